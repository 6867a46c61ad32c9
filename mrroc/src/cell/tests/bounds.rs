//! Numbers that a drive, a search, a loop or an emulator cannot use.

use super::*;

/// The key of the refusal after the first `good` was replaced by `bad`. Checks that the error is at the line of
/// `good`.
fn refusing(text: &str, good: &str, bad: &str) -> String {
    assert!(text.contains(good), "no {good:?}");
    let error = Cell::parse(&text.replacen(good, bad, 1)).expect_err(bad);
    assert_eq!(error.line, line_of(text, good), "{bad}: {error}");
    error.key
}

#[test]
fn what_a_drive_cannot_hold_is_refused_at_its_key() {
    let axis = "robot[0].axis[0]";
    let values = ["0.0", "-1.0", "1e-300", "1e-9", "1e12", "1e300"];
    let keys = [
        ("max_velocity = 250.0", "max_velocity"),
        ("max_acceleration = 1500.0", "max_acceleration"),
        ("following_error = 2.0", "following_error"),
        ("search_velocity = 15.0", "homing.search_velocity"),
        ("zero_velocity = 3.5", "homing.zero_velocity"),
        ("acceleration = 150.0", "homing.acceleration"),
        ("torque_constant = 0.105", "controller.torque_constant"),
        ("max_current = 25.0", "controller.max_current"),
        ("rated_torque = 0.42", "drive.rated_torque"),
        ("position_gain = 25.0", "controller.loop.law.cascade.position_gain"),
        ("velocity_gain = 0.043", "controller.loop.law.cascade.velocity_gain"),
        ("limit = 2.1", "controller.loop.law.cascade.limit"),
    ];
    let mut seen = 0;
    for text in [IRB6, SERIAL] {
        for (good, key) in keys.into_iter().filter(|(good, _)| text.contains(good)) {
            seen += 1;
            let name = good.split(' ').next().unwrap();
            for value in values {
                let found = refusing(text, good, &format!("{name} = {value}"));
                assert_eq!(found, format!("{axis}.{key}"), "{value}");
            }
        }
    }
    assert_eq!(seen, 18, "a key is in none of the examples");
}

#[test]
fn numbers_that_may_be_nothing_are_refused_beyond_all_use() {
    let law = "controller.loop.law.cascade";
    let forward = "controller.loop.feed_forward";
    let keys = [
        ("integral_rate = 10.0", format!("{law}.integral_rate")),
        ("velocity = 0.001", format!("{forward}.velocity")),
        ("acceleration = 0.00043", format!("{forward}.acceleration")),
        ("coulomb = 0.08 }", format!("{forward}.coulomb")),
    ];
    for (good, key) in keys {
        let name = good.split(' ').next().unwrap();
        let given = |value: &str| good.replacen(good.split([' ', '}']).nth(2).unwrap_or(""), value, 1);
        for value in ["-1.0", "1e6", "1e300"] {
            let found = refusing(SERIAL, good, &given(value));
            assert_eq!(found, format!("robot[0].axis[0].{key}"), "{name} = {value}");
        }
        assert!(Cell::parse(&SERIAL.replacen(good, &given("0.0"), 1)).is_ok());
    }
    let constant = "coulomb = 0.08 }";
    let found = refusing(SERIAL, constant, "constant = -1e300, coulomb = 0.08 }");
    assert_eq!(found, format!("robot[0].axis[0].{forward}.constant"));
    let plausible = "max_current = 25.0";
    for key in ["plausible_velocity", "plausible_acceleration"] {
        for value in ["1e-300", "1e300"] {
            let found = refusing(SERIAL, plausible, &format!("{key} = {value}, {plausible}"));
            assert_eq!(found, format!("robot[0].axis[0].controller.{key}"));
        }
    }
}

#[test]
fn a_search_that_would_not_end_is_refused_by_the_time_that_homing_has() {
    // The column's travel is 920 rad.
    let least = 920.0 / 1200.0;
    for text in [IRB6, SERIAL] {
        for (factor, possible) in [(0.99, false), (1.01, true)] {
            let slow = format!("search_velocity = {}", factor * least);
            let parsed = Cell::parse(&text.replacen("search_velocity = 15.0", &slow, 1));
            assert_eq!(parsed.is_ok(), possible, "{slow}");
        }
    }
    // The search of an axis without ends takes two minutes.
    for (slow, possible) in [(0.82, false), (0.84, true)] {
        let slow = format!("search_velocity = {slow}");
        let text = POLYCRANK.replacen("search_velocity = 15.0", &slow, 1);
        let text = text.replacen("zero_velocity = 3.5", "zero_velocity = 0.84", 1);
        assert_eq!(Cell::parse(&text).is_ok(), possible, "{slow}");
    }
}

