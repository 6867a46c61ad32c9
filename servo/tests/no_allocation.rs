//! Ten thousand cycles with a moving effector, its stop, and teams do not allocate.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;
use can::clock::now;
use drive::Homing;
use mrroc_servo::{
    CycleLaw, Direction, HomingLeg, HostHoming, LawBound, LawFault, LawInput, LawOutput, LawParameters, MAX_AXES,
    Macrostep, Order, Phase, Servo, ServoConfig, StopCause, Timing, thread,
};

use crate::{alone, scripted};

/// Counts the requests of this thread to the system allocator.
struct Counting;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    CALLS.with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call is forwarded unchanged to the system allocator.
#[expect(unsafe_code, reason = "an allocator cannot be written without")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn cycles_do_not_allocate() {
    for config in [scripted::config(6), scripted::host_config(6)] {
        moves_and_stops(&config);
    }
}

fn moves_and_stops(config: &ServoConfig) {
    let axes = config.effectors[0].axes.len();
    let (group, world) = scripted::group(axes);
    {
        let mut world = world.lock().expect("nobody else has it yet");
        world.log = false;
        world.axes.iter_mut().for_each(|drive| drive.state.homing = Homing::Attained);
    }
    let (mut servo, mut links) = Servo::new(config, vec![group]).expect("the configuration is sound");
    let link = &mut links[0];
    let mut records = servo.record(1000);
    let mut journal = servo.keep_journal(1000, 100, Vec::new());
    let mut orders = 0;
    let mut timing = Timing::default();
    let mut now = Instant::ZERO;
    let mut cycle = |servo: &mut Servo| {
        servo.step(now);
        timing.step.record(Duration::from_micros(3));
        now += scripted::PERIOD;
    };
    link.orders.push(Order::Enable).expect("the queue is empty");
    (0..20).for_each(|_| cycle(&mut servo));

    let before = CALLS.with(Cell::get);
    let mut moving = 0;
    for number in 0..1000 {
        // Back and forth by 0.01 rad.
        let position = [if number % 2 == 0 { 0.01 } else { 0.0 }; MAX_AXES];
        let velocity = [0.0; MAX_AXES];
        let macrostep = Macrostep {
            number,
            steps: 10,
            report_at: 5,
            position,
            velocity,
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: None,
            continues_law: false,
        };
        link.orders.push(Order::Move(macrostep)).expect("one is waiting at most");
        for _ in 0..10 {
            cycle(&mut servo);
            moving += u64::from(servo.state(0).is_some_and(|s| s.phase() == Phase::Moving));
            while records.pop().is_ok() || link.reports.pop().is_ok() || journal.read().is_some() {}
            while journal.order().is_some() {
                orders += 1;
            }
        }
    }
    // A stop does not allocate either: a stream that ends in motion, a fault, drives off.
    let (position, velocity) = ([0.05; MAX_AXES], [5.0; MAX_AXES]);
    let last = Macrostep {
        number: 1000,
        steps: 20,
        report_at: 5,
        position,
        velocity,
        acceleration: None,
        torque: [0.0; MAX_AXES],
        law: None,
        continues_law: false,
    };
    link.orders.push(Order::Move(last)).expect("the queue is empty");
    (0..200).for_each(|_| cycle(&mut servo));
    assert_eq!(CALLS.with(Cell::get) - before, 0);
    assert_eq!(moving, 10_000);
    assert_eq!(servo.fault(0).map(|fault| fault.cause), Some(StopCause::Starved { last: 1000 }));
    assert_eq!(servo.counters().dropped_records, 0);
    assert_eq!((orders, journal.lost()), (1001, 0));

    drop(vec![0u8]);
    assert_eq!(CALLS.with(Cell::get) - before, 2, "the counter counts");
}

/// A law that swings all motors by 1 mrad at 10 rad/s, and ends at its call of this number.
struct Swing {
    calls: u32,
    end: u32,
    output: LawOutput,
}

impl CycleLaw for Swing {
    fn check(&self, _: &LawParameters) -> Result<(), LawFault> {
        Ok(())
    }

    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {
        self.calls = 0;
    }

