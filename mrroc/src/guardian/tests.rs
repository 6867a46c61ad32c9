//! Tests of a guardian process, started from the test program itself, with a pseudo-terminal as its serial line.

use std::io::Read as _;
use std::os::fd::AsFd as _;

use can::Instant;
use hil::Pty;
use hil::pty::{self, Interest};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serial::{Settings, Tty};

use super::*;

const CONFIG: GuardianConfig =
    GuardianConfig { silence: Duration::from_millis(300), period: Duration::from_millis(2), priority: 1 };

const TELEGRAM: [u8; 4] = [7, 8, 9, 10];

/// Longest wait of a test.
const PATIENCE: Duration = Duration::from_secs(10);

struct Rig {
    drive: Pty,
    guardian: Guardian,
    stop: StopRequest,
    // Held open as the controller does.
    _line: Tty,
}

impl Rig {
    fn new() -> Self {
        let drive = Pty::open().expect("a pseudo-terminal");
        let line = Tty::open(drive.path(), Settings::AXIS_CONTROLLER).expect("its tty");
        let held = line.as_fd().try_clone_to_owned().expect("a descriptor");
        let guarded = GuardedLine { line: held, telegram: TELEGRAM.to_vec() };
        let guardian = Guardian::start(CONFIG, &[guarded], None, None).expect("a guardian");
        Self { drive, guardian, stop: StopRequest::default(), _line: line }
    }

    /// Reads whole telegrams until there are `count`.
    fn hears(&mut self, count: usize) {
        let mut heard = Vec::new();
        let end = clock::now() + PATIENCE;
        while heard.len() < count * TELEGRAM.len() {
            assert!(clock::now() < end, "{} bytes heard", heard.len());
            heard.extend(self.received(clock::now() + Duration::from_millis(100)));
        }
        assert!(heard.chunks_exact(TELEGRAM.len()).all(|telegram| telegram == TELEGRAM), "{heard:?}");
    }

    fn received(&mut self, until: Instant) -> Vec<u8> {
        let interest = Interest { read: true, write: false };
        pty::wait([(self.drive.as_fd(), interest)], until).expect("the pseudo-terminal can be waited for");
        let mut bytes = [0; 4096];
        let count = self.drive.read(&mut bytes).expect("the pseudo-terminal can be read");
        bytes[..count].to_vec()
    }
}

fn wait_until(mut holds: impl FnMut() -> bool, what: &str) {
    let end = clock::now() + PATIENCE;
    while !holds() {
        assert!(clock::now() < end, "{what}");
        clock::sleep_until(clock::now() + LOOK);
    }
}

#[test]
fn silence_of_the_servo_stops_the_drives_until_cycles_go_on() {
    let mut rig = Rig::new();
    let mut pulse = rig.guardian.pulse(rig.stop.clone());
    pulse.beat();
    assert_eq!(rig.guardian.look(&rig.stop), None);
    rig.hears(10);
    pulse.beat();
    assert!(rig.stop.is_requested());
    let stops = || rig.guardian.words.stops.load(Ordering::Relaxed);
    wait_until(
        || matches!(rig.guardian.fault(), Some(GuardianFault::Stopped { silence }) if silence >= CONFIG.silence),
        "fault",
    );
    assert_eq!(stops(), 1);
    // Telegrams of the silence before may still be on their way. With cycles they end.
    let last = clock::now() + PATIENCE;
    loop {
        assert!(clock::now() < last, "the telegrams do not end");
        pulse.beat();
        if rig.received(clock::now() + Duration::from_millis(20)).is_empty() {
            break;
        }
    }
}

#[test]
fn a_stop_by_the_guardian_is_found_while_the_servo_thread_hangs() {
    let mut rig = Rig::new();
    let mut pulse = rig.guardian.pulse(rig.stop.clone());
    pulse.beat();
    rig.hears(1);
    assert!(matches!(rig.guardian.look(&rig.stop), Some(GuardianFault::Stopped { .. })));
    assert!(rig.stop.is_requested());
    drop(pulse);
}

#[test]
fn a_stop_by_the_guardian_after_the_end_of_the_servo_thread_is_no_fault() {
    let mut rig = Rig::new();
    let mut pulse = rig.guardian.pulse(rig.stop.clone());
    pulse.beat();
    drop(pulse);
    rig.hears(1);
    assert_eq!(rig.guardian.look(&rig.stop), None);
    assert!(!rig.stop.is_requested());
}

#[test]
fn the_end_of_a_guardian_and_its_suspension_stop_all_robots() {
    for (signal, by_process) in [(Signal::SIGKILL, true), (Signal::SIGKILL, false), (Signal::SIGSTOP, false)] {
        let mut rig = Rig::new();
        let pid = rig.guardian.pid();
        let mut pulse = rig.guardian.pulse(rig.stop.clone());
        pulse.beat();
        kill(Pid::from_raw(pid as i32), signal).expect("the guardian is ours");
        let lost = Some(GuardianFault::Lost { pid });
        let stop = rig.stop.clone();
        wait_until(
            || {
                if !by_process {
                    pulse.beat();
                    return rig.guardian.fault() == lost;
                }
                rig.guardian.look(&stop) == lost
            },
            "the guardian is not missed",
        );
        assert!(rig.stop.is_requested());
    }
}

