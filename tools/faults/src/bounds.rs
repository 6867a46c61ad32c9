//! Bounds of a row: time to the detection, and distance of each motor.

use std::time::Duration;

use mrroc::cell::{Axis, CellFile};
use mrroc::scenario::FaultKind;
use servo::MAX_AXES;

use super::catalogue::FaultCase;
use super::origin::{Origin, contact_delay};
use super::phase::{FaultPhase, STEPS};

/// Declared time from a fault to its detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Within {
    /// The missing answers that the cell tolerates, and four periods.
    Answers,
    /// The same. The wire is cut, so a drive on CAN stops by itself after three heartbeats of the host.
    Cut,
    /// Cycles over which missing and late answers of a serial line are counted; two such windows at rest.
    Window,
    /// Four periods of the heartbeat.
    Heartbeat,
    /// The following error grows to its limit.
    Error,
    /// The same. Until then, the loop of the drive accelerates the motor.
    Lost,
    /// The same, and the motor loses at least a fifth of its speed. In homing, it moves on along its search until then.
    Slowed,
    /// The arm falls within the watch of the brakes, and its motor catches it.
    Fall,
    /// This time.
    Time(Duration),
    /// The deadlines missed in a row, one more than the cell tolerates, and the next cycle.
    Deadlines,
    /// The share of missed deadlines is judged at the end of each window of deadlines. Too few deadlines may be left in the
    /// window of the fault, so the bound is two windows.
    Share,
    /// The opening of the contact of the emergency stop reaches the host.
    Contact,
    /// The wrong macrostep begins after the present one. Four periods are added.
    Macrostep,
}

/// Cycles of a window of answers, and ten more.
const WINDOW: u32 = 210;

/// Margin of the bound of the distance for the loops of the drives.
const MARGIN: f64 = 1.1;

/// Acceleration of a motor whose loop is lost, as a multiple of its greatest permitted acceleration. The motor accelerates
/// over its permitted following error, and runs out over this multiple of the error.
const LOST: f64 = 8.0;

/// Bounds of a row: time to the detection, and distance of each motor, rad.
pub(super) struct Bounds {
    pub(super) detection: Duration,
    pub(super) distance: [f64; MAX_AXES],
}

/// Time from the detection of a brake that does not hold to the torque of the motor: a drive on CAN passes three states,
/// each with the answer to its controlword.
const CATCHING: f64 = 0.040;

/// Distance of a motor that falls, rad, until it is caught: the `limit` of the watch, the way until the motor has torque,
/// and the way in which it brakes. Its weight accelerates the motor by at most half of its greatest `acceleration`, rad/s²,
/// because the motor must accelerate upwards as well.
fn fall(limit: f64, acceleration: f64) -> f64 {
    let weight = 0.5 * acceleration;
    let seen = (2.0 * weight * limit).sqrt();
    let caught = seen + weight * CATCHING;
    limit + (seen + caught) / 2.0 * CATCHING + caught * caught / (2.0 * weight)
}

/// Missing answers that the bus or the lines of an axis tolerate.
fn tolerated_missing(file: &CellFile, axis: &Axis) -> u32 {
    let cell = &file.cell;
    let bus = cell.bus.iter().find(|bus| bus.name == axis.bus).map(|bus| bus.tolerated_missing);
    let bundle = cell.serial.iter().find(|serial| serial.name == axis.bus).map(|serial| serial.tolerated_missing);
    bus.or(bundle).unwrap_or(0)
}

/// Error of two displacements of a counter from rounding, increments.
const ROUNDING: f64 = 4.0;

/// Smallest step of the counter, increments, that the plausibility check finds while a motor moves at `speed`, rad/s. The page
/// of faults states it: the plausible acceleration in a period, the way in the longest delay, and four increments.
pub(super) fn smallest_step(file: &CellFile, axis: &Axis, speed: f64) -> f64 {
    let acceleration = match axis.drive {
        Some(_) => axis.drive_config(0.0).plausible_acceleration,
        None => axis.controller_config(0.0).max_acceleration,
    };
    let period = file.cell.period().as_secs_f64();
    let latest = f64::from(tolerated_missing(file, axis) + 2) * period;
    axis.scale(0.0).increments_per_radian().abs() * (acceleration * period * period + latest * speed) + ROUNDING
}

/// Smallest steps of the counter of one axis, rad of the motor.
#[derive(Clone, Debug)]
pub(super) struct SmallestSteps {
    pub(super) axis: String,
    pub(super) at_rest: f64,
    pub(super) at_max_velocity: f64,
}

impl SmallestSteps {
    /// Those of all axes of a robot.
    pub(super) fn of(file: &CellFile, robot: usize) -> impl Iterator<Item = Self> {
        let robot = &file.cell.robot[robot];
        robot.axis.iter().map(|axis| {
            let step = |speed| smallest_step(file, axis, speed) / axis.scale(0.0).increments_per_radian().abs();
            let name = format!("{}.{}", robot.name, axis.name);
            Self { axis: name, at_rest: step(0.0), at_max_velocity: step(axis.max_velocity) }
        })
    }
}

