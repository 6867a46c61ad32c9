//! Zeroing by the host and by the sensor.

use super::*;

/// Cycles until the zeroing ends, with the last state.
fn until_zeroed(rig: &mut Rig, request: ZeroRequest) -> (usize, WrenchState) {
    let ended = |state: &WrenchState| state.zeroing.is_done(request) || state.zeroing.has_failed(request);
    (1..100).map(|cycle| (cycle, rig.cycle())).find(|(_, state)| ended(state)).expect("zeroing ends")
}

#[test]
fn the_mean_of_ten_samples_becomes_the_zero() {
    let mut rig = Rig::up();
    rig.line.board().load = [115, -115, 345, 94, 0, -940 + 1];
    assert_eq!(rig.run(3).zeroing, Zeroing::None);
    let request = rig.link.zero();
    // The sample that is on its way was taken before the request.
    assert_eq!(rig.cycle().zeroing, Zeroing::UnderWay { request, samples: 0 });
    for samples in 1..10 {
        // A load that alternates about 120 counts.
        rig.line.board().load[0] = if samples % 2 == 0 { 110 } else { 130 };
        let state = rig.cycle();
        assert_eq!(state.zeroing, Zeroing::UnderWay { request, samples });
        // The zero before is in force until the new one is known.
        assert!(state.wrench[2] > 29.0);
    }
    let state = rig.cycle();
    assert_eq!(state.zeroing, Zeroing::Done { request, samples: 10 });
    assert!(state.zeroing.is_done(request));
    assert!(state.wrench[1..].iter().all(|component| component.abs() < 1e-12), "{state:?}");
    // The mean of 115, five times 130 and four times 110.
    let mean = (115.0 + 5.0 * 130.0 + 4.0 * 110.0) / 10.0;
    let state = rig.run(2);
    let last = f64::from(rig.line.board().load[0]);
    assert!((state.wrench[0] - (last - mean) * FORCE).abs() < 1e-12, "{state:?}");
    rig.line.board().load = [115, 0, 345, 94, 0, -939];
    let state = rig.run(2);
    assert!((state.wrench[1] - 10.0).abs() < 1e-12, "{state:?}");
}

#[test]
fn samples_that_differ_by_a_tenth_of_the_range_make_no_zero() {
    for (step, channel, axis) in [(74, 0, None), (75, 0, Some(WrenchAxis::Fx)), (-95, 5, Some(WrenchAxis::Tz))] {
        let mut rig = Rig::up();
        rig.line.board().load[2] = 115;
        let before = rig.run(3);
        let request = rig.link.zero();
        rig.run(5);
        rig.line.board().load[channel] = step;
        let (_, state) = until_zeroed(&mut rig, request);
        // 10 % of 747 counts of force, and of 940 counts of torque.
        match axis {
            None => assert_eq!(state.zeroing, Zeroing::Done { request, samples: 10 }),
            Some(axis) => {
                assert_eq!(state.zeroing, Zeroing::Failed { request, cause: ZeroFailure::Unsteady { axis } });
                // The zero before is still in force, and a steady load is zeroed.
                assert_eq!((state.wrench[2], state.fault), (before.wrench[2], None));
                let request = rig.link.zero();
                assert!(until_zeroed(&mut rig, request).1.zeroing.is_done(request));
            }
        }
    }
}

#[test]
fn a_bias_command_without_effect_is_a_failed_zeroing() {
    let mut rig = by_device();
    rig.line.board().load = [115, 0, 0, 0, 0, 0];
    rig.run(3);
    rig.line.board().without_bias = true;
    let request = rig.link.zero();
    let (_, state) = until_zeroed(&mut rig, request);
    let cause = ZeroFailure::NotBiased { axis: WrenchAxis::Fx };
    assert_eq!((state.zeroing, state.fault), (Zeroing::Failed { request, cause }, None));
}

#[test]
fn a_request_during_a_zeroing_begins_it_anew() {
    let mut rig = Rig::up();
    rig.run(3);
    let first = rig.link.zero();
    rig.run(5);
    let second = rig.link.zero();
    let state = rig.cycle();
    assert_eq!(state.zeroing, Zeroing::UnderWay { request: second, samples: 0 });
    let (cycles, state) = until_zeroed(&mut rig, second);
    assert_eq!((cycles, state.zeroing), (10, Zeroing::Done { request: second, samples: 10 }));
    assert!(state.zeroing.is_done(first));
}

#[test]
fn a_request_before_operation_takes_effect_in_the_first_cycle() {
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { load: [115; 6], ..Board::new() });
    let request = rig.link.zero();
    assert_eq!(rig.bring_up(), Ok(()));
    assert_eq!(rig.cycle().zeroing, Zeroing::UnderWay { request, samples: 0 });
    let (cycles, state) = until_zeroed(&mut rig, request);
    assert_eq!(cycles, 10);
    assert!(state.wrench.iter().all(|component| component.abs() < 1e-12));
}

