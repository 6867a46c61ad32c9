//! Numbered messages of a link, in a bounded queue.

#[cfg(any(test, feature = "test-hooks"))]
use std::time::Duration;

use can::Instant;

/// A message with its number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbered<T> {
    pub(super) step: u64,
    /// Time at which the message was sent.
    pub(super) at: Instant,
    /// Time before which a message does not arrive that a test delays; zero for all other messages.
    due: Instant,
    pub(super) value: T,
}

impl<T> Numbered<T> {
    /// Message number `step`, sent at `at`.
    pub(super) fn new(step: u64, at: Instant, value: T) -> Self {
        Self { step, at, due: Instant::ZERO, value }
    }
}

/// The sending end of a queue.
pub(super) struct Sender<T> {
    queue: rtrb::Producer<Numbered<T>>,
    #[cfg(any(test, feature = "test-hooks"))]
    disturbed: Option<(u64, Disturbance)>,
}

/// The receiving end of a queue.
pub(super) type Receiver<T> = rtrb::Consumer<Numbered<T>>;

/// A queue of `capacity` messages.
pub(super) fn queue<T>(capacity: usize) -> (Sender<T>, Receiver<T>) {
    let (queue, receiver) = rtrb::RingBuffer::new(capacity);
    let sender = Sender {
        queue,
        #[cfg(any(test, feature = "test-hooks"))]
        disturbed: None,
    };
    (sender, receiver)
}

/// The next message that has arrived by `now`.
pub(super) fn pop<T: Copy>(queue: &mut Receiver<T>, now: Instant) -> Option<Numbered<T>> {
    queue.peek().is_ok_and(|message| message.due <= now).then(|| queue.pop().ok())?
}

impl<T: Copy> Sender<T> {
    /// Whether the receiving end is gone.
    pub(super) fn is_abandoned(&self) -> bool {
        self.queue.is_abandoned()
    }

    /// Queues a message. Returns false if the queue is full.
    pub(super) fn push(&mut self, message: Numbered<T>) -> bool {
        #[cfg(any(test, feature = "test-hooks"))]
        if let Some((step, disturbance)) = self.disturbed
            && step == message.step
        {
            return self.push_disturbed(message, disturbance);
        }
        self.queue.push(message).is_ok()
    }
}

/// Disturbance of one message of a link.
#[cfg(any(test, feature = "test-hooks"))]
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// The message does not arrive.
    Lost,
    /// The message arrives twice.
    Doubled,
    /// The message has the number of the next step, as if both were exchanged. Orders and answers alternate: the next
    /// message is sent only after the other end has taken this one. An exchange of two messages is therefore a loss.
    Swapped,
    /// The message arrives this much later.
    Late(Duration),
}

#[cfg(any(test, feature = "test-hooks"))]
impl<T: Copy> Sender<T> {
    /// Disturbs the message of a step.
    pub(super) fn disturb(&mut self, step: u64, disturbance: Disturbance) {
        self.disturbed = Some((step, disturbance));
    }

    fn push_disturbed(&mut self, message: Numbered<T>, disturbance: Disturbance) -> bool {
        match disturbance {
            Disturbance::Lost => true,
            Disturbance::Doubled => self.queue.push(message).is_ok() && self.queue.push(message).is_ok(),
            Disturbance::Swapped => self.queue.push(Numbered { step: message.step + 1, ..message }).is_ok(),
            Disturbance::Late(late) => self.queue.push(Numbered { due: message.at + late, ..message }).is_ok(),
        }
    }
}
