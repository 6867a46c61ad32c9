//! A servo thread with a forbidden operation planted in its cycle. The proofs that a cycle does not allocate, lock or
//! write must detect the operation. The argument selects it: `nothing`, `allocation`, `lock` or `write`. The program
//! prints how often it read the kernel's account of the thread.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]

use std::fs::File;
use std::hint::black_box;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::Poll;
use std::time::Duration;

use can::{Instant, clock};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};
use servo::thread::{self, CellTime, Realtime};
use servo::{EffectorConfig, PositionLoop, Servo, ServoAxisConfig, ServoConfig};

const PERIOD: Duration = Duration::from_millis(1);
const CYCLES: u32 = 100;

enum Plant {
    Nothing,
    Allocation,
    /// A lock that the main thread holds most of the time.
    Lock(Arc<Mutex<u32>>),
    Write(File),
}

impl DriveGroup for Plant {
    fn axes(&self) -> usize {
        1
    }

    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _now: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }

    fn read(&mut self, _now: Instant, _states: &mut [AxisState]) {
        match self {
            Self::Nothing => {}
            Self::Allocation => drop(black_box(Box::new(0))),
            Self::Lock(held) => *held.lock().unwrap_or_else(PoisonError::into_inner) += 1,
            Self::Write(file) => file.write_all(b"a cycle").expect("nothing refuses it"),
        }
    }

    fn write(&mut self, _now: Instant, _commands: &[AxisCommand]) {}

    fn send(&mut self, _now: Instant) -> bool {
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

fn main() {
    let held = Arc::new(Mutex::new(0));
    let plant = match std::env::args().nth(1).as_deref() {
        Some("nothing") => Plant::Nothing,
        Some("allocation") => Plant::Allocation,
        Some("lock") => Plant::Lock(held.clone()),
        Some("write") => Plant::Write(File::create("/dev/null").expect("it is always there")),
        other => panic!("{other:?} cannot be planted"),
    };
    let axis = ServoAxisConfig {
        group: 0,
        index_in_group: 0,
        min_position: -1.0,
        max_position: 1.0,
        max_velocity: 1.0,
        max_acceleration: 1.0,
        planned_jerk: 5.0,
        following_error: 1.0,
        homing_order: 0,
        increments_per_radian: 1000.0,
        position_loop: PositionLoop::Drive,
        torque_offset: None,
        homing: None,
        frozen: servo::FrozenWatch::Always,
        brake_watch: true,
    };
    let config = ServoConfig {
        period: PERIOD,
        max_missed_in_row: u32::MAX,
        effectors: vec![EffectorConfig {
            name: "arm".into(),
            axes: vec![axis],
            queue: 8,
            enabling_timeout: PERIOD,
            homing_timeout: PERIOD,
        }],
    };
    let (servo, _links) = Servo::new(&config, vec![Box::new(plant)]).expect("the configuration is sound");
    let mut cycles = 0;
    let over = Arc::new(AtomicBool::new(false));
    let ended = over.clone();
    let until = move |_: &Servo| {
        cycles += 1;
        ended.fetch_or(cycles == CYCLES, Ordering::Relaxed)
    };
    let running = thread::start(servo, Realtime::PLAIN, CellTime::Wall, Arc::default(), |_| {}, until);
    while !over.load(Ordering::Relaxed) {
        let _held = held.lock().unwrap_or_else(PoisonError::into_inner);
        clock::sleep_until(clock::now() + PERIOD * 2);
    }
    let finished = running.expect("what the host denies is not needed").join();
    assert_eq!(finished.panicked, None);
    let account = finished.timing.account;
    println!("{}", account.disturbed + account.quiet + account.slack);
}
