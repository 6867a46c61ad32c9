//! Services for ports other than CAN. Each request is answered at once.

use can::{Frame, Instant};
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE};
use canopen::{Object, cob, nmt};

use super::Epos4;

impl Epos4 {
    /// Whether the device has booted and answers requests.
    pub(crate) fn has_booted(&self) -> bool {
        self.boots_at.is_none()
    }

    /// The size of an object in bytes; `None` if there is no such object.
    pub(crate) fn size(&self, object: Object) -> Option<usize> {
        self.objects.size(object)
    }

    /// Reads an object to the front of `into`, and returns the size of the object in bytes.
    pub(crate) fn read(
        &mut self,
        object: Object,
        into: &mut [u8; MAX_SIZE],
        now: Instant,
    ) -> Result<usize, AbortCode> {
        self.check_state()?;
        self.catch_up(now, false);
        let read = self.objects.read(object, into);
        self.settle(now);
        self.schedule();
        read
    }

    /// Writes a whole object and applies the change.
    pub(crate) fn write(
        &mut self,
        object: Object,
        data: &[u8],
        now: Instant,
    ) -> Result<(), AbortCode> {
        self.check_state()?;
        self.catch_up(now, false);
        let written = self.objects.write(object, data);
        self.settle(now);
        self.schedule();
        written
    }

    /// Executes an NMT command for this node or for all nodes. Ignores other bytes.
    pub(crate) fn command_nmt(
        &mut self,
        command: u16,
        node: u16,
        now: Instant,
    ) -> Result<(), AbortCode> {
        let (Ok(command), Ok(node)) = (u8::try_from(command), u8::try_from(node)) else {
            return Err(AbortCode::MAXON_ILLEGAL_COMMAND);
        };
        let frame = Frame::new(cob::NMT, &[command, node]).expect("two bytes fit");
        let request = nmt::Request::decode(&frame).ok_or(AbortCode::MAXON_ILLEGAL_COMMAND)?;
        if !self.node.is_some_and(|node| request.concerns(node)) {
            return Err(AbortCode::MAXON_NODE_ID);
        }
        self.catch_up(now, false);
        self.manage(request.command, now);
        self.schedule();
        Ok(())
    }

    /// Whether `node` addresses this device: by its node-ID, or by 0, which addresses the device at the end of the
    /// line.
    pub(crate) fn is_node(&self, node: u8) -> bool {
        node == 0 || self.node.is_some_and(|own| own.raw() == node)
    }

    fn check_state(&self) -> Result<(), AbortCode> {
        if self.serving() {
            Ok(())
        } else {
            Err(AbortCode::MAXON_NMT_STATE)
        }
    }
}
