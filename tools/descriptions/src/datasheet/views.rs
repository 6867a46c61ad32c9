//! Viewing direction and posture for the figure of each robot.

use controller::robot::{ConveyorParameters, GripperParameters, Joints, Vector};
use mrroc::cell::Parameters;
use nalgebra::Vector3;

use super::figure::{Other, Part, View};
use super::posture::{outline, range};
use crate::kinematics::Machine;

/// Names of the joints in the formulas.
pub(super) fn symbols(parameters: &Parameters) -> &'static [&'static str] {
    match parameters {
        Parameters::Irb6(_) => &["th1", "th2", "th3", "th4", "th5"],
        Parameters::Irp6(_) => &["th1", "th2", "th3", "th4", "th5", "th6"],
        Parameters::Irp6Track(_) => &["d0", "th1", "th2", "th3", "th4", "th5", "th6"],
        Parameters::Rnt(_) => &["alpha", "beta", "rho", "roll", "pitch", "spin"],
        Parameters::Polycrank(_) => &["q1", "q2", "q3", "q4", "q5", "q6", "q7"],
        Parameters::Gripper(_) | Parameters::Conveyor(_) => &[],
    }
}

/// Content of the figure of a machine.
pub(super) enum Drawing<'a> {
    Arm(Box<[View; 2]>),
    Gripper(&'a GripperParameters),
    Conveyor(&'a ConveyorParameters),
}

/// Two views of a robot, or the figure of a device.
pub(super) fn drawing(machine: &Machine) -> Drawing<'_> {
    Drawing::Arm(Box::new(match &machine.parameters {
        Parameters::Irb6(_) => arm(machine, &[0.0, -75.0, 12.0, 60.0, 0.0]),
        Parameters::Irp6(_) => arm(machine, &[0.0, -75.0, 12.0, 0.0, 270.0, 0.0]),
        Parameters::Irp6Track(_) => arm(machine, &[0.0, 0.0, -75.0, 12.0, 0.0, 270.0, 0.0]),
        Parameters::Rnt(_) => rnt(machine),
        Parameters::Polycrank(parameters) => {
            let [upper, fore] = parameters.upper_cranks;
            polycrank([(upper.abs() - fore.abs()).abs(), upper.abs() + fore.abs()])
        }
        Parameters::Gripper(gripper) => return Drawing::Gripper(gripper),
        Parameters::Conveyor(conveyor) => return Drawing::Conveyor(conveyor),
    }))
}

/// Views of the arm: from the side, and from above with the column turned.
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

fn rnt(machine: &Machine) -> [View; 2] {
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

/// Views along axis 1, and from the side with the plane of the forearm parallel to the sheet.
fn polycrank(radii: [f64; 2]) -> [View; 2] {
    let joints = from_degrees(&[140.0, -90.0, -50.0, 50.0, -80.0, 130.0, 0.0]);
    let ring = sector(radii, [-std::f64::consts::PI, std::f64::consts::PI]);
    let along = View {
        title: "Along axis 1",
        joints,
        right: -Vector3::y(),
        up: Vector3::x(),
        reach: Some((ring, "reach of axis 3")),
        others: Vec::new(),
    };
    let side = View {
        title: "From the side",
        joints,
        right: Vector3::z(),
        up: Vector3::x(),
        reach: None,
        others: Vec::new(),
    };
    [along, side]
}

fn from_degrees(degrees: &[f64]) -> Joints {
    let radians: Vec<_> = degrees.iter().map(|degrees| degrees.to_radians()).collect();
    Vector::new(&radians).expect("no robot has more axes than a vector")
}

/// A ring in the plane of x and y, or a sector of a ring.
fn sector(radii: [f64; 2], [from, to]: [f64; 2]) -> Vec<Vec<Vector3<f64>>> {
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
