//! The cell file: robots, buses, lines and drives of one controller, in TOML.
//!
//! The structs mirror the file key for key. The JSON schema next to the example cells is generated from them.
//! [`CellFile`] is a cell that was read from a file, with its device configuration files. [`Cell::parse`] checks the
//! whole cell, so the rest of the program does not check again. A `Cell` deserialised by
//! serde alone is unchecked. Units are SI: rad, rad/s and rad/s² at the **motor shaft** for an axis, rad or m at the
//! joint for a program. The name of a key with another unit ends in that unit.

mod axis_controller;
mod camera;
mod can_force_sensor;
mod chain;
mod conveyor;
mod defaults;
mod device;
mod device_configuration;
mod drives;
mod emergency_contact;
mod error;
mod file;
mod force;
mod force_law;
mod home;
mod io;
mod meetings;
mod parse;
mod program;
mod read;
mod scene;
#[cfg(feature = "schema")]
mod schema;
#[cfg(test)]
mod tests;
mod text;
mod touch;
mod ultrasonic;
mod validation;
mod workpiece;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use controller::generator::Pose;
use controller::robot::{self, Arm, Mass, ParameterError, Weight, WeightError};
use servo::KeyProblem;

pub use crate::robots::{Model, Parameters};
pub use axis_controller::{AxisController, Loop, Serial};
pub use camera::{Camera, CameraEmulator};
pub use can_force_sensor::{CanForceSensor, FieldContent, SensorField, SensorPdo};
pub use chain::{
    Body, ChainSettings, Convention, DenavitHartenberg, DescribedJoint, DescribedRobot, Frame, JointSettings, read_urdf,
};
pub use conveyor::{EmulatedConveyor, EmulatedGate, EmulatedObject};
pub(crate) use device::DEVICE_KEYS;
pub use device::{Device, DeviceEmulator, DeviceKeys};
pub(crate) use device_configuration::DeviceConfiguration;
pub use device_configuration::{Checked, Refused};
pub use drive::axis_controller::{Control, Protocol};
pub use drives::ENABLING;
pub use emergency_contact::EmergencyContact;
pub use error::{CellError, Path, Step};
pub use file::{CellFile, FileError};
pub use force::{EmulatedTemperature, ForceSensor, ForceSensorEmulator};
pub use force_law::ForceLaw;
pub use io::{ErrorState, InputLine, IoNode, LinePlace, OutputLine};
pub use meetings::Meeting;
pub(crate) use program::smooth_pose;
pub use program::{JOINT_LIMITS, PLANNED, ProgramError, instruction_path};
pub use read::LARGEST;
pub(crate) use read::{element as read_element, entries as read_entries, from_text};
pub use scene::{EmulatedBar, EmulatedBlock, EmulatedGripper, EmulatedPlane, EmulatedScene, EmulatedTip, Place};
pub use servo::regulator::{CascadeConfig, IncrementalConfig, ProportionalConfig};
pub use servo::thread::{Policy, Realtime, Scheduler, Wait};
pub use servo::{Direction, FeedForward, Figure, Law, Range};
pub(crate) use text::one_of;
pub use text::{printable, quoted};
pub use touch::EmulatedTouchProbe;
pub use ultrasonic::{Ultrasonic, UltrasonicEmulator};
#[cfg(test)]
pub(crate) use validation::most_devices;
pub use workpiece::{EmulatedCutter, EmulatedWorkpiece};

