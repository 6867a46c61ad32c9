//! Common parts of these programs: named checks, and a record of the frames on the bus.

use std::collections::VecDeque;
use std::env;
use std::fmt::Debug;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use socketcan::{CanSocket, EmbeddedFrame, Frame as _, Socket};

pub mod drive;

/// Longest time for one answer on a busy test machine.
pub const PATIENCE: Duration = Duration::from_secs(3);

/// Result of a check, with the reason of a failure.
pub type Outcome = Result<(), String>;

/// Arguments of a master: a network interface and a node-ID.
pub fn arguments() -> (String, u8) {
    let mut arguments = env::args().skip(1);
    let interface = arguments.next().expect("the first argument is a network interface");
    let node = arguments.next().and_then(|node| node.parse().ok());
    (interface, node.expect("the second argument is a node-ID"))
}

/// The arguments of a node: a network interface, a node-ID or 255 for none, and a serial number.
pub fn node_arguments() -> (String, u8, u32) {
    let (interface, node) = arguments();
    let serial = env::args().nth(3).and_then(|serial| serial.parse().ok());
    (interface, node, serial.expect("the third argument is a serial number"))
}

/// A recorded frame.
#[derive(Clone, Debug)]
pub struct Seen {
    pub id: u16,
    pub data: Vec<u8>,
    at: Duration,
}

/// Record of all frames on an interface since the start, from all senders.
#[derive(Clone)]
pub struct Wire {
    seen: Arc<Mutex<Vec<Seen>>>,
}

impl Wire {
    pub fn new(interface: &str) -> Self {
        let socket = CanSocket::open(interface).expect("the interface is there");
        let seen = Arc::new(Mutex::new(Vec::new()));
        let frames = seen.clone();
        let began = Instant::now();
        thread::spawn(move || {
            while let Ok(frame) = socket.read_frame() {
                frames.lock().expect("nobody panics with it").push(Seen {
                    id: frame.raw_id() as u16,
                    data: frame.data().to_vec(),
                    at: began.elapsed(),
                });
            }
        });
        Self { seen }
    }

    /// Number of recorded frames.
    pub fn mark(&self) -> usize {
        self.seen.lock().expect("nobody panics with it").len()
    }

    /// Waits for the first frame after `mark` that satisfies `wanted`.
    pub fn since(&self, mark: usize, wanted: impl Fn(&Seen) -> bool) -> Option<Seen> {
        let end = Instant::now() + PATIENCE;
        loop {
            let seen = self.seen.lock().expect("nobody panics with it");
            if let Some(found) = seen[mark..].iter().find(|seen| wanted(seen)) {
                return Some(found.clone());
            }
            drop(seen);
            if Instant::now() > end {
                return None;
            }
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// Whether any frame after `mark` satisfies `wanted`.
    pub fn any(&self, mark: usize, wanted: impl Fn(&Seen) -> bool) -> bool {
        let seen = self.seen.lock().expect("nobody panics with it");
        seen[mark..].iter().any(wanted)
    }

    /// The last frames in the notation of candump.
    fn last(&self) -> Vec<String> {
        // The thread that reads the frames may lag.
        thread::sleep(Duration::from_millis(50));
        let seen = self.seen.lock().expect("nobody panics with it");
        let last: VecDeque<_> = seen.iter().rev().take(24).collect();
        let line = |seen: &&Seen| {
            let data: String = seen.data.iter().map(|byte| format!("{byte:02X}")).collect();
            format!("{:9.4} {:03X}#{data}", seen.at.as_secs_f64(), seen.id)
        };
        last.iter().rev().map(line).collect()
    }
}

/// Runs named checks and prints `ok` or `FAILED`, the reason and the last frames of each.
pub struct Checks {
    wire: Wire,
    ran: usize,
    failed: usize,
}

impl Checks {
    pub fn new(wire: Wire) -> Self {
        Self { wire, ran: 0, failed: 0 }
    }

    pub fn check(&mut self, name: &str, check: impl FnOnce() -> Outcome) {
        let began = Instant::now();
        let outcome = check();
        let took = began.elapsed().as_secs_f64();
        self.ran += 1;
        match outcome {
            Ok(()) => println!("ok     {name} {took:.2} s"),
            Err(reason) => {
                self.failed += 1;
                println!("FAILED {name}: {reason}");
                for line in self.wire.last() {
                    println!("{line}");
                }
            }
        }
    }

    /// The exit status.
    pub fn finish(self) -> i32 {
        println!("{} checks, {} failed", self.ran, self.failed);
        i32::from(self.failed > 0)
    }
}

/// Asserts that both values are equal.
pub fn same<T: Debug + PartialEq>(what: &str, found: T, expected: T) -> Outcome {
    let wrong = || format!("{what}: {found:02x?}, expected {expected:02x?}");
    if found == expected { Ok(()) } else { Err(wrong()) }
}

/// Asserts that the condition is true.
pub fn holds(what: &str, condition: bool) -> Outcome {
    if condition { Ok(()) } else { Err(what.to_owned()) }
}

/// Test data: neighbouring bytes differ, and so do data of different lengths.
pub fn bytes(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 31 + length) as u8).collect()
}