impl FaultCase {
    /// Declared bounds on robot 0 of a cell whose motors move at `velocity`, rad/s. `detected` is the time of the detection.
    ///
    /// The distance of a motor is the sum of three parts, with a margin. The motor moves on until the detection, and for the
    /// four periods from sample to effect. The stop keeps the path: all motors have the same braking time, which is the
    /// longest one of all axes at their greatest accelerations. Twice the following error is added, for the distances
    /// between motor and set-point at the strike and at the end.
    ///
    /// If the following error detects the fault, this error itself limits the distance of the struck motor until the
    /// detection. In a motion, the other motors follow their set-points until then. The bound of the detection time is
    /// four times the time at constant speed to the limit of the error, and to the obstacle of a collision, plus 50 ms.
    /// For a sagging supply the factor is five, because the motor may keep four fifths of its speed. In homing, this
    /// motor moves on for the detection time, less the following error by which it then lags.
    pub(super) fn bounds(
        &self,
        file: &CellFile,
        axis: usize,
        velocity: &[f64; MAX_AXES],
        phase: FaultPhase,
        detected: Option<Duration>,
    ) -> Bounds {
        let cell = &file.cell;
        let robot = &cell.robot[0];
        let name = &robot.axis[axis].bus;
        let bus = cell.bus.iter().find(|bus| bus.name == *name);
        let answers = cell.period() * (tolerated_missing(file, &robot.axis[axis]) + 4);
        let silence = Duration::from_millis(4 * bus.map_or(100, |bus| u64::from(bus.heartbeat_ms)));
        let obstacle =
            if self.origin == Origin::Emulated(FaultKind::Collision) { self.numbers().distance } else { 0.0 };
        let error = robot.axis[axis].following_error;
        let at_speed = |way: f64| Duration::from_secs_f64(way / velocity[axis].abs());
        let both = |time| (time, time);
        let (detection, blind) = match self.within {
            Within::Answers => both(answers),
            Within::Cut => (answers, bus.map_or(answers, |bus| Duration::from_millis(3 * u64::from(bus.heartbeat_ms)))),
            Within::Window => both(cell.period() * if phase == FaultPhase::Idle { 2 * WINDOW } else { WINDOW }),
            Within::Heartbeat => both(silence),
            Within::Error | Within::Lost => {
                (at_speed(4.0 * (obstacle + error)) + Duration::from_millis(50), Duration::ZERO)
            }
            Within::Slowed => {
                let detection = at_speed(5.0 * error) + Duration::from_millis(50);
                (detection, if phase == FaultPhase::Homing { detection - at_speed(error) } else { Duration::ZERO })
            }
            Within::Time(time) => both(time),
            Within::Fall => (Duration::from_millis(1500), Duration::ZERO),
            Within::Deadlines => both(cell.period() * cell.max_missed_in_row.saturating_add(2)),
            Within::Share => {
                let detection = cell.period() * (2 * 1000.max(cell.max_missed_in_row.saturating_mul(16)));
                // A robot at rest moves no farther.
                (detection, if phase == FaultPhase::Homing { detection } else { Duration::ZERO })
            }
            Within::Contact => both(contact_delay(cell.period())),
            Within::Macrostep => both(cell.period() * (u32::from(STEPS) + 4)),
        };
        // At rest and in homing, the other motors stand.
        let is_of_error = phase.moves() && matches!(self.within, Within::Error | Within::Lost | Within::Slowed);
        let follows = detected.unwrap_or_default().min(detection).max(blind);
        let [blind, follows] = [blind, follows].map(|time| (time + 4 * cell.period()).as_secs_f64());
        let times = robot.axis.iter().zip(velocity).map(|(axis, speed)| speed.abs() / axis.max_acceleration);
        let longest = times.fold(0.0, f64::max);
        let distance = |number: usize| {
            let speed = velocity[number].abs();
            let given = robot.axis.get(number)?;
            // In homing, the axes move one after the other.
            let braking = match phase {
                FaultPhase::Homing => speed * speed / (2.0 * given.max_acceleration),
                _ => speed * longest / 2.0,
            };
            let blind = if is_of_error && number != axis { follows } else { blind };
            let lost = if number == axis && self.within == Within::Lost { LOST * given.following_error } else { 0.0 };
            let fall =
                if self.within == Within::Fall { fall(given.following_error, given.max_acceleration) } else { 0.0 };
            Some(MARGIN * (speed * blind + braking + lost + fall + 2.0 * given.following_error))
        };
        Bounds { detection, distance: std::array::from_fn(|number| distance(number).unwrap_or(f64::INFINITY)) }
    }
}
