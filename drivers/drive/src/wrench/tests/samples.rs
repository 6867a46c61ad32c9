//! From frames to samples.

use super::bench::*;

const LOAD: [i16; 6] = [1_000, -2_000, 300, 4_000, -5, 19_999];

#[test]
fn the_frames_of_one_sync_are_a_sample_of_the_time_of_that_sync() {
    let mut bench = Bench::up();
    assert_eq!(bench.cycle().age, 0);
    // The drive answers in the first cycle, before the first SYNC.
    let unexpected = bench.bus.counters().unexpected;
    bench.sender.load = LOAD;
    for cycle in 1..=5 {
        let sync = bench.now;
        let state = bench.cycle();
        assert_eq!((state.cycle, state.age, state.fault, state.samples), (cycle, 0, None, cycle));
        assert_eq!(state.sampled, sync);
        let expected = if cycle == 1 { [0.0; 6] } else { scaled(LOAD) };
        assert!(close(state.wrench, expected), "{state:?}");
    }
    // The drive beside the sensor is not disturbed.
    assert_eq!((bench.states[0].increments.0, bench.states[0].fault), (1_000, None));
    assert_eq!(bench.bus.counters().unexpected, unexpected);
}

#[test]
fn counts_of_32_bits_and_ignored_bytes_are_decoded_under_any_identifier() {
    let mut config = sensor_config();
    let field = |subindex, content| WrenchField { object: Object::new(0x2100, subindex), content };
    let [fx, fy, fz, tx, ty, tz] = WrenchAxis::ALL;
    config.pdos = vec![
        pdo(PdoNumber::One, 0x3A0, vec![field(1, Content::I32(fx)), field(2, Content::I32(tz))]),
        pdo(PdoNumber::Two, 0x6A1, vec![field(3, Content::Ignored { bytes: 3 }), field(4, Content::I16(fy))]),
        pdo(PdoNumber::Three, 0x18A, vec![field(5, Content::I32(fz)), field(6, Content::I16(tx))]),
        pdo(PdoNumber::Four, 0x2FE, vec![field(7, Content::I16(ty))]),
    ];
    config.sensor.channels = config.sensor.channels.map(|channel| Channel { range: i32::MAX, ..channel });
    config.sensor.channels[0].scale = -0.5;
    let mut bench = Bench::down(&config);
    for index in [0x1802, 0x1803] {
        bench.stores[0].put(index, 1, &[0; 4]);
        bench.stores[0].put(index, 2, &[254]);
    }
    for index in [0x1A02, 0x1A03] {
        bench.stores[0].put(index, 0, &[0]);
        (1..=2).for_each(|subindex| bench.stores[0].put(index, subindex, &[0; 4]));
    }
    // Fx 65,538, Tz -65,538; Fy 258; Fz -2, Tx -1; Ty 32,767. In any order.
    let frames = ["2FE#FF7F", "6A1#AABBCC0201", "3A0#02000100FEFFFEFF", "18A#FEFFFFFFFFFF"];
    bench.sender.frames = Some(frames.map(ToOwned::to_owned).to_vec());
    assert_eq!(bench.bring_up(), Ok(()));
    bench.cycle();
    let unexpected = bench.bus.counters().unexpected;
    let state = bench.run(3);
    let expected = [-32_769.0, 2.58, -0.02, -0.001, 32.767, -65.538];
    assert!(close(state.wrench, expected), "{state:?}");
    assert_eq!((state.age, bench.bus.counters().unexpected), (0, unexpected));
}

#[test]
fn a_sample_without_its_second_frame_is_no_sample() {
    let mut bench = Bench::up();
    bench.run(3);
    bench.sender.halved = true;
    bench.sender.load = LOAD;
    // The sample of the last SYNC is on its way.
    assert_eq!(bench.cycle().age, 0);
    assert_eq!(bench.cycle().age, 1);
    let state = bench.cycle();
    assert_eq!((state.age, state.wrench), (2, [0.0; 6]));
    bench.sender.halved = false;
    assert_eq!(bench.cycle().fault, Some(WrenchFault::Incomplete { samples: 2 }));
}

#[test]
fn frames_of_two_syncs_make_no_sample() {
    let mut bench = Bench::up();
    bench.run(3);
    bench.sender.frames = Some(vec!["189#E803000000000000".to_owned()]);
    bench.cycle();
    // The forces of one SYNC and the torques of the next have the same counter.
    bench.cycle();
    bench.sender.frames = Some(vec!["289#E8030000000000".to_owned()]);
    bench.cycle();
    let state = bench.cycle();
    assert_eq!((state.age, state.wrench), (3, [0.0; 6]));
}

#[test]
fn frames_with_different_counters_make_no_sample() {
    let mut bench = Bench::up();
    bench.run(3);
    let frames = ["189#E80300000000AA00", "289#E80300000000AB"];
    bench.sender.frames = Some(frames.map(ToOwned::to_owned).to_vec());
    bench.cycle();
    assert_eq!(bench.cycle().age, 1);
    bench.sender.frames = Some(vec!["289#E80300000000AC".to_owned(), "189#E80300000000AC00".to_owned()]);
    bench.cycle();
    let state = bench.cycle();
    assert!(close(state.wrench, scaled([1_000, 0, 0, 1_000, 0, 0])), "{state:?}");
}

/// A load whose forces and torques name the sample.
fn numbered(sample: i16) -> [i16; 6] {
    [sample, 0, 0, sample, 0, 0]
}

/// One cycle after which the sensor measures the next load.
fn numbered_cycle(bench: &mut Bench, sample: &mut i16) -> WrenchState {
    *sample += 1;
    bench.sender.load = numbered(*sample);
    bench.cycle()
}

