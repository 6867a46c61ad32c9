//! What a controller reads from and writes to an I/O node: latest values, without waiting.

use std::array;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;
use canopen::NodeId;
use canopen::cia401::CHANNELS;

use super::edges::{self, Edge, EdgesLost, History};
use super::fault::{self, IoFault};
use crate::latest::{Latest, Publisher, latest};
use crate::{Request, Word};

/// Greatest number of inputs of a node.
const INPUTS: usize = CHANNELS as usize;

/// One input of a node that works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Input {
    /// Level in the last frame of the node.
    pub level: bool,
    /// Changes of the level since the end of bring-up. Changes during a fault are not counted.
    pub edges: u64,
    /// Receive time of the frame that first showed the present level; `None` without an edge.
    pub last_edge: Option<Instant>,
}

/// An output command that the port took. Each heartbeat period repeats the last command; a repetition does not change
/// this value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SentOutputs {
    /// Level of output *n* in bit *n*.
    pub levels: u64,
    /// Number of the first cycle that sent these levels.
    pub cycle: u64,
    /// Time of that cycle.
    pub at: Instant,
}

/// An error that a node reported by EMCY (CiA 301 §7.2.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IoError {
    /// Error code of CiA 301 or of the vendor.
    pub code: u16,
    /// Object 0x1001.
    pub register: u8,
    /// Receive time of the EMCY.
    pub at: Instant,
}

/// State of an I/O node in one cycle. Cycles count from 0 at the end of bring-up.
///
/// The owner of the bus publishes an image in every cycle. [`at`](Self::at) of the latest image stays behind the clock
/// if the cycle does not run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputImage {
    /// Number of the cycle that published the image.
    pub cycle: u64,
    /// Time of that cycle.
    pub at: Instant,
    /// Receive time of the last frame of the node, inputs or heartbeat.
    pub heard: Instant,
    /// Receive time of the last frame with inputs.
    pub received: Instant,
    /// The fault of the node.
    pub fault: Option<IoFault>,
    /// The last error that the node reported by EMCY since the end of bring-up. An EMCY with the error register 0 ends
    /// it, and so does a [reset](IoLink::reset_fault). An error is no [`fault`](Self::fault): the node goes on.
    pub error: Option<IoError>,
    /// The last output command that the port took; `None` before the first since the start of the node.
    pub sent: Option<SentOutputs>,
    /// Number of inputs.
    pub(super) inputs: u8,
    pub(super) levels: u64,
    pub(super) edges: [u64; INPUTS],
    /// Zero without an edge.
    pub(super) last_edge: [Instant; INPUTS],
    pub(super) history: History,
}

/// Words of an image in front of those of each input: counters, times, levels, outputs, fault and error.
const HEAD: usize = 13;

/// Words of an image.
const WORDS: usize = HEAD + 2 * INPUTS + edges::WORDS;

/// The writing end of the image of a node.
pub(super) type ImagePublisher = Publisher<WORDS>;

impl InputImage {
    /// The image before operation.
    pub(super) fn not_started(node: NodeId, inputs: u8) -> Self {
        Self {
            cycle: 0,
            at: Instant::ZERO,
            heard: Instant::ZERO,
            received: Instant::ZERO,
            fault: Some(IoFault::NotStarted { node: node.raw() }),
            error: None,
            sent: None,
            inputs,
            levels: 0,
            edges: [0; INPUTS],
            last_edge: [Instant::ZERO; INPUTS],
            history: History::EMPTY,
        }
    }

    /// Input `number`, from 0. `None` while the node has a [`fault`](Self::fault), and beyond the inputs of the node.
    pub fn input(&self, number: u8) -> Option<Input> {
        if self.fault.is_some() || number >= self.inputs {
            return None;
        }
        let index = usize::from(number);
        let edges = self.edges[index];
        Some(Input {
            level: self.levels >> number & 1 == 1,
            edges,
            last_edge: (edges > 0).then_some(self.last_edge[index]),
        })
    }

    /// Number of edges of all inputs since the end of bring-up. Edges during a fault are not counted.
    pub fn edge_count(&self) -> u64 {
        self.history.count
    }

