//! Process data exchange: mapping, activation and transmission of each PDO.
//!
//! All parameters are read from the dictionary when the node becomes operational. A write to a parameter of a PDO
//! reads the parameters of that PDO again. No other access to the parameters takes place. A synchronous RPDO waits
//! for the next SYNC; a second RPDO before that SYNC replaces the first. A synchronous TPDO is sampled at SYNC.

use std::{collections::VecDeque, ops::Range, time::Duration};

use can::{Frame, Instant, StandardId};
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoNumber, TransmissionType};

use super::append;
use super::objects::Objects;
use super::table::{MAPPED, Slot};

/// The objects that the bytes of a PDO come from or go to.
#[derive(Clone, Copy, Debug)]
struct Mapping {
    entries: [(Option<Slot>, usize); MAPPED as usize],
    count: usize,
    bytes: usize,
}

impl Mapping {
    fn read(kind: PdoKind, number: PdoNumber, objects: &Objects) -> Self {
        let count = objects.u(objects.map(kind, number, 0)) as usize;
        let mut mapping = Self { entries: [(None, 0); MAPPED as usize], count, bytes: 0 };
        for sub in 1..=mapping.count {
            let entry = Entry::from_raw(objects.u(objects.map(kind, number, sub as u8)));
            let slot = objects.mappable(kind, entry).unwrap_or(None);
            let bytes = usize::from(entry.bits / 8);
            mapping.entries[sub - 1] = (slot, bytes);
            mapping.bytes += bytes;
        }
        mapping
    }

    /// The mapped slots, each with its place in the data.
    fn places(&self) -> impl Iterator<Item = (Slot, Range<usize>)> {
        let mut at = 0;
        let entries = self.entries[..self.count].iter();
        entries.filter_map(move |&(slot, bytes)| {
            at += bytes;
            Some((slot?, at - bytes..at))
        })
    }

    /// Numbers of which at least one changes with an event of a mapped object. A TPDO has at most 8 objects.
    fn events(&self, objects: &Objects) -> [u32; 8] {
        let mut events = [0; 8];
        for (event, (slot, _)) in events.iter_mut().zip(self.places()) {
            *event = objects.event(slot);
        }
        events
    }

    fn compose(&self, objects: &Objects) -> [u8; 8] {
        let mut data = [0; 8];
        for (slot, place) in self.places() {
            let bytes = place.len();
            data[place].copy_from_slice(&objects.u(slot).to_le_bytes()[..bytes]);
        }
        data
    }

    fn spread(&self, data: &[u8; 8], objects: &mut Objects) {
        for (slot, place) in self.places() {
            let mut value = [0; 4];
            value[..place.len()].copy_from_slice(&data[place]);
            objects.receive(slot, value);
        }
    }
}

/// The identifier of a PDO; `None` if the PDO is switched off.
fn identifier(kind: PdoKind, number: PdoNumber, objects: &Objects) -> Option<StandardId> {
    let cob = PdoCobId(objects.u(objects.cob_id(kind, number)));
    cob.id().filter(|_| cob.is_valid())
}

/// Whether an RPDO is switched on, and whether its event timer runs.
pub(crate) fn watched(number: PdoNumber, objects: &Objects) -> (bool, bool) {
    let rpdo = Rpdo::read(number, objects);
    (rpdo.is_some(), rpdo.is_some_and(|rpdo| !rpdo.within.is_zero()))
}

#[derive(Clone, Copy, Debug)]
struct Rpdo {
    id: StandardId,
    synchronous: bool,
    mapping: Mapping,
    /// Event timer; zero disables the timer.
    within: Duration,
    /// Data that waits for SYNC.
    waiting: Option<[u8; 8]>,
    /// Time of the last reception, until the event timer has expired.
    received: Option<Instant>,
}

