//! Data sheet of a serial arm that a cell describes.

use controller::robot::{ChainJoint, ChainParameters, Joints, LinkKind};
use nalgebra::Vector3;

use super::{Described, Description, Drawing, SYMBOLS};
use crate::datasheet::drives::{drive, range, signed};
use crate::datasheet::figure::View;
use crate::datasheet::tables::{Row, Tag};

impl Described for ChainParameters {
    fn description(&self) -> Description<'_> {
        let count = self.joints.len();
        let home = Joints::new(&self.joints.iter().map(|joint| joint.joint_at_home).collect::<Vec<_>>());
        let home = home.expect("a chain has at most as many joints as a vector");
        let matrix = self.motors_from_joints.as_deref();
        let drives = self.joints.iter().enumerate().map(|(number, joint)| {
            let name = format!("joint[{number}]");
            let motor = match matrix {
                Some(rows) => rows[number]
                    .iter()
                    .enumerate()
                    .filter(|(_, factor)| **factor != 0.0)
                    .fold("m =".to_owned(), |text, (other, factor)| {
                        text + &format!(" {} {}", signed(*factor), SYMBOLS[other])
                    }),
                None => format!("m = {} {}", signed(joint.ratio), SYMBOLS[number]),
            };
            let at_home = format!("{} at m {}", signed(joint.joint_at_home), signed(joint.motor_at_home));
            let limits =
                if joint.kind == LinkKind::Continuous { "without end".to_owned() } else { range(&joint.limits) };
            drive(SYMBOLS[number], &name, [&motor, &at_home, &limits, "as the joint's"], Tag::CellFile)
        });
        Description {
            about: "A serial arm that its cell file describes, joint by joint from the base to the flange.",
            symbols: &SYMBOLS[..count],
            caution: None,
            title: "Joints",
            lengths: self.joints.iter().enumerate().map(frame).collect(),
            drives: drives.collect(),
            loops: Vec::new(),
            example: "CELL --axis AXIS",
            drawing: Drawing::Arm(Box::new(move |_| views(home))),
        }
    }
}

/// The frame of a joint, and what is known of its motion.
fn frame((number, joint): (usize, &ChainJoint)) -> Row {
    let place = joint.parent_from_joint.translation;
    let (roll, pitch, yaw) = joint.parent_from_joint.rotation.euler_angles();
    let three = |numbers: [f64; 3]| numbers.map(signed).join(", ");
    let kind = match joint.kind {
        LinkKind::Revolute => "turns",
        LinkKind::Continuous => "turns without end",
        LinkKind::Prismatic => "slides",
    };
    let meaning = format!(
        "`{}` {kind} about the axis ({}); rpy of its frame in the previous one ({}) rad",
        joint.name,
        three(joint.axis),
        three([roll, pitch, yaw])
    );
    let value = three([place.x, place.y, place.z]);
    Row { cells: format!("`joint[{number}]` | {meaning}; place of the frame | {value} | m"), tag: Tag::CellFile }
}

/// From the side and from above, at home.
fn views(home: Joints) -> [View; 2] {
    let side = View::of("From the side", home, [Vector3::x(), Vector3::z()]);
    let above = View::of("From above", home, [Vector3::x(), Vector3::y()]);
    [side, above]
}
