//! The cycle law of an effector: its installation, its displacements, and their bounds.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::motion::Failed;
use super::{Effector, Tick};
use crate::axis::ServoAxis;
use crate::interpolate::Segment;
use crate::limit::{self, RELATIVE_TOLERANCE};
use crate::state::ServoState;
use crate::{
    CycleLaw, Knot, LawAxis, LawBound, LawError, LawFault, LawInput, LawOutput, LawParameters, MAX_AXES, Macrostep,
    StopCause,
};

/// A law and its state.
pub(crate) struct Installed {
    law: Box<dyn CycleLaw>,
    bounds: [LawBound; MAX_AXES],
    /// The law displaces the set-points of the motion under way.
    active: bool,
    /// The law panicked, and is not called again.
    panicked: bool,
    /// Present displacements: positions, velocities and accelerations. While the law is not `active`, all displacements
    /// are at rest, and are zero unless `kept`.
    displacement: [Knot; MAX_AXES],
    kept: Kept,
}

/// Whether the displacement is kept after the end of a motion.
#[derive(Clone, Copy)]
enum Kept {
    /// The displacement is part of the path.
    No,
    /// The effector brakes to a stand because the law moved it at the end of the path, whose motor positions are given.
    Braking(LawParameters, [f64; MAX_AXES]),
    /// The effector stands beside the end of the path.
    Standing(LawParameters),
}

impl Installed {
    /// Ends the law. The displacements remain in the set-points, and count as part of the path from now on.
    pub(super) fn end(&mut self) {
        (self.active, self.displacement, self.kept) = (false, [Knot::default(); MAX_AXES], Kept::No);
    }

    /// Ends the motion at a stand, or in braking to a stand from the end of the path at `path`, rad. The law decides
    /// whether it keeps its displacement.
    fn pause(&mut self, parameters: Option<&LawParameters>, braking: Option<[f64; MAX_AXES]>) {
        let law = &self.law;
        let keeps =
            |parameters: &LawParameters| catch_unwind(AssertUnwindSafe(|| law.keeps(parameters))).unwrap_or(false);
        let kept = parameters.filter(|parameters| self.active && !self.panicked && keeps(parameters));
        let displacements = self.displacements();
        self.end();
        match (kept, braking) {
            (None, _) => {}
            (Some(parameters), Some(path)) => self.kept = Kept::Braking(*parameters, path),
            (Some(parameters), None) => {
                self.kept = Kept::Standing(*parameters);
                self.displacement = displacements.map(Knot::at_rest);
            }
        }
    }

    /// The effector has come to a stand at the motor positions `stand`, rad.
    fn stand(&mut self, stand: [f64; MAX_AXES]) {
        if let Kept::Braking(parameters, path) = self.kept {
            self.kept = Kept::Standing(parameters);
            self.displacement = std::array::from_fn(|axis| Knot::at_rest(stand[axis] - path[axis]));
        }
    }

    /// Whether a macrostep with these parameters can continue the displacement that the law has kept.
    fn has_kept(&self, parameters: Option<&LawParameters>) -> bool {
        matches!(&self.kept, Kept::Standing(kept) if Some(kept) == parameters)
    }

    /// Present displacements, rad.
    pub(super) fn displacements(&self) -> [f64; MAX_AXES] {
        self.displacement.map(|knot| knot.position)
    }

    /// Takes the displacement of `axis` of this cycle, rad, if the displacement is within its bounds.
    fn take(&mut self, axis: usize, position: f64, dt: f64) -> Result<Knot, StopCause> {
        if !position.is_finite() {
            return Err(StopCause::NotFinite);
        }
        let LawBound { displacement: limit, speed } = self.bounds[axis];
        if position.abs() > limit {
            return Err(StopCause::LawDisplacement { displacement: position, limit });
        }
        let last = &mut self.displacement[axis];
        let velocity = (position - last.position) / dt;
        if velocity.abs() > speed * (1.0 + RELATIVE_TOLERANCE) {
            return Err(StopCause::LawSpeed { velocity, limit: speed });
        }
        *last = Knot { position, velocity, acceleration: (velocity - last.velocity) / dt };
        Ok(*last)
    }
}

impl Installed {
    /// [`CycleLaw::check`]. A law that panicked refuses every macrostep.
    fn check(&self, parameters: &LawParameters) -> Result<(), LawFault> {
        if self.panicked {
            return Err(LawFault::Panicked);
        }
        catch_unwind(AssertUnwindSafe(|| self.law.check(parameters))).unwrap_or(Err(LawFault::Panicked))
    }

    /// [`CycleLaw::begin`] in the first cycle of a motion, and [`CycleLaw::shift`].
    fn shift(&mut self, input: &LawInput<'_>, parameters: &LawParameters) -> LawOutput {
        let (law, active) = (&mut self.law, self.active);
        let shifted = catch_unwind(AssertUnwindSafe(|| {
            if !active {
                law.begin(input, parameters);
            }
            law.shift(input, parameters)
        }));
        (self.active, self.kept) = (true, Kept::No);
        shifted.unwrap_or_else(|_| {
            self.panicked = true;
            LawOutput::Fault(LawFault::Panicked)
        })
    }
}

impl Effector {
    pub(crate) fn install_law(&mut self, law: Box<dyn CycleLaw>, bounds: &[LawBound]) -> Result<(), LawError> {
        let effector = usize::from(self.index);
        LawBound::check(bounds, self.axes.iter().map(|axis| &axis.config))?;
        if self.law.is_some() {
            return Err(LawError::Installed { effector });
        }
        let none = LawBound { displacement: 0.0, speed: 0.0 };
        let bounds = std::array::from_fn(|axis| bounds.get(axis).copied().unwrap_or(none));
        self.law = Some(Installed {
            law,
            bounds,
            active: false,
            panicked: false,
            displacement: [Knot::default(); MAX_AXES],
            kept: Kept::No,
        });
        Ok(())
    }

