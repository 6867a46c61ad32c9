//! `mrroc monitor`: prints the frames of a bus as text while they arrive, or the frames of a candump log.

mod from_file;

use std::io::{BufWriter, ErrorKind, Write};
use std::mem::{replace, take};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::Context;
use can::{ControllerState, Port, PortError, Received, clock};
use canopen::NodeId;
use canopen::cia401::PROFILE;
use clap::Args;
use drive::{cia401, cia402};
use master::pdo::PdoSetup;
use serde::Serialize;

use super::decode::{Decoder, Described, Kind};
use super::pdo_map::{MappingQuestions, Pdo, PdoMap};
use super::survey::Survey;
use super::talk;
use super::words::Identification;
use super::{Bus, BusArgs};
use mrroc::bench::interfaces::Interface;
use mrroc::bench::silence;
use mrroc::cell::CellFile;
use mrroc::report::counted;
use mrroc::setup;

/// Message about an interface that was set down.
const DOWN: &str = "the interface is down: frames are shown again once it is up (ip link set ... up), Ctrl-C ends";

/// Options of `mrroc monitor`.
#[derive(Args)]
#[command(mut_arg("can", |can| can.required_unless_present("from")))]
pub struct Options {
    #[command(flatten)]
    bus: BusArgs,
    /// Read frames from a log of `candump -l` or `-L`, not from a bus; `-` is standard input. With --cell, an interface of
    /// the log has the PDOs and names of its bus of the cell. Lines that are no frame are counted.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["can", "bitrate_kbps", "map"])]
    from: Option<PathBuf>,
    /// Read the PDO mapping of the nodes by SDO at the start. Do not use while another master uses SDO.
    #[arg(long)]
    map: bool,
    /// Time to wait for an answer of each node to --map, ms.
    #[arg(long, value_name = "MS", default_value_t = 200)]
    timeout: u64,
    /// Stop after this number of frames.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Show frames of these kinds only.
    #[arg(long, value_name = "KIND", value_enum, value_delimiter = ',')]
    only: Vec<Kind>,
    /// Do not show frames of these kinds.
    #[arg(long, value_name = "KIND", value_enum, value_delimiter = ',', conflicts_with = "only")]
    without: Vec<Kind>,
    /// Print one JSON object per frame.
    #[arg(long)]
    json: bool,
}

impl Options {
    fn wants(&self, kind: Kind) -> bool {
        (self.only.is_empty() || self.only.contains(&kind)) && !self.without.contains(&kind)
    }
}

