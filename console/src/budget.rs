//! Whether each bus of a cell can carry its traffic within the period.

use std::time::Duration;

use anyhow::anyhow;
use can::StandardId;
use can::schedule::{self, Every, Message, Sender};
use can::timing::Bitrate;
use controller::cell::{Path, Protocol};
use drive::cia402::{Cia402Group, Traffic};
use serde::Serialize;

use crate::cell_file::CellFile;
use crate::setup;

/// What one bus has to carry.
#[derive(Debug, Serialize)]
pub(crate) struct BusBudget {
    pub(crate) name: String,
    /// Share of the bus's time that its frames need in the long run, with as many stuff bits as can be, percent.
    pub(crate) load_percent: f64,
    /// Share of the period after which the last frame of a cycle has left at the latest, percent.
    pub(crate) worst_case_percent: f64,
    pub(crate) messages: Vec<MessageBudget>,
    /// The bit rate, of all lines of a bundle together.
    pub(crate) bits_per_second: f64,
    /// Absent for a CAN bus.
    pub(crate) serial: Option<Bundle>,
}

/// A bundle of serial lines. Each carries the messages of one axis; loads and times are of one line.
#[derive(Debug, Serialize)]
pub(crate) struct Bundle {
    pub(crate) protocol: Protocol,
    pub(crate) baud: u32,
    pub(crate) lines: Vec<Line>,
}

/// The line of one axis.
#[derive(Debug, Serialize)]
pub(crate) struct Line {
    pub(crate) axis: String,
    /// The tty.
    pub(crate) line: String,
    /// Where the protocol has addresses.
    pub(crate) address: Option<u8>,
}

/// One message of a bus.
#[derive(Debug, Serialize)]
pub(crate) struct MessageBudget {
    pub(crate) what: &'static str,
    /// COB-ID; absent for a telegram of a serial line.
    pub(crate) cob_id: Option<u16>,
    pub(crate) bytes: u8,
    pub(crate) period_us: u128,
    /// From the start of the cycle to its last bit at the latest, µs; absent for what may take longer than a cycle.
    pub(crate) response_us: Option<u128>,
}

/// Computes the budget of every bus and refuses a cell that does not fit.
pub(crate) fn check(file: &CellFile) -> anyhow::Result<Vec<BusBudget>> {
    let buses = (0..file.cell.bus.len()).map(|bus| check_bus(file, bus));
    let lines = (0..file.cell.serial.len()).map(|bundle| check_lines(file, bundle));
    buses.chain(lines).collect()
}

fn check_bus(file: &CellFile, index: usize) -> anyhow::Result<BusBudget> {
    let bus = &file.cell.bus[index];
    let period = file.cell.period();
    let bitrate =
        Bitrate::from_kbps(bus.bitrate_kbps).expect("a parsed cell has possible bit rates");
    let configs = (
        file.cell.group_config(index),
        setup::axis_configs(file, index),
    );
    let mut traffic = Cia402Group::<Box<dyn can::Port>>::traffic(&configs.0, &configs.1);
    // What is not of the cycle leaves behind it.
    traffic.sort_by_key(|traffic| traffic.period > period || is_service(traffic.cob_id));
    let messages = messages(&traffic, period, bus.host_node);
    let analysis = schedule::analyse(bitrate, period, &messages);
    let share = |time: Duration| 100.0 * time.as_secs_f64() / period.as_secs_f64();
    let budget = BusBudget {
        name: bus.name.clone(),
        load_percent: 100.0 * analysis.load,
        worst_case_percent: share(analysis.busy),
        messages: traffic
            .iter()
            .zip(messages.iter().zip(&analysis.responses))
            .map(|(traffic, (message, response))| MessageBudget {
                what: traffic.what,
                cob_id: Some(traffic.cob_id.raw()),
                bytes: traffic.bytes,
                period_us: traffic.period.as_micros(),
                response_us: (message.every == Every::Cycle).then_some(response.as_micros()),
            })
            .collect(),
        bits_per_second: 1e3 * f64::from(bus.bitrate_kbps),
        serial: None,
    };
    if analysis.busy <= period {
        return Ok(budget);
    }
    let axes = file.cell.axes_on(index).count();
    let key = Path::default().then("bus").then(index);
    Err(file.refuse(&key, anyhow!(
        "{axes} axes keep bus {:?} busy for {} µs of each {} µs at the worst ({:.0} %, at most 100 %); {}",
        bus.name, analysis.busy.as_micros(), period.as_micros(), share(analysis.busy),
        what_fits(bitrate, period, &messages, axes),
    )))
}