#[test]
fn a_search_by_the_host_that_would_stop_far_behind_its_switch_is_refused() {
    // 31.4 rad of braking at 150 rad/s² are 97.08 rad/s.
    for (fast, possible) in [("97.0", true), ("97.1", false)] {
        let fast = format!("search_velocity = {fast}");
        let parsed = Cell::parse(&SERIAL.replacen("search_velocity = 15.0", &fast, 1));
        assert_eq!(parsed.is_ok(), possible, "{fast}");
        // A drive brakes by its own settings.
        assert!(Cell::parse(&IRB6.replacen("search_velocity = 15.0", &fast, 1)).is_ok());
    }
}

#[test]
fn every_time_of_a_search_that_is_accepted_can_be_said() {
    let text = SERIAL.replacen("search_velocity = 15.0", "search_velocity = 0.8", 1);
    let text = text.replacen("zero_velocity = 3.5", "zero_velocity = 0.11", 1);
    let cell = Cell::parse(&text).unwrap();
    let robot = &cell.robot[0];
    let limits = robot.kinematics().unwrap().motor_limits()[0];
    let homing = robot.servo_config(0, 0, 0, limits).homing.unwrap();
    assert!(homing.search.timeout.as_secs_f64() < 3600.0, "{homing:?}");
    assert!(homing.zero.timeout.as_secs_f64() < 3600.0, "{homing:?}");
}

#[test]
fn an_emulated_axis_stands_within_its_travel_or_beside_a_limit_switch() {
    let start = |text: &str, start: &str| {
        let given = format!("emulator = {{ start = {start} }}\nmax_velocity");
        Cell::parse(&text.replacen("max_velocity", &given, 1))
    };
    for (text, at, possible) in [
        (IRB6, "-470.0", true),
        (IRB6, "450.0", true),
        (IRB6, "-473.1", true),
        (IRB6, "-473.2", false),
        (IRB6, "1e12", false),
        (IRB6, "1e300", false),
        (POLYCRANK, "1000.0", true),
        (POLYCRANK, "-1000.0", true),
        (POLYCRANK, "1000.1", false),
        (SERIAL, "1e12", false),
    ] {
        match start(text, at) {
            Ok(_) => assert!(possible, "{at}"),
            Err(error) => {
                assert!(!possible, "{error}");
                assert_eq!(error.key, "robot[0].axis[0].emulator.start");
            }
        }
    }
}

#[test]
fn positions_that_a_counter_of_32_bits_does_not_reach_are_refused() {
    // 3.35e6 rad in both directions are 2.13e9 increments at 4000 counts, of 2.147e9.
    let finer = |given: &str| {
        let text = POLYCRANK.replacen("counts_per_revolution = 4000", "counts_per_revolution = 4096", 1);
        Cell::parse(&text.replacen("max_velocity", &format!("{given}max_velocity"), 1))
    };
    let error = finer("").unwrap_err();
    assert_eq!(error.key, "robot[0].axis[0].min_position");
    assert!(error.to_string().contains("a counter of 32 bits reaches at 4096"), "{error}");
    assert!(finer("min_position = -3000.0\nmax_position = 3000.0\n").is_ok());
}

#[test]
fn a_bus_without_axes_and_a_period_beyond_the_drives_are_refused() {
    let bus = "[[bus]]\nname = \"spare\"\ninterface = \"can1\"\n\n[[robot]]";
    let error = Cell::parse(&IRB6.replacen("[[robot]]", bus, 1)).unwrap_err();
    assert_eq!((error.key.as_str(), error.line), ("bus[1]", line_of(IRB6, "[[robot]]")));
    assert!(error.to_string().contains("no axis, no I/O node and no force sensor has bus = \"spare\""), "{error}");
    let bundle = "[[serial]]\nname = \"spare\"\n\n[[robot]]";
    let error = Cell::parse(&IRB6.replacen("[[robot]]", bundle, 1)).unwrap_err();
    assert_eq!(error.key, "serial[0]");
    for period in ["0", "500", "101000", "1000000"] {
        let period = format!("period_us = {period}");
        assert_eq!(refusing(IRB6, "period_us = 2000", &period), "period_us");
    }
}

