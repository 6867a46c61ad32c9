//! Emulated devices on pseudo-terminals and CAN interfaces, in step with the wall clock: CAN buses behind slcan adapters
//! or on interfaces, serial axis controllers, force sensors, and service ports. This module waits for bytes, frames and
//! the devices' time.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::io;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use can::{Frame, Instant, Port, Received, VirtualPort, clock};
use canopen::sync::Sync;
use hil::pty::{self, Interest};
use hil::{BusId, DeviceId, Pty, SlcanDevice, World};
use serial::{Line, VirtualLine};
use servo::thread::set_fifo;

use crate::bench::bus_port::BusPort;
use crate::bench::drive_ids::DriveIds;
use crate::bench::{emulated_time::EmulatedTime, emulation, plants::EmulatedCell};
use crate::cell::CellFile;
use crate::scenario::{Scenario, ScenarioRun};

/// Longest time between two checks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Requested SCHED_FIFO priority.
const PRIORITY: u8 = 60;

/// Shortest time between two wake-ups for the devices. Received bytes are handled at once. The end of a sent byte or a
/// UART interrupt needs no wake-up. The request and the answer of a 2 ms cell take 0.4 ms.
const GRAIN: Duration = Duration::from_micros(500);

/// As [`GRAIN`], in a world with a sensor. The query and the answer of a force sensor take most of a period.
const FINE_GRAIN: Duration = Duration::from_micros(100);

/// Greatest number of bytes taken from a pseudo-terminal at a time. Further bytes wait in it.
const CHUNK: usize = 4096;

/// Number of frames that a bus of the world holds for its interface, in each direction.
const FRAMES: usize = 1024;

/// A world, and the pseudo-terminals and CAN interfaces for its hosts. The time of the world starts at [`Instant::ZERO`].
#[derive(Default)]
pub struct EmulatedLines {
    /// The world.
    pub world: World,
    lines: Vec<EmulatedLine>,
    buses: Vec<BridgedBus>,
    /// Whether a line is that of a force sensor or an ultrasonic matrix.
    has_sensor: bool,
    /// Faults in the world.
    scenario: Option<ScenarioRun>,
    /// Faults that are given while the world runs.
    live: Option<LiveFaults>,
}

/// Faults that are given while the world runs, each as one line.
pub struct LiveFaults {
    /// The lines.
    pub lines: Receiver<String>,
    /// The cell of the world.
    pub file: CellFile,
    /// Places in the world.
    pub ids: DriveIds,
    /// Tells the acceptance or the refusal of a line.
    pub tell: Box<dyn FnMut(&str) + Send>,
}

/// A bus of the world and the interface that continues it. Frames take their time on the bus of the world, and none on
/// the interface.
struct BridgedBus {
    port: BusPort,
    bus: VirtualPort,
    /// Frames that the interface has not accepted yet.
    outgoing: Vec<Frame>,
}

/// One pseudo-terminal and the device behind it.
struct EmulatedLine {
    pty: Pty,
    end: End,
    /// The host does not read.
    full: bool,
}

enum End {
    Adapter(DeviceId),
    Line {
        line: VirtualLine,
        /// Bytes that have arrived for the host.
        arrived: Vec<u8>,
    },
}

impl EmulatedLines {
    /// Adds CAN bus `index` of a cell, behind an slcan adapter on `pty`.
    pub fn add_bus(&mut self, emulated: &EmulatedCell, index: usize, pty: Pty) -> BusId {
        let bus = emulated.add_bus(&mut self.world, index);
        let adapter = Box::new(SlcanDevice::new(emulation::bitrate(emulated.file, index)));
        let end = End::Adapter(self.world.add_device(bus, adapter));
        self.add(pty, end);
        bus
    }

    /// Adds CAN bus `index` of a cell, on the interface of `port`.
    pub fn add_bus_on(&mut self, emulated: &EmulatedCell, index: usize, port: BusPort) -> BusId {
        let bus = emulated.add_bus(&mut self.world, index);
        self.buses.push(BridgedBus { port, bus: self.world.host_port(bus, FRAMES), outgoing: Vec::new() });
        bus
    }

