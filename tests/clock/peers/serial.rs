//! The kernel's own slcan driver, attached by slcand to emulated adapters.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use can::slcan::BusErrors;
use can::{ControllerState, Frame, Port, Received, SocketCanPort, StandardId, clock};
use kit::adapter::Adapter;
use kit::bench::on_vcan;

use super::linux::{Killed, open, sequence};
use crate::socketcan::sh;
use crate::vcan::{started, wait_until};

/// Upper bound for the duration of every step.
const PATIENCE: Duration = Duration::from_secs(10);

/// The kernel's driver on a tty. Dropping the value detaches the driver.
pub(super) struct Attached {
    pub(super) interface: &'static str,
    _slcand: Killed,
}

/// Attaches the driver. The other end of the tty must be served in the meantime.
pub(super) fn attach(tty: &Path, interface: &'static str) -> Attached {
    let slcand = start_slcand(tty, interface);
    wait_until("the interface is there", || is_there(interface));
    // The default of ten frames overflows when python-canopen searches the bus.
    sh(&format!("ip link set {interface} txqueuelen 100 up"));
    Attached { interface, _slcand: slcand }
}

fn start_slcand(tty: &Path, interface: &str) -> Killed {
    let slcand = Command::new("slcand")
        .args(["-F", "-o", "-c", "-s8"])
        .arg(fs::canonicalize(tty).unwrap())
        .arg(interface)
        .stdout(Stdio::null())
        .spawn();
    Killed(slcand.expect("can-utils are installed"))
}

fn is_there(interface: &str) -> bool {
    Path::new("/sys/class/net").join(interface).exists()
}

/// Output of candump so far.
fn printed(log: &Path) -> String {
    fs::read_to_string(log).unwrap()
}

#[test]
fn the_kernels_driver_takes_frames_states_and_errors_of_an_adapter() {
    let test = "peers::serial::the_kernels_driver_takes_frames_states_and_errors_of_an_adapter";
    on_vcan(test, |_| {
        let interface = "slcan0";
        let mut adapter = Adapter::new(None);
        let _slcand = start_slcand(adapter.pty.path(), interface);
        assert!(adapter.serve(PATIENCE, |_| is_there(interface)));
        sh(&format!("ip link set {interface} up"));
        let log = std::env::temp_dir().join("slcan0.log");
        let _candump = started(|| {
            let candump = Command::new("candump")
                .args(["-L", &format!("{interface},0:0,#FFFFFFFF")])
                .stdout(fs::File::create(&log).unwrap())
                .spawn();
            Killed(candump.unwrap())
        });
        let mut port = open(interface);

        // Every length and both frame formats, in both directions.
        let frames: Vec<_> = (0..=8)
            .map(|length| Frame::new(StandardId::new(0x123).unwrap(), &[0xA5; 8][..length]).unwrap())
            .chain([
                Frame::new(can::ExtendedId::new(0x1234_5678).unwrap(), &[1, 2]).unwrap(),
                Frame::remote(StandardId::new(0x701).unwrap(), 1).unwrap(),
                Frame::remote(can::ExtendedId::new(0x17).unwrap(), 0).unwrap(),
            ])
            .collect();
        let before = adapter.device.counts();
        let mut taken = 0;
        assert!(adapter.serve(PATIENCE, |adapter| {
            taken += port.send(clock::now(), &frames[taken..]).unwrap();
            adapter.device.counts().sent == before.sent + frames.len() as u64
        }));
        assert_eq!(adapter.device.counts().refused, before.refused);
        for frame in &frames {
            adapter.deliver(frame);
        }
        let mut received = Vec::new();
        assert!(adapter.serve(PATIENCE, |_| {
            receive(&mut port, &mut received);
            received.len() >= frames.len()
        }));
        assert_eq!(received, frames);

        let errors = port.counters().errors;
        adapter.device.report_errors(BusErrors::CRC | BusErrors::STUFF);
        assert!(adapter.serve(PATIENCE, |_| {
            receive(&mut port, &mut received);
            port.counters().errors > errors
        }));
        for ((receiving, transmitting), state, line) in [
            ((96, 0), ControllerState::Warning, "20000204#000400000000"),
            ((0, 130), ControllerState::Passive, "20000204#002000000000"),
            ((0, 0), ControllerState::Active, "20000204#004000000000"),
            ((128, 0), ControllerState::Passive, "20000204#001000000000"),
            ((0, 256), ControllerState::BusOff, "20000040#"),
        ] {
            let errors = port.counters().errors;
            adapter.device.set_error_counters(receiving, transmitting);
            let seen = adapter.serve(PATIENCE, |_| {
                receive(&mut port, &mut received);
                port.counters().errors > errors && port.state() == state
            });
            assert!(seen, "{state:?}: {:?}\n{}", port.state(), printed(&log));
            assert!(adapter.serve(PATIENCE, |_| printed(&log).contains(line)), "{line}: {}", printed(&log));
        }
    });
}

fn receive(port: &mut SocketCanPort, all: &mut Vec<Frame>) {
    let mut into = [Received { frame: sequence(0), at: can::Instant::ZERO }; 32];
    let count = port.receive(clock::now(), &mut into).unwrap();
    all.extend(into[..count].iter().map(|received| received.frame));
}
