//! The values of the object dictionary, their storage, and the rules of writing.
//!
//! A write records its consequences for the rest of the device in [`Changes`]. The device evaluates the changes after
//! each request and each PDO. The rules of re-mapping a PDO (CiA 301 §7.5.2.36, §7.5.2.38) are enforced here:
//! COB-ID off (bit 31), count to 0, entries, count, COB-ID on. Stored values live as long as the emulator.

use std::borrow::Cow;
use std::time::Duration;

use canopen::pdo::{Entry as MapEntry, PdoCobId, PdoKind, PdoNumber};
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE};
use canopen::{NodeId, Object, cob, eds::DataType, nmt, objects as named};

use super::heartbeats::{ENTRIES, watched};
use super::table::{Entry, Slot};

/// "save", the password of object 0x1010.
const SAVE: u32 = 0x6576_6173;
/// "load", the password of object 0x1011.
const LOAD: u32 = 0x6461_6F6C;
/// Capacity of object 0x1003, errors.
pub(crate) const HISTORY: u16 = 5;

/// Changes by writes since the device last evaluated them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Changes {
    /// Marks of the written objects of the application, see [`Entry::marks`].
    pub(crate) marks: u8,
    /// Parameters of RPDOs and of TPDOs, by number.
    pub(crate) received: [bool; 4],
    pub(crate) transmitted: [bool; 4],
    /// The time of the node's own heartbeat.
    pub(crate) producer: bool,
    /// The nodes whose heartbeats are watched.
    pub(crate) consumers: bool,
}

/// Slots of the communication objects that the node itself uses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Communication {
    pub(crate) error_register: Slot,
    history_count: Slot,
    /// Object 0x603F, which only a drive has.
    pub(crate) error_code: Option<Slot>,
    /// The first entry of object 0x1016.
    consumers: Slot,
    producer: Slot,
    pub(crate) error_behaviour: Slot,
    /// Object 0x1015, in units of 100 µs.
    emergency_inhibit: Option<Slot>,
}

