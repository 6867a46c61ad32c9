//! Contact with springs: the force table of the laboratory, its stability limits, approach, and other directions.

use servo::LawFault;

use super::*;
use crate::law::Guard;
use crate::robot::{Irb6, Irb6Parameters};

/// Force of a step to 10 N.
struct Step {
    /// Overshoot, %.
    overshoot: f64,
    /// Time after which the force stays within 5 % of 10 N, s; infinite if it does not.
    settling: f64,
    /// Error at the end, N.
    steady: f64,
}

/// A step of the force from 0 to 10 N against a spring, for `seconds`.
fn step(stiffness: f64, tau: f64, delay: usize, seconds: f64) -> Step {
    let mut rig = Rig::new(irp6(), &START, tau, delay, WIDE);
    let environment = spring(rig.tool().translation.z, stiffness, false);
    let mut forces = Vec::new();
    for _ in 0..(seconds / T) as u32 {
        assert_eq!(rig.cycle(&press(10.0), &environment), None);
        forces.push(rig.forces.last().unwrap().z);
        if forces[forces.len() - 1].abs() > 1000.0 {
            break;
        }
    }
    measure(&forces)
}

fn measure(forces: &[f64]) -> Step {
    let beyond = forces.iter().rposition(|force| (force - 10.0).abs() > 0.5);
    let steady = forces[forces.len() - 1] - 10.0;
    Step {
        overshoot: 10.0 * (forces.iter().copied().fold(0.0, f64::max) - 10.0),
        settling: if steady.abs() > 0.5 { f64::INFINITY } else { T * beyond.map_or(0, |at| at + 1) as f64 },
        steady,
    }
}

/// The greatest stiffness, N/m, at which `settles` holds.
fn limit(settles: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (1e3, 1e5);
    while high > 1.01 * low {
        let middle = 0.5 * (low + high);
        *(if settles(middle) { &mut low } else { &mut high }) = middle;
    }
    low
}

#[test]
fn a_step_of_the_force_has_overshoot_and_settling_of_the_force_table() {
    // Both ends of each range of the table: lag 4 ms and one sample of delay, lag 10 ms and two samples. The table rounds the
    // settling times to 0.9, 0.7, 0.65, and 0.8 to 1.6 s.
    type Row = (f64, [f64; 2], [f64; 2]);
    let table: [Row; 4] = [
        (500.0, [0.0, 0.0], [0.93, 0.90]),
        (1000.0, [5.0, 7.0], [0.66, 0.72]),
        (3000.0, [28.0, 34.0], [0.64, 0.67]),
        (10_000.0, [59.0, 76.0], [0.76, 1.64]),
    ];
    for (stiffness, overshoots, settlings) in table {
        for (end, (tau, delay)) in [(0.004, 1), (0.01, 2)].into_iter().enumerate() {
            let found = step(stiffness, tau, delay, 4.0);
            println!(
                "{stiffness} N/m, lag {tau} s: overshoot {:.2} %, settling {:.3} s, steady error {:.4} N",
                found.overshoot, found.settling, found.steady
            );
            // 5 % of the table's value, or half of its last digit.
            let near = (found.overshoot - overshoots[end]).abs() <= (0.05 * overshoots[end]).max(0.5);
            assert!(near, "{stiffness} {tau}: {} %", found.overshoot);
            assert!((found.settling - settlings[end]).abs() < 0.005, "{stiffness} {tau}: {} s", found.settling);
            assert!(found.steady.abs() < 0.01, "{stiffness} {tau}: {} N", found.steady);
        }
    }
}

#[test]
fn the_law_is_stable_up_to_the_stiffness_of_the_force_table() {
    for (tau, delay, told) in [(0.004, 1, 35e3), (0.01, 2, 14e3), (0.02, 2, 8e3)] {
        let found = limit(|stiffness| step(stiffness, tau, delay, 4.2).settling < 4.0);
        println!("lag {tau} s, delay {delay}: a step settles within 4 s up to {found:.0} N/m");
        assert!((found / told - 1.0).abs() < 0.1, "lag {tau}: {found} N/m");
    }
    // Oscillations grow above a stiffness that is somewhat greater.
    let growing = limit(|stiffness| step(stiffness, 0.004, 1, 20.0).settling < 19.9);
    println!("lag 0.004 s, delay 1: oscillations decay up to {growing:.0} N/m");
    assert!((38e3..42e3).contains(&growing), "{growing}");
}

/// The same step with the law at the rate of macrosteps of 10 periods. The law reads the state after 8 periods, as a
/// generator does, and its result is executed in the next macrostep.
fn step_by_macrosteps(stiffness: f64, seconds: f64) -> Step {
    let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
    let environment = spring(rig.tool().translation.z, stiffness, false);
    let [mut from, mut to, mut next] = [rig.displacement; 3];
    let mut forces = Vec::new();
    for cycle in 0..(seconds / T) as u32 {
        rig.sense();
        if cycle % 10 == 0 {
            (from, to) = (to, next);
        }
        if cycle % 10 == 8 {
            rig.displacement = to;
            match rig.shift(&press(10.0), 10.0 * T) {
                LawOutput::Displacement(displacement) => next = displacement,
                // Oscillations have grown beyond the reach of the arm.
                end => {
                    assert_eq!(end, LawOutput::Fault(LawFault::Unreachable));
                    return Step { overshoot: f64::INFINITY, settling: f64::INFINITY, steady: f64::INFINITY };
                }
            }
        }
        let share = f64::from(cycle % 10 + 1) / 10.0;
        rig.displacement = std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]));
        rig.advance(&environment);
        forces.push(rig.forces.last().unwrap().z);
        if forces[forces.len() - 1].abs() > 1000.0 {
            break;
        }
    }
    measure(&forces)
}

