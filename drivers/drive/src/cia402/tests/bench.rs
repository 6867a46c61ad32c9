//! A group on a scripted bus.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::{ControllerState, Counters, Frame, Instant, Port, PortError, StandardId};
use canopen::{NodeId, Object, cob};

pub(crate) use can::Received;

pub(crate) use crate::bus::{CanBus, Sign, traffic};
use crate::cia401::{IoConfig, IoLink};
use crate::cia402::*;
pub(crate) use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, Fault};
use crate::{Finite, Power, Scale, Setpoint};

pub(crate) const PERIOD: Duration = Duration::from_millis(2);

pub(crate) fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

pub(crate) fn group_config() -> GroupConfig {
    GroupConfig {
        period: PERIOD,
        tolerated_missing: 2,
        heartbeat_period: Duration::from_secs(2),
        host_node: node(127),
        sdo_timeout: Duration::from_millis(100),
        sdo_retries: 1,
        boot_timeout: Duration::from_secs(1),
        transition_timeout: Duration::from_millis(500),
    }
}

pub(crate) fn setting(index: u16, subindex: u8, data: &[u8]) -> Setting {
    Setting { object: Object::new(index, subindex), data: data.to_vec(), readable: true, purpose: Purpose::Write }
}

/// 2000 increments per turn; an increment is TAU / 2000 rad.
pub(crate) fn axis_config(raw: u8) -> AxisConfig {
    let tau = std::f64::consts::TAU;
    AxisConfig {
        node: node(raw),
        identity: Identity { vendor: 0xFB, product: Some(0x6050_0000), revision: None },
        mode: CyclicMode::Csp,
        scale: Scale::new(2_000, 0.0).unwrap(),
        rated_torque: 0.1,
        homing: HomingConfig {
            method: 37,
            search_speed: tau,
            zero_speed: tau / 6.0,
            acceleration: tau * 10.0,
            start_timeout: Duration::from_secs(1),
        },
        plausible_velocity: tau * 1_000.0,
        plausible_acceleration: tau * 1e9,
        following_error: tau / 2.0,
        quick_stop_deceleration: tau * 100.0,
        emergency_input: None,
        position_range: None,
        configuration: vec![setting(0x3001, 1, &2_000_u32.to_le_bytes())],
    }
}

/// A bus seen from the host: frames sent, frames to be received, and the free space of its queue.
#[derive(Default)]
pub(crate) struct Bus {
    pub(crate) sent: Vec<Frame>,
    pub(crate) inbox: VecDeque<Received>,
    pub(crate) takes: Option<usize>,
    pub(crate) error: Option<PortError>,
    pub(crate) state: ControllerState,
    /// The bound of frames in flight.
    pub(crate) most_unsent: Option<usize>,
}

#[derive(Clone, Default)]
pub(crate) struct BusEnd(pub(crate) Arc<Mutex<Bus>>);

impl Port for BusEnd {
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let mut bus = self.0.lock().unwrap();
        if let Some(error) = bus.error {
            return Err(error);
        }
        let taken = frames.len().min(bus.takes.unwrap_or(usize::MAX));
        bus.sent.extend(&frames[..taken]);
        Ok(taken)
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        let mut bus = self.0.lock().unwrap();
        if let Some(error) = bus.error {
            return Err(error);
        }
        let due = bus.inbox.iter().take_while(|received| received.at <= now).count();
        let count = into.len().min(due);
        into.iter_mut().zip(bus.inbox.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }

    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        self.0.lock().unwrap().most_unsent = Some(most);
        Ok(())
    }

    fn counters(&self) -> Counters {
        Counters::default()
    }

    fn state(&self) -> ControllerState {
        self.0.lock().unwrap().state
    }
}

/// Parses a frame in the format of `candump -L`.
pub(crate) fn frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let id = StandardId::new(u16::from_str_radix(id, 16).unwrap()).unwrap();
    let byte = |i: usize| u8::from_str_radix(&data[i..i + 2], 16).unwrap();
    let bytes: Vec<u8> = (0..data.len()).step_by(2).map(byte).collect();
    Frame::new(id, &bytes).unwrap()
}

/// TPDO 1 of a node, with torque zero.
pub(crate) fn answer(raw: u8, statusword: u16, position: i32) -> String {
    let [s0, s1] = statusword.to_le_bytes();
    let [a, b, c, d] = position.to_le_bytes();
    format!("{:03X}#{s0:02X}{s1:02X}{a:02X}{b:02X}{c:02X}{d:02X}0000", 0x180 + u16::from(raw))
}

