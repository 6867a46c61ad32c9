//! Bus budget: whether each bus of a cell can carry its traffic within the period.

use std::time::Duration;

use anyhow::anyhow;
use can::schedule::{self, Every, Message, Sender};
use can::{StandardId, timing::Bitrate};
use canopen::cob;
use drive::bus::{Traffic, traffic};
use drive::cia401::IoConfig;
use drive::cia402::AxisConfig;
use serde::Serialize;

use crate::cell::{CellFile, Path, Protocol};
use crate::{bench::emulation, setup};

/// Budget of one bus.
#[derive(Debug, Serialize)]
pub struct BusBudget {
    /// Name of the bus or bundle.
    pub name: String,
    /// Long-term load of the bus with the greatest number of stuff bits, percent.
    pub load_percent: f64,
    /// Latest end of the last frame of a cycle, percent of the period.
    pub worst_case_percent: f64,
    /// All messages of the bus.
    pub messages: Vec<MessageBudget>,
    /// The bit rate; for a bundle, the sum of all lines.
    pub bits_per_second: f64,
    /// Absent for a CAN bus.
    pub serial: Option<Bundle>,
}

/// A bundle of serial lines. Each line carries the messages of one axis. Loads and times apply to one line.
#[derive(Debug, Serialize)]
pub struct Bundle {
    /// Protocol of the axis controllers.
    pub protocol: Protocol,
    /// Baud rate of each line, bit/s.
    pub baud: u32,
    /// The lines of the bundle.
    pub lines: Vec<LineBudget>,
}

/// The line of one axis.
#[derive(Debug, Serialize)]
pub struct LineBudget {
    /// Name of the axis.
    pub axis: String,
    /// The tty.
    pub line: String,
    /// Address of the axis controller, where the protocol has addresses.
    pub address: Option<u8>,
}

/// One message of a bus.
#[derive(Debug, Serialize)]
pub struct MessageBudget {
    /// Content of the message.
    pub what: &'static str,
    /// COB-ID; absent for a telegram of a serial line.
    pub cob_id: Option<u16>,
    /// Length of the data, bytes.
    pub bytes: u8,
    /// Time between two such messages, µs.
    pub period_us: u128,
    /// Latest end of its last bit, from the start of the cycle, µs; absent for a message that may take longer than a
    /// cycle.
    pub response_us: Option<u128>,
}

/// Computes the budget of every bus, and refuses a cell that exceeds it.
pub fn check(file: &CellFile) -> anyhow::Result<Vec<BusBudget>> {
    let buses = (0..file.cell.bus.len()).map(|bus| check_bus(file, bus));
    let lines = (0..file.cell.serial.len()).map(|bundle| check_lines(file, bundle));
    buses.chain(lines).collect()
}

fn check_bus(file: &CellFile, index: usize) -> anyhow::Result<BusBudget> {
    let bus = &file.cell.bus[index];
    let period = file.cell.period();
    let bitrate = emulation::bitrate(file, index);
    let axes = setup::axis_configs(file, index);
    let io = file.cell.io_configs(index);
    let mut traffic = traffic(&file.cell.group_config(index), &axes, &io);
    // Messages outside the cycle are sent after the cyclic ones. Outputs follow the heartbeat of the host.
    traffic
        .sort_by_key(|traffic| traffic.period > period || is_service(traffic.cob_id) || is_of_io(traffic.cob_id, &io));
    let messages = messages(&traffic, period, bus.host_node, &io);
    let analysis = schedule::analyse(bitrate, period, &messages);
    let share = |time: Duration| 100.0 * time.as_secs_f64() / period.as_secs_f64();
    let timed = messages.iter().zip(&analysis.responses);
    let rows = traffic.iter().zip(timed).map(|(traffic, (message, response))| MessageBudget {
        what: traffic.what,
        cob_id: Some(traffic.cob_id.raw()),
        bytes: traffic.bytes,
        period_us: traffic.period.as_micros(),
        response_us: (message.every == Every::Cycle).then_some(response.as_micros()),
    });
    let budget = BusBudget {
        name: bus.name.clone(),
        load_percent: 100.0 * analysis.load,
        worst_case_percent: share(analysis.busy),
        messages: rows.collect(),
        bits_per_second: 1e3 * f64::from(bus.bitrate_kbps),
        serial: None,
    };
    if analysis.busy <= period {
        return Ok(budget);
    }
    let key = Path::to("bus").then(index);
    Err(file.refuse(
        &key,
        anyhow!(
            "{} axes{} keep bus {:?} busy for {} µs of each {} µs at the worst ({:.0} %, at most 100 %); {}",
            axes.len(),
            and_io_nodes(io.len()),
            bus.name,
            analysis.busy.as_micros(),
            period.as_micros(),
            share(analysis.busy),
            what_fits(bitrate, period, &messages, &axes),
        ),
    ))
}

