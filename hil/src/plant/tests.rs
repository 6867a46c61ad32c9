//! A complete axis: plant, sensors and loops.

use std::f64::consts::TAU;

use super::{AxisConfig, Demand, Gravity, Irp6Axis, MotorConfig, PlantAxis, PlantConfig, PlantFault, Switch, Trip};

const TORQUE_CONSTANT: f64 = 0.105;

/// An axis with its motor changed by `change`.
fn irp6(axis: Irp6Axis, change: impl FnOnce(&mut MotorConfig)) -> AxisConfig {
    let mut config = AxisConfig::irp6(axis);
    match &mut config.plant {
        PlantConfig::Physical(motor) => change(motor),
        PlantConfig::Wut(_) => unreachable!("the preset is physical"),
    }
    config
}

/// Motion from standstill to standstill over 100 rad at 50 rad/s and 150 rad/s².
fn trapezoid(t: f64) -> f64 {
    const RAMP: f64 = 1.0 / 3.0;
    const END: f64 = 2.0 + RAMP;
    match t {
        t if t < RAMP => 75.0 * t * t,
        t if t < END - RAMP => 50.0 * (t - 0.5 * RAMP),
        t if t < END => 100.0 - 75.0 * (END - t) * (END - t),
        _ => 100.0,
    }
}

/// Largest and last following error, counts. Set-points are whole counts each `period` sub-steps, between which the
/// drive interpolates.
fn following_error(config: &AxisConfig, period: u32) -> (i32, i32) {
    let mut axis = PlantAxis::new(config, 1);
    axis.advance(5_000, Demand::Position { counts: 0.0, velocity: 0.0 });
    let scale = f64::from(config.counts_per_revolution) / TAU;
    let seconds = f64::from(period) * super::SUB_STEP;
    let target = |k: u32| (trapezoid(f64::from(k) * seconds) * scale).round();
    let (mut worst, mut last) = (0, 0);
    for k in 0..(3.0 / seconds) as u32 {
        let (from, to) = (target(k), target(k + 1));
        axis.advance(period, Demand::Position { counts: from, velocity: (to - from) / seconds });
        last = to as i32 - axis.feedback().counts;
        worst = worst.max(last.abs());
    }
    (worst, last)
}

#[test]
fn every_axis_follows_the_trapezoid_within_few_counts() {
    // Largest error, counts, of the physical axis and of the regression model. Break-away from stiction causes the
    // largest error. The error differs between axes with the ratio of friction to inertia.
    let table = [
        (Irp6Axis::Column, 5, 5),
        (Irp6Axis::LowerArm, 6, 5),
        (Irp6Axis::UpperArm, 14, 5),
        (Irp6Axis::Pitch, 12, 5),
        (Irp6Axis::Roll, 10, 5),
        (Irp6Axis::Flange, 7, 3),
    ];
    for (axis, physical, wut) in table {
        for (config, bound) in [(AxisConfig::irp6(axis), physical), (AxisConfig::wut(axis), wut)] {
            let PlantConfig::Physical(motor) = AxisConfig::irp6(axis).plant else { unreachable!() };
            let stops = motor.end_stops.expect("the preset has buffers");
            let start_angle = 0.5 * (stops.negative + stops.positive) - 50.0;
            for period in [10, 20] {
                let (worst, last) = following_error(&AxisConfig { start_angle, ..config }, period);
                assert!(worst <= bound, "{axis:?} at {period}: {worst} counts, not {bound}");
                assert!(last.abs() <= 1, "{axis:?} at {period}: ends {last} counts off");
            }
        }
    }
}

#[test]
fn loops_stay_stable_with_up_to_four_times_the_inertia() {
    for axis in Irp6Axis::ALL {
        for factor in [0.4, 1.0, 2.0, 3.0, 4.0] {
            let mut axis_at_work = PlantAxis::new(&irp6(axis, |motor| motor.inertia *= factor), 1);
            let errors: Vec<i32> = (0..1000)
                .map(|_| {
                    axis_at_work.advance(10, Demand::Position { counts: 200.0, velocity: 0.0 });
                    200 - axis_at_work.feedback().counts
                })
                .collect();
            let overshoot = -errors.iter().min().expect("not empty");
            let late = errors[700..].iter().map(|error| error.abs()).max().expect("not empty");
            assert!(overshoot <= 70, "{axis:?} ×{factor}: overshoots by {overshoot} of 200");
            assert!(late <= 1, "{axis:?} ×{factor}: still {late} off after 0.7 s");
        }
    }
}