    /// Adds a line of the world on `pty`.
    pub fn add_line(&mut self, line: VirtualLine, pty: Pty) {
        self.add(pty, End::Line { line, arrived: Vec::new() });
    }

    /// Adds the line of a force sensor or an ultrasonic matrix of the world on `pty`.
    pub fn add_sensor(&mut self, line: VirtualLine, pty: Pty) {
        self.has_sensor = true;
        self.add_line(line, pty);
    }

    /// Plays a scenario from now on, and takes faults while the world runs.
    pub fn play(&mut self, scenario: ScenarioRun, live: Option<LiveFaults>) {
        (self.scenario, self.live) = (Some(scenario), live);
    }

    /// Takes the faults that were given since the last call.
    fn take_live(&mut self) {
        let (Some(live), Some(run)) = (&mut self.live, &mut self.scenario) else {
            return;
        };
        for line in live.lines.try_iter().filter(|line| !line.trim().is_empty()) {
            let added = Scenario::of_line(&line).and_then(|scenario| run.add(&scenario, &live.file, &live.ids));
            (live.tell)(&added.map_or_else(|error| format!("{error:#}"), |()| format!("in effect: {line}")));
        }
    }

    fn add(&mut self, pty: Pty, end: End) {
        self.lines.push(EmulatedLine { pty, end, full: false });
    }

    /// Whether there are neither lines nor buses.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty() && self.buses.is_empty()
    }

    /// Runs the devices until `stop`.
    pub fn serve(&mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        self.serve_observed(stop, |_, _| {})
    }

    /// Runs the devices until `stop`. `observe` is called with the world and its time after each advance, at least every
    /// 50 ms.
    pub fn serve_observed(
        &mut self,
        stop: &AtomicBool,
        mut observe: impl FnMut(&World, Instant),
    ) -> anyhow::Result<()> {
        // The priority is below a controller on the same host and above everything else. If the priority is denied, a
        // busy host delays the devices.
        let _ = set_fifo(PRIORITY);
        let mut time = EmulatedTime::since(clock::now());
        let mut passed = Instant::ZERO;
        let grain = if self.has_sensor { FINE_GRAIN } else { GRAIN };
        while !stop.load(Ordering::Relaxed) {
            let due = self.world.next_event().unwrap_or(Instant::FAR_FUTURE);
            // Events of a scenario are looked for in each period.
            let look = self.scenario.as_ref().map_or(LOOK, |_| GRAIN);
            let wake = time.clock(due.max(passed + grain)).min(clock::now() + look);
            let ends = self.lines.iter().map(|line| {
                let interest = Interest { read: line.end.room(&self.world) > 0, write: line.full };
                (line.pty.as_fd(), interest)
            });
            let buses = self.buses.iter().map(|bus| (bus.port.as_fd(), Interest { read: true, write: false }));
            let readable = pty::wait(ends.chain(buses), wake)?;
            // A pseudo-terminal does not tell when its bytes arrived. After a late wake-up of this program, the bytes
            // count as older than the events that fell due in between. A device must detect the silence of its host,
            // not a delay of this program.
            let now = clock::now();
            time.waited(wake, now);
            let now = time.at(now);
            passed = passed.max(now.min(due - Duration::from_nanos(1)));
            let lines = self.lines.iter_mut().zip(readable);
            for (line, _) in lines.filter(|(_, readable)| *readable) {
                line.take(&mut self.world, passed)?;
            }
            for bus in &mut self.buses {
                bus.take(passed)?;
            }
            passed = passed.max(now);
            self.take_live();
            if let Some(scenario) = &mut self.scenario {
                scenario.advance(&mut self.world, passed);
            }
            self.world.advance(passed);
            if let Some(scenario) = &self.scenario {
                scenario.note(&self.world);
            }
            observe(&self.world, passed);
            for line in &mut self.lines {
                line.deliver(&mut self.world, passed)?;
            }
            for bus in &mut self.buses {
                bus.deliver(passed)?;
            }
        }
        Ok(())
    }
}

