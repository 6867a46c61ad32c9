//! The emulated side of a cell: its buses and serial lines with all devices.
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
//! assert_eq!(world.next_event(), None);
//! ```
//!
//! On a wall-clock bench, the world is advanced ahead of time: immediately after the turn of the host, up to the next
//! deadline of the host. The host sends no frame before this deadline. The port delays each received frame until the
//! time of the frame.

mod groups;
mod helpers;

use std::{any::Any, time::Duration};

use can::{Frame, Instant, VirtualPort, timing::Bitrate, virtual_port};
use serial::{Settings, VirtualLine, virtual_line};

use crate::plant::PlantFault;
use crate::scene::Scene;
use crate::{
    Device, DeviceFault, FrameFault, Frames, HostFault, LineDevice, LineFaults, PlantAxis, bus::VirtualBus,
    line::SerialLine,
};
use groups::Groups;
pub use helpers::Helpers;

/// Buses and lines with their devices, advanced together.
///
/// Buses and lines influence each other only through the [`Scene`], if there is one, through a robot
/// ([`Mechanism`](crate::Mechanism)), through a [`Cabinet`](crate::Cabinet), and through a shaft that another device
/// reads. The state of the scene changes at its steps only. Before each step, all buses and lines are advanced to the
/// time of the step. Robots of a scene without bodies, belts and other moving parts do not influence each other: the
/// devices of each robot are then advanced through all steps of an interval. The robots are advanced one after the
/// other, or several threads ([`Helpers`]) share them. Devices with a common robot or cabinet are advanced together.
/// Without a scene, each bus and each line is advanced to the end in one call.
#[derive(Default)]
pub struct World {
    buses: Vec<VirtualBus>,
    lines: Vec<SerialLine>,
    scene: Option<Scene>,
    /// Parts of the world that do not influence each other within an advance. `None` after a change.
    groups: Option<Groups>,
    helpers: Option<Helpers>,
    /// Latest instant to which the world was advanced.
    now: Instant,
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

impl DeviceId {
    /// The bus of the device.
    pub fn bus(self) -> BusId {
        self.bus
    }
}

/// One serial line of one [`World`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LineId(usize);

/// A drive of one [`World`], on a bus or at a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriveId {
    /// A drive on a bus.
    Node(DeviceId),
    /// An axis controller at a line.
    Line(LineId),
}

/// A fault of the wire, of a device or of a plant. [`World::begin_fault`] begins it.
#[derive(Clone, Debug, PartialEq)]
pub enum WorldFault {
    /// A fault of single frames.
    Frames {
        /// The bus.
        bus: BusId,
        /// Frames that the fault concerns.
        frames: Frames,
        /// The fault.
        fault: FrameFault,
        /// Probability that the fault damages a frame that it concerns.
        probability: f64,
        /// Greatest number of damaged frames.
        count: Option<u32>,
        /// Seed of the probability.
        seed: u64,
    },
    /// A fault of the controller or the interface of the host.
    Host {
        /// The bus.
        bus: BusId,
        /// The fault.
        fault: HostFault,
    },
    /// A node that is not part of the cell sends a frame.
    Foreign {
        /// The bus.
        bus: BusId,
        /// The frame.
        frame: Frame,
        /// Time between two frames; `None` for a single frame.
        every: Option<Duration>,
    },
    /// A fault of a serial line.
    Line {
        /// The line.
        line: LineId,
        /// The faults of both directions.
        faults: LineFaults,
    },
    /// The host's end of a serial line is gone for ever.
    HangUp {
        /// The line.
        line: LineId,
    },
    /// The answers of two serial lines reach the host of the other line.
    SwappedAnswers {
        /// The lines.
        lines: [LineId; 2],
    },
    /// A third party sends bytes on a serial line, once.
    Bytes {
        /// The line.
        line: LineId,
        /// Whether the host receives the bytes. Otherwise the device does.
        to_host: bool,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// A fault of a drive.
    Device {
        /// The drive.
        drive: DriveId,
        /// The fault.
        fault: DeviceFault,
    },
    /// A fault of a motor, its sensors or its power stage.
    Plant {
        /// The drive of the motor.
        drive: DriveId,
        /// The fault.
        fault: PlantFault,
    },
}

/// A fault in effect.
#[derive(Clone, Debug)]
pub struct FaultInEffect {
    fault: WorldFault,
    /// Number of the fault on its bus.
    number: u64,
    /// Whether the place has such a fault.
    known: bool,
}

impl World {
    /// A world without buses and lines, at [`Instant::ZERO`].
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a bus.
    pub fn add_bus(&mut self, bitrate: Bitrate) -> BusId {
        self.groups = None;
        self.buses.push(VirtualBus::new(bitrate));
        BusId(self.buses.len() - 1)
    }