impl Communication {
    fn of(table: &[Entry]) -> Self {
        let find = |object| Slot::find(table, object);
        Self {
            error_register: Slot::of(table, named::ERROR_REGISTER),
            history_count: Slot::of(table, named::ERROR_HISTORY_COUNT),
            error_code: find(named::ERROR_CODE),
            consumers: Slot::of(table, named::CONSUMER_HEARTBEAT_1),
            producer: Slot::of(table, named::PRODUCER_HEARTBEAT),
            error_behaviour: Slot::of(table, named::ERROR_BEHAVIOUR),
            emergency_inhibit: find(Object::new(0x1015, 0)),
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Objects {
    /// The rows, in ascending order.
    table: Cow<'static, [Entry]>,
    pub(crate) communication: Communication,
    values: Box<[u32]>,
    /// Values that a reset restores.
    stored: Box<[u32]>,
    /// Factory values with this unit's identity.
    factory: Box<[u32]>,
    /// Numbers of events of the objects whose events the application counts.
    events: Box<[u32]>,
    /// The only object of type DOMAIN.
    domain: Vec<u8>,
    pub(crate) nmt: nmt::NmtState,
    pub(crate) changes: Changes,
}

impl Objects {
    /// Factory values. `identity` holds the values that differ from unit to unit.
    ///
    /// Without a node-ID, COB-IDs are set by [`Objects::rename`].
    pub(crate) fn new(table: Cow<'static, [Entry]>, node: Option<NodeId>, identity: &[(Slot, u32)]) -> Self {
        let raw = node.map_or(0, |node| u32::from(node.raw()));
        let values = table.iter().map(|entry| entry.default + u32::from(entry.plus_node) * raw);
        let mut factory: Box<[u32]> = values.collect();
        for &(slot, value) in identity {
            factory[slot.row()] = value;
        }
        Self {
            communication: Communication::of(&table),
            domain: factory_domain(),
            values: factory.clone(),
            stored: factory.clone(),
            events: vec![0; factory.len()].into(),
            factory,
            table,
            nmt: nmt::NmtState::Initialising,
            changes: Changes::default(),
        }
    }

    /// The slot of an object received in a frame.
    pub(crate) fn find(&self, object: Object) -> Option<Slot> {
        Slot::find(&self.table, object)
    }

    fn entry(&self, slot: Slot) -> &Entry {
        &self.table[slot.row()]
    }

    fn locate(&self, object: Object) -> Result<Slot, AbortCode> {
        self.find(object).ok_or_else(|| {
            if self.table.iter().any(|entry| entry.object.index == object.index) {
                AbortCode::NO_SUBINDEX
            } else {
                AbortCode::NO_OBJECT
            }
        })
    }

    /// Restores stored values: those below 0x2000, or all.
    pub(crate) fn reset(&mut self, all: bool) {
        for (row, entry) in self.table.iter().enumerate() {
            if all || entry.object.index < 0x2000 {
                self.values[row] = self.stored[row];
            }
        }
        if all {
            self.domain = factory_domain();
        }
        self.changes = Changes::default();
    }

    /// Recalculates the COB-IDs for a node-ID, except COB-IDs that were stored otherwise.
    pub(crate) fn rename(&mut self, node: NodeId) {
        for (row, entry) in self.table.iter().enumerate().filter(|(_, entry)| entry.plus_node) {
            let factory = entry.default + u32::from(node.raw());
            if self.stored[row] == self.factory[row] {
                self.stored[row] = factory;
            }
            self.factory[row] = factory;
        }
    }

    /// An unsigned value.
    pub(crate) fn u(&self, slot: Slot) -> u32 {
        self.values[slot.row()]
    }

    /// A signed value.
    pub(crate) fn i(&self, slot: Slot) -> i32 {
        self.values[slot.row()] as i32
    }

    /// A value as a number for formulas.
    pub(crate) fn f(&self, slot: Slot) -> f64 {
        self.entry(slot).number(self.u(slot)) as f64
    }

    /// Counts an event of an object, see [`Entry::counts_events`].
    pub(crate) fn count_event(&mut self, slot: Slot) {
        let events = &mut self.events[slot.row()];
        *events = events.wrapping_add(1);
    }

    /// A number whose change is an event of the object: the value, or the number of events counted by the application.
    pub(crate) fn event(&self, slot: Slot) -> u32 {
        if self.entry(slot).counts_events { self.events[slot.row()] } else { self.u(slot) }
    }

    /// Object 0x1016: node-ID and time of consumer `number`, counted from 0.
    pub(crate) fn consumer(&self, number: usize) -> u32 {
        self.u(self.communication.consumers.plus(number as u16))
    }

    /// Object 0x1017; `None` if the node produces no heartbeat.
    pub(crate) fn heartbeat_period(&self) -> Option<Duration> {
        let period = Duration::from_millis(u64::from(self.u(self.communication.producer)));
        (!period.is_zero()).then_some(period)
    }

    /// Object 0x1015: shortest time between two EMCYs.
    pub(crate) fn emergency_inhibit(&self) -> Duration {
        let units = self.communication.emergency_inhibit.map_or(0, |slot| self.u(slot));
        Duration::from_micros(100 * u64::from(units))
    }

    /// Sets a value from inside the device, without any check.
    pub(crate) fn set(&mut self, slot: Slot, value: u32) {
        self.values[slot.row()] = value;
    }

    /// Writes a value received in a PDO. A value outside its limits is ignored.
    pub(crate) fn receive(&mut self, slot: Slot, bytes: [u8; 4]) {
        let entry = self.entry(slot);
        let value = entry.decode(bytes);
        if entry.allows(value) {
            self.assign(slot, value);
        }
    }

    /// Stores an error as the newest entry of the history.
    pub(crate) fn push_history(&mut self, code: u16) {
        let count_slot = self.communication.history_count;
        for sub in (1..HISTORY).rev() {
            let older = self.u(count_slot.plus(sub));
            self.set(count_slot.plus(sub + 1), older);
        }
        self.set(count_slot.plus(1), u32::from(code));
        let count = (self.u(count_slot) + 1).min(u32::from(HISTORY));
        self.set(count_slot, count);
    }

    fn assign(&mut self, slot: Slot, value: u32) {
        self.set(slot, value);
        let Entry { object, alias, marks, .. } = *self.entry(slot);
        if let Some(alias) = alias.and_then(|alias| self.find(alias)) {
            self.set(alias, value);
        }
        let changes = &mut self.changes;
        changes.marks |= marks;
        match object.index {
            0x1400..=0x17FF => changes.received[usize::from(object.index & 3)] = true,
            0x1800..=0x1BFF => changes.transmitted[usize::from(object.index & 3)] = true,
            0x1016 => changes.consumers = true,
            0x1017 => changes.producer = true,
            _ => {}
        }
    }

    /// Checks that forbid writing `value`, beyond access, length and limits.
    fn refuse(&mut self, slot: Slot, value: u32) -> Result<(), AbortCode> {
        let object = self.entry(slot).object;
        match object {
            named::STORE_ALL | named::RESTORE_ALL => self.store_or_restore(object, value),
            Object { index: 0x1016, .. } => self.refuse_consumer(slot, value),
            _ => pdo_parameter(object).map_or(Ok(()), |parameter| self.refuse_pdo(parameter, slot, value)),
        }
    }

    /// Two entries must not monitor the same node (CiA 301 §7.5.2.19).
    fn refuse_consumer(&self, slot: Slot, value: u32) -> Result<(), AbortCode> {
        let Some((node, _)) = watched(value) else {
            return Ok(());
        };
        let others = (0..ENTRIES).map(|number| self.communication.consumers.plus(number as u16));
        let mut others = others.filter(|other| *other != slot).map(|other| watched(self.u(other)));
        if others.any(|other| other.is_some_and(|(other, _)| other == node)) {
            return Err(AbortCode::PARAMETER_INCOMPATIBLE);
        }
        Ok(())
    }

    fn store_or_restore(&mut self, object: Object, value: u32) -> Result<(), AbortCode> {
        match (object, value) {
            (named::STORE_ALL, SAVE) => {
                for (row, entry) in self.table.iter().enumerate() {
                    if entry.writable && !entry.volatile {
                        self.stored[row] = self.values[row];
                    }
                }
            }
            (named::RESTORE_ALL, LOAD) => self.stored.clone_from(&self.factory),
            _ => return Err(AbortCode::CANNOT_STORE),
        }
        // Reading these objects returns the supported commands, not the written value.
        Ok(())
    }

    fn refuse_pdo(
        &self,
        (kind, number, place): (PdoKind, PdoNumber, Place),
        slot: Slot,
        value: u32,
    ) -> Result<(), AbortCode> {
        let existing = PdoCobId(self.u(self.cob_id(kind, number)));
        match place {
            Place::Communication(1) => {
                let wanted = PdoCobId(value);
                let changed = existing.is_valid() && (value ^ existing.0) & 0x3FFF_FFFF != 0;
                let free = wanted.id().is_some_and(|id| !cob::reserved(id));
                let allowed = wanted.is_standard() && (!wanted.is_valid() || free && !changed);
                allowed.then_some(()).ok_or(AbortCode::VALUE_RANGE)
            }
            Place::Communication(2) if (241..=253).contains(&value) => Err(AbortCode::VALUE_RANGE),
            Place::Communication(3) if existing.is_valid() => Err(AbortCode::DEVICE_STATE),
            Place::Communication(_) => Ok(()),
            Place::Mapping(_) if existing.is_valid() || self.nmt == nmt::NmtState::Operational => {
                Err(AbortCode::DEVICE_STATE)
            }
            // Every object takes at least one byte.
            Place::Mapping(0) if value > 8 => Err(AbortCode::PDO_LENGTH),
            Place::Mapping(0) => {
                let mut bits = 0;
                for sub in 1..=value as u16 {
                    let entry = MapEntry::from_raw(self.u(slot.plus(sub)));
                    self.mappable(kind, entry)?;
                    bits += u32::from(entry.bits);
                }
                if bits > 64 { Err(AbortCode::PDO_LENGTH) } else { Ok(()) }
            }
            Place::Mapping(_) if self.u(self.map(kind, number, 0)) != 0 => Err(AbortCode::SUBINDEX_LOCKED),
            Place::Mapping(_) => self.mappable(kind, MapEntry::from_raw(value)).map(|_| ()),
        }
    }

    /// The slot of a PDO's COB-ID; transmission type, inhibit time and event timer follow.
    pub(crate) fn cob_id(&self, kind: PdoKind, number: PdoNumber) -> Slot {
        self.find(kind.communication(number, 1)).expect("the table has all PDOs")
    }

    /// The slot of a sub-index of a PDO's mapping.
    pub(crate) fn map(&self, kind: PdoKind, number: PdoNumber, sub: u8) -> Slot {
        self.find(kind.mapping(number, sub)).expect("the table has all PDOs")
    }

    /// The slot of a mapping entry; `None` for a dummy of an RPDO.
    pub(crate) fn mappable(&self, kind: PdoKind, entry: MapEntry) -> Result<Option<Slot>, AbortCode> {
        let dummy = usize::from(entry.object.index).checked_sub(1).and_then(|at| DUMMIES.get(at));
        if let (PdoKind::Rpdo, Some(&bits)) = (kind, dummy) {
            let fills = bits > 0 && bits == entry.bits && entry.object.subindex == 0;
            return fills.then_some(None).ok_or(AbortCode::NOT_MAPPABLE);
        }
        let slot = self.find(entry.object).ok_or(AbortCode::NO_OBJECT)?;
        let row = self.entry(slot);
        let allowed = match kind {
            PdoKind::Rpdo => row.receive,
            PdoKind::Tpdo => row.transmit,
        };
        if allowed && usize::from(entry.bits) == 8 * row.size() { Ok(Some(slot)) } else { Err(AbortCode::NOT_MAPPABLE) }
    }
}

/// Sizes of objects 0x0001 to 0x0007, bits. In an RPDO these objects stand for their data types as fillers. 0 marks
/// BOOLEAN, which cannot be mapped, since PDOs consist of whole bytes here.
pub(crate) const DUMMIES: [u8; 7] = [0, 8, 16, 32, 8, 16, 32];

/// A byte pattern in which a displaced byte is visible.
fn factory_domain() -> Vec<u8> {
    (0..1000_u32).map(|at| (at % 251) as u8).collect()
}

/// A sub-index of a PDO's parameters.
pub(crate) enum Place {
    Communication(u8),
    Mapping(u8),
}

/// The parameter of a PDO that an object holds, if any.
pub(crate) fn pdo_parameter(object: Object) -> Option<(PdoKind, PdoNumber, Place)> {
    let number = *PdoNumber::ALL.get(usize::from(object.index & 0xFF))?;
    let sub = object.subindex;
    match object.index & 0xFF00 {
        0x1400 => Some((PdoKind::Rpdo, number, Place::Communication(sub))),
        0x1600 => Some((PdoKind::Rpdo, number, Place::Mapping(sub))),
        0x1800 => Some((PdoKind::Tpdo, number, Place::Communication(sub))),
        0x1A00 => Some((PdoKind::Tpdo, number, Place::Mapping(sub))),
        _ => None,
    }
}

impl Dictionary for Objects {
    fn size(&self, object: Object) -> Option<usize> {
        let entry = self.entry(self.find(object)?);
        (entry.data_type != DataType::Domain).then(|| entry.size())
    }

    fn check_write(&self, object: Object) -> Result<(), AbortCode> {
        let writable = self.entry(self.locate(object)?).writable;
        writable.then_some(()).ok_or(AbortCode::READ_ONLY)
    }

    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        let slot = self.locate(object)?;
        let entry = self.entry(slot);
        let count = self.u(self.communication.history_count);
        if object.index == named::ERROR_HISTORY_COUNT.index && u32::from(object.subindex) > count {
            return Err(AbortCode::NO_DATA);
        }
        let number = self.u(slot).to_le_bytes();
        let bytes = match entry.data_type {
            DataType::VisibleString => entry.text.as_bytes(),
            DataType::Domain => &self.domain,
            _ => &number[..entry.size()],
        };
        into[..bytes.len()].copy_from_slice(bytes);
        Ok(bytes.len())
    }

    fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode> {
        self.check_write(object)?;
        let slot = self.locate(object)?;
        let entry = self.entry(slot);
        if entry.data_type == DataType::Domain {
            // A server accepts only as many bytes as it can return.
            self.domain = data.to_vec();
            return Ok(());
        }
        let size = entry.size();
        if data.len() != size {
            return Err(if data.len() > size { AbortCode::LENGTH_MISMATCH } else { AbortCode::TOO_SHORT });
        }
        let mut bytes = [0; 4];
        bytes[..size].copy_from_slice(data);
        let value = entry.decode(bytes);
        if !entry.allows(value) {
            return Err(AbortCode::VALUE_RANGE);
        }
        self.refuse(slot, value)?;
        if !matches!(object, named::STORE_ALL | named::RESTORE_ALL) {
            self.assign(slot, value);
        }
        Ok(())
    }
}
