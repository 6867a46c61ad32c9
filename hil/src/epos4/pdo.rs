//! Process data at work: what each PDO carries, when it takes effect and when it is sent.
//!
//! Parameters are read from the dictionary when the node becomes operational or a parameter is
//! written; between that nothing is looked up. A synchronous RPDO waits for the next SYNC, and a
//! second one replaces it; a synchronous TPDO is sampled at SYNC.

use std::time::Duration;

use can::{Frame, Instant, StandardId};
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoNumber, TransmissionType};

use super::objects::{Objects, cob_id, map, mappable};
use super::table::{MAPPED, Slot};

/// Where the bytes of a PDO come from or go to.
#[derive(Clone, Copy, Debug)]
struct Mapping {
    entries: [(Option<Slot>, u8); MAPPED as usize],
    count: usize,
    bytes: usize,
}

impl Mapping {
    const EMPTY: Self = Self {
        entries: [(None, 0); MAPPED as usize],
        count: 0,
        bytes: 0,
    };

    fn read(kind: PdoKind, number: PdoNumber, objects: &Objects) -> Self {
        let mut mapping = Self::EMPTY;
        mapping.count = objects.u(map(kind, number, 0)) as usize;
        for sub in 1..=mapping.count {
            let entry = Entry::from_raw(objects.u(map(kind, number, sub as u16)));
            let slot = mappable(kind, entry).unwrap_or(None);
            mapping.entries[sub - 1] = (slot, entry.bits / 8);
            mapping.bytes += usize::from(entry.bits / 8);
        }
        mapping
    }

    fn entries(&self) -> &[(Option<Slot>, u8)] {
        &self.entries[..self.count]
    }

    fn compose(&self, objects: &Objects) -> [u8; 8] {
        let mut data = [0; 8];
        let mut at = 0;
        for &(slot, bytes) in self.entries() {
            let bytes = usize::from(bytes);
            if let Some(slot) = slot {
                data[at..at + bytes].copy_from_slice(&objects.u(slot).to_le_bytes()[..bytes]);
            }
            at += bytes;
        }
        data
    }

    fn spread(&self, data: &[u8; 8], objects: &mut Objects) {
        let mut at = 0;
        for &(slot, bytes) in self.entries() {
            let bytes = usize::from(bytes);
            if let Some(slot) = slot {
                let mut value = [0; 4];
                value[..bytes].copy_from_slice(&data[at..at + bytes]);
                objects.receive(slot, value);
            }
            at += bytes;
        }
    }
}

/// The identifier of a PDO that exists.
fn identifier(kind: PdoKind, number: PdoNumber, objects: &Objects) -> Option<StandardId> {
    let cob = PdoCobId(objects.u(cob_id(kind, number)));
    cob.id().filter(|_| cob.is_valid())
}

#[derive(Clone, Copy, Debug)]
struct Rpdo {
    id: Option<StandardId>,
    synchronous: bool,
    mapping: Mapping,
    /// Waits for SYNC.
    waiting: Option<[u8; 8]>,
    /// Event timer; zero is off.
    within: Duration,
    deadline: Option<Instant>,
}

#[derive(Clone, Copy, Debug)]
struct Tpdo {
    id: Option<StandardId>,
    transmission: TransmissionType,
    mapping: Mapping,
    /// SYNCs since it was last sent.
    syncs: u8,
    inhibit: Duration,
    /// Event timer; zero is off.
    period: Duration,
    sent: Option<([u8; 8], Instant)>,
}

/// What came of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reception {
    /// No RPDO of this node.
    Foreign,
    /// Waits for SYNC.
    Waiting,
    /// Took effect.
    Effective,
    /// Fewer bytes than are mapped; nothing was taken.
    TooShort,
}

/// The eight PDOs.
#[derive(Clone, Debug)]
pub(super) struct Pdos {
    received: [Rpdo; 4],
    transmitted: [Tpdo; 4],
}

impl Pdos {
    /// None exists.
    pub(super) const NONE: Self = Self {
        received: [Rpdo {
            id: None,
            synchronous: false,
            mapping: Mapping::EMPTY,
            waiting: None,
            within: Duration::ZERO,
            deadline: None,
        }; 4],
        transmitted: [Tpdo {
            id: None,
            transmission: TransmissionType::EVENT_PROFILE,
            mapping: Mapping::EMPTY,
            syncs: 0,
            inhibit: Duration::ZERO,
            period: Duration::ZERO,
            sent: None,
        }; 4],
    };

