//! Sets of images, which a generator declares: `e`, `V`, `a0` and their combinations.

use std::any::{Any, TypeId, type_name};
use std::time::Duration;

use can::Instant;

use super::{EffectorImage, GeneratorError};
use crate::ecp::StepEvent;

/// A value with the time at which it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// Time of the frame or telegram of a sensor, or of the step of a coordinator or member.
    pub at: Instant,
    /// Time from [`at`](Self::at) to the snapshot.
    pub age: Duration,
    /// The value.
    pub value: T,
}

/// Reading of a sensor, or order of the coordinator, as a step receives it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Received<T> {
    /// No sample since the instruction began. Exception: a loose link keeps an earlier order until a step has read the
    /// order.
    #[default]
    None,
    /// No new sample since the last step: the last sample again.
    Old(Sample<T>),
    /// A new sample.
    New(Sample<T>),
}

impl<T> Received<T> {
    /// The last sample, new or old.
    pub const fn sample(&self) -> Option<&Sample<T>> {
        match self {
            Self::None => None,
            Self::Old(sample) | Self::New(sample) => Some(sample),
        }
    }

    /// The last value, new or old. Fails without a sample, and if the sample is older than `limit`.
    pub fn younger_than(&self, limit: Duration) -> Result<&T, GeneratorError> {
        let sample = self.sample().ok_or(GeneratorError::NothingReceived)?;
        if sample.age <= limit { Ok(&sample.value) } else { Err(GeneratorError::Stale { age: sample.age, limit }) }
    }

    /// The same sample at time `now`, old if a step has `seen` the sample.
    pub(crate) fn at(self, now: Instant, seen: bool) -> Self {
        let aged = |sample: Sample<T>| Sample { age: now.since(sample.at), ..sample };
        match self {
            Self::None => Self::None,
            Self::New(sample) if !seen => Self::New(aged(sample)),
            Self::Old(sample) | Self::New(sample) => Self::Old(aged(sample)),
        }
    }
}

/// Type of the readings of a virtual sensor. An agent has at most one sensor of each type.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no reading of a virtual sensor",
    note = "a sensor of your own implements `SensorReading` for its readings, and `VirtualSensor`"
)]
pub trait SensorReading: Copy + Send + Sync + 'static {}

/// Readings of one to three virtual sensors: a [`SensorReading`], or a tuple of them.
pub trait Bundle: Copy + Send + Sync + 'static {
    /// A [`Received`] from each sensor.
    type Received: Copy + Send + Sync + 'static;

    /// Takes the snapshot.
    fn fetch(partners: &dyn Partners) -> Result<Self::Received, GeneratorError>;

    /// Refuses partners without one of the sensors.
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError>;
}

impl<R: SensorReading> Bundle for R {
    type Received = Received<R>;
    fn fetch(partners: &dyn Partners) -> Result<Self::Received, GeneratorError> {
        let reading = partners.reading(TypeId::of::<R>()).and_then(<dyn Any>::downcast_ref);
        reading.copied().ok_or(GeneratorError::NoSensor { reading: type_name::<R>() })
    }
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
        let provided = partners.gives_readings(TypeId::of::<R>());
        provided.then_some(()).ok_or(GeneratorError::NoSensor { reading: type_name::<R>() })
    }
}

impl<R: SensorReading, S: SensorReading> Bundle for (R, S) {
    type Received = (Received<R>, Received<S>);
    fn fetch(partners: &dyn Partners) -> Result<Self::Received, GeneratorError> {
        Ok((R::fetch(partners)?, S::fetch(partners)?))
    }
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
        R::require(partners).and(S::require(partners))
    }
}

impl<R: SensorReading, S: SensorReading, T: SensorReading> Bundle for (R, S, T) {
    type Received = (Received<R>, Received<S>, Received<T>);
    fn fetch(partners: &dyn Partners) -> Result<Self::Received, GeneratorError> {
        Ok((R::fetch(partners)?, S::fetch(partners)?, T::fetch(partners)?))
    }
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
        R::require(partners).and(S::require(partners)).and(T::require(partners))
    }
}

/// `V`: the readings of the agent's virtual sensors.
#[derive(Clone, Copy, Debug)]
pub struct V<B: Bundle>(pub B::Received);

/// `a0`: the order of the coordinator.
#[derive(Clone, Copy, Debug)]
pub struct A<C>(pub Received<C>);

/// Order of a coordinator, or answer to a coordinator.
pub trait Message: Copy + Send + Sync + 'static {}
impl<T: Copy + Send + Sync + 'static> Message for T {}

/// The partners of a subcontroller: its effector, its virtual sensors and the coordinator.
///
/// The flow chart reads the images that the generator declares, and no other image.
pub trait Partners {
    /// Present image of the effector. Fails if the measured positions are impossible for the mechanism.
    fn effector(&self) -> Result<EffectorImage, GeneratorError>;

    /// Whether a sensor has readings of this type.
    fn gives_readings(&self, _reading: TypeId) -> bool {
        false
    }

    /// Whether a coordinator gives orders of this type.
    fn gives_orders(&self, _order: TypeId) -> bool {
        false
    }

    /// The [`Received`] from the sensor with readings of this type.
    fn reading(&self, _reading: TypeId) -> Option<&dyn Any> {
        None
    }