    /// Ends the law with the change of state from `last` to `next`. A law that keeps its displacement does so at the
    /// end of a path. If the law still moves the effector there, the displacement is also kept while the effector
    /// brakes.
    pub(super) fn leave_law(&mut self, last: ServoState, next: ServoState, segment: Option<&Segment>) {
        let stand = self.each(|axis| axis.knot.position);
        let Some(installed) = &mut self.law else {
            return;
        };
        match (last, next) {
            (ServoState::Moving, ServoState::Standing) => installed.pause(segment.and_then(Segment::law), None),
            (ServoState::Moving, ServoState::Braking(_)) if self.settling => {
                let path = segment.map(|segment| segment.end().knots.map(|knot| knot.position));
                installed.pause(segment.and_then(Segment::law), path);
            }
            (ServoState::Braking(_), ServoState::Standing) if self.fault.is_none() => installed.stand(stand),
            (_, ServoState::Moving) => {}
            (_, _) => installed.end(),
        }
    }

    /// Displacement from which `macrostep` continues, rad. A first macrostep of a motion that does not continue gives
    /// up the kept displacement.
    pub(super) fn continue_law(&mut self, macrostep: &Macrostep) -> [f64; MAX_AXES] {
        match &mut self.law {
            Some(installed) if macrostep.continues_law => installed.displacements(),
            Some(installed) if !installed.active => {
                installed.end();
                [0.0; MAX_AXES]
            }
            _ => [0.0; MAX_AXES],
        }
    }

    /// Whether a law displaces the set-points of the motion under way.
    pub(super) fn is_displaced(&self) -> bool {
        self.law.as_ref().is_some_and(|law| law.active)
    }

    /// Checks whether the law of the effector can execute `macrostep`.
    pub(super) fn admit_law(&self, macrostep: &Macrostep) -> Result<(), StopCause> {
        let number = macrostep.number;
        let kept = || self.law.as_ref().is_some_and(|installed| installed.has_kept(macrostep.law.as_ref()));
        if macrostep.continues_law && !(self.state == ServoState::Standing && kept()) {
            return Err(StopCause::Malformed { number });
        }
        match (&self.law, &macrostep.law) {
            (_, None) if self.is_displaced() => Err(StopCause::LawLeft { number }),
            (_, None) => Ok(()),
            (None, Some(_)) => Err(StopCause::NoLaw { number }),
            (Some(_), Some(parameters)) if !parameters.0.iter().all(|value| value.is_finite()) => {
                Err(StopCause::NotFinite)
            }
            (Some(installed), Some(parameters)) => installed.check(parameters).map_err(StopCause::Law),
        }
    }

    /// Adds the displacements of this cycle to the interpolated set-points in `next`, if the macrostep has a law.
    pub(super) fn displace(&mut self, tick: &Tick) -> Result<(), Failed> {
        let parameters = self.segment.as_ref().and_then(Segment::law);
        let Some(parameters) = parameters.filter(|_| self.law.is_some()) else {
            return Ok(());
        };
        let trail = self.trail(tick.dt);
        let Some(installed) = &mut self.law else {
            return Ok(());
        };
        let mut seen = [LawAxis::default(); MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            seen[index] = LawAxis {
                planned: self.next[index],
                displacement: installed.displacement[index].position,
                commanded: axis.knot.position,
                position: axis.state.position,
                velocity: axis.state.velocity,
                torque: axis.state.torque,
                sampled: axis.state.sampled,
                age: axis.state.age,
            };
        }
        let input = LawInput {
            now: tick.now,
            period: tick.dt,
            periods: tick.periods,
            rate: tick.motion.rate,
            macrostep: self.macrostep,
            axes: &seen[..self.axes.len()],
            trail: &trail,
        };
        let displacements = match installed.shift(&input, parameters) {
            LawOutput::Displacement(displacements) => displacements,
            LawOutput::Touched => return Err((None, StopCause::Touched)),
            LawOutput::Fault(fault) => return Err((None, StopCause::Law(fault))),
        };
        for (index, next) in self.next[..self.axes.len()].iter_mut().enumerate() {
            let displaced = installed.take(index, displacements[index], tick.dt);
            let Knot { position, velocity, acceleration } = displaced.map_err(|cause| (Some(index), cause))?;
            next.position += position;
            next.velocity += velocity;
            next.acceleration += acceleration;
        }
        self.check_stop(tick)
    }

    /// Checks that a straight stop from the set-points in `next` ends within the position limits.
    ///
    /// A planned path decelerates before its limit. The output of a law is not known in advance, so the room for the stop
    /// is checked in each cycle.
    fn check_stop(&self, tick: &Tick) -> Result<(), Failed> {
        let step = |(axis, next): (&ServoAxis, &Knot)| (next.position - axis.last_step(tick.dt).position) / tick.dt;
        let steps = self.axes.iter().zip(&self.next);
        let duration = |pair: (&ServoAxis, &Knot)| step(pair).abs() / pair.0.config.max_acceleration;
        let longest = steps.clone().map(duration).fold(0.0, f64::max);
        for (index, pair) in steps.enumerate() {
            // An upper bound of the way of a straight stop of ceil(longest / dt) periods.
            let end = pair.1.position + 0.5 * step(pair) * longest;
            limit::check_position(&pair.0.config, pair.1.position, end).map_err(|cause| (Some(index), cause))?;
        }
        Ok(())
    }
}
