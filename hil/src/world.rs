//! The emulated side of a cell: its buses with everything that hangs on them.
//!
//! In a lockstep or emulated bench the host and the world take turns:
//!
//! ```
//! # use std::time::Duration;
//! # use can::{Frame, Instant, Port, StandardId, timing::Bitrate};
//! # use mrroc_hil::World;
//! let mut world = World::new();
//! let bus = world.add_bus(Bitrate::KBPS_1000);
//! let mut port = world.host_port(bus, 64);
//! let period = Duration::from_millis(2);
//! let mut now = Instant::ZERO;
//! for _ in 0..10 {
//!     let sync = Frame::new(StandardId::new(0x080).unwrap(), &[]).unwrap();
//!     port.send(now, &[sync]).unwrap();
//!     world.advance(now + period);
//!     now += period;
//! }
//! assert_eq!(world.bus(bus).frames, 10);
//! ```
//!
//! On a wall-clock bench the world is advanced to the host's next deadline right after the host's
//! turn, ahead of time: nothing comes in before that deadline, and frames are held back until their
//! own times by the port.

use std::any::Any;

use can::timing::Bitrate;
use can::{Instant, VirtualPort, virtual_port};

use crate::Device;
use crate::bus::{BusStatistics, VirtualBus};

/// Buses with their devices, advanced together. Buses do not influence each other.
#[derive(Default)]
pub struct World {
    buses: Vec<VirtualBus>,
}

/// One bus of one [`World`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BusId(usize);

/// One device of one [`World`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DeviceId {
    bus: BusId,
    number: usize,
}

impl World {
    /// Without buses, at [`Instant::ZERO`].
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a bus.
    pub fn add_bus(&mut self, bitrate: Bitrate) -> BusId {
        self.buses.push(VirtualBus::new(bitrate));
        BusId(self.buses.len() - 1)
    }

    /// Hangs a device on a bus. `bus` must be of this world.
    pub fn add_device(&mut self, bus: BusId, device: Box<dyn Device>) -> DeviceId {
        let number = self.buses[bus.0].attach_device(device);
        DeviceId { bus, number }
    }

    /// A port on a bus with room for `capacity` frames each way. `bus` must be of this world.
    pub fn host_port(&mut self, bus: BusId, capacity: usize) -> VirtualPort {
        let (port, peer) = virtual_port(capacity);
        self.buses[bus.0].attach_host(peer);
        port
    }

    /// Processes everything up to and including `until`, on every bus in order of events.
    pub fn advance(&mut self, until: Instant) {
        for bus in &mut self.buses {
            bus.advance(until);
        }
    }

    /// When something happens next on any bus, unless it is brought about from outside before.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.buses.iter().filter_map(VirtualBus::poll_timeout).min()
    }

    /// Lets `change` work on a device at `now`, up to which its bus is advanced before: how bytes get
    /// in and out of a device that has a serial line beside its bus. `None` if it is no `D`.
    pub fn change<D: Device, R>(
        &mut self,
        id: DeviceId,
        now: Instant,
        change: impl FnOnce(&mut D) -> R,
    ) -> Option<R> {
        let bus = self.buses.get_mut(id.bus.0)?;
        bus.change_device(id.number, now, |device| {
            let device: &mut dyn Any = device;
            device.downcast_mut().map(change)
        })?
    }

    /// What a bus has counted. `bus` must be of this world.
    pub fn bus(&self, bus: BusId) -> BusStatistics {
        self.buses[bus.0].statistics()
    }

    /// A device as what it was added as, to look at its true state; `None` if it is no `D`.
    pub fn device<D: Device>(&self, id: DeviceId) -> Option<&D> {
        let device: &dyn Any = self.buses.get(id.bus.0)?.device(id.number)?;
        device.downcast_ref()
    }
}
