//! Tests of the servo thread in real time.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};

use drive::Power;

use super::*;
use crate::scripted::{self, PERIOD, World};
use crate::servo::tests::accelerating;
use crate::{EffectorLink, Order, ServoConfig, ServoState, StopCause};

/// Two axes whose enabling waits for a busy host.
fn patient() -> ServoConfig {
    let mut config = scripted::config(2);
    config.effectors[0].enabling_timeout = Duration::from_secs(3_600);
    config
}

/// A servo ordered to switch its drives on. The host of a test may be very late.
fn rig() -> (Servo, EffectorLink, Arc<Mutex<World>>) {
    let mut config = patient();
    config.max_missed_in_row = u32::MAX;
    let (group, world) = scripted::group(2);
    let (servo, mut links) = Servo::new(&config, vec![group]).unwrap();
    let mut link = links.remove(0);
    link.orders.push(Order::Enable).unwrap();
    (servo, link, world)
}

fn is_standing(servo: &Servo) -> bool {
    servo.state(0) == Some(ServoState::Standing)
}

fn has_power(world: &Arc<Mutex<World>>) -> bool {
    let world = world.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    world.axes.iter().any(|drive| drive.state.power != Power::Off)
}

#[test]
fn a_run_ends_with_the_drives_off_and_every_cycle_timed() {
    for realtime in [Realtime::PLAIN, Realtime::default()] {
        let (servo, _link, world) = rig();
        let calls = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&calls);
        let mut last = Instant::ZERO;
        let between = move |next: Instant| {
            assert!(next.since(last) >= PERIOD);
            last = next;
            counted.fetch_add(1, Ordering::Relaxed);
        };
        let finished = run(servo, realtime, CellTime::Wall, between, is_standing).unwrap();
        assert_eq!(finished.panicked, None);
        assert!(finished.servo.is_off() && !has_power(&world));
        let cycles = finished.servo.counters().cycles;
        assert!(cycles > 5);
        assert_eq!(finished.timing.sync.count(), cycles);
        assert_eq!(finished.timing.step.count(), cycles);
        assert_eq!(finished.timing.bus.count(), cycles);
        assert_eq!(u64::from(calls.load(Ordering::Relaxed)), cycles);
    }
}

#[test]
fn with_a_hybrid_wait_sync_leaves_at_the_deadline_however_long_preparing_takes() {
    let (servo, _link, world) = rig();
    let work = Duration::from_micros(30);
    world.lock().unwrap().work = work;
    let realtime = Realtime { spin_share: Some(0.5), ..Realtime::default() };
    let mut cycles = 0;
    let until = move |_: &Servo| {
        cycles += 1;
        cycles == 300
    };
    let finished = run(servo, realtime, CellTime::Wall, |_| {}, until).unwrap();
    let timing = finished.timing;
    assert!(timing.wait.preparation > work && timing.wait.margin > Duration::ZERO);
    assert!(timing.wait.spin_share > 0.0);
    // The host may be very late at times, but not in most cycles.
    assert!(timing.sync.quantile(0.5) < work, "{:?}", timing.sync);
}

#[test]
fn a_panic_of_the_caller_brakes_and_switches_off() {
    let (servo, _link, world) = rig();
    let until = |servo: &Servo| {
        if is_standing(servo) { panic!("scripted") } else { false }
    };
    let finished = run(servo, Realtime::PLAIN, CellTime::Wall, |_| {}, until).unwrap();
    assert_eq!(finished.panicked, Some(Panicked::Caller));
    assert!(finished.servo.is_off() && !has_power(&world));
    assert_eq!(finished.servo.cell_state(), CellState::Off);
}

/// Runs until the effector stands; then `panics` cycles panic.
fn with_panics(panics: u32) -> (Finished, EffectorLink, Arc<Mutex<World>>) {
    let (servo, link, world) = rig();
    let script = Arc::clone(&world);
    let mut scripted = false;
    let until = move |servo: &Servo| {
        if is_standing(servo) && !scripted {
            scripted = true;
            script.lock().unwrap().panics = panics;
        }
        false
    };
    let finished = run(servo, Realtime::PLAIN, CellTime::Wall, |_| {}, until).unwrap();
    (finished, link, world)
}

#[test]
fn after_a_panic_of_one_cycle_the_next_cycles_brake_and_switch_off() {
    let (finished, _link, world) = with_panics(1);
    assert_eq!(finished.panicked, Some(Panicked::Cycle));
    assert!(finished.servo.is_off() && !has_power(&world));
}

