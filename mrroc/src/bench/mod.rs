//! Benches: the ports to the drives, and the emulated world behind them, if any.

pub mod bridge;
pub mod bus_port;
pub mod camera_wire;
mod cameras;
pub mod carving;
pub mod clockwork;
mod conveyors;
pub mod drive_ids;
pub mod emulated_lines;
pub(crate) mod emulated_sensors;
pub mod emulated_time;
pub mod emulation;
pub mod interfaces;
mod matrices;
mod own_devices;
pub mod plants;
mod random;
pub mod scene;
pub mod silence;
pub(crate) mod traffic;
pub mod truth;

use std::mem::take;
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use can::send_only::send_only;
use can::{InterfaceName, Port, SocketCanOptions, TraceReader, Tracer};
use drive::axis_controller::error_state_telegram;
use serial::{Line, LineTraceReader, LineTracer, Settings, Tty, VirtualLine};

use crate::bench::bus_port::{BusPort, prepare_card};
use crate::bench::{emulation::Emulation, interfaces::Interface};
use crate::cell::{Bus, Cell, CellFile, Serial};
use crate::guardian::{GuardedLine, Guardian, stop_of_all_nodes};
use crate::setup;
use crate::wire::{Listener, Wire};

/// Frames by which a trace may lag behind the bus: some seconds of a full bus.
const TRACE: usize = 1 << 16;

/// The benches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "command-line", derive(clap::ValueEnum))]
pub enum BenchKind {
    /// Emulated drives on a virtual bus, in virtual time.
    Lockstep,
    /// Emulated drives on a virtual bus, in real time.
    #[default]
    Emulated,
    /// A virtual CAN interface or pseudo-terminals, with `mrroc emulate` at the other end.
    Vcan,
    /// CAN cards and ttys. Moves hardware.
    Card,
}

impl BenchKind {
    /// Name of the bench on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lockstep => "lockstep",
            Self::Emulated => "emulated",
            Self::Vcan => "vcan",
            Self::Card => "card",
        }
    }
}

/// Interfaces and ttys of a bench, where they differ from the cell file.
#[derive(Debug, Default)]
#[cfg_attr(feature = "command-line", derive(clap::Args))]
pub struct Places {
    /// The interface of a bus in place of the cell's: IFACE, or BUS=IFACE once for each of several buses.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "IFACE"))]
    pub can: Vec<String>,
    /// The directory with one tty per axis, named after the axis, in place of the cell's lines. `mrroc emulate
    /// --serial` makes such a directory.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "DIR"))]
    pub serial: Option<PathBuf>,
    /// Set the cards to the cell's bit rates and bring them up. A card that is up at another rate is taken down first.
    #[cfg_attr(feature = "command-line", arg(long))]
    pub set_bitrate: bool,
    /// The socket of a waiting `mrroc guard`, which becomes the guardian in place of a child of this process.
    #[cfg_attr(feature = "command-line", arg(long, value_name = "SOCKET"))]
    pub guardian: Option<PathBuf>,
}

impl Places {
    /// Refuses interfaces and ttys that may be hardware on a bench without hardware. [`BenchKind::Vcan`] permits only
    /// virtual interfaces and pseudo-terminals.
    pub fn check(&self, file: &CellFile, kind: BenchKind) -> anyhow::Result<()> {
        if kind != BenchKind::Vcan {
            return Ok(());
        }
        let is_device = |path: &Path| path.canonicalize().is_ok_and(|it| !it.starts_with("/dev/pts"));
        let interfaces = interfaces::resolve(&file.cell, &self.can)?;
        let may_be_hardware = |interface: &&Interface| match interface {
            Interface::SocketCan(name) => can::card::read(name).is_ok(),
            Interface::Slcan { path, .. } | Interface::Epos { path, .. } => is_device(path.as_ref()),
        };
        let bus = interfaces.iter().find(may_be_hardware);
        let ttys = self.ttys(file);
        let tty = ttys.iter().find(|path| is_device(path));
        if let Some(name) = bus.map(Interface::to_string).or(tty.map(|path| path.display().to_string())) {
            bail!("--bench vcan: {name} may be hardware, which takes --bench card");
        }
        Ok(())
    }

