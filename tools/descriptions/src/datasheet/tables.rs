//! Data sheet of a robot: its parameters with unit, tag and source.

use std::fmt::Write as _;
use std::mem::discriminant;

use controller::robot::ArmParameters;
use mrroc::cell::{Model, Parameters};

use super::drives::{Drive, axes};
use super::loops;
use crate::kinematics::Machine;

/// Source of a number.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Tag {
    /// Read in published source code.
    PublicCode(&'static str),
    /// Derived from published numbers.
    Derived(&'static str),
    /// Plausible value, to be replaced by a measurement.
    Nominal,
    /// A number from the cell file that differs from the default.
    CellFile,
}

pub(super) const WUT: &str = "ptroja/mrrocpp, src/robot/irp6p_m";
pub(super) const WUT_TRACK: &str = "ptroja/mrrocpp, src/robot/irp6ot_m";
const GRIPPER: &str = "ptroja/mrrocpp, src/robot/irp6ot_tfg";
const CONVEYOR: &str = "ptroja/mrrocpp, src/robot/conveyor";
const GRASPIT: &str = "mzbikows/Graspit, Polycrank";

/// One parameter, with its name in a cell file.
struct Row {
    name: String,
    meaning: &'static str,
    value: String,
    unit: &'static str,
    tag: Tag,
}

/// The data sheet in Markdown.
pub(super) fn sheet(machine: &Machine) -> String {
    let mut page = String::new();
    let _ = write!(
        page,
        "# {}\n\n{}\n\n",
        machine.name,
        about(&machine.parameters)
    );
    if let Some(caution) = machine.caution {
        let _ = write!(page, "**Mind:** {caution}.\n\n");
    }
    let _ = write!(page, "![{0}]({0}.svg)\n\n", machine.name);
    geometry(&mut page, machine);
    drives(&mut page, machine);
    loops::section(&mut page, &machine.parameters);
    footer(&mut page, &machine.name);
    page
}

/// Meaning of the tags, and how the page is generated.
fn footer(page: &mut String, name: &str) {
    let _ = write!(
        page,
        "## Tags\n\n\
         - *public code*: read in the published source that is named.\n\
         - *derived*: follows from such numbers by arithmetic.\n\
         - *nominal*: a plausible figure, to be replaced by measurement.\n\n\
         `mrroc datasheet --robot {name}` prints this page, with `--figure` its figure.\n"
    );
}

impl Tag {
    /// Two cells of a table.
    fn cells(self) -> String {
        match self {
            Self::PublicCode(source) => format!("public code | {source}"),
            Self::Derived(how) => format!("derived | {how}"),
            Self::Nominal => "nominal | none published".into(),
            Self::CellFile => "cell file | set there".into(),
        }
    }
}

fn geometry(page: &mut String, machine: &Machine) {
    let presets: Vec<_> = presets(&machine.parameters)
        .map(|preset| lengths(&preset))
        .collect();
    let title = match machine.parameters {
        Parameters::Gripper(_) | Parameters::Conveyor(_) => "Parameters",
        Parameters::Irb6(_)
        | Parameters::Irp6(_)
        | Parameters::Irp6Track(_)
        | Parameters::Rnt(_)
        | Parameters::Polycrank(_) => "Geometry",
    };
    let _ = write!(
        page,
        "## {title}\n\n| parameter | meaning | value | unit | tag | source |\n|---|---|--:|---|---|---|\n"
    );
    for (number, row) in lengths(&machine.parameters).into_iter().enumerate() {
        let known = presets
            .iter()
            .any(|preset| preset[number].value == row.value);
        let tag = if known { row.tag } else { Tag::CellFile };
        let Row {
            name,
            meaning,
            value,
            unit,
            ..
        } = row;
        let _ = writeln!(
            page,
            "| `{name}` | {meaning} | {value} | {unit} | {} |",
            tag.cells()
        );
    }
    page.push('\n');
}

fn drives(page: &mut String, machine: &Machine) {
    let drives = axes(&machine.parameters);
    if drives.is_empty() {
        return;
    }
    let presets: Vec<_> = presets(&machine.parameters)
        .map(|preset| axes(&preset))
        .collect();
    page.push_str(
        "## Axes\n\nRanges and homes in rad, of what slides in m; the motor's in rad. Both ranges hold at once.\n\n\
         | joint | parameter | motor and joint | at home | joint range | motor range | tag | source |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for (number, drive) in drives.into_iter().enumerate() {
        let known = presets
            .iter()
            .any(|preset| preset[number].numbers() == drive.numbers());
        let tag = if known { drive.tag } else { Tag::CellFile };
        let Drive {
            joint,
            name,
            transmission,
            home,
            joints,
            motors,
            ..
        } = drive;
        let _ = writeln!(
            page,
            "| {joint} | `{name}` | {transmission} | {home} | {joints} | {motors} | {} |",
            tag.cells()
        );
    }
    page.push('\n');
}

fn about(parameters: &Parameters) -> &'static str {
    match parameters {
        Parameters::Irb6(_) => {
            "ASEA IRb-6, five axes. The base frame is on the floor under the column. th2, th3 and th4 are inclinations to \
             the horizontal, positive down, as the drives set them: the upper arm keeps its own while the lower arm \
             moves. The flange's z axis is the roll axis."
        }
        Parameters::Irp6(_) => {
            "WUT IRp-6 on its pedestal, six axes: the arm of the IRb-6 and a hand axis across the roll. The base frame is \
             at the shoulder. th2, th3 and th4 are inclinations to the horizontal, positive down, as the drives set \
             them. The flange's z axis is the hand axis; its origin is where that crosses the roll axis."
        }
        Parameters::Irp6Track(_) => {
            "WUT IRp-6 on a carriage, seven axes: d0 slides along the base frame's y axis, the rest is the IRp-6. The base \
             frame is at the shoulder with the carriage at zero."
        }
        Parameters::Rnt(_) => {
            "RNT, serial-parallel, six axes: three driven legs around a passive central one hold a platform, on which a \
             wrist of three axes stands. The joints are alpha, beta and rho, which place the platform, and the \
             wrist's; the first three motors are the legs. The base frame is in the universal joint of the central \
             leg."
        }
        Parameters::Polycrank(_) => {
            "Polycrank, seven axes without end: axes 1, 2, 3 are parallel and carry two cranks, axes 4, 5, 6 are parallel, \
             across them, and carry two more, axis 7 rolls the tool. The base frame has axis 1 for z, which is \
             level in the laboratory, 0.925 m above the floor (public code, mzbikows/Graspit)."
        }
        Parameters::Gripper(_) => {
            "The two-finger gripper of the WUT robots: one motor, two jaws. The opening is a polynomial of the motor's \
             position; past its vertex the jaws close again."
        }
        Parameters::Conveyor(_) => {
            "The conveyor of the WUT laboratory: a belt behind a gear, without limits."
        }
    }
}

