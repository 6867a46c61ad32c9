//! The data sheet of a robot: its parameters with unit, tag and source.

use std::fmt::Write as _;

use controller::robot::{
    ArmParameters, GearAxis, Irb6Parameters, Irp6Parameters, Irp6TrackParameters, LegAxis, Limits,
    PolycrankParameters, RntParameters, ScrewAxis,
};

use super::views;
use crate::kinematics::{Machine, Numbers};

/// Where a number comes from.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Tag {
    /// Read in published source.
    PublicCode(&'static str),
    /// Follows from published numbers.
    Derived(&'static str),
    /// Plausible, to be replaced by measurement.
    Nominal,
    /// Another number than the project's own.
    CellFile,
}

const WUT: &str = "ptroja/mrrocpp, src/robot/irp6p_m";
const WUT_TRACK: &str = "ptroja/mrrocpp, src/robot/irp6ot_m";
const GRASPIT: &str = "mzbikows/Graspit, Polycrank";

/// One parameter, under the name it has in a cell file.
struct Row {
    name: String,
    meaning: &'static str,
    value: String,
    unit: &'static str,
    tag: Tag,
}

/// One axis between joint and motor.
struct Drive {
    joint: &'static str,
    name: String,
    transmission: String,
    home: String,
    joints: String,
    motors: String,
    tag: Tag,
}

/// The data sheet in Markdown.
pub(super) fn sheet(machine: &Machine) -> String {
    let mut page = String::new();
    let _ = write!(
        page,
        "# {}\n\n{}\n\n",
        machine.name,
        about(&machine.numbers)
    );
    if let Some(caution) = machine.caution {
        let _ = write!(page, "**Mind:** {caution}.\n\n");
    }
    let _ = write!(page, "![{0}]({0}.svg)\n\n", machine.name);
    geometry(&mut page, machine);
    drives(&mut page, machine);
    footer(&mut page, &machine.name);
    page
}

/// What tags mean, and how the page is made.
pub(super) fn footer(page: &mut String, name: &str) {
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
    pub(super) fn cells(self) -> String {
        match self {
            Self::PublicCode(source) => format!("public code | {source}"),
            Self::Derived(how) => format!("derived | {how}"),
            Self::Nominal => "nominal | none published".into(),
            Self::CellFile => "cell file | set there".into(),
        }
    }
}

fn geometry(page: &mut String, machine: &Machine) {
    let preset = lengths(&preset(&machine.numbers));
    page.push_str("## Geometry\n\n| parameter | meaning | value | unit | tag | source |\n|---|---|--:|---|---|---|\n");
    for (row, known) in lengths(&machine.numbers).into_iter().zip(preset) {
        let tag = if row.value == known.value {
            row.tag
        } else {
            Tag::CellFile
        };
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
    let known = axes(&preset(&machine.numbers));
    page.push_str(
        "## Axes\n\nRanges and homes in rad, of what slides in m; the motor's in rad. Both ranges hold at once.\n\n\
         | joint | parameter | motor and joint | at home | joint range | motor range | tag | source |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for (drive, known) in axes(&machine.numbers).into_iter().zip(known) {
        let same = (
            &drive.transmission,
            &drive.home,
            &drive.joints,
            &drive.motors,
        ) == (
            &known.transmission,
            &known.home,
            &known.joints,
            &known.motors,
        );
        let tag = if same { drive.tag } else { Tag::CellFile };
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

fn about(numbers: &Numbers) -> &'static str {
    match numbers {
        Numbers::Irb6(_) => {
            "ASEA IRb-6, five axes. The base frame is on the floor under the column. th2, th3 and th4 are inclinations to \
             the horizontal, positive down, as the drives set them: the upper arm keeps its own while the lower arm \
             moves. The flange's z axis is the roll axis."
        }
        Numbers::Irp6(_) => {
            "WUT IRp-6 on its pedestal, six axes: the arm of the IRb-6 and a hand axis across the roll. The base frame is \
             at the shoulder. th2, th3 and th4 are inclinations to the horizontal, positive down, as the drives set \
             them. The flange's z axis is the hand axis; its origin is where that crosses the roll axis."
        }
        Numbers::Irp6Track(_) => {
            "WUT IRp-6 on a carriage, seven axes: d0 slides along the base frame's y axis, the rest is the IRp-6. The base \
             frame is at the shoulder with the carriage at zero."
        }
        Numbers::Rnt(_) => {
            "RNT, serial-parallel, six axes: three driven legs around a passive central one hold a platform, on which a \
             wrist of three axes stands. The joints are alpha, beta and rho, which place the platform, and the \
             wrist's; the first three motors are the legs. The base frame is in the universal joint of the central \
             leg."
        }
        Numbers::Polycrank(_) => {
            "Polycrank, seven axes without end: axes 1, 2, 3 are parallel and carry two cranks, axes 4, 5, 6 are parallel, \
             across them, and carry two more, axis 7 rolls the tool. The base frame has axis 1 for z, which is \
             level in the laboratory, 0.925 m above the floor (public code, mzbikows/Graspit)."
        }
    }
}

/// The project's own numbers of that kind.
fn preset(numbers: &Numbers) -> Numbers {
    match numbers {
        Numbers::Irb6(_) => Numbers::Irb6(Irb6Parameters::irb6()),
        Numbers::Irp6(_) => Numbers::Irp6(Irp6Parameters::irp6p()),
        Numbers::Irp6Track(_) => Numbers::Irp6Track(Irp6TrackParameters::irp6ot()),
        Numbers::Rnt(_) => Numbers::Rnt(RntParameters::nominal()),
        Numbers::Polycrank(_) => Numbers::Polycrank(PolycrankParameters::polycrank()),
    }
}

fn lengths(numbers: &Numbers) -> Vec<Row> {
    let row = |name: &str, meaning, value: f64, unit, tag| Row {
        name: name.into(),
        meaning,
        value: value.to_string(),
        unit,
        tag,
    };
    match numbers {
        Numbers::Irb6(robot) => {
            let mut rows = arm(&robot.arm, "arm.", Tag::PublicCode(WUT));
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
        Numbers::Irp6(robot) => arm(
            &robot.arm,
            "arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
        ),
        Numbers::Irp6Track(robot) => arm(
            &robot.robot.arm,
            "robot.arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
        ),
        Numbers::Rnt(robot) => [
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
        Numbers::Polycrank(robot) => {
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
    }
}

fn arm(arm: &ArmParameters, path: &str, shoulder: Tag) -> Vec<Row> {
    let code = Tag::PublicCode(WUT);
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

fn axes(numbers: &Numbers) -> Vec<Drive> {
    let symbols = views::symbols(numbers);
    let code = Tag::PublicCode(WUT);
    match numbers {
        Numbers::Irb6(robot) => arm_drives(&robot.arm, symbols, "arm.", WUT),
        Numbers::Irp6(robot) => {
            let mut drives = arm_drives(&robot.arm, symbols, "arm.", WUT);
            // Public code has 92°, where some poses have a second branch.
            drives[3].tag = Tag::Derived("as th4 of irb6, to 90° so that one branch remains");
            drives.push(gear("th6", "hand", &robot.hand, code));
            drives
        }
        Numbers::Irp6Track(robot) => {
            let ratio = Tag::Derived(
                "a screw of 8 mm behind a belt of 2:1; ptroja/mrrocpp, src/robot/irp6ot_m",
            );
            let mut drives = vec![gear("d0", "track", &robot.track, ratio)];
            drives.extend(arm_drives(
                &robot.robot.arm,
                &symbols[1..],
                "robot.arm.",
                WUT_TRACK,
            ));
            drives[4].tag = Tag::Derived("as th4 of irb6, to 90° so that one branch remains");
            drives.push(gear(
                "th6",
                "robot.hand",
                &robot.robot.hand,
                Tag::PublicCode(WUT_TRACK),
            ));
            drives
        }
        Numbers::Rnt(robot) => {
            let mut drives: Vec<_> = [
                ("alpha", robot.alpha),
                ("beta", robot.beta),
                ("extension", robot.extension),
            ]
            .into_iter()
            .zip(symbols)
            .map(|((name, limits), joint)| Drive {
                joint,
                name: name.into(),
                transmission: "by the legs".into(),
                home: String::new(),
                joints: range(&limits),
                motors: String::new(),
                tag: Tag::Nominal,
            })
            .collect();
            drives.extend(
                robot
                    .legs
                    .iter()
                    .enumerate()
                    .map(|(number, leg)| leg_drive(number, leg)),
            );
            for (joint, gear) in [
                ("roll", &robot.roll),
                ("pitch", &robot.pitch),
                ("spin", &robot.spin),
            ] {
                drives.push(self::gear(joint, joint, gear, Tag::Nominal));
            }
            drives
        }
        Numbers::Polycrank(robot) => symbols
            .iter()
            .zip(&robot.axes)
            .enumerate()
            .map(|(axis, (joint, axis_numbers))| {
                gear(joint, &format!("axes[{axis}]"), axis_numbers, Tag::Nominal)
            })
            .collect(),
    }
}

fn arm_drives(
    arm: &ArmParameters,
    symbols: &[&'static str],
    path: &str,
    source: &'static str,
) -> Vec<Drive> {
    let code = Tag::PublicCode(source);
    let name = |axis: &str| format!("{path}{axis}");
    vec![
        gear(symbols[0], &name("column"), &arm.column, code),
        screw(symbols[1], &name("lower_arm"), &arm.lower_arm, code),
        screw(symbols[2], &name("upper_arm"), &arm.upper_arm, code),
        gear(symbols[3], &name("pitch"), &arm.pitch, code),
        Drive {
            transmission: format!(
                "m = {} th, turned with the pitch motor",
                signed(arm.roll.ratio)
            ),
            ..gear(symbols[4], &name("roll"), &arm.roll, code)
        },
    ]
}

fn gear(joint: &'static str, name: &str, gear: &GearAxis, tag: Tag) -> Drive {
    Drive {
        joint,
        name: name.into(),
        transmission: format!(
            "m = {} {}",
            signed(gear.ratio),
            if joint == "d0" { "d0" } else { "th" }
        ),
        home: format!(
            "{} at m {}",
            signed(gear.joint_at_home),
            signed(gear.motor_at_home)
        ),
        joints: range(&gear.joint_limits),
        motors: range(&gear.motor_limits),
        tag,
    }
}

fn screw(joint: &'static str, name: &str, screw: &ScrewAxis, tag: Tag) -> Drive {
    let ScrewAxis {
        lead,
        squared,
        cosine,
        sine,
        length_at_home,
        motor_at_home,
        ..
    } = *screw;
    Drive {
        joint,
        name: name.into(),
        transmission: format!(
            "screw of {} m per turn, L² = {} {} cos th {} sin th m²",
            signed(lead),
            signed(squared),
            added(cosine),
            added(sine)
        ),
        home: format!(
            "L {} m at m {}",
            signed(length_at_home),
            signed(motor_at_home)
        ),
        joints: range(&screw.joint_limits),
        motors: range(&screw.motor_limits),
        tag,
    }
}

fn leg_drive(number: usize, leg: &LegAxis) -> Drive {
    Drive {
        joint: ["leg 0", "leg 1", "leg 2"][number],
        name: format!("legs[{number}]"),
        transmission: format!("screw of {} m per turn", signed(leg.lead)),
        home: format!(
            "L {} m at m {}",
            signed(leg.length_at_home),
            signed(leg.motor_at_home)
        ),
        joints: range(&leg.length_limits),
        motors: range(&Limits {
            low: leg.motor(leg.length_limits.low),
            high: leg.motor(leg.length_limits.high),
        }),
        tag: Tag::Nominal,
    }
}

/// A number with at most six digits behind the point, and a minus of its own width.
fn signed(value: f64) -> String {
    let rounded = (value * 1e8).round() / 1e8 + 0.0;
    let text = if rounded.abs() < 1.0 {
        rounded.to_string()
    } else {
        ((value * 1e6).round() / 1e6).to_string()
    };
    text.replace('-', "\u{2212}")
}

fn added(value: f64) -> String {
    let sign = if value < 0.0 { '\u{2212}' } else { '+' };
    format!("{sign} {}", signed(value.abs()))
}

fn range(limits: &Limits) -> String {
    if limits.is_continuous() {
        return "without end".into();
    }
    let [low, high] = [limits.low, limits.high].map(|end| signed((end * 1e4).round() / 1e4));
    format!("{low} … {high}")
}
