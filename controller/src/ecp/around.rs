//! The partners of a subcontroller in one step: its effector, its virtual sensors and the coordinator.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::time::Duration;

use can::Instant;

use super::image::Effector;
use super::steps::{Journal, StepEvent};
use crate::coordination::MemberLink;
use crate::generator::{EffectorImage, GeneratorError, Partners};
use crate::sensor::Sensors;

/// The partners at time `now`, the time of the last servo cycle. Every access is noted in the journal.
pub(super) struct Around<'a> {
    pub(super) effector: &'a Effector,
    pub(super) sensors: &'a mut Sensors,
    pub(super) coordinator: Option<&'a mut (dyn MemberLink + 'static)>,
    pub(super) journal: RefCell<&'a mut Journal>,
    pub(super) now: Instant,
}

impl Around<'_> {
    fn noted(&self, event: StepEvent, age: Option<Duration>) {
        self.journal.borrow_mut().note(self.now, event, age);
    }
}

impl Partners for Around<'_> {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        let image = self.effector.read()?;
        self.noted(StepEvent::ReadEffector, Some(self.now.since(image.at)));
        Ok(image)
    }

    fn gives_readings(&self, reading: TypeId) -> bool {
        self.sensors.provides(reading)
    }

    fn gives_orders(&self, order: TypeId) -> bool {
        self.coordinator.as_ref().is_some_and(|link| link.order_type() == order)
    }

    fn reading(&self, reading: TypeId) -> Option<&dyn Any> {
        let (received, age) = self.sensors.reading(reading)?;
        self.noted(StepEvent::ReadSensor, age);
        Some(received)
    }

    fn order(&self, order: TypeId) -> Option<&dyn Any> {
        let link = self.coordinator.as_ref().filter(|link| link.order_type() == order)?;
        self.noted(StepEvent::ReadOrder, link.age(self.now));
        Some(link.order())
    }

    fn tell(&mut self, command: &dyn Any) -> bool {
        self.noted(StepEvent::TellSensor, None);
        self.sensors.configure(command)
    }

    fn answer(&mut self, answer: &dyn Any) -> bool {
        self.noted(StepEvent::AnswerCoordinator, None);
        self.coordinator.as_mut().is_some_and(|link| link.answer(answer, self.now))
    }

    fn note(&mut self, event: StepEvent) {
        self.noted(event, None);
    }
}
