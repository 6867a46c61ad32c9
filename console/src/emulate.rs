//! `mrroc emulate`: the axis controllers of a cell on CAN interfaces or behind emulated slcan adapters, and on
//! pseudo-terminals in place of serial lines.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Frame, Instant, Port, Received, clock};
use canopen::sync::Sync;
use clap::Args;
use hil::{Cabinet, Device, Pty};

use crate::bus_port::BusPort;
use crate::cell_file::CellFile;
use crate::emulated_lines::EmulatedLines;
use crate::emulated_time::EmulatedTime;
use crate::plants::{Mechanisms, Payloads};
use crate::{emulation, interfaces, signals};

/// Longest time between two looks at whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Longest time that frames wait for the interface to take them.
const SEND: Duration = Duration::from_millis(100);

/// Options of `mrroc emulate`.
#[derive(Args)]
pub(crate) struct Options {
    /// The cell file.
    cell: PathBuf,
    /// The interface of a bus in place of the cell's: IFACE, or once for each bus BUS=IFACE where there are several.
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// An emulated slcan adapter for a bus in place of an interface, LINK, or once for each bus BUS=LINK where there are
    /// several: LINK will be a symbolic link to its tty.
    #[arg(long, value_name = "LINK")]
    slcan: Vec<String>,
    /// Where the ttys of the cell's serial lines are put: one symbolic link per axis, by its name.
    #[arg(long, value_name = "DIR")]
    serial: Option<PathBuf>,
    /// Where the service ports of EPOS4 are put: one symbolic link to a tty per CAN axis, by its name, for `mrroc sdo
    /// --can epos4:DIR/AXIS`. The drive behind it has the identity and the plant of the axis, and is another one than
    /// that on the bus: what is written to one the other does not know.
    #[arg(long, value_name = "DIR")]
    service: Option<PathBuf>,
}

/// Emulates the drives of a cell until Ctrl-C.
pub(crate) fn emulate(options: &Options) -> anyhow::Result<ExitCode> {
    let file = CellFile::read(&options.cell)?;
    let interfaces = interfaces::resolve(&file.cell, &options.can)?;
    let mut links = vec![None; interfaces.len()];
    for given in &options.slcan {
        let (index, link) = interfaces::bus_of(&file.cell, "--slcan", given)?;
        let named = |can: &String| {
            interfaces::bus_of(&file.cell, "--can", can).is_ok_and(|(bus, _)| bus == index)
        };
        if options.can.iter().any(named) || links[index].is_some() {
            bail!("--slcan {given}: the bus is already elsewhere");
        }
        links[index] = Some(link);
    }
    let on_interfaces = interfaces.iter().zip(&links);
    let on_interfaces = on_interfaces.map(|(interface, link)| link.is_none().then_some(interface));
    interfaces::all_differ(&file.cell, on_interfaces)?;
    emulation::problems(&file).next().map_or(Ok(()), Err)?;
    let mechanisms = Mechanisms::of(&file);
    let mut payloads = Payloads::of(&file, &mechanisms, clock::now());
    let mut buses = Vec::new();
    let mut lines = EmulatedLines::default();
    let mut names = Vec::new();
    for (index, bus) in file.cell.bus.iter().enumerate() {
        if let Some(link) = links[index] {
            let pty = Pty::linked(Path::new(link)).with_context(|| format!("--slcan {link}"))?;
            names.push(format!("{} behind {link}", bus.name));
            lines.add_bus(&file, &mechanisms, index, pty);
        } else {
            let interface = &interfaces[index];
            let on_bus = || format!("bus {}", bus.name);
            let claim = |(robot, axis): (usize, usize)| {
                interface.claim_as_node(file.cell.robot[robot].axis[axis].node)
            };
            let claims = emulation::axes_present(&file, index).map(claim);
            let claims = claims
                .collect::<anyhow::Result<Vec<_>>>()
                .with_context(on_bus)?;
            let port = BusPort::open(interface, bus.bitrate_kbps).with_context(on_bus)?;
            let port = port.holding(claims.into_iter().flatten());
            names.push(format!("{} on {interface}", bus.name));
            let now = clock::now();
            buses.push(EmulatedBus {
                port,
                devices: emulation::devices(&file, &mechanisms, index, now),
                time: EmulatedTime::default(),
                passed: now,
                outgoing: Vec::new(),
            });
        }
    }
    for (bundle, serial) in file.cell.serial.iter().enumerate() {
        let Some(directory) = &options.serial else {
            bail!(
                "--serial DIR is missing: it is where the ttys of {} are to be linked",
                serial.name
            );
        };
        let cabinet = Cabinet::default();
        for axis in file.cell.axes_on(file.cell.bus.len() + bundle) {
            let pty = link_of(&file, axis, directory)?;
            lines.add_axis(&file, &mechanisms, bundle, axis, &cabinet, pty);
        }
        names.push(format!("{} in {}", serial.name, directory.display()));
    }
    if let Some(directory) = &options.service {
        if file.cell.bus.is_empty() {
            bail!("--service: the cell has no CAN bus, and only drives on one have service ports");
        }
        for bus in 0..file.cell.bus.len() {
            for axis in emulation::axes_present(&file, bus) {
                let pty = link_of(&file, axis, directory)?;
                lines.add_service_port(&file, axis, pty);
            }
        }
        names.push(format!("of service ports in {}", directory.display()));
    }
    let stop = signals::ending_flag()?;
    crate::streams::say(format_args!(
        "{} emulated: bus {}; Ctrl-C ends it",
        file.cell.name,
        names.join(", bus ")
    ))?;
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
                // If it failed, the others end with it.
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
            served.context("a pseudo-terminal fails")
        };
        threads
            .into_iter()
            .map(|thread| thread.join().expect("serving a bus does not panic"))
            .fold(served, Result::and)
    })?;
    Ok(ExitCode::SUCCESS)
}

