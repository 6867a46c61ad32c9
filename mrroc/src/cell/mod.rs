//! The cell file: robots, buses, lines and drives of one controller, in TOML.
//!
//! These structs are the file, key for key; the JSON schema beside the example cells is generated
//! from them. What [`Cell::parse`] returns has been checked whole, so the rest of the program does
//! not check again: take no `Cell` from serde alone. Units are SI at the **motor shaft** for an
//! axis (rad, rad/s, rad/s²) and joint rad or metres for a program; a key that holds something
//! else says so in its name.

mod axis_controller;
mod check;
mod document;
mod drives;
mod error;
mod home;
mod locate;
mod meetings;
mod program;
mod read;
#[cfg(test)]
mod tests;
mod text;
mod weight;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use controller::generator::Pose;
use controller::robot::Arm;
use controller::robot::ParameterError;

pub use crate::robots::{Model, Parameters};
pub use axis_controller::{AxisController, Loop, Serial};
pub use document::LARGEST;
pub use drive::axis_controller::{Control, Protocol};
pub use drives::ENABLING;
pub use error::{CellError, Problem};
pub use locate::{Path, Step};
pub use meetings::Meeting;
pub use program::{ProgramError, instruction_path};
pub use servo::regulator::{CascadeConfig, IncrementalConfig, ProportionalConfig};
pub use servo::thread::{Policy, Realtime, Scheduler, Wait};
pub use servo::{Direction, FeedForward, Figure, Law, Range};
pub use text::{printable, quoted};
pub use weight::Weights;

/// One controller: everything that is stepped on one tick grid.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// What the reports call it.
    #[schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"))]
    pub name: String,
    /// Period of the servo cycle and of SYNC, µs: 1 to 100 whole milliseconds.
    pub period_us: u32,
    /// Servo periods in one macrostep, the step of the generators.
    #[serde(default = "defaults::macrostep")]
    pub macrostep: u16,
    /// Deadlines that may be missed in a row; one more stops the cell with category 1. The drives hold
    /// their last set-point while deadlines are missed, so this bounds how long an arm in motion stands
    /// still before it would jump. Without effect on the emulated benches, whose time waits for the host.
    #[serde(default = "defaults::max_missed_in_row")]
    pub max_missed_in_row: u32,
    /// How long a robot may wait for its partners at a meeting, s; then the cell stops by a fault.
    #[serde(default = "defaults::meeting_timeout_s")]
    pub meeting_timeout_s: u32,
    /// Seed of everything that is random in the emulators.
    #[serde(default = "defaults::seed")]
    pub seed: u64,
    /// What the servo thread asks of the host.
    #[serde(default)]
    pub realtime: Realtime,
    /// The CAN buses.
    #[serde(default)]
    pub bus: Vec<Bus>,
    /// The bundles of serial lines.
    #[serde(default)]
    pub serial: Vec<Serial>,
    /// The robots.
    pub robot: Vec<Robot>,
}

/// One CAN bus and the host's behaviour on it.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bus {
    /// What axes and reports call it.
    #[schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"))]
    pub name: String,
    /// Bit rate, kbit/s.
    #[serde(default = "defaults::bitrate_kbps")]
    pub bitrate_kbps: u32,
    /// The interface on the benches that have one: SocketCAN's, or `slcan:PATH[@BAUD]` for an adapter on a tty.
    pub interface: String,
    /// Node-ID of the host, whose heartbeat the drives watch.
    #[serde(default = "defaults::host_node")]
    pub host_node: u8,
    /// Period of every heartbeat on the bus, ms; silence of three periods is a fault.
    #[serde(default = "defaults::heartbeat_ms")]
    pub heartbeat_ms: u16,
    /// Cycles in a row that a drive's answer may be missing before it is a fault.
    #[serde(default = "defaults::tolerated_missing")]
    pub tolerated_missing: u32,
    /// Deadline of one SDO answer, ms.
    #[serde(default = "defaults::sdo_timeout_ms")]
    pub sdo_timeout_ms: u32,
    /// Deadline of a node's boot, ms.
    #[serde(default = "defaults::boot_timeout_ms")]
    pub boot_timeout_ms: u32,
}

