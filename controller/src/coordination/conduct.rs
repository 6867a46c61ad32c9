//! A coordinator at work: its flow chart on the links to the members.

use std::any::{Any, TypeId, type_name};
use std::cell::RefCell;
use std::task::Poll;
use std::time::Duration;

use can::Instant;

use super::{Coordinator, CoordinatorEnd, CoordinatorError, Patience};
use crate::ecp::{Planning, Preparation, StepEvent, StepLog, StepRecord};
use crate::generator::{Chart, EffectorImage, Functions, GeneratorError, Images, Outputs, Partners, Sample, digest};
use crate::sensor::{Prompt, Sensors};

/// Orders to all members, and a command to a sensor.
type Results<K, const N: usize> = ([<K as Coordinator<N>>::Order; N], <K as Coordinator<N>>::Out);

/// A coordinator as functions of the flow chart.
pub(crate) struct Lead<K, const N: usize>(K);

impl<K: Coordinator<N>, const N: usize> Functions for Lead<K, N> {
    type First = K::Sensors;
    type Every = ([Sample<K::Answer>; N], K::Sensors);
    type Memory = K::Memory;
    type Results = Results<K, N>;

    fn first_step(
        &mut self,
        sensors: &K::Sensors,
        macrostep: Duration,
    ) -> Result<(Results<K, N>, K::Memory), GeneratorError> {
        self.0.first_step(sensors, macrostep).map(|next| ((next.orders, next.out), next.memory))
    }

    fn terminal(&self, memory: &K::Memory, (answers, sensors): &Self::Every) -> bool {
        self.0.terminal(memory, answers, sensors)
    }

    fn next_step(
        &self,
        memory: &K::Memory,
        (answers, sensors): &Self::Every,
    ) -> Result<(Results<K, N>, K::Memory), GeneratorError> {
        self.0.next_step(memory, answers, sensors).map(|next| ((next.orders, next.out), next.memory))
    }
}

/// A coordinator before its first step, with the images of that step and its results.
struct First<K: Coordinator<N>, const N: usize> {
    chart: Chart<Lead<K, N>>,
    sensors: K::Sensors,
    results: Option<Results<K, N>>,
}

impl<K: Coordinator<N>, const N: usize> Preparation for First<K, N> {
    fn plan(&mut self, macrostep: Duration) -> Result<(), GeneratorError> {
        self.results = Some(self.chart.first_step(&self.sensors, macrostep)?);
        Ok(())
    }
}

/// State that a coordinator uses in one turn of its task.
pub(crate) struct Desk<'a> {
    /// Time of the last servo cycle.
    pub(crate) now: Instant,
    /// Speed of the motion time of the cell, by which deadlines count.
    pub(crate) rate: f64,
    /// Whether a member brakes. The instruction of this member is then ending, with an error if the member failed.
    pub(crate) braking: bool,
    /// The coordinators' journal.
    pub(crate) journal: &'a mut CoordinatorJournal,
    /// The planner of the first member.
    pub(crate) planning: &'a mut Planning,
    /// Time limit of the wait for the planner.
    pub(crate) planning_limit: Duration,
}

/// The journal of the coordinators of a cell.
#[derive(Default)]
pub(crate) struct CoordinatorJournal {
    pub(crate) log: Option<StepLog>,
    /// Number of motions begun.
    motions: u64,
}

/// Progress of a motion before its first orders.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Opening {
    New,
    /// Waits for the sensors.
    Reading,
    /// A planner computes the first step.
    Planning,
}

/// A coordinator at work on the links to its members. `N` is the number of members.
pub(crate) struct Conduct<'a, K: Coordinator<N>, const N: usize> {
    /// The coordinator. `None` while a planner has it.
    chart: Option<Chart<Lead<K, N>>>,
    links: [CoordinatorEnd<K::Order, K::Answer>; N],
    sensors: &'a mut Sensors,
    answers: [Option<Sample<K::Answer>>; N],
    macrostep: Duration,
    /// Longest wait for an answer or a reading is two macrosteps plus this time. The answers of the first steps have
    /// only the time limits of the members' planning.
    deadline: Duration,
    /// Number of the motion in the journal.
    motion: u64,
    phase: Opening,
    /// Number of the last orders; 0 before the first.
    step: u64,
    /// The wait since the last orders, or since the start of the motion.
    wait: Patience,
    /// Time at which the planner began.
    since: Instant,
}

