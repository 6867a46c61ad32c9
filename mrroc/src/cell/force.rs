//! The keys of force/torque sensors, and those of sensors on serial lines.

use std::time::Duration;

use controller::force::{Load, LoadError};
use controller::robot::{Mass, Pose};
use drive::axis_controller::{Settings, StopBits};
use drive::wrench::{Channel, SerialWrenchConfig, WrenchConfig, ZeroMethod};
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::{CanForceSensor, Cell, defaults};

/// Usual baud rate of a sensor, bit/s.
const BAUD: u32 = 115_200;

/// Usual sample rate of a sensor on a serial line, Hz.
const RATE: u32 = 1_000;

/// Greatest offset that a zeroing usually accepts, as a share of the range.
const USUAL_OFFSET: f64 = 0.2;

/// Part of a count by which a range may miss a whole number of counts through rounding.
const ROUNDING: f64 = 1e-6;

/// A force/torque sensor between the flange and the tool of a robot: on a serial line of its own (`line`), or on a CAN bus
/// (`can`).
///
/// The sensor on a serial line is an ATI transducer behind the controller board of the IRp-6 laboratory, 8 data bits and
/// 1 stop bit. The host queries the sensor in each servo period. The line carries a query of 1 byte and an answer of
/// 14 bytes within the period.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ForceSensor {
    /// Name of the sensor in tasks and reports, unlike that of any bus, bundle of lines or axis.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// The robot at whose flange the sensor sits.
    pub robot: String,
    /// The tty of a sensor on a serial line, `/dev/serial/by-id/…` for one that keeps its name; unused on the benches
    /// without hardware.
    pub line: Option<String>,
    /// The node of a sensor on a CAN bus.
    pub can: Option<CanForceSensor>,
    /// Bits per second of the line; 115200 where absent. Only with `line`.
    pub baud: Option<u32>,
    /// Samples per second that the sensor can take, at least one per servo period; 1000 where absent. Only with `line`.
    pub rate_hz: Option<u32>,
    /// Forces along x, y and z at which the sensor is saturated, N.
    pub force_range: [f64; 3],
    /// Torques about x, y and z at which the sensor is saturated, N·m.
    pub torque_range: [f64; 3],
    /// Force of one count, N; 10/115 where absent, required on a CAN bus. A negative value inverts the sense.
    pub force_per_count: Option<f64>,
    /// Torque of one count, N·m; 5/940 where absent, required on a CAN bus. A negative value inverts the sense.
    pub torque_per_count: Option<f64>,
    /// Origin of the sensor in the flange's frame, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Orientation of the sensor in the flange's frame as w, x, y, z; that of the flange where absent.
    pub quaternion: Option<[f64; 4]>,
    /// Mass of the tool and of all other parts behind the sensor, and its centre in the sensor's frame. Weight and inertia
    /// of this mass are compensated.
    #[serde(default)]
    pub tool: Mass,
    /// Moments of inertia of these parts about their centre, in the axes of the sensor, kg·m²; zero where absent, as of a
    /// point mass. Products of inertia are zero.
    #[serde(default)]
    pub tool_inertia: [f64; 3],
    /// Time by which the tool follows its set-points later than by the delay of its drives' protocol, s: the lag of the
    /// drives' own loops. The compensation of the inertia uses the set-points of this time before a sample. The default is
    /// the lag of the emulated drives.
    #[serde(default = "lag")]
    pub tool_lag_s: f64,
    /// Greatest reading that a zeroing accepts without the weight of the tool: forces along x, y and z, N, then torques
    /// about x, y and z, N·m; a fifth of each range where absent. A greater reading counts as a contact or as another tool.
    pub max_offset: Option<[f64; 6]>,
    /// Samples whose mean becomes the zero of the sensor.
    #[serde(default = "defaults::count::<10, u16>")]
    pub zero_samples: u16,
    /// Missing samples in a row that are tolerated; one more is a fault of the sensor.
    #[serde(default = "defaults::count::<3, u32>")]
    pub tolerated_missing: u32,
    /// Settings of the emulated sensor, on the benches without hardware.
    #[serde(default)]
    pub emulator: ForceSensorEmulator,
}

fn lag() -> f64 {
    0.002
}

/// What stands in for a force/torque sensor on the benches without hardware.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ForceSensorEmulator {
    /// Whether the sensor is absent from its line or bus.
    pub absent: bool,
    /// Time at which the cable of the emulated sensor breaks, s since the emulated devices were switched on; never where
    /// absent.
    pub silent_from_s: Option<f64>,
    /// Reading of the unloaded sensor: forces along x, y and z, N, then torques about x, y and z, N·m.
    pub offset: [f64; 6],
    /// Standard deviation of the noise of a sample: forces, N, then torques, N·m.
    pub noise: [f64; 6],
    /// Change of the reading per change of temperature since power-on: forces, N/K, then torques, N·m/K.
    pub drift: [f64; 6],
    /// Temperature of the emulated sensor; constant where absent.
    pub temperature: Option<EmulatedTemperature>,
}

