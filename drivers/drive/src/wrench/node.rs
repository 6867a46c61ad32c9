//! One force/torque sensor on a CAN bus: conversion of frames to samples, and supervision of the node.

use std::time::Duration;

use can::{Instant, StandardId};
use canopen::nmt::NmtState;

use super::fault::WrenchFault;
use super::node_config::{Content, Trigger, WrenchNodeConfig};
use super::sampler::Sampler;
use super::state::WrenchLink;
use crate::bus::Syncs;
use crate::cia402::GroupConfig;
use crate::{BringUpError, Fault};

/// Time limit of the samples in bring-up, beside the boot time-out: multiple of the duration of one rate comparison.
const COMPARISONS: u32 = 4;

/// A force/torque sensor on a CAN bus.
///
/// Nothing here waits or allocates. The order of calls within a cycle is:
/// 1. [`begin_of_read`](Self::begin_of_read);
/// 2. [`take`](Self::take) and [`heard`](Self::heard), as frames arrive;
/// 3. [`end_of_read`](Self::end_of_read), which publishes the state.
pub(crate) struct WrenchNode {
    node: u8,
    trigger: Trigger,
    /// Without SYNC: longest time from the first frame of a sample to any other frame of the sample.
    apart: Duration,
    /// Time-out for the samples of bring-up.
    samples_within: Duration,
    heartbeat_lost_after: Duration,
    frames: Vec<FrameLayout>,
    /// Every frame of a sample carries a counter.
    numbered: bool,
    set: Set,
    late: LateFrames,
    last_counter: Option<u32>,
    sampler: Sampler,
    sampling: Sampling,
    /// Receive time of the last heartbeat.
    heartbeat: Instant,
    /// Time of the first cycle. Silence is measured from this time, because earlier frames may still wait in the port.
    since: Option<Instant>,
    operational: bool,
}

/// The samples that end bring-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sampling {
    /// Other nodes of the bus are not operational yet.
    NotBegun,
    Begun {
        since: Instant,
    },
    /// Samples have come at the declared rate.
    Compared,
}

/// Layout of one TPDO of a sample.
struct FrameLayout {
    cob_id: StandardId,
    /// Offset and meaning of each field.
    fields: Vec<(usize, Content)>,
    bytes: usize,
}

/// Detection of frames that come after the next SYNC. Without a counter, such a frame looks like a frame of that SYNC.
///
/// Frames become late one after the other. A SYNC without some of its frames therefore comes first. The missing frames
/// are lost or late. A late frame comes before the frames of its own SYNC, so that the order of the frames changes.
#[derive(Clone, Copy, Default)]
struct LateFrames {
    /// Missing frames that may still come late: frame *n* in bit *n*. 0 after a complete sample.
    owed: u8,
    /// Order of the frames of the last accepted sample.
    order: Option<Order>,
}

/// Numbers of the first frames of a sample in the order of their arrival: the first frame in the lowest four bits. Frame
/// *n* has the number *n* + 1.
type Order = u16;

/// The frames of one sample that have arrived.
#[derive(Clone, Copy, Default)]
struct Set {
    /// Frame *n* in bit *n*.
    frames: u8,
    /// The same frames in the order of their arrival.
    order: Order,
    /// Time of the SYNC, or receive time of the first frame.
    at: Instant,
    counts: [i32; 6],
    errors: u32,
    /// Value of the sensor's counter, and mask of its bits.
    counter: Option<(u32, u32)>,
}

impl WrenchNode {
    /// A sensor that has not been brought up, and the controller's end of it. The configuration is checked.
    pub(crate) fn new(group: &GroupConfig, config: &WrenchNodeConfig) -> (Self, WrenchLink) {
        let pace = config.pace(group);
        let (sampler, link) = Sampler::new(&config.sensor, pace);
        let layout = |pdo: &super::WrenchPdo| {
            let mut bytes = 0;
            let fields = pdo.fields.iter().map(|field| {
                let offset = bytes;
                bytes += usize::from(field.content.bytes());
                (offset, field.content)
            });
            FrameLayout { cob_id: pdo.cob_id, fields: fields.collect(), bytes }
        };
        let node = Self {
            node: config.node.raw(),
            trigger: config.trigger,
            apart: pace.declared() / 2,
            samples_within: group.boot_timeout + COMPARISONS * pace.first_comparison(),
            heartbeat_lost_after: group.heartbeat_lost_after(),
            frames: config.pdos.iter().map(layout).collect(),
            numbered: config.pdos.iter().all(|pdo| pdo.has_counter()),
            set: Set::default(),
            late: LateFrames::default(),
            last_counter: None,
            sampler,
            sampling: Sampling::NotBegun,
            heartbeat: Instant::ZERO,
            since: None,
            operational: false,
        };
        (node, link)
    }

