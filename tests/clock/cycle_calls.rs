//! System calls of the servo thread in its cycles, counted by strace in real runs of `mrroc run`.
//!
//! Three methods together prove that a cycle neither allocates nor locks nor waits. A cycle also makes no system calls
//! except three: the exchange with its bus, the wait for the next cycle, and the read of the kernel's account that
//! explains late cycles. The account is read after the exchange.
//!
//! - This file observes **every system call** of the thread, from its first wait to its last. Bring-up and the end of
//!   the thread are left out. Homing, motion, file output and winding down are included. A contended lock appears as
//!   `futex`, and a request for more memory as `brk` or `mmap`. A free lock makes no system call. An allocation from
//!   memory that the allocator already holds makes none either.
//! - `tests/system/heap.rs` counts **every use of the heap**: in every cycle of every robot that these tests step in lockstep,
//!   and in a servo thread ([`crate::heap`]). This method covers only the paths that the tests take, and does not detect locks.
//! - `tests/realtime-sanitizer` runs the program and observes all functions of a cycle for **library calls that may
//!   wait**: the heap, the locks of the C library, the futexes of Rust's standard library, files, sockets and sleeps.
//!   It names the place of a call, and needs a nightly compiler. It does not detect a free lock of Rust's standard
//!   library, which is an atomic operation.
//!
//! No run proves the branches that it does not take. Other tests cover all branches of a cycle.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use kit::mrroc::{self, Directory, Output, Running, shorten};
use kit::{PERIOD, by_the_clock, processors};
use serde_json::Value;
use servo::thread::Wait;

use crate::vcan::on_stage;

/// The call that waits for the next cycle.
const WAIT: &str = "clock_nanosleep";

/// The calls that read the kernel's account of the thread, only in the slack of a cycle. Each read makes one call of
/// each, and the report counts the reads.
const OF_THE_ACCOUNT: [&str; 2] = ["getrusage", "pread64"];

/// Clock sources that the vDSO of the kernel reads without a system call. With any other source, such as that of
/// user-mode Linux, `clock_gettime` is a system call.
const WITHOUT_A_CALL: [&str; 4] = ["tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter"];

/// Additional calls when a serial line is ended: each of five drives that loses its power discards the bytes that wait
/// in its line. Each drive may do so repeatedly.
const OF_LINES_WITHOUT_POWER: (&str, u64) = ("ioctl", 20);

/// Number of system calls by name.
type Calls = BTreeMap<String, u64>;

/// System calls of the thread `servo`, from its first wait to its last, in a log of `strace -f`.
fn of_the_cycles(log: &Path) -> Vec<String> {
    let log = fs::read_to_string(log).expect("strace wrote its log");
    let name = log.lines().find(|line| line.contains("prctl(PR_SET_NAME, \"servo\""));
    let thread = name.expect("a thread is called servo").split(' ').next();
    let of_thread = |line: &&str| line.split(' ').next() == thread;
    // The second part of an interrupted call begins with `<...`, an exit with `+++`.
    let call = |line: &'_ str| {
        let (_, call) = line.split_once(' ')?;
        let (name, _) = call.trim_start().split_once('(')?;
        name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_').then(|| name.to_owned())
    };
    let calls: Vec<String> = log.lines().filter(of_thread).filter_map(call).collect();
    let first = calls.iter().position(|name| name == WAIT).expect("it waits");
    let last = calls.iter().rposition(|name| name == WAIT).expect("it waits");
    calls[first..=last].to_vec()
}

fn counted(calls: &[String]) -> Calls {
    let mut found = Calls::new();
    for name in calls {
        *found.entry(name.clone()).or_default() += 1;
    }
    found
}

/// Number of reads of the account between a wait and the exchange that follows it.
fn reads_before_sync(calls: &[String], exchange: &[(&str, u64)]) -> usize {
    let cycles = calls.split(|name| name == WAIT);
    let before = cycles.map(|cycle| {
        let exchanged = |name: &String| exchange.iter().any(|(call, _)| call == name);
        let sent = cycle.iter().rposition(exchanged).unwrap_or(0);
        let read = |name: &&String| OF_THE_ACCOUNT.contains(&name.as_str());
        cycle[..sent].iter().filter(read).count()
    });
    before.sum()
}