/// Each line carries one telegram in each direction per period. The answer starts after the request has arrived.
fn check_lines(file: &CellFile, index: usize) -> anyhow::Result<BusBudget> {
    let bundle = &file.cell.serial[index];
    let period = file.cell.period();
    let settings = bundle.settings();
    let (request, answer) = bundle.protocol.telegrams();
    let [asked, answered] = [request, request + answer].map(|bytes| settings.line_time(bytes));
    let share = |time: Duration| 100.0 * time.as_secs_f64() / period.as_secs_f64();
    let message = |what, bytes: usize, response: Duration| MessageBudget {
        what,
        cob_id: None,
        bytes: bytes as u8,
        period_us: period.as_micros(),
        response_us: Some(response.as_micros()),
    };
    let axes = file.cell.axes_on(file.cell.bus.len() + index);
    let line = |(robot, axis): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[axis];
        Some(LineBudget {
            axis: axis.name.clone(),
            line: axis.controller.as_ref()?.line.clone(),
            address: (bundle.protocol == Protocol::Nfv2).then_some(axis.node),
        })
    };
    let lines: Vec<_> = axes.filter_map(line).collect();
    let budget = BusBudget {
        name: bundle.name.clone(),
        load_percent: share(settings.line_time(request.max(answer))),
        worst_case_percent: share(answered),
        messages: vec![message("request", request, asked), message("answer", answer, answered)],
        bits_per_second: f64::from(bundle.baud) * lines.len() as f64,
        serial: Some(Bundle { protocol: bundle.protocol, baud: bundle.baud, lines }),
    };
    if answered <= period {
        return Ok(budget);
    }
    let key = Path::to("serial").then(index).then("baud");
    Err(file.refuse(
        &key,
        anyhow!(
            "a request of {request} and an answer of {answer} bytes take {} µs of each {} µs ({:.0} %, at most 100 %)",
            answered.as_micros(),
            period.as_micros(),
            share(answered),
        ),
    ))
}

/// The messages of a bus in the order of the senders' queues.
///
/// Service frames are not urgent and occur only during a change of mode. They count as blocking, but not in the load.
/// The inputs and outputs of I/O nodes may end in the next cycle, and count as often as they can occur.
fn messages(traffic: &[Traffic], period: Duration, host: u8, io: &[IoConfig]) -> Vec<Message> {
    let message = |traffic: &Traffic| {
        let id = traffic.cob_id.raw();
        let node = (id & 0x7F) as u8;
        // TPDOs, heartbeats and SDO answers come from the node in their identifier.
        let from_node = matches!(id & 0x780, 0x180 | 0x280 | 0x580 | 0x700) && node != host;
        let service = is_service(traffic.cob_id);
        Message {
            id: traffic.cob_id,
            bytes: traffic.bytes,
            sender: if from_node { Sender::Node(node) } else { Sender::Host },
            every: match (service, traffic.period == period && !is_of_io(traffic.cob_id, io)) {
                (false, true) => Every::Cycle,
                (true, _) => Every::Interval(Duration::from_secs(1)),
                (false, false) => Every::Interval(traffic.period),
            },
        }
    };
    traffic.iter().map(message).collect()
}

/// Whether a frame is of an I/O node.
fn is_of_io(id: StandardId, io: &[IoConfig]) -> bool {
    io.iter().any(|io| u16::from(io.node.raw()) == id.raw() & 0x7F)
}

/// Whether a frame belongs to the SDO service, which drives use for changes of mode during operation.
fn is_service(id: StandardId) -> bool {
    matches!(id.raw() & 0x780, 0x580 | 0x600)
}

fn and_io_nodes(count: usize) -> String {
    match count {
        0 => String::new(),
        1 => " and an I/O node".to_owned(),
        _ => format!(" and {count} I/O nodes"),
    }
}

/// Proposals for a cell that fits: fewer axes, or a longer period.
fn what_fits(bitrate: Bitrate, period: Duration, messages: &[Message], axes: &[AxisConfig]) -> String {
    let fits = |messages: &[Message], period| schedule::analyse(bitrate, period, messages).busy <= period;
    let nodes: Vec<u8> = axes.iter().map(|axis| axis.node.raw()).collect();
    let without = |count: usize| -> Vec<Message> {
        let gone = &nodes[count..];
        let kept = |message: &&Message| message.id == cob::SYNC || !gone.contains(&((message.id.raw() & 0x7F) as u8));
        messages.iter().filter(kept).copied().collect()
    };
    let most = (0..axes.len()).rev().find(|&count| fits(&without(count), period)).unwrap_or(0);
    let shortest = (1..=1000).map(Duration::from_millis).find(|&period| fits(messages, period));
    let period = shortest.map_or(String::new(), |period| format!(", or a period of {} ms", period.as_millis()));
    format!("{most} axes would fit{period}, or more buses")
}
