//! Transmissions of a robot's axes between joint and motor, as text.

use super::tables::Tag;
use controller::robot::{GearAxis, Limits, ScrewAxis};

/// Transmission of one axis between joint and motor.
pub(crate) struct Drive {
    pub(crate) joint: &'static str,
    pub(crate) name: String,
    pub(crate) transmission: String,
    pub(crate) home: String,
    pub(crate) joints: String,
    pub(crate) motors: String,
    pub(crate) tag: Tag,
}

impl Drive {
    /// Parameters that a cell file can set.
    pub(crate) fn numbers(&self) -> [&str; 4] {
        [&self.transmission, &self.home, &self.joints, &self.motors]
    }
}

pub(crate) fn gear(joint: &'static str, name: &str, gear: &GearAxis, tag: Tag) -> Drive {
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

pub(crate) fn screw(joint: &'static str, name: &str, screw: &ScrewAxis, tag: Tag) -> Drive {
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

/// A number with at most six decimal places and a true minus sign.
pub(crate) fn signed(value: f64) -> String {
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

pub(crate) fn range(limits: &Limits) -> String {
    if limits.is_continuous() {
        return "without end".into();
    }
    let [low, high] = [limits.low, limits.high].map(|end| signed((end * 1e4).round() / 1e4));
    format!("{low} … {high}")
}