    /// The [`Received`] from the coordinator, if its orders have this type.
    fn order(&self, _order: TypeId) -> Option<&dyn Any> {
        None
    }

    /// Records an event of the flow chart.
    fn note(&mut self, _event: StepEvent) {}

    /// Passes a command to the sensor that takes commands of this type. Returns whether there is one.
    fn tell(&mut self, _command: &dyn Any) -> bool {
        false
    }

    /// Passes an answer to the coordinator. Returns whether a coordinator takes answers of this type.
    fn answer(&mut self, _answer: &dyn Any) -> bool {
        false
    }
}

mod closed {
    use super::{A, Bundle, EffectorImage, Message, V};

    /// Closes [`Images`](super::Images): only this module decides which types are sets of images.
    #[diagnostic::on_unimplemented(
        message = "`{Self}` cannot become a set of images: the sets are closed",
        label = "is no set of images",
        note = "declare `()`, `EffectorImage`, `V<..>`, `A<..>` or a tuple of these in this order, and keep other data in \
                the generator or its memory"
    )]
    pub trait ImageSet {}
    impl ImageSet for () {}
    impl ImageSet for EffectorImage {}
    impl<B: Bundle> ImageSet for V<B> {}
    impl<C: Message> ImageSet for A<C> {}
    impl<B: Bundle> ImageSet for (EffectorImage, V<B>) {}
    impl<C: Message> ImageSet for (EffectorImage, A<C>) {}
    impl<B: Bundle, C: Message> ImageSet for (V<B>, A<C>) {}
    impl<B: Bundle, C: Message> ImageSet for (EffectorImage, V<B>, A<C>) {}
}

/// A set of images: `()` is the empty set, [`EffectorImage`] is `e`, [`V`] the readings of virtual sensors, [`A`] the
/// order of the coordinator. Tuples in this order are the combinations. These are the eight classes.
///
/// The trait is sealed: a generator cannot read undeclared images through a type that the program defines.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no set of images",
    label = "is no set of images",
    note = "a generator reads `()`, `EffectorImage`, `V<..>`, `A<..>`, or a tuple of these images in this order"
)]
pub trait Images: closed::ImageSet + Copy + Send + Sync + 'static {
    /// The class *q*: 1 for `e`, plus 2 for `V`, plus 4 for `a0`.
    const CLASS: u8;

    /// Takes the snapshot.
    fn fetch(partners: &dyn Partners) -> Result<Self, GeneratorError>;

    /// Refuses partners that cannot provide these images.
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError>;
}

/// Images that a coordinator declares beside the answers of its members: `()`, or [`V`] for sensors of its own.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no image of a coordinator",
    note = "a coordinator reads the answers of its members, and `()` or `V<..>` from sensors of its own"
)]
pub trait Readings: Images {}
impl Readings for () {}
impl<B: Bundle> Readings for V<B> {}

impl Images for () {
    const CLASS: u8 = 0;
    fn fetch(_: &dyn Partners) -> Result<Self, GeneratorError> {
        Ok(())
    }
    fn require(_: &dyn Partners) -> Result<(), GeneratorError> {
        Ok(())
    }
}

impl Images for EffectorImage {
    const CLASS: u8 = 1;
    fn fetch(partners: &dyn Partners) -> Result<Self, GeneratorError> {
        partners.effector()
    }
    fn require(_: &dyn Partners) -> Result<(), GeneratorError> {
        Ok(())
    }
}

impl<B: Bundle> Images for V<B> {
    const CLASS: u8 = 2;
    fn fetch(partners: &dyn Partners) -> Result<Self, GeneratorError> {
        Ok(Self(B::fetch(partners)?))
    }
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
        B::require(partners)
    }
}

impl<C: Message> Images for A<C> {
    const CLASS: u8 = 4;
    fn fetch(partners: &dyn Partners) -> Result<Self, GeneratorError> {
        let order = partners.order(TypeId::of::<C>()).and_then(<dyn Any>::downcast_ref);
        order.copied().map(Self).ok_or(GeneratorError::NoOrders { order: type_name::<C>() })
    }
    fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
        let provided = partners.gives_orders(TypeId::of::<C>());
        provided.then_some(()).ok_or(GeneratorError::NoOrders { order: type_name::<C>() })
    }
}

/// Combinations of images, all of one snapshot.
macro_rules! combinations {
    ($($class:literal: [$($generics:tt)*] $($image:ty),+;)+) => {$(
        impl<$($generics)*> Images for ($($image),+) {
            const CLASS: u8 = $class;
            fn fetch(partners: &dyn Partners) -> Result<Self, GeneratorError> {
                Ok(($(<$image>::fetch(partners)?),+))
            }
            fn require(partners: &dyn Partners) -> Result<(), GeneratorError> {
                $(<$image>::require(partners)?;)+
                Ok(())
            }
        }
    )+};
}

combinations! {
    3: [B: Bundle] EffectorImage, V<B>;
    5: [C: Message] EffectorImage, A<C>;
    6: [B: Bundle, C: Message] V<B>, A<C>;
    7: [B: Bundle, C: Message] EffectorImage, V<B>, A<C>;
}