/// One controller: all robots that share one servo cycle.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Name of the cell in reports.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Period of the servo cycle and of SYNC, µs: 1 to 100 whole milliseconds.
    pub period_us: u32,
    /// Servo periods in one macrostep, the step of the generators.
    #[serde(default = "defaults::count::<10, u16>")]
    pub macrostep: u16,
    /// Tolerated number of missed deadlines in a row; one more stops the cell with category 1. The drives hold their
    /// last set-point while deadlines are missed. The number therefore limits the time that a moving arm stands still
    /// before it would jump. The number has no effect on the emulated benches, where time waits for the host.
    #[serde(default = "defaults::count::<3, u32>")]
    pub max_missed_in_row: u32,
    /// Silence of the servo after which the guardian, a process beside the controller, puts every axis controller on a
    /// serial line into its error state, and stops the nodes of guarded buses, ms: at least two periods, at most 1000. Where absent, the silence of
    /// `max_missed_in_row` missed deadlines and one and a half periods, within 5 to 1000 ms.
    pub guardian_ms: Option<u32>,
    /// Hardware watchdog, for example `/dev/watchdog`, on the benches vcan and card. The guardian writes a byte to the file
    /// every 100 ms while servo cycles are completed, and the letter V at an orderly end. The time-out of the watchdog must
    /// be longer than 100 ms.
    pub watchdog: Option<String>,
    /// Longest wait of a robot for its partners at a meeting, s. A longer wait stops the cell by a fault.
    #[serde(default = "defaults::count::<600, u32>")]
    pub meeting_timeout_s: u32,
    /// Seconds of every cycle, frame and telegram that the flight recorder keeps in memory for `--flight`, at most 600; 0
    /// for none.
    #[serde(default = "defaults::count::<10, u32>")]
    pub flight_recorder_s: u32,
    /// Seed of all random values in the emulators.
    #[serde(default = "defaults::count::<1, u64>")]
    pub seed: u64,
    /// Real-time settings of the servo thread.
    #[serde(default)]
    pub realtime: Realtime,
    /// The CAN buses.
    #[serde(default)]
    pub bus: Vec<Bus>,
    /// The bundles of serial lines.
    #[serde(default)]
    pub serial: Vec<Serial>,
    /// The nodes of digital inputs and outputs.
    #[serde(default)]
    pub io: Vec<IoNode>,
    /// The force/torque sensors.
    #[serde(default)]
    pub force_sensor: Vec<ForceSensor>,
    /// The ultrasonic matrices.
    #[serde(default)]
    pub ultrasonic: Vec<Ultrasonic>,
    /// The network cameras.
    #[serde(default)]
    pub camera: Vec<Camera>,
    /// Devices of kinds that the program adds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<DeviceKeys>"))]
    pub device: Vec<Device>,
    /// The surroundings of the emulated robots; empty where absent.
    pub scene: Option<EmulatedScene>,
    /// The robots.
    pub robot: Vec<Robot>,
    /// Parameters of the task, with keys of its own. A program reads the table by `Cell::parameters`, without the tables
    /// `task.teach` and `task.replay`, which belong to the tasks of these names.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "std::collections::BTreeMap<String, serde_json::Value>"))]
    pub task: toml::Table,
}

/// One CAN bus and the host's behaviour on it.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Bus {
    /// Name of the bus for axes and reports.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Bit rate, kbit/s.
    #[serde(default = "defaults::count::<1_000, u32>")]
    pub bitrate_kbps: u32,
    /// The interface on the benches with a real or virtual interface: a SocketCAN interface, or `slcan:PATH[@BAUD]`
    /// for an adapter on a tty.
    pub interface: String,
    /// Node-ID of the host, whose heartbeat the drives watch.
    #[serde(default = "defaults::count::<127, u8>")]
    pub host_node: u8,
    /// Period of every heartbeat on the bus, ms, at least the servo period. Three periods without a heartbeat are a fault.
    #[serde(default = "defaults::count::<100, u16>")]
    pub heartbeat_ms: u16,
    /// Tolerated number of cycles in a row without an answer of a drive; one more is a fault.
    #[serde(default = "defaults::count::<5, u32>")]
    pub tolerated_missing: u32,
    /// Time-out of an SDO answer, ms: at least one servo period per node of the bus. In operation, one request leaves per
    /// cycle, and the nodes take turns.
    #[serde(default = "defaults::count::<500, u32>")]
    pub sdo_timeout_ms: u32,
    /// Time-out of a node's boot, from its reset to its first answer, ms. An emulated node boots in 50 ms and answers in the
    /// next cycle; real nodes take longer.
    #[serde(default = "defaults::count::<2_000, u32>")]
    pub boot_timeout_ms: u32,
    /// Whether the guardian stops all nodes of the bus by an NMT command when the servo is silent. Drives stop by themselves
    /// after three heartbeats, and the guardian earlier. The bus must have a SocketCAN interface.
    #[serde(default)]
    pub guarded: bool,
    /// Share of the capacity of the emulated bus that frames of further nodes take, 0 to 0.9, in addition to the
    /// traffic of the cell. Half of the frames have a higher priority than all process data. Only the benches with a
    /// virtual bus (lockstep, emulated) have these frames.
    #[serde(default)]
    pub emulated_load: f64,
}