#[test]
fn the_same_law_at_macrostep_rate_is_stable_up_to_about_half_of_the_stiffness() {
    let found = limit(|stiffness| step_by_macrosteps(stiffness, 4.2).settling < 4.0);
    println!("at macrostep rate, a step settles within 4 s up to {found:.0} N/m");
    assert!((14e3..22e3).contains(&found), "{found}");
    let Step { overshoot, settling, steady } = step_by_macrosteps(34e3, 4.2);
    assert!(settling.is_infinite(), "{overshoot} {settling} {steady}");
}

#[test]
fn a_guarded_motion_ends_in_a_force_of_velocity_by_reciprocal_damping() {
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[2] = Direction::Guarded { velocity: -0.02, compliance: Compliance::LINEAR };
    let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
    let environment = spring(rig.tool().translation.z - 0.01, 1e4, true);
    (0..2000).for_each(|_| assert_eq!(rig.cycle(&task, &environment), None));
    let force = rig.forces.last().unwrap().z;
    assert!((force - 4.0).abs() < 0.01, "{force}");
    // The same by the planned path, which the law holds back.
    let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
    let start = rig.tool();
    let below = Isometry3::from_parts((start.translation.vector - Vector3::z() * 0.005).into(), start.rotation);
    let below = rig.arm.motors(&rig.arm.inverse(&below, &START).unwrap()).unwrap();
    rig.path_velocity = std::array::from_fn(|axis| (below[axis] - rig.path[axis]) / 0.25);
    task.directions[2] = Direction::Guarded { velocity: 0.0, compliance: Compliance::LINEAR };
    let environment = spring(start.translation.z - 0.002, 1e4, true);
    (0..600).for_each(|_| assert_eq!(rig.cycle(&task, &environment), None));
    let force = rig.forces.last().unwrap().z;
    assert!((force - 4.0).abs() < 0.4, "{force}");
}

#[test]
fn an_approach_under_a_force_has_speed_and_impact_of_the_force_table() {
    for (stiffness, told) in [(1e3, 10.8), (1e4, 26.7)] {
        let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
        let environment = spring(rig.tool().translation.z - 0.04, stiffness, true);
        let (mut speed, mut peak) = (0.0_f64, 0.0_f64);
        for _ in 0..1500 {
            let before = rig.tool().translation.z;
            assert_eq!(rig.cycle(&press(10.0), &environment), None);
            speed = speed.max((before - rig.tool().translation.z) / T);
            peak = peak.max(rig.forces.last().unwrap().z);
        }
        println!("{stiffness} N/m: approach at {speed:.4} m/s, peak {peak:.2} N");
        assert!((speed - 0.05).abs() < 0.0005, "{speed}");
        assert!((peak / told - 1.0).abs() < 0.05, "{stiffness}: {peak} N, told {told} N");
    }
}

#[test]
fn a_touch_ends_the_motion_in_the_cycle_of_its_last_sample() {
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[2] = Direction::Unguarded { velocity: -0.05 };
    for samples in [1, 3] {
        task.guard = Some(Guard { force: 2.0, torque: 1.0, samples });
        let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
        let environment = spring(rig.tool().translation.z - 0.01, 1e4, true);
        let touched = (0..1000).find_map(|cycle| rig.cycle(&task, &environment).map(|end| (cycle, end)));
        let first = rig.forces.iter().position(|force| force.z > 2.0).unwrap();
        assert_eq!(touched, Some((first - 1 + usize::from(samples), LawOutput::Touched)));
    }
}

#[test]
fn held_directions_stay_while_another_yields() {
    let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
    let start = rig.tool();
    let mut task = press(0.0);
    task.directions[2] = Direction::Contact { force: 10.0, compliance: Compliance::LINEAR };
    (0..1000).for_each(|_| assert_eq!(rig.cycle(&task, &|_| Vector3::zeros()), None));
    let end = rig.tool();
    let moved = end.translation.vector - start.translation.vector;
    assert!(moved.z > 0.09, "{moved}");
    assert!(moved.xy().norm() < 1e-4 && start.rotation.angle_to(&end.rotation) < 1e-4, "{moved}");
}

