//! Motion of an effector: macrosteps in sequence, interpolated and checked.

use super::{Effector, Tick};
use crate::axis::ServoAxis;
use crate::interpolate::{Segment, Start};
use crate::motion_time::Bounds;
use crate::{Knot, Macrostep, Order, ServoEvent, ServoState, StopCause};

/// The axis of a failed check, if the check concerns a single axis, and the cause of the stop.
pub(super) type Failed = (Option<usize>, StopCause);

impl Effector {
    /// Interpolates, begins the next macrostep if `begin`, and stops on an error. The new set-points are only
    /// [taken](Self::take_set_points) after all effectors have found theirs.
    pub(crate) fn follow_macrosteps(&mut self, begin: bool, tick: &Tick) {
        if self.state != ServoState::Moving && !begin {
            return;
        }
        self.decided = true;
        match self.try_follow(begin, tick) {
            Ok(()) => {}
            Err((axis, StopCause::Touched)) => self.stop_as_intended(tick, axis, StopCause::Touched),
            Err((axis, cause)) => self.fail(tick, axis, cause),
        }
    }

    /// Takes the set-points found in this cycle. A stop of this cycle replaces them by its own.
    pub(super) fn take_set_points(&mut self) {
        if self.is_braking() && self.stop.advance() {
            self.place_stop();
        }
        if let Some(segment) = self.segment.as_ref().filter(|_| self.state == ServoState::Moving) {
            for (index, axis) in self.axes.iter_mut().enumerate() {
                axis.knot = self.next[index];
                axis.torque = segment.torque(index);
            }
        }
    }

    /// Whether the effector stands, or its macrostep ends in this cycle.
    pub(super) fn is_at_boundary(&self, tick: &Tick) -> bool {
        let ends = |segment: &Segment| segment.excess(tick.motion.periods).is_some();
        let moving = self.state == ServoState::Moving && self.segment.as_ref().is_none_or(ends);
        self.state == ServoState::Standing || moving
    }

    /// Whether the macrostep ends in this cycle while an axis moves.
    pub(crate) fn runs_out_in_motion(&self, tick: &Tick) -> bool {
        self.is_at_boundary(tick) && self.axis_in_motion().is_some()
    }

    /// The first axis that moves at the end of the macrostep.
    fn axis_in_motion(&self) -> Option<usize> {
        self.segment.as_ref().and_then(|segment| segment.ends_in_motion(self.axes.len()))
    }

    /// Stops an effector that has no next macrostep, while it or a partner moves.
    pub(crate) fn starve(&mut self, tick: &Tick) {
        self.decided = true;
        self.fail(tick, self.axis_in_motion(), StopCause::Starved { last: self.macrostep });
    }

    /// Bounds of the rate of motion time, by the limits of the axes. The bounds include effectors at rest, because they
    /// may begin to move before a change of the rate has ended.
    pub(crate) fn rate_bounds(&self, rate: f64) -> Bounds {
        let segment = self.segment.as_ref().filter(|_| self.state == ServoState::Moving);
        let bounds = |(index, axis): (usize, &ServoAxis)| {
            let ahead = |periods| segment.map_or_else(Knot::default, |segment| segment.ahead(index, periods));
            let after = |periods| Bounds::of_axis(ahead(periods), rate, &axis.config);
            // The planned acceleration may change during the next cycle, so the bounds include the next two periods.
            after(0.0).within(after(1.0)).within(after(2.0))
        };
        self.axes.iter().enumerate().map(bounds).fold(Bounds::NONE, Bounds::within)
    }

    fn try_follow(&mut self, begin: bool, tick: &Tick) -> Result<(), Failed> {
        let mut periods = tick.motion.periods;
        let excess = self.segment.as_ref().and_then(|segment| segment.excess(periods));
        if begin {
            self.begin(tick);
            periods = excess.unwrap_or(periods);
        } else if excess.is_some() {
            self.run_out(tick)?;
        }
        let Some(segment) = &mut self.segment else {
            return Ok(());
        };
        self.due |= segment.advance(periods, tick.motion.most_next(tick.dt));
        for (index, next) in self.next[..self.axes.len()].iter_mut().enumerate() {
            *next = tick.motion.slow(segment.at(index));
        }
        self.displace(tick)?;
        for (index, (axis, next)) in self.axes.iter().zip(&self.next).enumerate() {
            axis.vet(next.position, tick.dt).map_err(|cause| (Some(index), cause))?;
        }
        Ok(())
    }

