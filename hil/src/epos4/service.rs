//! Services for ports other than CAN. Each request is answered at once.

use can::{Frame, Instant};
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE};
use canopen::{Object, cob, nmt};
use serial::epos4::Address;

use super::Epos4;
use crate::node::objects::Objects;

impl Epos4 {
    /// Whether the device has booted and answers requests.
    pub(crate) fn has_booted(&self) -> bool {
        self.node.has_booted()
    }

    /// Reads an object to the front of `into`, and returns the size of the object in bytes.
    pub(crate) fn read(
        &mut self,
        address: Address,
        into: &mut [u8; MAX_SIZE],
        now: Instant,
    ) -> Result<usize, AbortCode> {
        self.access(address, now, |objects, object| objects.read(object, into))
    }

    /// Reads an object of up to four bytes.
    pub(crate) fn read_value(&mut self, address: Address, now: Instant) -> Result<u32, AbortCode> {
        let mut bytes = [0; MAX_SIZE];
        match self.read(address, &mut bytes, now)? {
            0..=4 => Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            _ => Err(AbortCode::LENGTH_MISMATCH),
        }
    }

    /// Writes a whole object and applies the change.
    pub(crate) fn write(&mut self, address: Address, data: &[u8], now: Instant) -> Result<(), AbortCode> {
        self.access(address, now, |objects, object| objects.write(object, data))
    }

    /// Writes the low bytes of `value`. The size of the object determines their number.
    pub(crate) fn write_value(&mut self, address: Address, value: u32, now: Instant) -> Result<(), AbortCode> {
        self.access(address, now, |objects, object| {
            let size = objects.size(object).map_or(4, |size| size.min(4));
            objects.write(object, &value.to_le_bytes()[..size])
        })
    }

    /// Accesses the dictionary if `address` has the device's node-ID, or 0 for the device at the end of the line.
    fn access<R>(
        &mut self,
        address: Address,
        now: Instant,
        access: impl FnOnce(&mut Objects, Object) -> Result<R, AbortCode>,
    ) -> Result<R, AbortCode> {
        if address.node != 0 && self.node.id.is_none_or(|own| own.raw() != address.node) {
            return Err(AbortCode::MAXON_NODE_ID);
        }
        if !self.node.serving() {
            return Err(AbortCode::MAXON_NMT_STATE);
        }
        self.node.catch_up(now, false);
        let object = Object::new(address.index, address.subindex);
        let result = access(&mut self.node.objects, object);
        self.node.settle(now);
        self.node.schedule();
        result
    }

    /// Executes an NMT command for this node or for all nodes. Ignores other bytes.
    pub(crate) fn command_nmt(&mut self, command: u16, node: u16, now: Instant) -> Result<(), AbortCode> {
        let (Ok(command), Ok(node)) = (u8::try_from(command), u8::try_from(node)) else {
            return Err(AbortCode::MAXON_ILLEGAL_COMMAND);
        };
        let frame = Frame::new(cob::NMT, &[command, node]).expect("two bytes fit");
        let request = nmt::Request::decode(&frame).ok_or(AbortCode::MAXON_ILLEGAL_COMMAND)?;
        if !self.node.id.is_some_and(|node| request.concerns(node)) {
            return Err(AbortCode::MAXON_NODE_ID);
        }
        self.node.catch_up(now, false);
        self.node.manage(request.command, now);
        self.node.schedule();
        Ok(())
    }
}
