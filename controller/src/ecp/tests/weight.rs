//! Feed-forward of weight by macrosteps.

use nalgebra::Isometry3;

use super::*;
use crate::robot::{Arm, Link, LinkKind, Mass, Weight};

/// The linear joints, each mounted on the previous joint.
pub(super) fn links() -> Vec<Link> {
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let slide = |(joint, axis): (usize, nalgebra::UnitVector3<f64>)| Link {
        name: "slide".into(),
        kind: LinkKind::Prismatic,
        parent_from_link: Isometry3::identity(),
        axis,
        coupling: std::array::from_fn(|factor| f64::from(u8::from(factor == joint))),
        limits: RANGE[joint],
    };
    axes.into_iter().enumerate().map(slide).collect()
}

/// The gantry on its side: the slide behind the lever lifts itself, the next slide and the load.
fn lying() -> Arm {
    let mass = |mass| Mass { mass, ..Mass::default() };
    let masses = [mass(50.0), mass(3.0), mass(2.0)];
    let weight = Weight::new(&Gantry, &masses, mass(1.0), [0.0, 2.0, 0.0]).unwrap();
    Arm::new(Arc::new(Gantry), Pose::identity()).weighing(weight)
}

#[test]
fn every_macrostep_tells_what_holds_the_weight_at_its_end() {
    let mut bench = Bench::of(lying(), 16);
    let task = Task::new().enable().home().run(to(0.3, 1.2, -0.2));
    assert_eq!(bench.run(task), finished(3));
    let mut seen = Vec::new();
    for macrostep in bench.servo.moves() {
        let lever = (macrostep.position[1] / 100.0).asinh();
        let expected = 9.81 * 6.0 / (100.0 * lever.cosh());
        let mut torque = macrostep.torque;
        assert!((torque[1] - expected).abs() < 1e-8, "{torque:?} N·m for {expected} at {lever} m");
        torque[1] = 0.0;
        assert!(torque.iter().all(|t| t.abs() < 1e-12), "{torque:?}");
        seen.push(expected);
    }
    // The torque changes during the motion.
    assert!(seen.len() > 10 && seen[0] > 1.5 * seen[seen.len() - 1]);
}

#[test]
fn a_robot_without_masses_is_fed_no_torque() {
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().run(to(0.3, 1.2, -0.2))), finished(1));
    assert!(bench.servo.moves().count() > 10);
    let torques = |macrostep: &Macrostep| macrostep.torque == [0.0; MAX_AXES];
    assert!(bench.servo.moves().all(torques));
}
