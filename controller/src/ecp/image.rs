//! Image of an effector in its control process: state of the motors, state of the joints and pose of the tool.

use std::array;
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use servo::{Knot, Phase, Snapshot, cubic_end_acceleration};

use super::Ecp;
use crate::generator::{Accelerations, Axes, AxesState, EffectorImage, EffectorState, GeneratorError, Pose, Setpoint};
use crate::path::PoseState;
use crate::robot::{Arm, KinematicsError};

/// Displacement in the differences by which velocities are converted, rad or m of the fastest joint or of the tool.
const STEP: f64 = 1e-4;

/// The same displacement of the fastest motor, rad. Behind a gear of 100 it is [`STEP`] of a joint.
const FINE: f64 = 1e-2;

/// Data of the effector in its control process. Joints and pose are computed from the motors on request.
#[derive(Clone, Debug)]
pub(super) struct Effector {
    pub(super) arm: Arm,
    /// The measured state: at the beginning of a motion the latest, then that of the last report that is `reached`.
    pub(super) measured: Snapshot,
    /// Motors at the end of the last macrostep made. The acceleration is stated.
    pub(super) commanded: AxesState,
}

impl Effector {
    pub(super) fn new(arm: Arm) -> Self {
        Self { arm, measured: Snapshot::default(), commanded: AxesState::default() }
    }

    fn state(&self, motors: &AxesState) -> Result<(EffectorState, Accelerations), KinematicsError> {
        let position = self.arm.joints(&motors.position)?;
        let joints = mapped(motors, position, FINE, |motors| self.arm.joints(motors))?;
        let accelerations = Accelerations {
            motors: motors.acceleration.unwrap_or_default(),
            joints: joints.acceleration.unwrap_or_default(),
        };
        let state = EffectorState {
            motors: AxesState { acceleration: None, ..*motors },
            joints: AxesState { acceleration: None, ..joints },
            pose: self.arm.forward(&position)?,
        };
        Ok((state, accelerations))
    }

    /// State of the motors at the end of the next macrostep of `seconds`. Without a set-point, the motors stand at the
    /// last command. The acceleration is always stated.
    pub(super) fn motors(&self, setpoint: Option<Setpoint>, seconds: f64) -> Result<AxesState, KinematicsError> {
        let motors = self.stated(setpoint)?;
        let last = self.commanded;
        let estimated = |axis: usize| {
            let from = Knot::new(last.position[axis], last.velocity[axis]);
            let to = Knot::new(motors.position[axis], motors.velocity[axis]);
            cubic_end_acceleration(from, to, seconds)
        };
        let acceleration = motors.acceleration.unwrap_or_else(|| array::from_fn(estimated));
        Ok(AxesState { acceleration: Some(acceleration), ..motors })
    }

    fn stated(&self, setpoint: Option<Setpoint>) -> Result<AxesState, KinematicsError> {
        let joints = match setpoint {
            None => return Ok(AxesState::at_rest(self.commanded.position)),
            Some(Setpoint::Motors(motors)) => return Ok(motors),
            Some(Setpoint::Joints(joints)) => joints,
            Some(Setpoint::JointsBy(by)) => {
                let here = self.arm.joints(&self.commanded.position)?;
                let position = array::from_fn(|axis| here[axis] + by.position[axis]);
                AxesState { position, ..by }
            }
            Some(Setpoint::Pose { pose, linear, angular }) => {
                self.at_pose(&PoseState { pose, linear, angular, ..PoseState::default() }, false)?
            }
            Some(Setpoint::Tool(state)) => self.at_pose(&state, true)?,
        };
        let position = self.arm.motors(&joints.position)?;
        mapped(&joints, position, STEP, |joints| self.arm.motors(joints))
    }

    /// Joints of a moving tool, with their acceleration if that of the tool is `stated`.
    fn at_pose(&self, tool: &PoseState, stated: bool) -> Result<AxesState, KinematicsError> {
        let near = self.arm.joints(&self.commanded.position)?;
        let position = self.arm.inverse(&tool.pose, &near)?;
        let at = |t: f64, push: f64| {
            let moved = |rate: Vector3<f64>, change: Vector3<f64>| rate * t + change * (push * t * t / 2.0);
            let turned = UnitQuaternion::from_scaled_axis(moved(tool.angular, tool.angular_acceleration));
            let shifted = tool.pose.translation.vector + moved(tool.linear, tool.linear_acceleration);
            self.arm.inverse(&Pose::from_parts(shifted.into(), turned * tool.pose.rotation), &position)
        };
        let speed = tool.linear.norm().max(tool.angular.norm());
        let velocity = slope(duration_of(speed, 0.0, STEP), &position, |t| at(t, 0.0))?;
        let push = tool.linear_acceleration.norm().max(tool.angular_acceleration.norm());
        let bend = || bend(duration_of(speed, push, STEP), &position, |t| at(t, 1.0));
        let acceleration = if stated { bend() } else { None };
        Ok(AxesState { position, velocity, acceleration })
    }
}

