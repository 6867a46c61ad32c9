//! Bring-up of a sensor, frame by frame, and its refusals.

use super::bench::*;

/// Writes to the sensor, in order. Each write is read back before the next, unless the node lacks the object.
const TOLD: &[&str] = &[
    // The node produces its heartbeat, and watches the host's where it can.
    "609#2B171000D0070000",
    "609#2316100170177F00",
    // TPDO 3 and 4 off.
    "609#23021801890300C0",
    "609#23031801890400C0",
    // TPDO 1: three forces, counter and status at every SYNC.
    "609#23001801890100C0",
    "609#2F001A0000000000",
    "609#23001A0110010020",
    "609#23001A0210020020",
    "609#23001A0310030020",
    "609#23001A0408070020",
    "609#23001A0508080020",
    "609#2F001A0005000000",
    "609#2F00180201000000",
    "609#2300180189010040",
    // TPDO 2: three torques and the counter.
    "609#23011801890200C0",
    "609#2F011A0000000000",
    "609#23011A0110040020",
    "609#23011A0210050020",
    "609#23011A0310060020",
    "609#23011A0408070020",
    "609#2F011A0004000000",
    "609#2F01180201000000",
    "609#2301180189020040",
];

/// The writes to the sensor during bring-up.
fn told(bench: &Bench) -> Vec<String> {
    bench.sent().into_iter().filter(|frame| frame.starts_with("609#2")).collect()
}

#[test]
fn a_sensor_is_asked_and_told_this_frame_by_frame() {
    let bench = Bench::up();
    let asked: Vec<_> = bench.sent().into_iter().filter(|frame| frame.starts_with("609#")).take(3).collect();
    // Device type, vendor, product.
    assert_eq!(asked, ["609#4000100000000000", "609#4018100100000000", "609#4018100200000000"]);
    assert_eq!(told(&bench), TOLD);
    // All nodes start together. Then SYNC is sent for sixteen samples and the one request before them, and for the latency
    // of the drive.
    let sent = bench.sent();
    let start = sent.iter().position(|frame| frame == "000#0109").unwrap();
    assert_eq!(sent[start - 1], "000#0102");
    assert_eq!(sent[start + 1..], ["080#"; 17]);
}

#[test]
fn an_event_timer_takes_the_place_of_sync() {
    let bench = Bench::up_with(&timed(4));
    let told = told(&bench);
    for write in ["609#2F001802FF000000", "609#2B00180504000000", "609#2F011802FF000000", "609#2B01180504000000"] {
        assert!(told.iter().any(|frame| frame == write), "{write}: {told:?}");
    }
    // The node lacks an inhibit time, which is then not set.
    assert!(told.iter().any(|frame| frame == "609#2B00180300000000"));
    // The SYNC that stands alone, for the latency of the drive.
    assert_eq!(bench.sent().iter().filter(|sent| *sent == "080#").count(), 1);
}

#[test]
fn a_fixed_mapping_is_not_written() {
    let mut config = sensor_config();
    config.pdos[1].mapped = false;
    let told = told(&Bench::up_with(&config));
    assert!(told.iter().any(|frame| frame.starts_with("609#23001A")));
    assert!(!told.iter().any(|frame| frame.starts_with("609#23011A") || frame.starts_with("609#2F011A")), "{told:?}");
    assert!(told.iter().any(|frame| frame == "609#2301180189020040"));
}

#[test]
fn settings_of_the_cell_come_first() {
    let mut config = sensor_config();
    config.configuration.push(setting(0x2200, 1, &[3]));
    let mut bench = Bench::down(&config);
    bench.stores[0].put(0x2200, 1, &[0]);
    assert_eq!(bench.bring_up(), Ok(()));
    assert_eq!(told(&bench)[0], "609#2F00220103000000");
}

