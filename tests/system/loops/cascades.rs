//! Gains of cascades for the physical axes of the IRp-6 on serial lines. One rule derives them from motor data, and
//! tests check the resulting loops. The example cells with such axes use these gains.

use hil::AxisConfig;
use hil::plant::Irp6Axis;
use servo::regulator::CascadeConfig;
use servo::{FeedForward, HostLoop, Law, Output, Phase};

use super::motors::{ByCurrent, ByPulseWidth, SUPPLY, physical};
use super::{MakeMotor, Rig};
use crate::regression::Trapezoid;

/// Bandwidth of the velocity loop in the cascade for the physical plant, rad/s. The open loop crosses over near this
/// frequency.
const BANDWIDTH: f64 = 100.0;

const POSITION_GAIN: f64 = 25.0;

/// Gains for a drive that controls the current.
fn by_torque(axis: Irp6Axis) -> HostLoop {
    let motor = physical(axis);
    HostLoop {
        law: Law::Cascade(CascadeConfig {
            position_gain: POSITION_GAIN,
            velocity_gain: motor.inertia * BANDWIDTH,
            integral_rate: 10.0,
            limit: AxisConfig::irp6(axis).amplifier.max_current * motor.torque_constant,
        }),
        output: Output::Torque,
        feed_forward: FeedForward {
            velocity: motor.viscous,
            acceleration: motor.inertia,
            coulomb: motor.friction.coulomb,
            ..FeedForward::default()
        },
        runaway_velocity: 300.0,
    }
}

/// Gains for a drive with pulse-width output. The zero of the integral part cancels the motor's pole.
fn by_duty(axis: Irp6Axis) -> HostLoop {
    let motor = physical(axis);
    let duty_per_torque = motor.resistance / motor.torque_constant / SUPPLY;
    let pole = motor.torque_constant.powi(2) / (motor.inertia * motor.resistance);
    let torque = by_torque(axis);
    HostLoop {
        law: Law::Cascade(CascadeConfig {
            position_gain: POSITION_GAIN,
            velocity_gain: motor.inertia * BANDWIDTH * duty_per_torque,
            integral_rate: pole,
            limit: 190.0 / 255.0,
        }),
        output: Output::Duty,
        feed_forward: FeedForward {
            velocity: motor.torque_constant / SUPPLY + motor.viscous * duty_per_torque,
            acceleration: motor.inertia * duty_per_torque,
            coulomb: motor.friction.coulomb * duty_per_torque,
            ..FeedForward::default()
        },
        ..torque
    }
}

/// An axis on a serial line, with a delay of one period from sample to effect.
pub(super) fn serial(axis: Irp6Axis, output: Output) -> Rig {
    let (host, motor): (_, MakeMotor) = match output {
        Output::Torque => (by_torque(axis), |axis| Box::new(ByCurrent::new(axis))),
        Output::Duty => (by_duty(axis), |axis| Box::new(ByPulseWidth::new(axis))),
        Output::Velocity => unreachable!("no axis controller on a line closes a velocity loop"),
    };
    Rig { host, counts: f64::from(AxisConfig::irp6(axis).counts_per_revolution), delay: 2, motor, axis }
}

#[test]
fn cascades_over_a_serial_line_are_well_damped() {
    for output in [Output::Torque, Output::Duty] {
        println!("{output:?}: crossover, Hz; margin, degrees; kp, kv, ki, limit; feed-forward");
        for axis in Irp6Axis::ALL {
            let rig = serial(axis, output);
            let (crossover, margin) = rig.margin(15.0);
            println!("{axis:10?} {crossover:6.1} {margin:6.1} {:?}", rig.host);
            assert!((12.0..22.0).contains(&crossover), "{axis:?}: {crossover} Hz");
            assert!(margin > 40.0, "{axis:?}: {margin} degrees");
        }
    }
}

#[test]
fn a_fast_move_keeps_within_a_fifth_of_a_radian() {
    let motion = Trapezoid { distance: 80.0, velocity: 250.0, acceleration: 1500.0 };
    for output in [Output::Torque, Output::Duty] {
        for axis in Irp6Axis::ALL {
            let mut running = serial(axis, output).enable();
            running.follow(motion);
            running.run(1000);
            let phase = running.phase();
            assert_eq!(phase, Phase::Standing, "{axis:?}: {:?}", running.servo.fault(0));
            let tracking = running.servo.tracking(0).next().unwrap();
            println!("{output:?} {axis:10?} peak {:.3} rad, rms {:.3}", tracking.peak, tracking.rms());
            assert!(tracking.peak < 0.2, "{axis:?}: {} rad", tracking.peak);
        }
    }
}