#[test]
fn signals_of_a_terminal_do_not_end_a_guardian() {
    let mut rig = Rig::new();
    let pid = Pid::from_raw(rig.guardian.pid() as i32);
    assert_ne!(nix::unistd::getpgid(Some(pid)), Ok(nix::unistd::getpgrp()), "a group of its own");
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP, Signal::SIGTSTP, Signal::SIGQUIT, Signal::SIGUSR1] {
        kill(pid, signal).expect("the guardian is ours");
    }
    let looks = rig.guardian.words.looks.load(Ordering::Relaxed);
    wait_until(|| rig.guardian.words.looks.load(Ordering::Relaxed) > looks + 10, "the guardian does not run");
    assert_eq!(rig.guardian.look(&rig.stop), None);
}

#[test]
fn the_end_of_a_controller_stops_the_drives_unless_they_are_off() {
    for (cycles, off, stops) in [(1, false, true), (1, true, false), (0, false, false)] {
        let mut rig = Rig::new();
        let mut pulse = rig.guardian.pulse(rig.stop.clone());
        (0..cycles).for_each(|_| pulse.beat());
        drop(pulse);
        if off {
            rig.guardian.all_off();
        }
        let Rig { mut drive, guardian, _line, .. } = rig;
        drop(guardian);
        // A kernel thread transfers the bytes. A line whose telegram is not read gets no other.
        let mut received = Vec::new();
        let mut hears = || {
            let mut bytes = [0; 4096];
            let count = drive.read(&mut bytes).expect("the pseudo-terminal can be read");
            received.extend_from_slice(&bytes[..count]);
            received.starts_with(&TELEGRAM)
        };
        if stops {
            wait_until(hears, "no telegram");
        } else {
            clock::sleep_until(clock::now() + Duration::from_millis(50));
            assert!(!hears() && received.is_empty(), "{cycles} cycles, off: {off}");
        }
    }
}

#[test]
fn lines_that_cannot_be_guarded_are_refused() {
    let refused = Guardian::start(CONFIG, &[], None, None).map(drop);
    assert_eq!(refused, Err(GuardianError::Lines { lines: 0 }));
    // A watchdog makes an invalid telegram no better.
    let (_device, written) = io::pipe().expect("a pipe");
    let watchdog = OwnedFd::from(written);
    for length in [0, 65] {
        let guarded = GuardedLine { line: watchdog.try_clone().expect("a pipe"), telegram: vec![0; length] };
        let refused = Guardian::start(CONFIG, &[guarded], Some(&watchdog), None).map(drop);
        assert_eq!(refused, Err(GuardianError::Lines { lines: 1 }), "{length} bytes");
    }
}

/// The bytes that are in `device` now.
fn take(device: &mut io::PipeReader) -> Vec<u8> {
    let mut bytes = vec![0; 1024];
    let count = device.read(&mut bytes).unwrap_or(0);
    bytes.truncate(count);
    bytes
}

/// The guardian writes to the watchdog before it ends, so all bytes are there after its end.
#[test]
fn a_watchdog_gets_a_byte_per_interval_and_is_switched_off_by_an_orderly_end_only() {
    for off in [true, false] {
        let (mut device, written) = io::pipe().expect("a pipe");
        nix::fcntl::fcntl(&device, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_NONBLOCK)).expect("a pipe");
        let mut guardian = Guardian::start(CONFIG, &[], Some(&OwnedFd::from(written)), None).expect("a guardian");
        let mut pulse = guardian.pulse(StopRequest::default());
        let mut count = 0;
        let mut fed = |device: &mut io::PipeReader, pulse: &mut Pulse, what: &str| {
            let before = count;
            wait_until(
                || {
                    pulse.beat();
                    count += take(device).len();
                    count >= before + 2
                },
                what,
            );
        };
        fed(&mut device, &mut pulse, "no bytes");
        if off {
            guardian.all_off();
            drop(guardian);
            assert_eq!(take(&mut device).last(), Some(&b'V'));
            continue;
        }
        // No cycle is completed any more, so the bytes end. Cycles that go on bring them back.
        let stops = || guardian.words.stops.load(Ordering::Relaxed);
        wait_until(|| stops() > 0, "no stop");
        take(&mut device);
        let looks = || guardian.words.looks.load(Ordering::Relaxed);
        let last = looks() + u64::try_from(250_000_000 / (CONFIG.period / 2).as_nanos()).expect("some looks");
        wait_until(|| looks() > last, "the guardian does not run");
        assert_eq!(take(&mut device), [0; 0], "bytes in a stop");
        fed(&mut device, &mut pulse, "no bytes after the stop");
        drop(guardian);
        assert!(!take(&mut device).contains(&b'V'));
    }
}

#[test]
fn the_nodes_of_a_guarded_bus_are_stopped_by_frames() {
    let (bus, socket) = std::os::unix::net::UnixDatagram::pair().expect("sockets");
    socket.set_nonblocking(true).expect("a socket");
    let guarded = GuardedLine { line: socket.into(), telegram: stop_of_all_nodes() };
    let guardian = Guardian::start(CONFIG, &[guarded], None, None).expect("a guardian");
    let mut pulse = guardian.pulse(StopRequest::default());
    pulse.beat();
    let mut frame = [0; 32];
    bus.set_read_timeout(Some(PATIENCE)).expect("a socket");
    for _ in 0..3 {
        let count = bus.recv(&mut frame).expect("a frame");
        // Identifier 0, two bytes: the command stop to all nodes.
        assert_eq!(frame[..count], [0, 0, 0, 0, 2, 0, 0, 0, 0x02, 0, 0, 0, 0, 0, 0, 0]);
    }
}
