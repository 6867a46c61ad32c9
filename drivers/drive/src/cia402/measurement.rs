//! The motion of one axis as its drive reports it, and the plausibility check of each position.

use std::time::Duration;

use can::Instant;

use super::config::{AxisConfig, GroupConfig};
use crate::step_check::{StepBounds, StepCheck};
use crate::{AxisState, Fault, Increments, Scale};

/// Greatest error of a displacement from rounding both positions, increments.
pub(super) const ROUNDING: f64 = 2.0;

/// Shortest time, periods, that the check allows for a displacement.
///
/// Answers delayed by the bus or an adapter arrive in a burst. All answers of a burst are taken for samples of the
/// last SYNC. Two successive ones are a period apart in fact, or two periods where the answer between them is lost.
pub(super) const SHORTEST: u32 = 2;

/// Position and velocity of the last plausible sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measurement {
    node: u8,
    scale: Scale,
    /// Greatest possible speed of the motor, increments/s.
    fastest: f64,
    /// Shortest time that the check allows for a displacement.
    shortest: Duration,
    increments: Increments,
    /// The last position as the drive counts it, plausible or not.
    pub(super) reported: Increments,
    velocity: f64,
    steps: StepCheck,
    /// Time at which the SYNC of that sample was sent.
    sampled: Option<Instant>,
}

impl Measurement {
    /// A motor at `increments` before the first answer.
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig, increments: Increments) -> Self {
        let scale = axis.scale;
        let steps = StepBounds {
            max_acceleration: axis.plausible_acceleration * scale.increments_per_radian().abs(),
            latest: group.period.as_secs_f64() * f64::from(group.tolerated_missing.saturating_add(SHORTEST)),
        };
        Self {
            node: axis.node.raw(),
            scale,
            fastest: axis.plausible_velocity * scale.increments_per_radian().abs(),
            shortest: SHORTEST * group.period,
            increments,
            reported: increments,
            velocity: 0.0,
            steps: StepCheck::new(steps),
            sampled: None,
        }
    }

    /// Takes the position sampled by the SYNC sent at `sampled` and received at `at`. `search_speed` is given during a
    /// search for the reference. A jump is refused and returned as a fault: position and velocity keep their values. A
    /// step in motion that the last two answers confirm is returned as a fault too; the position is taken.
    ///
    /// Velocity is the difference of two positions over the time between the SYNCs that sampled them. That time is
    /// longer than a period where an answer or a cycle was missed. The resolution is one increment per period.
    ///
    /// Both SYNCs may have reached the drive late. The longest time that may have passed for the motor is therefore
    /// the time from sending the first SYNC to receiving the second answer. No delay of the host or of the bus looks
    /// like a jump.
    pub(super) fn take(
        &mut self,
        position: Increments,
        sampled: Instant,
        at: Instant,
        search_speed: Option<f64>,
    ) -> Result<(), Fault> {
        self.reported = position;
        let mut step = None;
        if let Some(before) = self.sampled {
            let moved = position.0.wrapping_sub(self.increments.0);
            let dt = sampled.since(before).as_secs_f64();
            let within = at.since(before).max(self.shortest);
            let most = self.fastest * within.as_secs_f64() + ROUNDING;
            // During a search, the drive sets the counter.
            if search_speed.is_none() && f64::from(moved).abs() > most {
                self.steps.forget();
                return Err(Fault::Implausible { node: self.node, moved, most: most as u32, within });
            }
            step = self.steps.take(position.0, dt);
            let per_radian = self.scale.increments_per_radian();
            let way = f64::from(moved) / per_radian;
            let recounted =
                search_speed.is_some_and(|speed| way.abs() > 4.0 * speed * dt + ROUNDING / per_radian.abs());
            if dt > 0.0 && !recounted {
                self.velocity = way / dt;
            }
        }
        // During a search, the drive sets the counter.
        if search_speed.is_some() {
            self.steps.forget();
            step = None;
        }
        self.sampled = Some(sampled);
        self.increments = position;
        step.map_or(Ok(()), |step| {
            let (moved, most, within) = (step.moved, step.most, self.shortest / SHORTEST);
            Err(Fault::Implausible { node: self.node, moved, most, within })
        })
    }

    pub(super) fn tell(&self, state: &mut AxisState) {
        state.increments = self.increments;
        state.position = self.scale.position(self.increments);
        state.velocity = self.velocity;
    }
}