/// One effector: its kinematics, axes and program.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Name of the robot in reports.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Model of the robot, or `chain`.
    pub model: Option<Model>,
    /// Geometry, drive train, home positions and limits, in place of those of the model.
    pub parameters: Option<Parameters>,
    /// A serial arm that is no model of this list: from a robot description in URDF, or from a table of joints.
    pub chain: Option<ChainSettings>,
    /// Place of the base in the frame of the cell, for tasks with several robots and for the emulated surroundings; the
    /// origin of this frame where absent.
    #[serde(default)]
    pub base: Place,
    /// Difference between the place of the emulated base and `base`: a calibration error, in the frame of the base. Real
    /// robots ignore this key.
    #[serde(default)]
    pub emulated_base_error: Place,
    /// Origin of the tool in the flange's frame, m.
    #[serde(default)]
    pub tool: [f64; 3],
    /// Masses of the links, for the feed-forward of the weight to the motors; no such feed-forward where absent.
    pub weight: Option<Weights>,
    /// Force control in each servo cycle; generators cannot command forces where absent.
    pub force_law: Option<ForceLaw>,
    /// The axes, base first.
    pub axis: Vec<Axis>,
    /// Instructions after homing, in order.
    #[serde(default)]
    pub program: Vec<Instruction>,
    /// Payloads of the emulated robot, each from a given time on; no payload before the first. Real robots ignore this
    /// key.
    #[serde(default)]
    pub emulated_payload: Vec<EmulatedPayload>,
}

impl Robot {
    /// Kinematics, tool and weight of the robot, or the error in its parameters.
    pub fn arm(&self) -> Result<Arm, ParameterError> {
        let robot = self.kinematics()?;
        let weight = self.weight.as_ref().map(|weights| weights.of(&self.numbers(), &*robot));
        let arm = Arm::new(robot, Pose::translation(self.tool[0], self.tool[1], self.tool[2]));
        Ok(match weight.transpose().map_err(ParameterError::Weight)? {
            Some(weight) => arm.weighing(weight),
            None => arm,
        })
    }

    /// The text of an error with the names of axes in place of their numbers.
    pub fn naming_axes(&self, error: impl std::fmt::Display) -> String {
        let said = error.to_string();
        for (number, axis) in self.axis.iter().enumerate() {
            let numbered = format!("axis {number}");
            let Some((before, behind)) = said.split_once(&numbered) else {
                continue;
            };
            if behind.starts_with(|c: char| c.is_ascii_digit()) {
                continue;
            }
            // A name in front of the message is not repeated.
            let name = &axis.name;
            let in_front = before.strip_suffix(", ").is_some_and(|it| it.ends_with(name));
            let before = if in_front { "" } else { before };
            // An error concerns one axis.
            return format!("{before}axis {name}{behind}");
        }
        said
    }

    /// Pose of the base frame of the kinematics in the frame of the cell.
    pub fn cell_from_base(&self) -> Pose {
        self.base.pose() * self.numbers().upright_from_base()
    }

