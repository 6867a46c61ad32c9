//! Speed override, pause and resume.

use super::*;

/// Queues a motion of axis 0 and returns the commanded positions of a run. `act` is called before each cycle.
fn run(mut act: impl FnMut(&Servo, usize)) -> (Rig, Vec<f64>) {
    let mut rig = Rig::standing(1);
    let (mut position, mut velocity) = rig.accelerate(500.0, 3, 40);
    for number in 44..=46 {
        position += velocity * 10.0 * DT - 0.5 * 500.0 * (10.0 * DT).powi(2);
        velocity -= 5.0;
        rig.order(Order::Move(macrostep(number, 10, position, velocity)));
    }
    for cycle in 0..4000 {
        act(&rig.servo, cycle);
        rig.run(1);
        if rig.phase() == Phase::Standing && cycle > 50 {
            break;
        }
    }
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    (rig, positions)
}

#[test]
fn a_pause_at_any_moment_holds_on_the_path_and_a_resumed_motion_ends_at_its_end() {
    let (_, whole) = run(|_, _| {});
    let end = *whole.last().unwrap();
    for begin in (1..140).step_by(11) {
        let (rig, paused) = run(|servo, cycle| match cycle {
            _ if cycle == begin => servo.speed_override().pause(),
            _ if cycle == begin + 1000 => servo.speed_override().resume(),
            _ => {}
        });
        assert_eq!(*paused.last().unwrap(), end, "{begin}");
        assert!(paused.len() > whole.len() + 800, "{begin}: the pause lasts");
        let held = paused.windows(100).filter(|some| some.iter().all(|at| at == &some[0])).count();
        assert!(held > 100, "{begin}: it stands in the pause");
        assert!(paused.windows(2).all(|pair| pair[1] >= pair[0]), "{begin}: it never turns back");
        assert_eq!(rig.servo.counters().macrosteps, 46, "{begin}");
    }
}

#[test]
fn an_override_reports_every_macrostep_once_and_its_rate_in_the_latest_value() {
    let mut rate: f64 = 1.0;
    let (mut rig, slowed) = run(|servo, cycle| {
        servo.speed_override().set([0.37, 0.05, 1.0, 0.5][cycle / 40 % 4]).unwrap();
    });
    let (_, whole) = run(|_, _| {});
    assert!(slowed.len() > whole.len());
    assert_eq!(slowed.last(), whole.last());
    // A report that is not reached says that the macrostep before is complete.
    let complete = |report: &ServoReport| report.snapshot.macrostep - u64::from(!report.reached);
    let numbers: Vec<_> = rig.reports().iter().map(complete).collect();
    assert!((0..=46).all(|number| numbers.contains(&number)), "{numbers:?}");
    assert!(numbers.is_sorted(), "{numbers:?}");
    let latest = rig.link.latest.clone();
    rig.servo.speed_override().set(0.25).unwrap();
    for _ in 0..3000 {
        rig.run(1);
        rate = rate.min(latest.read().rate);
    }
    assert_eq!((rate, latest.read().rate), (0.25, 0.25));
}

#[test]
fn a_stop_in_a_pause_stands_at_once_and_the_motion_is_dropped() {
    let mut rig = Rig::standing(1);
    rig.accelerate(500.0, 3, 50);
    rig.run(60);
    rig.servo.speed_override().pause();
    rig.run(1000);
    assert_eq!(rig.phase(), Phase::Moving);
    rig.order(Order::Stop);
    rig.run(3);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    rig.servo.speed_override().resume();
    rig.run(100);
    assert_eq!(rig.phase(), Phase::Standing);
}

#[test]
fn a_motion_that_begins_in_a_pause_waits_at_its_start() {
    let mut rig = Rig::standing(1);
    rig.servo.speed_override().pause();
    rig.run(1000);
    rig.order(Order::Move(macrostep(1, 10, 0.01, 0.0)));
    rig.run(100);
    assert_eq!(rig.phase(), Phase::Moving);
    assert!(rig.positions(0).iter().all(|&at| at == 0.0));
    rig.servo.speed_override().resume();
    rig.run_until(Phase::Standing);
    assert_eq!(*rig.positions(0).last().unwrap(), 0.01);
}

#[test]
fn a_rate_that_changes_while_the_drives_come_up_does_not_pass_the_override() {
    for cycles in 0..100 {
        let mut rig = Rig::new(1);
        let latest = rig.link.latest.clone();
        rig.world().axes[0].state.homing = Homing::Attained;
        let speed = rig.servo.speed_override();
        speed.pause();
        rig.run(2000);
        assert_eq!((rig.phase(), latest.read().rate), (Phase::Off, 0.0));
        speed.set(0.2).unwrap();
        speed.resume();
        rig.run(cycles);
        rig.order(Order::Enable);
        let rates: Vec<f64> = std::iter::repeat_with(|| {
            rig.run(1);
            latest.read().rate
        })
        .take(2000)
        .collect();
        assert_eq!(rig.phase(), Phase::Standing);
        let most = rates.iter().fold(0.0_f64, |most, rate| most.max(*rate));
        assert_eq!((most, rates.last()), (0.2, Some(&0.2)), "{cycles}");
    }
}
