//! Seeds of the random streams of a bench. The key `seed` of the cell determines all of them.

use crate::cell::CellFile;

/// What draws random numbers. Devices that differ never share a stream.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    /// Noise of an axis.
    Axis { robot: usize, number: usize },
    /// Noise of a camera.
    Camera(usize),
    /// Foreign frames of a bus.
    Traffic(usize),
    /// Measured path of a conveyor.
    Conveyor(usize),
    /// Echoes of an ultrasonic matrix.
    Matrix(usize),
    /// Noise of a force sensor.
    Force(usize),
    /// Noise of a device of another crate.
    Device(usize),
}

impl Stream {
    pub(super) fn seed(self, file: &CellFile) -> u64 {
        let number = match self {
            Self::Axis { robot, number } => robot * 16 + number,
            Self::Camera(number) => 500 + number,
            Self::Traffic(bus) => 600 + bus,
            Self::Conveyor(number) => 700 + number,
            Self::Matrix(number) => 800 + number,
            Self::Force(number) => 900 + number,
            Self::Device(number) => 950 + number,
        };
        file.cell.seed.wrapping_mul(1000).wrapping_add(number as u64)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use Stream::*;

    #[test]
    fn no_two_devices_share_a_stream() {
        let file = CellFile::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../cells/irb6.toml")).unwrap();
        let axes = (0..16).flat_map(|robot| (0..16).map(move |number| Axis { robot, number }));
        let others = (0..16).flat_map(|n| [Camera(n), Traffic(n), Conveyor(n), Matrix(n), Force(n), Device(n)]);
        let streams: Vec<_> = axes.chain(others).collect();
        let seeds: HashSet<u64> = streams.iter().map(|stream| stream.seed(&file)).collect();
        assert_eq!(seeds.len(), streams.len());
    }
}
