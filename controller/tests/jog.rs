//! Jog of an IRp-6 by the real servo and the real effector control process on ideal drives, in virtual time.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use mrroc_controller::ecp::{Ecp, EcpConfig, StepEvent, StepRecords, Task, step_log};
use mrroc_controller::generator::{Axes, EffectorImage, GeneratorError, Jog, MotionLimits, Pace, Pose};
use mrroc_controller::robot::{Arm, Irp6, Irp6Parameters};
use mrroc_controller::sensor::{JogCommand, JogHandle, JogPanel, Shell};
use nalgebra::Vector3;
use servo::Servo;

use crate::ideal::{PERIOD, Sent, servo};

const AXES: usize = 6;
const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];
/// Limits of velocity and acceleration of the joints, rad/s and rad/s².
const LIMITS: [f64; 2] = [0.5, 2.0];
const DEAD_MAN: Duration = Duration::from_millis(100);
/// Macrosteps from a command or the end of the dead-man time to the set-points that follow from it, s.
const DELAY: f64 = 0.04;

struct Rig {
    arm: Arm,
    servo: Servo,
    ecp: Ecp,
    operator: Option<JogHandle>,
    steps: StepRecords,
    now: Instant,
    /// Greatest velocity and acceleration of a joint, relative to the limits.
    peaks: [f64; 2],
}

impl Rig {
    /// An arm that stands at `start`, and begins to jog.
    fn at(start: Axes) -> Self {
        let robot = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
        let arm = Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25));
        let motors = arm.motors(&start).expect("the arm stands there");
        let motors: [f64; AXES] = std::array::from_fn(|axis| motors[axis]);
        let (servo, link) = servo(motors, 250.0, 1500.0, &Sent::default());
        let config = EcpConfig {
            period: PERIOD,
            pace: Pace { periods: 10, read_at: 8 },
            macrosteps_ahead: 4,
            silence: Duration::from_secs(1),
            switching: Duration::from_secs(2),
            planning: Duration::from_secs(60),
            homing: Duration::from_secs(2),
            meeting: Duration::from_secs(1),
        };
        let mut ecp = Ecp::new(arm.clone(), link, config);
        let limits = MotionLimits::uniform(LIMITS[0], LIMITS[1], 1.0);
        let (panel, operator) = JogPanel::new();
        ecp.sensors().install(panel, Shell::NonInteractive, 1).expect("the only sensor");
        let (log, steps) = step_log(1 << 16);
        ecp.keep_steps(log);
        let jog = Jog::new(arm.clone(), limits, DEAD_MAN).expect("limits are positive");
        ecp.execute(Task::new().enable().run(jog)).expect("nothing is under way");
        let mut rig = Self { arm, servo, ecp, operator: Some(operator), steps, now: Instant::ZERO, peaks: [0.0; 2] };
        rig.wait(0.2);
        rig
    }

    fn image(&self) -> EffectorImage {
        self.ecp.image().expect("the mechanism can take these positions")
    }

    fn cycle(&mut self) {
        let before = self.image().commanded.joints.velocity;
        while let Some(event) = self.ecp.poll(self.now) {
            assert_eq!(event.outcome, Ok(()), "at {:?}", self.now);
        }
        self.servo.step(self.now);
        self.now += PERIOD;
        assert_eq!(self.servo.fault(0), None, "at {:?}", self.now);
        for (after, before) in self.image().commanded.joints.velocity.iter().zip(before) {
            let acceleration = (after - before) / PERIOD.as_secs_f64();
            self.peaks[0] = self.peaks[0].max(after.abs() / LIMITS[0]);
            self.peaks[1] = self.peaks[1].max(acceleration.abs() / LIMITS[1]);
        }
    }

    fn wait(&mut self, seconds: f64) {
        for _ in 0..(seconds / PERIOD.as_secs_f64()).round() as u32 {
            self.cycle();
        }
    }

    /// Repeats a command every 20 ms.
    fn hold(&mut self, command: JogCommand, seconds: f64) {
        for _ in 0..(seconds / 0.02).round() as u32 {
            self.operator.as_mut().expect("the operator is there").command(command).expect("a finite command");
            self.wait(0.02);
        }
    }

    fn stands(&self) -> bool {
        self.image().commanded.joints.velocity.iter().all(|velocity| velocity.abs() < 1e-9)
    }

    fn ended(&self) -> bool {
        self.ecp.status().instruction.is_none()
    }
}

/// A command of one joint, rad/s.
fn joint(axis: usize, velocity: f64) -> JogCommand {
    JogCommand::Joints(std::array::from_fn(|it| if it == axis { velocity } else { 0.0 }))
}

fn tool(linear: [f64; 3], angular: [f64; 3]) -> JogCommand {
    JogCommand::Tool { linear: Vector3::from(linear), angular: Vector3::from(angular) }
}

#[test]
fn a_joint_moves_at_the_commanded_velocity_and_brakes_after_the_dead_man_time() {
    let mut rig = Rig::at(START);
    assert!(rig.stands());
    rig.hold(joint(0, 0.3), 1.0);
    let image = rig.image();
    assert!((image.commanded.joints.velocity[0] - 0.3).abs() < 1e-6);
    let moved = image.commanded.joints.position[0] - START[0];
    // Less half of the time of acceleration, and the delay of the command.
    assert!((moved - 0.3 * (1.0 - 0.075)).abs() < 0.3 * DELAY + 1e-6, "{moved}");
    for (position, start) in image.commanded.joints.position.iter().zip(START).skip(1) {
        assert!((position - start).abs() < 1e-6, "{position} from {start}");
    }
    rig.wait(0.05);
    assert!((rig.image().commanded.joints.velocity[0] - 0.3).abs() < 1e-6, "within the dead-man time");
    rig.wait(DEAD_MAN.as_secs_f64() - 0.05 + DELAY + 0.15 + 0.02);
    assert!(rig.stands() && !rig.ended());
    rig.hold(joint(0, -0.3), 0.5);
    assert!(!rig.stands(), "the next command moves the joint again");
    rig.hold(JogCommand::End, 0.4);
    assert!(rig.stands() && rig.ended());
}