#[test]
fn a_sensor_that_is_not_what_the_cell_says_is_refused_before_operation() {
    type Change = fn(&mut Bench);
    let sensor = |error| BringUpError::WrenchNode { node: SENSOR, error };
    let declared = PERIOD;
    let table: [(Change, BringUpError); 7] = [
        (
            |bench| bench.stores[0].put(0x1000, 0, &[0x91, 0x01, 0x02, 0x00]),
            sensor(WrenchError::OfAnotherType { expected: 0x0002_0194, found: 0x0002_0191 }),
        ),
        (
            |bench| bench.stores[0].put(0x1018, 2, &[7, 0, 0, 0]),
            BringUpError::WrongIdentity { node: SENSOR, subindex: 2, expected: 6, found: 7 },
        ),
        (
            |bench| _ = bench.stores[0].objects.remove(&(0x1A01, 1)),
            BringUpError::WriteRefused {
                node: SENSOR,
                object: Object::new(0x1A01, 1),
                written: 0x2000_0410,
                code: 0x0602_0000,
            },
        ),
        (
            |bench| bench.sender.load[2] = -20_000,
            sensor(WrenchError::Saturated { axis: WrenchAxis::Fz, counts: -20_000 }),
        ),
        (|bench| bench.sender.status = 0x04, sensor(WrenchError::Status { status: 4 })),
        (|bench| bench.sender.every = 2, sensor(WrenchError::OfAnotherRate { declared, found: 2 * PERIOD })),
        (
            // Two samples per SYNC.
            |bench| {
                let frames = ["189#000000000000", "289#000000000000"].map(|frame| frame.to_owned() + "01");
                let frames = [frames[0].clone() + "00", frames[1].clone()];
                let next = frames.clone().map(|frame| frame.replace("00000000000001", "00000000000002"));
                bench.sender.frames = Some(frames.into_iter().chain(next).collect());
            },
            sensor(WrenchError::OfAnotherRate { declared, found: PERIOD / 2 }),
        ),
    ];
    for (change, error) in table {
        let mut bench = Bench::down(&sensor_config());
        change(&mut bench);
        assert_eq!(bench.bring_up(), Err(error), "{error}");
        assert_eq!(error.node(), Some(SENSOR));
        assert_eq!(bench.link.read().fault, Some(WrenchFault::NotStarted));
    }
    let mut bench = Bench::down(&timed(4));
    bench.sender.timer = Some(Duration::from_millis(8));
    let (declared, found) = (Duration::from_millis(4), Duration::from_millis(8));
    assert_eq!(bench.bring_up(), Err(sensor(WrenchError::OfAnotherRate { declared, found })));
}

#[test]
fn an_absent_or_silent_sensor_is_an_error_that_names_its_node() {
    let mut bench = Bench::down(&sensor_config());
    bench.stores[0].boots = false;
    bench.stores[0].mute = Some((0x1000, 0));
    let absent = bench.bring_up().unwrap_err();
    let error = |error: BringUpError| match error {
        BringUpError::WrenchNode { node: SENSOR, error } => error,
        other => panic!("{other:?}"),
    };
    assert!(matches!(error(absent), WrenchError::Absent { .. }), "{absent}");
    assert_eq!(
        absent.to_string(),
        "node 9: force sensor: no answer, waited 1.0s: check supply and cable of the sensor, and its node-ID"
    );
    for config in [sensor_config(), timed(2)] {
        let mut bench = Bench::down(&config);
        bench.sender.frames = Some(Vec::new());
        let began = bench.now;
        let silent = bench.bring_up().unwrap_err();
        assert!(matches!(error(silent), WrenchError::NoSamples { .. }), "{silent}");
        assert!(bench.now.since(began) < Duration::from_secs(10));
        // Once the sensor sends, the same bus comes up.
        bench.sender.frames = None;
        assert_eq!(bench.bring_up(), Ok(()));
        assert_eq!(bench.run(3).age, 0);
    }
    let mut bench = Bench::down(&uncounted());
    bench.sender.straddling = true;
    let straddling = bench.bring_up().unwrap_err();
    assert!(matches!(error(straddling), WrenchError::Incomplete { .. }), "{straddling}");
    let mut bench = Bench::down(&sensor_config());
    bench.stores[0].starts = false;
    assert!(matches!(bench.bring_up(), Err(BringUpError::NotOperational { node: SENSOR, .. })));
}

#[test]
fn a_sensor_of_any_type_is_accepted_if_the_cell_names_none() {
    let config = WrenchNodeConfig { identity: None, device_type: None, ..sensor_config() };
    let mut bench = Bench::down(&config);
    bench.stores[0].put(0x1000, 0, &[0; 4]);
    bench.stores[0].objects.remove(&(0x1018, 1));
    assert_eq!(bench.bring_up(), Ok(()));
}

#[test]
fn a_second_bring_up_forgets_samples_and_zero() {
    let mut bench = Bench::up();
    bench.sender.load[0] = 1_000;
    bench.run(3);
    bench.link.zero();
    assert!(close(bench.run(10).wrench, [0.0; 6]));
    assert_eq!(bench.bring_up(), Ok(()));
    let state = bench.run(3);
    assert_eq!((state.zeroing, state.cycle), (Zeroing::None, 2));
    assert!(close(state.wrench, scaled([1_000, 0, 0, 0, 0, 0])));
}