    /// The ttys of the axes, then those of the sensors.
    fn ttys(&self, file: &CellFile) -> Vec<PathBuf> {
        let directory = self.serial.as_deref();
        let ttys = (0..file.cell.serial.len()).flat_map(|bundle| tty_paths(file, bundle, directory));
        let sensors = sensor_lines(&file.cell).map(|it| sensor_tty(&it, directory));
        ttys.map(|(_, path)| path).chain(sensors).collect()
    }

    /// The interfaces of the buses, and the ttys of axes, sensors and slcan adapters.
    pub fn all(&self, file: &CellFile) -> anyhow::Result<(Vec<Interface>, Vec<PathBuf>)> {
        let (interfaces, mut ttys) = (interfaces::resolve(&file.cell, &self.can)?, self.ttys(file));
        ttys.extend(interfaces.iter().filter_map(|interface| match interface {
            Interface::SocketCan(_) => None,
            Interface::Slcan { path, .. } | Interface::Epos { path, .. } => Some(PathBuf::from(path)),
        }));
        Ok((interfaces, ttys))
    }
}

/// An opened bench.
pub struct Bench {
    /// One port per bus of the cell.
    pub ports: Vec<Box<dyn Port>>,
    /// The lines of each bundle of the cell.
    pub lines: Vec<Vec<Box<dyn Line>>>,
    /// The line of each force sensor on a serial line, then of each ultrasonic matrix, then of each device of another
    /// crate.
    pub sensors: Vec<Box<dyn Line>>,
    /// The interface of each port: the cell's, or the one given in its place.
    pub interfaces: Vec<Interface>,
    /// Frames at each port, if a trace was requested.
    pub traces: Vec<TraceReader>,
    /// The listeners of the buses.
    pub wire: Wire,
    /// The emulated cell, on the benches without hardware.
    pub emulation: Option<Emulation>,
    /// The guardian of the ttys of axis controllers.
    pub guardian: Option<Guardian>,
}

impl Bench {
    /// Records what passes over every line from now on: the lines of the bundles, then those of sensors.
    pub(crate) fn trace_lines(&mut self) -> Vec<LineTraceReader> {
        let mut readers = Vec::new();
        let mut traced = |line| {
            let (line, reader) = LineTracer::new(line, TRACE / 4);
            readers.push(reader);
            Box::new(line) as Box<dyn Line>
        };
        let bundles = take(&mut self.lines).into_iter();
        self.lines = bundles.map(|bundle| bundle.into_iter().map(&mut traced).collect()).collect();
        self.sensors = take(&mut self.sensors).into_iter().map(traced).collect();
        readers
    }

