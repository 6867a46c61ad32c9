//! Data sheet of the Polycrank.

use controller::robot::PolycrankParameters;
use nalgebra::Vector3;

use super::{Described, Description, Drawing};
use crate::datasheet::drives::gear;
use crate::datasheet::figure::View;
use crate::datasheet::posture::{from_degrees, sector};
use crate::datasheet::tables::{BY_DRIVE, Tag, row};

impl Described for PolycrankParameters {
    fn description(&self) -> Description<'_> {
        let [a1, a2] = self.upper_cranks;
        let [d1, d2, d3] = self.upper_offsets;
        let [d4, d5, d6] = self.forearm_offsets;
        let lengths = [
            ("upper_cranks[0]", "axis 1 to axis 2; at zero it points along -x", a1),
            ("upper_cranks[1]", "axis 2 to axis 3", a2),
            ("upper_offsets[0]", "joint 1 to joint 2 along axis 1", d1),
            ("upper_offsets[1]", "joint 2 to joint 3 along axis 2", d2),
            ("upper_offsets[2]", "joint 3 to axis 4 along axis 3", d3),
            ("forearm_crank", "axis 4 to axis 5, and axis 5 to axis 6", self.forearm_crank),
            ("forearm_offsets[0]", "joint 4 to joint 5 along axis 4", d4),
            ("forearm_offsets[1]", "joint 5 to joint 6 along axis 5", d5),
            ("forearm_offsets[2]", "joint 6 to axis 7; 0.062 in another published copy", d6),
            ("flange_offset", "flange along axis 7", self.flange_offset),
        ];
        let code = Tag::PublicCode("mzbikows/Graspit, Polycrank");
        let length = |(name, meaning, value)| row(name, meaning, value, "m", code);
        let symbols = &["q1", "q2", "q3", "q4", "q5", "q6", "q7"];
        let axes = symbols.iter().zip(&self.axes).enumerate();
        let drives = axes.map(|(number, (joint, axis))| gear(joint, &format!("axes[{number}]"), axis, Tag::Nominal));
        let nominal = "drives and home of the Polycrank are nominal: none was measured or published";
        let radii = [(a1.abs() - a2.abs()).abs(), a1.abs() + a2.abs()];
        Description {
            about: "Polycrank, seven axes without end: axes 1, 2, 3 are parallel and carry two cranks, axes 4, 5, 6 \
                    are parallel, across them, and carry two more, axis 7 rolls the tool. The base frame has axis 1 \
                    for z, which is level in the laboratory, 0.925 m above the floor (public code, mzbikows/Graspit).",
            symbols,
            caution: (*self == Self::polycrank()).then_some(nominal),
            title: "Geometry",
            lengths: lengths.map(length).into(),
            drives: drives.collect(),
            loops: vec![[
                "`cells/polycrank.toml`, axis by axis",
                BY_DRIVE,
                "42.5, 68.7, 60.9, 59.3, 45.1, 45.3, 45.7",
                "41.6°, 36.5°, 41.0°, 35.0°, 40.1°, 41.9°, 39.5°",
            ]],
            example: "cells/polycrank.toml --axis q1",
            drawing: Drawing::Arm(Box::new(move |_| views(radii))),
        }
    }
}

/// Along axis 1, and from the side with the forearm's plane in the page.
fn views(radii: [f64; 2]) -> [View; 2] {
    let joints = from_degrees(&[140.0, -90.0, -50.0, 50.0, -80.0, 130.0, 0.0]);
    let ring = sector(radii, [-std::f64::consts::PI, std::f64::consts::PI]);
    let mut along = View::of("Along axis 1", joints, [-Vector3::y(), Vector3::x()]);
    along.reach = Some((ring, "reach of axis 3"));
    let side = View::of("From the side", joints, [Vector3::z(), Vector3::x()]);
    [along, side]
}
