//! A link between the coordinator and one subcontroller: numbered messages in two bounded queues.

use std::any::{Any, TypeId};
use std::cell::Cell;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use can::Instant;
use thiserror::Error;

#[cfg(any(test, feature = "test-hooks"))]
use super::messages::Disturbance;
use super::messages::{Numbered, Receiver, Sender, pop, queue};
use crate::generator::{Message, Received, Sample};

/// Capacity of the queue of each direction, messages.
const QUEUE: usize = 4;

/// Behaviour of a member without a new order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    /// Whether step *m* waits for order *m*. If false, a step takes the latest order, if any, and the link keeps only
    /// the latest answer.
    pub blocking: bool,
    /// Longest wait for an order of a blocking link, in motion time. In motion, the servo also stops the team if the
    /// present macrostep ends without a next macrostep. A deadline longer than the time from the read of the images to
    /// the end of the macrostep therefore has no effect.
    pub deadline: Duration,
    /// Consequence of a late order of a blocking link.
    pub late: Late,
}

/// Consequence of an order that is late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Late {
    /// The step takes the last order, marked as old. The late order is dropped on arrival.
    Hold,
    /// The instruction ends with an error, and the effector brakes.
    Stop,
}

/// Errors of a link. `step` is the number of a macrostep of the coordinator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum LinkError {
    #[error("the order of step {step} did not come within {waited:?}")]
    Late { step: u64, waited: Duration },
    #[error("a message of step {received} came in place of that of step {expected}")]
    WrongStep { expected: u64, received: u64 },
    #[error("the other end of the link is gone")]
    Gone,
    #[error("{QUEUE} messages wait for the robot, which takes them in its motions")]
    Full,
    #[error("the robot moves in a team, whose coordinator ends the motion")]
    InTeam,
}

/// A wait that is measured in motion time, which stands still in a pause.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Patience {
    last: Option<Instant>,
    waited: Duration,
}

impl Patience {
    /// Motion time of the wait up to `now`, at this rate since the last call. The first call begins the wait.
    pub(crate) fn until(&mut self, now: Instant, rate: f64) -> Duration {
        let passed = self.last.replace(now).map_or(Duration::ZERO, |last| now.since(last));
        self.waited += passed.mul_f64(rate.clamp(0.0, 1.0));
        self.waited
    }
}

/// A message of the coordinator to a member.
#[derive(Clone, Copy, Debug)]
enum Directive<C> {
    /// The order of a step: next state or next pose.
    Next(C),
    /// The motion ends.
    EndMotion,
}

/// Transfer of answers.
enum Answers<Q, R> {
    /// A queue of all answers, if the link waits.
    All(Q),
    /// The latest answer, if the link does not wait.
    Latest(Arc<Mutex<Option<Numbered<R>>>>),
}

/// State of the next step of a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// The step takes place.
    Ready,
    /// The order has not arrived yet.
    Waiting,
    /// The coordinator has ended the motion.
    EndMotion,
}

/// The coordinator's end of a link.
pub struct CoordinatorEnd<C, R> {
    orders: Sender<Directive<C>>,
    answers: Answers<Receiver<R>, R>,
    /// Number of the next order of [`send`](Self::send), and of the next answer.
    next_order: u64,
    next_answer: u64,
}

/// The member's end of a link.
pub struct MemberEnd<C, R> {
    orders: Receiver<Directive<C>>,
    answers: Answers<Sender<R>, R>,
    config: LinkConfig,
    /// Number of the next order.
    next: u64,
    /// Number of the order of the first step.
    base: u64,
    /// Number of the present step of the instruction.
    step: u64,
    /// Number of the next answer.
    next_answer: u64,
    /// Orders below this number are late and dropped.
    held: u64,
    /// The wait for the order of the present step.
    wait: Patience,
    received: Received<C>,
    /// Whether a step has read the order received.
    read: Cell<bool>,
    ended: bool,
}