    /// Ends a motion whose last macrostep ends at rest.
    fn run_out(&mut self, tick: &Tick) -> Result<(), Failed> {
        if !self.segment.as_ref().is_some_and(Segment::is_over) {
            return Ok(());
        }
        // A macrostep may end with zero velocity and still arrive with a last step that is too fast.
        for index in 0..self.axes.len() {
            let axis = &self.axes[index];
            match axis.vet(axis.knot.position, tick.dt) {
                Ok(()) => {}
                // The law still moves the effector.
                Err(_) if self.is_displaced() => {
                    self.settling = true;
                    self.apply(tick, ServoEvent::Stop);
                    // The partners of a team have ended their motion too.
                    self.stopped = false;
                    return Ok(());
                }
                Err(cause) => return Err((Some(index), cause)),
            }
        }
        if self.is_displaced() {
            self.axes.iter_mut().for_each(|axis| axis.knot = Knot::at_rest(axis.knot.position));
        }
        self.apply(tick, ServoEvent::Done);
        Ok(())
    }

    /// Takes the next macrostep from the queue.
    fn begin(&mut self, tick: &Tick) {
        let Some(Order::Move(macrostep)) = self.pop() else {
            return;
        };
        let told = macrostep.torque.iter().any(|torque| *torque != 0.0);
        if told && self.state == ServoState::Standing {
            // Bumpless transfer: the torque that loops hold since homing or since a stop moves into the feed-forward.
            self.axes.iter_mut().zip(macrostep.torque).for_each(|(axis, torque)| axis.hand_over(torque));
        }
        let displaced = self.continue_law(&macrostep);
        let start = self.segment.as_ref().map_or_else(
            || {
                let mut knots = self.each(|axis| Knot::new(axis.knot.position, axis.knot.velocity));
                knots.iter_mut().zip(displaced).for_each(|(knot, by)| knot.position -= by);
                Start { knots, torque: self.each(|axis| axis.torque) }
            },
            Segment::end,
        );
        // Motion time may pass the end of a macrostep and the period of its report in one cycle.
        self.news |= self.segment.as_ref().is_some_and(|segment| !segment.is_reported());
        self.apply(tick, ServoEvent::Move);
        self.macrostep = macrostep.number;
        self.counters.macrosteps += 1;
        self.begin_with_team(macrostep.number);
        self.segment = Some(Segment::new(macrostep, start, tick.dt));
    }

    /// Whether the next macrostep can be begun. The effector is stopped if not.
    pub(crate) fn admit_next(&mut self, tick: &Tick) -> bool {
        let admitted = self.next_macrostep(tick).map_or(Ok(()), |macrostep| self.admit(macrostep));
        let Err((axis, cause)) = admitted else {
            return true;
        };
        self.refuse_next(tick, axis, cause);
        false
    }

    /// Drops the next macrostep, and stops the effector.
    pub(crate) fn refuse_next(&mut self, tick: &Tick, axis: Option<usize>, cause: StopCause) {
        self.pop();
        self.decided = true;
        self.fail(tick, axis, cause);
    }

    fn admit(&self, macrostep: &Macrostep) -> Result<(), Failed> {
        let number = macrostep.number;
        self.admit_law(macrostep).map_err(|cause| (None, cause))?;
        if !(1..=macrostep.steps).contains(&macrostep.report_at) {
            return Err((None, StopCause::Malformed { number }));
        }
        let in_team = self.team.next_number();
        if let Some(expected) = in_team.filter(|expected| *expected != number) {
            return Err((None, StopCause::OutOfSequence { number, expected }));
        }
        for (index, axis) in self.axes.iter().enumerate() {
            let Macrostep { position, velocity, acceleration, torque, .. } = macrostep;
            let acceleration = acceleration.map_or(0.0, |acceleration| acceleration[index]);
            let asked = [position[index], velocity[index], acceleration, torque[index]];
            if !asked.iter().all(|value| value.is_finite()) {
                return Err((Some(index), StopCause::NotFinite));
            }
            if !axis.is_homed() {
                return Err((Some(index), StopCause::NotHomed));
            }
        }
        Ok(())
    }
}
