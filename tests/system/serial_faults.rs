//! Faults of serial lines during motion. Each case ends without power and with the fault named. No motor ends far from
//! its set-point.

use std::time::Duration;

use ::mrroc::cell::Protocol;
use drive::axis_controller::AxisControllerFault;
use drive::{AxisCommand, Fault};
use hil::{LineFaults, PlantConfig, Stuck, WireFaults};
use kit::cell::Setup;
use kit::motion::Motion;
use kit::mrroc::SERIAL_CELLS;
use serial::LineError;
use servo::{Order, Phase, ServoFault, StopCause};

/// Distance that a motor without power runs on from [`Motion::VELOCITY`] until friction stops it, rad.
const RUN_OUT: f64 = 12.0;

/// Line faults in both directions.
fn both(wire: WireFaults) -> LineFaults {
    LineFaults { seed: 1, to_device: wire, to_host: wire, ..LineFaults::default() }
}

fn stuck(how: Stuck) -> WireFaults {
    WireFaults { stuck: Some(how), ..WireFaults::default() }
}

fn of_line(cause: StopCause) -> Option<(u8, AxisControllerFault)> {
    match cause {
        StopCause::Drive(Fault::AxisController { line, fault }) => Some((line, fault)),
        _ => None,
    }
}

#[test]
fn a_line_that_hangs_in_motion_stops_the_arm_by_the_name_of_its_axis() {
    for cell in SERIAL_CELLS {
        for how in [Stuck::Silent, Stuck::At(0x00), Stuck::At(0xFF)] {
            for direction in ["both", "to the device", "to the host"] {
                let mut rig = Setup::of(cell).bring_up();
                rig.home();
                let mut motion = rig.in_motion();
                let mut faults = both(stuck(how));
                match direction {
                    "to the device" => faults.to_host = WireFaults::default(),
                    "to the host" => faults.to_device = WireFaults::default(),
                    _ => {}
                }
                rig.set_line_faults(2, &faults);
                let tolerated = rig.cell.serial[0].tolerated_missing;
                // A drive that receives nothing has no watchdog. The other drives stop it: they open the emergency stop
                // of the cabinet.
                let limit = rig.period * (tolerated + 3);
                let ServoFault { axis, cause, .. } = rig.fault_within(limit, &mut motion, RUN_OUT);
                assert_eq!(axis, Some(2), "{cell}, {how:?}, {direction}");
                let cycles = tolerated + 1;
                let silent = AxisControllerFault::Silent { cycles };
                assert_eq!(of_line(cause), Some((2, silent)), "{cell}, {how:?}, {direction}");
            }
        }
    }
}

/// Longest time from a lost line to the order to switch off: the stop from full speed, and the wait for drives that may
/// brake by themselves.
const STOPPED: Duration = Duration::from_millis(350);

#[test]
fn a_line_that_hangs_up_in_motion_stops_the_arm_in_time_and_is_the_cause() {
    for cell in SERIAL_CELLS {
        for lost in [vec![0], vec![2], vec![4], vec![1, 3], vec![0, 1, 2, 3, 4]] {
            let mut rig = Setup::of(cell).bring_up();
            rig.home();
            let mut motion = rig.in_motion();
            let start = rig.angles();
            lost.iter().for_each(|axis| rig.hang_up(*axis));
            let hung_up = rig.now;
            while rig.servo.fault(0).is_none() {
                rig.feed(&mut motion);
                rig.cycle();
            }
            let ServoFault { axis, cause, .. } = rig.servo.fault(0).unwrap();
            let gone = AxisControllerFault::Line(LineError::Gone);
            let line = lost[0] as u8;
            assert_eq!(axis, Some(line), "{cell}, lines {lost:?}");
            assert_eq!(of_line(cause), Some((line, gone)), "{cell}");
            let believed = rig.last.axis[lost[0]].commanded;
            while rig.phase() != Phase::Faulted {
                rig.cycle();
                let waited = rig.now.since(hung_up);
                assert!(waited < STOPPED, "{cell}, lines {lost:?}: {waited:?}");
                let commanded = rig.last.axis[lost[0]].commanded;
                assert_eq!(commanded, believed, "{cell}, lines {lost:?}");
            }
            rig.cycle();
            let axes = &rig.last.axis[..start.len()];
            let off = axes.iter().all(|axis| axis.command == AxisCommand::Off);
            assert!(off, "{cell}, lines {lost:?}: every axis is told to be off");
            // If no line is left, no drive can be told to open the circuit of the cabinet.
            if lost.len() < start.len() {
                rig.at_rest(&start, RUN_OUT + STOPPED.as_secs_f64() * Motion::VELOCITY);
            }
        }
    }
}

#[test]
fn a_program_whose_line_hangs_up_ends_with_that_cause() {
    for cell in SERIAL_CELLS {
        for lost in [2..3, 0..5] {
            let mut rig = Setup::of(cell).bring_up();
            let mut moving = 0;
            let mut hung_up = None;
            let first = lost.start;
            let why = rig.run_program_until(|rig| {
                moving += u32::from(rig.phase() == Phase::Moving);
                if moving == 100 && hung_up.is_none() {
                    hung_up = Some(rig.now);
                    lost.clone().for_each(|axis| rig.hang_up(axis));
                }
            });
            let why = why.unwrap_err();
            let cause = format!("axis {first}: line {first}: line is gone: open it anew");
            assert_eq!(why, cause, "{cell}");
            let took = rig.now.since(hung_up.expect("the program moved"));
            assert!(took < STOPPED, "{cell}: {took:?}");
        }
    }
}