#[test]
fn each_step_reads_the_command_as_an_image_of_class_3_whose_age_is_less_than_a_macrostep() {
    let mut rig = Rig::at(START);
    rig.hold(joint(0, 0.3), 1.0);
    let (mut sensor, mut effector) = (0, 0);
    while let Ok(record) = rig.steps.queue.pop() {
        assert_eq!(record.class, if record.step == 0 { 2 } else { 3 });
        match record.event {
            StepEvent::ReadSensor if record.step > 20 => {
                assert!(record.age < Some(PERIOD * 10), "{record:?}");
                sensor += 1;
            }
            StepEvent::ReadEffector if record.step > 20 => effector += 1,
            _ => {}
        }
    }
    assert!(sensor > 30 && sensor == effector, "{sensor} readings, {effector} images");
}

#[test]
fn a_jog_ends_when_its_operator_is_gone() {
    let mut rig = Rig::at(START);
    rig.hold(joint(3, 0.5), 0.5);
    rig.operator = None;
    rig.wait(0.25 + DELAY + 0.04);
    assert!(rig.stands() && rig.ended());
}

#[test]
fn the_tool_moves_and_turns_about_its_own_axes() {
    for axis in 0..3 {
        let along: [f64; 3] = std::array::from_fn(|it| if it == axis { 1.0 } else { 0.0 });
        let mut rig = Rig::at(START);
        let start = rig.image().commanded.pose;
        rig.hold(tool(along.map(|it| it * 0.05), [0.0; 3]), 1.0);
        let by = start.inverse() * rig.image().commanded.pose;
        let (forward, all) = (by.translation.vector.dot(&Vector3::from(along)), by.translation.vector.norm());
        assert!(forward > 0.04 && forward < 0.05, "axis {axis}: {forward} m");
        assert!(forward > 0.999 * all && by.rotation.angle() < 0.01, "axis {axis}: {by}");

        let mut rig = Rig::at(START);
        let start = rig.image().commanded.pose;
        rig.hold(tool([0.0; 3], along.map(|it| it * 0.2)), 1.0);
        let by = start.inverse() * rig.image().commanded.pose;
        let turned = by.rotation.scaled_axis().dot(&Vector3::from(along));
        assert!(turned > 0.15 && turned < 0.2, "axis {axis}: {turned} rad");
        assert!(turned > 0.999 * by.rotation.angle() && by.translation.vector.norm() < 0.003, "axis {axis}: {by}");
    }
}

#[test]
fn joints_slow_down_and_stop_within_their_ranges() {
    for axis in 0..AXES {
        for sign in [1.0, -1.0] {
            let mut rig = Rig::at(START);
            rig.hold(joint(axis, sign * 0.5), 30.0);
            rig.wait(1.0);
            assert!(rig.stands(), "axis {axis}, {sign}");
            let mut beyond = rig.image().commanded.joints.position;
            rig.arm.motors(&beyond).expect("within the ranges");
            beyond[axis] += sign * 0.02;
            rig.arm.motors(&beyond).expect_err("near the end of a range");
        }
    }
}

#[test]
fn random_commands_keep_the_limits_also_near_a_singularity() {
    let mut stretched = START;
    stretched[4] = 0.0;
    let mut peaks: [f64; 2] = [0.0; 2];
    for seed in 0..30_u64 {
        let mut state = seed;
        let mut random = |most: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            most * (2.0 * (state >> 11) as f64 / (1_u64 << 53) as f64 - 1.0)
        };
        let mut rig = Rig::at(if seed % 2 == 0 { START } else { stretched });
        for _ in 0..20 {
            let command = if random(1.0) < 0.0 {
                JogCommand::Joints(std::array::from_fn(|_| random(1.0)))
            } else {
                tool([random(0.5), random(0.5), random(0.5)], [random(1.0), random(1.0), random(1.0)])
            };
            let (held, silent) = (random(0.4) + 0.4, random(0.2).max(0.0));
            rig.hold(command, held);
            rig.wait(silent);
        }
        rig.hold(JogCommand::End, 0.5);
        assert!(rig.stands() && rig.ended(), "seed {seed}");
        peaks = [0, 1].map(|it| peaks[it].max(rig.peaks[it]));
    }
    println!("velocity and acceleration relative to the limits: {peaks:?}");
    assert!(peaks[0] < 1.1 && peaks[1] < 2.0, "{peaks:?}");
}

#[test]
fn a_command_that_is_not_finite_is_refused() {
    let mut rig = Rig::at(START);
    let operator = rig.operator.as_mut().unwrap();
    assert_eq!(operator.command(joint(2, f64::NAN)), Err(GeneratorError::NotFinite { pose: 0, axis: 2 }));
    let refused = operator.command(tool([0.0; 3], [0.0, f64::INFINITY, 0.0]));
    assert_eq!(refused, Err(GeneratorError::NotFinite { pose: 0, axis: 4 }));
    rig.wait(0.1);
    assert!(rig.stands());
}