    /// Attaches a device to a bus. `bus` must belong to this world.
    pub fn add_device(&mut self, bus: BusId, device: Box<dyn Device>) -> DeviceId {
        self.groups = None;
        let number = self.buses[bus.0].attach_device(device);
        DeviceId { bus, number }
    }

    /// A port on a bus with room for `capacity` frames each way. `bus` must belong to this world.
    pub fn host_port(&mut self, bus: BusId, capacity: usize) -> VirtualPort {
        let (port, peer) = virtual_port(capacity);
        self.buses[bus.0].attach_host(peer);
        port
    }

    /// A port in place of the first port on a bus, with room for `capacity` frames each way. The frames of the old port
    /// are dropped. `bus` must belong to this world.
    pub fn replace_port(&mut self, bus: BusId, capacity: usize) -> VirtualPort {
        let (port, peer) = virtual_port(capacity);
        self.buses[bus.0].replace_host(peer);
        port
    }

    /// Adds a serial line with a device at its end. `latency` inserts a USB adapter with such a latency timer towards
    /// the host, for example the 16 ms of an FTDI adapter.
    pub fn add_line(&mut self, settings: Settings, latency: Option<Duration>, device: Box<dyn LineDevice>) -> LineId {
        self.groups = None;
        self.lines.push(SerialLine::new(settings, latency, device));
        LineId(self.lines.len() - 1)
    }

    /// The host's end of a `line` of this world, in place of the last end, with room for `capacity` bytes each way.
    pub fn host_line(&mut self, line: LineId, capacity: usize) -> VirtualLine {
        let (host, peer) = virtual_line(capacity);
        self.lines[line.0].attach_host(peer);
        host
    }

    /// Sets the scene of this world, and drops the previous scene. The scene continues from its present state, at the
    /// present time of the world. The motors of the scene's robots and belts advance with the scene, in sub-steps of
    /// 100 µs. All other motors advance as without a scene.
    pub fn set_scene(&mut self, mut scene: Scene) {
        self.groups = None;
        scene.begin(self.now);
        self.scene = Some(scene);
    }

    /// Lets helpers share the work of each advance with the thread that started them. Another thread that advances this
    /// world works alone. The helpers do not change the results.
    pub fn set_helpers(&mut self, helpers: Helpers) {
        self.groups = None;
        self.helpers = Some(helpers);
    }

    /// The scene, if there is one.
    pub fn scene(&self) -> Option<&Scene> {
        self.scene.as_ref()
    }

    /// The scene, mutable; `None` without a scene.
    pub fn scene_mut(&mut self) -> Option<&mut Scene> {
        self.groups = None;
        self.scene.as_mut()
    }

    /// Processes all events and all steps of the scene up to and including `until`. The events of each bus and each
    /// line are processed in the order of their times. A step precedes the events of the same instant.
    ///
    /// A host sends nothing during an advance. A bus or a line is therefore left out of the steps of the scene in which it
    /// has no event.
    pub fn advance(&mut self, until: Instant) {
        self.advance_beside(until, || {});
    }