    fn shift(&mut self, input: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        self.calls += 1;
        let at = 1e-3 * (1.0 - (10.0 * f64::from(self.calls) * input.period).cos());
        if self.calls < self.end { LawOutput::Displacement([at; MAX_AXES]) } else { self.output }
    }
}

#[test]
fn laws_and_their_ends_do_not_allocate() {
    let ends = [
        (LawOutput::Touched, StopCause::Touched),
        (LawOutput::Fault(LawFault::Saturated { channel: 1 }), StopCause::Law(LawFault::Saturated { channel: 1 })),
        (LawOutput::Displacement([f64::NAN; MAX_AXES]), StopCause::NotFinite),
    ];
    for (output, cause) in ends {
        let config = scripted::config(6);
        let (group, world) = scripted::group(6);
        {
            let mut world = world.lock().expect("nobody else has it yet");
            world.log = false;
            world.axes.iter_mut().for_each(|drive| drive.state.homing = Homing::Attained);
        }
        let (mut servo, mut links) = Servo::new(&config, vec![group]).expect("the configuration is sound");
        let bounds = [LawBound { displacement: 0.1, speed: 10.0 }; 6];
        servo.install_law(0, Box::new(Swing { calls: 0, end: 9_000, output }), &bounds).expect("the bounds are sound");
        let mut now = Instant::ZERO;
        let mut run = |servo: &mut Servo, cycles| {
            for _ in 0..cycles {
                servo.step(now);
                now += scripted::PERIOD;
            }
        };
        links[0].orders.push(Order::Enable).expect("the queue is empty");
        run(&mut servo, 20);
        let before = CALLS.with(Cell::get);
        for number in 1..1000 {
            let macrostep = Macrostep {
                number,
                steps: 10,
                report_at: 5,
                position: [0.01 * (number % 2) as f64; MAX_AXES],
                velocity: [0.0; MAX_AXES],
                acceleration: None,
                torque: [0.0; MAX_AXES],
                law: Some(LawParameters::default()),
                continues_law: false,
            };
            let _ = links[0].orders.push(Order::Move(macrostep));
            run(&mut servo, 10);
            while links[0].reports.pop().is_ok() {}
        }
        assert_eq!(CALLS.with(Cell::get) - before, 0);
        assert_eq!(servo.fault(0).map(|fault| fault.cause), Some(cause));
        assert_eq!(servo.counters().macrosteps, 900);
    }
}

#[test]
fn teams_barriers_and_their_stops_do_not_allocate() {
    let mut config = scripted::config(2);
    let mut partner = config.effectors[0].clone();
    partner.axes.iter_mut().for_each(|axis| axis.group = 1);
    config.effectors.push(partner);
    let groups = [(); 2].map(|()| {
        let (group, world) = scripted::group(2);
        let mut world = world.lock().expect("nobody else has it yet");
        world.log = false;
        world.axes.iter_mut().for_each(|drive| drive.state.homing = Homing::Attained);
        group
    });
    let (mut servo, mut links) = Servo::new(&config, groups.into()).expect("the configuration is sound");
    let mut now = Instant::ZERO;
    let mut run = |servo: &mut Servo, cycles| {
        for _ in 0..cycles {
            servo.step(now);
            now += scripted::PERIOD;
        }
    };
    let mut order = |order| links.iter_mut().for_each(|link| link.orders.push(order).expect("there is room"));
    // Back and forth by 0.01 rad.
    let step = |number: u64, speed: f64| Macrostep {
        number,
        steps: 10,
        report_at: 5,
        position: [0.01 * (number % 2) as f64; MAX_AXES],
        velocity: [if number % 2 == 1 { speed } else { -speed }; MAX_AXES],
        acceleration: None,
        torque: [0.0; MAX_AXES],
        law: None,
        continues_law: false,
    };
    order(Order::Enable);
    run(&mut servo, 20);
    let before = CALLS.with(Cell::get);
    let mut number = 0;
    for _ in 0..100 {
        order(Order::Meet { members: 0b11 });
        order(Order::Tie { members: 0b11 });
        for speed in [0.0, 0.0, 1.0] {
            number += 1;
            order(Order::Move(step(number, speed)));
        }
        // The last macrostep ends in motion and has no successor.
        run(&mut servo, 200);
        assert_eq!(servo.fault(1).map(|fault| fault.cause), Some(StopCause::Starved { last: number }));
        order(Order::ResetFault);
        order(Order::Enable);
        run(&mut servo, 50);
        assert_eq!(servo.state(0).map(|state| state.phase()), Some(Phase::Standing));
    }
    assert_eq!(CALLS.with(Cell::get) - before, 0);
    assert_eq!(servo.counters().macrosteps, 600);
}