    /// Whether SYNC makes the node sample.
    pub(crate) fn needs_sync(&self) -> bool {
        matches!(self.trigger, Trigger::Sync { .. })
    }

    /// Ends operation. Bring-up begins.
    pub(crate) fn reset(&mut self) {
        (self.set, self.late) = (Set::default(), LateFrames::default());
        (self.last_counter, self.sampling) = (None, Sampling::NotBegun);
        self.sampler.reset();
    }

    /// Starts operation after bring-up.
    pub(crate) fn begin(&mut self, now: Instant) {
        (self.since, self.operational) = (None, true);
        self.sampler.begin(now);
    }

    /// Judges the samples of bring-up once all nodes of the bus are operational. `synced`: whether a SYNC was sent
    /// since the last call. Returns whether the sensor is ready.
    pub(crate) fn is_ready(&mut self, now: Instant, synced: bool) -> Result<bool, BringUpError> {
        self.count_request(synced);
        let since = match self.sampling {
            Sampling::NotBegun => now,
            Sampling::Begun { since } => since,
            Sampling::Compared => return Ok(true),
        };
        let compared = self.sampler.compare_first(now.since(since), self.samples_within);
        let ready = compared.map_err(|error| BringUpError::WrenchNode { node: self.node, error })?;
        self.sampling = if ready { Sampling::Compared } else { Sampling::Begun { since } };
        Ok(ready)
    }

    fn count_request(&mut self, synced: bool) {
        if synced && self.needs_sync() {
            self.sampler.requested();
        }
    }

    /// Begins the reading of a cycle.
    pub(crate) fn begin_of_read(&mut self) {
        self.sampler.begin_of_read();
    }

    /// Index, among the frames of a sample, of the frame with this identifier.
    pub(crate) fn frame(&self, cob_id: StandardId) -> Option<usize> {
        self.frames.iter().position(|frame| frame.cob_id == cob_id)
    }

    /// Takes frame `index` of a sample, received at `at`. `None` means a payload of another length, or a frame that
    /// belongs to no SYNC.
    pub(crate) fn take(&mut self, index: usize, data: &[u8], at: Instant, syncs: &Syncs) -> Option<()> {
        let frame = self.frames.get(index)?;
        if data.len() != frame.bytes {
            self.sampler.garbage();
            return None;
        }
        let at = if self.needs_sync() { syncs.of_answer(at)? } else { at };
        let read = Set { at, ..Set::of(frame, data) };
        let (bit, all) = (1_u8 << index, u8::MAX >> (8 - self.frames.len()));
        let belongs = match self.trigger {
            Trigger::Sync { .. } => self.set.at == at,
            Trigger::EventTimer(_) => at.since(self.set.at) < self.apart,
        };
        let same = self.set.counter.is_none() || read.counter.is_none() || self.set.counter == read.counter;
        if self.set.frames == 0 || self.set.frames & bit != 0 || !belongs || !same {
            if self.set.frames != 0 {
                // The frames of a sample that is not complete are lost or late.
                self.late.owed = all & !self.set.frames;
                self.sampler.incomplete();
            }
            self.set = Set { at, ..Set::default() };
        }
        self.set.add(frame, &read, index);
        if self.set.frames != all {
            return Some(());
        }
        if self.needs_sync() && !self.numbered && self.late.are_in(&self.set) {
            // The late frames belong to a sample that was already counted as incomplete.
            self.set.remove(self.late.owed);
        } else {
            let set = std::mem::take(&mut self.set);
            self.late = LateFrames { owed: 0, order: Some(set.order) };
            self.complete(&set);
        }
        Some(())
    }

    /// Takes a whole sample. A sample with the counter value of the last sample is a repetition, and is dropped.
    fn complete(&mut self, set: &Set) {
        self.sampler.status(set.errors);
        if let Some((counter, mask)) = set.counter {
            let step = self.last_counter.map_or(1, |last| counter.wrapping_sub(last) & mask);
            self.last_counter = Some(counter);
            if step == 0 {
                self.sampler.counters.repeated += 1;
                return;
            }
            // The counter of a restarted sensor may begin at any value.
            self.sampler.counters.lost += if step <= mask / 2 { u64::from(step) - 1 } else { 0 };
        }
        self.sampler.take(set.counts, set.at);
    }

