//! `mrroc emulate`: emulates the axis controllers of a cell. The controllers are on CAN interfaces, behind emulated
//! slcan adapters, or on pseudo-terminals in place of serial lines.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod live_lines;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Frame, Instant, Port, Received, clock};
use canopen::sync::Sync;
use clap::Args;
use hil::{Cabinet, Device, Pty};

use mrroc::bench::bus_port::BusPort;
use mrroc::bench::camera_wire;
use mrroc::bench::emulated_lines::{EmulatedLines, LiveFaults};
use mrroc::bench::emulated_time::EmulatedTime;
use mrroc::bench::plants::{EmulatedCell, Payloads};
use mrroc::bench::{emulation, interfaces, sensor_lines};
use mrroc::cell::CellFile;
use mrroc::scenario::{Scenario, ScenarioProbe, ScenarioRun};
use mrroc::signals;

use live_lines::LiveLines;

/// Longest time between two checks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Longest time that frames wait until the interface accepts them.
const SEND: Duration = Duration::from_millis(100);

/// Options of `mrroc emulate`.
#[derive(Args)]
pub(crate) struct Options {
    /// The cell file.
    cell: PathBuf,
    /// The interface of a bus in place of the cell's: IFACE, or BUS=IFACE once per bus if the cell has several.
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// An emulated slcan adapter for a bus in place of an interface: LINK, or BUS=LINK once per bus if the cell has
    /// several. LINK becomes a symbolic link to the tty of the adapter.
    #[arg(long, value_name = "LINK")]
    slcan: Vec<String>,
    /// Directory for the ttys of the cell's serial lines: one symbolic link per axis, with the name of the axis.
    #[arg(long, value_name = "DIR")]
    serial: Option<PathBuf>,
    /// Directory for the service ports of EPOS4: one symbolic link to a tty per CAN axis, with the name of the axis.
    /// The ports are for `mrroc sdo --can epos4:DIR/AXIS`. The drive behind a port has the identity and the plant of
    /// the axis, but is not the drive on the bus. A value written to either of the two does not reach the other.
    #[arg(long, value_name = "DIR")]
    service: Option<PathBuf>,
    /// Play the faults of this scenario file.
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Read faults from standard input, one per line: the kind, then KEY=VALUE as in a scenario file, for example
    /// `lost axis=irb6.column duration=0.1`. The faults begin at once, and have no `at`, `cycle` and `when`.
    #[arg(long)]
    live: bool,
}

/// Faults that may wait for the emulation.
const LIVE: usize = 64;

