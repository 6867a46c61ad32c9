//! Rate of expedited SDO uploads, compared with an independent implementation: python-canopen.
//!
//! `cargo bench -p mrroc-tests --bench peers` prints one line per comparison and then one JSON object. The benchmark
//! fails if this project does not reach the required multiple of the peer's rate. The Python packages are those that
//! `tests/run` installs in `target/peers`.
//!
//! - *slcan*: one emulated adapter on a pseudo-terminal with one emulated drive. The drive answers at once, and the bus
//!   takes no time, so the benchmark measures the client. The first side is python-canopen on python-can's port, the
//!   second this project's client on this project's port.
//! - *virtual*: client and server of each project on the virtual bus of that project. This project's bus has true bit
//!   times and arbitration, and the server is an emulated drive in virtual time. The bus of python-can passes messages
//!   through a queue.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]
#![expect(clippy::unwrap_used, reason = "in a benchmark it is a verdict")]

use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::time::Duration;

use can::timing::Bitrate;
use can::{Instant, Port, Received, clock};
use canopen::NodeId;
use canopen::objects::DEVICE_TYPE;
use canopen::sync::Sync;
use hil::{AxisConfig, Epos4, Epos4Config, Irp6Axis, World, pty};
use kit::adapter::Adapter;
use master::sdo::Client;
use serde_json::json;
use serial::{Settings, SlcanPort, Tty};

const NODE: NodeId = NodeId::new(1).unwrap();

const READ: pty::Interest = pty::Interest { read: true, write: false };

/// Duration of the measurement of each side in a round.
const MEASURED: Duration = Duration::from_secs(1);

/// Number of rounds. The best round counts, because it was disturbed least.
const ROUNDS: usize = 4;

fn main() -> ExitCode {
    let all = [
        Comparison::new("slcan", over_slcan(), 2.0),
        Comparison::new("virtual", in_turns(|| python_canopen(&[]), on_the_virtual_bus), 50.0),
    ];
    all.iter().for_each(Comparison::print);
    println!("{}", json!({ "sdo_uploads_per_second": all.each_ref().map(Comparison::json) }));
    ExitCode::from(u8::from(!all.iter().all(Comparison::holds)))
}

/// Uploads per second of the two projects.
struct Comparison {
    name: &'static str,
    ours: f64,
    theirs: f64,
    /// Required ratio of this project's rate to the peer's.
    at_least: f64,
}

impl Comparison {
    fn new(name: &'static str, (theirs, ours): (f64, f64), at_least: f64) -> Self {
        Self { name, ours, theirs, at_least }
    }

    fn ratio(&self) -> f64 {
        self.ours / self.theirs
    }

    fn holds(&self) -> bool {
        self.ratio() >= self.at_least
    }

    fn print(&self) {
        let verdict = if self.holds() { "" } else { " - TOO FEW" };
        println!(
            "{:8} mrroc {:8.0}/s, python-canopen {:6.0}/s: {:5.1} times as many, to be {}{verdict}",
            self.name,
            self.ours,
            self.theirs,
            self.ratio(),
            self.at_least,
        );
    }

    fn json(&self) -> serde_json::Value {
        json!({
            "bus": self.name,
            "mrroc": self.ours.round(),
            "python_canopen": self.theirs.round(),
            "ratio": self.ratio(),
            "at_least": self.at_least,
        })
    }
}

/// Rates of python-canopen and of this project on one adapter.
fn over_slcan() -> (f64, f64) {
    let drive = Epos4::new(Epos4Config { answer_delay: Duration::ZERO, power_on: clock::now(), ..drive_config() });
    Adapter::new(Some(Box::new(drive))).served(|tty| {
        let channel = tty.to_str().expect("a path of digits and letters");
        let theirs = || python_canopen(&["--interface", "slcan", "--channel", channel]);
        in_turns(theirs, || on_the_adapter(tty))
    })
}

