//! Journal of the steps of an agent: what happened in the flow chart, in order.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;

/// An event of the flow chart (figure 3 of the paper).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepEvent {
    /// An instruction begins.
    Initiate,
    /// The image of the effector is read.
    ReadEffector,
    /// The reading of a virtual sensor is read.
    ReadSensor,
    /// The order of the coordinator is read.
    ReadOrder,
    /// The answer of a member is read by the coordinator.
    ReadAnswer,
    /// The terminal condition is evaluated.
    TerminalCondition,
    /// The functions (5) to (8) are computed.
    Functions,
    /// (6) A command goes to a virtual sensor.
    TellSensor,
    /// (7) An answer goes to the coordinator.
    AnswerCoordinator,
    /// (5) A set-point goes to the effector, or the orders of a coordinator go to the members.
    Exchange,
    /// The results of the step are committed.
    Commit,
}

impl StepEvent {
    /// Name of the event in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Initiate => "initiate",
            Self::ReadEffector => "read-effector",
            Self::ReadSensor => "read-sensor",
            Self::ReadOrder => "read-order",
            Self::ReadAnswer => "read-answer",
            Self::TerminalCondition => "terminal-condition",
            Self::Functions => "functions",
            Self::TellSensor => "tell-sensor",
            Self::AnswerCoordinator => "answer-coordinator",
            Self::Exchange => "exchange",
            Self::Commit => "commit",
        }
    }
}

/// One event of the flow chart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRecord {
    /// Time of the event, as given to the process.
    pub at: Instant,
    /// Number of the instruction, from 0: motions of this process since its start.
    pub motion: u64,
    /// Type of the generator.
    pub generator: &'static str,
    /// Class of the first step or of the next steps.
    pub class: u8,
    /// Number of the step, 0 for the first step.
    pub step: u64,
    /// The event.
    pub event: StepEvent,
    /// Age of the image that was read.
    pub age: Option<Duration>,
    /// Digest of the memory, with a commit.
    pub memory: Option<u64>,
}

/// Writing end of a journal. Events that do not fit into the queue are lost and counted.
pub struct StepLog {
    queue: rtrb::Producer<StepRecord>,
    lost: Arc<AtomicU64>,
}

impl StepLog {
    /// Adds an event, if the queue has room.
    pub(crate) fn write(&mut self, record: StepRecord) {
        if self.queue.push(record).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Reading end of a journal.
pub struct StepRecords {
    /// The events, in order.
    pub queue: rtrb::Consumer<StepRecord>,
    lost: Arc<AtomicU64>,
}

impl StepRecords {
    /// Number of events that did not fit into the queue.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

/// A journal of at most `size` events that wait for their reader.
pub fn step_log(size: usize) -> (StepLog, StepRecords) {
    let (sender, queue) = rtrb::RingBuffer::new(size);
    let lost = Arc::new(AtomicU64::new(0));
    (StepLog { queue: sender, lost: Arc::clone(&lost) }, StepRecords { queue, lost })
}

/// The journal of a process, if it is kept, and the present step.
#[derive(Default)]
pub(super) struct Journal {
    pub(super) log: Option<StepLog>,
    /// Number of motions begun.
    motions: u64,
    generator: &'static str,
    class: u8,
    step: u64,
}

impl Journal {
    /// Begins an instruction.
    pub(super) fn begin(&mut self, now: Instant, generator: &'static str, class: u8) {
        self.motions += 1;
        (self.generator, self.class, self.step) = (generator, class, 0);
        self.note(now, StepEvent::Initiate, None);
    }

    /// Begins the next step.
    pub(super) fn next(&mut self, class: u8) {
        self.class = class;
        self.step += 1;
    }

    pub(super) fn note(&mut self, at: Instant, event: StepEvent, age: Option<Duration>) {
        self.record(at, event, age, None);
    }

    /// Notes a commit. The digest of the memory is computed only for a journal that is kept.
    pub(super) fn commit(&mut self, at: Instant, memory: impl FnOnce() -> u64) {
        if self.log.is_some() {
            self.record(at, StepEvent::Commit, None, Some(memory()));
        }
    }

    fn record(&mut self, at: Instant, event: StepEvent, age: Option<Duration>, memory: Option<u64>) {
        let Some(log) = &mut self.log else {
            return;
        };
        let (motion, generator, class, step) = (self.motions - 1, self.generator, self.class, self.step);
        log.write(StepRecord { at, motion, generator, class, step, event, age, memory });
    }
}
