//! Data sheet of the RNT.

use controller::robot::{Joints, LegAxis, Limits, RntParameters};
use nalgebra::Vector3;

use super::{Described, Description, Drawing};
use crate::datasheet::drives::{drive, gear, length_at_home, range as span, signed};
use crate::datasheet::figure::{Other, Part, View};
use crate::datasheet::posture::{frames, from_degrees, outline};
use crate::datasheet::tables::{Row, Tag, row};
use crate::kinematics::Machine;

impl Described for RntParameters {
    fn description(&self) -> Description<'_> {
        let nominal = "geometry, drives and limits of the RNT are nominal: none was measured or published";
        let lengths = [
            ("base_radius", "circle on which the legs begin, at 0°, 120°, 240°", self.base_radius),
            ("platform_radius", "circle on which the legs end", self.platform_radius),
            ("wrist_offset", "platform to wrist centre along the central leg", self.wrist_offset),
        ];
        let length = |(name, meaning, value)| row(name, meaning, value, "m", Tag::Nominal);
        let platform =
            [("alpha", "alpha", self.alpha), ("beta", "beta", self.beta), ("rho", "extension", self.extension)];
        let by_legs = |(joint, name, limits)| drive(joint, name, ["by the legs", "", &span(&limits), ""], Tag::Nominal);
        let mut drives: Vec<_> = platform.map(by_legs).into();
        drives.extend(self.legs.iter().enumerate().map(leg_drive));
        let wrist = [("roll", self.roll), ("pitch", self.pitch), ("spin", self.spin)];
        drives.extend(wrist.map(|(joint, axis)| gear(joint, joint, &axis, Tag::Nominal)));
        Description {
            about: "RNT, serial-parallel, six axes: three driven legs around a passive central one hold a platform, \
                    on which a wrist of three axes stands. The joints are alpha, beta and rho, which place the \
                    platform, and the wrist's; the first three motors are the legs. The base frame is in the \
                    universal joint of the central leg.",
            symbols: &["alpha", "beta", "rho", "roll", "pitch", "spin"],
            caution: (*self == Self::nominal()).then_some(nominal),
            title: "Geometry",
            lengths: lengths.map(length).into(),
            drives,
            loops: vec![
                [
                    "`cells/rnt.toml`, by velocity (CSV), axis by axis",
                    "by the servo: proportional, 50 / s, delay 3",
                    "8.4, 8.6, 8.3, 8.6, 8.5, 8.4",
                    "82.3°, 83.0°, 81.5°, 81.1°, 81.9°, 83.1°",
                ],
                [
                    "by torque (CST) instead (figures: column of an IRb-6 so driven)",
                    "by the servo: cascade, two thirds of the gains of the IRb-6, delay 3",
                    "11.2",
                    "47.5°",
                ],
            ],
            example: "cells/rnt.toml --axis leg-1",
            drawing: Drawing::Arm(Box::new(views)),
        }
    }
}

fn leg_drive((number, leg): (usize, &LegAxis)) -> Row {
    let transmission = format!("screw of {} m per turn", signed(leg.lead));
    let home = length_at_home(leg.length_at_home, leg.motor_at_home);
    let motors = span(&Limits { low: leg.motor(leg.length_limits.low), high: leg.motor(leg.length_limits.high) });
    let numbers = [&*transmission, &home, &span(&leg.length_limits), &motors];
    drive(&format!("leg {number}"), &format!("legs[{number}]"), numbers, Tag::Nominal)
}

fn views(machine: &Machine) -> [View; 2] {
    let mut joints: Joints = from_degrees(&[0.0, 15.0, 0.0, 0.0, -40.0, 0.0]);
    joints[2] = 0.95;
    let flange = |joints: &Joints| {
        let pose = machine.robot.forward(joints);
        pose.map_or_else(|_| Vector3::zeros(), |pose| pose.translation.vector)
    };
    let area = outline(machine, &joints, [1, 2], flange);
    let links = machine.robot.links();
    let platform = frames(&links, &joints)[2];
    let legs = machine.leg_ends().unwrap_or_default();
    let legs = legs.map(|[base, end]| [base, (platform * nalgebra::Point3::from(end)).coords]);
    let legs_and_rings = || {
        let beams = legs.iter().map(|ends| Other { points: ends.to_vec(), part: Part::Leg, said: None });
        let rings = [0, 1].map(|end| Other {
            points: [0, 1, 2, 0].map(|leg: usize| legs[leg][end]).into(),
            part: Part::Solid,
            said: None,
        });
        beams.chain(rings).collect::<Vec<_>>()
    };
    let radius = Other {
        said: Some(format!("{:.0}", legs[1][0].norm() * 1e3)),
        points: vec![Vector3::zeros(), legs[1][0]],
        part: Part::Measure,
    };
    let mut side = View::of("From the side", joints, [Vector3::x(), Vector3::z()]);
    side.reach = Some((vec![area], "reach of the wrist centre with alpha at 0"));
    side.others = legs_and_rings();
    let mut above = View::of("From above", joints, [Vector3::x(), Vector3::y()]);
    above.others = legs_and_rings();
    above.others.push(radius);
    [side, above]
}