    /// The edges of all inputs after the first `seen` edges, oldest first. `seen` is the
    /// [`edge_count`](Self::edge_count) of the last image that the reader took, and zero for all edges. Fails if
    /// the image no longer has all of them: an image has the last [`EDGES`](super::EDGES) edges.
    pub fn edges_since(&self, seen: u64) -> Result<impl Iterator<Item = Edge> + '_, EdgesLost> {
        self.history.since(seen)
    }

    /// Time from the last frame of the node to the cycle of the image.
    pub fn age(&self) -> Duration {
        self.at.since(self.heard)
    }

    pub(super) fn words(&self) -> [u64; WORDS] {
        let mut words = [0; WORDS];
        let (fault, value) = fault::words(self.fault);
        let no_error = IoError { code: 0, register: 0, at: Instant::ZERO };
        let error = self.error.unwrap_or(no_error);
        let sent = self.sent.unwrap_or(SentOutputs { levels: 0, cycle: 0, at: Instant::ZERO });
        words[..HEAD].copy_from_slice(&[
            self.cycle,
            self.at.as_nanos(),
            self.heard.as_nanos(),
            self.received.as_nanos(),
            self.levels,
            u64::from(self.inputs) | u64::from(self.sent.is_some()) << 8 | u64::from(self.error.is_some()) << 9,
            sent.levels,
            sent.cycle,
            sent.at.as_nanos(),
            fault,
            value,
            u64::from(error.code) | u64::from(error.register) << 16,
            error.at.as_nanos(),
        ]);
        let (lines, history) = words[HEAD..].split_at_mut(2 * INPUTS);
        self.history.write(history);
        let (edges, times) = lines.split_at_mut(INPUTS);
        edges.copy_from_slice(&self.edges);
        for (word, time) in times.iter_mut().zip(self.last_edge) {
            *word = time.as_nanos();
        }
        words
    }

    pub(super) fn from_words(words: &[u64; WORDS]) -> Self {
        let time = |word: usize| Instant::from_nanos(words[word]);
        let sent = SentOutputs { levels: words[6], cycle: words[7], at: time(8) };
        let error = IoError { code: words[11] as u16, register: (words[11] >> 16) as u8, at: time(12) };
        Self {
            cycle: words[0],
            at: time(1),
            heard: time(2),
            received: time(3),
            levels: words[4],
            inputs: words[5] as u8,
            sent: (words[5] & 1 << 8 != 0).then_some(sent),
            fault: fault::of_words(words[9], words[10]),
            error: (words[5] & 1 << 9 != 0).then_some(error),
            edges: array::from_fn(|input| words[HEAD + input]),
            last_edge: array::from_fn(|input| time(HEAD + INPUTS + input)),
            history: History::read(&words[HEAD + 2 * INPUTS..]),
        }
    }
}

/// The latest image of a node, for any number of readers. A read neither waits nor delays the cycle.
#[derive(Clone, Debug)]
pub struct LatestInputs(Latest<WORDS>);

impl LatestInputs {
    /// The latest image. All its fields are of one cycle.
    pub fn read(&self) -> InputImage {
        InputImage::from_words(&self.0.read())
    }
}

/// The commanded levels of the outputs of a node, for any number of writers. A write does not wait. The owner of the
/// bus takes the word once per cycle and sends it if it changed. Two changes within a cycle may become one or none.
#[derive(Clone, Debug)]
pub struct OutputCommand {
    levels: Arc<AtomicU64>,
    /// The levels that the owner of the bus took last.
    taken: Arc<AtomicU64>,
}

impl OutputCommand {
    /// Commands the level of output `number`, from 0. An output that the node lacks is ignored.
    pub fn set(&self, number: u8, level: bool) {
        let bit = 1_u64.checked_shl(number.into()).unwrap_or(0);
        if level {
            self.levels.fetch_or(bit, Ordering::AcqRel);
        } else {
            self.levels.fetch_and(!bit, Ordering::AcqRel);
        }
    }

    /// Commands all outputs at once, output *n* by bit *n*.
    pub fn set_all(&self, levels: u64) {
        self.levels.store(levels, Ordering::Release);
    }

