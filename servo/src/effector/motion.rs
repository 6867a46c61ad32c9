//! Motion of an effector: macrosteps in sequence, interpolated and checked.

use super::{Effector, Tick};
use crate::axis::ServoAxis;
use crate::interpolate::{Segment, Start};
use crate::motion_time::Bounds;
use crate::{Knot, MAX_AXES, Macrostep, Order, ServoEvent, ServoState, StopCause};

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

    /// Bounds of the change of the rate of motion time, by the acceleration limits of the axes that follow a macrostep.
    pub(crate) fn rate_bounds(&self, rate: f64) -> Bounds {
        let Some(segment) = self.segment.as_ref().filter(|_| self.state == ServoState::Moving) else {
            return Bounds::NONE;
        };
        // The planned acceleration changes within the period for which the bounds hold.
        let bounds = |(index, axis): (usize, &ServoAxis)| {
            let after = |periods| Bounds::of_axis(segment.ahead(index, periods), rate, axis.config.max_acceleration);
            after(0.0).within(after(1.0)).within(after(2.0))
        };
        self.axes.iter().enumerate().map(bounds).fold(Bounds::NONE, Bounds::within)
    }

    fn try_follow(&mut self, tick: &Tick) -> Result<(), (Option<usize>, StopCause)> {
        let mut periods = tick.motion.periods;
        match self.segment.as_ref().map(|segment| segment.excess(periods)) {
            None => self.segment = self.begin(tick)?,
            Some(None) => {}
            Some(Some(excess)) => {
                if let Some(next) = self.begin(tick)? {
                    periods = excess;
                    self.segment = Some(next);
                } else {
                    self.run_out(tick)?;
                }
            }
        }
        let Some(segment) = &mut self.segment else {
            return Ok(());
        };
        self.due |= segment.advance(periods);
        let mut knots = [Knot::default(); MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            let knot = tick.motion.slow(segment.at(index));
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

    /// Ends a motion whose last macrostep is over. A macrostep that ends in motion must have a successor.
    fn run_out(&mut self, tick: &Tick) -> Result<(), (Option<usize>, StopCause)> {
        let Some(segment) = &self.segment else {
            return Ok(());
        };
        if let Some(axis) = segment.ends_in_motion(self.axes.len()) {
            return Err((Some(axis), StopCause::Starved { last: self.macrostep }));
        }
        if segment.is_over() {
            // A macrostep may end with zero velocity and still arrive with a last step that is too fast.
            for (index, axis) in self.axes.iter().enumerate() {
                axis.vet(axis.knot.position, tick.dt).map_err(|cause| (Some(index), cause))?;
            }
            self.apply(tick, ServoEvent::Done);
        }
        Ok(())
    }

    /// Takes the next macrostep from the queue, if there is one.
    fn begin(&mut self, tick: &Tick) -> Result<Option<Segment>, (Option<usize>, StopCause)> {
        if !matches!(self.orders.peek(), Ok(Order::Move(_))) {
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
        let start = self.segment.as_ref().map_or_else(
            || Start {
                knots: self.each(|axis| Knot::new(axis.knot.position, axis.knot.velocity)),
                torque: self.each(|axis| axis.torque),
            },
            Segment::end,
        );
        // Motion time may pass the end of a macrostep and the period of its report in one cycle.
        self.news |= self.segment.as_ref().is_some_and(|segment| !segment.is_reported());
        self.apply(tick, ServoEvent::Move);
        self.macrostep = macrostep.number;
        self.counters.macrosteps += 1;
        Ok(Some(Segment::new(macrostep, start, tick.dt)))
    }

    /// Checks whether a macrostep can be started.
    fn admit(&self, macrostep: &Macrostep) -> Result<(), (Option<usize>, StopCause)> {
        let number = macrostep.number;
        if !(1..=macrostep.steps).contains(&macrostep.report_at) {
            return Err((None, StopCause::Malformed { number }));
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