#[derive(Clone, Copy, Debug)]
struct Tpdo {
    id: StandardId,
    transmission: TransmissionType,
    mapping: Mapping,
    inhibit: Duration,
    /// Event timer; zero disables the timer.
    period: Duration,
    /// SYNCs since the last transmission.
    syncs: u8,
    /// Events of the mapped objects at the last transmission, and its time.
    sent: Option<([u32; 8], Instant)>,
    /// Whether a change waits for the end of the inhibit time.
    inhibited: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reception {
    /// The frame is no RPDO of this node.
    Foreign,
    /// The RPDO of this number, from 0, waits for SYNC.
    Waiting(usize),
    /// The RPDO of this number, from 0, took effect.
    Effective(usize),
    /// The RPDO of this number, from 0, has fewer bytes than are mapped. The frame has no effect.
    TooShort(usize),
}

/// The eight PDOs; `None` for a PDO that is switched off.
#[derive(Clone, Debug)]
pub(crate) struct Pdos {
    received: [Option<Rpdo>; 4],
    transmitted: [Option<Tpdo>; 4],
}

impl Pdos {
    pub(crate) const NONE: Self = Self { received: [None; 4], transmitted: [None; 4] };

    /// PDOs with the parameters of the dictionary, without waiting data and before the first transmission.
    pub(crate) fn read(objects: &Objects) -> Self {
        Self {
            received: PdoNumber::ALL.map(|number| Rpdo::read(number, objects)),
            transmitted: PdoNumber::ALL.map(|number| Tpdo::read(number, objects)),
        }
    }

    /// Applies the parameters of one PDO. Its counts, times and data stay unless its identifier changes.
    pub(crate) fn update(&mut self, kind: PdoKind, number: PdoNumber, objects: &Objects) {
        let at = usize::from(number.offset());
        match kind {
            PdoKind::Rpdo => {
                let rpdo = Rpdo::read(number, objects);
                self.received[at] = match (self.received[at], rpdo) {
                    (Some(before), Some(now)) if before.id == now.id => Some(Rpdo {
                        waiting: before.waiting,
                        // A deadline that is switched on starts with the next reception (CiA 301 §7.5.2.35).
                        received: before.received.filter(|_| !before.within.is_zero()),
                        ..now
                    }),
                    _ => rpdo,
                };
            }
            PdoKind::Tpdo => {
                let tpdo = Tpdo::read(number, objects);
                self.transmitted[at] = match (self.transmitted[at], tpdo) {
                    (Some(before), Some(now)) if before.id == now.id => {
                        Some(Tpdo { syncs: before.syncs, sent: before.sent, inhibited: before.inhibited, ..now })
                    }
                    _ => tpdo,
                };
            }
        }
    }

    /// Whether a frame with this identifier is an RPDO of this node.
    pub(crate) fn hears(&self, id: StandardId) -> bool {
        self.received.iter().flatten().any(|rpdo| rpdo.id == id)
    }

    /// Takes a frame if the frame is an RPDO of this node.
    pub(crate) fn receive(&mut self, id: StandardId, data: &[u8], objects: &mut Objects, now: Instant) -> Reception {
        let Some((number, rpdo)) = self.rpdos().find(|(_, rpdo)| rpdo.id == id) else {
            return Reception::Foreign;
        };
        if data.len() < rpdo.mapping.bytes {
            return Reception::TooShort(number);
        }
        rpdo.received = Some(now);
        let mut bytes = [0; 8];
        bytes[..data.len()].copy_from_slice(data);
        if rpdo.synchronous {
            rpdo.waiting = Some(bytes);
            return Reception::Waiting(number);
        }
        rpdo.mapping.spread(&bytes, objects);
        Reception::Effective(number)
    }

    /// SYNC, first half: sends the synchronous TPDOs that are due.
    pub(crate) fn sample(&mut self, objects: &Objects, now: Instant, queue: &mut VecDeque<Frame>) {
        let transmitted = self.transmitted.iter_mut().flatten();
        for tpdo in transmitted.filter(|tpdo| tpdo.transmission.is_synchronous()) {
            tpdo.syncs = tpdo.syncs.saturating_add(1);
            let due = match tpdo.transmission.cycle() {
                Some(cycle) => tpdo.syncs >= cycle,
                None => tpdo.sent.is_none_or(|(sent, _)| sent != tpdo.mapping.events(objects)),
            };
            if due {
                tpdo.syncs = 0;
                tpdo.send(objects, now, queue);
            }
        }
    }

    /// SYNC, second half: waiting RPDOs take effect.
    pub(crate) fn take_effect(&mut self, objects: &mut Objects) {
        for rpdo in self.received.iter_mut().flatten() {
            if let Some(data) = rpdo.waiting.take() {
                rpdo.mapping.spread(&data, objects);
            }
        }
    }

