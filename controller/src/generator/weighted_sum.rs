//! Superposition of two generators: the weighted sum of their set-points.

use std::array;
use std::time::Duration;

use super::polynomial::quintic_step;
use super::with_images::Includes;
use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, Next, Pace, Setpoint};
use crate::robot::Space;

/// Velocity, rad/s or m/s, below which a generator has ended at rest.
const STILL: f64 = 1e-9;

/// The weighted sum of the set-points of two generators, in joints or in motors. The weight of the second generator is w,
/// and that of the first generator is 1 − w.
///
/// With states a and b of the generators, position, velocity and acceleration are
///
/// ```text
/// q   = a   + w (b − a)
/// q′  = a′  + w (b′ − a′) + w′ (b − a)
/// q″  = a″  + w (b″ − a″) + 2 w′ (b′ − a′) + w″ (b − a)
/// ```
///
/// With a constant weight, the sum keeps the limits that both generators keep. A [changing](Self::changing_to) weight adds
/// up to 1.875 / T · |b − a| to the velocity, for a change by 1 within the time T, s. The servo checks the sum like every
/// set-point.
///
/// Both generators compute every step. A generator that has ended stands at its end. The sum ends when both generators and
/// the change of the weight have ended. Both generators have the same images and no outputs;
/// [`WithImages`](super::WithImages) adapts a generator that reads fewer images. The first step reads the effector. A sum
/// is a generator: sums can be nested.
///
/// Set-points of the other space, displacements and poses of the tool are refused with [`GeneratorError::NotAdded`]: a
/// sum of poses is not a pose. If a generator ends in motion before the other generator ends, the motion fails with
/// [`GeneratorError::EndedInMotion`].
///
/// ```
/// # use mrroc_controller::generator::{JerkLimited, MotionLimits, Polynomial, WeightedSum};
/// # use mrroc_controller::robot::Space;
/// let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
/// let fast = JerkLimited::new(Space::Joint, 6, limits, &[[0.4; 8]])?;
/// let gentle = Polynomial::quintic(Space::Joint, 6, limits, [0.4; 8])?;
/// let motion = WeightedSum::new(Space::Joint, fast, gentle, 0.5)?;
/// # Ok::<(), mrroc_controller::generator::GeneratorError>(())
/// ```
#[doc(alias = "superposition")]
#[derive(Clone, Debug)]
pub struct WeightedSum<A, B> {
    space: Space,
    first: A,
    second: B,
    /// Weight of the second generator at the start and after the change.
    from: f64,
    to: f64,
    /// Duration of the change, s.
    change: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// Memory of a [`WeightedSum`] of generators with memories `M` and `N`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SumMemory<M, N> {
    /// Number of macrosteps done.
    done: u32,
    first: Summand<M>,
    second: Summand<N>,
}

/// Progress of one generator of a sum.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Summand<M> {
    memory: M,
    /// Last state of the generator.
    state: AxesState,
    ended: bool,
}

impl<M> Summand<M> {
    /// The generator after its first step, which began at `start`. Also returns whether the step sends a macrostep.
    fn begin(space: Space, next: Next<M>, start: &Axes) -> Result<(Self, bool), GeneratorError> {
        let state = stated(space, without_law(&next)?, start)?;
        Ok((Self { memory: next.memory, state, ended: false }, next.effector.is_some()))
    }

    /// Whether the generator has ended or ends now.
    fn ends<G: Generator<Memory = M>>(&self, generator: &G, images: &G::Every) -> bool {
        self.ended || generator.terminal(&self.memory, images)
    }

    /// The generator after its next step.
    fn next<G>(&self, space: Space, generator: &G, images: &G::Every) -> Result<Self, GeneratorError>
    where
        M: Copy,
        G: Generator<Memory = M, Out = ()>,
    {
        if !self.ends(generator, images) {
            let next = generator.next_step(&self.memory, images)?;
            let state = stated(space, without_law(&next)?, &self.state.position)?;
            return Ok(Self { memory: next.memory, state, ended: false });
        }
        if self.state.velocity.iter().any(|velocity| velocity.abs() > STILL) {
            return Err(GeneratorError::EndedInMotion);
        }
        Ok(Self { state: AxesState::at_rest(self.state.position), ended: true, ..*self })
    }
}

/// The set-point of a part that is not under a force law.
fn without_law<M>(next: &Next<M>) -> Result<Option<Setpoint>, GeneratorError> {
    if next.law.is_some() { Err(GeneratorError::LawOfPart) } else { Ok(next.effector) }
}

/// State of a set-point; without one, standstill at the position before.
fn stated(space: Space, setpoint: Option<Setpoint>, before: &Axes) -> Result<AxesState, GeneratorError> {
    match (space, setpoint) {
        (_, None) => Ok(AxesState::at_rest(*before)),
        (Space::Joint, Some(Setpoint::Joints(state))) | (Space::Motor, Some(Setpoint::Motors(state))) => Ok(state),
        (_, Some(_)) => Err(GeneratorError::NotAdded),
    }
}

