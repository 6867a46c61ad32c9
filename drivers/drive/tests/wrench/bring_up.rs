//! What ends the bring-up of a sensor on a serial line.

use super::*;

fn error(result: Result<(), BringUpError>) -> WrenchError {
    match result {
        Err(BringUpError::WrenchLine { error }) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn eight_answers_in_time_end_bring_up() {
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board::new());
    rig.line.board().outbox.extend(b"left over from before");
    assert_eq!(rig.link.read().fault, Some(WrenchFault::NotStarted));
    let began = rig.now;
    assert_eq!(rig.bring_up(), Ok(()));
    // The line is drained and quiet for a period before the first query.
    assert_eq!(rig.line.board().heard[0], (began + PERIOD, b'q'));
    assert_eq!(rig.line.board().heard.len(), 8);
    assert_eq!((rig.link.read().fault, rig.link.read().samples), (None, 0));
}

#[test]
fn a_sensor_that_was_just_switched_on_may_talk_first() {
    for cycles in [1, 10, 400] {
        let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { deaf: true, ..Board::new() });
        for cycle in 0..cycles {
            // Text with gaps of a cycle, in which queries are lost.
            if cycle % 3 != 0 {
                rig.line.board().outbox.extend(b"force sensor ready\r\n");
            }
            assert!(rig.sensor.bring_up(rig.now).is_pending());
            rig.now += PERIOD;
        }
        rig.line.board().deaf = false;
        assert_eq!(rig.bring_up(), Ok(()), "{cycles}");
        assert_eq!(rig.run(3).age, 0);
    }
}

#[test]
fn an_absent_sensor_is_an_error_after_the_boot_time_out() {
    for absent in [Board { deaf: true, ..Board::new() }, Board { full: true, ..Board::new() }] {
        let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), absent);
        let began = rig.now;
        let found = error(rig.bring_up());
        let waited = rig.now.since(began);
        assert_eq!(found, WrenchError::Absent { waited, address: "baud rate" });
        assert_eq!(waited, Duration::from_millis(2_002));
        assert_eq!(
            BringUpError::WrenchLine { error: found }.to_string(),
            "force sensor: no answer, waited 2.0s: check supply and cable of the sensor, and its baud rate"
        );
        assert_eq!(rig.link.read().fault, Some(WrenchFault::NotStarted));
        // Once the sensor is connected, the same driver comes up.
        (rig.line.board().deaf, rig.line.board().full) = (false, false);
        assert_eq!(rig.bring_up(), Ok(()));
    }
}

#[test]
fn another_device_on_the_line_is_an_error() {
    for surplus in [-7, -1, 3] {
        let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { surplus, ..Board::new() });
        let found = error(rig.bring_up());
        assert!(matches!(found, WrenchError::Garbled { bytes: 1.., length: 14 }), "{surplus}: {found:?}");
    }
    // A device that never stops talking.
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board::new());
    let result = (0..10_000).find_map(|_| {
        rig.line.board().outbox.extend([0x55; 5]);
        rig.now += PERIOD;
        match rig.sensor.bring_up(rig.now) {
            Poll::Ready(result) => Some(result),
            Poll::Pending => None,
        }
    });
    assert!(matches!(error(result.unwrap()), WrenchError::Garbled { bytes: 5_000.., .. }));
    assert!(rig.line.board().heard.is_empty());
}

#[test]
fn answers_that_take_longer_than_a_period_are_an_error() {
    for (delay, right) in [(0, true), (1, false), (5, false)] {
        let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { delay, ..Board::new() });
        let result = rig.bring_up();
        match right {
            true => assert_eq!(result, Ok(())),
            false => assert_eq!(error(result), WrenchError::Late { late: 8, answers: 8 }),
        }
    }
}

#[test]
fn calls_of_a_host_that_catches_up_make_no_answer_late() {
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board::new());
    let result = (0..1_000).find_map(|_| {
        rig.now += PERIOD;
        let result = rig.sensor.bring_up(rig.now);
        let under_way: Vec<u8> = rig.line.board().outbox.drain(..).collect();
        for call in 1..=3 {
            let now = rig.now + call * Duration::from_micros(10);
            assert!(result.is_ready() || rig.sensor.bring_up(now).is_pending());
        }
        rig.line.board().outbox.extend(under_way);
        result.is_ready().then_some(result)
    });
    assert_eq!(result, Some(Poll::Ready(Ok(()))));
}

#[test]
fn a_saturated_sensor_is_an_error_before_operation() {
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { load: [0, 0, 1_495, 0, 0, 0], ..Board::new() });
    let found = error(rig.bring_up());
    assert_eq!(found, WrenchError::Saturated { axis: WrenchAxis::Fz, counts: 1_495 });
    assert_eq!(
        found.to_string(),
        "Fz is saturated at 1495 counts: free the tool of contact and load, check the cable of the sensor"
    );
    rig.line.board().load = [0; 6];
    assert_eq!(rig.bring_up(), Ok(()));
}

#[test]
fn a_line_that_is_gone_is_an_error() {
    let mut rig = Rig::with(SerialWrenchConfig::new(PERIOD), Board { gone: true, ..Board::new() });
    assert_eq!(error(rig.bring_up()), WrenchError::Line(LineError::Gone));
}

#[test]
fn what_cannot_work_is_refused_before_a_byte_is_sent() {
    type Change = fn(&mut SerialWrenchConfig);
    let exchange = Duration::from_nanos(1_302_084);
    let cases: [(Change, ConfigError); 8] = [
        (
            |config| config.period = Duration::from_millis(1),
            ConfigError::Period { period: Duration::from_millis(1), exchange },
        ),
        (|config| config.sensor.channels[3].scale = 0.0, ConfigError::Scale { axis: WrenchAxis::Tx, scale: 0.0 }),
        (
            |config| config.sensor.channels[0].scale = f64::INFINITY,
            ConfigError::Scale { axis: WrenchAxis::Fx, scale: f64::INFINITY },
        ),
        (
            |config| config.sensor.channels[5] = Channel { scale: 1.0, range: 0 },
            ConfigError::Range { axis: WrenchAxis::Tz, range: 0 },
        ),
        (
            |config| config.sensor.channels[5] = Channel { scale: 1.0, range: -5 },
            ConfigError::Range { axis: WrenchAxis::Tz, range: -5 },
        ),
        (|config| config.sensor.zero = ZeroMethod::Host { samples: 0 }, ConfigError::ZeroSamples),
        (
            |config| {
                config.sensor.zero = ZeroMethod::Device;
                config.sensor.tolerated_missing = 0;
            },
            ConfigError::BiasGap,
        ),
        (|config| config.sensor.channels[1].scale = 1e300, ConfigError::Scale { axis: WrenchAxis::Fy, scale: 1e300 }),
    ];
    for (change, expected) in cases {
        let mut config = SerialWrenchConfig::new(PERIOD);
        change(&mut config);
        let line = Board::new().shared();
        let refused = SerialWrenchSensor::new(line.clone(), config).err();
        assert_eq!(refused, Some(expected));
        assert!(line.board().heard.is_empty());
    }
    let mut config = SerialWrenchConfig::new(PERIOD);
    config.sensor.channels[2].scale = f64::NAN;
    let refused = SerialWrenchSensor::new(Board::new().shared(), config).err();
    assert!(matches!(refused, Some(ConfigError::Scale { axis: WrenchAxis::Fz, .. })));
    // The exchange takes 1.302 ms: a period of 2 ms carries it, a period of 1 ms does not.
    assert_eq!(SerialWrenchConfig::new(PERIOD).check(), Ok(()));
}
