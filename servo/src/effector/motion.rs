//! Motion of an effector: macrosteps begun one after the other, interpolated and vetted.

use super::{Effector, Tick};
use crate::interpolate::Segment;
use crate::{Event, Knot, MAX_AXES, Macrostep, Order, State, StopCause};

impl Effector {
    /// Interpolates, beginning the next macrostep where one ends, and brakes if it cannot go on.
    pub(super) fn follow_macrosteps(&mut self, tick: &Tick) {
        if let Err((axis, cause)) = self.try_follow(tick) {
            self.fail(tick, axis, cause);
            if matches!(self.state, State::Braking(_)) && self.stop.advance() {
                self.place_stop();
            }
        }
    }

    fn try_follow(&mut self, tick: &Tick) -> Result<(), (Option<usize>, StopCause)> {
        let mut segment = match self.segment {
            Some(segment) if !segment.is_over() => segment,
            _ => match self.begin(tick)? {
                Some(segment) => segment,
                None => return Ok(()),
            },
        };
        segment.advance();
        let mut knots = [Knot::default(); MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            let knot = segment.at(index);
            axis.vet(knot.position, tick.dt)
                .map_err(|cause| (Some(index), cause))?;
            knots[index] = knot;
        }
        // Only now is any of it taken: an effector is never half commanded.
        for (index, axis) in self.axes.iter_mut().enumerate() {
            axis.knot = knots[index];
            axis.torque = segment.torque(index);
        }
        self.segment = Some(segment);
        Ok(())
    }

    /// Takes the next macrostep from the queue; `None` if the last one ended at rest.
    fn begin(&mut self, tick: &Tick) -> Result<Option<Segment>, (Option<usize>, StopCause)> {
        self.segment = None;
        if !matches!(self.orders.peek(), Ok(Order::Move(_))) {
            if let Some(axis) = self.axes.iter().position(|axis| axis.knot.velocity != 0.0) {
                return Err((
                    Some(axis),
                    StopCause::Starved {
                        last: self.macrostep,
                    },
                ));
            }
            // A macrostep may claim an end at rest and yet arrive with speed.
            for (index, axis) in self.axes.iter().enumerate() {
                axis.vet(axis.knot.position, tick.dt)
                    .map_err(|cause| (Some(index), cause))?;
            }
            self.apply(tick, Event::Done);
            return Ok(None);
        }
        let Some(Order::Move(macrostep)) = self.pop() else {
            return Ok(None);
        };
        self.admit(&macrostep)?;
        if self.state == State::Standing {
            // What loops have come to hold by themselves, since homing or since a stop elsewhere, changes hands.
            let axes = self.axes.iter_mut().zip(macrostep.torque);
            axes.for_each(|(axis, torque)| axis.hand_over(torque));
        }
        self.apply(tick, Event::Move);
        self.macrostep = macrostep.number;
        self.counters.macrosteps += 1;
        let mut from = [Knot::default(); MAX_AXES];
        let mut from_torque = [0.0; MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            from[index] = axis.knot;
            from_torque[index] = axis.torque;
        }
        Ok(Some(Segment::new(macrostep, from, from_torque, tick.dt)))
    }

    /// Whether a macrostep can be begun at all.
    fn admit(&self, macrostep: &Macrostep) -> Result<(), (Option<usize>, StopCause)> {
        let Macrostep {
            number,
            steps,
            report_at,
            position,
            velocity,
            torque,
        } = macrostep;
        if *report_at < 1 || report_at > steps {
            return Err((None, StopCause::Malformed { number: *number }));
        }
        for (index, axis) in self.axes.iter().enumerate() {
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