#[test]
fn a_second_panic_of_a_cycle_takes_the_power() {
    let (finished, _link, world) = with_panics(2);
    assert_eq!(finished.panicked, Some(Panicked::TwoCycles));
    assert!(!has_power(&world));
}

#[test]
fn a_thread_that_comes_back_after_its_starter_has_left_sends_nothing_and_ends() {
    for in_cycle in [false, true] {
        let (servo, _link, world) = rig();
        world.lock().unwrap().log = true;
        let (tell, told) = mpsc::channel();
        let (free, freed) = mpsc::channel::<()>();
        let mut calls = 0;
        let between = move |_: Instant| {
            calls += 1;
            if calls == 5 {
                tell.send(()).unwrap();
                freed.recv().unwrap();
            }
            assert!(calls <= 5, "called again");
        };
        let running = start(servo, Realtime::PLAIN, CellTime::Wall, Arc::default(), between, |_| false).unwrap();
        told.recv().unwrap();
        assert_eq!(running.cycles(), 5);
        let held = world.lock().unwrap();
        let sent = held.sent.len();
        if in_cycle {
            // The drives do not return from the next call.
            free.send(()).unwrap();
            sleep_until(now() + 5 * PERIOD);
        }
        assert_eq!(running.cycles(), 5);
        running.leave();
        drop(held);
        let _ = free.send(());
        assert_eq!(told.recv(), Err(mpsc::RecvError), "the thread ends");
        assert_eq!(world.lock().unwrap().sent.len(), sent, "in a cycle: {in_cycle}");
    }
}

#[test]
fn a_stop_that_is_not_over_in_time_ends_without_power() {
    let (servo, mut link, world) = rig();
    world.lock().unwrap().axes.iter_mut().for_each(|drive| drive.homing_takes = 1);
    link.orders.push(Order::Home).unwrap();
    // From 50 rad/s at 1000 rad/s² the stop takes 50 cycles.
    accelerating(500.0, 20, 30).into_iter().for_each(|step| link.orders.push(Order::Move(step)).unwrap());
    let slow = Arc::clone(&world);
    let until = move |servo: &Servo| {
        let moving = link.latest.read().commanded_velocity[0] > 50.0;
        if moving {
            // Each cycle takes 100 periods from now on.
            slow.lock().unwrap().work = 100 * PERIOD;
        }
        moving || servo.fault(0).is_some()
    };
    let finished = run(servo, Realtime::PLAIN, CellTime::Wall, |_| {}, until).unwrap();
    let state = finished.servo.state(0);
    assert!(matches!(state, Some(ServoState::Braking(_))), "the stop is under way: {state:?}");
    assert!(!has_power(&world));
    assert_eq!(finished.servo.cell_state(), CellState::Cut);
}

#[test]
fn missed_slots_are_skipped_and_never_caught_up() {
    let (servo, _link, _world) = rig();
    let mut cycles = 0;
    let mut last = Instant::ZERO;
    let between = move |next: Instant| {
        let due = next - PERIOD;
        assert!(due > last, "a slot was used twice");
        last = due;
        cycles += 1;
        if cycles == 5 {
            // Work that takes three periods too long.
            sleep_until(now() + 4 * PERIOD);
        }
    };
    let finished = run(servo, Realtime::PLAIN, CellTime::Wall, between, is_standing).unwrap();
    assert_eq!(finished.panicked, None);
    assert!(finished.servo.counters().missed_cycles >= 3);
}

/// Time added to `CLOCK_BOOTTIME` by the next test, ns.
static SUSPENDED: AtomicU64 = AtomicU64::new(0);