impl<'a, K: Coordinator<N>, const N: usize> Conduct<'a, K, N> {
    pub(crate) fn new(
        coordinator: K,
        links: [CoordinatorEnd<K::Order, K::Answer>; N],
        sensors: &'a mut Sensors,
        macrostep: Duration,
        deadline: Duration,
    ) -> Self {
        Self {
            chart: Some(Chart::new(Lead(coordinator))),
            links,
            sensors,
            answers: [None; N],
            macrostep,
            deadline,
            motion: 0,
            phase: Opening::New,
            step: 0,
            wait: Patience::default(),
            since: Instant::ZERO,
        }
    }

    /// Begins the motion: reads the sensors, lets the planner compute the first step, and gives the first orders. Ready
    /// with the first orders.
    pub(crate) fn begin(&mut self, desk: &mut Desk) -> Poll<Result<(), CoordinatorError>> {
        if self.phase == Opening::New && desk.braking {
            // After a dropped motion.
            return Poll::Pending;
        }
        if self.phase == Opening::New {
            self.motion = desk.journal.motions;
            desk.journal.motions += 1;
            self.sensors.begin();
            self.sensors.initiate(desk.now);
            self.note(desk, StepEvent::Initiate);
            self.phase = Opening::Reading;
        }
        if self.phase == Opening::Reading {
            self.sensors.poll(desk.now);
            if !self.are_read(desk)? {
                return Poll::Pending;
            }
            let sensors = self.read(desk).map_err(|error| CoordinatorError::Generator { step: 0, error })?;
            let chart = self.chart.take().expect("a motion begins once");
            desk.planning.prepare(Box::new(First { chart, sensors, results: None }), self.macrostep);
            (self.phase, self.since) = (Opening::Planning, desk.now);
        }
        let Some((prepared, first)) = desk.planning.prepared() else {
            let waited = desk.now.since(self.since);
            let late = waited > desk.planning_limit;
            return if late { Poll::Ready(Err(CoordinatorError::Unplanned { waited })) } else { Poll::Pending };
        };
        first.map_err(|error| CoordinatorError::Generator { step: 0, error })?;
        let prepared: Box<dyn Any> = prepared;
        let first = prepared.downcast::<First<K, N>>().expect("a planner returns what it was given");
        let First { chart, results, .. } = *first;
        self.chart = Some(chart);
        Poll::Ready(self.give(results.expect("the first step is computed"), desk))
    }

    /// Advances the coordinator after its first orders. Ready at the end of the motion.
    pub(crate) fn poll(&mut self, desk: &mut Desk) -> Poll<Result<(), CoordinatorError>> {
        self.sensors.poll(desk.now);
        match self.advance(desk) {
            Ok(false) => Poll::Pending,
            Ok(true) => Poll::Ready(Ok(())),
            Err(error) => Poll::Ready(Err(error)),
        }
    }

    fn advance(&mut self, desk: &mut Desk) -> Result<bool, CoordinatorError> {
        let (step, now) = (self.step, desk.now);
        for (member, (link, answer)) in self.links.iter_mut().zip(&mut self.answers).enumerate() {
            if answer.is_none() {
                let came = link.answer_by(desk.now).map_err(|error| CoordinatorError::Link { step, member, error })?;
                *answer = came.map(|(_, sample)| sample);
            }
        }
        if let Some(member) = self.answers.iter().position(Option::is_none) {
            let waited = self.waited(desk);
            let limited = step > 0 && waited > self.deadline + self.macrostep * 2;
            return if limited { Err(CoordinatorError::Silent { step, member, waited }) } else { Ok(false) };
        }
        if !self.are_read(desk)? {
            return Ok(false);
        }
        let answers = std::mem::replace(&mut self.answers, [None; N]).map(|answer| answer.expect("all have answered"));
        let answers = answers.map(|answer| answer.aged(now));
        self.step += 1;
        let stamp = self.stamp(now);
        answers.iter().for_each(|answer| stamp.note(desk.journal, StepEvent::ReadAnswer, Some(answer.age), None));
        let of_step = |error| CoordinatorError::Generator { step: step + 1, error };
        let sensors = self.read(desk).map_err(of_step)?;
        self.note(desk, StepEvent::TerminalCondition);
        let chart = self.chart.as_mut().expect("the planner has returned it");
        if let Some(results) = chart.next_step(&(answers, sensors)).map_err(of_step)? {
            self.give(results, desk)?;
            return Ok(false);
        }
        // A member that has ended by itself takes no message.
        self.links.iter_mut().for_each(|link| _ = link.end_motion(now));
        Ok(true)
    }