/// Calls beyond the permitted ones. Permitted are the wait, the calls of `exchange` up to their number per cycle, and
/// `reads` reads of the account.
fn surplus(calls: &Calls, exchange: &[(&str, u64)], cycles: u64, missed: u64, reads: u64) -> Vec<String> {
    let clock = fs::read_to_string("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let clock_is_called = !clock.is_ok_and(|clock| WITHOUT_A_CALL.contains(&clock.trim()));
    let allowed = |name: &str| {
        let per_cycle = exchange.iter().find(|(call, _)| *call == name);
        match per_cycle {
            // After missed deadlines, more frames may wait than one reading takes.
            Some((_, count)) if name == "recvmmsg" => count * cycles + missed,
            Some((_, count)) => count * cycles,
            // Each sequence of missed deadlines is followed by another wait.
            None if name == WAIT => cycles + missed + 1,
            None if name == "clock_gettime" && clock_is_called => u64::MAX,
            None if name == OF_LINES_WITHOUT_POWER.0 && exchange.iter().any(|(call, _)| *call == "write") => {
                OF_LINES_WITHOUT_POWER.1
            }
            None if OF_THE_ACCOUNT.contains(&name) => reads,
            None => 0,
        }
    };
    let surplus = calls.iter().filter(|(name, count)| **count > allowed(name));
    surplus.map(|(name, count)| format!("{count} × {name}")).collect()
}

/// Mean use of processors by a run under strace.
const PROCESSORS: f64 = 0.6;

/// Minimum number of cycles for a meaningful run.
const LEAST: u64 = 100;

/// Asserts that a run made no other calls, and prints the number of calls per cycle.
#[track_caller]
fn check(bench: &str, log: &Path, run: &Output, exchange: &[(&str, u64)]) {
    let report = run.json();
    let number = |value: &Value| value.as_u64().expect("a count");
    let cycles = number(&report["cycle"]["cycles"]);
    let missed = number(&report["cycle"]["missed"]);
    let account = &report["cycle"]["account"];
    let [disturbed, quiet, slack] = ["disturbed", "quiet", "slack"].map(|why| number(&account[why]));
    let reads = disturbed + quiet + slack;
    let in_order = of_the_cycles(log);
    let calls = counted(&in_order);
    let each: Vec<String> =
        calls.iter().map(|(name, count)| format!("{:.3} {name}", *count as f64 / cycles as f64)).collect();
    // On a busy host, drives in another process may answer too late for the arm. The run then covers the reaction to a
    // fault.
    let (outcome, each) = (&report["outcome"], each.join(", "));
    println!("{bench}: {outcome}, {cycles} cycles, {missed} missed, account {account}, per cycle {each}");
    assert!(cycles > LEAST, "{bench}: {report}");
    let surplus = surplus(&calls, exchange, cycles, missed, reads);
    assert!(surplus.is_empty(), "{bench}: {surplus:?} in {cycles} cycles");
    let late: u64 = report["cycle"]["causes"].as_object().expect("causes by name").values().map(number).sum();
    // Skipped cycles before a late cycle count as late too.
    assert!(disturbed <= cycles && late <= 2 * disturbed, "{report}");
    assert!(16 * quiet <= cycles - disturbed, "{report}");
    assert!(slack <= cycles, "{report}");
    for call in OF_THE_ACCOUNT {
        let count = calls.get(call).copied().unwrap_or(0);
        // One read before the first wait and one after the last wait may be missing in the log.
        assert!(count + 2 >= reads, "{bench}: {count} × {call}, {reads} reads");
    }
    assert_eq!(reads_before_sync(&in_order, exchange), 0, "{bench}");
    // The log is of the right thread, and strace lost no calls. A cycle sends nothing while frames of the cycle before wait.
    for call in exchange.iter().map(|(call, _)| *call).chain([WAIT]) {
        let held_back = if call == "sendmmsg" { cycles / 8 } else { 0 };
        assert!(calls.get(call).copied().unwrap_or(0) + held_back >= cycles - 1, "{bench}: {calls:?}");
    }
}

/// Runs `cell` with output files under strace.
fn run(directory: &Directory, cell: &Path, more: &[&str]) -> (PathBuf, Output) {
    let log = directory.path("calls");
    let record = directory.path("states.csv");
    let arguments = [
        "run".as_ref(),
        cell.as_os_str(),
        "--json".as_ref(),
        "--force".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ];
    let arguments = arguments.into_iter().chain(more.iter().map(AsRef::as_ref));
    let output = Running::under_strace(&log, mrroc::binary(), arguments).output();
    (log, output)
}

/// The emulated drives are simulated in the servo thread, between cycles, and make no system calls either.
#[test]
fn a_cycle_on_an_emulated_bus_makes_no_call_but_the_wait() {
    let directory = Directory::new();
    for (name, wait) in [("plain", Wait::Plain), ("hybrid", Wait::Hybrid)] {
        let cell = directory.cell("irb6", |cell| {
            shorten(cell);
            cell.realtime.wait = wait;
        });
        by_the_clock(PROCESSORS, PERIOD, || {
            let (log, output) =
                run(&directory, &cell, &[&format!("--trace={}", directory.path("trace.log").display())]);
            check(name, &log, &output, &[]);
        });
    }
}

#[test]
fn a_cycle_on_serial_lines_makes_one_call_each_way_per_line_and_the_wait() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", |cell| {
        shorten(cell);
        // Under strace, the answers of another process are late.
        cell.serial[0].tolerated_missing = 10;
        cell.serial[0].answer_timeout_ms = 500;
        cell.max_missed_in_row = 500;
    });
    let ttys = directory.path("ttys");
    let serial = format!("--serial={}", ttys.display());
    by_the_clock(PROCESSORS, PERIOD, || {
        let _ = fs::remove_dir_all(&ttys);
        let _emulator = emulate(&cell, &ttys);
        let (log, output) = run(&directory, &cell, &["--bench=card", &serial]);
        check("ttys", &log, &output, &[("read", 5), ("write", 5)]);
    });
}

