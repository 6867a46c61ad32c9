//! The whole servo cycle over the real drive group and emulated drives: number of frames and calls, order of frames on
//! the bus, and stated delay.

use can::Frame;
use can::candump::Direction;
use kit::cell::{Setup, traced};
use kit::motion::Motion;
use servo::{Macrostep, Order, Phase};

use crate::watch::Watcher;

#[test]
fn a_cycle_sends_once_and_receives_once() {
    let watcher = Watcher::new();
    let watch = watcher.clone();
    let mut setup = Setup::of("irp6");
    setup.port = Box::new(move |port| watch.wrap(port));
    let mut rig = setup.bring_up();
    let axes = rig.scales.len();
    watcher.lock().forget();
    rig.after_cycle = Box::new(move |record| {
        let mut watch = watcher.lock();
        let calls = (watch.sends, watch.receives);
        assert_eq!(calls, (1, 1), "cycle {}, {:?}", record.cycle, record.phase);
        let ids: Vec<u16> = watch.offered.iter().map(id).collect();
        assert_eq!(ids[0], 0x080, "SYNC comes first");
        let set_points: Vec<u16> = (0x201..).take(axes).collect();
        assert_eq!(ids[1..=axes], set_points, "one set-point per axis");
        // The rest is at most a heartbeat and an SDO request.
        let rest = &ids[axes + 1..];
        assert!(rest.len() <= 2 && rest.iter().all(|&id| id > 0x600), "{ids:03x?}");
        watch.forget();
    });
    rig.home();
    let mut motion = Motion::new(&rig, 30.0);
    rig.follow(&mut motion, |rig| rig.phase() == Phase::Moving);
    rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
    let mut motion = Motion::new(&rig, -60.0);
    rig.follow(&mut motion, |rig| rig.last.axis[0].velocity < -40.0);
    rig.order(Order::Disable);
    rig.until(Motion::LONGEST, "off", |rig| rig.servo.is_off());
    assert_eq!(rig.servo.fault(0), None);
}

fn id(frame: &Frame) -> u16 {
    frame.standard_data_id().map_or(0, |id| id.raw())
}

/// The low bytes of statuswords and controlwords in the order of their first occurrence. Those of the drive equal a
/// recording of a real drive.
#[test]
fn a_drive_is_enabled_step_by_step_as_an_epos_was_seen_to() {
    let (mut rig, mut trace) = traced(Setup::one_axis(1));
    while trace.read().is_some() {}
    for _ in 0..3 {
        rig.cycle();
    }
    rig.stand_by(Order::Enable);
    let mut words = Vec::new();
    while let Some(traced) = trace.read() {
        let data = traced.frame.data();
        let word = match (id(&traced.frame), traced.direction) {
            (0x202, Direction::Sent) | (0x182, Direction::Received) => {
                format!("{:03X}#{:02X}", id(&traced.frame), data[0])
            }
            _ => continue,
        };
        if !words.contains(&word) {
            words.push(word);
        }
    }
    let expected = ["202#00", "182#40", "202#06", "182#21", "202#07", "182#23", "202#0F", "182#37"];
    assert_eq!(words, expected);
}

/// Sampled motor positions in each cycle from the command of a step on, and the size of the step.
fn step(distance: f64) -> (Vec<i32>, usize) {
    let mut setup = Setup::one_axis(0);
    let axis = &mut setup.cell.robot[0].axis[0];
    (axis.max_velocity, axis.max_acceleration) = (1e3, 1e6);
    let mut rig = setup.bring_up();
    rig.home();
    for _ in 0..100 {
        rig.cycle();
    }
    let before = rig.last.axis[0];
    let mut position = [0.0; servo::MAX_AXES];
    position[0] = before.commanded + distance;
    rig.order(Order::Move(Macrostep {
        number: 1,
        steps: 1,
        report_at: 1,
        position,
        velocity: [0.0; servo::MAX_AXES],
        acceleration: None,
        torque: [0.0; servo::MAX_AXES],
        law: None,
        continues_law: false,
    }));
    let samples = (0..10).map(|_| {
        rig.cycle();
        assert!((rig.last.axis[0].commanded - position[0]).abs() < 1e-9);
        rig.last.axis[0].increments.0 - before.increments.0
    });
    (samples.collect(), rig.delay)
}

#[test]
fn a_step_shows_in_the_sample_as_many_cycles_later_as_the_group_states() {
    for distance in [0.05, -0.05] {
        let (samples, delay) = step(distance);
        let (before, after) = samples.split_at(delay);
        assert!(before.iter().all(|moved| moved.abs() <= 1), "{samples:?}");
        let moved = f64::from(after[0]) * distance.signum();
        assert!(moved >= 3.0, "{samples:?} after {delay} cycles");
    }
}

#[test]
fn tracking_error_has_no_share_of_velocity_times_period() {
    for distance in [60.0, -60.0] {
        let mut rig = Setup::of("irb6").bring_up();
        rig.home();
        let mut motion = Motion::new(&rig, distance);
        let mut commanded = vec![rig.last; rig.delay + 1];
        let mut errors = [0.0; 5];
        let mut count = 0.0;
        rig.follow(&mut motion, |rig| rig.phase() == Phase::Moving);
        while rig.phase() == Phase::Moving {
            rig.feed(&mut motion);
            rig.cycle();
            commanded.push(rig.last);
            let then = commanded[commanded.len() - 1 - rig.delay];
            let full_speed = 0.99 * Motion::VELOCITY * rig.period.as_secs_f64();
            let step = rig.last.axis[0].commanded - then.axis[0].commanded;
            if step.abs() < full_speed * rig.delay as f64 {
                continue;
            }
            count += 1.0;
            for (axis, error) in errors.iter_mut().enumerate() {
                *error += then.axis[axis].commanded - rig.last.axis[axis].measured;
            }
        }
        let offset = Motion::VELOCITY * rig.period.as_secs_f64();
        assert!(count > 100.0, "{count} cycles at full speed");
        for error in errors {
            let mean = error / count;
            assert!(mean.abs() < 0.2 * offset, "{mean:.4} rad of {offset:.4}");
        }
    }
}
