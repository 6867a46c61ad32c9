//! Two controllers, or two emulators of one node, on one bus: the second is refused before it sends a frame.
//!
//! Required hardware, with `HIL_CAN` set: a virtual interface.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use can::{Frame, Port, SocketCanOptions, SocketCanPort, clock};
use canopen::heartbeat::Heartbeat;
use canopen::sync::Sync;
use canopen::{NodeId, nmt};
use kit::mrroc::{Running, mrroc, trace};
use kit::refusals::refused;
use serde_json::json;

use crate::cli_run::stopped;
use crate::vcan::{Stage, bodies_on_stage, faulted, frames_of, wait_until};

/// Emulates a controller in another computer: sends `frame` every `period` while `body` runs.
pub(crate) fn beside_a_master(interface: &str, frame: Frame, period: Duration, body: impl FnOnce()) {
    let mut port = SocketCanPort::open(interface, &SocketCanOptions::default()).unwrap();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                port.send(clock::now(), &[frame]).unwrap();
                clock::sleep_until(clock::now() + period);
            }
        });
        body();
        over.store(true, Ordering::Relaxed);
    });
}

#[test]
fn two_controllers_on_one_interface() {
    bodies_on_stage(
        "second_controller::two_controllers_on_one_interface",
        &[
            (
                "a second controller on an interface is refused and told of the first",
                a_second_controller_on_an_interface_is_refused_and_told_of_the_first,
            ),
            (
                "a controller that was killed leaves the interface free",
                a_controller_that_was_killed_leaves_the_interface_free,
            ),
            (
                "a master in another computer refuses the start before a frame is sent",
                a_master_in_another_computer_refuses_the_start_before_a_frame_is_sent,
            ),
            (
                "a master that comes in operation stops the robot and is named",
                a_master_that_comes_in_operation_stops_the_robot_and_is_named,
            ),
            ("a node is emulated once on an interface", a_node_is_emulated_once_on_an_interface),
        ],
    );
}

fn a_second_controller_on_an_interface_is_refused_and_told_of_the_first(stage: &mut Stage) {
    // Motion that outlasts all commands below.
    stage.change(|cell| {
        let program = &mut cell.robot[0].program;
        *program = vec![program.clone(); 6].concat();
    });
    let (_emulators, first) = stage.start_moving();
    let cell = stage.directory.path("cell.toml").display().to_string();
    let on = ["--bench=vcan", "--can", stage.interface];
    let holder = format!("bus arm: {}: another controller is at work: process {}", stage.interface, first.id());
    for command in [
        &["run", &cell][..],
        &["identify", &cell, "--axis=column", "--at=command", "--to=16"],
        &["jitter", "--cell", &cell, "--duration=100ms"],
    ] {
        refused(&mrroc(command.iter().chain(&on)), &[&holder]);
    }
    // Service commands are permitted during a run.
    let read = ["sdo", "read", "1", "0x1008", "--can", stage.interface];
    let read = mrroc(read);
    assert_eq!(read.status.code(), Some(0), "{read:?}");
    // Not where they would take the drive's watch away.
    let holder = format!("process {}", first.id());
    for object in ["0x1016:1", "0x1010:1", "0x30B0"] {
        let write = ["sdo", "write", "1", object, "0", "--type", "u32", "--can"];
        let write = mrroc(write.iter().chain(&[stage.interface]));
        refused(&write, &["belongs to the driver", &holder, "end that process"]);
    }
    let tuning = ["sdo", "write", "1", "0x6067", "4000", "--type", "u32", "--can"];
    let tuning = mrroc(tuning.iter().chain(&[stage.interface]));
    assert_eq!(tuning.status.code(), Some(0), "{tuning:?}");
    first.signal("INT");
    let first = first.output();
    stopped(&first);
    assert_eq!(first.json()["faults"], json!([]), "{first:?}");
}

fn a_controller_that_was_killed_leaves_the_interface_free(stage: &mut Stage) {
    stage.change(|cell| {
        cell.bus[0].heartbeat_ms = 300;
        cell.robot[0].program.truncate(1);
    });
    let (_emulators, first) = stage.start_moving();
    let _candump = stage.start_candump();
    first.signal("KILL");
    drop(first);
    // The kernel of a busy host delivers the last frames late.
    let syncs = || {
        let frames = frames_of(&stage.directory.path("bus.log"));
        frames.iter().filter(|received| received.frame == Sync::default().encode()).count()
    };
    wait_until("no further SYNC comes", || {
        let before = syncs();
        clock::sleep_until(clock::now() + Duration::from_millis(100));
        syncs() == before
    });
    // The drives brake because the heartbeat is missing, while the next controller listens.
    let next = stage.start_controller().output();
    assert_eq!(next.status.code(), Some(0), "{next:?}");
}

fn a_master_in_another_computer_refuses_the_start_before_a_frame_is_sent(stage: &mut Stage) {
    let _emulators = stage.start_emulators();
    let host = Heartbeat { node: NodeId::new(stage.cell.bus[0].host_node).unwrap(), state: nmt::NmtState::Operational };
    let heartbeat = Duration::from_millis(stage.cell.bus[0].heartbeat_ms.into());
    let cycle = Duration::from_micros(stage.cell.period_us.into());
    for (frame, period, sign) in
        [(Sync::default().encode(), cycle, "SYNC"), (host.encode(), heartbeat, "the heartbeat of node 127")]
    {
        beside_a_master(stage.interface, frame, period, || {
            let output = stage.start_controller().output();
            let sign = format!("bus arm: another controller is at work: it sent {sign}");
            refused(&output, &[&sign]);
        });
        let log = stage.directory.path("trace.log");
        let sent = trace(&log).into_iter().filter(|entry| {
            let direction = entry.direction;
            direction == Some(can::candump::Direction::Sent)
        });
        assert_eq!(sent.count(), 0, "{}", fs::read_to_string(&log).unwrap());
    }
}

fn a_master_that_comes_in_operation_stops_the_robot_and_is_named(stage: &mut Stage) {
    let (_emulators, controller) = stage.start_moving();
    let cycle = Duration::from_micros(stage.cell.period_us.into());
    beside_a_master(stage.interface, Sync::default().encode(), cycle, || {
        let named = "bus arm: another controller is at work: it sent SYNC";
        faulted(&controller.output(), &[named]);
    });
}

fn a_node_is_emulated_once_on_an_interface(stage: &mut Stage) {
    let first = stage.start_emulators();
    let cell = stage.directory.path("cell.toml").display().to_string();
    let again = mrroc(["emulate", &cell, "--can", stage.interface]);
    let holder = format!("bus arm: {}: node 1 is emulated already: process {}", stage.interface, first.id());
    refused(&again, &[&holder]);
    // The first emulator does not serve the other nodes.
    stage.change(|cell| {
        for axis in &mut cell.robot[0].axis {
            axis.node += 20;
        }
    });
    let other = Running::start(["emulate", &cell, "--can", stage.interface]);
    let answers = || mrroc(["sdo", "read", "21", "0x1000", "--can", stage.interface]);
    wait_until("the other nodes answer", || answers().status.success());
    drop((first, other));
}