#[test]
fn velocity_and_torque_demands_are_met() {
    for axis in Irp6Axis::ALL {
        let mut axis_at_work = PlantAxis::new(&AxisConfig::irp6(axis), 1);
        axis_at_work.advance(10_000, Demand::Velocity(-20_000.0));
        let before = axis_at_work.feedback().counts;
        axis_at_work.advance(10_000, Demand::Velocity(-20_000.0));
        let moved = axis_at_work.feedback().counts - before;
        // The weight torque of the arms changes during the motion, and the integral lags behind it.
        assert!((moved + 20_000).abs() <= 20, "{axis:?}: {moved} counts in a second");
    }
    let mut axis = PlantAxis::new(&AxisConfig::irp6(Irp6Axis::Column), 1);
    axis.advance(50, Demand::Torque(-0.5));
    assert!((axis.feedback().torque + 0.5).abs() < 0.005, "{} N·m", axis.feedback().torque);
}

#[test]
fn standing_axis_does_not_creep() {
    // The weight torque is greatest where the axis starts.
    let heavy = |amplitude| Gravity { amplitude, ratio: 1e3, phase: -15e-3 };
    let off = Demand::Off;
    let hold = Demand::Position { counts: 0.0, velocity: 0.0 };
    // Weight, N·m; brake; demand; and whether the axis stays at standstill. Stiction is 0.12 N·m.
    let cases = [
        (0.11, 0.0, off, true),
        (-0.11, 0.0, off, true),
        (0.13, 0.0, off, false),
        (0.60, 0.0, off, false),
        (0.60, 1.0, off, true),
        (0.11, 0.0, hold, true),
    ];
    for (amplitude, brake, demand, stays) in cases {
        let config = irp6(Irp6Axis::LowerArm, |motor| motor.gravity = heavy(amplitude));
        let config = AxisConfig { brake, edge_jitter: 0.0, ..config };
        let mut axis = PlantAxis::new(&config, 1);
        axis.advance(100_000, demand);
        let stayed = axis.angle() == config.start_angle;
        assert_eq!(stayed, stays, "{amplitude} N·m, brake {brake}, {demand:?}: {}", axis.angle());
    }
}

#[test]
fn powered_axis_settles_on_its_count_under_its_weight() {
    for axis in Irp6Axis::ALL {
        let mut axis_at_work = PlantAxis::new(&AxisConfig { edge_jitter: 0.0, ..AxisConfig::irp6(axis) }, 1);
        let hold = Demand::Position { counts: 777.0, velocity: 0.0 };
        axis_at_work.advance(20_000, hold);
        let angle = axis_at_work.angle();
        assert_eq!(axis_at_work.feedback().counts, 777, "{axis:?}");
        axis_at_work.advance(100_000, hold);
        assert_eq!(axis_at_work.angle(), angle, "{axis:?} hunts");
    }
}

/// Largest deviation, counts, of an axis that is told to hold its present position.
fn bump(mut axis: PlantAxis) -> i32 {
    let here = axis.feedback().counts;
    let hold = Demand::Position { counts: f64::from(here), velocity: 0.0 };
    let strays = (0..500).map(|_| {
        axis.advance(10, hold);
        (axis.feedback().counts - here).abs()
    });
    strays.max().expect("not empty")
}

#[test]
fn position_loop_takes_over_without_a_bump() {
    // The position loop takes over from a torque that carries the weight.
    let config = irp6(Irp6Axis::UpperArm, |motor| {
        motor.gravity = Gravity { amplitude: 0.4, ratio: 1e9, phase: 0.0 };
    });
    let mut axis = PlantAxis::new(&config, 1);
    axis.advance(1_000, Demand::Torque(-0.4));
    assert!(bump(axis) <= 1);
    // The position loop takes over at high torque or speed.
    for work in [Demand::Torque(2.0), Demand::Velocity(20_000.0)] {
        let mut axis = PlantAxis::new(&AxisConfig::irp6(Irp6Axis::Column), 1);
        axis.advance(100, Demand::Velocity(0.0));
        axis.advance(20, work);
        axis.advance(1_000, Demand::Off);
        assert!(bump(axis) <= 1, "after {work:?}");
    }
}