#[test]
fn an_admittance_yields_like_its_spring_and_returns() {
    let mut task = ForceTask::default();
    task.directions[0] = Direction::Admittance { stiffness: 2000.0, compliance: Compliance::LINEAR };
    task.directions[5] = Direction::Admittance { stiffness: 50.0, compliance: Compliance::ROTARY };
    let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
    let start = rig.tool();
    let push = start.rotation * Vector3::x() * 8.0;
    (0..2000).for_each(|_| assert_eq!(rig.cycle(&task, &|_| push), None));
    let moved = (start.inverse() * rig.tool()).translation.vector;
    assert!((moved - Vector3::x() * 8.0 / 2000.0).norm() < 2e-5, "{moved}");
    (0..3000).for_each(|_| assert_eq!(rig.cycle(&task, &|_| Vector3::zeros()), None));
    assert!((start.inverse() * rig.tool()).translation.vector.norm() < 2e-5);
}

#[test]
fn an_admittance_that_begins_displaced_keeps_its_force_and_returns_to_the_path() {
    let (stiffness, turn) = (2000.0, 50.0);
    for axes in [TaskAxes::Tool, TaskAxes::Base] {
        let mut task = ForceTask { axes, ..ForceTask::default() };
        task.directions[2] = Direction::Admittance { stiffness, compliance: Compliance::LINEAR };
        task.directions[5] = Direction::Admittance { stiffness: turn, compliance: Compliance::ROTARY };
        let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
        let start = rig.tool();
        let surface = start.translation.z + 0.002;
        let environment = spring(surface, 2000.0, true);
        (0..2000).for_each(|_| assert_eq!(rig.cycle(&task, &environment), None));
        let settled = rig.forces[rig.forces.len() - 1].z;
        // The tool is not quite upright.
        assert!((settled - 2.0).abs() < 0.2, "{axes:?}: {settled} N");
        // The next motion begins the law again, with the kept displacement.
        for _ in 0..2 {
            rig.began = false;
            for _ in 0..500 {
                assert_eq!(rig.cycle(&task, &environment), None);
                let force = rig.forces[rig.forces.len() - 1].z;
                assert!((force - settled).abs() < 0.01, "{axes:?}: {force} N of {settled} N");
            }
        }
        rig.began = false;
        (0..3000).for_each(|_| assert_eq!(rig.cycle(&task, &|_| Vector3::zeros()), None));
        let rest = start.inverse() * rig.tool();
        assert!(rest.translation.vector.norm() < 2e-5 && rest.rotation.angle() < 1e-4, "{axes:?}: {rest}");
    }
}

#[test]
fn only_a_task_with_a_spring_keeps_its_displacement() {
    let rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
    let compliance = Compliance::LINEAR;
    let directions = [
        (Direction::HELD, false),
        (Direction::Unguarded { velocity: 0.1 }, false),
        (Direction::Guarded { velocity: 0.1, compliance }, false),
        (Direction::Contact { force: 5.0, compliance }, false),
        (Direction::Admittance { stiffness: 1.0, compliance }, true),
    ];
    for (direction, keeps) in directions {
        let mut task = ForceTask::default();
        task.directions[1] = direction;
        assert_eq!(rig.law.keeps(&task.into()), keeps, "{direction:?}");
    }
}

#[test]
fn an_arm_of_five_axes_moves_its_tool_as_the_law_requires() {
    let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), irp6().flange_from_tool().to_owned());
    let start = [0.3, -FRAC_PI_2, 0.1, FRAC_PI_2, 0.4, 0.0, 0.0, 0.0];
    for direction in 0..3 {
        let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
        task.directions[direction] = Direction::Contact { force: 10.0, compliance: Compliance::LINEAR };
        let mut rig = Rig::new(arm.clone(), &start, 0.0, 0, WIDE);
        let from = rig.tool().translation.vector;
        (0..300).for_each(|_| assert_eq!(rig.cycle(&task, &|_| Vector3::zeros()), None));
        let moved = rig.tool().translation.vector - from;
        let along = moved[direction];
        assert!(along > 0.02, "{direction}: {moved}");
        assert!((moved.norm_squared() - along * along).sqrt() < 0.01 * along, "{direction}: {moved}");
    }
}

#[test]
fn limits_of_the_motors_reduce_a_change_and_keep_its_direction() {
    let limits = ForceLimits { speed: [2.0; MAX_AXES], acceleration: [5.0; MAX_AXES], ..WIDE };
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[1] = Direction::Unguarded { velocity: 0.1 };
    task.directions[2] = Direction::Unguarded { velocity: 0.05 };
    let mut rig = Rig::new(irp6(), &START, 0.0, 0, limits);
    let from = rig.tool().translation.vector;
    let mut last = [rig.commanded; 2];
    for _ in 0..500 {
        assert_eq!(rig.cycle(&task, &|_| Vector3::zeros()), None);
        for (axis, c) in rig.commanded.into_iter().enumerate() {
            let [a, b] = last.map(|positions| positions[axis]);
            assert!(((c - b) / T).abs() <= 2.0 + 1e-9);
            assert!(((c - 2.0 * b + a) / (T * T)).abs() <= 5.0 + 1e-6);
        }
        last = [last[1], rig.commanded];
    }
    let moved = rig.tool().translation.vector - from;
    assert!(moved.norm() > 0.005, "{moved}");
    assert!((moved.y - 2.0 * moved.z).abs() < 0.02 * moved.norm() && moved.x.abs() < 0.02 * moved.norm(), "{moved}");
}