/// A pseudo-terminal that a link in `directory` leads to, by the name of `axis`, robot and number.
fn link_of(
    file: &CellFile,
    (robot, number): (usize, usize),
    directory: &Path,
) -> anyhow::Result<Pty> {
    std::fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    let link = directory.join(file.axis_name(robot, number));
    Pty::linked(&link).with_context(|| link.display().to_string())
}

/// The devices of one bus and their interface.
struct EmulatedBus {
    port: BusPort,
    devices: Vec<Box<dyn Device>>,
    time: EmulatedTime,
    /// How far time has passed for the devices.
    passed: Instant,
    /// What they have to say; as many as their queues hold.
    outgoing: Vec<Frame>,
}

impl EmulatedBus {
    /// Answers frames and lets time pass until `stop`.
    fn serve(mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        let mut received = [Received {
            frame: Sync::default().encode(),
            at: Instant::ZERO,
        }; 64];
        while !stop.load(Ordering::Relaxed) {
            let timeouts = self
                .devices
                .iter()
                .filter_map(|device| device.poll_timeout());
            let timeouts = timeouts.map(|timeout| self.time.clock(timeout));
            let wake = timeouts.fold(clock::now() + LOOK, Instant::min);
            self.port.wait_readable(wake)?;
            let count = self.port.receive(clock::now(), &mut received)?;
            // Read after the frames came, so that none is ahead of it.
            let now = clock::now();
            let came = received[..count].first().map_or(now, |first| first.at);
            self.time.waited(wake, came);
            for Received { frame, at } in &received[..count] {
                self.let_pass(self.time.at(*at));
                self.devices
                    .iter_mut()
                    .for_each(|device| device.handle(frame, self.passed));
            }
            self.let_pass(self.time.at(now));
            self.transmit(now)?;
        }
        Ok(())
    }

    /// Lets the devices' time pass to `to`. A frame is handled at the time it came, however late that is noticed: what
    /// a drive watches is the bus and not this program.
    fn let_pass(&mut self, to: Instant) {
        self.passed = self.passed.max(to);
        let timeouts = self
            .devices
            .iter()
            .filter_map(|device| device.poll_timeout());
        // All at once: else each moves its plant on in a wake-up of its own.
        if timeouts.min().is_some_and(|due| due <= self.passed) {
            for device in &mut self.devices {
                device.handle_timeout(self.passed);
            }
        }
    }

    /// Sends what the devices have to say, to the interface and each to the other devices. What the interface does not
    /// take in time is lost, as behind a bus that nobody acknowledges.
    fn transmit(&mut self, now: Instant) -> anyhow::Result<()> {
        for sender in 0..self.devices.len() {
            while let Some(frame) = self.devices[sender].poll_transmit(self.passed) {
                let others = self
                    .devices
                    .iter_mut()
                    .enumerate()
                    .filter(|(number, _)| *number != sender);
                others.for_each(|(_, device)| device.handle(&frame, self.passed));
                self.outgoing.push(frame);
            }
        }
        // At once where there is room: a call for each frame costs more than all that the devices compute.
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
