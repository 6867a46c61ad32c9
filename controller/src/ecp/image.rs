//! Image of an effector in its control process: state of the motors, state of the joints and pose of the tool.

use std::array;
use std::time::Duration;

use servo::Snapshot;

use crate::generator::{Axes, AxesState, EffectorImage, EffectorState, GeneratorError, ImageSource, Pose, Setpoint};
use crate::robot::{Arm, KinematicsError};

/// Step of the differences by which velocities are converted, rad or m of the fastest axis or of the tool.
const STEP: f64 = 1e-4;

/// Data of the effector in its control process. Joints and pose are computed from the motors on request.
#[derive(Clone, Debug)]
pub(super) struct Effector {
    pub(super) arm: Arm,
    /// The measured state: at the beginning of a motion the latest, then that of the last report that is `reached`.
    pub(super) measured: Snapshot,
    /// Motor positions and velocities at the end of the last macrostep made.
    pub(super) commanded: AxesState,
}

impl Effector {
    pub(super) fn new(arm: Arm) -> Self {
        Self { arm, measured: Snapshot::default(), commanded: AxesState::default() }
    }

    fn state(&self, motors: &AxesState) -> Result<EffectorState, KinematicsError> {
        let position = self.arm.joints(&motors.position)?;
        let velocity = slope(motors, &position, |motors| self.arm.joints(motors))?;
        Ok(EffectorState {
            motors: *motors,
            joints: AxesState { position, velocity },
            pose: self.arm.forward(&position)?,
        })
    }

    /// State of the motors at the end of the next macrostep. Without a set-point, the motors stand at the last command.
    pub(super) fn motors(&self, setpoint: Option<Setpoint>) -> Result<AxesState, KinematicsError> {
        let joints = match setpoint {
            None => return Ok(AxesState::at_rest(self.commanded.position)),
            Some(Setpoint::Motors(motors)) => return Ok(motors),
            Some(Setpoint::Joints(joints)) => joints,
            Some(Setpoint::JointsBy(by)) => {
                let here = self.arm.joints(&self.commanded.position)?;
                let position = moved(&here, &by.position, 1.0);
                AxesState { position, ..by }
            }
            Some(Setpoint::Pose { pose, linear, angular }) => {
                let near = self.arm.joints(&self.commanded.position)?;
                let position = self.arm.inverse(&pose, &near)?;
                let at = |t: f64| {
                    let turned = nalgebra::UnitQuaternion::from_scaled_axis(angular * t) * pose.rotation;
                    let shifted = pose.translation.vector + linear * t;
                    self.arm.inverse(&Pose::from_parts(shifted.into(), turned), &position)
                };
                let velocity = difference(linear.norm().max(angular.norm()), &position, at)?;
                AxesState { position, velocity }
            }
        };
        let position = self.arm.motors(&joints.position)?;
        let velocity = slope(&joints, &position, |joints| self.arm.motors(joints))?;
        Ok(AxesState { position, velocity })
    }
}

impl Effector {
    /// The image of a measured and a commanded state.
    pub(super) fn image(&self, measured: &Snapshot, commanded: &AxesState) -> Result<EffectorImage, GeneratorError> {
        let &Snapshot { at, macrostep, torque, switches, sampled, .. } = measured;
        let axes = usize::from(measured.axes);
        let motors = AxesState { position: measured.measured, velocity: measured.velocity };
        Ok(EffectorImage {
            at: sampled[..axes].iter().copied().min().unwrap_or(at),
            read_at: at,
            age: array::from_fn(|axis| if axis < axes { at.since(sampled[axis]) } else { Duration::ZERO }),
            macrostep,
            measured: self.state(&motors).map_err(GeneratorError::Image)?,
            torque,
            switches,
            commanded: self.state(commanded).map_err(GeneratorError::Image)?,
        })
    }
}

impl ImageSource for Effector {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        self.image(&self.measured, &self.commanded)
    }
}

/// Velocity of `map(position)` while `position` moves from `from.position` at `from.velocity`. `value` is
/// `map(from.position)`.
fn slope(
    from: &AxesState,
    value: &Axes,
    map: impl Fn(&Axes) -> Result<Axes, KinematicsError>,
) -> Result<Axes, KinematicsError> {
    let fastest = from.velocity.map(f64::abs).into_iter().fold(0.0, f64::max);
    difference(fastest, value, |t| map(&moved(&from.position, &from.velocity, t)))
}

/// Time derivative of `at(t)` at t = 0. `value` is `at(0)`; `speed` is that of the fastest axis or of the tool.
///
/// The central difference uses points 1e-4 rad or m before and after. Its relative error, f‴ / f′ · 1e-8 / 6, is below
/// 1e-8 for the screws and rods of the drive trains. Rounding of positions near 1000 rad adds 1e-9. If one point is
/// beyond a limit, the difference is one-sided and accurate to 1e-4.
fn difference(
    speed: f64,
    value: &Axes,
    at: impl Fn(f64) -> Result<Axes, KinematicsError>,
) -> Result<Axes, KinematicsError> {
    if !(speed > 0.0 && speed.is_finite()) {
        return Ok(Axes::default());
    }
    let dt = STEP / speed;
    let over = |from: &Axes, to: &Axes, dt: f64| array::from_fn(|axis| (to[axis] - from[axis]) / dt);
    match (at(-dt), at(dt)) {
        (Ok(behind), Ok(ahead)) => Ok(over(&behind, &ahead, 2.0 * dt)),
        (Err(_), Ok(ahead)) => Ok(over(value, &ahead, dt)),
        (Ok(behind), Err(_)) => Ok(over(&behind, value, dt)),
        (Err(error), Err(_)) => Err(error),
    }
}

fn moved(position: &Axes, velocity: &Axes, t: f64) -> Axes {
    array::from_fn(|axis| position[axis] + velocity[axis] * t)
}