/// One effector: its kinematics, its axes and what it is to do.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// What reports call it.
    #[schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"))]
    pub name: String,
    /// Which robot it is.
    pub model: Model,
    /// Geometry, drive train, home positions and limits, in place of the model's own.
    #[serde(default)]
    pub parameters: Option<Parameters>,
    /// Origin of the tool in the flange's frame, m.
    #[serde(default)]
    pub tool: [f64; 3],
    /// What its links weigh, to be fed forward to its motors; not fed forward where absent.
    #[serde(default)]
    pub weight: Option<Weights>,
    /// The axes, base first.
    pub axis: Vec<Axis>,
    /// What it does after homing, in order.
    #[serde(default)]
    pub program: Vec<Instruction>,
    /// What the emulated robot carries, and from when on; nothing before the first. The others ignore it.
    #[serde(default)]
    pub emulated_payload: Vec<EmulatedPayload>,
}

impl Robot {
    /// Its kinematics, its tool and what weighs on its motors, or what is wrong with its parameters.
    pub fn arm(&self) -> Result<Arm, ParameterError> {
        let robot = self.kinematics()?;
        let weight = self
            .weight
            .as_ref()
            .map(|weights| weights.of(self.model, &*robot));
        let tool = Pose::translation(self.tool[0], self.tool[1], self.tool[2]);
        let arm = Arm::new(robot, tool);
        Ok(match weight.transpose().map_err(ParameterError::Weight)? {
            Some(weight) => arm.weighing(weight),
            None => arm,
        })
    }

    /// What an error says, with the names of axes in place of their numbers.
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
            // Where the name stands in front, once is enough.
            let name = &axis.name;
            let in_front = before
                .strip_suffix(", ")
                .is_some_and(|it| it.ends_with(name));
            let before = if in_front { "" } else { before };
            // An error is of one axis.
            return format!("{before}axis {name}{behind}");
        }
        said
    }

    /// Its kinematics and drive train, or what is wrong with its parameters.
    pub fn kinematics(&self) -> Result<Arc<dyn controller::robot::Robot>, ParameterError> {
        let usual = || self.model.parameters();
        self.parameters.unwrap_or_else(usual).kinematics()
    }
}

/// One axis: a drive, its scale, its limits.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// What reports call it.
    #[schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"))]
    pub name: String,
    /// The CAN bus its drive hangs on, or the bundle of lines its axis controller is of.
    pub bus: String,
    /// Node-ID of its drive, or NFv2 address of its axis controller; the older protocol has none.
    #[serde(default)]
    pub node: u8,
    /// The drive, on a CAN bus.
    #[serde(default)]
    pub drive: Option<Drive>,
    /// The axis controller, on a serial line.
    #[serde(default)]
    pub controller: Option<AxisController>,
    /// Greatest motor velocity, rad/s.
    pub max_velocity: f64,
    /// Greatest motor acceleration, rad/s².
    pub max_acceleration: f64,
    /// Lowest motor position, rad, within the model's own limits and below `max_position`; the model's own
    /// where absent.
    #[serde(default)]
    pub min_position: Option<f64>,
    /// Highest motor position, rad, within the model's own limits and above `min_position`; the model's own
    /// where absent.
    #[serde(default)]
    pub max_position: Option<f64>,
    /// Greatest distance between commanded and measured motor position, rad.
    pub following_error: f64,
    /// How it finds its reference.
    pub homing: Homing,
    /// What stands in for it on the benches without hardware.
    #[serde(default)]
    pub emulator: Emulator,
}

