//! Journal of a servo: all inputs of the servo, except the inputs that its groups read from ports.
//!
//! The journal contains the calls of the servo with their times. For each cycle, the journal contains the new orders,
//! the missed deadlines, the stop request, the speed override, and the words that other threads set. Two servos with
//! the same configuration, ports and journal have the same outputs bit for bit. Another thread drains the journal.
//! Writing to the journal neither allocates nor waits. Entries for which the journal has no room are counted, and the
//! journal is then incomplete.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::{Order, ServoFault};

/// One entry of a journal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JournalEntry {
    /// Time of the call, as the caller gave it.
    pub now: Instant,
    /// The event.
    pub event: JournalEvent,
}

/// An event of a journal. The events of a cycle are in this order: `Cycle`, `Orders` and `Fault` by effector, `Word`,
/// `Sent`, `Timing`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JournalEvent {
    /// A poll of the bring-up.
    BringUp {
        /// Whether a stop was requested.
        stop: bool,
    },
    /// The set-points of a cycle were found.
    Cycle {
        /// Number of the cycle, from 0.
        number: u64,
        /// Deadlines missed since the last cycle.
        missed: u32,
        /// Whether a stop was requested.
        stop: bool,
        /// Requested rate of motion time, 0 to 1.
        rate: f64,
    },
    /// The effector of this index found new orders in its queue. [`JournalReader::order`] has them.
    Orders {
        /// Index of the effector.
        effector: u8,
        /// Number of the orders.
        count: u32,
    },
    /// The fault of the effector of this index changed.
    Fault {
        /// Index of the effector.
        effector: u8,
        /// The fault; `None` after a reset.
        fault: Option<ServoFault>,
    },
    /// The cycle, or the poll of the bring-up, used a new value of the watched word of this index.
    Word {
        /// Index of the word.
        index: u16,
        /// Its value.
        value: u64,
    },
    /// The batch was handed to the ports.
    Sent,
    /// The power of all axes was switched off without braking, because a cycle failed.
    Cut,
    /// Punctuality of the cycle before, measured by the servo thread.
    Timing {
        /// Time from the deadline to the sending of the batch.
        late: Duration,
        /// Duration of the cycle, without waiting.
        step: Duration,
    },
}

/// The servo's end of a journal.
pub(crate) struct Journal {
    entries: Producer<JournalEntry>,
    orders: Producer<Order>,
    lost: Arc<AtomicU64>,
    words: Vec<(Arc<AtomicU64>, u64)>,
    /// Fault of each effector in the last cycle.
    faults: Vec<Option<ServoFault>>,
}

/// The reading end of a journal, for another thread.
#[derive(Debug)]
pub struct JournalReader {
    entries: Consumer<JournalEntry>,
    orders: Consumer<Order>,
    lost: Arc<AtomicU64>,
}

impl Journal {
    /// Both ends of a journal of `entries` entries and `orders` orders. The journal contains each change of one of `words`.
    pub(crate) fn new(
        entries: usize,
        orders: usize,
        words: Vec<Arc<AtomicU64>>,
        effectors: usize,
    ) -> (Self, JournalReader) {
        let (mut entries, mut read_entries) = RingBuffer::new(entries);
        let (mut orders, mut read_orders) = RingBuffer::new(orders);
        // Every page is touched here: no cycle waits for one.
        while entries.push(JournalEntry { now: Instant::ZERO, event: JournalEvent::Sent }).is_ok() {}
        while read_entries.pop().is_ok() {}
        while orders.push(Order::Stop).is_ok() {}
        while read_orders.pop().is_ok() {}
        let lost = Arc::new(AtomicU64::new(0));
        let reader = JournalReader { entries: read_entries, orders: read_orders, lost: Arc::clone(&lost) };
        let words = words.into_iter().map(|word| (Arc::clone(&word), word.load(Ordering::Relaxed))).collect();
        (Self { entries, orders, lost, words, faults: vec![None; effectors] }, reader)
    }

    pub(crate) fn note(&mut self, now: Instant, event: JournalEvent) {
        if self.entries.push(JournalEntry { now, event }).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Stores an order that the next entry [`JournalEvent::Orders`] counts. False if there is no room.
    pub(crate) fn keep(&mut self, order: &Order) -> bool {
        let kept = self.orders.push(*order).is_ok();
        self.lost.fetch_add(u64::from(!kept), Ordering::Relaxed);
        kept
    }

    /// Notes the fault of effector `index` if it changed.
    pub(crate) fn note_fault(&mut self, now: Instant, index: usize, fault: Option<ServoFault>) {
        if self.faults[index] != fault {
            self.faults[index] = fault;
            self.note(now, JournalEvent::Fault { effector: index as u8, fault });
        }
    }

    /// Notes the watched words that changed.
    pub(crate) fn note_words(&mut self, now: Instant) {
        for index in 0..self.words.len() {
            let (word, last) = &mut self.words[index];
            let value = word.load(Ordering::Relaxed);
            if value != *last {
                *last = value;
                self.note(now, JournalEvent::Word { index: index as u16, value });
            }
        }
    }
}

impl JournalReader {
    /// The oldest entry that was not read yet.
    pub fn read(&mut self) -> Option<JournalEntry> {
        self.entries.pop().ok()
    }

    /// The next of the orders that the last entry [`JournalEvent::Orders`] counted.
    pub fn order(&mut self) -> Option<Order> {
        self.orders.pop().ok()
    }

    /// Entries and orders that found no room.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}