/// First-order temperature course of an emulated sensor from power-on: `end + (start - end) exp(-t / time_constant_s)`.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedTemperature {
    /// Temperature at power-on, °C. The drift is zero at this temperature.
    pub start: f64,
    /// Final temperature, °C.
    pub end: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
}

impl ForceSensorEmulator {
    /// Final drift of the reading: forces, N, then torques, N·m.
    pub fn final_drift(&self) -> [f64; 6] {
        let warming = self.temperature.map_or(0.0, |temperature| temperature.end - temperature.start);
        self.drift.map(|drift| drift * warming)
    }
}

impl Cell {
    /// Indices in [`force_sensor`](Self::force_sensor) of the sensors on serial lines.
    pub fn serial_sensors(&self) -> impl Iterator<Item = usize> {
        (0..self.force_sensor.len()).filter(|&sensor| self.force_sensor[sensor].can.is_none())
    }

    /// The sensor on a serial line with drive group `group` of [`groups`](Self::groups); `None` for a bus or a bundle of
    /// lines.
    pub fn sensor_of_group(&self, group: usize) -> Option<&ForceSensor> {
        let number = group.checked_sub(self.bus.len() + self.serial.len())?;
        self.serial_sensors().nth(number).map(|sensor| &self.force_sensor[sensor])
    }

    /// Index of the robot at whose flange force sensor `sensor` sits.
    pub fn robot_of_sensor(&self, sensor: usize) -> usize {
        let name = &self.force_sensor[sensor].robot;
        self.robot.iter().position(|robot| robot.name == *name).expect("a parsed cell has the robot of a sensor")
    }
}

impl ForceSensor {
    /// Force of one count, N, and torque of one count, N·m.
    pub fn counts(&self) -> [f64; 2] {
        let given = [self.force_per_count, self.torque_per_count];
        let usual = WrenchConfig::ATI.channels;
        [given[0].unwrap_or(usual[0].scale), given[1].unwrap_or(usual[3].scale)]
    }

    /// The tty of a sensor on a serial line; empty for a sensor on a CAN bus.
    pub fn tty(&self) -> &str {
        self.line.as_deref().unwrap_or_default()
    }

    /// Settings of the line.
    pub fn settings(&self) -> Settings {
        Settings { baud: self.baud.unwrap_or(BAUD), stop_bits: StopBits::One }
    }

    /// Ranges of all channels, N and N·m.
    pub fn ranges(&self) -> [f64; 6] {
        let ([fx, fy, fz], [tx, ty, tz]) = (self.force_range, self.torque_range);
        [fx, fy, fz, tx, ty, tz]
    }

    /// The lag of the tool behind its set-points.
    pub fn tool_lag(&self) -> Duration {
        Duration::from_secs_f64(self.tool_lag_s)
    }

    /// Greatest offsets that a zeroing accepts, N and N·m.
    pub fn max_offsets(&self) -> [f64; 6] {
        self.max_offset.unwrap_or(self.ranges().map(|range| USUAL_OFFSET * range))
    }

    /// The load behind the sensor. Fails if the moments of inertia are not those of a body.
    pub fn load(&self) -> Result<Load, LoadError> {
        let Mass { mass, centre } = self.tool;
        Load::new(mass, centre.into(), Matrix3::from_diagonal(&self.tool_inertia.into()))
    }

    /// Scales, ranges and tolerances.
    pub fn wrench_config(&self) -> WrenchConfig {
        let ranges = self.ranges();
        let channel = |axis: usize| {
            let scale = self.counts()[axis / 3];
            Channel { scale, range: (ranges[axis] / scale.abs() + ROUNDING).floor() as i32 }
        };
        WrenchConfig {
            channels: std::array::from_fn(channel),
            tolerated_missing: self.tolerated_missing,
            zero: ZeroMethod::Host { samples: self.zero_samples },
            ..WrenchConfig::ATI
        }
    }

    /// Configuration of the driver of a sensor on a serial line, at the servo period `period`.
    pub fn config(&self, period: Duration) -> SerialWrenchConfig {
        let sensor = self.wrench_config();
        SerialWrenchConfig { settings: self.settings(), sensor, ..SerialWrenchConfig::new(period) }
    }

    /// Samples per second that a sensor on a serial line can take.
    pub fn samples_per_second(&self) -> u32 {
        self.rate_hz.unwrap_or(RATE)
    }

    /// Time between two samples at the servo period `period`.
    pub fn sample_period(&self, period: Duration) -> Duration {
        self.can.as_ref().map_or(period, |can| can.sample_period(period))
    }

    /// Frame of the sensor in the flange's frame.
    pub fn flange_from_sensor(&self) -> Pose {
        let [w, x, y, z] = self.quaternion.unwrap_or([1.0, 0.0, 0.0, 0.0]);
        let [px, py, pz] = self.position;
        Pose::from_parts(Translation3::new(px, py, pz), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }
}