#[test]
fn late_cycles_and_their_bookkeeping_do_not_allocate() {
    let _alone = alone();
    let mut config = scripted::config(2);
    config.max_missed_in_row = u32::MAX;
    let (group, world) = scripted::group(2);
    world.lock().expect("nobody else has it yet").log = false;
    let (servo, _links) = Servo::new(&config, vec![group]).expect("the configuration is sound");
    let (mut cycles, mut first) = (0, None);
    let counted = Arc::new(AtomicU64::new(u64::MAX));
    let so_far = Arc::clone(&counted);
    // The same on the servo thread.
    let between = move |next: Instant| {
        cycles += 1;
        let calls = CALLS.with(Cell::get);
        so_far.store(calls - *first.get_or_insert(calls), Ordering::Relaxed);
        // Late for the next cycle, and at times too late for some slots.
        let late = [100, 1300][cycles / 10 % 2];
        while cycles % 10 == 0 && now() < next + Duration::from_micros(late) {}
    };
    let mut turned = 0;
    let until = move |_: &Servo| {
        turned += 1;
        turned == 200
    };
    let realtime = thread::Realtime { lock_memory: false, ..thread::Realtime::PLAIN };
    let finished = thread::run(servo, realtime, thread::CellTime::Wall, between, until).expect("nothing is required");
    assert!(finished.timing.late.count() >= 20, "{finished:?}");
    assert!(finished.servo.counters().missed_cycles >= 10);
    assert_eq!(counted.load(Ordering::Relaxed), 0);
}

#[test]
fn homing_by_the_servo_does_not_allocate() {
    let mut config = scripted::host_config(2);
    config.effectors[0].homing_timeout = Duration::from_secs(20);
    let leg = |velocity, distance| HomingLeg { velocity, distance, timeout: Duration::from_secs(5) };
    for axis in &mut config.effectors[0].axes {
        axis.homing = Some(HostHoming {
            direction: Direction::Negative,
            search: leg(15.0, 20.0),
            zero: leg(3.5, 8.0),
            acceleration: 300.0,
            pause: Duration::from_millis(10),
            debounce: 3,
            reverse_at_limit: true,
        });
    }
    let (group, world) = scripted::group(2);
    {
        let mut world = world.lock().expect("nobody else has it yet");
        world.log = false;
        for drive in &mut world.axes {
            drive.home_below = Some(-5.0);
            drive.index = -3.0;
        }
    }
    let (mut servo, mut links) = Servo::new(&config, vec![group]).expect("the configuration is sound");
    let mut now = Instant::ZERO;
    let mut run = |servo: &mut Servo, cycles| {
        for _ in 0..cycles {
            servo.step(now);
            now += scripted::PERIOD;
        }
    };
    let orders = &mut links[0].orders;
    orders.push(Order::Enable).expect("the queue is empty");
    run(&mut servo, 20);
    let before = CALLS.with(Cell::get);
    orders.push(Order::Home).expect("the queue is empty");
    run(&mut servo, 5000);
    assert_eq!(CALLS.with(Cell::get) - before, 0);
    assert!(servo.homing_offsets(0).all(|offset| offset.is_some()));
    assert_eq!(servo.state(0).map(|state| state.phase()), Some(Phase::Standing));
}
