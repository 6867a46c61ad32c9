//! Tests of the laws of an arm against springs, with lag of the position loops and delay of the sensor.

mod rate;
mod refusals;
mod spring;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use drive::wrench::RehearsedWrench;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use servo::{CycleLaw, Knot, LawAxis, LawInput, LawOutput, MAX_AXES, Trail};

use super::{Compliance, Direction, ForceLimits, ForceTask, PositionForce, PositionForceConfig, TaskAxes};
use crate::force::Wrench;
use crate::robot::{Arm, Axes, Irp6, Irp6Parameters, Pose};

/// The servo period, s.
const T: f64 = 0.002;

/// A posture of the IRp-6 in the middle of its workspace, its tool down, rad.
const START: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, FRAC_PI_2 - 0.3, 0.3, 0.0, 0.0];

/// An arm under a law, ideal but for the lag of its position loops and the delay of its sensor.
struct Rig {
    law: PositionForce,
    arm: Arm,
    sensor: RehearsedWrench,
    flange_from_sensor: Pose,
    /// Motors at the start of the path, velocity of the path, rad/s, and motors as commanded and moved.
    path: Axes,
    path_velocity: Axes,
    commanded: Axes,
    displacement: Axes,
    actual: Axes,
    /// Share of the distance to the commanded position that a motor keeps in a period.
    lag: f64,
    /// Forces on the tool, the newest last, and the number of periods by which the sensor is late.
    forces: Vec<Vector3<f64>>,
    delay: usize,
    cycle: u32,
    began: bool,
    /// Rate of motion time.
    rate: f64,
}

fn flange_from_sensor() -> Pose {
    let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.8);
    Isometry3::from_parts(Translation3::new(0.0, 0.01, 0.05), rotation)
}

fn irp6() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    Arm::new(Arc::new(robot), Isometry3::from_parts(Translation3::new(0.02, 0.0, 0.25), UnitQuaternion::identity()))
}

/// Limits that no motion of the tests reaches.
const WIDE: ForceLimits = ForceLimits {
    wrench: [1e4; 6],
    age: Duration::from_millis(6),
    speed: [1e4; MAX_AXES],
    acceleration: [1e7; MAX_AXES],
};

impl Rig {
    /// `tau`: time constant of the position loops, s. `delay`: delay of the sensor, periods.
    fn new(arm: Arm, joints: &Axes, tau: f64, delay: usize, limits: ForceLimits) -> Self {
        let (sensor, link) = RehearsedWrench::new();
        let flange_from_sensor = flange_from_sensor();
        let config = PositionForceConfig {
            arm: arm.clone(),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor,
            load: None,
            lag: Duration::ZERO,
            zeroed: None,
            payload: None,
            limits,
        };
        let path = arm.motors(joints).unwrap();
        Self {
            law: PositionForce::new(config, link).unwrap(),
            arm,
            sensor,
            flange_from_sensor,
            path,
            path_velocity: [0.0; MAX_AXES],
            commanded: path,
            displacement: [0.0; MAX_AXES],
            actual: path,
            lag: if tau > 0.0 { (-T / tau).exp() } else { 0.0 },
            forces: vec![Vector3::zeros(); delay + 1],
            delay,
            cycle: 0,
            began: false,
            rate: 1.0,
        }
    }

    fn now(&self) -> Instant {
        Instant::ZERO + self.cycle * Duration::from_millis(2)
    }

    /// Pose of the tool.
    fn tool(&self) -> Pose {
        self.arm.forward(&self.arm.joints(&self.actual).unwrap()).unwrap()
    }

    /// The sample that the sensor gives in this cycle.
    fn sense(&mut self) {
        let force = self.forces[self.forces.len() - 1 - self.delay];
        let base_from_tool = self.tool();
        let base_from_flange = base_from_tool * self.arm.flange_from_tool().inverse();
        let base_from_sensor = base_from_flange * self.flange_from_sensor;
        let push = Wrench { force, torque: Vector3::zeros() };
        let at_tool = Isometry3::from_parts(base_from_tool.translation, UnitQuaternion::identity());
        let load = push.seen_from(&(base_from_sensor.inverse() * at_tool));
        self.sensor.advance(self.now(), load.components());
    }

    /// The output of the law in this cycle, for a period of `dt` seconds.
    fn shift(&mut self, task: &ForceTask, dt: f64) -> LawOutput {
        let axes: [LawAxis; MAX_AXES] = std::array::from_fn(|axis| LawAxis {
            planned: Knot::new(self.path[axis], self.path_velocity[axis]),
            displacement: self.displacement[axis],
            commanded: self.commanded[axis],
            position: self.actual[axis],
            ..LawAxis::default()
        });
        let axes = &axes[..self.arm.axes()];
        let input = LawInput {
            now: self.now(),
            period: dt,
            periods: 1,
            rate: self.rate,
            macrostep: 1,
            axes,
            trail: &Trail::default(),
        };
        let parameters = (*task).into();
        self.law.check(&parameters).unwrap();
        if !std::mem::replace(&mut self.began, true) {
            self.law.begin(&input, &parameters);
        }
        self.law.shift(&input, &parameters)
    }

    /// The motors move for a period. `environment`: force on the tool at a pose of the tool, N, in the axes of the base.
    fn advance(&mut self, environment: &dyn Fn(&Pose) -> Vector3<f64>) {
        for axis in 0..self.arm.axes() {
            self.commanded[axis] = self.path[axis] + self.displacement[axis];
            self.actual[axis] = self.commanded[axis] + (self.actual[axis] - self.commanded[axis]) * self.lag;
        }
        self.forces.push(environment(&self.tool()));
        self.cycle += 1;
    }

    /// One cycle. Returns the output of the law if that is an end.
    fn cycle(&mut self, task: &ForceTask, environment: &dyn Fn(&Pose) -> Vector3<f64>) -> Option<LawOutput> {
        self.path.iter_mut().zip(self.path_velocity).for_each(|(at, velocity)| *at += self.rate * velocity * T);
        self.sense();
        match self.shift(task, T) {
            LawOutput::Displacement(displacement) => self.displacement = displacement,
            end => return Some(end),
        }
        self.advance(environment);
        None
    }
}

/// Contact along z of the base with a force downward, N.
fn press(force: f64) -> ForceTask {
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[2] = Direction::Contact { force: -force, compliance: Compliance::LINEAR };
    task
}

/// A spring of `stiffness`, N/m, below the height `z`, m, that also pulls if not `one_sided`.
fn spring(z: f64, stiffness: f64, one_sided: bool) -> impl Fn(&Pose) -> Vector3<f64> {
    move |tool| {
        let force = stiffness * (z - tool.translation.z);
        Vector3::z() * if one_sided { force.max(0.0) } else { force }
    }
}
