//! An ultrasonic matrix as a virtual sensor: the place of a box.
//!
//! The matrix faces a flat surface parallel to its plane, called the floor. A box of known size stands on the floor.
//! The echo time of each element gives the distance of the nearest surface in its cone. The place of the box is the
//! least-squares solution of all distances ([`fit`]).

mod fit;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use drive::ultrasonic::{Scan, ScanKind, UltrasonicFault, UltrasonicLink};
use nalgebra::{Point3, Vector3};
use thiserror::Error;

use super::VirtualSensor;
use crate::generator::{GeneratorError, SensorReading};
use crate::robot::Pose;
use fit::Echoes;

/// Greatest number of scans in a mean.
pub const MOST_SCANS: usize = 32;

/// Greatest distance of an echo from the median of its element, m. Echoes beyond are outliers.
const SPREAD: f64 = 0.006;

/// Why the readings of a matrix give no place of a box.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum EchoError {
    /// The matrix or its line has a fault.
    #[error("{0}")]
    Matrix(UltrasonicFault),
    /// Not enough scans have ended.
    #[error("{found} of {needed} scans: wait for the next scan")]
    NoScan {
        /// Scans so far.
        found: u16,
        /// Scans of a reading.
        needed: u16,
    },
    /// Too few elements received an echo.
    #[error(
        "{found} of {elements} elements have an echo, {needed} are needed: check range and direction of the matrix"
    )]
    TooFewEchoes {
        /// Elements with an echo.
        found: u16,
        /// Elements of the matrix.
        elements: u16,
        /// Least number.
        needed: u16,
    },
    /// No surface is nearer than the others by the height of the box.
    #[error("no box of {height} m height is in view: {near} elements have a near echo, {far} a far one")]
    NothingFound {
        /// Height of the box, m.
        height: f64,
        /// Elements with an echo of the nearer surface.
        near: u16,
        /// Elements with an echo of the floor.
        far: u16,
    },
    /// The echoes do not determine the place.
    #[error("the place of the box is uncertain by {deviation:.4} m, at most {most} m: move the box into the view")]
    Uncertain {
        /// Standard deviation in the worst direction, m.
        deviation: f64,
        /// Permitted standard deviation, m.
        most: f64,
    },
    /// The echoes do not fit a box of this size.
    #[error("the echoes differ from those of the box by {residual:.4} m rms, at most {most} m: check its size")]
    Unlike {
        /// Root of the mean square of the residuals, m.
        residual: f64,
        /// Permitted residual, m.
        most: f64,
    },
}

/// The matrix and its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatrixConfig {
    /// Elements per row and column, up to 16.
    pub size: u8,
    /// The echoes of a scan.
    pub scan: ScanKind,
    /// Distance between neighbouring elements, m.
    pub pitch: f64,
    /// Half the opening angle of the cone of an element, rad.
    pub half_cone: f64,
    /// Speed of sound, m/s.
    pub speed_of_sound: f64,
    /// Standard deviation of a measured distance, m.
    pub deviation: f64,
    /// Frame of the matrix in the base frame of the robot. Columns grow along x, rows along y, and the elements look
    /// along z.
    pub base_from_matrix: Pose,
}

/// Place of a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxPlace {
    /// Centre of the face towards the matrix, in the base frame of the robot, m.
    pub position: Point3<f64>,
    /// Rotation of the first edge of the box about z of the matrix, from x of the matrix, rad, within a half turn. A
    /// square box has no defined rotation.
    pub yaw: f64,
    /// Standard deviations of the position along x, y and z of the matrix, m.
    pub deviation: [f64; 3],
    /// Root of the mean square of the residuals of all used distances, m.
    pub residual: f64,
    /// Elements whose distance was used.
    pub used: u16,
    /// Elements without an echo in any scan.
    pub missing: u16,
    /// Echoes that were excluded as outliers.
    pub outliers: u16,
}

/// Reading of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxReading(Result<BoxPlace, EchoError>);

impl SensorReading for BoxReading {}

impl BoxReading {
    /// The place of the box.
    pub fn place(&self) -> Result<BoxPlace, GeneratorError> {
        self.0.map_err(GeneratorError::Echo)
    }

    /// The place of the box, or the reason why there is none.
    pub fn result(&self) -> Result<BoxPlace, EchoError> {
        self.0
    }
}