/// A CiA 402 drive on CAN.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Vendor-ID, object 0x1018:01.
    pub vendor: u32,
    /// Product code, object 0x1018:02; not checked where absent.
    #[serde(default)]
    pub product: Option<u32>,
    /// Revision number, object 0x1018:03; not checked where absent.
    #[serde(default)]
    pub revision: Option<u32>,
    /// Device configuration file (DCF of CiA 306) whose values are written before operation and read back, relative to the
    /// cell file. What the controller itself sets, and `parameter`, come after it and win. One that states no node-ID can
    /// serve several axes.
    #[serde(default)]
    pub dcf: Option<String>,
    /// Quadrature counts per motor revolution.
    pub counts_per_revolution: u32,
    /// Whether the counter falls while the motor turns in its positive direction.
    #[serde(default)]
    pub reversed: bool,
    /// Rated torque of the motor, N·m: the unit of the drive's torque values is a thousandth of it.
    pub rated_torque: f64,
    /// What it is commanded by.
    #[serde(default)]
    pub control: DriveControl,
    /// How the host closes the position loop, under `control = "velocity"` or `"torque"`.
    #[serde(default)]
    pub r#loop: Option<Loop>,
    /// Further objects to write before operation.
    #[serde(default)]
    pub parameter: Vec<Parameter>,
}

// A drive's `CyclicMode` has one mode more, position with a torque, which follows from the robot's `weight`.
/// What a drive on CAN is commanded by, each at every SYNC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DriveControl {
    /// Position (CSP): the drive closes every loop.
    #[default]
    Position,
    /// Velocity (CSV): the host closes the position loop.
    Velocity,
    /// Torque (CST): the host closes position and velocity loop. Their gain is right only if `rated_torque` is what the
    /// drive says in object 0x6076, which for maxon is nominal current times torque constant.
    Torque,
}

/// An object written to a drive before operation and read back.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Parameter {
    /// Index.
    pub index: u16,
    /// Sub-index.
    #[serde(default)]
    pub subindex: u8,
    /// Value.
    pub value: u32,
    /// Its size in the dictionary, bytes: 1, 2 or 4.
    pub bytes: u8,
}

// One table for both families. The legs of a `HostHoming` follow from the limits of the motor.
/// Homing: by the drive on CAN (CiA 402 mode HM), by the host on a serial line.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Homing {
    /// Homing method of a drive, object 0x6098. An axis on a serial line has none: it searches for its home
    /// switch, and back for the index pulse beside it.
    #[serde(default)]
    pub method: Option<i8>,
    /// Where an axis on a serial line searches for its home switch; towards lower positions where absent.
    #[serde(default)]
    pub direction: Option<Direction>,
    /// Axes home in ascending order of this; equal ones together.
    #[serde(default)]
    pub order: u8,
    /// Whether a search by the host that meets a limit switch goes back across the home switch and begins
    /// again, once; it does where absent.
    #[serde(default)]
    pub reverse_at_limit: Option<bool>,
    /// Motor velocity while searching for the switch, rad/s.
    pub search_velocity: f64,
    /// Motor velocity while searching for the index pulse, rad/s.
    pub zero_velocity: f64,
    /// Motor acceleration, rad/s².
    pub acceleration: f64,
}

/// What stands in for an axis on the benches without hardware.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Emulator {
    /// The plant behind the emulated drive.
    pub plant: Plant,
    /// Motor position at which the emulated axis stands when it is switched on, rad; 20 rad above its
    /// home position where absent.
    pub start: Option<f64>,
    /// Vendor-ID it answers with; the drive's own where absent.
    pub vendor: Option<u32>,
    /// Revision number it answers with; the drive's own where absent.
    pub revision: Option<u32>,
    /// Quadrature counts per revolution that it says its sensor has; the drive's own where absent.
    pub counts_per_revolution: Option<u32>,
    /// Rated torque that it says its motor has, N·m; the drive's own where absent.
    pub rated_torque: Option<f64>,
    /// NFv2 address it answers with; the axis's own where absent.
    pub address: Option<u8>,
    /// What it speaks on its line; what the axis expects where absent.
    pub protocol: Option<Protocol>,
    /// Whether the bus or line lacks it: a drive that never boots.
    pub absent: bool,
}

/// What an emulated robot carries from a point of time on, in place of whatever it carried before.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmulatedPayload {
    /// Counted from when the emulated drives are switched on, s.
    pub at_s: f64,
    /// kg; 0 puts down what it carried.
    pub mass: f64,
    /// The centre of mass in the emulated mechanism's flange frame, m.
    #[serde(default)]
    pub centre: [f64; 3],
}

