//! Behaviour of the drive.

use super::*;
use serial::nfv2::Gains;

#[test]
fn pulse_widths_and_currents_drive_the_motor_only_in_their_modes() {
    // Mode, set-point, and whether the axis moves. If one mode were mistaken for the other, each set-point would move
    // the axis, which has no dry friction.
    let pwm = Command::SetPwm(200);
    let current = Command::SetCurrent(200);
    let cases = [
        (Mode::Manual, pwm, false),
        (Mode::Manual, current, false),
        (Mode::Pwm, pwm, true),
        (Mode::Pwm, current, false),
        (Mode::SyncPwm, pwm, true),
        (Mode::Current, current, true),
        (Mode::Current, pwm, false),
        (Mode::SyncCurrent, current, true),
        (Mode::Error, pwm, false),
    ];
    for (mode, set_point, moves) in cases {
        let mut config = column();
        if let crate::PlantConfig::Physical(motor) = &mut config.axis.plant {
            motor.friction = crate::plant::FrictionConfig::NONE;
        }
        let mut rig = Rig::nfv2(&config);
        rig.cycle(&[Command::SetMode(mode), set_point]);
        let before = rig.cycle(&[]).position;
        for _ in 0..50 {
            rig.cycle(&[]);
        }
        let after = rig.cycle(&[]);
        assert_eq!(after.position - before > 20, moves, "{mode:?} {set_point:?}");
        assert_eq!(after.is(Status::ERROR), mode == Mode::Error);
    }
}

#[test]
fn a_pulse_width_is_its_share_of_48_volts() {
    let mut rig = Rig::nfv2(&column());
    rig.cycle(&[Command::SetMode(Mode::Pwm)]);
    // A ramp, since a step from standstill would trip the drive.
    for pwm in 0..=100 {
        rig.cycle(&[Command::SetPwm(pwm)]);
    }
    for _ in 0..500 {
        rig.cycle(&[]);
    }
    let (start, current) = {
        let reading = rig.cycle(&[]);
        (reading.position, f64::from(reading.current) * 1e-3)
    };
    for _ in 0..499 {
        rig.cycle(&[]);
    }
    let turns = f64::from(rig.cycle(&[]).position - start) / 4000.0;
    let speed = turns * std::f64::consts::TAU;
    // 4.8 V less the voltage drop of the winding, divided by 0.105 V·s/rad.
    let expected = (4.8 - 0.6 * current) / 0.105;
    assert!((speed - expected).abs() < 0.02 * expected, "{speed} {expected}");
}

#[test]
fn the_drives_own_loop_settles_on_the_current_within_two_milliseconds() {
    for axis in Irp6Axis::ALL {
        let mut config = AxisControllerConfig::new(AxisConfig::irp6(axis));
        // The shaft is held, so there is no back-EMF. The trip threshold is out of reach.
        if let crate::PlantConfig::Physical(motor) = &mut config.axis.plant {
            motor.friction.stiction = 100.0;
            motor.friction.coulomb = 100.0;
        }
        let asked = (config.axis.amplifier.max_current * 500.0) as i16;
        let mut rig = Rig::nfv2(&config);
        rig.cycle(&[Command::SetMode(Mode::Current), Command::SetCurrent(asked)]);
        rig.cycle(&[]);
        let read = rig.cycle(&[]).current;
        let off = (f64::from(read) / f64::from(asked) - 1.0).abs();
        assert!(off < 0.05, "{axis:?}: {read} mA for {asked}");
    }
}

#[test]
fn other_gains_make_another_loop() {
    let mut rig = Rig::nfv2(&column());
    let weak = Gains { p: 3, i: 3, d: 0, t: 0 };
    rig.cycle(&[Command::SetCurrentRegulator(weak), Command::SetMode(Mode::Current), Command::SetCurrent(5000)]);
    let read = rig.cycle(&[]).current;
    assert!((0..1000).contains(&read), "{read} mA after 2 ms");
}

