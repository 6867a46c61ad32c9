//! Computing time of a cycle over the real drive group, with and without the emulated robot.
//!
//! `lockstep` counts cycles of servo, bus and emulated drives together. The result divided by the 500 cycles per second
//! is the speed of a lockstep run in multiples of real time. `servo cycle` is the servo and the group alone. Its port
//! answers every SYNC from a table and makes no system call.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received, StandardId, VirtualPort};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use servo::Phase;

#[path = "../system/allocations.rs"]
mod allocations;
#[allow(dead_code, reason = "the tests use the rest")]
#[path = "../system/cell.rs"]
mod cell;
#[path = "../system/motion.rs"]
mod motion;

use cell::{Rig, Setup};
use motion::Motion;

/// Number of cycles in one iteration of the lockstep benchmark: one second.
const SECOND: u64 = 500;

/// A motion to and fro without end.
struct ToAndFro {
    motion: Motion,
    distance: f64,
}

impl ToAndFro {
    fn new(rig: &Rig) -> Self {
        let distance = 30.0;
        Self { motion: Motion::new(rig, distance), distance }
    }

    fn feed(&mut self, rig: &mut Rig) {
        if self.motion.is_sent() && rig.phase() == Phase::Standing {
            self.distance = -self.distance;
            self.motion = Motion::new(rig, self.distance);
        }
        rig.feed(&mut self.motion);
    }
}

fn lockstep(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("lockstep");
    group.throughput(Throughput::Elements(SECOND));
    for name in ["irb6", "irp6"] {
        let mut rig = Setup::of(name).bring_up();
        rig.home();
        let mut motion = ToAndFro::new(&rig);
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for _ in 0..SECOND {
                    motion.feed(&mut rig);
                    rig.cycle();
                }
            });
        });
        assert_eq!(rig.servo.fault(0), None);
    }
}

/// The port of a robot at rest. It is a real port at first; after it is cut off, each SYNC is answered with the last
/// answers.
struct Echo {
    port: VirtualPort,
    cut: Arc<AtomicBool>,
    answers: Vec<Received>,
    synchronised: Option<Instant>,
}

impl Echo {
    fn is_cut(&self) -> bool {
        self.cut.load(Ordering::Relaxed)
    }
}

impl Port for Echo {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        if !self.is_cut() {
            return self.port.send(now, frames);
        }
        self.synchronised = Some(now);
        Ok(frames.len())
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        if !self.is_cut() {
            let count = self.port.receive(now, into)?;
            let is_answer = |received: &&Received| {
                let id = received.frame.standard_data_id();
                id.is_some_and(|id| (0x181..=0x1FF).contains(&id.raw()))
            };
            if into[..count].iter().any(|received| is_answer(&received)) {
                self.answers.clear();
                self.answers.extend(into[..count].iter().filter(is_answer));
            }
            return Ok(count);
        }
        let Some(at) = self.synchronised.take() else {
            return Ok(0);
        };
        for (place, answer) in into.iter_mut().zip(&self.answers) {
            *place = Received { at: at + Duration::from_micros(500), ..*answer };
        }
        // All heartbeats in each cycle, which is more than real drives send.
        let mut count = self.answers.len();
        for (place, node) in into[count..].iter_mut().zip(1..=self.answers.len() as u16) {
            let id = StandardId::new(0x700 + node).expect("a heartbeat's identifier");
            let frame = Frame::new(id, &[5]).expect("a byte");
            *place = Received { frame, at };
            count += 1;
        }
        Ok(count)
    }

    fn counters(&self) -> Counters {
        self.port.counters()
    }

    fn state(&self) -> ControllerState {
        self.port.state()
    }
}

fn servo_cycle(criterion: &mut Criterion) {
    let cut = Arc::default();
    let mut setup = Setup::of("irp6");
    // The drives keep their position while the commands go to and fro.
    for axis in &mut setup.cell.robot[0].axis {
        axis.following_error = 100.0;
    }
    let switch = Arc::clone(&cut);
    setup.port = Box::new(move |port| {
        Box::new(Echo {
            port,
            cut: switch,
            // Capacity for six axes. Growth in the cycle would count as heap use of the servo.
            answers: Vec::with_capacity(6),
            synchronised: None,
        })
    });
    let mut rig = setup.bring_up();
    rig.home();
    cut.store(true, Ordering::Relaxed);
    let mut motion = ToAndFro::new(&rig);
    criterion.bench_function("servo cycle, six moving axes", |bencher| {
        bencher.iter(|| {
            motion.feed(&mut rig);
            rig.servo_cycle();
            rig.now += rig.period;
        });
    });
    assert_eq!(rig.servo.fault(0), None);
}

criterion_group!(benches, servo_cycle, lockstep);
criterion_main!(benches);