    /// As the dictionary says; nothing waits and nothing was sent.
    pub(super) fn read(objects: &Objects) -> Self {
        let mut pdos = Self::NONE;
        for (number, rpdo) in PdoNumber::ALL.into_iter().zip(&mut pdos.received) {
            let cob = cob_id(PdoKind::Rpdo, number);
            rpdo.id = identifier(PdoKind::Rpdo, number, objects);
            rpdo.synchronous = TransmissionType(objects.u(cob.plus(1)) as u8).is_synchronous();
            rpdo.mapping = Mapping::read(PdoKind::Rpdo, number, objects);
            rpdo.within = Duration::from_millis(u64::from(objects.u(cob.plus(2))));
        }
        for (number, tpdo) in PdoNumber::ALL.into_iter().zip(&mut pdos.transmitted) {
            let cob = cob_id(PdoKind::Tpdo, number);
            tpdo.id = identifier(PdoKind::Tpdo, number, objects);
            tpdo.transmission = TransmissionType(objects.u(cob.plus(1)) as u8);
            tpdo.mapping = Mapping::read(PdoKind::Tpdo, number, objects);
            tpdo.inhibit = Duration::from_micros(100 * u64::from(objects.u(cob.plus(2))));
            tpdo.period = Duration::from_millis(u64::from(objects.u(cob.plus(3))));
        }
        pdos
    }

    /// Takes a frame if it is one of the RPDOs.
    pub(super) fn receive(
        &mut self,
        id: StandardId,
        data: &[u8],
        objects: &mut Objects,
        now: Instant,
    ) -> Reception {
        let Some(rpdo) = self.received.iter_mut().find(|rpdo| rpdo.id == Some(id)) else {
            return Reception::Foreign;
        };
        if data.len() < rpdo.mapping.bytes {
            return Reception::TooShort;
        }
        rpdo.deadline = (!rpdo.within.is_zero()).then(|| now + rpdo.within);
        let mut bytes = [0; 8];
        bytes[..data.len()].copy_from_slice(data);
        if rpdo.synchronous {
            rpdo.waiting = Some(bytes);
            return Reception::Waiting;
        }
        rpdo.mapping.spread(&bytes, objects);
        Reception::Effective
    }

    /// SYNC, first half: hands out the synchronous TPDOs that are due.
    pub(super) fn sample(&mut self, objects: &Objects, now: Instant, mut send: impl FnMut(Frame)) {
        for tpdo in &mut self.transmitted {
            let Some(id) = tpdo.id.filter(|_| tpdo.transmission.is_synchronous()) else {
                continue;
            };
            tpdo.syncs = tpdo.syncs.saturating_add(1);
            let data = tpdo.mapping.compose(objects);
            let due = match tpdo.transmission.cycle() {
                Some(cycle) => tpdo.syncs >= cycle,
                None => tpdo.sent.is_none_or(|(sent, _)| sent != data),
            };
            if due {
                tpdo.syncs = 0;
                tpdo.send(id, data, now, &mut send);
            }
        }
    }

    /// SYNC, second half: what waited takes effect.
    pub(super) fn take_effect(&mut self, objects: &mut Objects) {
        for rpdo in &mut self.received {
            if let Some(data) = rpdo.waiting.take() {
                rpdo.mapping.spread(&data, objects);
            }
        }
    }

    /// Hands out the event-driven TPDOs whose content changed or whose timer expired, unless
    /// inhibited.
    pub(super) fn events(&mut self, objects: &Objects, now: Instant, mut send: impl FnMut(Frame)) {
        for tpdo in &mut self.transmitted {
            let Some(id) = tpdo.id.filter(|_| !tpdo.transmission.is_synchronous()) else {
                continue;
            };
            let data = tpdo.mapping.compose(objects);
            let due = match tpdo.sent {
                None => true,
                Some((sent, at)) => {
                    sent != data && at + tpdo.inhibit <= now
                        || !tpdo.period.is_zero() && at + tpdo.period <= now
                }
            };
            if due {
                tpdo.send(id, data, now, &mut send);
            }
        }
    }

    /// Whether any TPDO is sent on its own.
    pub(super) fn event_driven(&self) -> bool {
        self.transmitted
            .iter()
            .any(|tpdo| tpdo.id.is_some() && !tpdo.transmission.is_synchronous())
    }

    /// When an event timer of either direction expires.
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let deadlines = self.received.iter().filter_map(|rpdo| rpdo.deadline);
        let periods = self.transmitted.iter().filter_map(|tpdo| {
            let timed =
                tpdo.id.is_some() && !tpdo.transmission.is_synchronous() && !tpdo.period.is_zero();
            let (_, at) = tpdo.sent.filter(|_| timed)?;
            Some(at + tpdo.period)
        });
        deadlines.chain(periods).min()
    }

    /// Whether an RPDO is overdue; it is watched again from its next reception.
    pub(super) fn overdue(&mut self, now: Instant) -> bool {
        let mut overdue = false;
        for rpdo in &mut self.received {
            overdue |= rpdo.deadline.take_if(|deadline| *deadline <= now).is_some();
        }
        overdue
    }
}

impl Tpdo {
    fn send(&mut self, id: StandardId, data: [u8; 8], now: Instant, send: &mut impl FnMut(Frame)) {
        self.sent = Some((data, now));
        let frame = Frame::new(id, &data[..self.mapping.bytes.min(8)]);
        send(frame.expect("a mapping has at most 8 bytes"));
    }
}