#[test]
fn over_current_is_latched_until_manual_mode() {
    let mut rig = Rig::nfv2(&column());
    let go = [Command::SetMode(Mode::Pwm), Command::SetPwm(300)];
    rig.cycle(&[Command::SetMaxCurrent(5000)]);
    rig.cycle(&go);
    // 14.4 V across 0.6 Ω at standstill would be 24 A.
    let tripped = rig.cycle(&[]);
    assert!(tripped.is(Status::OVERCURRENT), "{tripped:?}");
    let tripped = rig.cycle(&go);
    assert!(tripped.is(Status::OVERCURRENT) && tripped.current == 0);
    let cleared = rig.cycle(&[Command::SetMode(Mode::Manual)]);
    assert!(!cleared.is(Status::OVERCURRENT));
    // With a higher current limit the motor runs.
    rig.cycle(&[Command::SetMaxCurrent(25_000)]);
    rig.cycle(&go);
    for _ in 0..20 {
        assert!(!rig.cycle(&[]).is(Status::OVERCURRENT));
    }
}

#[test]
fn a_limit_switch_stops_what_runs_into_it_and_lets_it_out() {
    for (start, sign, bit) in [(449.0, 1, Status::UPPER_LIMIT), (-469.0, -1, Status::LOWER_LIMIT)] {
        for current in [false, true] {
            let mut config = column();
            config.axis.start_angle = start;
            let mut rig = Rig::nfv2(&config);
            let set = |value: i16| {
                if current { Command::SetCurrent(sign * 15 * value) } else { Command::SetPwm(sign * value) }
            };
            let mode = if current { Mode::Current } else { Mode::Pwm };
            rig.cycle(&[Command::SetMode(mode), set(100)]);
            for _ in 0..300 {
                rig.cycle(&[]);
            }
            let stopped = rig.cycle(&[]);
            assert!(stopped.is(bit), "{stopped:?}");
            let device = rig.device();
            // The switch closes one radian from the start. The buffer begins three radians beyond the switch.
            let beyond = f64::from(sign) * (device.axis().angle() - start) - 1.0;
            assert!((0.0..3.0).contains(&beyond), "{beyond} rad into the switch");
            assert_eq!(rig.cycle(&[]).position, stopped.position, "it stands");
            rig.cycle(&[set(-100)]);
            for _ in 0..300 {
                rig.cycle(&[]);
            }
            assert!(!rig.cycle(&[]).is(bit), "it came out");
        }
    }
}

#[test]
fn a_set_point_stays_when_the_host_stops_sending() {
    let mut rig = Rig::nfv2(&column());
    rig.cycle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
    rig.now += Duration::from_millis(500);
    let before = rig.cycle(&[]).position;
    rig.now += Duration::from_millis(100);
    let after = rig.cycle(&[]).position;
    assert!(after - before > 100, "{before} to {after}");
}

#[test]
fn a_drive_in_error_takes_the_power_from_its_cabinet_alone() {
    for shared in [true, false] {
        let cabinet = Cabinet::default();
        let config = AxisControllerConfig { cabinet: cabinet.clone(), ..column() };
        let mut rig = Rig::nfv2(&config);
        let other = AxisControllerConfig { cabinet: if shared { cabinet } else { Cabinet::default() }, ..column() };
        let device = Box::new(AxisController::nfv2(ADDRESS, &other));
        let line = rig.world.add_line(Settings::AXIS_CONTROLLER, None, device);
        let mut other = rig.world.host_line(line, 4096);
        rig.cycle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
        let mut tell = |rig: &Rig, mode| {
            let request = frame(ADDRESS, &[Command::SetMode(mode)]);
            assert_eq!(other.write(rig.now, &request), Ok(request.len()));
        };
        tell(&rig, Mode::Error);
        rig.cycle(&[]);
        let off = rig.cycle(&[]);
        assert_eq!(off.is(Status::POWER_STAGE_FAULT), shared);
        assert_eq!(off.current == 0, shared, "{off:?}");
        assert!(!off.is(Status::ERROR));
        // Manual mode clears no fault while the stop is open. Once the stop is closed, manual mode clears the fault.
        let manual = [Command::SetMode(Mode::Manual)];
        assert_eq!(rig.cycle(&manual).is(Status::POWER_STAGE_FAULT), shared);
        tell(&rig, Mode::Manual);
        rig.cycle(&[]);
        assert!(!rig.cycle(&[]).is(Status::POWER_STAGE_FAULT));
    }
}

