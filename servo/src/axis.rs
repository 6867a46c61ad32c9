//! One axis as its servo knows it: what its drive says, and what was commanded when.

use drive::{AxisCommand, AxisState, Finite, Homing, Power, Setpoint};

use crate::{Knot, ServoAxisConfig, StopCause, TrackingError, limit};

/// Commands remembered per axis; a sample older than that is compared with the oldest.
const REMEMBERED: usize = 16;

/// Share of its greatest velocity below which a motor counts as still.
const STILL: f64 = 0.01;

/// An axis.
pub(crate) struct Axis {
    pub(crate) config: ServoAxisConfig,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) of its group.
    delay: usize,
    /// What the drive says.
    pub(crate) state: AxisState,
    /// The set-point of this cycle.
    pub(crate) knot: Knot,
    /// Positions commanded, the newest first.
    commanded: [f64; REMEMBERED],
    /// Cycles in a row in which the drive was told to follow.
    followed: usize,
    /// It searched for its reference in this homing.
    pub(crate) searched: bool,
    pub(crate) command: AxisCommand,
    pub(crate) tracking: TrackingError,
    reference: ReferenceWatch,
}

impl Axis {
    pub(crate) fn new(config: ServoAxisConfig, delay: usize) -> Self {
        Self {
            config,
            delay,
            state: AxisState::default(),
            knot: Knot::default(),
            commanded: [0.0; REMEMBERED],
            followed: 0,
            searched: false,
            command: AxisCommand::Off,
            tracking: TrackingError::default(),
            reference: ReferenceWatch::default(),
        }
    }

    /// Takes what the drive says; `dt` is the period, s.
    pub(crate) fn observe(&mut self, state: AxisState, dt: f64) {
        self.state = state;
        self.reference
            .observe(&state, self.config.max_acceleration, dt);
    }

    /// A search for the reference begins.
    pub(crate) fn begin_homing(&mut self) {
        self.searched = false;
        self.reference = ReferenceWatch::default();
    }

    /// What the counter showed at the reference before it was set there; `None` without a search.
    pub(crate) fn homing_offset(&self) -> Option<i64> {
        self.searched.then_some(self.reference.offset)
    }

    /// Whether the drive, by a sample taken under a set-point of ours, follows set-points.
    pub(crate) fn follows(&self) -> bool {
        self.is_watched() && self.state.following && self.state.power == Power::On
    }

    /// Takes the measured position as the commanded one, so that following begins without a jump.
    pub(crate) fn capture(&mut self) {
        self.knot = Knot {
            position: self.state.position,
            velocity: 0.0,
        };
        self.commanded = [self.state.position; REMEMBERED];
    }

    /// Takes the motor for standing at the last set-point.
    pub(crate) fn rest(&mut self) {
        self.knot.velocity = 0.0;
        self.commanded[1] = self.commanded[0];
    }

    /// The last position sent and the step to it.
    pub(crate) fn last_step(&self, dt: f64) -> Knot {
        let [last, before_last, ..] = self.commanded;
        Knot {
            position: last,
            velocity: (last - before_last) / dt,
        }
    }

    /// Whether `position` may be commanded next.
    pub(crate) fn vet(&self, position: f64, dt: f64) -> Result<(), StopCause> {
        let [last, before_last, ..] = self.commanded;
        limit::check(&self.config.limits(), before_last, last, position, dt)
    }

    /// Whether a sample taken under a set-point of ours is there. A drive that then does not follow
    /// is none the less watched: the growing error is how it shows.
    pub(crate) fn is_watched(&self) -> bool {
        self.followed >= self.delay
    }

    /// Commanded minus measured, rad, for the command that the sample shows the effect of.
    pub(crate) fn error(&self) -> f64 {
        // This cycle's command is not in `commanded` yet, so the newest there is one period old.
        let age = (self.delay - 1)
            .saturating_add(self.state.age as usize)
            .min(REMEMBERED - 1);
        self.commanded[age] - self.state.position
    }

    pub(crate) fn is_homed(&self) -> bool {
        self.state.homing == Homing::Attained
    }

