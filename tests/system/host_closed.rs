//! CiA 402 drives in velocity mode (CSV) and torque mode (CST): the servo closes the position loop over CAN.

use std::time::Duration;

use ::mrroc::cell::{Axis, CascadeConfig, DriveControl, FeedForward, Law, Loop, ProportionalConfig};
use drive::{AxisCommand, AxisState, Finite, Power, Setpoint};
use hil::AxisConfig;
use hil::plant::{Irp6Axis, PlantConfig};
use kit::cell::{Setup, ends};
use kit::motion::Motion;
use servo::{Order, Phase, StopCause};

pub(crate) const BY_HOST: [DriveControl; 2] = [DriveControl::Velocity, DriveControl::Torque];

/// Position gain for the velocity loop of the drive, rad/s: [`hil::AmplifierConfig::VELOCITY_BANDWIDTH`] is 283.
const POSITION_GAIN: f64 = 50.0;

/// Ratio of the bandwidths to those of `loops/cascades.rs`, where the rule for the gains is defined. Over CAN, the
/// delay from sample to effect is a period longer. Including the delay of the velocity estimate, it is six milliseconds
/// instead of four.
const SHARE: f64 = 2.0 / 3.0;

/// Makes the host close the loop of `axis`, tuned for the nominal motor.
pub(crate) fn closed_by_host(axis: &mut Axis, kind: Irp6Axis, control: DriveControl) {
    let config = AxisConfig::irp6(kind);
    let PlantConfig::Physical(motor) = config.plant else { unreachable!("the preset is physical") };
    let (law, feed_forward) = match control {
        DriveControl::Position => return,
        DriveControl::Velocity => (
            Law::Proportional(ProportionalConfig { position_gain: POSITION_GAIN, integral_rate: 0.0, limit: 280.0 }),
            FeedForward { velocity: 1.0, ..FeedForward::default() },
        ),
        DriveControl::Torque => (
            Law::Cascade(CascadeConfig {
                position_gain: 25.0 * SHARE,
                velocity_gain: motor.inertia * 100.0 * SHARE,
                integral_rate: 10.0 * SHARE,
                limit: 0.8 * config.amplifier.max_current * motor.torque_constant,
            }),
            FeedForward {
                velocity: motor.viscous,
                acceleration: motor.inertia,
                coulomb: motor.friction.coulomb,
                ..FeedForward::default()
            },
        ),
    };
    let drive = axis.drive.as_mut().expect("the cell is on CAN");
    // As in the emulated drive: rated torque is nominal current times torque constant.
    drive.rated_torque = config.amplifier.max_current * motor.torque_constant;
    drive.control = control;
    drive.r#loop = Some(Loop { law, feed_forward, runaway_velocity: Some(300.0) });
}

/// The IRb-6 on CAN with loops closed by the host.
pub(crate) fn irb6(control: DriveControl) -> Setup {
    let mut setup = Setup::of("irb6");
    let axes = setup.cell.robot[0].axis.iter_mut();
    for (axis, kind) in axes.zip(Irp6Axis::ALL) {
        closed_by_host(axis, kind, control);
    }
    setup
}

#[test]
fn a_program_runs_by_velocity_and_by_torque() {
    for control in BY_HOST {
        let mut rig = irb6(control).bring_up();
        rig.run_program().unwrap();
        for (axis, tracking) in rig.servo.tracking(0).enumerate() {
            println!("{control:?}, axis {axis}: peak {:.3} rad, rms {:.4} rad", tracking.peak, tracking.rms());
            let most = match control {
                DriveControl::Velocity => 0.1,
                _ => 0.5,
            };
            assert!(tracking.peak < most, "{control:?} {axis}: {tracking:?}");
        }
    }
}