    /// Takes a heartbeat or boot-up received at `at`.
    pub(crate) fn heard(&mut self, state: NmtState, at: Instant) {
        self.heartbeat = at;
        self.operational &= state == NmtState::Operational;
    }

    /// Latches a fault of the bus.
    pub(crate) fn latch_of_bus(&mut self, fault: Fault) {
        if let Some(fault) = WrenchFault::of_bus(fault) {
            self.sampler.latch(fault);
        }
    }

    /// Ends the reading of a cycle: checks for silence, and publishes the state. `synced`: whether the SYNC of the last
    /// cycle was sent.
    pub(crate) fn end_of_read(&mut self, now: Instant, cycle: u64, synced: bool) {
        self.count_request(synced);
        if !self.operational {
            self.sampler.latch(WrenchFault::LeftOperational);
        }
        let since = *self.since.get_or_insert(now);
        let waited = now.since(self.heartbeat.max(since));
        if waited > self.heartbeat_lost_after {
            self.sampler.latch(WrenchFault::HeartbeatLost { waited });
        }
        self.sampler.end_of_read(now, cycle);
    }
}

impl Set {
    /// The fields of one frame.
    fn of(frame: &FrameLayout, data: &[u8]) -> Self {
        let mut set = Self::default();
        for &(offset, content) in &frame.fields {
            let bytes = &data[offset..offset + usize::from(content.bytes())];
            match content {
                Content::I16(axis) | Content::I32(axis) => set.counts[axis as usize] = signed(bytes),
                Content::Counter { bytes: length } => {
                    set.counter = Some((canopen::number(bytes), u32::MAX >> (32 - 8 * u32::from(length))));
                }
                Content::Status { errors, .. } => set.errors |= canopen::number(bytes) & errors,
                Content::Ignored { .. } => {}
            }
        }
        set
    }

    /// Adds the fields of a frame of this sample.
    fn add(&mut self, frame: &FrameLayout, read: &Self, index: usize) {
        self.order |= (index as Order + 1) << (4 * self.frames.count_ones());
        self.frames |= 1 << index;
        self.errors |= read.errors;
        self.counter = self.counter.or(read.counter);
        for axis in frame.fields.iter().filter_map(|(_, content)| content.axis()) {
            self.counts[axis as usize] = read.counts[axis as usize];
        }
    }

    /// The frames in the order of their arrival, by their index.
    fn arrived(&self) -> impl DoubleEndedIterator<Item = u16> + use<> {
        let (order, count) = (self.order, self.frames.count_ones());
        (0..count).map(move |place| (order >> (4 * place) & 0xF) - 1)
    }

    /// The last `count` frames, frame *n* in bit *n*.
    fn last(&self, count: u32) -> u8 {
        self.arrived().rev().take(count as usize).fold(0, |frames, index| frames | 1 << index)
    }

    /// Removes frames. The next frame with the same index replaces their counts.
    fn remove(&mut self, frames: u8) {
        let kept = self.arrived().filter(|index| frames & 1 << index == 0);
        let order = kept.enumerate().fold(0, |order, (place, index)| order | (index + 1) << (4 * place));
        (self.frames, self.order) = (self.frames & !frames, order);
    }
}

impl LateFrames {
    /// Whether frames of the last SYNC may be among those of the complete set.
    fn are_in(&self, set: &Set) -> bool {
        if self.owed == 0 {
            return false;
        }
        match self.order {
            Some(order) => set.order != order,
            // The first sample since the start. A frame that was missing before must be behind all others.
            None => set.last(self.owed.count_ones()) != self.owed,
        }
    }
}

/// A little-endian number of two or four bytes with its sign.
fn signed(bytes: &[u8]) -> i32 {
    match *bytes {
        [low, high] => i16::from_le_bytes([low, high]).into(),
        _ => canopen::number(bytes).cast_signed(),
    }
}

impl Drop for WrenchNode {
    /// Latches [`WrenchFault::Ended`]: the last wrench is no longer valid.
    fn drop(&mut self) {
        self.sampler.end();
    }
}