/// Emulates the drives of a cell until Ctrl-C.
pub(crate) fn emulate(options: &Options) -> anyhow::Result<ExitCode> {
    let file = CellFile::read(&options.cell)?;
    let interfaces = interfaces::resolve(&file.cell, &options.can)?;
    let mut links = vec![None; interfaces.len()];
    for given in &options.slcan {
        let (index, link) = interfaces::bus_of(&file.cell, "--slcan", given)?;
        let named = |can: &String| interfaces::bus_of(&file.cell, "--can", can).is_ok_and(|(bus, _)| bus == index);
        if options.can.iter().any(named) || links[index].is_some() {
            bail!("--slcan {given}: the bus is already elsewhere");
        }
        links[index] = Some(link);
    }
    let on_interfaces = interfaces.iter().zip(&links).map(|(interface, link)| link.is_none().then_some(interface));
    interfaces::all_differ(&file.cell, on_interfaces)?;
    emulation::problems(&file).next().map_or(Ok(()), Err)?;
    let scenario = options.scenario.as_deref().map(Scenario::read).transpose()?;
    // Contacts, sensors and faults need one world of all drives. Buses of this world have transmission times.
    let cell = &file.cell;
    let faulty = scenario.is_some() || options.live;
    let sensors = cell.has_sensor_lines() || !(cell.force_sensor.is_empty() && cell.camera.is_empty());
    let together = faulty || sensors || cell.scene.is_some();
    let emulated = EmulatedCell::of(&file);
    let mut payloads = Payloads::of(&emulated, clock::now());
    let mut buses = Vec::new();
    // The buses of the world, one per bus of the cell if all are in it.
    let mut of_world = Vec::new();
    let mut lines = EmulatedLines::default();
    let mut names = Vec::new();
    for (index, bus) in file.cell.bus.iter().enumerate() {
        if let Some(link) = links[index] {
            let pty = Pty::linked(Path::new(link)).with_context(|| format!("--slcan {link}"))?;
            names.push(format!("{} behind {link}", bus.name));
            of_world.push(lines.add_bus(&emulated, index, pty));
        } else {
            let interface = &interfaces[index];
            let on_bus = || format!("bus {}", bus.name);
            let claim = |node| interface.claim_as_node(node);
            let claims: anyhow::Result<Vec<_>> = emulation::nodes_present(&file, index).map(claim).collect();
            let claims = claims.with_context(on_bus)?;
            let port = BusPort::open(interface, bus.bitrate_kbps).with_context(on_bus)?;
            let port = port.holding(claims.into_iter().flatten());
            names.push(format!("{} on {interface}", bus.name));
            if together {
                of_world.push(lines.add_bus_on(&emulated, index, port));
                continue;
            }
            let now = clock::now();
            buses.push(EmulatedBus {
                port,
                devices: emulated.devices(index, now),
                time: EmulatedTime::default(),
                passed: now,
                outgoing: Vec::new(),
            });
        }
    }
    for (bundle, serial) in file.cell.serial.iter().enumerate() {
        let Some(directory) = &options.serial else {
            bail!("--serial DIR is missing: it is where the ttys of {} are to be linked", serial.name);
        };
        let cabinet = Cabinet::default();
        for axis in file.cell.axes_on(file.cell.bus.len() + bundle) {
            let pty = link_of(&file, axis, directory)?;
            let line = emulated.add_line(&mut lines.world, bundle, axis, &cabinet);
            lines.add_line(line, pty);
        }
        names.push(format!("{} in {}", serial.name, directory.display()));
    }
    let (mut sensors, _) = emulated.add_sensors(&mut lines.world, &of_world);
    sensors.extend(emulated.add_matrices(&mut lines.world));
    sensors.extend(emulated.add_devices(&mut lines.world));
    for (name, line) in sensor_lines(cell).map(|sensor| sensor.name).zip(sensors) {
        let Some(directory) = &options.serial else {
            bail!("--serial DIR is missing: it is where the tty of {name} is to be linked");
        };
        lines.add_sensor(line, linked(name, directory)?);
        names.push(format!("{name} in {}", directory.display()));
    }
    let mut cameras = camera_wire::Threads::default();
    for (number, camera) in file.cell.camera.iter().enumerate() {
        let address = camera.address.parse().expect("a parsed cell has addresses of cameras");
        cameras.serve(&file, number, &mut lines.world, address)?;
        names.push(format!("{} at {address}", camera.name));
    }
    if let Some(directory) = &options.service {
        if file.cell.bus.is_empty() {
            bail!("--service: the cell has no CAN bus, and only drives on one have service ports");
        }
        for bus in 0..file.cell.bus.len() {
            for axis in emulation::axes_present(&file, bus) {
                let pty = link_of(&file, axis, directory)?;
                let line = emulation::add_service_port(&mut lines.world, &file, axis);
                lines.add_line(line, pty);
            }
        }
        names.push(format!("of service ports in {}", directory.display()));
    }
    let mut played = ScenarioProbe::default();
    if faulty {
        let ids = emulated.ids();
        let mut run = ScenarioRun::empty(&file);
        scenario.iter().try_for_each(|scenario| run.add(scenario, &file, &ids))?;
        played = run.watch();
        let live = options.live.then(|| {
            let tell = |said: &str| mrroc::streams::warn(format_args!("mrroc: {said}"));
            LiveFaults { lines: standard_input(), file: file.clone(), ids, tell: Box::new(tell) }
        });
        lines.play(run, live);
    }
    let stop = signals::ending_flag()?;
    mrroc::streams::say(format_args!("{} emulated: bus {}; Ctrl-C ends it", file.cell.name, names.join(", bus ")))?;
    std::thread::scope(|scope| {
        let flag = &stop;
        scope.spawn(move || {
            while let Some(due) = payloads.next().filter(|_| !flag.load(Ordering::Relaxed)) {
                clock::sleep_until(due.min(clock::now() + LOOK));
                payloads.take_over(clock::now());
            }
        });
        let serve = |bus: EmulatedBus| {
            let stop = &stop;
            scope.spawn(move || {
                let served = bus.serve(stop);
                // If this thread failed, the other threads end as well.
                stop.store(true, Ordering::Relaxed);
                served
            })
        };
        let threads: Vec<_> = buses.into_iter().map(serve).collect();
        let served = if lines.is_empty() {
            Ok(())
        } else {
            let served = lines.serve(&stop);
            stop.store(true, Ordering::Relaxed);
            served.context("an emulated bus or line fails")
        };
        threads.into_iter().map(|thread| thread.join().expect("serving a bus does not panic")).fold(served, Result::and)
    })?;
    for idle in played.idle() {
        mrroc::streams::warn(format_args!("mrroc: {idle}"));
    }
    Ok(ExitCode::SUCCESS)
}

