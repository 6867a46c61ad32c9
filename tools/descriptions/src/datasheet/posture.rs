//! Posture of a robot in a figure: positions of joints, links and legs in the base frame.

use controller::robot::{Joints, Link, LinkKind, Vector};
use nalgebra::{Isometry3, Vector3};

use crate::kinematics::Machine;

/// Shortest link that is drawn, m.
pub(crate) const LEAST: f64 = 1e-4;

/// Number of steps of an outline along one joint.
const STEPS: usize = 48;

/// One joint and the link before it.
pub(crate) struct Stand {
    pub(crate) kind: LinkKind,
    /// The joint's frame.
    pub(crate) frame: Isometry3<f64>,
    pub(crate) axis: Vector3<f64>,
    /// Segments of the link from the previous joint: along the axis of that joint, then across it.
    pub(crate) way: Vec<[Vector3<f64>; 2]>,
    /// Direction of the link after this joint with the joint at zero, and its present direction. `None` if the
    /// direction does not depend on the joint.
    pub(crate) turned: Option<[Vector3<f64>; 2]>,
}

/// All joints of a robot at the given positions.
pub(crate) fn stands(links: &[Link], all: &Joints) -> Vec<Stand> {
    let frames = frames(links, all);
    let mut before = Isometry3::identity();
    let mut axis_before = Vector3::z();
    let mut stands = Vec::new();
    for (number, (link, frame)) in links.iter().zip(&frames).enumerate() {
        let [from, to] = [before, *frame].map(|frame| frame.translation.vector);
        let corner = from + axis_before * axis_before.dot(&(to - from));
        let way = [[from, corner], [corner, to]];
        let axis = frame.rotation * link.axis.as_ref();
        let mut zeroed = *all;
        zeroed[number] = 0.0;
        let behind = |frames: &[Isometry3<f64>]| {
            let end = frames.get(number + 1)?.translation.vector - to;
            let across = end - axis * axis.dot(&end);
            (across.norm() > LEAST).then(|| across.normalize())
        };
        let at_zero = self::frames(links, &zeroed);
        let turned = (link.kind != LinkKind::Prismatic).then(|| Some([behind(&at_zero)?, behind(&frames)?])).flatten();
        stands.push(Stand {
            kind: link.kind,
            frame: *frame,
            axis,
            way: way.into_iter().filter(|[from, to]| (to - from).norm() > LEAST).collect(),
            turned,
        });
        (before, axis_before) = (*frame, axis);
    }
    stands
}

/// Frame of each link in the base frame.
pub(crate) fn frames(links: &[Link], joints: &Joints) -> Vec<Isometry3<f64>> {
    let mut base = Isometry3::identity();
    let mut placed = |link: &Link| {
        base *= link.placed(joints);
        base
    };
    links.iter().map(&mut placed).collect()
}

/// Outline of the area that `point` of the robot reaches by motion of two joints, with all other joints fixed. The
/// outline is correct if motion of the outer joint does not make the limit curves of the inner joint cross.
pub(crate) fn outline(
    machine: &Machine,
    joints: &Joints,
    [outer, inner]: [usize; 2],
    point: impl Fn(&Joints) -> Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let [low, high] = range(machine, joints, outer);
    let along = (0..=STEPS).map(|step| step as f64 / STEPS as f64);
    let edges = [
        along.clone().map(|share| [share, 0.0]).collect::<Vec<_>>(),
        along.clone().map(|share| [1.0, share]).collect(),
        along.clone().rev().map(|share| [share, 1.0]).collect(),
        along.rev().map(|share| [0.0, share]).collect(),
    ];
    let at = |[share, inner_share]: [f64; 2]| {
        let mut posture = *joints;
        posture[outer] = low + (high - low) * share;
        let [low, high] = range(machine, &posture, inner);
        posture[inner] = low + (high - low) * inner_share;
        point(&posture)
    };
    edges.concat().into_iter().map(at).collect()
}

/// Range of one joint with all other joints fixed. Limits of the joint, of its motor and of the legs apply.
pub(crate) fn range(machine: &Machine, joints: &Joints, axis: usize) -> [f64; 2] {
    let limits = machine.robot.joint_limits()[axis];
    let here = joints[axis];
    [limits.low, limits.high].map(|end| {
        let allowed = |position: f64| {
            let mut at = *joints;
            at[axis] = position;
            machine.robot.motors_from_joints(&at).is_ok()
        };
        if allowed(end) {
            return end;
        }
        let (mut good, mut bad) = (here, end);
        for _ in 0..40 {
            let middle = (good + bad) / 2.0;
            if allowed(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        good
    })
}

pub(crate) fn from_degrees(degrees: &[f64]) -> Joints {
    let radians: Vec<_> = degrees.iter().map(|degrees| degrees.to_radians()).collect();
    Vector::new(&radians).expect("no robot has more axes than a vector")
}

/// A ring in the plane of x and y, or a sector of a ring.
pub(crate) fn sector(radii: [f64; 2], [from, to]: [f64; 2]) -> Vec<Vec<Vector3<f64>>> {
    let [inner, outer] = radii.map(|radius| {
        let point = |step| {
            let (sin, cos) = (from + (to - from) * f64::from(step) / 72.0).sin_cos();
            Vector3::new(radius * cos, radius * sin, 0.0)
        };
        (0..=72).map(point).collect::<Vec<_>>()
    });
    if to - from >= std::f64::consts::TAU {
        return vec![outer, inner];
    }
    vec![outer.into_iter().chain(inner.into_iter().rev()).collect()]
}
