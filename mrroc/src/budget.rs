//! Bus budget: whether each bus and each line of a cell can carry its traffic within the period.

use std::time::Duration;

use anyhow::anyhow;
use can::schedule::{self, Every, Message, Sender};
use can::{StandardId, timing::Bitrate};
use canopen::cob::Function;
use drive::bus::{Traffic, traffic};
use drive::cia402::AxisConfig;
use drive::wrench::WrenchNodeConfig;
use serde::Serialize;
use serial::ati;

use crate::bench::{emulation, traffic::further};
use crate::cell::{CellFile, Device, ForceSensor, Path, Protocol, Ultrasonic};
use crate::setup;
use can::counted;

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
    /// Absent for a CAN bus and for a sensor.
    pub serial: Option<Bundle>,
    /// The line of a sensor; absent for a bus and for a bundle of lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorBudget>,
    /// Time, ms, after which frames that an adapter holds neither enable nor move a drive; absent without drives on CAN.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stale_after_ms: Option<u64>,
}

/// The line of a force sensor, of an ultrasonic matrix, or of a device of another crate.
#[derive(Debug, Serialize)]
pub struct SensorBudget {
    /// Kind of the sensor.
    pub what: &'static str,
    /// Name of the robot.
    pub robot: String,
    /// The tty.
    pub line: String,
    /// Baud rate, bit/s.
    pub baud: u32,
    /// Kind of a device of another crate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<&'static str>,
    /// Greatest rate of a device of another crate, samples per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_per_s: Option<f64>,
    /// Duration of a scan of an ultrasonic matrix, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scan_ms: Option<f64>,
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
    pub bytes: u16,
    /// Time between two such messages, µs.
    pub period_us: u128,
    /// Latest end of its last bit, from the start of the cycle, µs; absent for a message that may take longer than a
    /// cycle.
    pub response_us: Option<u128>,
}

/// Computes the budget of every bus, and refuses a cell that exceeds it.
pub fn check(file: &CellFile) -> anyhow::Result<Vec<BusBudget>> {
    let buses = (0..file.cell.bus.len()).map(|bus| check_bus(file, bus, &file.cell.sensor_configs(bus)));
    let lines = (0..file.cell.serial.len()).map(|bundle| check_lines(file, bundle));
    let sensors = file.cell.serial_sensors().map(|sensor| &file.cell.force_sensor[sensor]);
    let sensors = sensors.map(|sensor| Ok(of_sensor(file.cell.period(), sensor)));
    let matrices = file.cell.ultrasonic.iter().map(|matrix| Ok(of_matrix(file.cell.period(), matrix)));
    let devices = file.cell.device.iter().map(|device| Ok(of_device(file.cell.period(), device)));
    buses.chain(lines).chain(sensors).chain(matrices).chain(devices).collect()
}

/// Longest time from the queueing of an event-driven message to its last bit on bus `index`, with the frames of further
/// emulated nodes. Refuses a bus beyond its budget.
pub(crate) fn longest_response(file: &CellFile, index: usize, id: StandardId) -> anyhow::Result<Duration> {
    let sensors = file.cell.sensor_configs(index);
    check_bus(file, index, &sensors)?;
    let (bitrate, period) = (emulation::bitrate(file, index), file.cell.period());
    let axes = setup::axis_configs(file, index);
    let io = file.cell.io_configs(index);
    let mut messages = messages(&traffic(&file.cell.group_config(index), &axes, &io, &sensors), period);
    messages.extend(further(bitrate, file.cell.bus[index].emulated_load));
    let analysis = schedule::analyse(bitrate, period, &messages);
    let found = messages.iter().zip(&analysis.responses).find(|(message, _)| message.id == id);
    found.map(|(_, response)| *response).ok_or_else(|| anyhow!("the bus has no message {:#05x}", id.raw()))
}