/// The lines of standard input. The thread that reads them ends with the process.
fn standard_input() -> Receiver<String> {
    let (send, lines) = sync_channel(LIVE);
    std::thread::spawn(move || {
        let mut lines = LiveLines::new(std::io::stdin().lock());
        while let Ok(Some(line)) = lines.next_line() {
            if send.send(line).is_err() {
                return;
            }
        }
    });
    lines
}

/// A pseudo-terminal and a symbolic link to it in `directory`. The link has the name of `axis`, which gives robot and
/// number.
fn link_of(file: &CellFile, (robot, number): (usize, usize), directory: &Path) -> anyhow::Result<Pty> {
    linked(&file.axis_name(robot, number), directory)
}

/// A pseudo-terminal and a symbolic link called `name` to it in `directory`.
fn linked(name: &str, directory: &Path) -> anyhow::Result<Pty> {
    std::fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    let link = directory.join(name);
    Pty::linked(&link).with_context(|| link.display().to_string())
}

/// The devices of one bus and their interface.
struct EmulatedBus {
    port: BusPort,
    devices: Vec<Box<dyn Device>>,
    time: EmulatedTime,
    /// Time up to which the devices have been simulated.
    passed: Instant,
    /// Frames that the devices send. The capacity is the sum of their queues.
    outgoing: Vec<Frame>,
}

impl EmulatedBus {
    /// Processes frames and advances the devices until `stop` is set.
    fn serve(mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        let mut received = [Received { frame: Sync::default().encode(), at: Instant::ZERO }; 64];
        while !stop.load(Ordering::Relaxed) {
            let look = clock::now() + LOOK;
            let wake = self.due().map(|due| self.time.clock(due)).map_or(look, |due| due.min(look));
            self.port.wait_readable(wake)?;
            let count = self.port.receive(clock::now(), &mut received)?;
            // The clock is read after the frames arrived, so that no frame has a later time.
            let now = clock::now();
            let came = received[..count].first().map_or(now, |first| first.at);
            self.time.waited(wake, came);
            for Received { frame, at } in &received[..count] {
                self.let_pass(self.time.at(*at));
                for device in &mut self.devices {
                    device.handle(frame, self.passed);
                }
            }
            self.let_pass(self.time.at(now));
            self.transmit(now)?;
        }
        Ok(())
    }

    /// Time of the next event of a device.
    fn due(&self) -> Option<Instant> {
        self.devices.iter().filter_map(|device| device.poll_timeout()).min()
    }

    /// Advances the devices to `to`. A frame is processed at its time of arrival, even if this program reads it late.
    /// The watchdogs of the devices therefore monitor the bus and not this program.
    fn let_pass(&mut self, to: Instant) {
        self.passed = self.passed.max(to);
        // All devices are handled at once. Otherwise each device would advance its plant in a wake-up of its own.
        if self.due().is_some_and(|due| due <= self.passed) {
            for device in &mut self.devices {
                device.handle_timeout(self.passed);
            }
        }
    }

    /// Sends the frames of the devices to the interface, and the frames of each device to all other devices. Frames
    /// that the interface does not accept in time are lost, as on a bus without acknowledgement.
    fn transmit(&mut self, now: Instant) -> anyhow::Result<()> {
        for sender in 0..self.devices.len() {
            while let Some(frame) = self.devices[sender].poll_transmit(self.passed) {
                let others = self.devices.iter_mut().enumerate().filter(|(number, _)| *number != sender);
                others.for_each(|(_, device)| device.handle(&frame, self.passed));
                self.outgoing.push(frame);
            }
        }
        // Frames are sent in one call if possible. One call per frame would cost more than all computation of the
        // devices.
        let mut rest = self.outgoing.as_slice();
        let give_up = now + SEND;
        while !rest.is_empty() {
            rest = &rest[self.port.send(now, rest)?..];
            if !rest.is_empty() {
                if clock::now() >= give_up {
                    break;
                }
                clock::sleep_until(clock::now() + Duration::from_micros(100));
            }
        }
        self.outgoing.clear();
        Ok(())
    }
}