#[test]
fn a_line_that_is_whole_again_in_time_is_ridden_through() {
    for cell in SERIAL_CELLS {
        let mut rig = Setup::of(cell).bring_up();
        rig.home();
        let mut motion = rig.in_motion();
        let tolerated = rig.cell.serial[0].tolerated_missing;
        rig.set_line_faults(2, &both(stuck(Stuck::Silent)));
        for _ in 0..tolerated {
            rig.feed(&mut motion);
            rig.cycle();
        }
        rig.set_line_faults(2, &LineFaults::default());
        rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
        // In the older protocol, a telegram is left out after the first missing answer.
        let left_out = u32::from(rig.cell.serial[0].protocol == Protocol::HiMoxa);
        assert_eq!(rig.missed_answers(), u64::from(tolerated - left_out), "{cell}");
    }
}

/// Each motor is within the following error of its set-point plus the undetectable motion of one cycle, or is braking
/// after a fault.
#[test]
fn bit_errors_on_every_line_never_move_a_motor_elsewhere() {
    for cell in SERIAL_CELLS {
        let mut faulted = 0;
        for seed in 0..6 {
            let mut rig = Setup::of(cell).bring_up();
            let start: Vec<f64> = rig.angles();
            let wire = WireFaults { bit_error_rate: 1e-4, ..WireFaults::default() };
            for axis in 0..start.len() {
                let faults = LineFaults { seed: seed * 100 + axis as u64, ..both(wire) };
                rig.set_line_faults(axis, &faults);
            }
            let mut before = start;
            let result = rig.run_program_with(|rig| {
                let fault = rig.servo.fault(0).is_some();
                for (axis, before) in before.iter_mut().enumerate() {
                    let angle = rig.angle(axis);
                    let record = &rig.last.axis[axis];
                    let velocity = (angle - *before) / rig.period.as_secs_f64();
                    *before = angle;
                    let limit = rig.cell.robot[0].axis[axis].max_velocity;
                    assert!(velocity.abs() < limit, "{cell}, seed {seed}, axis {axis}: {velocity:.1} rad/s");
                    let homed = record.homing == drive::Homing::Attained;
                    let error = (record.commanded - angle).abs();
                    if homed && rig.phase() == Phase::Moving && !fault {
                        assert!(
                            error < rig.cell.robot[0].axis[axis].following_error,
                            "{cell}, seed {seed}, axis {axis}: {error:.2} rad from its set-point"
                        );
                    }
                }
            });
            // A run that stops reports the cause.
            if let Err(why) = result {
                faulted += 1;
                println!("{cell}, seed {seed}: {why}");
                assert!(rig.servo.fault(0).is_some(), "{cell}, seed {seed}: {why}");
            }
        }
        println!("{cell}: {faulted} of 6 runs stopped");
    }
}

/// The leads of a motor are swapped, so the output of its loop drives the motor away from the set-point.
#[test]
fn a_loop_of_the_wrong_sign_loses_its_power_within_a_turn() {
    for cell in SERIAL_CELLS {
        for swapped in 0..5 {
            let setup = Setup::of(cell).with_plant(move |axis, plant| {
                if let PlantConfig::Physical(motor) = &mut plant.plant
                    && axis == swapped
                {
                    motor.torque_constant = -motor.torque_constant;
                }
            });
            let mut rig = setup.bring_up();
            let start = rig.angle(swapped);
            rig.order(Order::Enable);
            rig.cycle();
            rig.until(Duration::from_secs(5), "standing", |rig| {
                rig.phase() == Phase::Standing || rig.servo.fault(0).is_some()
            });
            if rig.servo.fault(0).is_none() {
                rig.order(Order::Home);
            }
            rig.until(Duration::from_secs(60), "a fault", |rig| rig.servo.fault(0).is_some());
            let latched = (rig.angle(swapped) - start).abs();
            let cause = rig.servo.fault(0).unwrap().cause;
            rig.until(Duration::from_secs(10), "off", |rig| rig.phase() == Phase::Faulted);
            for _ in 0..1500 {
                rig.cycle();
            }
            let way = (rig.angle(swapped) - start).abs();
            println!("{cell}, axis {swapped}: {cause}, {latched:.2} rad, at rest after {way:.2} rad");
            assert_eq!(rig.servo.fault(0).unwrap().axis, Some(swapped as u8));
            assert!(
                matches!(
                    (cause, of_line(cause)),
                    (StopCause::Runaway { .. } | StopCause::FollowingError { .. }, _)
                        | (_, Some((_, AxisControllerFault::Overcurrent)))
                ),
                "{cell}, axis {swapped}: {cause}"
            );
            assert!(latched < 6.3, "{cell}, axis {swapped}: {latched:.2} rad");
        }
    }
}
