//! Transmissions of a robot's axes between joint and motor, as text.

use controller::robot::{ArmParameters, GearAxis, LegAxis, Limits, ScrewAxis};
use mrroc::cell::Parameters;

use super::tables::{Tag, WUT, WUT_TRACK};
use super::views;

/// Transmission of one axis between joint and motor.
pub(super) struct Drive {
    pub(super) joint: &'static str,
    pub(super) name: String,
    pub(super) transmission: String,
    pub(super) home: String,
    pub(super) joints: String,
    pub(super) motors: String,
    pub(super) tag: Tag,
}

impl Drive {
    /// Parameters that a cell file can set.
    pub(super) fn numbers(&self) -> [&str; 4] {
        [&self.transmission, &self.home, &self.joints, &self.motors]
    }
}

/// Transmissions of all axes of a robot.
pub(super) fn axes(parameters: &Parameters) -> Vec<Drive> {
    let symbols = views::symbols(parameters);
    let code = Tag::PublicCode(WUT);
    match parameters {
        Parameters::Irb6(robot) => arm_drives(&robot.arm, symbols, "arm.", WUT),
        Parameters::Irp6(robot) => {
            let mut drives = arm_drives(&robot.arm, symbols, "arm.", WUT);
            // Published code has 92°, at which some poses have a second branch.
            drives[3].tag = Tag::Derived("as th4 of irb6, to 90° so that one branch remains");
            drives.push(gear("th6", "hand", &robot.hand, code));
            drives
        }
        Parameters::Irp6Track(robot) => {
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
        Parameters::Rnt(robot) => {
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
        Parameters::Polycrank(robot) => symbols
            .iter()
            .zip(&robot.axes)
            .enumerate()
            .map(|(axis, (joint, axis_numbers))| {
                gear(joint, &format!("axes[{axis}]"), axis_numbers, Tag::Nominal)
            })
            .collect(),
        Parameters::Gripper(_) | Parameters::Conveyor(_) => Vec::new(),
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

/// A number with at most six decimal places and a true minus sign.
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