/// The service side of a node: an object store that answers service requests only.
pub(crate) struct Store {
    pub(crate) raw: u8,
    pub(crate) objects: BTreeMap<(u16, u8), Vec<u8>>,
    pub(crate) aborts: BTreeMap<(u16, u8), u32>,
    /// Objects that cannot be written.
    pub(crate) read_only: Vec<(u16, u8)>,
    /// Objects it takes and does not keep.
    pub(crate) forgetful: Option<(u16, u8)>,
    /// An object whose writing sets another object to zero.
    pub(crate) clears: Option<((u16, u8), (u16, u8))>,
    /// Object without any answer.
    pub(crate) mute: Option<(u16, u8)>,
    pub(crate) boots: bool,
    pub(crate) starts: bool,
    pub(crate) shows_modes: bool,
    /// A frame sent at the start, besides the heartbeat.
    pub(crate) sends: Option<Frame>,
    /// The object of a segmented transfer, and the bytes received so far or still to be sent.
    segments: ((u16, u8), Vec<u8>),
}

impl Store {
    /// An EPOS4 that is switched off and stands at 1000 increments.
    pub(crate) fn epos4(raw: u8) -> Self {
        let mut objects = BTreeMap::new();
        let mut put = |index, subindex, bytes: &[u8]| objects.insert((index, subindex), bytes.to_vec());
        put(0x1000, 0, &[0x92, 0x01, 0x02, 0x00]);
        put(0x1016, 1, &[0; 4]);
        put(0x1017, 0, &[0; 2]);
        put(0x1018, 1, &[0xFB, 0, 0, 0]);
        put(0x1018, 2, &[0x00, 0x00, 0x50, 0x60]);
        put(0x1018, 3, &[0x00, 0x00, 0x70, 0x01]);
        for i in 0..4 {
            put(0x1400 + i, 1, &[0; 4]);
            put(0x1400 + i, 2, &[255]);
            put(0x1400 + i, 5, &[0, 0]);
            put(0x1800 + i, 1, &[0; 4]);
            put(0x1800 + i, 2, &[255]);
            put(0x1800 + i, 3, &[10, 0]);
            put(0x1800 + i, 5, &[0, 0]);
        }
        for index in [0x1600, 0x1A00, 0x1A01] {
            put(index, 0, &[1]);
            (1..=3).for_each(|subindex| _ = put(index, subindex, &[0; 4]));
        }
        put(0x1029, 1, &[0]);
        put(0x3001, 1, &[0; 4]);
        put(0x30B0, 0, &[9, 0, 0, 0]);
        put(0x30B1, 0, &[9, 0, 0, 0]);
        put(0x6007, 0, &[1, 0]);
        put(0x603F, 0, &[0; 2]);
        put(0x6040, 0, &[0; 2]);
        put(0x6041, 0, &[0x40, 0x07]);
        put(0x605A, 0, &[5, 0]);
        put(0x6060, 0, &[1]);
        put(0x6061, 0, &[1]);
        put(0x6064, 0, &[0xE8, 0x03, 0, 0]);
        put(0x6065, 0, &[0; 4]);
        put(0x6085, 0, &[0; 4]);
        put(0x6098, 0, &[7]);
        put(0x6099, 1, &[0; 4]);
        put(0x6099, 2, &[0; 4]);
        put(0x609A, 0, &[0; 4]);
        put(0x60C2, 1, &[0]);
        put(0x60C2, 2, &[0xFD]);
        put(0x6502, 0, &[0xA5, 0x03, 0, 0]);
        Self::of(raw, objects)
    }

    /// A node with these objects.
    pub(crate) fn of(raw: u8, objects: BTreeMap<(u16, u8), Vec<u8>>) -> Self {
        Self {
            raw,
            objects,
            aborts: BTreeMap::new(),
            read_only: Vec::new(),
            forgetful: None,
            clears: None,
            mute: None,
            boots: true,
            starts: true,
            shows_modes: true,
            sends: None,
            segments: ((0, 0), Vec::new()),
        }
    }

    pub(crate) fn put(&mut self, index: u16, subindex: u8, bytes: &[u8]) {
        self.objects.insert((index, subindex), bytes.to_vec());
    }

    pub(crate) fn handle(&mut self, frame: &Frame) -> Option<Frame> {
        let id = frame.standard_data_id()?.raw();
        let heartbeat = 0x700 + u16::from(self.raw);
        let new = |id, data: &[u8]| Frame::new(StandardId::new(id).unwrap(), data);
        match (id, frame.data()) {
            (0, &[0x82, raw]) if raw == self.raw && self.boots => new(heartbeat, &[0]),
            (0, &[0x01, raw]) if raw == self.raw && self.starts => new(heartbeat, &[5]),
            (id, &[specifier @ (0x00..0x20 | 0x60..0x80), ref data @ ..]) if id == 0x600 + u16::from(self.raw) => {
                new(0x580 + u16::from(self.raw), &self.segment(specifier, data))
            }
            (id, &[specifier, low, high, subindex, ref data @ ..]) if id == 0x600 + u16::from(self.raw) => {
                let index = u16::from_le_bytes([low, high]);
                let reply = self.serve(specifier, (index, subindex), data)?;
                let [a, b, c, d] = reply.1;
                new(0x580 + u16::from(self.raw), &[reply.0, low, high, subindex, a, b, c, d])
            }
            _ => None,
        }
    }