    /// Advances the world as [`advance`](Self::advance). The calling thread first does `work`, while helpers already
    /// advance their shares. `work` must not use the ports and lines of this world.
    pub fn advance_beside(&mut self, until: Instant, work: impl FnOnce()) {
        let Self { buses, lines, scene, groups, helpers, now } = self;
        if scene.is_some() || helpers.is_some() {
            let threads = helpers.as_ref().map_or(1, Helpers::threads);
            let groups = groups.get_or_insert_with(|| Groups::new(scene.as_ref(), buses, lines, threads));
            groups.advance(until, scene.as_mut(), buses, lines, helpers.as_ref(), work);
        } else {
            work();
            buses.iter_mut().for_each(|bus| bus.advance(until));
            lines.iter_mut().for_each(|line| line.advance(until));
        }
        *now = (*now).max(until);
    }

    /// Time of the next event known now; `None` if no event occurs before a host sends. A waiting bench advances to
    /// this instant, or to the instant of an earlier frame of a host.
    pub fn next_event(&self) -> Option<Instant> {
        let buses = self.buses.iter().filter_map(VirtualBus::next_event);
        let lines = self.lines.iter().filter_map(SerialLine::next_event);
        buses.chain(lines).min()
    }

    /// Applies `change` to a device at `now`, after advancing its bus, or the whole world if it has a scene, to `now`.
    /// A device with a serial line exchanges its bytes in this way. `None` if the device is no `D`.
    pub fn change<D: Device, R>(&mut self, id: DeviceId, now: Instant, change: impl FnOnce(&mut D) -> R) -> Option<R> {
        if self.scene.is_some() {
            self.advance(now);
        }
        let bus = self.buses.get_mut(id.bus.0)?;
        bus.change_device(id.number, now, |device| {
            let device: &mut dyn Any = device;
            device.downcast_mut().map(change)
        })?
    }

    /// A device as its own type, to examine its true state; `None` if the device is no `D`.
    pub fn device<D: Device>(&self, id: DeviceId) -> Option<&D> {
        let device: &dyn Any = self.buses.get(id.bus.0)?.device(id.number)?;
        device.downcast_ref()
    }

    /// Begins a fault at `now`, after advancing the world to `now`.
    pub fn begin_fault(&mut self, fault: &WorldFault, now: Instant) -> FaultInEffect {
        self.advance(now);
        let (number, known) = match fault {
            WorldFault::Frames { bus, frames, fault, probability, count, seed } => {
                (self.buses[bus.0].begin_frame_fault(*frames, *fault, (*probability, *count, *seed)), true)
            }
            WorldFault::Foreign { bus, frame, every } => (self.buses[bus.0].begin_foreign(*frame, now, *every), true),
            _ => (0, self.switch_fault(fault, true, now)),
        };
        FaultInEffect { fault: fault.clone(), number, known }
    }

    /// Whether a fault has acted before its end. A fault of frames or of the bytes of a line acts when it damages a frame
    /// or telegram, and every other fault at its beginning.
    pub fn has_acted(&self, in_effect: &FaultInEffect) -> bool {
        match &in_effect.fault {
            WorldFault::Frames { bus, .. } => self.buses[bus.0].has_damaged(in_effect.number),
            WorldFault::Line { line, .. } => self.lines[line.0].damaged() > 0,
            _ => in_effect.known,
        }
    }

    /// Ends a fault at `now`, after advancing the world to `now`. A single event has no end: a reset, a jump, a hang-up.
    pub fn end_fault(&mut self, in_effect: &FaultInEffect, now: Instant) {
        self.advance(now);
        match &in_effect.fault {
            WorldFault::Frames { bus, .. } | WorldFault::Foreign { bus, .. } => {
                self.buses[bus.0].end_frame_fault(in_effect.number, now);
            }
            fault => _ = self.switch_fault(fault, false, now),
        }
    }

