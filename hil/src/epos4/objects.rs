//! The values of the object dictionary, their storage, and the rules of writing.
//!
//! A write records its consequences for the rest of the device in [`Changes`]. The device evaluates the changes after
//! each request and each PDO. The rules of re-mapping a PDO (CiA 301 §7.5.2.36, §7.5.2.38) are enforced here:
//! COB-ID off (bit 31), count to 0, entries, count, COB-ID on. Stored values live as long as the emulator.

use canopen::cia402::{HomingMethod, ModeOfOperation, SupportedModes};
use canopen::pdo::{Entry as MapEntry, PdoCobId, PdoKind, PdoNumber};
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE};
use canopen::{NodeId, Object, cob, eds::DataType, nmt, objects as named};

use super::heartbeats::{ENTRIES, watched};
use super::table::{ROWS, Slot, TABLE, slot};

/// "save", the password of object 0x1010.
const SAVE: u32 = 0x6576_6173;
/// "load", the password of object 0x1011.
const LOAD: u32 = 0x6461_6F6C;
/// Capacity of object 0x1003, errors.
pub(super) const HISTORY: u16 = 5;

/// Changes by writes since the device last evaluated them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Changes {
    pub(super) controlword: bool,
    pub(super) mode: bool,
    /// A set-point of a cyclic mode.
    pub(super) setpoint: bool,
    /// Parameters of RPDOs and of TPDOs, by number.
    pub(super) received: [bool; 4],
    pub(super) transmitted: [bool; 4],
    /// The time of the node's own heartbeat.
    pub(super) producer: bool,
    /// The nodes whose heartbeats are watched.
    pub(super) consumers: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Objects {
    values: [u32; ROWS],
    /// Values that a reset restores.
    stored: Box<[u32; ROWS]>,
    /// Factory values with this unit's identity.
    factory: Box<[u32; ROWS]>,
    /// The only object of type DOMAIN.
    domain: Vec<u8>,
    pub(super) nmt: nmt::NmtState,
    pub(super) changes: Changes,
}

impl Objects {
    /// Factory values. `identity` holds the values that differ from unit to unit.
    ///
    /// Without a node-ID, COB-IDs are set by [`Objects::rename`].
    pub(super) fn new(node: Option<NodeId>, identity: &[(Slot, u32)]) -> Self {
        let raw = node.map_or(0, |node| u32::from(node.raw()));
        let mut factory = [0; ROWS];
        for (value, entry) in factory.iter_mut().zip(&TABLE) {
            *value = entry.default + u32::from(entry.plus_node) * raw;
        }
        for &(slot, value) in identity {
            factory[slot.row()] = value;
        }
        Self {
            domain: factory_domain(),
            values: factory,
            stored: Box::new(factory),
            factory: Box::new(factory),
            nmt: nmt::NmtState::Initialising,
            changes: Changes::default(),
        }
    }