#[test]
fn index_marks_home_and_the_switch_is_closed_below_it() {
    for axis in Irp6Axis::ALL {
        let config = AxisConfig { edge_jitter: 0.0, ..AxisConfig::irp6(axis) };
        let per_radian = f64::from(config.counts_per_revolution) / TAU;
        let home = (config.index_angle * per_radian).floor() - (config.start_angle * per_radian).floor();
        let Some(Switch { to, .. }) = config.home_switch else { unreachable!("the preset has one") };
        let mut axis_at_work = PlantAxis::new(&config, 1);
        let (mut indices, mut edge) = (Vec::new(), None);
        for _ in 0..4_000 {
            axis_at_work.advance(10, Demand::Velocity(-15.0 * per_radian));
            indices.extend(axis_at_work.take_index());
            let closed = axis_at_work.feedback().home_switch;
            assert_eq!(closed, (to - 18.0..=to).contains(&axis_at_work.angle()), "{axis:?}");
            if closed {
                edge.get_or_insert(axis_at_work.angle());
            }
        }
        let turn = config.counts_per_revolution as i32;
        assert!(indices.contains(&(home as i32)), "{axis:?}: no {home} in {indices:?}");
        assert!(indices.windows(2).all(|pair| pair[0] - pair[1] == turn), "{indices:?}");
        let edge = edge.expect("the switch was passed");
        assert!((to - 0.02..=to).contains(&edge), "{axis:?}: closed at {edge}, not {to}");
    }
}

/// Runs into an end stop at 30 rad/s and continues to push with full torque.
fn stalled(axis: Irp6Axis, direction: f64) -> (PlantAxis, Demand) {
    let mut axis_at_work = PlantAxis::new(&AxisConfig::irp6(axis), 1);
    axis_at_work.advance(100_000, Demand::Velocity(19_000.0 * direction));
    (axis_at_work, Demand::Torque(100.0 * direction))
}

#[test]
fn limit_switches_close_before_the_buffers_stop_the_axis() {
    for (direction, end) in [(1.0, 100.0_f64), (-1.0, -80.0)] {
        let (mut axis, push) = stalled(Irp6Axis::UpperArm, direction);
        axis.advance(10_000, push);
        let feedback = axis.feedback();
        assert_eq!(feedback.trip, None);
        assert_eq!((feedback.negative_limit, feedback.positive_limit), (end < 0.0, end > 0.0));
        let into_buffer = (axis.angle() - end) * direction - 3.0;
        assert!((0.05..0.1).contains(&into_buffer), "{into_buffer} rad");
        let before = axis.angle();
        axis.advance(10_000, push);
        assert!((axis.angle() - before).abs() < 2e-3, "moves by {}", axis.angle() - before);
    }
}

#[test]
fn current_and_voltage_have_their_limits() {
    let free = irp6(Irp6Axis::Column, |motor| {
        motor.end_stops = None;
        motor.torque_ripple = 0.0;
    });
    let mut axis = PlantAxis::new(&free, 1);
    let mut most = 0.0_f64;
    for _ in 0..10_000 {
        axis.advance(1, Demand::Torque(100.0));
        most = most.max(axis.feedback().torque / TORQUE_CONSTANT);
    }
    assert!((19.8..20.001).contains(&most), "{most} A");
    axis.advance(20_000, Demand::Torque(100.0));
    // 35.8 V divided by 0.105 V·s/rad, reduced by friction.
    let speed = axis.feedback().velocity * TAU / 4000.0;
    assert!((310.0..341.0).contains(&speed), "{speed} rad/s");
    // Anti-windup: after the voltage limit the loops settle at once.
    axis.advance(3_000, Demand::Velocity(0.0));
    assert!(axis.feedback().velocity.abs() < 200.0, "{} counts/s", axis.feedback().velocity);
}

