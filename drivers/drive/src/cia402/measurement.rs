//! The motion of one axis, as the answers of its drive tell it.

use can::Instant;

use crate::{AxisState, Increments, Scale};

/// Position and velocity of the last sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measurement {
    scale: Scale,
    increments: Increments,
    velocity: f64,
    /// When the SYNC was sent that sampled it.
    sampled: Option<Instant>,
}

impl Measurement {
    /// A motor that was at `increments` before the first answer.
    pub(super) fn new(scale: Scale, increments: Increments) -> Self {
        Self {
            scale,
            increments,
            velocity: 0.0,
            sampled: None,
        }
    }

    /// Takes the position that the SYNC sent at `sampled` sampled, `search_speed` during a search for the reference.
    ///
    /// Velocity is the difference of two sampled positions over the time between the SYNCs that sampled
    /// them as they were sent, which is longer than a period where an answer or a cycle was missed.
    /// Its resolution is one increment a period.
    pub(super) fn take(
        &mut self,
        position: Increments,
        sampled: Instant,
        search_speed: Option<f64>,
    ) {
        let dt = self
            .sampled
            .map_or(0.0, |before| sampled.since(before).as_secs_f64());
        if dt > 0.0 {
            let per_radian = self.scale.increments_per_radian();
            let moved = f64::from(position.0.wrapping_sub(self.increments.0)) / per_radian;
            // A search sets the counter anew; a step that no search could move is that, and no motion.
            let recounted = search_speed
                .is_some_and(|speed| moved.abs() > 4.0 * speed * dt + 2.0 / per_radian.abs());
            if !recounted {
                self.velocity = moved / dt;
            }
        }
        self.sampled = Some(sampled);
        self.increments = position;
    }

    /// Says so in `state`.
    pub(super) fn tell(&self, state: &mut AxisState) {
        state.increments = self.increments;
        state.position = self.scale.position(self.increments);
        state.velocity = self.velocity;
    }
}
