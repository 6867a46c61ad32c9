//! Budgets of buses with force/torque sensors, and of buses without cyclic frames.

use std::fs;

use can::StandardId;
use canopen::pdo::PdoNumber;
use canopen::{NodeId, Object};
use drive::wrench::{Content, Trigger, WrenchAxis, WrenchConfig, WrenchField, WrenchPdo, ZeroMethod};

use super::*;
use crate::cell::Cell;

const TOUCH: &str = include_str!("../../../cells/irb6-touch.toml");

/// The example cell with its I/O node on a bus of its own, after a change of the cell.
fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    let mut cell = Cell::parse(TOUCH).unwrap();
    let mut bus = cell.bus[0].clone();
    (bus.name, bus.interface) = ("cabinet".into(), "can1".into());
    cell.bus.push(bus);
    cell.io[0].bus = "cabinet".into();
    change(&mut cell);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cell.toml");
    fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    CellFile::read(&path).unwrap()
}

/// Three forces and three torques of 16 bits.
fn sensor(trigger: Trigger, cob_ids: [u16; 2]) -> WrenchNodeConfig {
    let field = |axis| WrenchField { object: Object::new(0x2000, axis as u8 + 1), content: Content::I16(axis) };
    let pdo = |number, cob_id, axes: &[WrenchAxis]| WrenchPdo {
        number,
        cob_id: StandardId::new(cob_id).unwrap(),
        fields: axes.iter().copied().map(field).collect(),
        mapped: true,
    };
    let (forces, torques) = WrenchAxis::ALL.split_at(3);
    WrenchNodeConfig {
        node: NodeId::new(9).unwrap(),
        identity: None,
        device_type: None,
        sensor: WrenchConfig { zero: ZeroMethod::Host { samples: 10 }, ..WrenchConfig::ATI },
        trigger,
        pdos: vec![pdo(PdoNumber::One, cob_ids[0], forces), pdo(PdoNumber::Two, cob_ids[1], torques)],
        configuration: Vec::new(),
    }
}

const SYNC: Trigger = Trigger::Sync { every: 1 };
const COB_IDS: [u16; 2] = [0x189, 0x289];
/// Longest times of frames of 6 bytes and of 1 byte at 1 Mbit/s, and of SYNC, µs.
const FRAME: f64 = 115.0;
const SHORT_FRAME: f64 = 65.0;
const SYNC_FRAME: f64 = 55.0;

/// Rows of the budget with this content: COB-ID, period and worst response, µs.
fn rows(budget: &BusBudget, what: &str) -> Vec<(u16, u128, Option<u128>)> {
    let rows = budget.messages.iter().filter(|message| message.what == what);
    rows.map(|message| (message.cob_id.unwrap(), message.period_us, message.response_us)).collect()
}

#[test]
fn the_frames_of_a_force_sensor_beside_drives_take_time_of_the_cycle() {
    let file = cell(|_| ());
    let [without, with] = [&[][..], &[sensor(SYNC, COB_IDS)]].map(|sensors| check_bus(&file, 0, sensors).unwrap());
    let more = |of: fn(&BusBudget) -> f64| (of(&with) - of(&without)) / 100.0 * 2_000.0;
    // The modes of operation of 5 drives precede the second frame.
    let worst = more(|budget| budget.worst_case_percent);
    assert!((worst - 2.0 * FRAME - 5.0 * SHORT_FRAME).abs() < 1e-6, "{worst}");
    // Two samples per cycle, and a heartbeat of 65 µs.
    let heartbeat = SHORT_FRAME * 2.0 / f64::from(file.cell.bus[0].heartbeat_ms);
    assert!((more(|budget| budget.load_percent) - 2.0 * FRAME - heartbeat).abs() < 1e-6);
    assert_eq!((rows(&without, "SYNC").len(), rows(&with, "SYNC").len()), (1, 1));
    assert_eq!(rows(&with, "wrench").iter().map(|row| row.0).collect::<Vec<_>>(), COB_IDS);
    assert!(rows(&with, "wrench").iter().all(|(_, period, response)| *period == 2_000 && response.is_some()));
}

#[test]
fn a_force_sensor_makes_a_bus_without_drives_cyclic() {
    let file = cell(|_| ());
    let alone = check_bus(&file, 1, &[]).unwrap();
    assert_eq!((alone.worst_case_percent, rows(&alone, "SYNC").len()), (0.0, 0));
    let sampled = check_bus(&file, 1, &[sensor(SYNC, COB_IDS)]).unwrap();
    assert_eq!(rows(&sampled, "SYNC").len(), 1);
    assert!(sampled.worst_case_percent / 100.0 * 2_000.0 >= SYNC_FRAME + 2.0 * FRAME);
    // Every fifth SYNC: the same worst cycle, a fifth of the load.
    let fifth = check_bus(&file, 1, &[sensor(Trigger::Sync { every: 5 }, COB_IDS)]).unwrap();
    assert_eq!(fifth.worst_case_percent, sampled.worst_case_percent);
    let less = (sampled.load_percent - fifth.load_percent) / 100.0 * 2_000.0;
    assert!((less - 0.8 * 2.0 * FRAME).abs() < 1e-6, "{less}");
    // Samples by an event timer have no cycle and need no SYNC.
    let timed = check_bus(&file, 1, &[sensor(Trigger::EventTimer(Duration::from_millis(2)), COB_IDS)]).unwrap();
    assert_eq!((timed.worst_case_percent, rows(&timed, "SYNC").len()), (0.0, 0));
    assert_eq!(rows(&timed, "wrench"), [(0x189, 2_000, None), (0x289, 2_000, None)]);
}