/// A new link.
pub fn link<C: Message, R: Message>(config: LinkConfig) -> (CoordinatorEnd<C, R>, MemberEnd<C, R>) {
    let (order_sender, orders) = queue(QUEUE);
    let (answers, answer_receiver) = if config.blocking {
        let (sender, receiver) = queue(QUEUE);
        (Answers::All(sender), Answers::All(receiver))
    } else {
        let latest = Arc::default();
        (Answers::Latest(Arc::clone(&latest)), Answers::Latest(latest))
    };
    let coordinator = CoordinatorEnd { orders: order_sender, answers: answer_receiver, next_order: 0, next_answer: 0 };
    let received = Received::None;
    let member = MemberEnd {
        orders,
        answers,
        config,
        next: 0,
        base: 0,
        step: 0,
        next_answer: 0,
        held: 0,
        wait: Patience::default(),
        received,
        read: Cell::new(false),
        ended: false,
    };
    (coordinator, member)
}

impl<C: Message, R: Message> CoordinatorEnd<C, R> {
    /// Gives the next order at `now`. Returns false if the queue is full.
    pub fn order(&mut self, now: Instant, order: C) -> bool {
        self.send(now, Directive::Next(order))
    }

    /// Ends the motion of the member at `now`. Returns false if the queue is full.
    pub fn end_motion(&mut self, now: Instant) -> bool {
        self.send(now, Directive::EndMotion)
    }

    /// The next answer with its number, if the answer was sent.
    pub fn answer(&mut self) -> Result<Option<(u64, Sample<R>)>, LinkError> {
        self.answer_by(Instant::FAR_FUTURE)
    }

    /// The next answer with its number, if the answer has arrived by `now`.
    pub(crate) fn answer_by(&mut self, now: Instant) -> Result<Option<(u64, Sample<R>)>, LinkError> {
        let (answer, gapless) = match &mut self.answers {
            Answers::All(queue) => (pop(queue, now), true),
            Answers::Latest(latest) => (lock(latest).take(), false),
        };
        let Some(Numbered { step, at, value, .. }) = answer else {
            return Ok(None);
        };
        if step != self.next_answer && (gapless || step < self.next_answer) {
            return Err(LinkError::WrongStep { expected: self.next_answer, received: step });
        }
        self.next_answer = step + 1;
        Ok(Some((step, Sample { at, age: Duration::ZERO, value })))
    }

    /// Whether the member has another link or is gone.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.orders.is_abandoned()
    }

    fn send(&mut self, at: Instant, value: Directive<C>) -> bool {
        let sent = self.orders.push(Numbered::new(self.next_order, at, value));
        self.next_order += u64::from(sent);
        sent
    }

    /// Disturbs the order of a step.
    #[cfg(any(test, feature = "test-hooks"))]
    #[doc(hidden)]
    pub fn disturb(&mut self, step: u64, disturbance: Disturbance) {
        self.orders.disturb(step, disturbance);
    }
}

/// The member's end, of any types of messages.
pub(crate) trait MemberLink: Send {
    /// Type of the orders.
    fn order_type(&self) -> TypeId;

    /// The present order, as a [`Received`]. The order counts as read.
    fn order(&self) -> &dyn Any;

    /// Begins an instruction: orders and the end of an earlier motion are dropped. A link that does not block keeps an
    /// unread order for the first step of this instruction.
    fn begin(&mut self);

    /// Takes all messages of a link that does not block, between two steps. On a blocking link, each step takes the
    /// message with its own number.
    fn receive(&mut self, now: Instant);

    /// Whether a message that was taken since [`begin`](Self::begin) ends the motion.
    fn is_ended(&self) -> bool;

    /// Whether a message that still waits in the queue ends a motion.
    fn holds_end(&mut self) -> bool;

    /// Age of the present order at `now`.
    fn age(&self, now: Instant) -> Option<Duration>;

    /// State of step number `step` of the instruction at `now`. Takes the order of the step. `rate` is the rate of motion
    /// time, in which deadlines are measured.
    fn poll(&mut self, step: u64, now: Instant, rate: f64) -> Result<Turn, LinkError>;

    /// Answers the present step. Returns false if the answer has another type, or if the queue of a blocking link is
    /// full.
    fn answer(&mut self, answer: &dyn Any, now: Instant) -> bool;
}