    /// Whether the readings of all declared interactive sensors are available. Fails if a reading is too late.
    fn are_read(&mut self, desk: &Desk) -> Result<bool, CoordinatorError> {
        if K::Sensors::require(&Prompt(self.sensors)).is_ok() {
            return Ok(true);
        }
        let waited = self.waited(desk);
        let late = waited > self.deadline + self.macrostep * 2;
        if late { Err(CoordinatorError::Unread { step: self.step, waited }) } else { Ok(false) }
    }

    /// Motion time since the last orders. The wait restarts while a member brakes.
    fn waited(&mut self, desk: &Desk) -> Duration {
        if desk.braking {
            self.wait = Patience::default();
        }
        self.wait.until(desk.now, desk.rate)
    }

    /// Reads the coordinator's sensors.
    fn read(&mut self, desk: &mut Desk) -> Result<K::Sensors, GeneratorError> {
        let stamp = self.stamp(desk.now);
        K::Sensors::fetch(&Around { sensors: self.sensors, journal: RefCell::new(desk.journal), stamp })
    }

    fn give(&mut self, (orders, out): Results<K, N>, desk: &mut Desk) -> Result<(), CoordinatorError> {
        let (step, now) = (self.step, desk.now);
        self.note(desk, StepEvent::Functions);
        let stamp = self.stamp(now);
        let told = out.deliver(&mut Around { sensors: self.sensors, journal: RefCell::new(desk.journal), stamp });
        told.map_err(|error| CoordinatorError::Generator { step, error })?;
        for (member, (link, order)) in self.links.iter_mut().zip(orders).enumerate() {
            if !link.order(now, order) {
                return Err(CoordinatorError::Full { step, member });
            }
        }
        self.sensors.initiate(now);
        self.wait = Patience::default();
        self.wait.until(now, desk.rate);
        self.note(desk, StepEvent::Exchange);
        let memory = self.chart.as_ref().and_then(|chart| chart.memory.as_ref()).map(digest::of);
        stamp.note(desk.journal, StepEvent::Commit, None, memory);
        Ok(())
    }

    fn note(&self, desk: &mut Desk, event: StepEvent) {
        self.stamp(desk.now).note(desk.journal, event, None, None);
    }

    /// The present step in the journal. The members are the coordinator's partner, and their answers count as its image
    /// `e` in the class.
    fn stamp(&self, at: Instant) -> Stamp {
        let class = u8::from(self.step > 0) + K::Sensors::CLASS;
        Stamp { at, motion: self.motion, generator: type_name::<K>(), class, step: self.step }
    }
}

/// A step in the journal.
#[derive(Clone, Copy)]
struct Stamp {
    at: Instant,
    motion: u64,
    generator: &'static str,
    class: u8,
    step: u64,
}

impl Stamp {
    fn note(self, journal: &mut CoordinatorJournal, event: StepEvent, age: Option<Duration>, memory: Option<u64>) {
        let Self { at, motion, generator, class, step } = self;
        if let Some(log) = &mut journal.log {
            log.write(StepRecord { at, motion, generator, class, step, event, age, memory });
        }
    }
}

/// The sensors of a coordinator in one step. Every access is noted in the journal.
struct Around<'a> {
    sensors: &'a mut Sensors,
    journal: RefCell<&'a mut CoordinatorJournal>,
    stamp: Stamp,
}

impl Partners for Around<'_> {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        Err(GeneratorError::NoEffector)
    }

    fn gives_readings(&self, reading: TypeId) -> bool {
        self.sensors.provides(reading)
    }

    fn reading(&self, reading: TypeId) -> Option<&dyn Any> {
        let (received, age) = self.sensors.reading(reading)?;
        self.stamp.note(&mut self.journal.borrow_mut(), StepEvent::ReadSensor, age, None);
        Some(received)
    }

    fn tell(&mut self, command: &dyn Any) -> bool {
        self.stamp.note(self.journal.get_mut(), StepEvent::TellSensor, None, None);
        self.sensors.configure(command)
    }
}
