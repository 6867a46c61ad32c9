//! What the programs here share: named checks, and a memory of the wire.

use std::collections::VecDeque;
use std::env;
use std::fmt::Debug;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use socketcan::{CanSocket, EmbeddedFrame, Frame as _, Socket};

pub mod drive;

/// Longest time that one answer may take where the test machine is busy.
pub const PATIENCE: Duration = Duration::from_secs(3);

/// Why a check failed.
pub type Outcome = Result<(), String>;

/// The arguments: a network interface and a node-ID.
pub fn arguments() -> (String, u8) {
    let mut arguments = env::args().skip(1);
    let interface = arguments
        .next()
        .expect("the first argument is a network interface");
    let node = arguments.next().and_then(|node| node.parse().ok());
    (interface, node.expect("the second argument is a node-ID"))
}

/// The arguments of a node: a network interface, a node-ID or 255 for none, and a serial number.
pub fn node_arguments() -> (String, u8, u32) {
    let (interface, node) = arguments();
    let serial = env::args().nth(3).and_then(|serial| serial.parse().ok());
    (
        interface,
        node,
        serial.expect("the third argument is a serial number"),
    )
}

/// A frame as it passed.
#[derive(Clone, Debug)]
pub struct Seen {
    pub id: u16,
    pub data: Vec<u8>,
    at: Duration,
}

/// All frames of an interface since the beginning, from all senders.
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

    /// How many frames have passed.
    pub fn mark(&self) -> usize {
        self.seen.lock().expect("nobody panics with it").len()
    }

    /// The first frame since `mark` of which `wanted` is true, waiting for it.
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

    /// Whether `wanted` is true of any frame since `mark`.
    pub fn any(&self, mark: usize, wanted: impl Fn(&Seen) -> bool) -> bool {
        let seen = self.seen.lock().expect("nobody panics with it");
        seen[mark..].iter().any(wanted)
    }

    /// The last frames as candump prints them.
    fn last(&self) -> Vec<String> {
        // The thread that reads them may be behind.
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
        Self {
            wire,
            ran: 0,
            failed: 0,
        }
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

/// Both are the same.
pub fn same<T: Debug + PartialEq>(what: &str, found: T, expected: T) -> Outcome {
    let wrong = || format!("{what}: {found:02x?}, expected {expected:02x?}");
    if found == expected {
        Ok(())
    } else {
        Err(wrong())
    }
}

/// It is true.
pub fn holds(what: &str, condition: bool) -> Outcome {
    if condition {
        Ok(())
    } else {
        Err(what.to_owned())
    }
}

/// Test data: neighbouring bytes differ, and so do data of different lengths.
pub fn bytes(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 31 + length) as u8).collect()
}