#[test]
fn over_current_trips_until_power_is_taken_off() {
    let mut config = AxisConfig::irp6(Irp6Axis::Column);
    config.amplifier.trip_current = 5.0;
    let mut axis = PlantAxis::new(&config, 1);
    axis.advance(10, Demand::Torque(0.4));
    assert_eq!(axis.feedback().trip, None);
    axis.advance(50, Demand::Torque(1.0));
    assert_eq!(axis.feedback().trip, Some(Trip::OverCurrent));
    axis.advance(50, Demand::Torque(0.1));
    assert_eq!((axis.feedback().trip, axis.feedback().torque), (Some(Trip::OverCurrent), 0.0));
    axis.advance(1, Demand::Off);
    axis.advance(50, Demand::Torque(0.1));
    assert_eq!(axis.feedback().trip, None);
    assert!(axis.feedback().torque > 0.09);
}

#[test]
fn stalled_motor_overheats_and_recovers_when_it_has_cooled() {
    let (mut axis, stall) = stalled(Irp6Axis::UpperArm, 1.0);
    let mut seconds = 0;
    while axis.feedback().trip.is_none() {
        axis.advance(10_000, stall);
        seconds += 1;
        assert!(seconds < 200, "never trips");
    }
    // 135 W into 60 J/K, rising as copper warms. A rise of 130 K takes about 60 s, including the heat flow to the
    // housing.
    assert!((40..90).contains(&seconds), "{seconds} s");
    assert_eq!(axis.feedback().trip, Some(Trip::OverTemperature));
    axis.advance(1, stall);
    assert_eq!(axis.feedback().torque, 0.0);
    axis.advance(1, Demand::Off);
    assert_eq!(axis.feedback().trip, Some(Trip::OverTemperature), "off does not cool it");
    axis.advance(100_000, Demand::Off);
    assert_eq!(axis.feedback().trip, None);
}

/// Exercises all random parts.
fn wander(seed: u64, chunks: &[u32]) -> (u64, i32) {
    let mut config = AxisConfig::irp6(Irp6Axis::Roll);
    config.home_switch = Some(Switch { from: 440.0, to: 450.0, bounce: 50 });
    let mut axis = PlantAxis::new(&config, seed);
    for velocity in [-20_000.0, 10_000.0, -30_000.0] {
        for chunk in chunks {
            axis.advance(*chunk, Demand::Velocity(velocity));
        }
    }
    (axis.angle().to_bits(), axis.feedback().counts)
}

#[test]
fn one_seed_is_one_run_bit_for_bit() {
    assert_eq!(wander(5, &[20; 200]), wander(5, &[20; 200]));
    assert_ne!(wander(5, &[20; 200]).0, wander(6, &[20; 200]).0);
}

#[test]
fn ripple_and_jitter_are_what_seeds_differ_in() {
    let run = |seed, torque_ripple, edge_jitter| {
        let config = irp6(Irp6Axis::Column, |motor| {
            motor.torque_ripple = torque_ripple;
        });
        let mut axis = PlantAxis::new(&AxisConfig { edge_jitter, ..config }, seed);
        axis.advance(5_000, Demand::Velocity(-31_000.0));
        axis.angle().to_bits()
    };
    for (ripple, jitter, differ) in [(0.0, 0.0, false), (0.01, 0.0, true), (0.0, 0.1, true)] {
        assert_eq!(run(1, ripple, jitter) != run(2, ripple, jitter), differ, "{ripple}, {jitter}");
    }
}

#[test]
fn how_time_is_cut_up_changes_nothing() {
    let mut config = AxisConfig::irp6(Irp6Axis::Column);
    config.start_angle = 0.0;
    let run = |chunks: &[u32]| {
        let mut axis = PlantAxis::new(&config, 5);
        for chunk in chunks {
            axis.advance(*chunk, Demand::Velocity(31_000.0));
        }
        axis.angle().to_bits()
    };
    let whole = run(&[6_000]);
    assert_eq!(run(&[20; 300]), whole);
    assert_eq!(run(&[7, 13, 1, 9, 30].repeat(100)), whole);
}

