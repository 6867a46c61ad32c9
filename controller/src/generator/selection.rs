//! Selection of one of two generators in every step.

use std::time::Duration;

use super::with_images::Includes;
use super::{EffectorImage, Generator, GeneratorError, MotionLimits, Next, Pace, Setpoint};
use crate::path::PoseState;
use crate::robot::Arm;

/// Allowance for rounding errors, relative to the limits.
const ROUNDING: f64 = 1e-9;

/// One of the two generators of a [`Selection`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Selected {
    /// The first generator.
    First,
    /// The second generator.
    Second,
}

/// Memory of a [`Selection`] of generators with memories `M` and `N`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelectionMemory<M, N> {
    /// The generator of the last step.
    pub selected: Selected,
    /// Number of next steps since this generator was selected.
    pub steps: u32,
    /// Memory of the first generator.
    pub first: M,
    /// Memory of the second generator.
    pub second: N,
}

/// Two generators, of which a function of memory and images selects one in every step.
///
/// The function must give the same result for the same memory and images. The selected generator computes the step and
/// determines the end. The memory of the other generator is kept. The first steps of both generators run when the
/// selection begins, and the set-point and outputs of the first generator are sent. Both generators have the same
/// images and outputs; [`WithImages`](super::WithImages) adapts a generator that reads fewer images. The images of the
/// next steps include the effector, because each change is checked against the commanded motion. A selection is a
/// generator: selections can be nested.
///
/// The motion is continuous if the set-points of each generator continue from `e.commanded`. [`Jog`](super::Jog),
/// [`Wait`](super::Wait) at rest and generators that integrate a velocity do so. A planned generator does so only if
/// the generator is selected at the begin of its plan. A change of the generator is therefore checked in the joints.
/// The mean velocity of each joint in the macrostep must be within its limit. The change from the commanded velocity to
/// the mean velocity must be possible in one macrostep within the acceleration limit. Otherwise the change is refused
/// with [`GeneratorError::Switch`] before the set-point is sent, and the effector brakes.
///
/// ```
/// # use std::{sync::Arc, time::Duration};
/// # use mrroc_controller::generator::{
/// #     EffectorImage, Jog, MotionLimits, Pose, Selected, Selection, SelectionMemory, V, Wait, WithImages
/// # };
/// # use mrroc_controller::sensor::JogReading;
/// # use mrroc_controller::robot::{Arm, Irb6, Irb6Parameters};
/// # let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), Pose::identity());
/// # let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
/// let jog = Jog::new(arm.clone(), limits, Duration::from_millis(200))?;
/// // The operator moves the arm as long as the tool is below 1.5 m. The arm then waits for five seconds.
/// let wait = WithImages::of(Wait { duration: Duration::from_secs(5) });
/// let below = |_: &SelectionMemory<_, _>, (e, _): &(EffectorImage, V<JogReading>)| match e.commanded.pose.translation.z {
///     z if z < 1.5 => Selected::First,
///     _ => Selected::Second,
/// };
/// let motion = Selection::between(arm, limits, jog, wait, below)?;
/// # Ok::<(), mrroc_controller::generator::GeneratorError>(())
/// ```
#[doc(alias = "switching")]
#[derive(Clone, Debug)]
pub struct Selection<A, B, S> {
    arm: Arm,
    limits: MotionLimits,
    first: A,
    second: B,
    select: S,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl<A, B, S> Selection<A, B, S>
where
    A: Generator<Every: Includes<EffectorImage>>,
    B: Generator<First = A::First, Every = A::Every, Out = A::Out>,
    S: Fn(&SelectionMemory<A::Memory, B::Memory>, &A::Every) -> Selected + Send + Sync + 'static,
{
    /// A selection by the function `select`. A change is permitted within `limits` of the joints.
    pub fn between(arm: Arm, limits: MotionLimits, first: A, second: B, select: S) -> Result<Self, GeneratorError> {
        limits.check(arm.axes())?;
        Ok(Self { arm, limits, first, second, select, macrostep: 0.0 })
    }

    /// Refuses a set-point that does not continue the commanded motion. A set-point that the arm cannot take, or that
    /// is not finite, is refused later by the check of every set-point.
    fn check(&self, e: &EffectorImage, setpoint: Option<Setpoint>) -> Result<(), GeneratorError> {
        let here = &e.commanded.joints;
        let position = match setpoint {
            None => Ok(here.position),
            Some(Setpoint::Joints(joints)) => Ok(joints.position),
            Some(Setpoint::JointsBy(by)) => Ok(std::array::from_fn(|axis| here.position[axis] + by.position[axis])),
            Some(Setpoint::Motors(motors)) => self.arm.joints(&motors.position),
            Some(Setpoint::Pose { pose, .. } | Setpoint::Tool(PoseState { pose, .. })) => {
                self.arm.inverse(&pose, &here.position)
            }
        };
        let Ok(position) = position else {
            return Ok(());
        };
        let room = 1.0 + ROUNDING;
        for (axis, position) in position.iter().enumerate().take(self.arm.axes()) {
            let commanded = here.velocity[axis];
            let needed = (position - here.position[axis]) / self.macrostep;
            let change = self.limits.max_acceleration[axis] * self.macrostep;
            if needed.abs() > self.limits.max_velocity[axis] * room || (needed - commanded).abs() > change * room {
                return Err(GeneratorError::Switch { axis: axis as u8, needed, commanded });
            }
        }
        Ok(())
    }
}

impl<A, B, S> Generator for Selection<A, B, S>
where
    A: Generator<Every: Includes<EffectorImage>>,
    B: Generator<First = A::First, Every = A::Every, Out = A::Out>,
    S: Fn(&SelectionMemory<A::Memory, B::Memory>, &A::Every) -> Selected + Send + Sync + 'static,
{
    type First = A::First;
    type Every = A::Every;
    type Out = A::Out;
    type Memory = SelectionMemory<A::Memory, B::Memory>;

    /// The shorter macrostep of the two generators.
    fn pace(&self, cell: Pace) -> Pace {
        self.first.pace(cell).shorter(self.second.pace(cell))
    }

    fn begins_in_motion(&self) -> bool {
        self.first.begins_in_motion() && self.second.begins_in_motion()
    }

    fn first_step(
        &mut self,
        images: &A::First,
        macrostep: Duration,
    ) -> Result<Next<Self::Memory, A::Out>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        let Next { effector, law, out, memory: first } = self.first.first_step(images, macrostep)?;
        let Next { law: other, memory: second, .. } = self.second.first_step(images, macrostep)?;
        // A motion under a law stays under it.
        if law.is_some() != other.is_some() {
            return Err(GeneratorError::LawOfPart);
        }
        let memory = SelectionMemory { selected: Selected::First, steps: 0, first, second };
        Ok(Next { effector, law, out, memory })
    }

    fn terminal(&self, memory: &Self::Memory, images: &A::Every) -> bool {
        match (self.select)(memory, images) {
            Selected::First => self.first.terminal(&memory.first, images),
            Selected::Second => self.second.terminal(&memory.second, images),
        }
    }

    fn next_step(
        &self,
        memory: &Self::Memory,
        images: &A::Every,
    ) -> Result<Next<Self::Memory, A::Out>, GeneratorError> {
        let selected = (self.select)(memory, images);
        let changed = selected != memory.selected;
        let steps = if changed { 1 } else { memory.steps.saturating_add(1) };
        let memory = SelectionMemory { selected, steps, ..*memory };
        let next = match selected {
            Selected::First => {
                let Next { effector, law, out, memory: first } = self.first.next_step(&memory.first, images)?;
                Next { effector, law, out, memory: SelectionMemory { first, ..memory } }
            }
            Selected::Second => {
                let Next { effector, law, out, memory: second } = self.second.next_step(&memory.second, images)?;
                Next { effector, law, out, memory: SelectionMemory { second, ..memory } }
            }
        };
        if changed {
            self.check(&images.part(), next.effector)?;
        }
        Ok(next)
    }
}