#[test]
fn a_suspension_of_the_machine_stops_the_effectors_as_an_overrun() {
    // More than the three tolerated deadlines, and fewer.
    for (suspended, stops) in [(Duration::from_secs(7_200), true), (3 * PERIOD, false)] {
        let mut config = patient();
        config.max_missed_in_row = 1_000_000;
        let (group, _world) = scripted::group(2);
        let (servo, mut links) = Servo::new(&config, vec![group]).unwrap();
        links[0].orders.push(Order::Enable).unwrap();
        let mut run = Run::new(servo, &Realtime::PLAIN, CellTime::Wall, Arc::default(), Arc::default());
        SUSPENDED.store(0, Ordering::Relaxed);
        run.since_boot = || since_boot() + Duration::from_nanos(SUSPENDED.load(Ordering::Relaxed));
        let mut cycles = 0;
        let until = move |servo: &Servo| {
            if is_standing(servo) {
                cycles += 1;
                SUSPENDED.store(suspended.as_nanos() as u64, Ordering::Relaxed);
            }
            cycles == 10 || servo.fault(0).is_some()
        };
        run.go(|_| {}, until);
        let missed = run.servo.counters().missed_cycles;
        // A delay between the readings of the clocks divides a suspension in two parts, each of which is rounded.
        assert!(missed + 1 >= suspended.as_nanos() as u64 / PERIOD.as_nanos() as u64, "{missed}");
        let overrun = matches!(run.servo.fault(0).map(|fault| fault.cause), Some(StopCause::Overrun { .. }));
        assert_eq!(overrun, stops, "{:?}", run.servo.fault(0));
        assert!(run.servo.is_off());
    }
}

#[test]
fn nominal_time_stands_still_while_deadlines_are_missed() {
    let (mut config, (group, _world)) = (scripted::config(2), scripted::group(2));
    config.max_missed_in_row = 0;
    let (servo, mut links) = Servo::new(&config, vec![group]).unwrap();
    links[0].orders.push(Order::Enable).unwrap();
    let first = Instant::from_nanos(7);
    let mut expected = first;
    let between = move |next: Instant| {
        expected += PERIOD;
        assert_eq!(next, expected);
        if next == first + 5 * PERIOD {
            sleep_until(now() + 4 * PERIOD);
        }
    };
    let time = CellTime::Nominal(first);
    let finished = run(servo, Realtime::PLAIN, time, between, is_standing).unwrap();
    assert_eq!(finished.panicked, None);
    assert_eq!(finished.servo.fault(0), None);
    assert!(finished.servo.counters().missed_cycles >= 3);
}

#[test]
fn a_thread_that_does_not_begin_is_an_error() {
    let (tell, told) = sync_channel(1);
    let waited = Duration::from_millis(1);
    assert_eq!(first_denial(&told, waited), Err(StartError::Silent { waited }));
    tell.send(None).unwrap();
    assert_eq!(first_denial(&told, waited), Ok(None));
}

#[test]
fn what_is_required_and_denied_is_named_before_any_cycle() {
    // No host has this priority or these CPUs.
    for (priority, cpu) in [(100, None), (80, Some(1023)), (80, Some(usize::MAX))] {
        let (servo, _link, world) = rig();
        let realtime = Realtime { policy: Policy::Require, priority, cpu, lock_memory: false, ..Realtime::PLAIN };
        let refused = start(servo, realtime, CellTime::Wall, Arc::default(), |_| {}, |_| true).unwrap_err();
        let StartError::Denied(denial) = refused else { panic!("{refused}") };
        assert!(world.lock().unwrap().sent.is_empty());
        match denial {
            Denial::Cpu { cpu: denied, .. } => assert_eq!(Some(denied), cpu),
            Denial::Fifo { .. } => assert!(denial.to_string().contains("rtprio"), "{denial}"),
            Denial::FifoInGroup { .. }
            | Denial::Deadline { .. }
            | Denial::LockMemory { .. }
            | Denial::TimerSlack { .. }
            | Denial::CpuLatency { .. } => panic!("{denial}"),
        }
    }
}

#[test]
#[expect(unsafe_code, reason = "what a thread has is the kernel's to tell")]
fn a_thread_really_has_what_was_not_denied() {
    let has = || {
        // SAFETY: both calls concern this thread, take numbers and touch no memory.
        let (scheduler, slack) = unsafe { (libc::sched_getscheduler(0), libc::prctl(libc::PR_GET_TIMERSLACK)) };
        let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
        let field = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name));
            line.unwrap().trim().to_owned()
        };
        let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
        // Field 40 of proc_pid_stat(5). The name in brackets is the second field.
        let priority = stat.rsplit(')').next().unwrap().split_whitespace().nth(37);
        let priority = priority.unwrap().parse::<u8>().unwrap();
        let locked = field("VmLck:") != "0 kB";
        (scheduler, priority, slack, field("Cpus_allowed_list:"), locked)
    };
    let (tell, told) = mpsc::channel();
    let until = move |_: &Servo| {
        let child = std::thread::spawn(has).join().unwrap();
        let _ = tell.send((has(), child.0));
        true
    };
    let realtime = Realtime { priority: 42, cpu: Some(0), ..Realtime::PLAIN };
    let (servo, _link, _world) = rig();
    let finished = run(servo, realtime, CellTime::Wall, |_| {}, until).unwrap();
    let ((scheduler, priority, slack, cpus, locked), child) = told.recv().unwrap();
    let granted = |which: fn(&Denial) -> bool| !finished.denied.iter().any(which);
    let fifo = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    let is_fifo = (scheduler, priority) == (fifo, 42);
    let denied_fifo = |one: &Denial| matches!(one, Denial::Fifo { .. } | Denial::FifoInGroup { .. });
    assert_eq!(is_fifo, granted(denied_fifo), "{scheduler:#x} {priority}");
    assert_eq!(child, libc::SCHED_OTHER, "a child does not inherit it");
    // Linux 6.13 and later give a real-time thread no timer slack.
    assert_eq!(slack <= 1, granted(|one| matches!(one, Denial::TimerSlack { .. })));
    assert_eq!(cpus == "0", granted(|one| matches!(one, Denial::Cpu { .. })), "{cpus}");
    assert!(locked || !granted(|one| matches!(one, Denial::LockMemory { .. })));
}

