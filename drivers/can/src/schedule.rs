//! Worst-case bus load and response times of a cyclic traffic pattern.
//!
//! SYNC starts each cycle: the host queues a batch of frames, and the nodes answer. All frames of a cycle must have
//! left the bus before the next cycle begins. The response time of a message is its own time on the wire plus:
//! - the longest frame that can already be on the wire;
//! - the frames before the message in the queue of its sender;
//! - the frames that win arbitration against the message or against a frame before it in the queue.
//!
//! A frame that may recur within a cycle counts as often as its interval permits.
//! Each frame is counted with the largest possible number of stuff bits. Error frames, retransmissions and frames sent
//! only after faults are not counted. The drivers tolerate the delay from such frames.

use std::time::Duration;

use crate::StandardId;
use crate::timing::{Bitrate, Format, worst_case_bits};

/// A recurring message. Messages in a slice are in the order of their senders' queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// Identifier. A lower identifier has priority.
    pub id: StandardId,
    /// Payload bytes.
    pub bytes: u8,
    /// Sender of the message. Messages of one sender leave in queue order.
    pub sender: Sender,
    /// Recurrence of the message.
    pub every: Every,
}

/// The sender of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sender {
    /// The host, which sends SYNC.
    Host,
    /// The node with this node-ID.
    Node(u8),
}

/// Recurrence of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Every {
    /// Once in each cycle. The end of the cycle is the deadline.
    Cycle,
    /// Once in this number of cycles, at least 1. The deadline of the message is the end of its cycle.
    Cycles(u32),
    /// At most once in this interval, without a deadline.
    Interval(Duration),
}

impl Every {
    /// Whether the message must end within its cycle.
    pub fn has_deadline(self) -> bool {
        match self {
            Self::Cycle | Self::Cycles(_) => true,
            Self::Interval(_) => false,
        }
    }
}

/// Result of [`analyse`].
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Long-term bus load of all messages; 1 is a full bus.
    pub load: f64,
    /// Worst-case response time of each message, from the start of the cycle to its last bit. The time of an
    /// [`Every::Interval`] message starts at its queueing, and includes each frame ahead as often as it occurs in a
    /// cycle.
    pub responses: Vec<Duration>,
    /// Latest end of the last cyclic message, from the start of the cycle.
    pub busy: Duration,
}

/// Worst-case load and response times of `messages` on a bus with this cycle time.
pub fn analyse(bitrate: Bitrate, cycle: Duration, messages: &[Message]) -> Analysis {
    let time = |message: &Message| bitrate.duration(worst_case_bits(Format::Standard, message.bytes));
    let rate = |message: &Message| match message.every {
        Every::Cycle => 1.0 / cycle.as_secs_f64(),
        Every::Cycles(count) => 1.0 / (cycle.as_secs_f64() * f64::from(count)),
        Every::Interval(interval) => 1.0 / interval.as_secs_f64(),
    };
    let times = |message: &Message| time(message) * occurrences(message, cycle);
    let responses: Vec<Duration> = (0..messages.len())
        .map(|index| before(messages, index).map(times).sum::<Duration>() + blocking(messages, index, time))
        .collect();
    let cyclic = messages.iter().zip(&responses).filter(|(message, _)| message.every.has_deadline());
    Analysis {
        load: messages.iter().map(|message| time(message).as_secs_f64() * rate(message)).sum(),
        busy: cyclic.map(|(_, response)| *response).max().unwrap_or_default(),
        responses,
    }
}

/// Greatest number of such messages in a cycle, if the first is queued at its beginning.
fn occurrences(message: &Message, cycle: Duration) -> u32 {
    match message.every {
        Every::Cycle | Every::Cycles(_) => 1,
        Every::Interval(interval) => {
            let count = cycle.as_nanos().div_ceil(interval.as_nanos().max(1));
            u32::try_from(count).unwrap_or(u32::MAX)
        }
    }
}

/// The message at `index` and the messages that can leave before it.
fn before(messages: &[Message], index: usize) -> impl Iterator<Item = &Message> {
    let own = messages[index];
    // The message waits for the frames before it in the queue, so frames with priority over any of these count too.
    let queued = messages[..=index].iter().filter(|message| message.sender == own.sender);
    let weakest = queued.map(|message| message.id).max().unwrap_or(own.id);
    let before = move |(position, message): &(usize, &Message)| {
        if message.sender == own.sender { *position <= index } else { message.id < weakest }
    };
    let messages = messages.iter().enumerate().filter(before);
    messages.map(|(_, message)| message)
}