impl<C: Message, R: Message> MemberEnd<C, R> {
    /// Disturbs the answer of a step, if the link waits.
    #[cfg(any(test, feature = "test-hooks"))]
    #[doc(hidden)]
    pub fn disturb(&mut self, step: u64, disturbance: Disturbance) {
        if let Answers::All(queue) = &mut self.answers {
            queue.disturb(step, disturbance);
        }
    }

    /// Takes one order from the queue. Returns whether the queue had an order.
    fn take(&mut self, now: Instant) -> Result<bool, LinkError> {
        let Some(Numbered { step, at, value, .. }) = pop(&mut self.orders, now) else {
            return Ok(false);
        };
        // The end of the motion is never too late.
        let Directive::Next(value) = value else {
            (self.ended, self.next) = (true, step + 1);
            // Orders before the end are of the ended motion.
            self.read.set(true);
            return Ok(true);
        };
        if step < self.held {
            return Ok(true);
        }
        if step != self.next {
            return Err(LinkError::WrongStep { expected: self.next, received: step });
        }
        self.next += 1;
        self.received = Received::New(Sample { at, age: now.since(at), value });
        self.read.set(false);
        Ok(true)
    }

    /// Waits for the order of this number.
    fn wait(&mut self, number: u64, now: Instant, rate: f64) -> Result<Turn, LinkError> {
        if self.orders.is_abandoned() {
            return Err(LinkError::Gone);
        }
        let waited = self.wait.until(now, rate);
        match self.config.late {
            _ if waited <= self.config.deadline => return Ok(Turn::Waiting),
            Late::Stop => return Err(LinkError::Late { step: number, waited }),
            Late::Hold => {}
        }
        self.next = number + 1;
        self.held = self.next;
        Ok(Turn::Ready)
    }
}

impl<C: Message, R: Message> MemberLink for MemberEnd<C, R> {
    fn order_type(&self) -> TypeId {
        TypeId::of::<C>()
    }

    fn order(&self) -> &dyn Any {
        self.read.set(true);
        &self.received
    }

    fn begin(&mut self) {
        if self.config.blocking || self.read.get() {
            self.received = Received::None;
        }
        (self.ended, self.wait, self.step) = (false, Patience::default(), 0);
        self.base = self.next;
    }

    fn receive(&mut self, now: Instant) {
        // A message of another step is an error of the next step.
        while !self.config.blocking && matches!(self.take(now), Ok(true)) {}
    }

    fn is_ended(&self) -> bool {
        self.ended
    }

    fn holds_end(&mut self) -> bool {
        let waiting = self.orders.slots();
        let Ok(messages) = self.orders.read_chunk(waiting) else {
            return false;
        };
        let (first, second) = messages.as_slices();
        first.iter().chain(second).any(|message| matches!(message.value, Directive::EndMotion))
    }

    fn age(&self, now: Instant) -> Option<Duration> {
        self.received.sample().map(|sample| now.since(sample.at))
    }

    fn poll(&mut self, step: u64, now: Instant, rate: f64) -> Result<Turn, LinkError> {
        let next = step != self.step;
        if next {
            (self.step, self.wait) = (step, Patience::default());
        }
        self.received = self.received.at(now, next && (self.config.blocking || self.read.get()));
        if self.config.blocking {
            let number = self.base + step;
            while self.next <= number && !self.ended {
                if !self.take(now)? {
                    return self.wait(number, now, rate);
                }
            }
        } else {
            while self.take(now)? {}
        }
        Ok(if self.ended { Turn::EndMotion } else { Turn::Ready })
    }

    fn answer(&mut self, answer: &dyn Any, at: Instant) -> bool {
        let Some(&value) = answer.downcast_ref::<R>() else {
            return false;
        };
        let answer = Numbered::new(self.next_answer, at, value);
        match &mut self.answers {
            Answers::All(queue) => {
                if !queue.push(answer) {
                    return false;
                }
            }
            Answers::Latest(latest) => *lock(latest) = Some(answer),
        }
        self.next_answer += 1;
        true
    }
}

/// The latest answer. One thread uses both ends of the link, so the lock is always free.
fn lock<R>(latest: &Mutex<Option<Numbered<R>>>) -> MutexGuard<'_, Option<Numbered<R>>> {
    latest.lock().unwrap_or_else(PoisonError::into_inner)
}
