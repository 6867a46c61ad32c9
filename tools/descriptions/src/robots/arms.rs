//! Data sheets of the IRb-6 and of the IRp-6, on its pedestal and on its track.

use controller::robot::{ArmParameters, Irb6Parameters, Irp6Parameters, Irp6TrackParameters, Joints};
use nalgebra::Vector3;

use super::{Described, Description, Drawing};
use crate::datasheet::drives::{gear, geared, screw, signed};
use crate::datasheet::figure::{Other, Part, View};
use crate::datasheet::posture::{frames, from_degrees, outline, range, sector};
use crate::datasheet::tables::{BY_DRIVE, Row, Tag, WUT, WUT_TRACK, row};
use crate::kinematics::Machine;

impl Described for Irb6Parameters {
    fn description(&self) -> Description<'_> {
        let symbols = &["th1", "th2", "th3", "th4", "th5"];
        let mut lengths = arm_rows(&self.arm, "arm.", Tag::PublicCode(WUT), WUT);
        let meaning = "sine by which a pose's tool axis may lean out of the arm's plane";
        lengths.push(row("tool_plane_tolerance", meaning, self.tool_plane_tolerance, "1", Tag::Nominal));
        Description {
            about: "ASEA IRb-6, five axes. The base frame is on the floor under the column. th2, th3 and th4 are \
                    inclinations to the horizontal, positive down, as the drives set them: the upper arm keeps its \
                    own while the lower arm moves. The flange's z axis is the roll axis.",
            symbols,
            caution: None,
            title: "Geometry",
            lengths,
            drives: arm_drives(&self.arm, symbols, "arm.", WUT),
            loops: vec![
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
            example: "cells/irb6-serial.toml --axis column",
            drawing: drawing(&[0.0, -75.0, 12.0, 60.0, 0.0]),
        }
    }
}

impl Described for Irp6Parameters {
    fn description(&self) -> Description<'_> {
        let symbols = &["th1", "th2", "th3", "th4", "th5", "th6"];
        Description {
            about: "WUT IRp-6 on its pedestal, six axes: the arm of the IRb-6 and a hand axis across the roll. The \
                    base frame is at the shoulder. th2, th3 and th4 are inclinations to the horizontal, positive \
                    down, as the drives set them. The flange's z axis is the hand axis; its origin is where that \
                    crosses the roll axis.",
            symbols,
            caution: None,
            title: "Geometry",
            lengths: arm_rows(&self.arm, "arm.", AT_SHOULDER, WUT),
            drives: irp6_drives(self, symbols, "", WUT),
            loops: vec![
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
            example: "cells/irp6.toml --axis column",
            drawing: drawing(&[0.0, -75.0, 12.0, 0.0, 270.0, 0.0]),
        }
    }
}

impl Described for Irp6TrackParameters {
    fn description(&self) -> Description<'_> {
        let symbols = &["d0", "th1", "th2", "th3", "th4", "th5", "th6"];
        let ratio = Tag::Derived("a screw of 8 mm behind a belt of 2:1; ptroja/mrrocpp, src/robot/irp6ot_m");
        let mut drives = vec![gear("d0", "track", &self.track, ratio)];
        drives.extend(irp6_drives(&self.robot, &symbols[1..], "robot.", WUT_TRACK));
        Description {
            about: "WUT IRp-6 on a carriage, seven axes: d0 slides along the base frame's y axis, the rest is the \
                    IRp-6. The base frame is at the shoulder with the carriage at zero.",
            symbols,
            caution: None,
            title: "Geometry",
            lengths: arm_rows(&self.robot.arm, "robot.arm.", AT_SHOULDER, WUT_TRACK),
            drives,
            loops: vec![[
                "`cells/irp6-track.toml`, axis by axis",
                BY_DRIVE,
                "45.7, 45.7, 47.8, 41.1, 45.6, 44.3, 43.9",
                "37.8°, 36.4°, 37.3°, 39.4°, 39.5°, 40.6°, 43.1°",
            ]],
            example: "cells/irp6-track.toml --axis track",
            drawing: drawing(&[0.0, 0.0, -75.0, 12.0, 0.0, 270.0, 0.0]),
        }
    }
}