#[test]
fn torques_of_one_period_and_forces_of_the_next_make_no_sample() {
    let mut bench = Bench::up_with(&uncounted());
    let mut sample = 0;
    let whole = |state: &WrenchState| (state.wrench[0] * 100.0).round() == (state.wrench[3] * 1_000.0).round();
    for _ in 0..5 {
        let state = numbered_cycle(&mut bench, &mut sample);
        assert!(whole(&state) && state.age == 0, "{state:?}");
    }
    // The torques of each sample come after the next SYNC, before the forces of that SYNC.
    bench.sender.straddling = true;
    let states: Vec<_> = (0..5).map(|_| numbered_cycle(&mut bench, &mut sample)).collect();
    assert!(states.iter().all(whole), "{states:?}");
    assert_eq!(states.iter().map(|state| state.age).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert_eq!(states[3].fault, Some(WrenchFault::Incomplete { samples: 2 }));
    // The first period with all its frames is a sample, although the last late frame comes with it.
    bench.sender.straddling = false;
    bench.link.reset_fault();
    numbered_cycle(&mut bench, &mut sample);
    let state = numbered_cycle(&mut bench, &mut sample);
    assert_eq!((whole(&state), state.age, state.fault), (true, 0, None));
}

#[test]
fn a_lost_frame_costs_one_sample_in_any_order_of_the_frames() {
    let frames = ["189#E803000000000000", "289#E8030000000000"].map(ToOwned::to_owned);
    for order in [[0, 1], [1, 0]] {
        for lost in [0, 1] {
            let mut bench = Bench::down(&uncounted());
            let all: Vec<_> = order.iter().map(|&frame| frames[frame].clone()).collect();
            bench.sender.frames = Some(all.clone());
            assert_eq!(bench.bring_up(), Ok(()));
            bench.run(3);
            bench.sender.frames = Some(vec![frames[lost].clone()]);
            bench.cycle();
            bench.sender.frames = Some(all);
            let ages: Vec<_> = (0..3).map(|_| bench.cycle().age).collect();
            assert_eq!(ages, [1, 0, 0], "{order:?}, {lost} alone");
        }
    }
}

#[test]
fn a_counter_that_stays_is_the_same_sample() {
    let mut bench = Bench::up();
    bench.run(3);
    bench.sender.step = 0;
    assert_eq!(bench.cycle().age, 0);
    let ages: Vec<_> = (0..2).map(|_| bench.cycle().age).collect();
    assert_eq!(ages, [1, 2]);
    bench.sender.step = 1;
    assert_eq!(bench.cycle().fault, Some(WrenchFault::Silent { cycles: 3 }));
    // The counter of a byte wraps around.
    let mut bench = Bench::up();
    assert_eq!(bench.run(600).fault, None);
}

#[test]
fn a_sensor_with_an_event_timer_has_the_times_of_reception() {
    for (millis, age) in [(1, [0, 0, 0, 0, 0]), (2, [0, 0, 0, 0, 0]), (10, [0, 1, 2, 3, 4])] {
        let mut bench = Bench::up_with(&timed(millis));
        bench.sender.load = LOAD;
        bench.run(20);
        // The last of the cycles without a sample.
        bench.run_to_sample();
        bench.run(age[4] as usize);
        let ages: Vec<_> = (0..5).map(|_| bench.cycle()).collect();
        assert_eq!(ages.iter().map(|state| state.age).collect::<Vec<_>>(), age, "{millis} ms");
        let state = ages[0];
        assert!(close(state.wrench, scaled(LOAD)));
        // The time of the first frame of the sample.
        let newest = bench.sender_time_before(state.at);
        assert_eq!(state.sampled, newest, "{millis} ms");
    }
}

#[test]
fn frames_that_are_half_a_sample_apart_are_of_two_samples() {
    let mut bench = Bench::up_with(&timed(10));
    bench.run(20);
    bench.mute();
    bench.run(5);
    let before = bench.link.read();
    bench.cycle_with(&["189#E803000000000000"]);
    bench.run(2);
    // Six milliseconds later.
    let state = bench.cycle_with(&["289#E8030000000000"]);
    assert_eq!((state.sampled, state.wrench), (before.sampled, before.wrench));
    bench.run(3);
    bench.cycle_with(&["189#D007000000000000"]);
    bench.cycle();
    let state = bench.cycle_with(&["289#D0070000000000"]);
    assert!(close(state.wrench, scaled([2_000, 0, 0, 2_000, 0, 0])), "{state:?}");
}

#[test]
fn the_mean_of_samples_becomes_the_zero() {
    let mut bench = Bench::up();
    bench.sender.load = LOAD;
    bench.run(3);
    let request = bench.link.zero();
    assert_eq!(bench.cycle().zeroing, Zeroing::UnderWay { request, samples: 0 });
    let state = bench.run(4);
    assert_eq!(state.zeroing, Zeroing::Done { request, samples: 4 });
    assert!(close(state.wrench, [0.0; 6]));
    bench.sender.load = [1_100, -2_000, 300, 4_000, -5, 19_999];
    bench.cycle();
    assert!(close(bench.cycle().wrench, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn a_bus_may_have_a_sensor_alone() {
    let config = sensor_config();
    let mut bench = Bench::of(&config, &[]);
    assert_eq!((bench.bus.axes(), bench.link.read().fault), (0, Some(WrenchFault::NotStarted)));
    assert_eq!(bench.bring_up(), Ok(()));
    bench.sender.load = LOAD;
    let state = bench.run(3);
    assert!(close(state.wrench, scaled(LOAD)));
    assert_eq!((state.age, bench.bus.counters().unexpected), (0, 0));
    let Bench { bus, link, .. } = bench;
    drop(bus);
    assert_eq!((link.read().fault, link.read().measured()), (Some(WrenchFault::Ended), None));
}