    /// Opens the bench `kind` for a cell.
    pub fn open(file: &CellFile, kind: BenchKind, places: &Places, trace: bool) -> anyhow::Result<Self> {
        let (can, serial) = (&places.can, places.serial.as_deref());
        if places.set_bitrate && kind != BenchKind::Card {
            bail!("--set-bitrate needs --bench card");
        }
        let interfaces = interfaces::resolve(&file.cell, can)?;
        interfaces::all_differ(&file.cell, interfaces.iter().map(Some))?;
        places.check(file, kind)?;
        let (ports, lines, sensors, listeners, emulation, guardian) = match kind {
            BenchKind::Lockstep | BenchKind::Emulated => {
                if !can.is_empty() || serial.is_some() {
                    bail!("--can and --serial need --bench vcan or --bench card");
                }
                if places.guardian.is_some() {
                    bail!("--guardian needs --bench vcan or --bench card: emulated drives have no guardian");
                }
                emulation::problems(file).next().map_or(Ok(()), Err)?;
                let (mut emulation, ends) = Emulation::of(file);
                let lines = emulated_lines(file, kind, &mut emulation, ends.lines)?;
                let sensors = emulated_sensors(file, kind, &mut emulation, ends.sensors)?;
                let listeners = ends.listeners.into_iter().map(Listener::Virtual).collect();
                (ends.ports, lines, sensors, listeners, Some(emulation), None)
            }
            BenchKind::Vcan | BenchKind::Card => {
                let open = |(index, interface): (usize, &Interface)| {
                    let bus = &file.cell.bus[index];
                    let on_bus = || format!("bus {}", bus.name);
                    // Before any access to the card, which another controller may be using.
                    let claim = interface.claim_as_controller().with_context(on_bus)?;
                    if kind == BenchKind::Card {
                        prepare_card(interface, bus, places.set_bitrate).with_context(on_bus)?;
                    }
                    let send_queue = file.cell.frames_per_cycle(index);
                    let options = SocketCanOptions { send_queue, ..SocketCanOptions::default() };
                    let port = BusPort::with_options(interface, bus.bitrate_kbps, &options);
                    Ok(Box::new(port.with_context(on_bus)?.holding(claim)) as _)
                };
                let ports = interfaces.iter().enumerate().map(open).collect::<anyhow::Result<_>>()?;
                let listen = |(index, interface): (usize, &Interface)| {
                    Listener::open(file, index, interface).with_context(|| format!("bus {}", file.cell.bus[index].name))
                };
                let listeners = interfaces.iter().enumerate().map(listen).collect::<anyhow::Result<_>>()?;
                let (lines, mut guarded) = ttys(file, serial)?;
                guarded.extend(guarded_buses(file, &interfaces)?);
                let sensors = sensor_ttys(file, serial)?;
                (ports, lines, sensors, listeners, None, Guardian::of_cell(file, &guarded, places.guardian.as_deref())?)
            }
        };
        let (ports, traces) = if trace {
            let traced = ports.into_iter().map(|port| {
                let (port, reader) = Tracer::new(port, TRACE);
                (Box::new(port) as _, reader)
            });
            traced.unzip()
        } else {
            (ports, Vec::new())
        };
        Ok(Self { ports, lines, sensors, interfaces, traces, wire: Wire::new(file, listeners), emulation, guardian })
    }
}

/// The host's ends of emulated lines: virtual lines in lockstep, ttys in real time.
pub(crate) fn emulated_lines(
    file: &CellFile,
    kind: BenchKind,
    emulation: &mut Emulation,
    lines: Vec<Vec<VirtualLine>>,
) -> anyhow::Result<Vec<Vec<Box<dyn Line>>>> {
    let bundle = |(lines, bundle): (Vec<VirtualLine>, &Serial)| {
        let line = |line| -> anyhow::Result<Box<dyn Line>> {
            Ok(match kind {
                BenchKind::Emulated => Box::new(emulation.on_tty(line, bundle.settings())?),
                _ => Box::new(line),
            })
        };
        lines.into_iter().map(line).collect()
    };
    lines.into_iter().zip(&file.cell.serial).map(bundle).collect()
}

/// A sensor or a device on a serial line of its own.
pub struct SensorLine<'a> {
    /// Kind of the sensor in messages.
    pub what: &'static str,
    /// Name of the sensor.
    pub name: &'a str,
    /// The tty.
    pub line: &'a str,
    settings: Settings,
}

/// The lines of all force sensors on serial lines, then of all ultrasonic matrices, then of all devices of other
/// crates.
pub fn sensor_lines(cell: &Cell) -> impl Iterator<Item = SensorLine<'_>> {
    let sensors = cell.serial_sensors().map(|sensor| &cell.force_sensor[sensor]).map(|it| SensorLine {
        what: "force sensor",
        name: &it.name,
        line: it.tty(),
        settings: it.settings(),
    });
    let matrices = cell.ultrasonic.iter().map(|it| SensorLine {
        what: "ultrasonic matrix",
        name: &it.name,
        line: &it.line,
        settings: it.settings(),
    });
    let devices = cell.device.iter().map(|it| SensorLine {
        what: "device",
        name: &it.keys.name,
        line: &it.keys.line,
        settings: it.own.line().settings,
    });
    sensors.chain(matrices).chain(devices)
}