const AT_SHOULDER: Tag = Tag::Derived("the controller's base frame is at the shoulder");

fn arm_rows(arm: &ArmParameters, path: &str, shoulder: Tag, source: &'static str) -> Vec<Row> {
    let length = |name, meaning, value, tag| row(&format!("{path}{name}"), meaning, value, "m", tag);
    let code = Tag::PublicCode(source);
    vec![
        length("shoulder_height", "base frame to shoulder axis, up", arm.shoulder_height, shoulder),
        length("lower_arm_length", "shoulder axis to elbow axis", arm.lower_arm_length, code),
        length("upper_arm_length", "elbow axis to pitch axis", arm.upper_arm_length, code),
        length("wrist_length", "pitch axis to flange along the roll axis", arm.wrist_length, code),
    ]
}

fn arm_drives(arm: &ArmParameters, symbols: &[&str], path: &str, source: &'static str) -> Vec<Row> {
    let code = Tag::PublicCode(source);
    let name = |axis: &str| format!("{path}{axis}");
    let roll = format!("m = {} th, turned with the pitch motor", signed(arm.roll.ratio));
    vec![
        gear(symbols[0], &name("column"), &arm.column, code),
        screw(symbols[1], &name("lower_arm"), &arm.lower_arm, code),
        screw(symbols[2], &name("upper_arm"), &arm.upper_arm, code),
        gear(symbols[3], &name("pitch"), &arm.pitch, code),
        geared(symbols[4], &name("roll"), &roll, &arm.roll, code),
    ]
}

fn irp6_drives(robot: &Irp6Parameters, symbols: &[&str], path: &str, source: &'static str) -> Vec<Row> {
    let mut drives = arm_drives(&robot.arm, symbols, &format!("{path}arm."), source);
    // Public code has 92°, where some poses have a second branch.
    drives[3].tag = Tag::Derived("as th4 of irb6, to 90° so that one branch remains");
    drives.push(gear("th6", &format!("{path}hand"), &robot.hand, Tag::PublicCode(source)));
    drives
}

fn drawing(degrees: &'static [f64]) -> Drawing<'static> {
    Drawing::Arm(Box::new(|machine| arm(machine, degrees)))
}

/// The arm from its side, and from above with the column turned.
fn arm(machine: &Machine, degrees: &[f64]) -> [View; 2] {
    let on_track = degrees.len() == 7;
    let column = usize::from(on_track);
    let joints = from_degrees(degrees);
    let links = machine.robot.links();
    let pitch_axis = |joints: &Joints| frames(&links, joints)[column + 3].translation.vector;
    let area = outline(machine, &joints, [column + 1, column + 2], pitch_axis);
    let radii = area.iter().fold([f64::INFINITY, 0.0_f64], |[low, high], point| [low.min(point.x), high.max(point.x)]);
    let mut turned = joints;
    turned[column] = 35.0_f64.to_radians();
    let (mut others, mut above) = (Vec::new(), None);
    if on_track {
        turned[0] = 0.9;
        let ends = range(machine, &joints, 0).map(|end| Vector3::y() * end);
        let travel = format!("{:.0}", (ends[1] - ends[0]).norm() * 1e3);
        others.push(Other { points: ends.to_vec(), part: Part::Solid, said: Some(travel) });
    } else {
        above = Some((sector(radii, range(machine, &joints, column)), "reach of the pitch axis"));
    }
    let mut side = View::of("From the side", joints, [Vector3::x(), Vector3::z()]);
    side.reach = Some((vec![area], "reach of the pitch axis"));
    let mut top = View::of("From above", turned, [Vector3::x(), Vector3::y()]);
    (top.reach, top.others) = (above, others);
    [side, top]
}