/// Time of the longest frame not counted by [`before`] that can occupy the wire when the message at `index` is queued.
fn blocking(messages: &[Message], index: usize, time: impl Fn(&Message) -> Duration) -> Duration {
    let ahead: Vec<StandardId> = before(messages, index).map(|message| message.id).collect();
    messages.iter().filter(|message| !ahead.contains(&message.id)).map(time).max().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SYNC; per axis an RPDO of 6 bytes, a TPDO of 8 bytes and a heartbeat.
    fn axes(count: u8) -> Vec<Message> {
        let id = |raw| StandardId::new(raw).unwrap();
        let cyclic = |raw, bytes, sender| Message { id: id(raw), bytes, sender, every: Every::Cycle };
        let mut messages = vec![cyclic(0x080, 0, Sender::Host)];
        for node in 1..=count {
            messages.push(cyclic(0x200 + u16::from(node), 6, Sender::Host));
            messages.push(cyclic(0x180 + u16::from(node), 8, Sender::Node(node)));
        }
        for node in 1..=count {
            let every = Every::Interval(Duration::from_millis(100));
            messages.push(Message { id: id(0x700 + u16::from(node)), bytes: 1, sender: Sender::Node(node), every });
        }
        messages
    }

    #[test]
    fn a_cycle_is_busy_for_its_frames_and_one_that_blocks() {
        let microseconds = |axes: u64| 55 + 250 * axes + 65;
        for count in [1, 2, 3, 6, 7] {
            let analysis = analyse(Bitrate::KBPS_1000, Duration::from_millis(2), &axes(count));
            assert_eq!(analysis.busy, Duration::from_micros(microseconds(u64::from(count))), "{count} axes");
        }
    }

    #[test]
    fn load_is_the_share_of_the_cycle() {
        let analysis = analyse(Bitrate::KBPS_1000, Duration::from_millis(2), &axes(6));
        let heartbeats = 6.0 * 65e-6 / 0.1;
        assert!((analysis.load - (1555e-6 / 2e-3 + heartbeats)).abs() < 1e-12, "{}", analysis.load);
    }

    #[test]
    fn a_frame_that_recurs_within_a_cycle_delays_the_others_each_time() {
        let inputs = |micros| Message {
            id: StandardId::new(0x182).unwrap(),
            bytes: 1,
            sender: Sender::Node(2),
            every: Every::Interval(Duration::from_micros(micros)),
        };
        // The set-point loses against the answer and the inputs.
        for (micros, times) in [(5_000, 1), (2_000, 1), (1_000, 2), (500, 4)] {
            let messages = [axes(1), vec![inputs(micros)]].concat();
            let analysis = analyse(Bitrate::KBPS_1000, Duration::from_millis(2), &messages);
            let busy = 55 + 135 + 115 + 65 * times + 65;
            assert_eq!(analysis.busy, Duration::from_micros(busy), "{micros} µs");
        }
    }

    #[test]
    fn a_frame_of_every_fifth_cycle_has_a_deadline_and_a_fifth_of_the_load() {
        let (cycle, id) = (Duration::from_millis(2), StandardId::new(0x6A0).unwrap());
        let sample = |every| [Message { id, bytes: 8, sender: Sender::Node(3), every }];
        let [always, fifth] = [Every::Cycle, Every::Cycles(5)].map(|every| {
            let messages = [axes(1), sample(every).to_vec()].concat();
            analyse(Bitrate::KBPS_1000, cycle, &messages)
        });
        assert_eq!((always.busy, &always.responses), (fifth.busy, &fifth.responses));
        assert!((always.load - fifth.load - 135e-6 / 2e-3 * 0.8).abs() < 1e-12, "{} {}", always.load, fifth.load);
        // Without a deadline, the frame with the greatest identifier may follow in the next cycle.
        let timed = [axes(1), sample(Every::Interval(cycle)).to_vec()].concat();
        assert!(always.busy > analyse(Bitrate::KBPS_1000, cycle, &timed).busy);
    }

    #[test]
    fn sync_waits_for_one_frame_only() {
        let analysis = analyse(Bitrate::KBPS_1000, Duration::from_millis(2), &axes(6));
        assert_eq!(analysis.responses[0], Duration::from_micros(55 + 135));
    }

    #[test]
    fn a_message_behind_a_weaker_one_in_its_queue_is_overtaken_with_it() {
        let id = |raw| StandardId::new(raw).unwrap();
        let cyclic = |raw, bytes, sender| Message { id: id(raw), bytes, sender, every: Every::Cycle };
        let messages =
            [cyclic(0x300, 0, Sender::Host), cyclic(0x100, 0, Sender::Host), cyclic(0x200, 8, Sender::Node(1))];
        let analysis = analyse(Bitrate::KBPS_1000, Duration::from_millis(1), &messages);
        assert_eq!(analysis.responses[1], Duration::from_micros(55 + 55 + 135));
    }
}