#[test]
fn voltages_and_currents_act_from_their_first_sub_step() {
    // Friction exceeds any motor torque, so there is no back-EMF.
    let mut config = irp6(Irp6Axis::Column, |motor| {
        motor.friction.coulomb = 100.0;
        motor.friction.stiction = 100.0;
    });
    config.amplifier.max_voltage = 48.0;
    config.amplifier.trip_current = 100.0;
    for phase in 0..10 {
        let mut axis = PlantAxis::new(&config, 1);
        axis.advance(phase, Demand::Off);
        for k in 1..=20 {
            axis.advance(1, Demand::Duty(0.25));
            // 12 V across 0.6 Ω and 0.5 mH.
            let exact = 20.0 * (1.0 - (-0.12 * f64::from(k)).exp());
            let current = axis.feedback().current;
            assert!((current - exact).abs() < 1e-6, "{current} A for {exact}");
        }
        // The current loop takes over without a bump, and settles.
        let before = axis.feedback().current;
        axis.advance(1, Demand::Current(before));
        let jump = axis.feedback().current - before;
        assert!(jump.abs() < 0.7, "{jump} A, where 12 V alone add 0.2");
        axis.advance(30, Demand::Current(-3.0));
        let current = axis.feedback().current;
        assert!((current + 3.0).abs() < 0.03, "{current} A");
    }
}

#[test]
fn an_axis_trips_beyond_the_current_it_was_set_to() {
    for config in [AxisConfig::irp6(Irp6Axis::Column), AxisConfig::wut(Irp6Axis::Column)] {
        for (limit, trips) in [(4.0, true), (6.0, false)] {
            let mut axis = PlantAxis::new(&config, 1);
            axis.amplifier.config.trip_current = limit;
            axis.advance(100, Demand::Current(5.0));
            let trip = axis.feedback().trip;
            assert_eq!(trip == Some(Trip::OverCurrent), trips, "{limit} A");
            axis.advance(100, Demand::Current(5.0));
            assert_eq!(axis.feedback().trip, trip, "latched");
            assert_eq!(axis.feedback().current == 0.0, trips);
            axis.advance(1, Demand::Off);
            assert_eq!(axis.feedback().trip, None);
        }
    }
}

/// An axis that holds its position, after `settle` under a fault and 200 ms.
fn under_fault(fault: PlantFault) -> (PlantAxis, PlantAxis) {
    let config = AxisConfig::irp6(Irp6Axis::ALL[0]);
    let mut axis = PlantAxis::new(&config, 1);
    let hold = Demand::Position { counts: 0.0, velocity: 0.0 };
    axis.advance(1000, hold);
    let sound = axis.clone();
    axis.set_fault(fault, true);
    axis.advance(2000, Demand::Velocity(4000.0));
    (sound, axis)
}

#[test]
fn a_fault_of_the_plant_shows_in_the_feedback_and_not_beyond() {
    let (sound, blocked) = under_fault(PlantFault::Blocked);
    assert!((blocked.angle() - sound.angle()).abs() < 1e-6, "a blocked shaft stands");
    let (sound, frozen) = under_fault(PlantFault::EncoderFrozen);
    assert_eq!(frozen.feedback().counts, sound.feedback().counts);
    assert!((frozen.angle() - sound.angle()).abs() > 1.0, "the shaft turns");
    let (sound, inverted) = under_fault(PlantFault::EncoderInverted);
    let moved = f64::from(inverted.feedback().counts - sound.feedback().counts);
    assert!(moved * (inverted.angle() - sound.angle()) < 0.0, "the counter runs backwards");
    let (sound, jumped) = under_fault(PlantFault::EncoderJump(4000));
    let turned =
        (jumped.angle() - sound.angle()) * f64::from(AxisConfig::irp6(Irp6Axis::ALL[0]).counts_per_revolution) / TAU;
    let counted = f64::from(jumped.feedback().counts - sound.feedback().counts);
    assert!((counted - turned - 4000.0).abs() < 3.0, "{counted} of {turned}");
    let (_, closed) = under_fault(PlantFault::LimitSwitchClosed);
    assert!(closed.feedback().positive_limit);
    for (fault, trip) in
        [(PlantFault::OverCurrent, Trip::OverCurrent), (PlantFault::OverTemperature, Trip::OverTemperature)]
    {
        let (_, mut tripped) = under_fault(fault);
        assert_eq!(tripped.feedback().trip, Some(trip));
        tripped.set_fault(fault, false);
        tripped.advance(10, Demand::Off);
        assert_eq!(tripped.feedback().trip, None);
    }
    let (sound, collided) = under_fault(PlantFault::Buffer { distance: 0.5, stiffness: 20.0 });
    let way = collided.angle() - sound.angle();
    assert!(way > 0.4 && way < 1.5, "{way} rad against the buffer");
    let (sound, reversed) = under_fault(PlantFault::SwappedPhases);
    assert!(reversed.angle() < sound.angle() - 1.0, "a motor with swapped phases runs away");
}

