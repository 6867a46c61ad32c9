//! Cycle laws in macrosteps: their parameters, the end of their motions, and touches.

use servo::LawParameters;

use super::*;
use crate::law::{Compliance, Direction, ForceTask};

/// Presses with 10 N along z of the tool.
fn press() -> ForceTask {
    let mut task = ForceTask::default();
    task.directions[2] = Direction::Contact { force: 10.0, compliance: Compliance::LINEAR };
    task
}

fn wait() -> Wait {
    Wait { duration: Duration::from_millis(200) }
}

/// A motion of joint 0 that ends at 0.6 m/s.
fn through() -> JerkLimited {
    JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.5)]).unwrap().ending_at(axis_0(0.6)).unwrap()
}

fn back() -> JerkLimited {
    JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.0)]).unwrap()
}

#[test]
fn every_macrostep_of_a_generator_under_a_law_has_its_parameters() {
    for (motion, count) in
        [(Task::new().run(wait().under(press())), 10), (Task::new().run(to(0.1, 0.0, 0.0).under(press())), 1)]
    {
        let mut bench = Bench::ready();
        assert_eq!(bench.run(motion), finished(1));
        let laws: Vec<_> = bench.servo.moves().map(|macrostep| macrostep.law).collect();
        assert!(laws.len() >= count, "{} macrosteps", laws.len());
        assert!(laws.iter().all(|law| *law == Some(LawParameters::from(press()))));
        // The law ends with its motion.
        assert_eq!(bench.run(Task::new().run(wait())), finished(1));
        assert_eq!(bench.servo.moves().last().unwrap().law, None);
        assert!(!bench.ecp.has_touched());
    }
}

#[test]
fn a_motion_under_a_law_that_ends_at_speed_is_braked_before_the_next_motion() {
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().run(through().under(press())).run(back().under(press()))), finished(2));
    assert!(bench.servo.log.contains(&Order::Stop));
    // Without laws, both motions are one continuous motion.
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().run(through()).run(back())), finished(2));
    assert!(!bench.servo.log.contains(&Order::Stop));
}

#[test]
fn a_touch_ends_the_motion_with_success_and_the_list_goes_on() {
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(to(1.0, 0.0, 0.0).under(press())).run(to(0.0, 0.0, 0.0))).unwrap();
    let (mut count, mut touched) = (0, Vec::new());
    let events = bench.go_on(|bench| {
        count += 1;
        if count == 100 {
            bench.servo.touch();
        }
        touched.push(bench.ecp.has_touched());
    });
    assert_eq!(events, finished(2));
    assert!(touched[..100].iter().all(|touched| !touched) && touched[101..].contains(&true));
    // The next motion begins without the touch, and reaches its end.
    assert!(!bench.ecp.has_touched());
    let met =
        bench.servo.moves().filter(|macrostep| macrostep.law.is_some()).map(|it| it.position[0]).fold(0.0, f64::max);
    assert!(met > 1.0, "{met} rad");
    assert!(bench.servo.moves().any(|macrostep| macrostep.law.is_none()));
    assert!(bench.servo.report.snapshot.commanded[0].abs() < 1e-9);
}

/// Yields like a spring along z of the tool.
fn spring() -> ForceTask {
    let mut task = ForceTask::default();
    task.directions[2] = Direction::Admittance { stiffness: 1000.0, compliance: Compliance::LINEAR };
    task
}

#[test]
fn a_motion_under_the_same_law_plans_from_the_end_of_the_path_that_the_law_has_displaced() {
    let displaced = |law: ForceTask| {
        let mut bench = Bench::ready();
        assert_eq!(bench.run(Task::new().run(to(0.1, 0.0, 0.0).under(law))), finished(1));
        // The law has kept a displacement.
        let snapshot = &mut bench.servo.report.snapshot;
        let end = snapshot.commanded[0];
        snapshot.commanded[0] += 0.3;
        snapshot.displacement[0] = 0.3;
        bench.servo.publish();
        (bench, end)
    };
    // Under the same law, the path goes on, and once only.
    let (mut bench, end) = displaced(spring());
    let before = bench.servo.moves().count();
    assert_eq!(bench.run(Task::new().run(wait().under(spring()))), finished(1));
    let moves: Vec<_> = bench.servo.moves().skip(before).copied().collect();
    assert!(moves.iter().all(|macrostep| (macrostep.position[0] - end).abs() < 1e-12), "{moves:?}");
    assert_eq!(moves.iter().position(|macrostep| macrostep.continues_law), Some(0));
    assert_eq!(moves.iter().filter(|macrostep| macrostep.continues_law).count(), 1);
    // Under another law, and without one, the path begins where the effector stands.
    for other in [Task::new().run(wait().under(press())), Task::new().run(wait())] {
        let (mut bench, end) = displaced(spring());
        let before = bench.servo.moves().count();
        assert_eq!(bench.run(other), finished(1));
        let moves: Vec<_> = bench.servo.moves().skip(before).copied().collect();
        assert!(moves.iter().all(|macrostep| (macrostep.position[0] - end - 0.3).abs() < 1e-12), "{moves:?}");
        assert!(moves.iter().all(|macrostep| !macrostep.continues_law));
    }
}