    /// Transfers the next seven bytes, in either direction.
    fn segment(&mut self, specifier: u8, data: &[u8]) -> [u8; 8] {
        let (object, bytes) = &mut self.segments;
        let mut answer = [0; 8];
        if specifier < 0x20 {
            let unused = usize::from(specifier >> 1 & 7);
            bytes.extend(&data[..7 - unused]);
            answer[0] = 0x20 | specifier & 0x10;
            if specifier & 1 == 1 && self.forgetful != Some(*object) {
                self.objects.insert(*object, std::mem::take(bytes));
            }
        } else {
            let count = bytes.len().min(7);
            answer[1..=count].copy_from_slice(&bytes[..count]);
            bytes.drain(..count);
            answer[0] = specifier & 0x10 | (7 - count as u8) << 1 | u8::from(bytes.is_empty());
        }
        answer
    }

    fn serve(&mut self, specifier: u8, object: (u16, u8), data: &[u8]) -> Option<(u8, [u8; 4])> {
        if specifier == 0x80 || self.mute == Some(object) {
            return None;
        }
        if let Some(code) = self.aborts.get(&object) {
            return Some((0x80, code.to_le_bytes()));
        }
        if specifier != 0x40 && self.read_only.contains(&object) {
            return Some((0x80, 0x0601_0002_u32.to_le_bytes()));
        }
        let Some(stored) = self.objects.get_mut(&object) else {
            return Some((0x80, 0x0602_0000_u32.to_le_bytes()));
        };
        if specifier == 0x21 {
            self.segments = (object, Vec::new());
            return Some((0x60, [0; 4]));
        }
        if specifier == 0x40 && !(1..=4).contains(&stored.len()) {
            self.segments = (object, stored.clone());
            return Some((0x41, (stored.len() as u32).to_le_bytes()));
        }
        if specifier == 0x40 {
            let mut bytes = [0; 4];
            bytes[..stored.len()].copy_from_slice(stored);
            return Some((0x43 | (4 - stored.len() as u8) << 2, bytes));
        }
        assert_eq!(specifier, 0x23 | (4 - stored.len() as u8) << 2, "length of {object:04x?}");
        if self.forgetful != Some(object) {
            let length = stored.len();
            stored.copy_from_slice(&data[..length]);
        }
        if let Some((_, cleared)) = self.clears.filter(|(trigger, _)| *trigger == object) {
            self.objects.get_mut(&cleared).unwrap().fill(0);
        }
        if object == (0x6060, 0) && self.shows_modes {
            let mode = data[0];
            self.objects.insert((0x6061, 0), vec![mode]);
        }
        Some((0x60, [0; 4]))
    }
}

/// A group, its bus, and the service side of its drives.
pub(crate) struct Bench {
    pub(crate) group: CanBus<BusEnd>,
    pub(crate) links: Vec<IoLink>,
    pub(crate) bus: BusEnd,
    pub(crate) stores: Vec<Store>,
    pub(crate) now: Instant,
    pub(crate) states: Vec<AxisState>,
    /// Latencies of the answers of the drives in bring-up; `None` for a drive that does not answer.
    pub(crate) latencies: Vec<Option<Duration>>,
    seen: usize,
}

impl Bench {
    pub(crate) fn new(config: GroupConfig, axes: &[AxisConfig]) -> Self {
        Self::with_io(config, axes, &[])
    }

    /// A bus with drives and I/O nodes; the stores of the I/O nodes are added by the caller.
    pub(crate) fn with_io(config: GroupConfig, axes: &[AxisConfig], io: &[IoConfig]) -> Self {
        let bus = BusEnd::default();
        let (group, links) = CanBus::with_io(bus.clone(), config, axes, io).unwrap();
        Self {
            group,
            links,
            bus,
            stores: axes.iter().map(|axis| Store::epos4(axis.node.raw())).collect(),
            now: Instant::ZERO,
            states: vec![AxisState::default(); axes.len()],
            latencies: vec![Some(PERIOD / 2); axes.len()],
            seen: 0,
        }
    }

