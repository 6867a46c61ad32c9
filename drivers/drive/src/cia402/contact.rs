//! A contact of the emergency stop at a digital input of a drive (object 0x60FD).

use super::config::AxisConfig;
use crate::EmergencyStop;

/// A normally closed contact. Its level is known as long as the drive sends its inputs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    node: u8,
    input: u8,
    /// Greatest number of successive SYNCs without the inputs.
    tolerated_missing: u32,
    levels: u32,
    /// SYNCs in a row without the inputs.
    age: u32,
    taken: bool,
}

impl Contact {
    /// The contact of an axis, with the inputs that bring-up read; `None` for a drive without one.
    pub(super) fn new(axis: &AxisConfig, tolerated_missing: u32, levels: u32) -> Option<Self> {
        let (node, input) = (axis.node.raw(), axis.emergency_input?);
        Some(Self { node, input, tolerated_missing, levels, age: 0, taken: false })
    }

    /// Takes TPDO 3. `None` for a payload of another length.
    pub(super) fn take(&mut self, data: &[u8]) -> Option<()> {
        self.levels = u32::from_le_bytes(data.try_into().ok()?);
        self.taken = true;
        Some(())
    }

    /// Ends the reading of a cycle. `due` is true if the last cycle had to send a SYNC.
    pub(super) fn end_of_read(&mut self, due: bool) {
        if std::mem::take(&mut self.taken) {
            self.age = 0;
        } else if due {
            self.age = self.age.saturating_add(1);
        }
    }

    /// The demand of a stop, while the contact is open or its level is not known. `works` is true while the drive is in
    /// operation.
    pub(super) fn emergency_stop(&self, works: bool) -> Option<EmergencyStop> {
        let known = works && self.age <= self.tolerated_missing;
        let closed = self.levels >> self.input & 1 == 1;
        (!known || !closed).then_some(EmergencyStop { node: self.node, input: self.input, known })
    }
}