impl BridgedBus {
    /// Puts the frames of the interface on the bus of the world, at `now`.
    fn take(&mut self, now: Instant) -> anyhow::Result<()> {
        let mut received = [Received { frame: Sync::default().encode(), at: Instant::ZERO }; 64];
        let count = self.port.receive(clock::now(), &mut received)?;
        for Received { frame, .. } in &received[..count] {
            // A frame without room is lost, as in the overrun of a receiver.
            self.bus.send(now, std::slice::from_ref(frame))?;
        }
        Ok(())
    }

    /// Sends the frames that have ended on the bus of the world by `now` to the interface. Frames that the interface does
    /// not accept wait for the next call, and the oldest are lost.
    fn deliver(&mut self, now: Instant) -> anyhow::Result<()> {
        let mut received = [Received { frame: Sync::default().encode(), at: Instant::ZERO }; 64];
        let count = self.bus.receive(now, &mut received)?;
        self.outgoing.extend(received[..count].iter().map(|received| received.frame));
        let sent = self.port.send(clock::now(), &self.outgoing)?;
        self.outgoing.drain(..sent);
        let surplus = self.outgoing.len().saturating_sub(FRAMES);
        self.outgoing.drain(..surplus);
        Ok(())
    }
}

impl EmulatedLine {
    /// Takes the bytes that the host has written.
    fn take(&mut self, world: &mut World, now: Instant) -> io::Result<()> {
        let mut bytes = [0; CHUNK];
        let room = self.end.room(world).min(CHUNK);
        let count = if room == 0 { 0 } else { self.pty.read(&mut bytes[..room])? };
        match &mut self.end {
            _ if count == 0 => {}
            End::Adapter(id) => change(world, *id, now, |adapter| {
                adapter.handle_bytes(&bytes[..count], now);
            }),
            // Bytes without room are lost, as in the overrun of a receiver.
            End::Line { line, .. } => _ = line.write(now, &bytes[..count]),
        }
        Ok(())
    }

    /// Delivers received bytes to the host, until the host stops reading.
    fn deliver(&mut self, world: &mut World, now: Instant) -> io::Result<()> {
        self.full = false;
        match &mut self.end {
            End::Adapter(id) => {
                while !adapter(world, *id).bytes().is_empty() && !self.full {
                    let count = self.pty.write(adapter(world, *id).bytes())?;
                    change(world, *id, now, |adapter| adapter.consume(count));
                    self.full = count == 0;
                }
            }
            End::Line { line, arrived } => {
                let mut bytes = [0; CHUNK];
                while !self.full {
                    if arrived.is_empty() {
                        // A failed line delivers no bytes.
                        let count = line.read(now, &mut bytes).unwrap_or(0);
                        arrived.extend_from_slice(&bytes[..count]);
                    }
                    if arrived.is_empty() {
                        break;
                    }
                    let count = self.pty.write(arrived)?;
                    arrived.drain(..count);
                    // While the host does not read, the line's own queue fills up and then loses bytes, like that of a
                    // tty.
                    self.full = !arrived.is_empty();
                }
            }
        }
        Ok(())
    }
}

impl End {
    /// Number of bytes that the end takes. Further bytes block the host.
    fn room(&self, world: &World) -> usize {
        match self {
            Self::Adapter(id) => adapter(world, *id).room(),
            Self::Line { .. } => CHUNK,
        }
    }
}

fn adapter(world: &World, id: DeviceId) -> &SlcanDevice {
    world.device(id).expect("it was added as an adapter")
}

fn change(world: &mut World, id: DeviceId, now: Instant, change: impl FnOnce(&mut SlcanDevice)) {
    world.change(id, now, change).expect("it was added as an adapter");
}
