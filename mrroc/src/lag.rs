//! Following errors that a rehearsed task may cause, compared with `following_error`. Drives and motors are nominal, so
//! an excessive following error is only a warning.
//!
//! * **Late SYNC.** A drive that closes the position loop interpolates its set-points over one period. Foreign frames
//!   on the bus delay SYNC, and the set-point stands until SYNC comes. The velocity loop samples this standstill as
//!   lost velocity, and only a position error makes up for the loss.
//! * **Weight and friction.** A loop of the host takes over the weight of robot and payload when the brakes open, and
//!   breaks the friction at the first motion. The integral of the loop is zero then.

use std::fmt;

use controller::generator::Axes;
use hil::plant::PlantConfig;
use hil::{AmplifierConfig, AxisControllerConfig};
use servo::Output;

use crate::bench::plants;
use crate::cell::CellFile;

/// Mean time per period for which the velocity loop sees a set-point that stands, s: one step of the loop, in half of
/// the periods.
const STANDS: f64 = 0.5e-3;

/// Share of the limit above which a sag is a warning: at half of `following_error`, an axis that stands still is a fault.
const SAGS: f64 = 0.5;

/// Following error that an axis may have, with its cause.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lag {
    robot: usize,
    axis: usize,
    /// Expected error and limit, rad.
    error: f64,
    limit: f64,
    cause: Cause,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Cause {
    /// Greatest velocity of the motor, rad/s.
    LateSync { velocity: f64 },
    /// Greatest weight and friction at rest, at the motor, N·m.
    Weight { torque: f64 },
}

impl fmt::Display for Lag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, error, limit, .. } = self;
        write!(f, "axis {axis} may have a following error of {error:.2} rad, and following_error is {limit:.2} rad: ")?;
        match self.cause {
            Cause::LateSync { velocity } => write!(
                f,
                "at {velocity:.0} rad/s of the motor, and with SYNC behind the frames of emulated_load. Give following_error \
                 at least {error:.2} rad, or move slower"
            ),
            Cause::Weight { torque } => write!(
                f,
                "its loop takes over a weight and a friction of {torque:.2} N·m when the brakes open. Raise velocity_gain, or \
                 give following_error at least {:.2} rad",
                error / SAGS
            ),
        }
    }
}

/// The axes of a robot that may lag behind more than their limits permit. `fastest` has the greatest velocities of the
/// motors, rad/s. `heaviest` has the greatest weights at the motors, N·m.
pub(crate) fn of(file: &CellFile, robot: usize, fastest: &Axes, heaviest: &Axes) -> Vec<Lag> {
    let cell = &file.cell;
    let period = cell.period();
    let lag = |number: usize| {
        let axis = &cell.robot[robot].axis[number];
        let (error, share, cause) = match axis.loop_plant(period) {
            None => {
                let bus = cell.bus.iter().find(|bus| bus.name == axis.bus)?;
                axis.drive.as_ref().filter(|_| bus.emulated_load > 0.0)?;
                let velocity = fastest[number];
                let lost = velocity * (STANDS / period.as_secs_f64()).min(1.0);
                (lost / AmplifierConfig::POSITION_GAIN, 1.0, Cause::LateSync { velocity })
            }
            Some((plant, law, output)) => {
                let PlantConfig::Physical(motor) = plants::plant(file, robot, number).plant else { return None };
                let torque = heaviest[number] + motor.friction.stiction;
                let needed = match output {
                    Output::Velocity => return None,
                    Output::Torque => torque,
                    Output::Duty => torque * motor.resistance / (motor.torque_constant * AxisControllerConfig::SUPPLY),
                };
                (plant.sag(&law, needed)?, SAGS, Cause::Weight { torque })
            }
        };
        let limit = axis.following_error;
        (error > share * limit).then_some(Lag { robot, axis: number, error, limit, cause })
    };
    (0..cell.robot[robot].axis.len()).filter_map(lag).collect()
}

/// The warnings of these axes.
pub(crate) fn warnings<'a>(file: &'a CellFile, lags: &'a [Lag]) -> impl Iterator<Item = String> + 'a {
    lags.iter().map(|lag| {
        let robot = &file.cell.robot[lag.robot];
        format!("robot {}: {}", robot.name, robot.naming_axes(lag))
    })
}