    /// The parameters of the robot: its own, or those of its model.
    pub fn numbers(&self) -> Parameters {
        let chain = || self.chain.as_ref()?.numbers.clone().map(Parameters::Chain);
        let own = self.parameters.clone().or_else(chain).or_else(|| self.model.map(Model::parameters));
        own.expect("a parsed robot has a model or a chain")
    }

    /// Kinematics and drive train, or the error in the parameters.
    pub fn kinematics(&self) -> Result<Arc<dyn robot::Robot>, ParameterError> {
        self.numbers().kinematics()
    }
}

/// One axis: a drive, its scale, its limits.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Name of the axis in reports.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// The CAN bus of the drive, or the bundle of serial lines of the axis controller.
    pub bus: String,
    /// Node-ID of the drive, or NFv2 address of the axis controller. The older protocol has no addresses.
    #[serde(default)]
    pub node: u8,
    /// The drive, on a CAN bus.
    pub drive: Option<Drive>,
    /// The axis controller, on a serial line.
    pub controller: Option<AxisController>,
    /// Greatest motor velocity, rad/s.
    pub max_velocity: f64,
    /// Greatest motor acceleration, rad/s².
    pub max_acceleration: f64,
    /// Lowest motor position, rad, within the limits of the model and below `max_position`; the limit of the model
    /// where absent.
    pub min_position: Option<f64>,
    /// Highest motor position, rad, within the limits of the model and above `min_position`; the limit of the model
    /// where absent.
    pub max_position: Option<f64>,
    /// Greatest following error: distance between commanded and measured motor position, rad.
    pub following_error: f64,
    /// Whether a brake holds the motor while its power is off. If the brake does not hold after an orderly power-off,
    /// the motors of the robot get their power again. An axis without a brake may move then.
    #[serde(default = "defaults::yes")]
    pub brake: bool,
    /// Whether the power of the axis is removed if its measured position stands still although the motor should move.
    /// `false` for an axis that presses against rigid bodies: only `following_error` then detects a blocked motor.
    #[serde(default = "defaults::yes")]
    pub frozen_watch: bool,
    /// How the axis searches for its reference.
    pub homing: Homing,
    /// Settings of the emulated axis, on the benches without hardware.
    #[serde(default)]
    pub emulator: Emulator,
}

/// A CiA 402 drive on CAN.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Vendor-ID, object 0x1018:01.
    pub vendor: u32,
    /// Product code, object 0x1018:02; not checked where absent.
    pub product: Option<u32>,
    /// Revision number, object 0x1018:03; not checked where absent.
    pub revision: Option<u32>,
    /// Device configuration file (DCF of CiA 306), relative to the cell file. Its values are written before operation
    /// and read back. Settings of the controller and `parameter` are written later and take precedence. A file without
    /// a node-ID can serve several axes.
    pub dcf: Option<String>,
    /// Quadrature counts per motor revolution.
    pub counts_per_revolution: u32,
    /// Whether the counter falls while the motor turns in its positive direction.
    #[serde(default)]
    pub reversed: bool,
    /// Rated torque of the motor, N·m. The drive's torque values are thousandths of it.
    pub rated_torque: f64,
    /// Greatest torque of motor and drive, N·m, for `mrroc check` and the emulated drive; a nominal one where absent.
    pub max_torque: Option<f64>,
    /// The quantity commanded to the drive.
    #[serde(default)]
    pub control: DriveControl,
    /// Greatest acceleration that the motor can physically have, rad/s²: a step of the counter in motion that needs more is a
    /// fault. Twenty times the axis's `max_acceleration` where absent.
    pub plausible_acceleration: Option<f64>,
    /// The position loop in the host, with `control = "velocity"` or `"torque"`.
    pub r#loop: Option<Loop>,
    /// A digital input of the drive that is a contact of the emergency stop.
    pub emergency_stop: Option<EmergencyContact>,
    /// Further objects to write before operation.
    #[serde(default)]
    pub parameter: Vec<Parameter>,
}