/// An ultrasonic matrix that finds a box. Reads the echo that each element receives of its own emission.
///
/// The box is at rest during the scans of a reading. The place is computed once per scan, while the agent is
/// polled. The computation ends after 24 iterations at most, and after 12 while the box stays where it was
/// (`cargo bench -p mrroc-controller --bench locator` measures the time). The time of a reading is the end of its last
/// scan.
pub struct BoxLocator {
    link: UltrasonicLink,
    config: MatrixConfig,
    /// Edges of the box along its own x, y and z, m.
    box_size: [f64; 3],
    scans: usize,
    past: VecDeque<Scan>,
    /// Number of the last scan seen.
    last: u64,
    reading: Option<(Instant, BoxReading)>,
    /// The last box that was found.
    found: Option<fit::Fitted>,
}

impl BoxLocator {
    /// A locator of a box with edges `box_size`, m: two along the floor, then the height. A reading needs `scans` scans
    /// after this call, 1 to [`MOST_SCANS`]; other values are limited to this range.
    pub fn new(link: UltrasonicLink, config: MatrixConfig, box_size: [f64; 3], scans: usize) -> Self {
        let scans = scans.clamp(1, MOST_SCANS);
        let last = link.read().scan.number;
        Self { link, config, box_size, scans, past: VecDeque::with_capacity(scans), last, reading: None, found: None }
    }

    /// The last reading and the time of its last scan.
    pub fn read(&mut self) -> (Instant, BoxReading) {
        let state = self.link.read();
        if let Some(fault) = state.fault {
            // Scans before and after a fault do not belong to one reading.
            self.past.clear();
            self.last = state.scan.number;
            self.reading = None;
            return (state.at, BoxReading(Err(EchoError::Matrix(fault))));
        }
        // A new bring-up counts from 1 again.
        if state.scan.number < self.last {
            (self.last, self.reading) = (0, None);
            self.past.clear();
        }
        if state.scan.number > self.last {
            self.last = state.scan.number;
            if self.past.len() == self.scans {
                self.past.pop_front();
            }
            self.past.push_back(state.scan);
            if self.past.len() == self.scans {
                let located = self.locate();
                self.reading = Some((state.scan.ended, BoxReading(located)));
            }
        }
        let (found, needed) = (self.past.len() as u16, self.scans as u16);
        self.reading.unwrap_or((state.at, BoxReading(Err(EchoError::NoScan { found, needed }))))
    }

    fn locate(&mut self) -> Result<BoxPlace, EchoError> {
        let size = usize::from(self.config.size).min(drive::ultrasonic::MOST_SHOTS);
        let mut echoes = Echoes::default();
        for row in 0..size {
            for column in 0..size {
                let (shot, number) = match self.config.scan {
                    ScanKind::Rows => (row, column),
                    ScanKind::Pairs => (row * size + column, row * size + column),
                };
                let times = self.past.iter().filter_map(|scan| scan.echo(shot, number));
                echoes.add(self.position(row, column), times.map(|time| self.distance(time)), SPREAD);
            }
        }
        let fitted = fit::locate(&echoes, &self.config, self.box_size, self.found.as_ref());
        self.found = fitted.as_ref().ok().copied();
        let fitted = fitted?;
        let place = Point3::from(Vector3::new(fitted.x, fitted.y, fitted.distance));
        Ok(BoxPlace {
            position: self.config.base_from_matrix * place,
            yaw: fitted.yaw,
            deviation: fitted.deviation,
            residual: fitted.residual,
            used: fitted.used,
            missing: echoes.missing,
            outliers: echoes.outliers + fitted.outliers,
        })
    }

    /// Place of an element in the plane of the matrix, m.
    fn position(&self, row: usize, column: usize) -> [f64; 2] {
        let middle = (f64::from(self.config.size) - 1.0) / 2.0;
        [column, row].map(|number| (number as f64 - middle) * self.config.pitch)
    }

    /// Distance of an echo, m.
    fn distance(&self, time: Duration) -> f64 {
        0.5 * time.as_secs_f64() * self.config.speed_of_sound
    }
}

impl VirtualSensor for BoxLocator {
    type Reading = BoxReading;
    type Command = ();

    fn poll(&mut self, _: Instant) -> Option<(Instant, BoxReading)> {
        Some(self.read())
    }
}