/// Measures both sides in turns, so that other load of the machine disturbs both. Returns the best round of each.
fn in_turns(mut theirs: impl FnMut() -> f64, mut ours: impl FnMut() -> f64) -> (f64, f64) {
    (0..ROUNDS).fold((0.0_f64, 0.0_f64), |best, _| (best.0.max(theirs()), best.1.max(ours())))
}

fn on_the_adapter(tty: &Path) -> f64 {
    const LOOK: Duration = Duration::from_secs(1);
    let tty = Tty::open(tty, Settings::EPOS).unwrap();
    let mut port = SlcanPort::new(tty, Bitrate::KBPS_1000, clock::now()).unwrap();
    let wait = |port: &SlcanPort<Tty>, until| {
        pty::wait([(port.line().as_fd(), READ)], until).unwrap();
        clock::now()
    };
    while port.poll_open(clock::now()).map(Result::unwrap).is_pending() {
        wait(&port, port.poll_timeout().expect("it is opening"));
    }
    let mut client = client();
    rate(|| {
        upload(&mut client, &mut port, clock::now(), |port, now| wait(port, now + LOOK));
    })
}

/// Rate in virtual time, measured on the wall clock.
fn on_the_virtual_bus() -> f64 {
    const STEP: Duration = Duration::from_micros(100);
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let mut port = world.host_port(bus, 16);
    world.add_device(bus, Box::new(Epos4::new(drive_config())));
    let mut now = Instant::ZERO + Duration::from_secs(1);
    world.advance(now);
    let mut client = client();
    rate(|| {
        now = upload(&mut client, &mut port, now, |_, now| {
            world.advance(now + STEP);
            now + STEP
        });
    })
}

fn drive_config() -> Epos4Config {
    Epos4Config::new(NODE, AxisConfig::irp6(Irp6Axis::ALL[0]))
}

fn client() -> Client {
    Client::new(NODE, Duration::from_secs(2), 0)
}

/// Makes one upload that starts at `now`, and returns the time of its end. `wait` waits for frames.
fn upload<P: Port>(
    client: &mut Client,
    port: &mut P,
    mut now: Instant,
    mut wait: impl FnMut(&P, Instant) -> Instant,
) -> Instant {
    let nothing = Received { frame: Sync::default().encode(), at: Instant::ZERO };
    let mut received = [nothing; 16];
    client.upload(DEVICE_TYPE, now).unwrap();
    let request = client.poll_transmit(now).unwrap();
    assert_eq!(port.send(now, &[request]), Ok(1));
    loop {
        now = wait(port, now);
        let count = port.receive(now, &mut received).unwrap();
        for received in &received[..count] {
            client.handle(&received.frame, now);
        }
        client.handle_timeout(now);
        if let Some(result) = client.poll() {
            assert_eq!(result.unwrap().number(), Ok(0x0002_0192_u32));
            return now;
        }
    }
}

/// Number of calls of `once` per second.
fn rate(mut once: impl FnMut()) -> f64 {
    const AT_A_TIME: u32 = 100;
    (0..AT_A_TIME).for_each(|_| once());
    let begin = clock::now();
    let (mut count, mut measured) = (0, Duration::ZERO);
    while measured < MEASURED {
        (0..AT_A_TIME).for_each(|_| once());
        count += AT_A_TIME;
        measured = clock::now().since(begin);
    }
    f64::from(count) / measured.as_secs_f64()
}

/// Rate of python-canopen, measured by `speed.py` with these arguments.
fn python_canopen(arguments: &[&str]) -> f64 {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests' room is inside the workspace");
    let output = Command::new(root.join("target/peers/bin/python"))
        .args(["-B", "tests/peers/speed.py", "--seconds"])
        .arg(MEASURED.as_secs().to_string())
        .args(arguments)
        .current_dir(root)
        .output()
        .expect("`tests/run` makes target/peers");
    assert!(output.status.success(), "{output:?}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    found["uploads_per_second"].as_f64().unwrap()
}
