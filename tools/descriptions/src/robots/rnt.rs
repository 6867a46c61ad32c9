//! Data sheet of the RNT.

use controller::robot::{Joints, LegAxis, Limits, RntParameters};
use nalgebra::Vector3;

use super::Described;
use crate::datasheet::drives::{Drive, gear, range as span, signed};
use crate::datasheet::figure::{Other, Part, View};
use crate::datasheet::loops::Loop;
use crate::datasheet::posture::outline;
use crate::datasheet::tables::{Row, Tag, row};
use crate::datasheet::views::{Drawing, from_degrees};
use crate::kinematics::Machine;

impl Described for RntParameters {
    fn about(&self) -> &'static str {
        "RNT, serial-parallel, six axes: three driven legs around a passive central one hold a platform, on which a \
             wrist of three axes stands. The joints are alpha, beta and rho, which place the platform, and the \
             wrist's; the first three motors are the legs. The base frame is in the universal joint of the central \
             leg."
    }

    fn symbols(&self) -> &'static [&'static str] {
        &["alpha", "beta", "rho", "roll", "pitch", "spin"]
    }

    fn caution(&self) -> Option<&'static str> {
        (*self == Self::nominal()).then_some(
            "geometry, drives and limits of the RNT are nominal: none was measured or published",
        )
    }

    fn lengths(&self) -> Vec<Row> {
        let robot = self;
        [
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
        .into()
    }

    fn drives(&self) -> Vec<Drive> {
        let symbols = self.symbols();
        let robot = self;
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
            joints: span(&limits),
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
        for (joint, axis) in [
            ("roll", &robot.roll),
            ("pitch", &robot.pitch),
            ("spin", &robot.spin),
        ] {
            drives.push(gear(joint, joint, axis, Tag::Nominal));
        }
        drives
    }

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![
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
            "cells/rnt.toml --axis leg-1",
        )
    }

    fn drawing<'a>(&'a self, machine: &Machine) -> Drawing<'a> {
        Drawing::Arm(Box::new(views(machine)))
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
        joints: span(&leg.length_limits),
        motors: span(&Limits {
            low: leg.motor(leg.length_limits.low),
            high: leg.motor(leg.length_limits.high),
        }),
        tag: Tag::Nominal,
    }
}

fn views(machine: &Machine) -> [View; 2] {
    let mut joints: Joints = from_degrees(&[0.0, 15.0, 0.0, 0.0, -40.0, 0.0]);
    joints[2] = 0.95;
    let flange = |joints: &Joints| {
        let pose = machine.robot.forward(joints);
        pose.map_or_else(|_| Vector3::zeros(), |pose| pose.translation.vector)
    };
    let area = outline(machine, &joints, [1, 2], flange);
    let links = machine.robot.links().map_or_else(Vec::new, |links| links.0);
    let placed = links.iter().take(3).map(|link| link.placed(&joints));
    let platform = placed.fold(nalgebra::Isometry3::identity(), |base, link| base * link);
    let legs = machine.leg_ends().unwrap_or_default();
    let legs = legs.map(|[base, end]| [base, (platform * nalgebra::Point3::from(end)).coords]);
    let others = || {
        let mut others: Vec<_> = legs
            .iter()
            .map(|ends| Other {
                points: ends.to_vec(),
                part: Part::Leg,
                said: None,
            })
            .collect();
        for end in [0, 1] {
            let ring = [0, 1, 2, 0].map(|leg: usize| legs[leg][end]);
            others.push(Other {
                points: ring.to_vec(),
                part: Part::Solid,
                said: None,
            });
        }
        others
    };
    let radius = Other {
        said: Some(format!("{:.0}", legs[1][0].norm() * 1e3)),
        points: vec![Vector3::zeros(), legs[1][0]],
        part: Part::Measure,
    };
    let side = View {
        title: "From the side",
        joints,
        right: Vector3::x(),
        up: Vector3::z(),
        reach: Some((vec![area], "reach of the wrist centre with alpha at 0")),
        others: others(),
    };
    let above = View {
        title: "From above",
        joints,
        right: Vector3::x(),
        up: Vector3::y(),
        reach: None,
        others: others().into_iter().chain([radius]).collect(),
    };
    [side, above]
}