#[test]
fn a_message_gives_both_ends_of_a_range_and_counts_none_in_words() {
    let cases = [
        (
            "max_missed_in_row = 1000001\nperiod_us = 2000",
            "max_missed_in_row: is 1000001, must be between 1 and 1000000 (periods)",
        ),
        ("robot = []\nperiod_us = 2000", "robot: has no robots, must have at least one"),
        (
            "guardian_ms = 9\nperiod_us = 2000",
            "guardian_ms: has no effect without axis controllers on serial lines, a guarded bus or a watchdog: leave it out",
        ),
    ];
    let head = &IRB6[..IRB6.find("[[robot]]").unwrap()];
    for (given, expected) in cases {
        let text = match given.starts_with("robot") {
            true => head.replacen("period_us = 2000", given, 1),
            false => IRB6.replacen("period_us = 2000", given, 1),
        };
        let error = Cell::parse(&text).unwrap_err().to_string();
        assert!(error.ends_with(expected), "{error}");
    }
    let text = IRB6.replacen("poses = [[0.4, -1.8, 0.1, 0.5, 0.3], [0.0, -1.5, 0.2, 0.8, 0.0]]", "poses = []", 1);
    let error = Cell::parse(&text).unwrap_err().to_string();
    assert!(error.ends_with("joints.poses: has no poses, must have at least one"), "{error}");
    let without = IRB6.replacen("[[bus]]\nname = \"arm\"\nbitrate_kbps = 1000\ninterface = \"can0\"\n", "", 1);
    let error = Cell::parse(&without).unwrap_err().to_string();
    assert!(error.ends_with("bus: has no buses, and no serial lines either, must have at least one"), "{error}");
}

#[test]
fn a_parameter_is_refused_that_its_bytes_do_not_hold() {
    let given = |value: &str, bytes: u8| {
        let parameter =
            format!("drive = {{ parameter = [{{ index = 0x6081, value = {value}, bytes = {bytes} }}], vendor");
        Cell::parse(&IRB6.replacen("drive = { vendor", &parameter, 1))
    };
    for (value, bytes, possible) in [
        ("0xFF", 1, true),
        ("0x100", 1, false),
        ("0xFFFFFFFF", 1, true),
        ("0xFFFFFF80", 1, true),
        ("0xFFFFFF7F", 1, false),
        ("0xFFFF", 2, true),
        ("0x10000", 2, false),
        ("0xFFFF8000", 2, true),
        ("0xFFFFFFFF", 4, true),
    ] {
        match given(value, bytes) {
            Ok(_) => assert!(possible, "{value} in {bytes}"),
            Err(error) => {
                assert!(!possible, "{error}");
                assert_eq!(error.key, "robot[0].axis[0].drive.parameter[0].value");
            }
        }
    }
}

#[test]
fn the_gains_of_every_law_of_the_robots_themselves_are_within_the_bounds() {
    // The IRp-6's own law, by current.
    for law in servo::regulator::IRP6 {
        let text = format!(
            "law = {{ incremental = {{ a = {}, b0 = {}, b1 = {}, eps = {}, gain = {}, limit = {} }} }} #",
            law.a,
            law.b0,
            law.b1,
            law.eps,
            law.gain,
            law.limit.min(2.6)
        );
        let cell = SERIAL.replacen("law = { cascade", &format!("{text} law = {{ cascade"), 1);
        // The rest of the line becomes a comment.
        let cell = cell.replacen(" #", " } }\n#", 1);
        Cell::parse(&cell).unwrap_or_else(|error| panic!("{law:?}: {error}"));
    }
}

#[test]
fn the_permitted_silence_follows_from_the_missed_deadlines_and_has_bounds() {
    let silence = |keys: &str| {
        let text = SERIAL.replacen("period_us = 2000", keys, 1);
        Cell::parse(&text).map(|cell| cell.guardian_config().silence.as_millis()).map_err(|error| error.key)
    };
    let cases = [
        ("period_us = 2000", Ok(9)),
        ("period_us = 2000\nmax_missed_in_row = 20", Ok(43)),
        ("period_us = 2000\nmax_missed_in_row = 1", Ok(5)),
        ("period_us = 2000\nmax_missed_in_row = 100000", Ok(1000)),
        ("period_us = 2000\nguardian_ms = 4", Ok(4)),
        ("period_us = 2000\nguardian_ms = 3", Err("guardian_ms".to_owned())),
        ("period_us = 2000\nguardian_ms = 1001", Err("guardian_ms".to_owned())),
    ];
    for (keys, expected) in cases {
        assert_eq!(silence(keys), expected, "{keys}");
    }
}
