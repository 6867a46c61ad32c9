//! Data sheets of the IRb-6 and of the IRp-6, on its pedestal and on its track.

use controller::robot::{
    ArmParameters, Irb6Parameters, Irp6Parameters, Irp6TrackParameters, Joints,
};
use nalgebra::Vector3;

use super::Described;
use crate::datasheet::drives::{Drive, gear, screw, signed};
use crate::datasheet::figure::{Other, Part, View};
use crate::datasheet::loops::{BY_DRIVE, Loop};
use crate::datasheet::posture::{outline, range};
use crate::datasheet::tables::{Row, Tag, WUT, WUT_TRACK, row};
use crate::datasheet::views::{Drawing, from_degrees, sector};
use crate::kinematics::Machine;

impl Described for Irb6Parameters {
    fn about(&self) -> &'static str {
        "ASEA IRb-6, five axes. The base frame is on the floor under the column. th2, th3 and th4 are inclinations to \
             the horizontal, positive down, as the drives set them: the upper arm keeps its own while the lower arm \
             moves. The flange's z axis is the roll axis."
    }

    fn symbols(&self) -> &'static [&'static str] {
        &["th1", "th2", "th3", "th4", "th5"]
    }

    fn lengths(&self) -> Vec<Row> {
        let robot = self;
        let mut rows = arm_rows(&robot.arm, "arm.", Tag::PublicCode(WUT), WUT);
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

    fn drives(&self) -> Vec<Drive> {
        let symbols = self.symbols();
        let robot = self;
        arm_drives(&robot.arm, symbols, "arm.", WUT)
    }

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![
                [
                    "`cells/irb6-serial.toml`, column to wrist pitch, by current",
                    "by the servo: cascade, 25 / s, 100 J / s, 10 / s, delay 2",
                    "16.8, 17.2, 15.0, 17.6",
                    "48.2°, 47.5°, 48.0°, 48.1°",
                ],
                [
                    "`cells/irb6-serial.toml`, wrist roll, by pulse width",
                    "by the servo: the same per duty, integral at the motor's pole, delay 2",
                    "15.7",
                    "51.6°",
                ],
                [
                    "`cells/irb6.toml`, axis by axis",
                    BY_DRIVE,
                    "46.4, 48.6, 40.4, 48.9, 52.0",
                    "35.6°, 37.4°, 38.9°, 37.7°, 40.6°",
                ],
            ],
            "cells/irb6-serial.toml --axis column",
        )
    }

    fn drawing<'a>(&'a self, machine: &Machine) -> Drawing<'a> {
        Drawing::Arm(Box::new(arm(machine, &[0.0, -75.0, 12.0, 60.0, 0.0])))
    }
}

impl Described for Irp6Parameters {
    fn about(&self) -> &'static str {
        "WUT IRp-6 on its pedestal, six axes: the arm of the IRb-6 and a hand axis across the roll. The base frame is \
             at the shoulder. th2, th3 and th4 are inclinations to the horizontal, positive down, as the drives set \
             them. The flange's z axis is the hand axis; its origin is where that crosses the roll axis."
    }

    fn symbols(&self) -> &'static [&'static str] {
        &["th1", "th2", "th3", "th4", "th5", "th6"]
    }

    fn lengths(&self) -> Vec<Row> {
        let robot = self;
        arm_rows(
            &robot.arm,
            "arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
            WUT,
        )
    }

    fn drives(&self) -> Vec<Drive> {
        let symbols = self.symbols();
        let code = Tag::PublicCode(WUT);
        let robot = self;
        let mut drives = arm_drives(&robot.arm, symbols, "arm.", WUT);
        // Public code has 92°, where some poses have a second branch.
        drives[3].tag = Tag::Derived("as th4 of irb6, to 90° so that one branch remains");
        drives.push(gear("th6", "hand", &robot.hand, code));
        drives
    }

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![
                [
                    "`cells/irp6.toml`, axis by axis",
                    BY_DRIVE,
                    "46.4, 48.4, 41.3, 46.7, 44.3, 43.9",
                    "36.7°, 37.9°, 40.3°, 39.3°, 40.7°, 43.0°",
                ],
                [
                    "its own law on serial lines, by current; axis by axis",
                    "by the servo: incremental law, delay 1",
                    "53.6, 22.9, 34.8, 21.9, 74.6, 7.3",
                    "47.7°, 78.1°, 77.5°, 82.3°, 8.4°, 52.9°",
                ],
            ],
            "cells/irp6.toml --axis column",
        )
    }

    fn drawing<'a>(&'a self, machine: &Machine) -> Drawing<'a> {
        Drawing::Arm(Box::new(arm(machine, &[0.0, -75.0, 12.0, 0.0, 270.0, 0.0])))
    }
}