/// An object written to a drive or an I/O node before operation and read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Parameter {
    /// Index.
    pub index: u16,
    /// Sub-index.
    #[serde(default)]
    pub subindex: u8,
    /// Value; two's complement for a signed object.
    pub value: u32,
    /// Size of the object, bytes: 1, 2 or 4.
    pub bytes: u8,
}

/// The quantity commanded to a drive on CAN at every SYNC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DriveControl {
    /// Position (CSP): the drive closes every loop.
    #[default]
    Position,
    /// Velocity (CSV): the host closes the position loop.
    Velocity,
    /// Torque (CST): the host closes position and velocity loop. The gain of these loops is correct only if
    /// `rated_torque` equals object 0x6076 of the drive. For maxon, that value is nominal current times torque
    /// constant.
    Torque,
}

// One table for both families. The legs of a `HostHoming` follow from the limits of the motor.
/// Homing: by the drive on CAN (CiA 402 mode HM), by the host on a serial line.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Homing {
    /// Homing method of a drive, object 0x6098. An axis on a serial line has no method: it searches for its home
    /// switch, and then back for the index pulse of the switch.
    pub method: Option<i8>,
    /// Direction in which an axis on a serial line searches for its home switch; negative where absent.
    pub direction: Option<Direction>,
    /// Homing order: axes home in ascending order, and axes of equal order together.
    #[serde(default)]
    pub order: u8,
    /// Whether a search by the host that meets a limit switch returns across the home switch and starts again, once;
    /// true where absent.
    pub reverse_at_limit: Option<bool>,
    /// Longest time, ms, from the start of homing until a drive on CAN shows that it searches; 1000 where absent. A result
    /// that the drive shows before is of an earlier search.
    pub start_timeout_ms: Option<u32>,
    /// Motor velocity while searching for the switch, rad/s.
    pub search_velocity: f64,
    /// Motor velocity while searching for the index pulse, rad/s.
    pub zero_velocity: f64,
    /// Motor acceleration, rad/s².
    pub acceleration: f64,
}

/// What stands in for an axis on the benches without hardware.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Emulator {
    /// The plant behind the emulated drive.
    pub plant: Plant,
    /// Dry friction of the emulated motor as a share of its nominal value; 1 where absent. Without dry friction, the axis
    /// is linear. The plant `wut` has none.
    pub dry_friction: Option<f64>,
    /// Time constant of the filter of position set-points in the emulated drive, s; no filter where absent.
    #[serde(default)]
    pub setpoint_filter_s: f64,
    /// Initial motor position of the emulated axis, rad; 20 rad above its home position where absent.
    pub start: Option<f64>,
    /// Vendor-ID that the emulated drive reports; the drive's own where absent.
    pub vendor: Option<u32>,
    /// Revision number that the emulated drive reports; the drive's own where absent.
    pub revision: Option<u32>,
    /// Quadrature counts per revolution that the emulated drive reports for its sensor; the drive's own where absent.
    pub counts_per_revolution: Option<u32>,
    /// Rated torque that the emulated drive reports for its motor, N·m; the drive's own where absent.
    pub rated_torque: Option<f64>,
    /// NFv2 address of the emulated axis controller; the axis's own where absent.
    pub address: Option<u8>,
    /// Protocol of the emulated axis controller; the protocol of the axis where absent.
    pub protocol: Option<Protocol>,
    /// Whether the device is absent from its bus or line. An absent drive never boots.
    pub absent: bool,
    /// Time at which the emulated drive on CAN trips with an over-current, s since the emulated devices were switched on;
    /// never where absent. A drive whose motor has no power at this time trips when the motor gets power.
    pub trips_at_s: Option<f64>,
}

