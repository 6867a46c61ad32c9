//! The motion of one axis as its drive reports it, and the plausibility check of each position.

use std::time::Duration;

use can::Instant;

use super::setup::Setup;
use crate::{AxisState, Increments, Scale};

/// Most increments that rounding both positions adds to a displacement.
const ROUNDING: f64 = 2.0;

/// Shortest time, periods, that the check allows for a displacement.
///
/// Answers that the bus or an adapter held back arrive in a burst. All answers of a burst are taken for samples of the
/// last SYNC, although a period lies between two of them, and two periods where an answer in between is lost.
const SHORTEST: u32 = 2;

/// Position and velocity of the last sample that was believed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measurement {
    scale: Scale,
    /// Increments/s that the motor cannot exceed.
    fastest: f64,
    /// Least time that the check allows for a displacement.
    shortest: Duration,
    increments: Increments,
    /// The last position reported, believed or not.
    reported: Increments,
    velocity: f64,
    /// When the SYNC was sent that sampled it.
    sampled: Option<Instant>,
}

/// A change of position that the motor cannot have made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Jump {
    /// Increments from the last position believed.
    pub(super) moved: i32,
    /// Most increments that the motor can have moved.
    pub(super) most: u32,
    /// Longest time that the motor can have had.
    pub(super) within: Duration,
}

impl Measurement {
    /// A motor that was at `increments` before the first answer.
    pub(super) fn new(setup: &Setup, increments: Increments) -> Self {
        let Setup { scale, period, .. } = *setup;
        Self {
            scale,
            fastest: setup.plausible_velocity * scale.increments_per_radian().abs(),
            shortest: SHORTEST * period,
            increments,
            reported: increments,
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
    /// Both SYNCs may have reached the drive late. The time from the sending of the first SYNC to the second answer is the
    /// longest time that the motor can have had. No delay of the host or of the bus looks like a jump.
    pub(super) fn take(
        &mut self,
        position: Increments,
        sampled: Instant,
        at: Instant,
        search_speed: Option<f64>,
    ) -> Result<(), Jump> {
        self.reported = position;
        if let Some(before) = self.sampled {
            let moved = position.0.wrapping_sub(self.increments.0);
            let dt = sampled.since(before).as_secs_f64();
            let within = at.since(before).max(self.shortest);
            let most = self.fastest * within.as_secs_f64() + ROUNDING;
            // A search sets the counter anew.
            if search_speed.is_none() && f64::from(moved).abs() > most {
                let most = most as u32;
                return Err(Jump {
                    moved,
                    most,
                    within,
                });
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

    /// The drive's own counter, even where it jumped.
    pub(super) fn reported(&self) -> Increments {
        self.reported
    }

    /// Says so in `state`.
    pub(super) fn tell(&self, state: &mut AxisState) {
        state.increments = self.increments;
        state.position = self.scale.position(self.increments);
        state.velocity = self.velocity;
    }
}