impl Ecp {
    /// Image of the effector in the last servo cycle, in every phase, also with the drives off. Joints and pose are
    /// meaningful after homing. The commanded state is the set-point of that cycle, or the measured position at rest in
    /// a phase without set-points. Fails if the effector measures positions that its mechanism cannot take.
    #[doc(alias = "get_position")]
    pub fn image(&self) -> Result<EffectorImage, GeneratorError> {
        let latest = self.latest();
        let commanded = match latest.phase {
            Phase::Standing | Phase::Moving | Phase::Stopping => {
                AxesState::new(latest.commanded, latest.commanded_velocity)
            }
            Phase::Off | Phase::Enabling | Phase::Homing | Phase::Faulted => AxesState::at_rest(latest.measured),
        };
        self.effector.image(&latest, &commanded)
    }
}

impl Effector {
    /// The present image.
    pub(super) fn read(&self) -> Result<EffectorImage, GeneratorError> {
        self.image(&self.measured, &self.commanded)
    }

    /// The image of a measured and a commanded state.
    pub(super) fn image(&self, measured: &Snapshot, commanded: &AxesState) -> Result<EffectorImage, GeneratorError> {
        let &Snapshot { at, macrostep, torque, switches, sampled, .. } = measured;
        let axes = usize::from(measured.axes);
        let motors = AxesState::new(measured.measured, measured.velocity);
        let (commanded, commanded_acceleration) = self.state(commanded).map_err(GeneratorError::Image)?;
        Ok(EffectorImage {
            at: sampled[..axes].iter().copied().min().unwrap_or(at),
            read_at: at,
            age: array::from_fn(|axis| if axis < axes { at.since(sampled[axis]) } else { Duration::ZERO }),
            macrostep,
            measured: self.state(&motors).map_err(GeneratorError::Image)?.0,
            torque,
            switches,
            commanded,
            commanded_acceleration,
        })
    }
}

/// The state `map(from)`, where `position` is `map(from.position)`. `step` is the greatest displacement of an axis in the
/// differences.
fn mapped(
    from: &AxesState,
    position: Axes,
    step: f64,
    map: impl Fn(&Axes) -> Result<Axes, KinematicsError>,
) -> Result<AxesState, KinematicsError> {
    let greatest = |axes: &Axes| axes.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let speed = greatest(&from.velocity);
    let ahead = |t: f64, push: &Axes| {
        map(&array::from_fn(|axis| from.position[axis] + t * (from.velocity[axis] + 0.5 * push[axis] * t)))
    };
    let velocity = slope(duration_of(speed, 0.0, step), &position, |t| ahead(t, &Axes::default()))?;
    let bend = |push: Axes| bend(duration_of(speed, greatest(&push), step), &position, |t| ahead(t, &push));
    Ok(AxesState { position, velocity, acceleration: from.acceleration.and_then(bend) })
}

/// Time in which an axis moves by about `step` at this speed and acceleration; `None` at rest.
fn duration_of(speed: f64, acceleration: f64, step: f64) -> Option<f64> {
    let duration = (step / speed).min((2.0 * step / acceleration).sqrt());
    (speed.is_finite() && acceleration.is_finite() && duration.is_finite()).then_some(duration)
}

/// Time derivative of `at(t)` at t = 0, by a difference over `dt` seconds before and after; zero without `dt`. `value` is
/// `at(0)`.
///
/// The points lie 1e-4 rad or m before and after. The relative error of the central difference, f‴ / f′ · 1e-8 / 6, is
/// below 1e-8 for the screws and rods of the drive trains. Rounding of positions near 1000 rad adds 1e-9. If one point is
/// beyond a limit, the difference is one-sided and accurate to 1e-4.
fn slope(
    dt: Option<f64>,
    value: &Axes,
    at: impl Fn(f64) -> Result<Axes, KinematicsError>,
) -> Result<Axes, KinematicsError> {
    let Some(dt) = dt else {
        return Ok(Axes::default());
    };
    let over = |from: &Axes, to: &Axes, dt: f64| array::from_fn(|axis| (to[axis] - from[axis]) / dt);
    match (at(-dt), at(dt)) {
        (Ok(behind), Ok(ahead)) => Ok(over(&behind, &ahead, 2.0 * dt)),
        (Err(_), Ok(ahead)) => Ok(over(value, &ahead, dt)),
        (Ok(behind), Err(_)) => Ok(over(&behind, value, dt)),
        (Err(error), Err(_)) => Err(error),
    }
}

/// Second time derivative of `at(t)` at t = 0, by a central difference; zero without `dt`, and `None` beside a limit.
fn bend(dt: Option<f64>, value: &Axes, at: impl Fn(f64) -> Result<Axes, KinematicsError>) -> Option<Axes> {
    let Some(dt) = dt else {
        return Some(Axes::default());
    };
    let (behind, ahead) = (at(-dt).ok()?, at(dt).ok()?);
    Some(array::from_fn(|axis| ((ahead[axis] - value[axis]) - (value[axis] - behind[axis])) / (dt * dt)))
}