/// Each line carries one telegram each way per period; the answer leaves once the request has come.
fn check_lines(file: &CellFile, index: usize) -> anyhow::Result<BusBudget> {
    let bundle = &file.cell.serial[index];
    let period = file.cell.period();
    let settings = bundle.settings();
    let (request, answer) = bundle.telegrams();
    let (asked, answered) = (
        settings.line_time(request),
        settings.line_time(request + answer),
    );
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
        Some(Line {
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
        messages: vec![
            message("request", request, asked),
            message("answer", answer, answered),
        ],
        bits_per_second: f64::from(bundle.baud) * lines.len() as f64,
        serial: Some(Bundle {
            protocol: bundle.protocol,
            baud: bundle.baud,
            lines,
        }),
    };
    if answered <= period {
        return Ok(budget);
    }
    let key = Path::default().then("serial").then(index).then("baud");
    Err(file.refuse(&key, anyhow!(
        "a request of {request} and an answer of {answer} bytes take {} µs of each {} µs ({:.0} %, at most 100 %)",
        answered.as_micros(), period.as_micros(), share(answered),
    )))
}

/// The messages of a bus in the order of the senders' queues.
///
/// Service frames are not urgent and flow only while a mode changes: they block, but what they load is left out.
fn messages(traffic: &[Traffic], period: Duration, host: u8) -> Vec<Message> {
    let message = |traffic: &Traffic| {
        let id = traffic.cob_id.raw();
        let node = (id & 0x7F) as u8;
        // TPDOs, heartbeats and SDO answers come from the node their identifier names.
        let from_node = matches!(id & 0x780, 0x180 | 0x280 | 0x580 | 0x700) && node != host;
        let service = is_service(traffic.cob_id);
        Message {
            id: traffic.cob_id,
            bytes: traffic.bytes,
            sender: if from_node {
                Sender::Node(node)
            } else {
                Sender::Host
            },
            every: match (service, traffic.period == period) {
                (false, true) => Every::Cycle,
                (true, _) => Every::Interval(Duration::from_secs(1)),
                (false, false) => Every::Interval(traffic.period),
            },
        }
    };
    traffic.iter().map(message).collect()
}

/// Whether a frame is of the SDO service, which the drives' mode changes use during operation.
fn is_service(id: StandardId) -> bool {
    matches!(id.raw() & 0x780, 0x580 | 0x600)
}

/// What would fit instead: fewer axes, or a longer period.
fn what_fits(bitrate: Bitrate, period: Duration, messages: &[Message], axes: usize) -> String {
    let fits =
        |messages: &[Message], period| schedule::analyse(bitrate, period, messages).busy <= period;
    let nodes: Vec<u8> = messages
        .iter()
        .filter_map(|message| match message.sender {
            // Each has one answer, and at a long period more that come once a cycle.
            Sender::Node(node) if message.id.raw() & 0x780 == 0x180 => Some(node),
            _ => None,
        })
        .collect();
    let without = |count: usize| -> Vec<Message> {
        let gone = &nodes[count..];
        let kept = |message: &&Message| {
            message.id == SYNC || !gone.contains(&((message.id.raw() & 0x7F) as u8))
        };
        messages.iter().filter(kept).copied().collect()
    };
    let most = (0..axes)
        .rev()
        .find(|&count| fits(&without(count), period))
        .unwrap_or(0);
    let shortest = (1..=1000)
        .map(Duration::from_millis)
        .find(|&period| fits(messages, period));
    let period = shortest.map_or(String::new(), |period| {
        format!(", or a period of {} ms", period.as_millis())
    });
    format!("{most} axes would fit{period}, or more buses")
}

const SYNC: StandardId = StandardId::new(0x080).expect("an 11-bit identifier");