    /// Returns whether the place has such a fault.
    fn switch_fault(&mut self, fault: &WorldFault, on: bool, now: Instant) -> bool {
        match fault {
            WorldFault::Host { bus, fault } => self.buses[bus.0].set_host_fault(*fault, on, now),
            WorldFault::Line { line, faults } => {
                let faults = if on { *faults } else { LineFaults::default() };
                self.lines[line.0].set_faults(&faults);
            }
            // The end of the fault exchanges the hosts again.
            WorldFault::SwappedAnswers { lines: [one, other] } => {
                return match self.lines.get_disjoint_mut([one.0, other.0]) {
                    Ok([one, other]) => {
                        one.swap_receivers(other);
                        true
                    }
                    Err(_) => false,
                };
            }
            WorldFault::HangUp { line } if on => self.lines[line.0].hang_up(),
            WorldFault::Bytes { line, to_host, bytes } if on => self.lines[line.0].inject(bytes, *to_host, now),
            WorldFault::Device { drive, fault } => {
                return match drive {
                    DriveId::Node(id) => self.buses[id.bus.0].set_device_fault(id.number, *fault, on, now),
                    DriveId::Line(id) => self.lines[id.0].set_device_fault(*fault, on, now),
                };
            }
            WorldFault::Plant { drive, fault } => {
                let plant = match drive {
                    DriveId::Node(id) => self.buses[id.bus.0].device_mut(id.number).and_then(Device::plant_mut),
                    DriveId::Line(id) => self.lines[id.0].device_mut().plant_mut(),
                };
                return plant.map(|plant| plant.set_fault(*fault, on)).is_some();
            }
            WorldFault::Frames { .. }
            | WorldFault::Foreign { .. }
            | WorldFault::HangUp { .. }
            | WorldFault::Bytes { .. } => {}
        }
        true
    }

    /// The motor of a drive with its true state, as of its last sub-step; `None` for a device without a motor.
    pub fn plant(&self, drive: DriveId) -> Option<&PlantAxis> {
        match drive {
            DriveId::Node(id) => self.buses.get(id.bus.0)?.device(id.number)?.plant(),
            DriveId::Line(id) => self.lines.get(id.0)?.any_device().plant(),
        }
    }

    /// A line, to examine its counters and its device. `line` must belong to this world.
    pub fn line(&self, line: LineId) -> &SerialLine {
        &self.lines[line.0]
    }

    /// A line, to change its faults or to disconnect its host. `line` must belong to this world.
    pub fn line_mut(&mut self, line: LineId) -> &mut SerialLine {
        &mut self.lines[line.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::{Port, StandardId};
    use serial::Line;

    /// Sends every byte back at once.
    struct Echo(Option<u8>);

    impl LineDevice for Echo {
        fn receive(&mut self, byte: u8, _now: Instant) {
            self.0 = Some(byte);
        }
        fn poll_transmit(&mut self, _now: Instant) -> Option<u8> {
            self.0.take()
        }
        fn poll_timeout(&self) -> Option<Instant> {
            None
        }
        fn handle_timeout(&mut self, _now: Instant) {}
    }

    #[test]
    fn a_bench_that_wakes_at_the_next_event_misses_none() {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let line = world.add_line(Settings::EPOS, None, Box::new(Echo(None)));
        let (mut port, mut listener) = (world.host_port(bus, 4), world.host_port(bus, 4));
        let mut host = world.host_line(line, 4);
        assert_eq!(world.next_event(), None);
        host.write(Instant::ZERO, &[7]).expect("it is there");
        let sync = Frame::new(StandardId::new(0x080).expect("11 bits"), &[]).expect("no bytes");
        port.send(Instant::ZERO, &[sync]).expect("it is there");
        let mut wakings = Vec::new();
        while let Some(at) = world.next_event() {
            world.advance(at);
            wakings.push(at.as_nanos());
        }
        // The frame begins and ends; the byte ends at the device, then at the host.
        assert_eq!(wakings, [0, 48_000, 86_806, 2 * 86_806]);
        let mut byte = [0];
        let end = Instant::from_nanos(2 * 86_806);
        assert_eq!(host.read(end, &mut byte), Ok(1));
        let mut frame = [can::Received { frame: sync, at: end }];
        assert_eq!(listener.receive(end, &mut frame), Ok(1));
        assert!(world.line(line).device::<Echo>().is_some());
        assert_eq!(world.line(line).statistics().to_host, 1);
    }
}