    /// The commanded levels.
    pub fn levels(&self) -> u64 {
        self.levels.load(Ordering::Acquire)
    }

    /// The commanded levels, as the owner of the bus takes them.
    pub(super) fn take(&self) -> u64 {
        let levels = self.levels();
        self.taken.store(levels, Ordering::Relaxed);
        levels
    }
}

/// The controller's end of an I/O node.
#[derive(Clone, Debug)]
pub struct IoLink {
    /// Node-ID.
    pub node: NodeId,
    /// Inputs, state of the outputs, fault and error.
    pub inputs: LatestInputs,
    /// Commands to the outputs. A bring-up sets them to the levels of the error state
    /// ([`IoConfig::error_mode`](super::IoConfig::error_mode)), and so does a reset.
    pub outputs: OutputCommand,
    reset: Request,
}

impl IoLink {
    /// The link of a node whose first image is `image`, and the writing end of its images.
    pub(super) fn new(node: NodeId, image: &InputImage, levels: u64) -> (ImagePublisher, Self) {
        let (publisher, inputs) = latest(image.words());
        let [commanded, taken] = [levels; 2].map(|levels| Arc::new(AtomicU64::new(levels)));
        let outputs = OutputCommand { levels: commanded, taken };
        (publisher, Self { node, inputs: LatestInputs(inputs), outputs, reset: Request::default() })
    }

    /// Requests a reset of the fault of the node, and does not wait. The owner of the bus resets the communication of
    /// the node, configures the node and starts it, as in bring-up. The axes of the bus go on. The fault ends when the
    /// node is operational and its inputs are known, some hundred cycles later. If the reset fails, the fault says so
    /// ([`IoFault::NotBack`], [`IoFault::NotConfigured`]), and a later request tries again.
    ///
    /// A node without a fault ignores the request.
    pub fn reset_fault(&self) {
        self.reset.request();
    }

    /// The words that the owner of the bus takes.
    pub fn words(&self) -> [Word; 2] {
        let outputs = self.outputs.clone();
        let taken = Arc::clone(&outputs.taken);
        [Word { taken, repeat: Box::new(move |levels| outputs.set_all(levels)) }, self.reset.word()]
    }

    pub(super) fn reset_request(&self) -> Request {
        self.reset.clone()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_published_is_read(
            head in any::<[u64; 8]>(),
            (kind, node, value) in (0..=13_u64, any::<u8>(), any::<u32>()),
            (sent, error, inputs) in (any::<bool>(), any::<bool>(), 0..=CHANNELS),
            edges in any::<u64>(),
        ) {
            let [cycle, at, heard, received, levels, sent_levels, sent_cycle, sent_at] = head;
            let time = Instant::from_nanos;
            let image = InputImage {
                cycle,
                at: time(at),
                heard: time(heard),
                received: time(received),
                fault: fault::of_words(kind | u64::from(node) << 8, value.into()),
                error: error.then_some(IoError { code: value as u16, register: node, at: time(heard) }),
                sent: sent.then_some(SentOutputs { levels: sent_levels, cycle: sent_cycle, at: time(sent_at) }),
                inputs,
                levels,
                edges: array::from_fn(|input| edges.wrapping_add(input as u64)),
                last_edge: array::from_fn(|input| time(edges ^ input as u64)),
                history: History::EMPTY,
            };
            let first = InputImage::not_started(NodeId::MIN, inputs);
            let (mut publisher, link) = IoLink::new(NodeId::MIN, &first, 0);
            prop_assert_eq!(link.inputs.read(), first);
            publisher.publish(&image.words());
            prop_assert_eq!(link.inputs.read(), image);
        }
    }

    #[test]
    fn outputs_are_commanded_one_by_one_or_all_at_once() {
        let (_publisher, link) = IoLink::new(NodeId::MIN, &InputImage::not_started(NodeId::MIN, 0), 0b100);
        let outputs = link.outputs.clone();
        outputs.set(0, true);
        outputs.set(2, false);
        outputs.set(63, true);
        outputs.set(64, true);
        assert_eq!(link.outputs.levels(), 1 << 63 | 1);
        outputs.set_all(6);
        assert_eq!(link.outputs.levels(), 6);
    }
}