    /// Sends the event-driven TPDOs whose objects had an event or whose timer expired, except during the inhibit time.
    pub(crate) fn events(&mut self, objects: &Objects, now: Instant, queue: &mut VecDeque<Frame>) {
        let transmitted = self.transmitted.iter_mut().flatten();
        for tpdo in transmitted.filter(|tpdo| !tpdo.transmission.is_synchronous()) {
            let due = match tpdo.sent {
                None => true,
                Some((sent, at)) => {
                    tpdo.inhibited = sent != tpdo.mapping.events(objects);
                    tpdo.due(at).is_some_and(|due| due <= now)
                }
            };
            if due {
                tpdo.send(objects, now, queue);
            }
        }
    }

    pub(crate) fn event_driven(&self) -> bool {
        self.event_driven_tpdos().next().is_some()
    }

    /// Time at which an event timer of either direction expires, or an inhibit time that delays a change.
    pub(crate) fn poll_timeout(&self) -> Option<Instant> {
        let deadlines = self.received.iter().flatten().filter_map(Rpdo::deadline);
        let events = self.event_driven_tpdos().filter_map(|tpdo| {
            let (_, at) = tpdo.sent?;
            tpdo.due(at)
        });
        deadlines.chain(events).min()
    }

    fn event_driven_tpdos(&self) -> impl Iterator<Item = &Tpdo> {
        let transmitted = self.transmitted.iter().flatten();
        transmitted.filter(|tpdo| !tpdo.transmission.is_synchronous())
    }

    /// Number of an overdue RPDO, from 0, whose timer restarts with the next reception. Called until `None`.
    pub(crate) fn overdue(&mut self, now: Instant) -> Option<usize> {
        let overdue = |rpdo: &Rpdo| rpdo.deadline().is_some_and(|at| at <= now);
        let (number, rpdo) = self.rpdos().find(|(_, rpdo)| overdue(rpdo))?;
        rpdo.received = None;
        Some(number)
    }

    fn rpdos(&mut self) -> impl Iterator<Item = (usize, &mut Rpdo)> {
        let received = self.received.iter_mut().enumerate();
        received.filter_map(|(number, rpdo)| Some((number, rpdo.as_mut()?)))
    }
}

impl Rpdo {
    fn read(number: PdoNumber, objects: &Objects) -> Option<Self> {
        let cob = objects.cob_id(PdoKind::Rpdo, number);
        Some(Self {
            id: identifier(PdoKind::Rpdo, number, objects)?,
            synchronous: TransmissionType(objects.u(cob.plus(1)) as u8).is_synchronous(),
            mapping: Mapping::read(PdoKind::Rpdo, number, objects),
            within: Duration::from_millis(u64::from(objects.u(cob.plus(2)))),
            waiting: None,
            received: None,
        })
    }

    fn deadline(&self) -> Option<Instant> {
        let at = self.received.filter(|_| !self.within.is_zero())?;
        Some(at + self.within)
    }
}

impl Tpdo {
    fn read(number: PdoNumber, objects: &Objects) -> Option<Self> {
        let cob = objects.cob_id(PdoKind::Tpdo, number);
        Some(Self {
            id: identifier(PdoKind::Tpdo, number, objects)?,
            transmission: TransmissionType(objects.u(cob.plus(1)) as u8),
            mapping: Mapping::read(PdoKind::Tpdo, number, objects),
            inhibit: Duration::from_micros(100 * u64::from(objects.u(cob.plus(2)))),
            period: Duration::from_millis(u64::from(objects.u(cob.plus(3)))),
            syncs: 0,
            sent: None,
            inhibited: false,
        })
    }

    /// Due time of the PDO, last sent `at`: after a change or by the event timer, and never within the inhibit time.
    fn due(&self, at: Instant) -> Option<Instant> {
        let timer = (!self.period.is_zero()).then_some(self.period);
        let event = if self.inhibited { Some(Duration::ZERO) } else { timer };
        Some(at + event?.max(self.inhibit))
    }

    fn send(&mut self, objects: &Objects, now: Instant, queue: &mut VecDeque<Frame>) {
        let data = self.mapping.compose(objects);
        self.sent = Some((self.mapping.events(objects), now));
        self.inhibited = false;
        let frame = Frame::new(self.id, &data[..self.mapping.bytes.min(8)]);
        append(queue, frame.expect("a mapping has at most 8 bytes"));
    }
}