/// The host's ends of the emulated lines of sensors: virtual lines in lockstep, ttys in real time.
pub(crate) fn emulated_sensors(
    file: &CellFile,
    kind: BenchKind,
    emulation: &mut Emulation,
    lines: Vec<VirtualLine>,
) -> anyhow::Result<Vec<Box<dyn Line>>> {
    let line = |(line, sensor): (VirtualLine, SensorLine<'_>)| -> anyhow::Result<Box<dyn Line>> {
        Ok(match kind {
            BenchKind::Emulated => Box::new(emulation.on_tty(line, sensor.settings)?),
            _ => Box::new(line),
        })
    };
    lines.into_iter().zip(sensor_lines(&file.cell)).map(line).collect()
}

fn sensor_ttys(file: &CellFile, directory: Option<&Path>) -> anyhow::Result<Vec<Box<dyn Line>>> {
    let open = |sensor: SensorLine<'_>| {
        let tty = Tty::open(sensor_tty(&sensor, directory), sensor.settings);
        Ok(Box::new(tty.with_context(|| format!("{} {}", sensor.what, sensor.name))?) as Box<dyn Line>)
    };
    sensor_lines(&file.cell).map(open).collect()
}

/// The tty of a sensor, named in the cell, or made in `directory` by `mrroc emulate --serial`.
fn sensor_tty(sensor: &SensorLine<'_>, directory: Option<&Path>) -> PathBuf {
    directory.map_or_else(|| PathBuf::from(sensor.line), |directory| directory.join(sensor.name))
}

/// The lines of each bundle.
type Bundles = Vec<Vec<Box<dyn Line>>>;

/// The ttys of axis controllers, and what a guardian needs of each.
fn ttys(file: &CellFile, directory: Option<&Path>) -> anyhow::Result<(Bundles, Vec<GuardedLine>)> {
    let mut guarded = Vec::new();
    let mut bundles = Vec::new();
    for (index, bundle) in file.cell.serial.iter().enumerate() {
        let axes = setup::controller_configs(file, index);
        let mut lines = Vec::new();
        for ((axis, path), config) in tty_paths(file, index, directory).into_iter().zip(axes) {
            let of_axis = || format!("axis {axis}");
            let tty = Tty::open(&path, bundle.settings()).with_context(of_axis)?;
            let line = tty.as_fd().try_clone_to_owned().with_context(of_axis)?;
            guarded.push(GuardedLine { line, telegram: error_state_telegram(bundle.protocol, &config) });
            lines.push(Box::new(tty) as Box<dyn Line>);
        }
        bundles.push(lines);
    }
    Ok((bundles, guarded))
}

/// A socket of each guarded bus, and the frame that stops its nodes.
fn guarded_buses(file: &CellFile, interfaces: &[Interface]) -> anyhow::Result<Vec<GuardedLine>> {
    let guarded = file.cell.bus.iter().zip(interfaces).filter(|(bus, _)| bus.guarded);
    let line = |(bus, interface): (&Bus, &Interface)| {
        let Interface::SocketCan(name) = interface else {
            bail!("bus {}: guarded needs a SocketCAN interface, not {interface}", bus.name);
        };
        let name = InterfaceName::new(name).with_context(|| format!("bus {}: {name}", bus.name))?;
        let line = send_only(name).with_context(|| format!("bus {}: guardian on {name}", bus.name))?;
        Ok(GuardedLine { line, telegram: stop_of_all_nodes() })
    };
    guarded.map(line).collect()
}

/// The axes of bundle `bundle` and their ttys. The ttys are named in the cell, or `mrroc emulate --serial` made them
/// in `directory`.
fn tty_paths(file: &CellFile, bundle: usize, directory: Option<&Path>) -> Vec<(String, PathBuf)> {
    let path = |(robot, number): (usize, usize)| {
        let axis = file.axis_name(robot, number);
        let own = || PathBuf::from(&file.cell.robot[robot].axis[number].axis_controller().line);
        let path = directory.map_or_else(own, |directory| directory.join(&axis));
        (axis, path)
    };
    file.cell.axes_on(file.cell.bus.len() + bundle).map(path).collect()
}