impl Described for Irp6TrackParameters {
    fn about(&self) -> &'static str {
        "WUT IRp-6 on a carriage, seven axes: d0 slides along the base frame's y axis, the rest is the IRp-6. The base \
             frame is at the shoulder with the carriage at zero."
    }

    fn symbols(&self) -> &'static [&'static str] {
        &["d0", "th1", "th2", "th3", "th4", "th5", "th6"]
    }

    fn lengths(&self) -> Vec<Row> {
        let robot = self;
        arm_rows(
            &robot.robot.arm,
            "robot.arm.",
            Tag::Derived("the controller's base frame is at the shoulder"),
            WUT_TRACK,
        )
    }

    fn drives(&self) -> Vec<Drive> {
        let symbols = self.symbols();
        let robot = self;
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

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![[
                "`cells/irp6-track.toml`, axis by axis",
                BY_DRIVE,
                "45.7, 45.7, 47.8, 41.1, 45.6, 44.3, 43.9",
                "37.8°, 36.4°, 37.3°, 39.4°, 39.5°, 40.6°, 43.1°",
            ]],
            "cells/irp6-track.toml --axis track",
        )
    }

    fn drawing<'a>(&'a self, machine: &Machine) -> Drawing<'a> {
        Drawing::Arm(Box::new(arm(
            machine,
            &[0.0, 0.0, -75.0, 12.0, 0.0, 270.0, 0.0],
        )))
    }
}

fn arm_rows(arm: &ArmParameters, path: &str, shoulder: Tag, source: &'static str) -> Vec<Row> {
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

/// The arm from its side, and from above with the column turned.
fn arm(machine: &Machine, degrees: &[f64]) -> [View; 2] {
    let on_track = degrees.len() == 7;
    let column = usize::from(on_track);
    let joints = from_degrees(degrees);
    let links = machine.robot.links().map_or_else(Vec::new, |links| links.0);
    let pitch_axis = |joints: &Joints| {
        let placed = links
            .iter()
            .take(column + 4)
            .map(|link| link.placed(joints));
        placed
            .fold(nalgebra::Isometry3::identity(), |base, link| base * link)
            .translation
            .vector
    };
    let area = outline(machine, &joints, [column + 1, column + 2], pitch_axis);
    let radii = area
        .iter()
        .fold([f64::INFINITY, 0.0_f64], |[low, high], point| {
            [low.min(point.x), high.max(point.x)]
        });
    let mut turned = joints;
    turned[column] = 35.0_f64.to_radians();
    let (mut others, mut above) = (Vec::new(), None);
    if on_track {
        turned[0] = 0.9;
        let ends = range(machine, &joints, 0).map(|end| Vector3::y() * end);
        let travel = format!("{:.0}", (ends[1] - ends[0]).norm() * 1e3);
        others.push(Other {
            points: ends.to_vec(),
            part: Part::Solid,
            said: Some(travel),
        });
    } else {
        let ends = range(machine, &joints, column);
        above = Some((sector(radii, ends), "reach of the pitch axis"));
    }
    let side = View {
        title: "From the side",
        joints,
        right: Vector3::x(),
        up: Vector3::z(),
        reach: Some((vec![area], "reach of the pitch axis")),
        others: Vec::new(),
    };
    let top = View {
        title: "From above",
        joints: turned,
        right: Vector3::x(),
        up: Vector3::y(),
        reach: above,
        others,
    };
    [side, top]
}