/// The homing cycle by hand: towards the switch, then back off the switch with the index search armed, until the
/// counter is zeroed. `step` takes a pulse width and whether the index search is armed. `step` returns whether the
/// switch is closed, whether the index pulse came, and the counter.
fn home(mut step: impl FnMut(i16, bool) -> (bool, bool, i32)) {
    let mut until = |pwm, armed, done: fn((bool, bool, i32)) -> bool| {
        (0..5000).map(|_| step(pwm, armed)).find(|&seen| done(seen)).expect("it gets there")
    };
    let (_, index, _) = until(-60, false, |(switch, ..)| switch);
    assert!(!index);
    for _ in 0..250 {
        until(0, false, |_| true);
    }
    let (_, index, _) = until(40, true, |(switch, ..)| !switch);
    assert!(!index, "the index lies 2 rad beyond the edge");
    let (_, _, position) = until(40, true, |(_, index, _)| index);
    assert!((0..200).contains(&position), "zeroed {position} counts ago");
    until(0, false, |(_, index, _)| !index);
}

#[test]
fn homing_by_hand_zeroes_the_counter_at_the_index() {
    let mut rig = Rig::nfv2(&column());
    rig.cycle(&[Command::SetMode(Mode::Pwm)]);
    home(|pwm, armed| {
        let mode = if armed { Mode::SyncPwm } else { Mode::Pwm };
        let reading = rig.cycle(&[Command::SetMode(mode), Command::SetPwm(pwm)]);
        (reading.is(Status::HOME_SWITCH), reading.is(Status::INDEX), reading.position)
    });
    let referenced = |rig: &mut Rig| {
        let reading = rig.cycle(&[Command::SetPwm(0)]);
        assert!(reading.is(Status::SYNCHRONIZED));
        // The true angle of the simulated axis: the index lies at -15.9 rad.
        let truth = (rig.device().axis().angle() + 15.9) * 4000.0 / std::f64::consts::TAU;
        assert!((f64::from(reading.position) - truth).abs() < 2.0, "{} for {truth}", reading.position);
    };
    for _ in 0..100 {
        rig.cycle(&[Command::SetPwm(0)]);
    }
    referenced(&mut rig);
    // The host restarts. The drive does not notice the restart.
    rig.host = rig.world.host_line(rig.line, 64);
    referenced(&mut rig);
}

#[test]
fn homing_by_hand_works_with_the_older_telegrams() {
    let mut rig = Rig::hi_moxa(&column());
    home(|value, latch_index| {
        let answer = rig.old_cycle(hi_moxa::Request::Drive { mode: hi_moxa::Mode::Pwm, value, latch_index });
        let is = |bit| answer.flags.any(bit);
        (is(hi_moxa::Flags::HOME_SWITCH), is(hi_moxa::Flags::INDEX), answer.position)
    });
    let state = rig.old_cycle(hi_moxa::Request::Set(hi_moxa::Parameter::DriverMode(hi_moxa::DriverMode::Manual)));
    assert_eq!(state.flags.0, hi_moxa::Flags::SYNCHRONIZED);
}

#[test]
fn the_regression_model_takes_currents_and_pulse_widths() {
    let settle = |commands: &[Command]| {
        let config = AxisControllerConfig::new(AxisConfig::wut(Irp6Axis::Column));
        let mut rig = Rig::nfv2(&config);
        rig.cycle(commands);
        let before = (0..100).map(|_| rig.cycle(&[]).position).last();
        let turns = f64::from(rig.cycle(&[]).position - before.unwrap()) / 4000.0;
        turns * std::f64::consts::TAU / PERIOD.as_secs_f64()
    };
    // Torque 10 A · 0.105 N·m/A against viscous friction 0.02 N·m·s/rad.
    let speed = settle(&[Command::SetMode(Mode::Current), Command::SetCurrent(10_000)]);
    assert!((speed - 52.5).abs() < 1.0, "{speed}");
    // (4.8 V - 0.105 w) / 0.6 · 0.105 = 0.02 w.
    let speed = settle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
    let expected = 4.8 * 0.105 / (0.02 * 0.6 + 0.105 * 0.105);
    assert!((speed - expected).abs() < 1.0, "{speed} for {expected}");
}
