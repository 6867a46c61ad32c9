//! Bus times in the report of a run, compared with the frames that another listener recorded.

use ::mrroc::cell::Cell;
use can::{Instant, Received};
use canopen::pdo::PdoNumber;
use canopen::{NodeId, cob};
use serde_json::Value;

/// Times between SYNCs from the second on and, for each axis, from SYNC to the answer, in ascending order, µs. They are
/// computed from `frames`, a complete recording. The answers to the last SYNC are left out. The first SYNC is that of
/// bring-up.
pub fn times(cell: &Cell, frames: &[Received]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let is = |received: &Received, id| received.frame.standard_data_id() == Some(id);
    let cycles: Vec<&[Received]> = frames.split_inclusive(|received| is(received, cob::SYNC)).skip(1).collect();
    let micros = |from: Instant, to: Instant| to.since(from).as_nanos() as f64 / 1e3;
    let syncs = frames.iter().filter(|received| is(received, cob::SYNC));
    let syncs: Vec<_> = syncs.map(|received| received.at).collect();
    let mut apart: Vec<_> = syncs.windows(2).skip(1).map(|two| micros(two[0], two[1])).collect();
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
pub fn check(what: &str, report: &Value, times: &[f64], tolerance: f64) {
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
pub fn agrees(wire: &Value, cell: &Cell, frames: &[Received]) {
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
        let unanswered = apart.len() + 1 - after.len();
        assert_eq!(node["unanswered"], unanswered, "{node}");
    }
}