#[test]
fn a_bus_has_a_sensor_alone() {
    let mut file = cell(|_| ());
    file.cell.io.clear();
    let budget = check_bus(&file, 1, &[sensor(SYNC, COB_IDS)]).unwrap();
    let sent: Vec<_> = budget.messages.iter().map(|message| message.what).collect();
    assert_eq!(sent, ["SYNC", "wrench", "wrench", "host heartbeat", "heartbeat"]);
}

#[test]
fn a_bus_that_a_sensor_makes_too_slow_is_refused_and_fewer_axes_are_proposed() {
    let file = cell(|cell| cell.bus[0].bitrate_kbps = 800);
    let fits = check_bus(&file, 0, &[]).unwrap();
    assert!(fits.worst_case_percent <= 100.0, "{fits:?}");
    let refused = check_bus(&file, 0, &[sensor(SYNC, COB_IDS)]).unwrap_err().to_string();
    for needle in
        ["bus[0]: bus \"arm\" with 5 axes and a force sensor is busy for ", "of each 2000 µs", "3 axes would fit, or a"]
    {
        assert!(refused.contains(needle), "{refused}");
    }
}

#[test]
fn no_cell_without_axes_is_proposed() {
    let said = |axes: usize, bitrate: u32| {
        let file = cell(|cell| {
            cell.bus[0].bitrate_kbps = bitrate;
            cell.robot[0].axis.iter_mut().for_each(|axis| axis.bus = "cabinet".into());
            cell.robot[0].axis.iter_mut().take(axes).for_each(|axis| axis.bus = "arm".into());
            cell.bus[1].bitrate_kbps = 1000;
        });
        check_bus(&file, 0, &[]).map(|_| String::new()).unwrap_or_else(|refusal| refusal.to_string())
    };
    let one = said(1, 50);
    assert!(one.contains("is busy for ") && one.contains("a period of "), "{one}");
    for count in 1..=5 {
        for bitrate in [50, 125, 250] {
            let refusal = said(count, bitrate);
            assert!(!refusal.contains("0 axes would fit") && !refusal.contains("1 axes would"), "{refusal}");
        }
    }
    assert!(said(3, 250).contains("1 axis would fit, or a period of "), "{}", said(3, 250));
}

#[test]
fn a_frame_belongs_to_the_node_that_sends_it_or_that_the_host_sends_it_to() {
    let node_of = |id, sender| {
        let id = StandardId::new(id).unwrap();
        node_of(&Message { id, bytes: 8, sender, every: Every::Cycle })
    };
    assert_eq!(node_of(0x185, Sender::Node(5)), Some(5));
    assert_eq!([0x205, 0x605].map(|id| node_of(id, Sender::Host)), [Some(5); 2]);
    // SYNC and the heartbeat of the host.
    assert_eq!([0x080, 0x77F].map(|id| node_of(id, Sender::Host)), [None; 2]);
    // A sample whose identifier ends like the identifiers of drive 5.
    assert_eq!(node_of(0x685, Sender::Node(9)), Some(9));
}

#[test]
fn a_long_term_load_above_the_capacity_is_refused_without_a_cyclic_frame() {
    let chatty = |nodes: u8| {
        cell(|cell| {
            // 65 bits per 100 µs and node.
            cell.io[0].inhibit_us = Some(100);
            let of = |number| {
                let mut io = cell.io[0].clone();
                (io.name, io.node) = (format!("io{number}"), 40 + number);
                io.input.iter_mut().for_each(|line| line.name = format!("{}{number}", line.name));
                io.output.iter_mut().for_each(|line| line.name = format!("{}{number}", line.name));
                io
            };
            cell.io = (0..nodes).map(of).collect();
        })
    };
    let one = &check(&chatty(1)).unwrap()[1];
    assert_eq!(one.worst_case_percent, 0.0);
    assert!((65.0..75.0).contains(&one.load_percent), "{}", one.load_percent);
    let refused = check(&chatty(2)).unwrap_err().to_string();
    let expected = "bus[1]: bus \"cabinet\" with 2 I/O nodes has a long-term load of up to 137 %, at most 100 %: raise \
                    its bitrate_kbps or the inhibit_us of its I/O nodes, or use more buses";
    assert!(refused.ends_with(expected), "{refused}");
}

#[test]
fn the_nodes_of_a_bus_are_named_by_their_kinds() {
    for (counts, expected) in [
        ((0, 0, 0), "0 axes"),
        ((6, 0, 0), "6 axes"),
        ((6, 1, 0), "6 axes and an I/O node"),
        ((0, 2, 0), "2 I/O nodes"),
        ((2, 2, 1), "2 axes and 2 I/O nodes and a force sensor"),
        ((0, 0, 3), "3 force sensors"),
    ] {
        assert_eq!(nodes(counts.0, counts.1, counts.2), expected);
    }
}

#[test]
fn a_device_of_another_crate_has_its_greatest_rate_and_all_bytes_of_its_answer() {
    use crate::devices::tests::{Ranger, text};
    crate::devices::register::<Ranger>();
    let cell = Cell::parse(&text("reach = 4.0\nlong = true")).unwrap();
    let budget = of_device(cell.period(), &cell.device[0]);
    let bytes: Vec<_> = budget.messages.iter().map(|message| message.bytes).collect();
    assert_eq!(bytes, [1, 400]);
    // 401 bytes take 34.8 ms at 115200 bit/s, and end in the 18th reading. One reading without bytes follows.
    assert_eq!(budget.messages[1].period_us, 38_000);
    assert_eq!(budget.sensor.unwrap().samples_per_s, Some(1.0 / 0.038));
}
