//! Motion of an axis during identification, and the frequency response from its records.

use std::ops::RangeInclusive;

use drive::{AxisCommand, Setpoint};

use super::{Point, Response, respond, response::opened};
use crate::{Excitation, MAX_AXES, Macrostep, PositionLoop, Record, ServoAxisConfig};

/// Time at constant velocity before the excitation begins, s.
const SETTLING: f64 = 0.5;

/// Motion of one axis: acceleration from rest, constant velocity with excitation, and braking to rest. The other axes
/// stand still.
#[derive(Clone, Debug)]
pub struct Run {
    /// Index of the axis within its effector.
    pub axis: usize,
    /// Initial positions of the axes, rad.
    pub start: [f64; MAX_AXES],
    /// Velocity during the excitation, rad/s.
    pub velocity: f64,
    /// Acceleration and deceleration, rad/s².
    pub acceleration: f64,
    /// One period of the excitation: one value per cycle, over a whole number of macrosteps.
    pub excitation: Vec<f64>,
    /// Number of measured periods. The transient decays in one additional period before them.
    pub periods: usize,
    /// Servo cycles per macrostep.
    pub steps: u16,
    /// Period of the servo, s.
    pub dt: f64,
    /// Period of the drive's control loops, s, for an excitation by a torque offset. The drive holds each torque for
    /// this time.
    pub drive_period: f64,
}

impl Run {
    /// The excitation for [`Servo::excite`](crate::Servo::excite).
    pub fn excitation(&self) -> Excitation {
        Excitation { period: self.excitation.clone(), macrosteps: self.excited() }
    }

    /// The macrostep with this number, counted from 1; `None` for 0 and after the last.
    pub fn macrostep(&self, number: u64) -> Option<Macrostep> {
        if number == 0 || number > self.macrosteps() {
            return None;
        }
        let at = number as f64 * self.macrostep_time();
        let ramp = self.ramp() as f64 * self.macrostep_time();
        let end = self.macrosteps() as f64 * self.macrostep_time();
        let left = end - at;
        let (share, way) = if ramp == 0.0 {
            (0.0, 0.0)
        } else if at < ramp {
            (at / ramp, 0.5 * at * at / ramp)
        } else if left < ramp {
            (left / ramp, end - ramp - 0.5 * left * left / ramp)
        } else {
            (1.0, at - 0.5 * ramp)
        };
        let mut position = self.start;
        position[self.axis] += self.velocity * way;
        let mut velocity = [0.0; MAX_AXES];
        velocity[self.axis] = self.velocity * share;
        Some(Macrostep {
            number,
            steps: self.steps,
            report_at: self.steps,
            position,
            velocity,
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: None,
            continues_law: false,
        })
    }

    /// Number of macrosteps.
    pub fn macrosteps(&self) -> u64 {
        self.excited().end() + self.ramp()
    }

    /// Displacement of the axis over the whole motion, rad, with the sign of the velocity.
    pub fn travel(&self) -> f64 {
        self.velocity * (self.macrosteps() - self.ramp()) as f64 * self.macrostep_time()
    }

    fn excited(&self) -> RangeInclusive<u64> {
        let settled = self.ramp() + (SETTLING / self.macrostep_time()).ceil() as u64;
        let cycles = self.excitation.len() * (self.periods + 1);
        settled + 1..=settled + (cycles / usize::from(self.steps)) as u64
    }

    /// Number of macrosteps of the acceleration, and of the deceleration.
    fn ramp(&self) -> u64 {
        (self.velocity.abs() / self.acceleration / self.macrostep_time()).ceil() as u64
    }

    fn macrostep_time(&self) -> f64 {
        f64::from(self.steps) * self.dt
    }
}

/// Records of an axis since the first nonzero value of its excitation.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    records: Vec<crate::AxisRecord>,
}

impl Trace {
    /// Stores the record of a cycle. Records before the first nonzero excitation are skipped.
    pub fn take(&mut self, record: &Record, axis: usize) {
        let record = record.axis[axis];
        if !self.records.is_empty() || record.excitation != 0.0 {
            self.records.push(record);
        }
    }

    /// Frequency response of the axis at `lines`, multiples of 1 / excitation period; `None` after an interrupted run.
    ///
    /// The response is the open loop if the servo closes the position loop or the drive accepts a torque offset, and
    /// the closed loop otherwise. `delay` is [`DriveGroup::delay`](drive::DriveGroup::delay).
    pub fn response(
        &self,
        run: &Run,
        config: &ServoAxisConfig,
        delay: usize,
        lines: &[usize],
    ) -> Option<(Response, Vec<Point>)> {
        let length = run.excitation.len();
        let measured = length..length * (run.periods + 1);
        let records = self.records.get(measured.clone())?;
        let shown = measured.start + delay..measured.end + delay;
        let (kind, input, output): (_, Vec<f64>, Vec<f64>) = match config.position_loop {
            PositionLoop::Drive if config.torque_offset.is_some() => {
                let samples = self.records.get(shown)?;
                let input: Vec<_> = records.iter().map(|record| record.excitation).collect();
                let left: Vec<_> = samples.iter().map(|sample| sample.torque).collect();
                let taken: Vec<_> = input.iter().zip(&left).map(|(all, left)| all - left).collect();
                let [taken, left] =
                    [taken, left].map(|output| respond(&input, &output, length, lines, run.dt, Response::Closed));
                return Some((Response::Open, opened(&taken, &left, run.dt, run.drive_period)));
            }
            PositionLoop::Drive => {
                let samples = self.records.get(shown)?;
                let beyond = records.iter().zip(samples).map(|(record, sample)| sample.measured - record.commanded);
                let input = records.iter().map(|record| record.excitation);
                (Response::Closed, input.collect(), beyond.collect())
            }
            PositionLoop::Host(_) => {
                let sent = |record: &crate::AxisRecord| match record.command {
                    AxisCommand::Follow(Setpoint::Velocity(it) | Setpoint::Torque(it) | Setpoint::Duty(it)) => {
                        Some(it.get())
                    }
                    _ => None,
                };
                let input = records.iter().map(sent).collect::<Option<Vec<_>>>()?;
                let output = records.iter().zip(&input).map(|(record, sent)| record.excitation - sent).collect();
                (Response::Open, input, output)
            }
        };
        Some((kind, respond(&input, &output, length, lines, run.dt, kind)))
    }
}