    pub(crate) fn is_still(&self) -> bool {
        self.state.velocity.abs() <= STILL * self.config.max_velocity
    }

    /// Keeps `command` for the write and remembers the set-point.
    pub(crate) fn command(&mut self, command: AxisCommand) {
        let follows = matches!(command, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        self.followed = if follows {
            self.followed.saturating_add(1)
        } else {
            0
        };
        self.commanded.rotate_right(1);
        self.commanded[0] = self.knot.position;
        self.command = command;
    }

    /// Turns the set-point into what its drive is to follow.
    ///
    /// Drives that close the position loop get the position as it is; a loop closed here, for
    /// velocity or torque, belongs in this place.
    pub(crate) fn regulate(&self) -> AxisCommand {
        match Finite::new(self.knot.position) {
            Some(position) => AxisCommand::Follow(Setpoint::Position(position)),
            // Only a measured position taken over can be it; such an axis never settles, and the
            // time-out of what it settles for names it.
            None => AxisCommand::Off,
        }
    }
}

/// Sees a drive set its counter at the reference: the greatest step during a search that no motor can make.
#[derive(Clone, Copy, Debug, Default)]
struct ReferenceWatch {
    /// The last sample and the one before.
    last: Option<(f64, i64)>,
    before_last: Option<(f64, i64)>,
    searching: bool,
    /// The step, increments. Samples that came early or late make steps too, but smaller ones.
    offset: i64,
}

impl ReferenceWatch {
    /// A step is the counter's own if the motor would need this many times its greatest acceleration.
    const IMPOSSIBLE: f64 = 4.0;

    fn observe(&mut self, state: &AxisState, max_acceleration: f64, dt: f64) {
        // The sample that tells of success may be the first one after the step.
        let searched = std::mem::replace(&mut self.searching, state.homing == Homing::InProgress);
        if state.age > 0 {
            (self.last, self.before_last) = (None, None);
            return;
        }
        let sample = (state.position, i64::from(state.increments.0));
        if let (Some(last), Some(before_last)) = (self.last, self.before_last) {
            let expected = (2.0 * last.0 - before_last.0, 2 * last.1 - before_last.1);
            let step = (sample.0 - expected.0).abs();
            if (searched || self.searching) && step > Self::IMPOSSIBLE * max_acceleration * dt * dt
            {
                let counts = expected.1 - sample.1;
                if counts.abs() > self.offset.abs() {
                    self.offset = counts;
                }
                // Samples from before the step are of another count.
                self.last = None;
            }
        }
        self.before_last = self.last;
        self.last = Some(sample);
    }
}

#[cfg(test)]
mod tests {
    use drive::Increments;

    use super::*;

    const COUNTS: f64 = 4000.0 / std::f64::consts::TAU;

    /// What the watch makes of samples of homing state and counts, a period of 2 ms apart.
    fn offset(samples: &[(Homing, i32)]) -> i64 {
        let mut watch = ReferenceWatch::default();
        for &(homing, counts) in samples {
            let state = AxisState {
                position: f64::from(counts) / COUNTS,
                increments: Increments(counts),
                homing,
                ..AxisState::default()
            };
            watch.observe(&state, 1500.0, 0.002);
        }
        watch.offset
    }

    #[test]
    fn the_step_to_the_reference_is_the_offset_and_jitter_is_not() {
        use Homing::{Attained, InProgress};
        let search = [(InProgress, -100), (InProgress, -96), (InProgress, -92)];
        let home = [(Attained, 4), (Attained, 4), (Attained, 4)];
        assert_eq!(offset(&[&search[..], &home].concat()), -92);
        // Two periods' way in one: the sample was taken late.
        let late = [(InProgress, -140), (InProgress, -120), (InProgress, -80)];
        assert_eq!(offset(&[&late[..], &search, &home].concat()), -92);
        let fast = [(Attained, 100), (Attained, 200), (Attained, 400)];
        assert_eq!(offset(&[&search[..], &home, &fast].concat()), -92);
    }
}