/// Starts `mrroc emulate --serial` and waits until all its ttys exist.
pub(crate) fn emulate(cell: &Path, ttys: &Path) -> Running {
    processors::precede();
    let arguments = ["emulate".as_ref(), cell.as_os_str(), "--serial".as_ref(), ttys.as_os_str()];
    let emulator = Running::start(arguments);
    crate::vcan::wait_until("its ttys are there", || ttys.join("wrist-roll").exists());
    emulator
}

#[test]
fn a_cycle_on_a_can_bus_sends_once_receives_once_and_waits_once() {
    on_stage("cycle_calls::a_cycle_on_a_can_bus_sends_once_receives_once_and_waits_once", |stage| {
        let cell = stage.directory.path("cell.toml");
        let _emulators = stage.start_emulators();
        let (log, output) = run(&stage.directory, &cell, &["--bench=vcan", "--can", stage.interface]);
        check("vcan", &log, &output, &[("recvmmsg", 1), ("sendmmsg", 1)]);
    });
}

/// A free lock and a small allocation make no system call. The other two methods detect them.
#[test]
fn a_call_that_is_planted_in_the_cycle_is_found_by_its_name() {
    let _share = processors::take(0.4);
    let directory = Directory::new();
    let planting = mrroc::planted();
    for (planted, expected) in [("nothing", None), ("lock", Some("futex")), ("write", Some("write"))] {
        let log = directory.path("calls");
        let output = Running::under_strace(&log, &planting, [planted]).output();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let reads = output.stdout.trim().parse().expect("it says how often");
        let calls = counted(&of_the_cycles(&log));
        let found = surplus(&calls, &[], calls[WAIT], 0, reads);
        let named = found.iter().map(|found| found.split(' ').next_back());
        assert_eq!(named.collect::<Vec<_>>(), Vec::from_iter(expected.map(Some)), "{planted}");
    }
}

#[test]
fn a_read_of_the_account_counts_as_early_until_the_last_call_of_the_exchange() {
    let exchange = [("read", 1), ("write", 2)];
    for (calls, expected) in [
        ("wait read write write getrusage pread64 wait", 0),
        ("wait read write write getrusage getrusage wait wait read", 0),
        ("wait getrusage pread64 wait", 0),
        ("wait getrusage read write write wait", 1),
        ("wait read write getrusage pread64 write wait", 2),
    ] {
        let named = |name: &str| name.replace("wait", WAIT);
        let in_order: Vec<_> = calls.split(' ').map(named).collect();
        assert_eq!(reads_before_sync(&in_order, &exchange), expected, "{calls}");
    }
}
