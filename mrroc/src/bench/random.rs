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
            // A robot has up to eight axes, and only the first 31 robots have sixteen numbers each.
            Self::Axis { robot: robot @ 31.., number } => (robot - 31) * 16 + 8 + number,
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

    use servo::MAX_AXES;

    use super::*;
    use crate::cell::most_devices;
    use Stream::*;

    #[test]
    fn no_two_devices_share_a_stream() {
        let file = CellFile::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../cells/irb6.toml")).unwrap();
        let [robots, buses, matrices, sensors, cameras, conveyors, devices] = most_devices();
        let axes = (0..robots).flat_map(|robot| (0..MAX_AXES).map(move |number| Axis { robot, number }));
        let streams: Vec<_> = axes
            .chain((0..buses).map(Traffic))
            .chain((0..matrices).map(Matrix))
            .chain((0..sensors).map(Force))
            .chain((0..cameras).map(Camera))
            .chain((0..conveyors).map(Conveyor))
            .chain((0..devices).map(Device))
            .collect();
        assert!(streams.len() > 32 * 8);
        let seeds: HashSet<u64> = streams.iter().map(|stream| stream.seed(&file)).collect();
        assert_eq!(seeds.len(), streams.len());
    }
}
