//! The keys of ultrasonic matrices on serial lines.

use std::time::Duration;

use controller::robot::Pose;
use controller::sensor::MatrixConfig;
use drive::axis_controller::{Settings, StopBits};
use drive::ultrasonic::{ScanKind, UltrasonicConfig};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::{Cell, defaults};

/// A matrix of N × N ultrasonic transducers that look along one axis and measure echo times, on a serial line of its own
/// with 8 data bits and 1 stop bit.
///
/// The host asks for one row or one pair of elements after the other. A scan takes the firing slots of all its
/// emissions, and the time of the telegrams.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Ultrasonic {
    /// Name of the matrix in tasks and reports, unlike that of any bus, bundle of lines, force sensor or axis.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// The robot in whose base frame the place of the matrix and its readings are given.
    pub robot: String,
    /// The tty, `/dev/serial/by-id/…` for one that keeps its name; unused on the benches without hardware.
    pub line: String,
    /// Bits per second of the line.
    #[serde(default = "defaults::count::<115_200, u32>")]
    pub baud: u32,
    /// Elements per row and column, 1 to 16; 1 to 4 in a scan of pairs.
    pub size: u8,
    /// The echoes of a scan.
    #[serde(default)]
    pub scan: ScanKind,
    /// Distance between neighbouring elements, m.
    pub pitch: f64,
    /// Half the opening angle of the cone of an element, rad.
    pub half_cone: f64,
    /// Firing slot: duration of one emission with its echoes, µs.
    #[serde(default = "defaults::count::<3_500, u16>")]
    pub slot_us: u16,
    /// Speed of sound, m/s. The speed grows by 0.6 m/s per kelvin.
    #[serde(default = "speed_of_sound")]
    pub speed_of_sound: f64,
    /// Standard deviation of a measured distance, m.
    #[serde(default = "deviation")]
    pub deviation: f64,
    /// Centre of the matrix in the base frame of the robot, m.
    pub position: [f64; 3],
    /// Orientation of the matrix in the base frame of the robot as w, x, y, z: columns grow along x, rows along y, and the
    /// elements look along z.
    pub quaternion: [f64; 4],
    /// Queries in a row without a reply that are tolerated; one more is a fault of the matrix.
    #[serde(default = "defaults::count::<3, u32>")]
    pub tolerated_missing: u32,
    /// Settings of the emulated matrix, on the benches without hardware.
    #[serde(default)]
    pub emulator: UltrasonicEmulator,
}

/// What stands in for an ultrasonic matrix on the benches without hardware.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct UltrasonicEmulator {
    /// Whether the matrix is absent from its line.
    pub absent: bool,
    /// Time at which the cable of the emulated matrix breaks, s since the emulated devices were switched on; never where
    /// absent.
    pub silent_from_s: Option<f64>,
    /// Elements per row and column of the emulated matrix; those of the cell where absent.
    pub size: Option<u8>,
    /// Standard deviation of the noise of a distance, m; the declared deviation where absent.
    pub noise: Option<f64>,
    /// Share of the echoes that are lost, 0 to 1.
    pub lost_echoes: f64,
}

fn speed_of_sound() -> f64 {
    343.0
}

fn deviation() -> f64 {
    1e-3
}

impl Cell {
    /// The drive group of ultrasonic matrix `matrix` in [`groups`](Self::groups).
    pub fn group_of_matrix(&self, matrix: usize) -> usize {
        self.bus.len() + self.serial.len() + self.serial_sensors().count() + matrix
    }

    /// The ultrasonic matrix with drive group `group` of [`groups`](Self::groups); `None` for any other group.
    pub fn matrix_of_group(&self, group: usize) -> Option<&Ultrasonic> {
        self.ultrasonic.get(group.checked_sub(self.group_of_matrix(0))?)
    }
}

impl Ultrasonic {
    /// Settings of the line.
    pub fn settings(&self) -> Settings {
        Settings { baud: self.baud, stop_bits: StopBits::One }
    }

    /// Configuration of the driver at the servo period `period`.
    pub fn config(&self, period: Duration) -> UltrasonicConfig {
        UltrasonicConfig {
            settings: self.settings(),
            size: self.size,
            pitch: self.pitch,
            slot: Duration::from_micros(self.slot_us.into()),
            scan: self.scan,
            tolerated_missing: self.tolerated_missing,
            ..UltrasonicConfig::new(period)
        }
    }

    /// Configuration of the virtual sensor.
    pub fn matrix(&self) -> MatrixConfig {
        MatrixConfig {
            size: self.size,
            scan: self.scan,
            pitch: self.pitch,
            half_cone: self.half_cone,
            speed_of_sound: self.speed_of_sound,
            deviation: self.deviation,
            base_from_matrix: self.base_from_matrix(),
        }
    }

    /// Frame of the matrix in the base frame of its robot.
    pub fn base_from_matrix(&self) -> Pose {
        let [w, x, y, z] = self.quaternion;
        let [px, py, pz] = self.position;
        Pose::from_parts(Translation3::new(px, py, pz), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }
}
