//! Bus times in the report of a run, compared with the lengths of frames on a virtual bus and with another listener.

use ::mrroc::cell::Cell;
use can::timing::bits_on_wire;
use canopen::pdo::PdoNumber;
use canopen::{NodeId, cob};
use kit::mrroc::{Directory, example, mrroc, text, trace};
use kit::wire::check;

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