/// The plants an emulated axis can have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Plant {
    /// Friction, gravity, current limit, switches; masses and friction are nominal.
    #[default]
    Physical,
    /// The inertia and viscous friction of WUT's own emulator, and nothing else.
    Wut,
}

/// One instruction of a program.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Instruction {
    /// Move through joint poses.
    Joints(Joints),
    /// Move the tool along a straight line.
    Line(Line),
    /// Stand until every robot whose program names this meeting has come to it, then go on with them in the same servo
    /// cycle. A name that comes again is another meeting of the same robots.
    Meet(#[schemars(schema_with = "name_schema")] String),
}

/// A name, where an attribute of the field does not reach the schema.
fn name_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({ "type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$" })
}

/// A motion through joint poses.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Joints {
    /// The poses, each as many joint values as the robot has axes, rad.
    pub poses: Vec<Vec<f64>>,
    /// The generator.
    #[serde(default)]
    pub generator: JointGenerator,
    /// Fraction of the greatest joint velocity to use.
    #[serde(default = "defaults::fraction")]
    pub velocity: f64,
    /// Fraction of the greatest joint acceleration to use.
    #[serde(default = "defaults::fraction")]
    pub acceleration: f64,
    /// How long the motion to each pose lasts, s, rounded up to a macrostep; of jerk-limited motions only, and as
    /// short as the limits allow where absent.
    #[serde(default)]
    pub duration: Option<f64>,
}

/// The generators of joint motions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum JointGenerator {
    /// Time-synchronised trapezoid of velocity, continuous through the poses.
    #[default]
    Newsmooth,
    /// Jerk-limited, at rest in each pose.
    JerkLimited,
}

/// A straight line of the tool from where it is.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Where the tool is to go, m, in the robot's base frame.
    pub position: [f64; 3],
    /// Its orientation there as w, x, y, z; unchanged where absent.
    #[serde(default)]
    pub quaternion: Option<[f64; 4]>,
    /// Greatest tool velocity, m/s.
    #[serde(default = "defaults::line_velocity")]
    pub velocity: f64,
    /// Greatest tool acceleration, m/s².
    #[serde(default = "defaults::line_acceleration")]
    pub acceleration: f64,
}

impl Cell {
    /// The JSON schema of a cell file.
    pub fn schema() -> schemars::Schema {
        schemars::schema_for!(Self)
    }

    /// The text of a cell file of these bytes: refused if it is not UTF-8, or longer than [`LARGEST`].
    pub fn text(bytes: &[u8]) -> Result<&str, CellError> {
        document::text(bytes)
    }

    /// Reads and checks the text of a cell file.
    pub fn parse(text: &str) -> Result<Self, CellError> {
        let document = document::parse(text)?;
        let cell: Self = read::read(text, &document)?;
        check::check(&cell).map_err(|(path, problem)| CellError {
            line: locate::line_of(text, &path),
            key: path.to_string(),
            problem,
        })?;
        Ok(cell)
    }
}

mod defaults {
    pub(super) fn macrostep() -> u16 {
        10
    }
    pub(super) fn max_missed_in_row() -> u32 {
        3
    }
    pub(super) fn meeting_timeout_s() -> u32 {
        600
    }
    pub(super) fn seed() -> u64 {
        1
    }
    pub(super) fn bitrate_kbps() -> u32 {
        1000
    }
    pub(super) fn host_node() -> u8 {
        127
    }
    pub(super) fn heartbeat_ms() -> u16 {
        100
    }
    pub(super) fn tolerated_missing() -> u32 {
        5
    }
    pub(super) fn sdo_timeout_ms() -> u32 {
        500
    }
    pub(super) fn boot_timeout_ms() -> u32 {
        2000
    }
    pub(super) fn fraction() -> f64 {
        0.5
    }
    pub(super) fn line_velocity() -> f64 {
        0.2
    }
    pub(super) fn line_acceleration() -> f64 {
        0.5
    }
}