    /// A group of EPOS4 in CSP, brought up.
    pub(crate) fn up(nodes: &[u8]) -> Self {
        let axes: Vec<AxisConfig> = nodes.iter().map(|&raw| axis_config(raw)).collect();
        Self::up_with(group_config(), &axes)
    }

    pub(crate) fn up_with(config: GroupConfig, axes: &[AxisConfig]) -> Self {
        Self::new(config, axes).brought_up()
    }

    /// A bus with drives and I/O nodes, whose service side is `nodes`, brought up.
    pub(crate) fn up_with_io(config: GroupConfig, axes: &[AxisConfig], io: &[IoConfig], nodes: Vec<Store>) -> Self {
        let mut bench = Self::with_io(config, axes, io);
        bench.stores.extend(nodes);
        bench.brought_up()
    }

    fn brought_up(mut self) -> Self {
        assert_eq!(self.bring_up(), Ok(()));
        self.seen = self.bus.0.lock().unwrap().sent.len();
        self
    }

    /// Runs bring-up to its end with one call per period.
    pub(crate) fn bring_up(&mut self) -> Result<(), BringUpError> {
        for _ in 0..10_000 {
            if let Poll::Ready(result) = self.group.bring_up(self.now) {
                return result;
            }
            self.answer_syncs();
            self.serve();
            self.now += PERIOD;
        }
        panic!("bring-up did not end");
    }

    /// Lets the drives answer the SYNCs sent since the last call of [`serve`](Self::serve), as they do in bring-up.
    pub(crate) fn answer_syncs(&mut self) {
        let mut bus = self.bus.0.lock().unwrap();
        let syncs = bus.sent[self.seen..].iter().filter(|sent| sent.standard_data_id() == Some(cob::SYNC)).count();
        for _ in 0..syncs {
            for (store, latency) in self.stores.iter().zip(&self.latencies) {
                let frame = frame(&answer(store.raw, 0x0740, 1_000));
                bus.inbox.extend(latency.map(|latency| Received { frame, at: self.now + latency }));
            }
        }
    }

    /// Lets the stores answer the frames sent since the last call.
    pub(crate) fn serve(&mut self) {
        let mut bus = self.bus.0.lock().unwrap();
        let at = self.now + PERIOD / 2;
        for i in self.seen..bus.sent.len() {
            let frame = bus.sent[i];
            let replies = self.stores.iter_mut().flat_map(|store| {
                let started = frame.data() == [0x01, store.raw] && frame.standard_data_id() == Some(cob::NMT);
                [store.handle(&frame), store.sends.filter(|_| started)]
            });
            bus.inbox.extend(replies.flatten().map(|frame| Received { frame, at }));
        }
        self.seen = bus.sent.len();
    }

    /// One cycle: `answers` arrived half a period ago. Returns the frames sent.
    pub(crate) fn cycle<T: AsRef<str>>(&mut self, answers: &[T], commands: &[AxisCommand]) -> Vec<String> {
        self.now += PERIOD;
        let at = self.now - PERIOD / 2;
        let mut bus = self.bus.0.lock().unwrap();
        let frames = answers.iter().map(|text| Received { frame: frame(text.as_ref()), at });
        bus.inbox.extend(frames);
        let before = bus.sent.len();
        drop(bus);
        self.group.read(self.now, &mut self.states);
        self.group.write(self.now, commands);
        self.group.send(self.now);
        self.serve();
        let bus = self.bus.0.lock().unwrap();
        bus.sent[before..].iter().map(Frame::to_string).collect()
    }

    /// Enables every axis, standing at 1000 increments.
    pub(crate) fn enable(&mut self) {
        let commands = vec![AxisCommand::Stand; self.states.len()];
        for statusword in [0x0740, 0x0721, 0x0723, 0x0737, 0x0737, 0x0737, 0x0737] {
            self.cycle(&self.answers(statusword, 1_000), &commands);
        }
        assert!(self.states.iter().all(|state| state.power == Power::On && state.following));
    }

    pub(crate) fn answers(&self, statusword: u16, position: i32) -> Vec<String> {
        self.stores[..self.states.len()].iter().map(|store| answer(store.raw, statusword, position)).collect()
    }
}

/// Follows a position in increments of [`axis_config`].
pub(crate) fn follow(increments: f64) -> AxisCommand {
    let position = increments * std::f64::consts::TAU / 2_000.0;
    AxisCommand::Follow(Setpoint::Position(Finite::new(position).unwrap()))
}

pub(crate) const NONE: &[&str] = &[];

/// The frames sent, in the format of `candump`.
pub(crate) fn sent(bench: &Bench) -> Vec<String> {
    bench.bus.0.lock().unwrap().sent.iter().map(Frame::to_string).collect()
}
