//! The motion of one axis as its drive reports it, and the plausibility check of each position.

use std::time::Duration;

use can::Instant;

use crate::{AxisState, Increments, Scale};

/// Increments by which rounding at both ends may lengthen a way.
const ROUNDING: f64 = 2.0;

/// Position and velocity of the last sample that was believed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measurement {
    scale: Scale,
    /// Increments/s that the motor cannot exceed.
    fastest: f64,
    increments: Increments,
    velocity: f64,
    /// When the SYNC was sent that sampled it.
    sampled: Option<Instant>,
}

/// A change of position that the motor cannot have made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Jump {
    /// Increments from the last position believed.
    pub(super) moved: i32,
    /// Time since that position, at the most.
    pub(super) within: Duration,
}

impl Measurement {
    /// A motor that was at `increments` before the first answer, and turns at `plausible_velocity`, rad/s, at the most.
    pub(super) fn new(scale: Scale, plausible_velocity: f64, increments: Increments) -> Self {
        Self {
            scale,
            fastest: plausible_velocity * scale.increments_per_radian().abs(),
            increments,
            velocity: 0.0,
            sampled: None,
        }
    }

    /// Takes the position that the SYNC sent at `sampled` sampled and an answer brought at `at`, `search_speed` during a
    /// search for the reference. A jump is not believed: position and velocity stay as they are.
    ///
    /// Velocity is the difference of two positions over the time between the SYNCs that sampled them. That time is longer
    /// than a period where an answer or a cycle was missed. The resolution is one increment a period.
    ///
    /// Both SYNCs may have reached the drive late. From the sending of the first to the second answer is the longest time
    /// that the motor can have had, so that no delay of the host or of the bus looks like a jump.
    pub(super) fn take(
        &mut self,
        position: Increments,
        sampled: Instant,
        at: Instant,
        search_speed: Option<f64>,
    ) -> Result<(), Jump> {
        if let Some(before) = self.sampled {
            let moved = position.0.wrapping_sub(self.increments.0);
            let (dt, within) = (sampled.since(before).as_secs_f64(), at.since(before));
            // A search sets the counter anew.
            let reach = match search_speed {
                Some(_) => f64::INFINITY,
                None => self.fastest * within.as_secs_f64() + ROUNDING,
            };
            if f64::from(moved).abs() > reach {
                return Err(Jump { moved, within });
            }
            let per_radian = self.scale.increments_per_radian();
            let way = f64::from(moved) / per_radian;
            let recounted = search_speed
                .is_some_and(|speed| way.abs() > 4.0 * speed * dt + ROUNDING / per_radian.abs());
            if dt > 0.0 && !recounted {
                self.velocity = way / dt;
            }
        }
        self.sampled = Some(sampled);
        self.increments = position;
        Ok(())
    }

    /// Says so in `state`.
    pub(super) fn tell(&self, state: &mut AxisState) {
        state.increments = self.increments;
        state.position = self.scale.position(self.increments);
        state.velocity = self.velocity;
    }
}