/// Default parameters of robots of the same kind.
fn presets(parameters: &Parameters) -> impl Iterator<Item = Parameters> {
    let kind = discriminant(parameters);
    let all = Model::ALL.into_iter().map(Model::parameters);
    all.filter(move |preset| discriminant(preset) == kind)
}

fn lengths(parameters: &Parameters) -> Vec<Row> {
    let row = |name: &str, meaning, value: f64, unit, tag| Row {
        name: name.into(),
        meaning,
        value: value.to_string(),
        unit,
        tag,
    };
    match parameters {
        Parameters::Irb6(robot) => {
            let mut rows = arm(&robot.arm, "arm.", Tag::PublicCode(WUT), WUT);
            let meaning = "sine by which a pose's tool axis may lean out of the arm's plane";
            let tolerance = robot.tool_plane_tolerance;
            rows.push(row(
                "tool_plane_tolerance",
                meaning,
                tolerance,
                "1",
                Tag::Nominal,
            ));
            rows
        }
        Parameters::Irp6(robot) => arm(
            &robot.arm,
            "arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
            WUT,
        ),
        Parameters::Irp6Track(robot) => arm(
            &robot.robot.arm,
            "robot.arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
            WUT_TRACK,
        ),
        Parameters::Rnt(robot) => [
            (
                "base_radius",
                "circle on which the legs begin, at 0°, 120°, 240°",
                robot.base_radius,
            ),
            (
                "platform_radius",
                "circle on which the legs end",
                robot.platform_radius,
            ),
            (
                "wrist_offset",
                "platform to wrist centre along the central leg",
                robot.wrist_offset,
            ),
        ]
        .map(|(name, meaning, value)| row(name, meaning, value, "m", Tag::Nominal))
        .into(),
        Parameters::Polycrank(robot) => {
            let [a1, a2] = robot.upper_cranks;
            let [d1, d2, d3] = robot.upper_offsets;
            let [d4, d5, d6] = robot.forearm_offsets;
            [
                (
                    "upper_cranks[0]",
                    "axis 1 to axis 2; at zero it points along -x",
                    a1,
                ),
                ("upper_cranks[1]", "axis 2 to axis 3", a2),
                ("upper_offsets[0]", "joint 1 to joint 2 along axis 1", d1),
                ("upper_offsets[1]", "joint 2 to joint 3 along axis 2", d2),
                ("upper_offsets[2]", "joint 3 to axis 4 along axis 3", d3),
                (
                    "forearm_crank",
                    "axis 4 to axis 5, and axis 5 to axis 6",
                    robot.forearm_crank,
                ),
                ("forearm_offsets[0]", "joint 4 to joint 5 along axis 4", d4),
                ("forearm_offsets[1]", "joint 5 to joint 6 along axis 5", d5),
                (
                    "forearm_offsets[2]",
                    "joint 6 to axis 7; 0.062 in another published copy",
                    d6,
                ),
                ("flange_offset", "flange along axis 7", robot.flange_offset),
            ]
            .map(|(name, meaning, value)| row(name, meaning, value, "m", Tag::PublicCode(GRASPIT)))
            .into()
        }
        Parameters::Gripper(gripper) => {
            let (motors, openings) = (gripper.motor_limits, gripper.opening_limits);
            let sign = Tag::Derived(
                "ptroja/mrrocpp, src/robot/irp6ot_tfg; with the sign by which its home, 4830 rad, is within its \
                 openings: the code has the other, by which it is not",
            );
            let code = Tag::PublicCode(GRIPPER);
            [
                (
                    "square",
                    "opening per square of the motor's position",
                    gripper.square,
                    "m/rad²",
                ),
                (
                    "linear",
                    "opening per motor position",
                    gripper.linear,
                    "m/rad",
                ),
                (
                    "constant",
                    "opening at motor position 0",
                    gripper.constant,
                    "m",
                ),
                (
                    "motor_at_home",
                    "motor position at home",
                    gripper.motor_at_home,
                    "rad",
                ),
                (
                    "motor_limits.low",
                    "lowest motor position",
                    motors.low,
                    "rad",
                ),
                (
                    "motor_limits.high",
                    "highest motor position",
                    motors.high,
                    "rad",
                ),
                ("opening_limits.low", "narrowest opening", openings.low, "m"),
                ("opening_limits.high", "widest opening", openings.high, "m"),
            ]
            .map(|(name, meaning, value, unit)| {
                let tag = if name == "linear" { sign } else { code };
                row(name, meaning, value, unit, tag)
            })
            .into()
        }
        Parameters::Conveyor(conveyor) => {
            let counter = Tag::Derived("what a 32-bit counter of 4000 counts per turn holds");
            let code = Tag::PublicCode(CONVEYOR);
            let motors = conveyor.motor_limits;
            [
                (
                    "ratio",
                    "motor position per position of the belt",
                    conveyor.ratio,
                    "rad/m",
                    code,
                ),
                (
                    "motor_at_home",
                    "motor position at home",
                    conveyor.motor_at_home,
                    "rad",
                    code,
                ),
                (
                    "motor_limits.low",
                    "lowest motor position",
                    motors.low,
                    "rad",
                    counter,
                ),
                (
                    "motor_limits.high",
                    "highest motor position",
                    motors.high,
                    "rad",
                    counter,
                ),
            ]
            .map(|(name, meaning, value, unit, tag)| row(name, meaning, value, unit, tag))
            .into()
        }
    }
}

fn arm(arm: &ArmParameters, path: &str, shoulder: Tag, source: &'static str) -> Vec<Row> {
    let code = Tag::PublicCode(source);
    [
        (
            "shoulder_height",
            "base frame to shoulder axis, up",
            arm.shoulder_height,
            shoulder,
        ),
        (
            "lower_arm_length",
            "shoulder axis to elbow axis",
            arm.lower_arm_length,
            code,
        ),
        (
            "upper_arm_length",
            "elbow axis to pitch axis",
            arm.upper_arm_length,
            code,
        ),
        (
            "wrist_length",
            "pitch axis to flange along the roll axis",
            arm.wrist_length,
            code,
        ),
    ]
    .map(|(name, meaning, value, tag)| Row {
        name: format!("{path}{name}"),
        meaning,
        value: value.to_string(),
        unit: "m",
        tag,
    })
    .into()
}