/// Shows frames until Ctrl-C, until `--count` frames were shown, or until the reader of the output closes it. The exit
/// status is 0 in all three cases. An interface that was down does not end the command. A log is shown to its end.
pub fn monitor(options: &Options) -> anyhow::Result<ExitCode> {
    if let Some(path) = &options.from {
        return from_file::show(path, options);
    }
    let mut bus = if options.map { options.bus.open()? } else { options.bus.listen()? };
    let mut decoder = bus.cell.as_ref().map(|(file, index)| of_cell(file, *index)).unwrap_or_default();
    if options.map {
        let nodes = NodeId::all().map(|node| (node, MappingQuestions::of(node)));
        let mut survey = Survey::new(nodes, Duration::from_millis(options.timeout));
        bus.hold(&mut survey)?;
        for (node, questions) in survey.into_answers() {
            decoder.identify(node, questions.identification);
            decoder.add_pdos(questions.into_map());
        }
    }
    match watch(&mut bus, &mut decoder, options) {
        Err(error) if is_broken_pipe(&error) => Ok(ExitCode::SUCCESS),
        watched => watched.map(|()| ExitCode::SUCCESS),
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

/// PDO mapping that a run of the cell configures in its nodes, and the identification of the nodes.
fn of_cell(file: &CellFile, index: usize) -> Decoder {
    let mut decoder = Decoder::default();
    let mut pdos = PdoMap::new();
    let mut add = |node: NodeId, setups: Vec<PdoSetup>| {
        for setup in setups {
            let id = setup.cob_id.id().expect("these have 11-bit identifiers");
            let entries = setup.mapping.entries().to_vec();
            pdos.insert(id.raw(), Pdo { node, kind: setup.kind, number: setup.number, entries });
        }
    };
    for axis in setup::axis_configs(file, index) {
        decoder.identify(axis.node, Identification { vendor: Some(axis.identity.vendor), device_type: None });
        add(axis.node, cia402::pdo_setups(&axis));
    }
    for io in file.cell.io_configs(index) {
        let device_type = Some(u32::from(PROFILE));
        decoder.identify(io.node, Identification { vendor: Some(io.identity.vendor), device_type });
        let mut setups = cia401::pdo_setups(&io).expect("a parsed cell has possible times").to_vec();
        setups.retain(|setup| !setup.mapping.entries().is_empty());
        add(io.node, setups);
    }
    for sensor in file.cell.sensor_configs(index) {
        let vendor = sensor.identity.map(|identity| identity.vendor);
        decoder.identify(sensor.node, Identification { vendor, device_type: sensor.device_type });
        add(sensor.node, sensor.pdo_setups().expect("a parsed cell has possible process data"));
    }
    decoder.add_pdos(pdos);
    decoder
}

fn watch(bus: &mut Bus, decoder: &mut Decoder, options: &Options) -> anyhow::Result<()> {
    let mut received = talk::batch();
    let mut out = BufWriter::new(std::io::stdout());
    let began = clock::now();
    decoder.begin(began);
    let mut left = options.count.unwrap_or(u64::MAX);
    let (mut health, mut down) = (Health::default(), false);
    while left > 0 && !bus.interrupted.load(Ordering::Relaxed) {
        let look = clock::now() + talk::LOOK;
        let read = bus.port.wait_readable(look).and_then(|_| bus.port.receive(clock::now(), &mut received));
        let count = match read {
            Ok(count) => count,
            Err(PortError::Down) => {
                if !replace(&mut down, true) {
                    mrroc::streams::warn(format_args!("mrroc: {}: {DOWN}", bus.interface));
                }
                clock::sleep_until(look);
                0
            }
            Err(error) => return Err(error).with_context(|| bus.interface.to_string()),
        };
        if count > 0 && take(&mut down) {
            mrroc::streams::warn(format_args!("mrroc: {}: frames arrive again", bus.interface));
            decoder.begin(clock::now());
        }
        if health.has_lost(bus) {
            // The position of the loss among the received frames is not known.
            decoder.begin(clock::now());
        }
        for Received { frame, at } in &received[..count] {
            let described = decoder.describe(frame, *at);
            if left == 0 || !options.wants(described.kind) {
                continue;
            }
            left -= 1;
            let name = described.node.map(|node| format!("{}: ", bus.name_of(node)));
            let at_s = at.since(began).as_secs_f64();
            let line = MonitorLine { at_s, interface: None, frame: frame.to_string(), described };
            line.write(&mut out, name, options.json)?;
        }
        if let Some(news) = health.news(bus) {
            mrroc::streams::warn(format_args!("mrroc: {}: {news}", bus.interface));
        }
        out.flush()?;
    }
    Ok(())
}

/// Last reported state of the CAN controller, and last reported number of lost frames.
#[derive(Default)]
struct Health {
    state: ControllerState,
    dropped: u64,
}

impl Health {
    /// Whether frames were lost since the last report.
    fn has_lost(&self, bus: &Bus) -> bool {
        bus.port.counters().dropped > self.dropped
    }

    fn news(&mut self, bus: &Bus) -> Option<String> {
        let (state, dropped) = (bus.port.state(), bus.port.counters().dropped);
        let lost = dropped - self.dropped;
        let changed = state != self.state;
        *self = Self { state, dropped };
        if lost > 0 {
            return Some(loss(&bus.interface, lost));
        }
        changed.then(|| format!("the controller is {}", silence::state_text(state)))
    }
}

/// Text about lost frames. An unreadable line of an slcan adapter may or may not have been a frame.
fn loss(interface: &Interface, count: u64) -> String {
    match interface {
        Interface::SocketCan(_) | Interface::Epos { .. } => {
            format!("{} lost, this host did not keep up", counted(count, "frame"))
        }
        Interface::Slcan { .. } => format!("{} lost or unreadable", counted(count, "frame")),
    }
}

/// A frame with the time since the start of the monitor, or since the first frame of a log, s.
#[derive(Serialize)]
struct MonitorLine {
    at_s: f64,
    /// The interface of a frame of a log.
    #[serde(skip_serializing_if = "Option::is_none")]
    interface: Option<String>,
    frame: String,
    #[serde(flatten)]
    described: Described,
}

impl MonitorLine {
    /// Writes the line as JSON, or as text with the name of the node.
    fn write(&self, out: &mut impl Write, name: Option<String>, json: bool) -> anyhow::Result<()> {
        if json {
            writeln!(out, "{}", serde_json::to_string(self)?)?;
            return Ok(());
        }
        let interface = self.interface.as_ref().map(|interface| format!("{interface:<6}  ")).unwrap_or_default();
        let (frame, text) = (&self.frame, mrroc::streams::plain(&self.described.text));
        writeln!(out, "{:12.6}  {interface}{frame:<20}  {}{text}", self.at_s, name.unwrap_or_default())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_is_blamed_on_this_host_only_where_nothing_else_can_be() {
        let table = [
            ("can0", "3 frames lost, this host did not keep up"),
            ("slcan:/dev/ttyACM0", "3 frames lost or unreadable"),
        ];
        for (interface, text) in table {
            assert_eq!(loss(&Interface::parse(interface), 3), text);
        }
    }
}