impl<A, B> WeightedSum<A, B>
where
    A: Generator<First: Includes<EffectorImage>, Out = ()>,
    B: Generator<First = A::First, Every = A::Every, Out = ()>,
{
    /// The sum with the constant weight `weight`, 0 to 1, of the second generator.
    pub fn new(space: Space, first: A, second: B, weight: f64) -> Result<Self, GeneratorError> {
        let weight = checked(weight)?;
        Ok(Self { space, first, second, from: weight, to: weight, change: 0.0, macrostep: 0.0 })
    }

    /// The same sum, in which the weight changes to `weight`, 0 to 1, within `duration` from the start. The change is a
    /// quintic of time, without jumps of velocity and acceleration.
    pub fn changing_to(self, weight: f64, duration: Duration) -> Result<Self, GeneratorError> {
        Ok(Self { to: checked(weight)?, change: duration.as_secs_f64(), ..self })
    }

    /// Weight of the second generator and its first two derivatives after `done` macrosteps.
    fn weight(&self, done: u32) -> [f64; 3] {
        let time = f64::from(done) * self.macrostep;
        if time >= self.change {
            return [self.to, 0.0, 0.0];
        }
        let [step, rate, push] = quintic_step(time / self.change);
        let by = self.to - self.from;
        [self.from + by * step, by * rate / self.change, by * push / (self.change * self.change)]
    }

    /// The set-point after `done` macrosteps.
    fn sum(&self, done: u32, first: &AxesState, second: &AxesState) -> Setpoint {
        let [weight, rate, push] = self.weight(done);
        let apart = |a: &Axes, b: &Axes| -> Axes { array::from_fn(|axis| b[axis] - a[axis]) };
        let [position, velocity] = [apart(&first.position, &second.position), apart(&first.velocity, &second.velocity)];
        let state = AxesState::new(
            array::from_fn(|axis| first.position[axis] + weight * position[axis]),
            array::from_fn(|axis| first.velocity[axis] + weight * velocity[axis] + rate * position[axis]),
        );
        let Some((a, b)) = first.acceleration.zip(second.acceleration) else {
            return self.space.setpoint(state);
        };
        let acceleration = |axis: usize| {
            let apart = b[axis] - a[axis];
            a[axis] + weight * apart + 2.0 * rate * velocity[axis] + push * position[axis]
        };
        self.space.setpoint(state.accelerating(array::from_fn(acceleration)))
    }
}

/// The weight, if the weight is from 0 to 1.
fn checked(weight: f64) -> Result<f64, GeneratorError> {
    if (0.0..=1.0).contains(&weight) { Ok(weight) } else { Err(GeneratorError::Weight { weight }) }
}

impl<A, B> Generator for WeightedSum<A, B>
where
    A: Generator<First: Includes<EffectorImage>, Out = ()>,
    B: Generator<First = A::First, Every = A::Every, Out = ()>,
{
    type First = A::First;
    type Every = A::Every;
    type Out = ();
    type Memory = SumMemory<A::Memory, B::Memory>;

    /// The shorter macrostep of the two generators.
    fn pace(&self, cell: Pace) -> Pace {
        self.first.pace(cell).shorter(self.second.pace(cell))
    }

    fn macrosteps_ahead(&self, most: u16) -> u16 {
        self.first.macrosteps_ahead(most).min(self.second.macrosteps_ahead(most))
    }

    fn begins_in_motion(&self) -> bool {
        self.first.begins_in_motion() && self.second.begins_in_motion()
    }

    fn first_step(&mut self, images: &A::First, macrostep: Duration) -> Result<Next<Self::Memory>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        let start = self.space.commanded(&images.part()).position;
        let (first, moves) = Summand::begin(self.space, self.first.first_step(images, macrostep)?, &start)?;
        let (second, also) = Summand::begin(self.space, self.second.first_step(images, macrostep)?, &start)?;
        if !(moves || also) {
            return Ok(Next::remember(SumMemory { done: 0, first, second }));
        }
        Ok(Next::command(self.sum(1, &first.state, &second.state), SumMemory { done: 1, first, second }))
    }

    fn terminal(&self, memory: &Self::Memory, images: &A::Every) -> bool {
        let changed = f64::from(memory.done) * self.macrostep >= self.change;
        changed && memory.first.ends(&self.first, images) && memory.second.ends(&self.second, images)
    }

    fn next_step(&self, memory: &Self::Memory, images: &A::Every) -> Result<Next<Self::Memory>, GeneratorError> {
        let done = memory.done.saturating_add(1);
        let first = memory.first.next(self.space, &self.first, images)?;
        let second = memory.second.next(self.space, &self.second, images)?;
        Ok(Next::command(self.sum(done, &first.state, &second.state), SumMemory { done, first, second }))
    }
}
