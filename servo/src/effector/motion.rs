//! Motion of an effector: macrosteps in sequence, interpolated and checked.

use super::{Effector, Tick};
use crate::{Knot, MAX_AXES, Macrostep, Order, ServoEvent, ServoState, StopCause, interpolate::Segment};

impl Effector {
    /// Interpolates, starts the next macrostep at the end of each one, and brakes on an error.
    pub(super) fn follow_macrosteps(&mut self, tick: &Tick) {
        if let Err((axis, cause)) = self.try_follow(tick) {
            self.fail(tick, axis, cause);
            if matches!(self.state, ServoState::Braking(_)) && self.stop.advance() {
                self.place_stop();
            }
        }
    }

    fn try_follow(&mut self, tick: &Tick) -> Result<(), (Option<usize>, StopCause)> {
        if self.segment.as_ref().is_none_or(Segment::is_over) {
            self.segment = self.begin(tick)?;
        }
        let Some(segment) = &mut self.segment else {
            return Ok(());
        };
        segment.advance();
        let mut knots = [Knot::default(); MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            let knot = segment.at(index);
            axis.vet(knot.position, tick.dt).map_err(|cause| (Some(index), cause))?;
            knots[index] = knot;
        }
        // The set-points are taken only after all were checked. An effector is never commanded in part.
        for (index, axis) in self.axes.iter_mut().enumerate() {
            axis.knot = knots[index];
            axis.torque = segment.torque(index);
        }
        Ok(())
    }

    /// Takes the next macrostep from the queue; `None` if the last one ended at rest.
    fn begin(&mut self, tick: &Tick) -> Result<Option<Segment>, (Option<usize>, StopCause)> {
        self.segment = None;
        if !matches!(self.orders.peek(), Ok(Order::Move(_))) {
            if let Some(axis) = self.axes.iter().position(|axis| axis.knot.velocity != 0.0) {
                return Err((Some(axis), StopCause::Starved { last: self.macrostep }));
            }
            // A macrostep may end with zero velocity and still arrive with a last step that is too fast.
            for (index, axis) in self.axes.iter().enumerate() {
                axis.vet(axis.knot.position, tick.dt).map_err(|cause| (Some(index), cause))?;
            }
            self.apply(tick, ServoEvent::Done);
            return Ok(None);
        }
        let Some(Order::Move(macrostep)) = self.pop() else {
            return Ok(None);
        };
        self.admit(&macrostep)?;
        let told = macrostep.torque.iter().any(|torque| *torque != 0.0);
        if told && self.state == ServoState::Standing {
            // Bumpless transfer: the torque that loops hold since homing or since a stop moves into the feed-forward.
            self.axes.iter_mut().zip(macrostep.torque).for_each(|(axis, torque)| axis.hand_over(torque));
        }
        self.apply(tick, ServoEvent::Move);
        self.macrostep = macrostep.number;
        self.counters.macrosteps += 1;
        let (from, from_torque) = (self.each(|axis| axis.knot), self.each(|axis| axis.torque));
        Ok(Some(Segment::new(macrostep, from, from_torque, tick.dt)))
    }

    /// Checks whether a macrostep can be started.
    fn admit(&self, macrostep: &Macrostep) -> Result<(), (Option<usize>, StopCause)> {
        let number = macrostep.number;
        if !(1..=macrostep.steps).contains(&macrostep.report_at) {
            return Err((None, StopCause::Malformed { number }));
        }
        for (index, axis) in self.axes.iter().enumerate() {
            let Macrostep { position, velocity, torque, .. } = macrostep;
            let asked = [position[index], velocity[index], torque[index]];
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