/// The counter that belongs to a true angle, for an encoder that never lost a count.
fn true_counts(config: &AxisConfig, axis: &PlantAxis) -> f64 {
    let scale = f64::from(config.counts_per_revolution) / TAU;
    (axis.angle() * scale).floor() - (config.start_angle * scale).floor()
}

#[test]
fn an_encoder_keeps_the_offset_of_its_fault_after_its_end() {
    let config = AxisConfig { edge_jitter: 0.0, ..AxisConfig::irp6(Irp6Axis::ALL[0]) };
    // Change of the offset per true increment during the fault, and the offset of the fault itself.
    let table = [
        (PlantFault::EncoderFrozen, -1.0, 0.0),
        (PlantFault::EncoderInverted, -2.0, 0.0),
        (PlantFault::EncoderJump(4000), 0.0, 4000.0),
    ];
    for (fault, per_increment, once) in table {
        let mut axis = PlantAxis::new(&config, 1);
        let offset = |axis: &PlantAxis| f64::from(axis.feedback().counts) - true_counts(&config, axis);
        axis.advance(1000, Demand::Velocity(2000.0));
        assert_eq!(offset(&axis), 0.0, "{fault:?}");
        let begun = true_counts(&config, &axis);
        axis.set_fault(fault, true);
        axis.advance(500, Demand::Torque(0.4));
        let moved = true_counts(&config, &axis) - begun;
        assert!(moved > 100.0, "{fault:?}: {moved} increments");
        let lost = once + per_increment * moved;
        assert_eq!(offset(&axis), lost, "during {fault:?}");
        let counter = axis.feedback().counts;
        axis.set_fault(fault, false);
        assert_eq!(axis.feedback().counts, counter, "the counter continues from its value after {fault:?}");
        for demand in [Demand::Off, Demand::Velocity(4000.0), Demand::Velocity(-4000.0)] {
            axis.advance(2000, demand);
            assert_eq!(offset(&axis), lost, "after {fault:?}");
        }
    }
}

#[test]
fn the_index_pulse_stays_at_its_angle_of_the_shaft() {
    let config = AxisConfig { edge_jitter: 0.0, ..AxisConfig::irp6(Irp6Axis::ALL[0]) };
    let scale = f64::from(config.counts_per_revolution) / TAU;
    let turn = f64::from(config.counts_per_revolution);
    let index = (config.index_angle * scale).floor() - (config.start_angle * scale).floor();
    for fault in [PlantFault::EncoderFrozen, PlantFault::EncoderInverted, PlantFault::EncoderJump(777)] {
        let mut axis = PlantAxis::new(&config, 1);
        axis.set_fault(fault, true);
        axis.advance(500, Demand::Torque(0.4));
        axis.set_fault(fault, false);
        let offset = f64::from(axis.feedback().counts) - true_counts(&config, &axis);
        assert!(offset.abs() > 100.0, "{fault:?}: {offset}");
        axis.take_index();
        axis.advance(20_000, Demand::Velocity(4000.0));
        let latched = f64::from(axis.take_index().expect("a turn in each second"));
        assert_eq!((latched - offset - index).rem_euclid(turn), 0.0, "after {fault:?}");
    }
    // A dead encoder has no index pulse, not even for a pulse that it passed during the fault.
    let mut axis = PlantAxis::new(&config, 1);
    axis.set_fault(PlantFault::EncoderFrozen, true);
    axis.advance(2000, Demand::Torque(0.4));
    assert!(true_counts(&config, &axis) > 2.0 * turn, "{} counts", true_counts(&config, &axis));
    axis.set_fault(PlantFault::EncoderFrozen, false);
    axis.advance(1, Demand::Off);
    assert_eq!(axis.take_index(), None);
    // An inverted encoder latches its own counter where the shaft passes the index.
    let mut axis = PlantAxis::new(&config, 1);
    axis.set_fault(PlantFault::EncoderInverted, true);
    while axis.feedback().index.is_none() {
        axis.advance(1, Demand::Torque(0.4));
    }
    let latched = f64::from(axis.take_index().expect("the loop waited for it"));
    assert_eq!((-latched - index).rem_euclid(turn), 0.0, "{latched}");
}