#[test]
fn a_missing_answer_delays_a_zeroing_and_a_fault_ends_it() {
    let mut rig = Rig::up();
    rig.line.board().load = [115; 6];
    rig.run(3);
    let request = rig.link.zero();
    rig.run(3);
    rig.line.board().mute = 1;
    // One cycle for the request, ten samples, and two cycles of the missing answer.
    assert_eq!(until_zeroed(&mut rig, request).0, 13 - 3);
    let kept = rig.run(2);
    let request = rig.link.zero();
    rig.run(3);
    rig.line.board().deaf = true;
    let (_, state) = until_zeroed(&mut rig, request);
    assert_eq!(state.zeroing, Zeroing::Failed { request, cause: ZeroFailure::Interrupted });
    assert!(matches!(state.fault, Some(WrenchFault::Silent { .. })), "{state:?}");
    // During a fault no request is carried out.
    let refused = rig.link.zero();
    assert_eq!(rig.cycle().zeroing, Zeroing::Failed { request: refused, cause: ZeroFailure::Interrupted });
    rig.line.board().deaf = false;
    rig.link.reset_fault();
    let state = rig.run(4);
    assert_eq!((state.fault, state.wrench), (None, kept.wrench));
}

#[test]
fn a_new_bring_up_forgets_the_zero() {
    let mut rig = Rig::up();
    rig.line.board().load = [115; 6];
    rig.run(3);
    let request = rig.link.zero();
    rig.run(1);
    until_zeroed(&mut rig, request);
    assert_eq!(rig.bring_up(), Ok(()));
    let state = rig.run(3);
    assert_eq!(state.zeroing, Zeroing::None);
    assert!((state.wrench[0] - 10.0).abs() < 1e-12);
}

#[test]
fn a_new_bring_up_ends_the_zero_and_a_zeroing_as_failed() {
    let mut rig = Rig::up();
    rig.run(3);
    let first = rig.link.zero();
    assert_eq!(until_zeroed(&mut rig, first).1.zeroed, Some(first));
    let request = rig.link.zero();
    assert!(matches!(rig.run(3).zeroing, Zeroing::UnderWay { .. }));
    // Another node of the bus may need the bring-up: the sensor has no fault.
    assert_eq!(rig.bring_up(), Ok(()));
    let state = rig.run(20);
    assert_eq!((state.fault, state.zeroing), (None, Zeroing::Failed { request, cause: ZeroFailure::Interrupted }));
    assert_eq!(state.zeroed, None);
    let request = rig.link.zero();
    rig.run(1);
    until_zeroed(&mut rig, request);
    assert!(rig.link.read().zeroing.is_done(request));
}

fn by_device() -> Rig {
    let board = Board { load: [115; 6], ..Board::new() };
    Rig::up_with(config(|sensor| sensor.zero = ZeroMethod::Device), board)
}

#[test]
fn the_bias_command_takes_the_place_of_one_query() {
    let mut rig = by_device();
    rig.run(3);
    let request = rig.link.zero();
    rig.line.board().heard.clear();
    let states: Vec<_> = (0..4).map(|_| rig.cycle()).collect();
    let heard: Vec<u8> = rig.line.board().heard.iter().map(|(_, byte)| *byte).collect();
    assert_eq!(heard, b"bqqq");
    assert_eq!(states.iter().map(|state| state.age).collect::<Vec<_>>(), [0, 1, 0, 0]);
    for state in &states[..2] {
        assert_eq!(state.zeroing, Zeroing::UnderWay { request, samples: 0 });
        assert!((state.wrench[0] - 10.0).abs() < 1e-12);
    }
    assert_eq!(states[2].zeroing, Zeroing::Done { request, samples: 0 });
    assert_eq!(states[2].wrench, [0.0; 6]);
}

#[test]
fn a_bias_command_that_the_line_refuses_is_sent_again() {
    let mut rig = by_device();
    rig.run(3);
    let request = rig.link.zero();
    rig.line.board().full = true;
    rig.cycle();
    rig.line.board().full = false;
    assert_eq!(rig.cycle().zeroing, Zeroing::UnderWay { request, samples: 0 });
    let state = rig.run(3);
    assert_eq!((state.zeroing, state.wrench), (Zeroing::Done { request, samples: 0 }, [0.0; 6]));
}

#[test]
fn a_sensor_that_may_have_been_restarted_has_lost_its_own_zero() {
    let mut rig = by_device();
    let request = rig.link.zero();
    rig.run(1);
    until_zeroed(&mut rig, request);
    rig.line.board().deaf = true;
    rig.until_fault();
    rig.line.board().deaf = false;
    rig.line.board().bias = [0; 6];
    rig.link.reset_fault();
    let state = rig.run(3);
    assert_eq!((state.fault, state.zeroing), (None, Zeroing::None));
    // A zero in the host outlasts the same.
    let mut rig = Rig::up();
    let request = rig.link.zero();
    rig.run(1);
    until_zeroed(&mut rig, request);
    rig.line.board().deaf = true;
    rig.until_fault();
    rig.line.board().deaf = false;
    rig.link.reset_fault();
    assert!(rig.run(3).zeroing.is_done(request));
}