fn check_bus(file: &CellFile, index: usize, sensors: &[WrenchNodeConfig]) -> anyhow::Result<BusBudget> {
    let bus = &file.cell.bus[index];
    let period = file.cell.period();
    let bitrate = emulation::bitrate(file, index);
    let axes = setup::axis_configs(file, index);
    let io = file.cell.io_configs(index);
    let mut traffic = traffic(&file.cell.group_config(index), &axes, &io, sensors);
    // Messages outside the cycle are sent after the cyclic ones. Outputs follow the heartbeat of the host.
    traffic.sort_by_key(|traffic| !traffic.cyclic);
    let messages = messages(&traffic, period);
    let analysis = schedule::analyse(bitrate, period, &messages);
    let percent = |time: Duration| 100.0 * time.as_secs_f64() / period.as_secs_f64();
    let timed = messages.iter().zip(&analysis.responses);
    let rows = traffic.iter().zip(timed).map(|(traffic, (message, response))| MessageBudget {
        what: traffic.what,
        cob_id: Some(traffic.cob_id.raw()),
        bytes: traffic.bytes.into(),
        period_us: traffic.period.as_micros(),
        response_us: message.every.has_deadline().then_some(response.as_micros()),
    });
    let budget = BusBudget {
        name: bus.name.clone(),
        load_percent: 100.0 * analysis.load,
        worst_case_percent: percent(analysis.busy),
        messages: rows.collect(),
        bits_per_second: 1e3 * f64::from(bus.bitrate_kbps),
        serial: None,
        sensor: None,
        stale_after_ms: (!axes.is_empty()).then(|| file.cell.group_config(index).host_lost_after().as_millis() as u64),
    };
    let (key, nodes) = (Path::to("bus").then(index), nodes(axes.len(), io.len(), sensors.len()));
    if analysis.busy > period {
        let problem = anyhow!(
            "bus {:?} with {nodes} is busy for {} µs of each {} µs at the worst ({:.0} %, at most 100 %); {}",
            bus.name,
            analysis.busy.as_micros(),
            period.as_micros(),
            percent(analysis.busy),
            what_fits(bitrate, period, &messages, &axes),
        );
        return Err(file.refuse(&key, problem));
    }
    if analysis.load > 1.0 {
        let problem = anyhow!(
            "bus {:?} with {nodes} has a long-term load of up to {:.0} %, at most 100 %: raise its bitrate_kbps or the \
             inhibit_us of its I/O nodes, or use more buses",
            bus.name,
            budget.load_percent,
        );
        return Err(file.refuse(&key, problem));
    }
    Ok(budget)
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
        bytes: bytes as u16,
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
        sensor: None,
        stale_after_ms: None,
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

/// The line of a force sensor carries one query and one answer per period. A parsed cell has time for both.
fn of_sensor(period: Duration, sensor: &ForceSensor) -> BusBudget {
    let settings = sensor.settings();
    let [asked, answered] = [ati::REQUEST, ati::REQUEST + ati::REPLY].map(|bytes| settings.line_time(bytes));
    let share = |time: Duration| 100.0 * time.as_secs_f64() / period.as_secs_f64();
    let message = |what, bytes: usize, response: Duration| MessageBudget {
        what,
        cob_id: None,
        bytes: bytes as u16,
        period_us: period.as_micros(),
        response_us: Some(response.as_micros()),
    };
    BusBudget {
        name: sensor.name.clone(),
        load_percent: share(settings.line_time(ati::REPLY)),
        worst_case_percent: share(answered),
        messages: vec![message("query", ati::REQUEST, asked), message("answer", ati::REPLY, answered)],
        bits_per_second: f64::from(settings.baud),
        serial: None,
        sensor: Some(SensorBudget {
            what: "force sensor",
            robot: sensor.robot.clone(),
            line: sensor.tty().to_owned(),
            baud: settings.baud,
            kind: None,
            samples_per_s: None,
            scan_ms: None,
        }),
        stale_after_ms: None,
    }
}

/// The line of an ultrasonic matrix carries one query and one reply per row, or per pair of elements. Both may take
/// longer than a period.
fn of_matrix(period: Duration, matrix: &Ultrasonic) -> BusBudget {
    let config = matrix.config(period);
    let query = config.query(0);
    let (request, reply) = (query.encode().1, query.reply_length(matrix.size));
    let exchange = config.scan_time() / config.queries() as u32;
    let message = |what, bytes: usize| MessageBudget {
        what,
        cob_id: None,
        bytes: bytes as u16,
        period_us: exchange.as_micros(),
        response_us: None,
    };
    let share = 100.0 * config.settings.line_time(reply).as_secs_f64() / exchange.as_secs_f64();
    BusBudget {
        name: matrix.name.clone(),
        load_percent: share,
        worst_case_percent: share,
        messages: vec![message("query", request), message("reply", reply)],
        bits_per_second: f64::from(matrix.baud),
        serial: None,
        sensor: Some(SensorBudget {
            what: "ultrasonic matrix",
            robot: matrix.robot.clone(),
            line: matrix.line.clone(),
            baud: matrix.baud,
            kind: None,
            samples_per_s: None,
            scan_ms: Some(config.scan_time().as_secs_f64() * 1e3),
        }),
        stale_after_ms: None,
    }
}

/// The line of a device of another crate carries one query and one answer per sample, or one answer.
fn of_device(period: Duration, device: &Device) -> BusBudget {
    let line = device.own.line();
    let each = line.least_sample_time(period);
    let message = |what, bytes: usize| MessageBudget {
        what,
        cob_id: None,
        bytes: bytes.try_into().unwrap_or(u16::MAX),
        period_us: each.as_micros(),
        response_us: None,
    };
    let share = 100.0 * line.settings.line_time(line.answer).as_secs_f64() / each.as_secs_f64();
    let query = (!line.is_streamed()).then(|| message("query", line.query));
    BusBudget {
        name: device.keys.name.clone(),
        load_percent: share,
        worst_case_percent: share,
        messages: query.into_iter().chain([message("answer", line.answer)]).collect(),
        bits_per_second: f64::from(line.settings.baud),
        serial: None,
        sensor: Some(SensorBudget {
            what: "device",
            robot: device.keys.robot.clone().unwrap_or_else(|| "the cell".to_owned()),
            line: device.keys.line.clone(),
            baud: line.settings.baud,
            kind: Some(device.own.kind()),
            samples_per_s: Some(1.0 / each.as_secs_f64()),
            scan_ms: None,
        }),
        stale_after_ms: None,
    }
}

/// The messages of a bus in the order of the senders' queues.
///
/// Service frames are not urgent and occur only during a change of mode. They count as blocking, but not in the load.
/// The inputs and outputs of I/O nodes may end in the next cycle, and count as often as they can occur.
fn messages(traffic: &[Traffic], period: Duration) -> Vec<Message> {
    let message = |traffic: &Traffic| Message {
        id: traffic.cob_id,
        bytes: traffic.bytes,
        sender: traffic.sender,
        every: match (is_service(traffic.cob_id), traffic.cyclic) {
            (true, _) => Every::Interval(Duration::from_secs(1)),
            (false, true) => match traffic.period.div_duration_f64(period).round() as u32 {
                0 | 1 => Every::Cycle,
                cycles => Every::Cycles(cycles),
            },
            (false, false) => Every::Interval(traffic.period),
        },
    };
    traffic.iter().map(message).collect()
}

/// Whether a frame belongs to the SDO service, which drives use for changes of mode during operation.
fn is_service(id: StandardId) -> bool {
    matches!(Function::of(id), Some(Function::SdoRequest(_) | Function::SdoResponse(_)))
}

/// The nodes of a bus in words: its axes, then its I/O nodes and force sensors if it has any.
fn nodes(axes: usize, io: usize, sensors: usize) -> String {
    let count = |count: usize, one: &str, many: &str| match count {
        0 => None,
        1 => Some(one.to_owned()),
        _ => Some(format!("{count} {many}")),
    };
    let beside = [count(io, "an I/O node", "I/O nodes"), count(sensors, "a force sensor", "force sensors")];
    let axes = (axes > 0 || beside.iter().all(Option::is_none)).then(|| counted(axes, "axis"));
    [axes].into_iter().chain(beside).flatten().collect::<Vec<_>>().join(" and ")
}

/// The node that sends a message, or the node to which the host sends the message.
fn node_of(message: &Message) -> Option<u8> {
    match (message.sender, Function::of(message.id)) {
        (Sender::Node(node), _) => Some(node),
        (Sender::Host, Some(Function::Rpdo(_, node) | Function::SdoRequest(node))) => Some(node.raw()),
        (Sender::Host, _) => None,
    }
}

/// Proposals for a cell that fits: fewer axes, or a longer period.
fn what_fits(bitrate: Bitrate, period: Duration, messages: &[Message], axes: &[AxisConfig]) -> String {
    let fits = |messages: &[Message], period| schedule::analyse(bitrate, period, messages).busy <= period;
    let nodes: Vec<u8> = axes.iter().map(|axis| axis.node.raw()).collect();
    let without = |count: usize| -> Vec<Message> {
        let gone = &nodes[count..];
        let kept = |message: &&Message| node_of(message).is_none_or(|node| !gone.contains(&node));
        messages.iter().filter(kept).copied().collect()
    };
    let most = (1..axes.len()).rev().find(|&count| fits(&without(count), period));
    let axes = most.map(|most| counted(most, "axis") + " would fit");
    let shortest = (1..=1000).map(Duration::from_millis).find(|&period| fits(messages, period));
    let period = shortest.map(|period| format!("a period of {} ms", period.as_millis()));
    let proposals: Vec<_> = axes.into_iter().chain(period).chain(["more buses".to_owned()]).collect();
    proposals.join(", or ")
}

#[cfg(test)]
mod tests;