#[test]
fn an_arm_is_held_against_its_weight_from_power_to_power() {
    for control in BY_HOST {
        let mut rig = irb6(control).bring_up();
        rig.stand_by(Order::Enable);
        let held = rig.angles();
        for _ in 0..500 {
            rig.cycle();
        }
        for (axis, (before, after)) in held.iter().zip(rig.angles()).enumerate() {
            let sank = after - before;
            assert!(sank.abs() < 0.1, "{control:?}, axis {axis}: by {sank} rad");
        }
        rig.stand_by(Order::Home);
        for axis in 0..5 {
            let error = rig.last.axis[axis].commanded - rig.last.axis[axis].measured;
            assert!(error.abs() < 0.5, "{control:?}, axis {axis}: {error} rad");
        }
    }
}

#[test]
fn a_loop_that_does_not_work_loses_its_power_at_once() {
    for control in BY_HOST {
        let mut setup = irb6(control);
        setup.axes = vec![0];
        // A very small gain, and a feed-forward that is too large.
        let drive = setup.cell.robot[0].axis[0].drive.as_mut().unwrap();
        let given = drive.r#loop.as_mut().unwrap();
        match &mut given.law {
            Law::Proportional(law) => law.position_gain = 1e-6,
            Law::Cascade(law) => law.velocity_gain = 1e-6,
            Law::Incremental(_) => unreachable!("not of these"),
        }
        given.feed_forward.velocity *= 1.2;
        given.feed_forward.acceleration *= 3.0;
        let mut rig = setup.bring_up();
        rig.home();
        let mut motion = Motion::new(&rig, 100.0);
        while rig.servo.fault(0).is_none() {
            rig.feed(&mut motion);
            rig.cycle();
        }
        let cause = rig.servo.fault(0).unwrap().cause;
        assert!(
            matches!(cause, StopCause::FollowingError { .. } | StopCause::Runaway { .. }),
            "{control:?}: {cause:?}"
        );
        // Stop category 0: no further set-point is sent.
        assert_eq!(rig.last.axis[0].command, AxisCommand::Off);
        assert_eq!(rig.phase(), Phase::Faulted);
    }
}

#[test]
fn the_host_that_falls_silent_leaves_no_drive_running() {
    for control in BY_HOST {
        let mut setup = irb6(control);
        setup.axes = vec![0];
        let mut rig = setup.bring_up();
        rig.home();
        rig.in_motion();
        let silence = 5 * rig.heartbeat() + Duration::from_millis(500);
        for _ in 0..silence.as_micros() / rig.period.as_micros() {
            rig.pass();
        }
        let before = rig.angle(0);
        rig.pass();
        assert!((rig.angle(0) - before).abs() < 1e-4, "{control:?}");
    }
}

#[test]
fn a_sample_shows_the_set_point_of_three_cycles_before_in_every_mode() {
    let finite = |value| Finite::new(value).unwrap();
    for control in [DriveControl::Position, DriveControl::Velocity, DriveControl::Torque] {
        let mut setup = irb6(control);
        setup.axes = vec![0];
        let (mut group, mut world, period) = ends(setup);
        let mut now = can::Instant::ZERO;
        while group.bring_up(now).is_pending() {
            now += period;
            world.advance(now);
        }
        let mut states = [AxisState::default()];
        let mut cycle = |command| {
            now += period;
            world.advance(now);
            group.read(now, &mut states);
            group.write(now, &[command]);
            group.send(now);
            states[0]
        };
        while cycle(AxisCommand::Stand).power != Power::On {}
        let mut at = 0.0;
        for _ in 0..50 {
            at = cycle(AxisCommand::Stand).position;
        }
        let command = AxisCommand::Follow(match control {
            DriveControl::Position => Setpoint::Position(finite(at + 0.2)),
            DriveControl::Velocity => Setpoint::Velocity(finite(50.0)),
            DriveControl::Torque => Setpoint::Torque(finite(2.0)),
        });
        let moved: Vec<_> = (0..6).map(|_| (cycle(command).position - at).abs()).collect();
        let count = std::f64::consts::TAU / 4000.0;
        let first = moved.iter().position(|moved| *moved > 1.5 * count);
        assert_eq!(first, Some(group.delay()), "{control:?}: {moved:?}");
        assert_eq!(group.delay(), 3);
    }
}