/// The result of sched_getattr(2) for the calling thread.
#[expect(unsafe_code, reason = "what a thread has is the kernel's to tell")]
fn scheduling() -> libc::sched_attr {
    // SAFETY: a sched_attr consists of plain numbers, and the call fills at most the given number of bytes.
    unsafe {
        let mut attr: libc::sched_attr = std::mem::zeroed();
        let size = size_of::<libc::sched_attr>();
        let result = libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attr, size, 0);
        assert_eq!(result, 0);
        attr
    }
}

#[test]
fn a_deadline_thread_has_its_budget_and_starts_others_without_it() {
    let (tell, told) = mpsc::channel();
    let mut cycles = 0;
    let until = move |_: &Servo| {
        let child = std::thread::spawn(scheduling).join().unwrap();
        let _ = tell.send((scheduling(), child));
        cycles += 1;
        cycles == 5
    };
    let realtime = Realtime { scheduler: Scheduler::Deadline, ..Realtime::default() };
    let (servo, _link, _world) = rig();
    let finished = run(servo, realtime, CellTime::Wall, |_| {}, until).unwrap();
    let (found, child) = told.recv().unwrap();
    assert_eq!(child.sched_policy, libc::SCHED_OTHER as u32);
    let denial = (finished.denied.iter()).find(|one| matches!(one, Denial::Deadline { .. }));
    let nanos = PERIOD.as_nanos() as u64;
    match denial {
        None => {
            assert_eq!(found.sched_policy, libc::SCHED_DEADLINE as u32);
            assert_eq!(found.sched_flags, libc::SCHED_FLAG_RESET_ON_FORK as u64);
            let times = [found.sched_runtime, found.sched_deadline, found.sched_period];
            assert_eq!(times, [nanos / 10 * 9, nanos, nanos]);
        }
        Some(denial) => {
            assert_eq!(found.sched_policy, libc::SCHED_OTHER as u32);
            let said = denial.to_string();
            assert!(["cap_sys_nice", "have reserved", "seccomp"].iter().any(|way| said.contains(way)), "{said}");
        }
    }
}

#[test]
fn a_denied_deadline_says_what_would_grant_it() {
    // A thread on one CPU of several is refused like one without the capability; no host has a period of 1 h.
    let on_one_cpu = Realtime { scheduler: Scheduler::Deadline, cpu: Some(0), lock_memory: false, ..Realtime::PLAIN };
    let on_any = Realtime { cpu: None, ..on_one_cpu };
    let too_long = Duration::from_secs(3600);
    let several = std::fs::read_to_string("/sys/devices/system/cpu/online").unwrap().trim() != "0";
    for (policy, period, needles) in [
        (on_one_cpu, PERIOD, ["cap_sys_nice+ep", "cap_sys_nice+ep"]),
        // The kernel looks at the capability after the period, and a filter before both.
        (on_any, too_long, ["sched_deadline_period_min_us", "seccomp"]),
    ] {
        let denied = std::thread::spawn(move || demand(&policy, period)).join().unwrap();
        let said = denied.iter().find(|one| matches!(one, Denial::Deadline { .. }));
        match said.map(ToString::to_string) {
            Some(said) => assert!(needles.iter().any(|needle| said.contains(needle)), "{said}"),
            None => assert!(!several && policy.cpu.is_some(), "{policy:?}"),
        }
    }
}
