//! Phases in which faults strike, and the fixed motion of a robot.

use std::time::Duration;

use controller::robot::Arm;
use mrroc::cell::{Axis, CellFile};
use mrroc::scenario::FaultNumbers;
use servo::{MAX_AXES, Macrostep};

use super::origin::Flaw;

/// Phases of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum FaultPhase {
    /// On and at rest.
    Idle,
    /// Searching for the reference.
    Homing,
    /// Becoming faster.
    Accelerating,
    /// At constant speed.
    Cruising,
    /// Becoming slower.
    Braking,
    /// At constant speed, with one axis against a spring.
    Contact,
    /// At constant speed, in a team with another robot.
    Team,
}

impl FaultPhase {
    /// All phases.
    pub const ALL: [Self; 7] =
        [Self::Idle, Self::Homing, Self::Accelerating, Self::Cruising, Self::Braking, Self::Contact, Self::Team];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Homing => "homing",
            Self::Accelerating => "accelerating",
            Self::Cruising => "cruising",
            Self::Braking => "braking",
            Self::Contact => "contact",
            Self::Team => "team",
        }
    }

    /// Time of the strike after the beginning of the motion, of homing or of standing.
    pub(super) fn strikes_after(self, course: &Course) -> Duration {
        let Course { ramp, cruise, .. } = *course;
        match self {
            Self::Idle => Duration::from_millis(100),
            Self::Homing => Duration::from_millis(400),
            Self::Accelerating => ramp / 2,
            Self::Cruising | Self::Team => ramp + cruise / 2,
            Self::Contact => ramp + cruise * 3 / 4,
            Self::Braking => ramp + cruise + ramp / 2,
        }
    }

    pub(super) fn moves(self) -> bool {
        !matches!(self, Self::Idle | Self::Homing)
    }
}

/// Servo periods of a macrostep.
pub(super) const STEPS: u16 = 10;

/// Times and speed of the fixed motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    /// Duration of acceleration and of braking.
    pub(super) ramp: Duration,
    /// Duration at constant speed.
    pub(super) cruise: Duration,
    /// Share of the greatest velocity of a motor that the motion uses at most.
    speed: f64,
    /// Share of the greatest acceleration that the motion uses at most.
    effort: f64,
    /// Share of the room of a motor that the motion uses at most.
    room: f64,
}

impl Course {
    const USUAL: Self = Self {
        ramp: Duration::from_millis(160),
        cruise: Duration::from_millis(400),
        speed: 0.25,
        effort: 0.4,
        room: 0.4,
    };

    /// The motion with which all motors of the cell reach their greatest speed, as far as their room permits.
    fn fast(file: &CellFile) -> Self {
        let fast = Self { cruise: Duration::from_millis(160), speed: 0.9, effort: 0.6, room: 0.8, ..Self::USUAL };
        let axes = file.cell.robot.iter().flat_map(|robot| &robot.axis);
        let time = |axis: &Axis| fast.speed * axis.max_velocity / (fast.effort * axis.max_acceleration);
        let longest = axes.map(time).fold(fast.ramp.as_secs_f64(), f64::max).min(LONGEST_RAMP);
        // Whole macrosteps.
        let step = file.cell.period() * u32::from(STEPS);
        let steps = (longest / step.as_secs_f64()).ceil() as u32;
        Self { ramp: step * steps, ..fast }
    }

    /// The usual motion. If the first motor is slow, the motion takes longer: after the strike of a row of contact, the
    /// motor needs time to reach an obstacle and to lag by its following error.
    fn usual(file: &CellFile) -> Self {
        let Self { ramp, cruise, speed, effort, .. } = Self::USUAL;
        let Some(axis) = file.cell.robot.first().and_then(|robot| robot.axis.first()) else { return Self::USUAL };
        let ramp = ramp.as_secs_f64();
        let velocity = (speed * axis.max_velocity).min(effort * axis.max_acceleration * ramp);
        let way = FaultNumbers::default().distance + 2.0 * axis.following_error;
        let needed = (4.0 * (way / velocity - 0.5 * ramp)).clamp(cruise.as_secs_f64(), LONGEST_CRUISE);
        // Whole macrosteps.
        let step = file.cell.period() * u32::from(STEPS);
        let steps = ((needed - cruise.as_secs_f64()) / step.as_secs_f64()).ceil() as u32;
        Self { cruise: cruise + step * steps, ..Self::USUAL }
    }

    /// Additional time at constant speed, compared with the usual motion.
    pub(super) fn longer(&self) -> Duration {
        self.cruise.saturating_sub(Self::USUAL.cruise)
    }

    pub(super) fn of(file: &CellFile, at_top_speed: bool) -> Self {
        if at_top_speed { Self::fast(file) } else { Self::usual(file) }
    }
}

/// Longest ramp of a motion at top speed, s.
const LONGEST_RAMP: f64 = 0.8;

/// Longest time at constant speed, s.
const LONGEST_CRUISE: f64 = 2.0;

/// The fixed motion of a robot: all motors accelerate, move at constant speed and brake at the same times, away from
/// the nearer end of their range.
#[derive(Clone, Debug)]
pub(super) struct FixedMotion {
    from: [f64; MAX_AXES],
    /// Velocity at constant speed, rad/s.
    pub(super) velocity: [f64; MAX_AXES],
    period: f64,
    course: Course,
    sent: u64,
    first: u64,
    end: Option<End>,
}