    /// Restores stored values: those below 0x2000, or all.
    pub(super) fn reset(&mut self, all: bool) {
        for (row, entry) in TABLE.iter().enumerate() {
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
    pub(super) fn rename(&mut self, node: NodeId) {
        for (row, entry) in TABLE.iter().enumerate().filter(|(_, entry)| entry.plus_node) {
            let factory = entry.default + u32::from(node.raw());
            if self.stored[row] == self.factory[row] {
                self.stored[row] = factory;
            }
            self.factory[row] = factory;
        }
    }

    /// An unsigned value.
    pub(super) fn u(&self, slot: Slot) -> u32 {
        self.values[slot.row()]
    }

    /// A signed value.
    pub(super) fn i(&self, slot: Slot) -> i32 {
        self.values[slot.row()] as i32
    }

    /// A value as a number for formulas.
    pub(super) fn f(&self, slot: Slot) -> f64 {
        slot.entry().number(self.u(slot)) as f64
    }

    /// Sets a value from inside the device, without any check.
    pub(super) fn set(&mut self, slot: Slot, value: u32) {
        self.values[slot.row()] = value;
    }

    /// Writes a value received in a PDO. A value outside its limits is ignored.
    pub(super) fn receive(&mut self, slot: Slot, bytes: [u8; 4]) {
        let entry = slot.entry();
        let value = entry.decode(bytes);
        if entry.allows(value) && (entry.object != named::MODE_OF_OPERATION || supported(value)) {
            self.assign(slot, value);
        }
    }

    /// Stores an error as the newest entry of the history.
    pub(super) fn push_history(&mut self, code: u16) {
        const COUNT: Slot = slot!(ERROR_HISTORY_COUNT);
        for sub in (1..HISTORY).rev() {
            let older = self.u(COUNT.plus(sub));
            self.set(COUNT.plus(sub + 1), older);
        }
        self.set(COUNT.plus(1), u32::from(code));
        let count = (self.u(COUNT) + 1).min(u32::from(HISTORY));
        self.set(COUNT, count);
    }

    fn assign(&mut self, slot: Slot, value: u32) {
        self.set(slot, value);
        let object = slot.entry().object;
        let changes = &mut self.changes;
        match object {
            named::CONTROLWORD => changes.controlword = true,
            named::MODE_OF_OPERATION => changes.mode = true,
            named::TARGET_POSITION | named::TARGET_VELOCITY | named::TARGET_TORQUE => {
                changes.setpoint = true;
            }
            // One object has two addresses, CiA's and maxon's.
            named::HOME_OFFSET => self.set(slot!(EPOS4_HOME_OFFSET_MOVE), value),
            named::EPOS4_HOME_OFFSET_MOVE => self.set(slot!(HOME_OFFSET), value),
            _ => match object.index {
                0x1400..=0x17FF => changes.received[usize::from(object.index & 3)] = true,
                0x1800..=0x1BFF => changes.transmitted[usize::from(object.index & 3)] = true,
                0x1016 => changes.consumers = true,
                0x1017 => changes.producer = true,
                _ => {}
            },
        }
    }

    /// Checks that forbid writing `value`, beyond access, length and limits.
    fn refuse(&mut self, slot: Slot, value: u32) -> Result<(), AbortCode> {
        let object = slot.entry().object;
        let in_range = match object {
            named::ERROR_HISTORY_COUNT => value == 0,
            named::MODE_OF_OPERATION => supported(value),
            named::HOMING_METHOD => HomingMethod::EPOS4.contains(&HomingMethod(value as i32 as i8)),
            // Revolutions per minute, from 1 down to 1e-6.
            named::VELOCITY_UNIT => {
                value & 0x00FF_FFFF == 0x00B4_4700 && (-6..=0).contains(&((value >> 24) as u8 as i8))
            }
            _ => true,
        };
        if !in_range {
            return Err(AbortCode::VALUE_RANGE);
        }
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
        let others = (0..ENTRIES).map(|number| slot!(CONSUMER_HEARTBEAT_1).plus(number as u16));
        let mut others = others.filter(|other| *other != slot).map(|other| watched(self.u(other)));
        if others.any(|other| other.is_some_and(|(other, _)| other == node)) {
            return Err(AbortCode::PARAMETER_INCOMPATIBLE);
        }
        Ok(())
    }

    fn store_or_restore(&mut self, object: Object, value: u32) -> Result<(), AbortCode> {
        match (object, value) {
            (named::STORE_ALL, SAVE) => {
                for (row, entry) in TABLE.iter().enumerate() {
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
        let existing = PdoCobId(self.u(cob_id(kind, number)));
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
                    mappable(kind, entry)?;
                    bits += u32::from(entry.bits);
                }
                if bits > 64 { Err(AbortCode::PDO_LENGTH) } else { Ok(()) }
            }
            Place::Mapping(_) if self.u(map(kind, number, 0)) != 0 => Err(AbortCode::SUBINDEX_LOCKED),
            Place::Mapping(_) => mappable(kind, MapEntry::from_raw(value)).map(|_| ()),
        }
    }
}

/// The slot of a PDO's COB-ID; transmission type, inhibit time and event timer follow.
pub(super) fn cob_id(kind: PdoKind, number: PdoNumber) -> Slot {
    Slot::find(kind.communication(number, 1)).expect("the table has all PDOs")
}

/// The slot of a sub-index of a PDO's mapping.
pub(super) fn map(kind: PdoKind, number: PdoNumber, sub: u8) -> Slot {
    Slot::find(kind.mapping(number, sub)).expect("the table has all PDOs")
}

/// Sizes of objects 0x0001 to 0x0007, bits. In an RPDO these objects stand for their data types as fillers. 0 marks
/// BOOLEAN, which cannot be mapped, since PDOs consist of whole bytes here.
pub(super) const DUMMIES: [u8; 7] = [0, 8, 16, 32, 8, 16, 32];

/// The slot of a mapping entry; `None` for a dummy of an RPDO.
pub(super) fn mappable(kind: PdoKind, entry: MapEntry) -> Result<Option<Slot>, AbortCode> {
    let dummy = usize::from(entry.object.index).checked_sub(1).and_then(|at| DUMMIES.get(at));
    if let (PdoKind::Rpdo, Some(&bits)) = (kind, dummy) {
        let fills = bits > 0 && bits == entry.bits && entry.object.subindex == 0;
        return fills.then_some(None).ok_or(AbortCode::NOT_MAPPABLE);
    }
    let slot = Slot::find(entry.object).ok_or(AbortCode::NO_OBJECT)?;
    let row = slot.entry();
    let allowed = match kind {
        PdoKind::Rpdo => row.receive,
        PdoKind::Tpdo => row.transmit,
    };
    if allowed && usize::from(entry.bits) == 8 * row.size() { Ok(Some(slot)) } else { Err(AbortCode::NOT_MAPPABLE) }
}

/// A byte pattern in which a displaced byte is visible.
fn factory_domain() -> Vec<u8> {
    (0..1000_u32).map(|at| (at % 251) as u8).collect()
}

fn supported(mode: u32) -> bool {
    SupportedModes::EPOS4.contains(ModeOfOperation::from_raw(mode as i32 as i8))
}

/// A sub-index of a PDO's parameters.
pub(super) enum Place {
    Communication(u8),
    Mapping(u8),
}

/// The parameter of a PDO that an object holds, if any.
pub(super) fn pdo_parameter(object: Object) -> Option<(PdoKind, PdoNumber, Place)> {
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

fn find(object: Object) -> Result<Slot, AbortCode> {
    Slot::find(object).ok_or_else(|| {
        if TABLE.iter().any(|entry| entry.object.index == object.index) {
            AbortCode::NO_SUBINDEX
        } else {
            AbortCode::NO_OBJECT
        }
    })
}

impl Dictionary for Objects {
    fn size(&self, object: Object) -> Option<usize> {
        let entry = Slot::find(object)?.entry();
        (entry.data_type != DataType::Domain).then(|| entry.size())
    }

    fn check_write(&self, object: Object) -> Result<(), AbortCode> {
        let writable = find(object)?.entry().writable;
        writable.then_some(()).ok_or(AbortCode::READ_ONLY)
    }

    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        let slot = find(object)?;
        let entry = slot.entry();
        let count = self.u(slot!(ERROR_HISTORY_COUNT));
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
        let slot = find(object)?;
        let entry = slot.entry();
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
