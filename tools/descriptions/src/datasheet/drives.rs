//! Transmissions of a robot's axes between joint and motor, as text.

use super::tables::{Row, Tag};
use controller::robot::{GearAxis, Limits, ScrewAxis};

/// Transmission of one axis between joint and motor. `numbers` are the relation of both, the home and the ranges of
/// joint and motor.
pub(crate) fn drive(joint: &str, name: &str, numbers: [&str; 4], tag: Tag) -> Row {
    Row { cells: format!("{joint} | `{name}` | {}", numbers.join(" | ")), tag }
}

pub(crate) fn gear(joint: &str, name: &str, gear: &GearAxis, tag: Tag) -> Row {
    let symbol = if joint == "d0" { "d0" } else { "th" };
    geared(joint, name, &format!("m = {} {symbol}", signed(gear.ratio)), gear, tag)
}

/// A gear with another relation of motor and joint.
pub(crate) fn geared(joint: &str, name: &str, transmission: &str, gear: &GearAxis, tag: Tag) -> Row {
    let [at_joint, at_motor] = [gear.joint_at_home, gear.motor_at_home].map(signed);
    let home = format!("{at_joint} at m {at_motor}");
    let [joints, motors] = [gear.joint_limits, gear.motor_limits].map(|limits| range(&limits));
    drive(joint, name, [transmission, &home, &joints, &motors], tag)
}

pub(crate) fn screw(joint: &str, name: &str, screw: &ScrewAxis, tag: Tag) -> Row {
    let transmission = format!(
        "screw of {} m per turn, L² = {} {} cos th {} sin th m²",
        signed(screw.lead),
        signed(screw.squared),
        added(screw.cosine),
        added(screw.sine)
    );
    let home = length_at_home(screw.length_at_home, screw.motor_at_home);
    let [joints, motors] = [screw.joint_limits, screw.motor_limits].map(|limits| range(&limits));
    drive(joint, name, [&transmission, &home, &joints, &motors], tag)
}

/// Home of a screw: its length, m, and the position of its motor, rad.
pub(crate) fn length_at_home(length: f64, motor: f64) -> String {
    format!("L {} m at m {}", signed(length), signed(motor))
}

/// A number with at most six decimal places and a true minus sign.
pub(crate) fn signed(value: f64) -> String {
    let rounded = (value * 1e8).round() / 1e8 + 0.0;
    let text = if rounded.abs() < 1.0 { rounded.to_string() } else { ((value * 1e6).round() / 1e6).to_string() };
    text.replace('-', "\u{2212}")
}

fn added(value: f64) -> String {
    let sign = if value < 0.0 { '\u{2212}' } else { '+' };
    format!("{sign} {}", signed(value.abs()))
}

pub(crate) fn range(limits: &Limits) -> String {
    if limits.is_continuous() {
        return "without end".into();
    }
    let [low, high] = [limits.low, limits.high].map(|end| signed((end * 1e4).round() / 1e4));
    format!("{low} … {high}")
}
