//! A relay at an output of an I/O node on a guarded bus: the guardian opens the relay when the controller is killed.
//!
//! The controller is this test again, in a process of its own. The drives and the node are emulated on a virtual
//! interface in this process, so that the terminal of the relay can be read in the time of the emulator.

use std::env;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use ::mrroc::bench::bus_port::BusPort;
use ::mrroc::bench::emulated_lines::EmulatedLines;
use ::mrroc::bench::interfaces::Interface;
use ::mrroc::bench::plants::EmulatedCell;
use ::mrroc::bench::{BenchKind, Places};
use ::mrroc::cell::{Cell as CellConfig, CellFile, ErrorState, OutputLine};
use ::mrroc::prelude::*;
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::Program;
use can::{Instant, Port, Received, clock};
use canopen::sync::Sync;
use canopen::{NodeId, cob};
use hil::{DigitalIo, DigitalIoConfig, World};
use kit::bench::on_vcan_within;
use kit::mrroc::{Directory, Running};
use kit::slow;

/// Environment variable that makes this test the controller of a cell file.
const CONTROLLER: &str = "RELAY_CELL";

/// Period of the heartbeats of the host. Without a guardian, the node opens the relay by itself when it has received no
/// heartbeat for three periods.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// Latest opening by the guardian, and earliest opening by the node, after the last message of the controller. The last
/// heartbeat is up to one period older than the last message.
const BY_GUARDIAN: Duration = Duration::from_millis(1500);

const BY_NODE: Duration = Duration::from_millis(1900);

/// Node-ID of the I/O node, and the number of the output.
const NODE: u8 = 40;

const LINE: u8 = 0;

/// Latest observations of the emulator.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Time of the last SYNC or heartbeat of the host.
    sign: Instant,
    /// Whether the relay is closed, and the time of its last change.
    closed: bool,
    changed: Instant,
}

/// Closes the relay, and keeps it closed.
async fn hold(cell: &mut Cell) -> Outcome {
    cell.output("relay")?.set(true);
    cell.sleep(Duration::from_secs(300)).await;
    Ok(())
}

/// Controls a cell on `interface`, until this process is killed.
fn control(cell: &Path, interface: &str) {
    let file = CellFile::read(cell).expect("the cell");
    let mut options = RunOptions::on(BenchKind::Vcan);
    options.places = Places { can: vec![interface.to_owned()], ..Places::default() };
    let run = ::mrroc::run::run(&file, &options, &Requests::default(), &Program::of(hold), &mut |_| {});
    panic!("the run ended: {run:?}");
}

fn shorten(cell: &mut CellConfig) {
    slow::shorten(cell);
    cell.flight_recorder_s = 0;
    cell.bus[0].heartbeat_ms = HEARTBEAT.as_millis() as u16;
}

/// Time from the last message of a killed controller to the opening of the relay.
fn opens(test: &str, interface: &str, guarded: bool) -> Duration {
    let directory = Directory::new();
    let drives = directory.cell("irb6-touch", |cell| {
        shorten(cell);
        cell.io.clear();
    });
    let drives = CellFile::read(drives).expect("the cell of the drives");
    let mut lines = EmulatedLines::default();
    let bus = {
        let port = BusPort::open(&Interface::parse(interface), drives.cell.bus[0].bitrate_kbps);
        lines.add_bus_on(&EmulatedCell::of(&drives), 0, port.expect("the interface"))
    };
    let module = DigitalIo::new(DigitalIoConfig::new(NodeId::new(NODE).expect("a node-ID"))).expect("a module");
    let node = lines.world.add_device(bus, Box::new(module));
    let mut listener = lines.world.host_port(bus, 1 << 12);
    let sync = Sync::default().encode();
    let heartbeat = NodeId::new(drives.cell.bus[0].host_node).map(cob::heartbeat);
    let seen = Arc::new(Mutex::new(Seen { sign: Instant::ZERO, closed: false, changed: Instant::ZERO }));
    let over = Arc::new(AtomicBool::new(false));
    let (told, ended) = (Arc::clone(&seen), Arc::clone(&over));
    let emulator = thread::spawn(move || {
        let mut frames = [Received { frame: sync, at: Instant::ZERO }; 64];
        let observe = |world: &World, now: Instant| {
            let mut seen = told.lock().expect("no panic");
            while let count @ 1.. = listener.receive(Instant::FAR_FUTURE, &mut frames).expect("a virtual bus") {
                let is_sign = |it: &&Received| it.frame == sync || it.frame.standard_data_id() == heartbeat;
                seen.sign = frames[..count].iter().rfind(is_sign).map_or(seen.sign, |sign| sign.at);
            }
            let module: &DigitalIo = world.device(node).expect("the module");
            let closed = module.output(LINE).level;
            if closed != seen.closed {
                (seen.closed, seen.changed) = (closed, now);
            }
        };
        lines.serve_observed(&ended, observe).expect("the lines can be served");
    });
    let cell = directory.cell("irb6-touch", |cell| {
        shorten(cell);
        cell.bus[0].guarded = guarded;
        cell.guardian_ms = guarded.then_some(350);
        let relay = OutputLine { name: "relay".into(), line: LINE, inverted: false, error_state: ErrorState::Off };
        cell.io[0].output = vec![relay];
    });
    let binary = env::current_exe().expect("a test binary knows its own path");
    let role = format!("{CONTROLLER}={}", cell.display());
    let arguments = [role.as_ref(), binary.as_os_str(), test.as_ref(), "--exact".as_ref(), "--nocapture".as_ref()];
    let controller = Running::program(Path::new("env"), arguments);
    let wait_until = |closed: bool| {
        for _ in 0..6_000 {
            let seen = *seen.lock().expect("no panic");
            if seen.closed == closed {
                return seen;
            }
            clock::sleep_until(clock::now() + Duration::from_millis(10));
        }
        controller.signal("KILL");
        panic!("the relay never becomes closed = {closed}");
    };
    wait_until(true);
    controller.signal("KILL");
    let opened = wait_until(false);
    over.store(true, Ordering::Relaxed);
    emulator.join().expect("the emulator does not panic");
    opened.changed.since(opened.sign)
}

#[test]
fn a_relay_opens_when_the_controller_is_killed() {
    let test = "relay::a_relay_opens_when_the_controller_is_killed";
    if let Some(cell) = env::var_os(CONTROLLER) {
        let interface = env::var("HIL_CAN").expect("the interface of the other process");
        return control(cell.as_ref(), &interface);
    }
    on_vcan_within(Duration::from_secs(240), test, |interface| {
        let by_guardian = opens(test, interface, true);
        let by_node = opens(test, interface, false);
        println!("the relay opens after {by_guardian:?} by the guardian, and after {by_node:?} by the node");
        assert!(by_guardian < BY_GUARDIAN, "{by_guardian:?} by the guardian");
        assert!(by_node > BY_NODE, "{by_node:?} by the node");
    });
}