/// End of the motion by its generator. The last macrostep is the first that begins after a time, and lasts one period.
#[derive(Clone, Copy, Debug)]
struct End {
    /// Time, s.
    after: f64,
    /// Axis whose position is wrong by this much, rad or NaN, in the last macrostep; `None` without this macrostep.
    wrong: Option<(usize, f64)>,
}

impl FixedMotion {
    /// The motion of robot `robot` from `from`, rad of the motors.
    pub(super) fn of(file: &CellFile, robot: usize, from: [f64; MAX_AXES], first: u64, course: Course) -> Self {
        let ramp = course.ramp.as_secs_f64();
        let way = ramp + course.cruise.as_secs_f64();
        let arm: &Arm = &file.arms[robot];
        let mut velocity = [0.0; MAX_AXES];
        for (number, axis) in file.cell.robot[robot].axis.iter().enumerate() {
            let (low, high) = range(file, robot, number);
            let (up, down) = (high - from[number], from[number] - low);
            let sign = if up >= down { 1.0 } else { -1.0 };
            let Course { speed, effort, room, .. } = course;
            let most = [speed * axis.max_velocity, effort * axis.max_acceleration * ramp, room * up.max(down) / way];
            velocity[number] = sign * most.into_iter().fold(f64::INFINITY, f64::min);
        }
        // A mechanism with closed loops takes no arbitrary motor positions.
        for _ in 0..8 {
            let end = std::array::from_fn(|axis| from[axis] + velocity[axis] * way);
            if arm.joints(&end).is_ok_and(|joints| arm.motors(&joints).is_ok()) {
                break;
            }
            velocity.iter_mut().for_each(|velocity| *velocity *= 0.5);
        }
        Self { from, velocity, period: file.cell.period().as_secs_f64(), course, sent: 0, first, end: None }
    }

    /// Ends the motion of robot `robot` with a wrong macrostep of `axis`, the first that begins later than `after`. All
    /// motors of a team need macrosteps of one length: see [`cut`](Self::cut) for the partners.
    pub(super) fn spoil(&mut self, file: &CellFile, robot: usize, axis: usize, after: Duration, flaw: Flaw) {
        let given = &file.cell.robot[robot].axis[axis];
        let forwards = 1f64.copysign(self.velocity[axis]);
        let wrong = match flaw {
            Flaw::NotANumber => Some(f64::NAN),
            Flaw::Position => {
                let (low, high) = range(file, robot, axis);
                Some(forwards * (high - low))
            }
            Flaw::Velocity => Some(forwards * 2.0 * given.max_velocity * self.period),
            Flaw::Acceleration => Some(forwards * 2.0 * given.max_acceleration * self.period.powi(2)),
            Flaw::Absent => None,
        };
        self.end = Some(End { after: after.as_secs_f64(), wrong: wrong.map(|by| (axis, by)) });
    }

    /// Ends the motion with a macrostep of one period, the first that begins later than `after`.
    pub(super) fn cut(&mut self, after: Duration) {
        self.end = Some(End { after: after.as_secs_f64(), wrong: Some((0, 0.0)) });
    }

    /// The next macrostep; `None` at the end of the motion.
    pub(super) fn next(&mut self) -> Option<Macrostep> {
        let (ramp, cruise) = (self.course.ramp.as_secs_f64(), self.course.cruise.as_secs_f64());
        let step = self.period * f64::from(STEPS);
        if self.sent as f64 * step >= 2.0 * ramp + cruise - 1e-9 {
            return None;
        }
        let begin = self.sent as f64 * step;
        let end = self.end.filter(|end| begin > end.after + 1e-9);
        if let Some(End { wrong, .. }) = end {
            self.end = Some(End { after: f64::NEG_INFINITY, wrong: None });
            let (axis, by) = wrong?;
            let mut last = self.step(begin + self.period, 1);
            last.position[axis] += by;
            return Some(last);
        }
        Some(self.step((self.sent + 1) as f64 * step, STEPS))
    }

    /// The next macrostep, which ends at `t`, s, after `steps` periods.
    fn step(&mut self, t: f64, steps: u16) -> Macrostep {
        let (ramp, cruise) = (self.course.ramp.as_secs_f64(), self.course.cruise.as_secs_f64());
        self.sent += 1;
        // Way and velocity, in units of the velocity at constant speed.
        let (way, share) = if t < ramp {
            (0.5 * t * t / ramp, t / ramp)
        } else if t < ramp + cruise {
            (t - 0.5 * ramp, 1.0)
        } else {
            let left = (2.0 * ramp + cruise - t).max(0.0);
            (ramp + cruise - 0.5 * left * left / ramp, left / ramp)
        };
        Macrostep {
            number: self.first + self.sent,
            steps,
            report_at: steps,
            position: std::array::from_fn(|axis| self.from[axis] + self.velocity[axis] * way),
            velocity: self.velocity.map(|velocity| velocity * share),
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: None,
            continues_law: false,
        }
    }
}

/// Position limits of a motor, rad.
fn range(file: &CellFile, robot: usize, axis: usize) -> (f64, f64) {
    let range = file.arms[robot].robot().motor_limits()[axis];
    let given = &file.cell.robot[robot].axis[axis];
    let low = given.min_position.map_or(range.low, |low| low.max(range.low));
    let high = given.max_position.map_or(range.high, |high| high.min(range.high));
    (low, high)
}