/// A payload of an emulated robot from a given time on. The payload replaces the previous one.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EmulatedPayload {
    /// Time since the emulated drives were switched on, s.
    pub at_s: f64,
    /// Mass of the payload, kg; 0 removes the payload.
    pub mass: f64,
    /// The centre of mass in the emulated mechanism's flange frame, m.
    #[serde(default)]
    pub centre: [f64; 3],
}

/// Masses of a robot's links. With this table in the cell file, the torques that hold the links in the commanded pose
/// are fed forward to the motors. Without the table, only the position loops hold the weight. An empty table uses the
/// nominal masses of the model.
///
/// The host must close the position loop of every axis, commanded by torque or current. Pulse width is possible if
/// `feed_forward` gives `weight`. Drives that close the loop hold the weight by themselves.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// The links from base to flange, as written by `mrroc urdf`; the nominal links of the model where absent.
    pub masses: Option<Vec<Mass>>,
    /// The load at the flange beyond the last link, with its centre in the flange's frame.
    pub load: Mass,
    /// The direction against gravity in the robot's base frame, of any length; the direction of the model where
    /// absent.
    pub up: Option<[f64; 3]>,
}

impl Weights {
    /// The weight of `robot`, whose parameters are `numbers`.
    pub(super) fn of(&self, numbers: &Parameters, robot: &dyn robot::Robot) -> Result<Weight, WeightError> {
        let masses = self.masses.clone().unwrap_or_else(|| numbers.masses());
        Weight::new(robot, &masses, self.load, self.up.unwrap_or(numbers.up()))
    }
}

/// Physical models of an emulated axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Plant {
    /// Friction, gravity, current limit, switches; masses and friction are nominal.
    #[default]
    Physical,
    /// Only the inertia and viscous friction of WUT's emulator.
    Wut,
}

/// One instruction of a program.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Instruction {
    /// Move through joint poses.
    Joints(Joints),
    /// Move the tool along a straight line.
    Line(LineInstruction),
    /// Stand until every robot whose program names this meeting has come to it. All of them then continue in the same
    /// servo cycle. A repeated name is another meeting of the same robots.
    Meet(#[cfg_attr(feature = "schema", schemars(schema_with = "schema::of_name"))] String),
}

/// A motion through joint poses.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Joints {
    /// The poses, each as many joint values as the robot has axes, rad.
    pub poses: Vec<Vec<f64>>,
    /// The generator.
    #[serde(default)]
    pub generator: JointGenerator,
    /// Fraction of the greatest joint velocity to use.
    #[serde(default = "defaults::hundredths::<50>")]
    pub velocity: f64,
    /// Fraction of the greatest joint acceleration to use.
    #[serde(default = "defaults::hundredths::<50>")]
    pub acceleration: f64,
    /// Duration of the motion to each pose, s, rounded up to a servo period; the shortest within the limits where absent.
    /// Only for jerk-limited motions.
    pub duration: Option<f64>,
}

/// The generators of joint motions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum JointGenerator {
    /// Time-synchronised trapezoid of velocity, continuous through the poses.
    #[default]
    Newsmooth,
    /// Jerk-limited, at rest in each pose.
    JerkLimited,
}

/// A straight line of the tool from its present position.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LineInstruction {
    /// Target position of the tool, m, in the robot's base frame.
    pub position: [f64; 3],
    /// Target orientation of the tool as w, x, y, z; unchanged where absent.
    pub quaternion: Option<[f64; 4]>,
    /// Greatest tool velocity, m/s.
    #[serde(default = "defaults::hundredths::<20>")]
    pub velocity: f64,
    /// Greatest tool acceleration, m/s².
    #[serde(default = "defaults::hundredths::<50>")]
    pub acceleration: f64,
    /// Whether the speed is constant between acceleration and braking, for example for engraving. A line that joints
    /// limit is then slower as a whole, not only where a joint is fast.
    #[serde(default)]
    pub constant_speed: bool,
}

/// The problem of a number outside its range.
fn out_of_range(value: f64, range: Range) -> String {
    KeyProblem::OutOfRange { value, range }.to_string()
}
