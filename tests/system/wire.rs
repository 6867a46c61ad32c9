//! Bus times in the report of a run, compared with the lengths of frames on a virtual bus and with another listener.

use ::mrroc::cell::Cell;
use can::timing::bits_on_wire;
use can::{Instant, Received};
use canopen::pdo::PdoNumber;
use canopen::{NodeId, cob};
use serde_json::Value;

use crate::mrroc::{Directory, example, mrroc, text, trace};

/// Times between SYNCs and, for each axis, from SYNC to the answer, in ascending order, µs. They are computed from
/// `frames`, a complete recording. The answers to the last SYNC are left out.
fn times(cell: &Cell, frames: &[Received]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let is = |received: &Received, id| received.frame.standard_data_id() == Some(id);
    let cycles: Vec<&[Received]> = frames.split_inclusive(|received| is(received, cob::SYNC)).skip(1).collect();
    let micros = |from: Instant, to: Instant| to.since(from).as_nanos() as f64 / 1e3;
    let syncs = frames.iter().filter(|received| is(received, cob::SYNC));
    let syncs: Vec<_> = syncs.map(|received| received.at).collect();
    let mut apart: Vec<_> = syncs.windows(2).map(|two| micros(two[0], two[1])).collect();
    apart.sort_by(f64::total_cmp);
    let answers = cell.robot[0].axis.iter().map(|axis| {
        let id = cob::tpdo(PdoNumber::One, NodeId::new(axis.node).unwrap());
        let judged = syncs.iter().zip(&cycles).take(syncs.len() - 1);
        let mut after = Vec::new();
        // The previous SYNC, if no answer came before the next SYNC.
        let mut owed = None;
        for (&sync, cycle) in judged {
            let came = cycle.iter().filter(|received| is(received, id));
            let came: Vec<_> = came.map(|received| received.at).collect();
            match (&came[..], owed.take()) {
                ([], _) => owed = Some(sync),
                ([late, own, ..], Some(owed)) => {
                    after.extend([micros(owed, *late), micros(sync, *own)]);
                }
                ([own, ..], _) => after.push(micros(sync, *own)),
            }
        }
        after.sort_by(f64::total_cmp);
        after
    });
    (apart, answers.collect())
}

/// Asserts that the figures of a report match `times` within `tolerance`, µs.
fn check(what: &str, report: &Value, times: &[f64], tolerance: f64) {
    assert!(times.len() > 100, "{what}: {} times", times.len());
    for (key, share) in [("p50", 0.5), ("p99", 0.99), ("p999", 0.999), ("max", 1.0)] {
        // The smallest time that the given share of the times does not exceed.
        let rank = (share * times.len() as f64).ceil() as usize;
        let expected = times[rank.clamp(1, times.len()) - 1];
        let said = report[key].as_f64().unwrap();
        // All values except the maximum are rounded to four digits. On a busy host, some time can pass between the two
        // stamps of one frame. The maximum shows this time.
        let digits = if key == "max" { expected * 1e-2 } else { expected * 1.3e-4 };
        assert!(
            (said - expected).abs() <= tolerance + digits,
            "{what}, {key}: {expected} µs, and the run said {said}: {report}"
        );
    }
}

/// Asserts that the figures of the run equal the figures of `frames`, which another listener recorded with a resolution
/// of a microsecond.
pub(crate) fn agrees(wire: &Value, cell: &Cell, frames: &[Received]) {
    let bus = &wire[0];
    assert_eq!(bus["source"], "kernel", "{wire}");
    assert_eq!(bus["sync_stamp"], "handed-over", "{wire}");
    assert_eq!(bus["lost_frames"], 0, "{wire}");
    let (apart, answers) = times(cell, frames);
    check("SYNC to SYNC", &bus["sync_to_sync_us"], &apart, 1.0);
    let nodes = bus["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), answers.len());
    for ((axis, node), after) in cell.robot[0].axis.iter().zip(nodes).zip(&answers) {
        assert_eq!(node["node"], axis.node);
        check(&axis.name, &node["sync_to_tpdo_us"], after, 1.0);
        let unanswered = apart.len() - after.len();
        assert_eq!(node["unanswered"], unanswered, "{node}");
    }
}

#[test]
fn answers_on_the_virtual_bus_take_what_their_bits_take() {
    let directory = Directory::new();
    let log = directory.path("trace.log");
    let run = mrroc([
        "run".as_ref(),
        example("irb6").as_os_str(),
        "--bench=lockstep".as_ref(),
        "--json".as_ref(),
        "--trace".as_ref(),
        log.as_os_str(),
    ]);
    let wire = &run.json()["wire"][0];
    assert_eq!(wire["source"], "virtual");
    assert_eq!(wire["lost_frames"], 0);
    for key in ["p50", "max"] {
        assert_eq!(wire["sync_to_sync_us"][key], 2000.0, "{wire}");
        assert_eq!(wire["sync_off_period_us"][key], 0.0, "{wire}");
    }

    // Every drive answers at the last bit of SYNC. The answers therefore follow each other at once, in ascending order
    // of their identifiers, with one microsecond per bit.
    let cell = Cell::parse(&text("irb6")).unwrap();
    let trace = trace(&log);
    let is = |frame: &can::Frame, id| frame.standard_data_id() == Some(id);
    let syncs = trace.split(|entry| is(&entry.frame, cob::SYNC)).skip(1);
    let cycles: Vec<_> = syncs.collect();
    let mut nodes: Vec<u8> = cell.robot[0].axis.iter().map(|axis| axis.node).collect();
    nodes.sort_unstable();
    for (axis, node) in cell.robot[0].axis.iter().zip(wire["nodes"].as_array().unwrap()) {
        let before = nodes.iter().filter(|&&node| node <= axis.node);
        let ids: Vec<_> = before.map(|&node| cob::tpdo(PdoNumber::One, NodeId::new(node).unwrap())).collect();
        let judged = &cycles[..cycles.len() - 1];
        let mut after: Vec<f64> = judged
            .iter()
            .map(|cycle| {
                let answers = cycle.iter().filter(|entry| ids.iter().any(|&id| is(&entry.frame, id)));
                answers.map(|entry| f64::from(bits_on_wire(&entry.frame))).sum()
            })
            .collect();
        after.sort_by(f64::total_cmp);
        check(&axis.name, &node["sync_to_tpdo_us"], &after, 0.0);
        assert_eq!(node["unanswered"], 0, "{node}");
        assert_eq!(node["late"], 0, "{node}");
        assert_eq!(node["surplus"], 0, "{node}");
    }
}

#[test]
fn serial_lines_report_telegrams_and_no_times_on_the_wire() {
    let example = example("irb6-serial");
    let run = mrroc(["run".as_ref(), example.as_os_str(), "--bench=lockstep".as_ref()]);
    for line in ["telegrams on 5 lines, load", "bus arm: times on the wire not measured"] {
        assert!(run.stdout.contains(line), "{line}: {}", run.stdout);
    }
    assert!(!run.stdout.contains("SYNC to"), "{}", run.stdout);
}
