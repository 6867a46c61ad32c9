//! Processor time of the servo thread for six axis controllers on pseudo-terminals in a cycle of 2 ms, system calls
//! included. `cargo bench -p mrroc-drive --bench lines`
#![allow(unsafe_code, reason = "opening and polling pseudo-terminals takes system calls")]
#![allow(clippy::disallowed_methods, reason = "this measures time")]
#![allow(clippy::unwrap_used, reason = "a bench")]

#[path = "../tests/scripted.rs"]
mod scripted;

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, FromRawFd};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use mrroc_drive::axis_controller::{AxisConfig, AxisControllerGroup, Control, GroupConfig, Protocol};
use mrroc_drive::{AxisCommand, AxisState, DriveGroup, Finite, Scale, Setpoint};
use serial::{Line, Settings, Tty};

const AXES: usize = 6;
const PERIOD: Duration = Duration::from_millis(2);

fn pty() -> (File, PathBuf) {
    // SAFETY: the returned descriptor is new and owned here; the name fits its buffer.
    unsafe {
        let master = libc::posix_openpt(libc::O_RDWR | libc::O_NOCTTY | libc::O_CLOEXEC);
        assert!(master >= 0 && libc::grantpt(master) == 0 && libc::unlockpt(master) == 0);
        let mut name = [0; 64];
        assert_eq!(libc::ptsname_r(master, name.as_mut_ptr(), name.len()), 0);
        let name = std::ffi::CStr::from_ptr(name.as_ptr()).to_str().unwrap();
        (File::from_raw_fd(master), name.into())
    }
}

/// Answers requests until the host's end is closed.
fn emulate(mut masters: Vec<File>, protocol: Protocol) {
    let mut drives: Vec<scripted::Shared> = (0..AXES).map(|_| scripted::Drive::new(protocol, 8).shared()).collect();
    let mut polls: Vec<libc::pollfd> = masters
        .iter()
        .map(|master| libc::pollfd { fd: master.as_raw_fd(), events: libc::POLLIN, revents: 0 })
        .collect();
    let mut bytes = [0; 256];
    loop {
        // SAFETY: the count is the length of the array.
        if unsafe { libc::poll(polls.as_mut_ptr(), AXES as libc::nfds_t, 1_000) } <= 0 {
            return;
        }
        for (line, poll) in polls.iter().enumerate() {
            if poll.revents == 0 {
                continue;
            }
            let Ok(count) = masters[line].read(&mut bytes) else {
                return;
            };
            let now = can::Instant::ZERO;
            drives[line].drive().keep_heard = false;
            drives[line].write(now, &bytes[..count]).unwrap();
            let count = drives[line].read(now, &mut bytes).unwrap();
            masters[line].write_all(&bytes[..count]).unwrap();
        }
    }
}

fn measure(protocol: Protocol, cycles: usize) {
    let (masters, paths): (Vec<File>, Vec<PathBuf>) = (0..AXES).map(|_| pty()).unzip();
    let open = |path| Tty::open(path, Settings::AXIS_CONTROLLER).unwrap();
    let lines: Vec<Tty> = paths.iter().map(open).collect();
    let emulator = std::thread::spawn(move || emulate(masters, protocol));
    let axis = AxisConfig {
        address: 8,
        scale: Scale::new(4_000, 0.0).unwrap(),
        torque_constant: 0.105,
        control: Control::Pwm,
        max_current: 15.0,
        max_velocity: 100.0,
        max_acceleration: 10_000.0,
    };
    let config = GroupConfig { tolerated_missing: 100, ..GroupConfig::new(protocol) };
    let mut group = AxisControllerGroup::new(lines, config, &[axis; AXES]).unwrap();
    let began = Instant::now();
    let now = || can::Instant::from_nanos(1_000_000_000 + began.elapsed().as_nanos() as u64);
    while group.bring_up(now()).map(Result::unwrap).is_pending() {
        std::thread::sleep(PERIOD);
    }
    let mut states = [AxisState::default(); AXES];
    let mut costs = Vec::with_capacity(cycles);
    let mut walls = Vec::with_capacity(cycles);
    let mut deadline = Instant::now();
    for cycle in 0..cycles {
        deadline += PERIOD;
        std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
        let duty = Setpoint::Duty(Finite::new((cycle % 10) as f64 * 1e-3).unwrap());
        let command = match cycle {
            0..10 => AxisCommand::Stand,
            _ => AxisCommand::Follow(duty),
        };
        let (start, spent) = (Instant::now(), spent());
        group.read(now(), &mut states);
        group.write(now(), &[command; AXES]);
        group.send(now());
        costs.push(self::spent() - spent);
        walls.push(start.elapsed());
    }
    let missed = group.counters().missed_answers;
    drop(group);
    emulator.join().unwrap();
    println!("{protocol:?}: {AXES} lines, {cycles} cycles, {missed} answers missed");
    for (what, mut times) in [("processor time", costs), ("wall time", walls)] {
        times.sort_unstable();
        let at = |share: f64| times[((cycles - 1) as f64 * share) as usize];
        println!(
            "  {what}: median {:.1?}, 99 % {:.1?}, 99.9 % {:.1?}, greatest {:.1?}",
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0)
        );
    }
}

/// Processor time of this thread, independent of the load of the machine.
fn spent() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call fills a timespec.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

fn main() {
    let benched = std::env::args().any(|argument| argument == "--bench");
    for protocol in [Protocol::Nfv2, Protocol::HiMoxa] {
        measure(protocol, if benched { 10_000 } else { 100 });
    }
}
