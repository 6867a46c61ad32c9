//! The guardian of serial lines: `mrroc run` in a process of its own fails in motion, and the drives of the emulator are
//! stopped within a bound.
//!
//! The emulator is in this process, so that the true angles of the motors can be read in the time of the emulator.
//! `cargo test --release -p mrroc-tests guarded_20 -- --ignored --nocapture` makes 20 tries of each failure and prints figures.

use std::fmt;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use ::mrroc::bench::emulated_lines::EmulatedLines;
use ::mrroc::bench::plants::EmulatedCell;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::guardian::NAME;
use can::{Instant, clock};
use hil::{AxisController, Cabinet, LineId, Pty, World};
use kit::mrroc::{Directory, Running, SERIAL_CELLS};
use kit::{by_the_clock, processors};

use crate::hang::Hang;
use crate::serial_cli::{emulate, patient, run_arguments};

/// Permitted silence, ms, on a host with other load.
const SILENCE_MS: u32 = 20;

/// Mean use of processors, and the shortest delay that disturbs a run before its failure: more missed deadlines than the
/// cell permits.
const PROCESSORS: f64 = 0.45;
const UNBEARABLE: Duration = Duration::from_millis(6);

/// A motor that moves by less than this is at a standstill, rad. The gears reduce by about 150.
const STILL: f64 = 0.1;

/// Ways in which a run fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Failure {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT after this time.
    Pause(Duration),
    /// The servo thread hangs until the end of the run.
    Hang,
    /// The guardian is killed.
    Unguarded,
    /// SIGKILL to the run and all its descendants, with a guardian that another process started.
    KillAll,
}

const FAILURES: [Failure; 7] = [
    Failure::Kill,
    Failure::KillAll,
    Failure::Pause(Duration::from_millis(30)),
    Failure::Pause(Duration::from_millis(400)),
    Failure::Pause(Duration::from_secs(5)),
    Failure::Hang,
    Failure::Unguarded,
];

/// The true state of the emulated robot at a time.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) wall: Instant,
    /// Time of the emulator.
    pub(crate) at: Instant,
    /// Motor angles, rad.
    pub(crate) motors: Vec<f64>,
    /// A drive is in its error state.
    pub(crate) error: bool,
    /// Number of bytes that hosts sent to all drives on serial lines, or of messages of the host on a bus.
    pub(crate) bytes: u64,
}

/// The emulated drives of a cell.
pub(crate) struct Emulator {
    pub(crate) samples: Arc<Mutex<Vec<Sample>>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    pub(crate) fn start(file: &CellFile, ttys: &Path) -> Self {
        let emulated = EmulatedCell::of(file);
        let mut lines = EmulatedLines::default();
        let cabinet = Cabinet::default();
        fs::create_dir(ttys).expect("a directory of a new name");
        let mut ids = Vec::new();
        for axis in file.cell.axes_on(0) {
            let pty = Pty::linked(&ttys.join(file.axis_name(axis.0, axis.1))).expect("a pseudo-terminal");
            let id = emulated.add_axis_controller(&mut lines.world, 0, axis, &cabinet);
            let line = lines.world.host_line(id, 4096);
            lines.add_line(line, pty);
            ids.push(id);
        }
        let angle = |world: &World, id: &LineId| {
            let drive = world.line(*id).device::<AxisController>().expect("an axis controller");
            drive.axis().angle()
        };
        let observe = move |world: &World, at: Instant| {
            let motors = ids.iter().map(|id| angle(world, id)).collect();
            let bytes = ids.iter().map(|id| world.line(*id).statistics().to_device).sum();
            Sample { wall: clock::now(), at, motors, error: cabinet.has_error(), bytes }
        };
        Self::serve(lines, observe)
    }

    /// Serves `lines` on a thread of its own, with a sample at each advance.
    pub(crate) fn serve(
        mut lines: EmulatedLines,
        mut sample: impl FnMut(&World, Instant) -> Sample + Send + 'static,
    ) -> Self {
        // The emulator is as urgent as the programs of the test.
        processors::precede();
        let samples = Arc::new(Mutex::new(Vec::new()));
        let over = Arc::new(AtomicBool::new(false));
        let (kept, ended) = (samples.clone(), over.clone());
        let observe = move |world: &World, at: Instant| kept.lock().expect("no panic").push(sample(world, at));
        let serve = move || lines.serve_observed(&ended, observe).expect("the lines can be served");
        Self { samples, over, thread: Some(std::thread::spawn(serve)) }
    }

    /// Waits until no motor has moved for half a second, and returns all samples since `since`.
    pub(crate) fn at_rest(&self, since: Instant) -> Vec<Sample> {
        const REST: Duration = Duration::from_millis(500);
        let end = clock::now() + Duration::from_secs(30);
        loop {
            clock::sleep_until(clock::now() + REST);
            let samples = self.samples.lock().expect("no panic");
            let last = samples.last().expect("samples").clone();
            // The last sample before the half second counts too: on a busy host, there may be no sample for a while.
            let before = samples.partition_point(|sample| last.at.since(sample.at) >= REST);
            if before > 0 && samples[before - 1..].iter().all(|sample| !moved(sample, &last)) {
                return samples.iter().filter(|sample| sample.wall >= since).cloned().collect();
            }
            assert!(clock::now() < end, "the motors do not come to rest: {last:?}");
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A failed emulator has failed the test.
            let _ = thread.join();
        }
    }
}

pub(crate) fn moved(a: &Sample, b: &Sample) -> bool {
    a.motors.iter().zip(&b.motors).any(|(a, b)| (a - b).abs() > STILL)
}

/// Figures of one failure.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Figures {
    /// Time from the last sign of the controller to the first drive in its error state.
    pub(crate) reaction: Duration,
    /// Time from the last sign of the controller to standstill.
    pub(crate) standstill: Duration,
    /// Greatest distance of a joint meanwhile, degrees.
    pub(crate) distance: f64,
    /// Greatest motor velocity at the failure, rad/s.
    pub(crate) velocity: f64,
}

impl Figures {
    pub(crate) fn worst(self, other: Self) -> Self {
        Self {
            reaction: self.reaction.max(other.reaction),
            standstill: self.standstill.max(other.standstill),
            distance: self.distance.max(other.distance),
            velocity: self.velocity.max(other.velocity),
        }
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { reaction, standstill, distance, velocity } = self;
        write!(
            f,
            "error state after {reaction:.1?}, still after {standstill:.1?}, {distance:.2}°, from {velocity:.0} rad/s"
        )
    }
}

/// Figures of `samples` for a failure at `event`.
pub(crate) fn figures(file: &CellFile, samples: &[Sample], event: Instant) -> Figures {
    let arm = &file.arms[0];
    let joints = |sample: &Sample| {
        let mut motors = [0.0; 8];
        motors[..sample.motors.len()].copy_from_slice(&sample.motors);
        arm.joints(&motors).expect("motors have joints")
    };
    let after = samples.iter().position(|sample| sample.wall >= event).expect("samples after the event");
    let (before, rest) = samples.split_at(after);
    let start = before.last().expect("a sample before the event");
    let (at, last) = (joints(start), samples.last().expect("samples"));
    let earlier = before.iter().rev().find(|sample| start.at.since(sample.at) >= Duration::from_millis(10));
    let velocity = earlier.map_or(0.0, |earlier| {
        let time = start.at.since(earlier.at).as_secs_f64();
        start.motors.iter().zip(&earlier.motors).map(|(a, b)| (a - b).abs() / time).fold(0.0, f64::max)
    });
    let distance = |sample: &Sample| joints(sample).iter().zip(&at).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let error = rest.iter().find(|sample| sample.error);
    let moving = rest.iter().rev().find(|sample| moved(sample, last)).unwrap_or(start);
    Figures {
        reaction: error.map_or(Duration::ZERO, |sample| sample.at.since(start.at)),
        standstill: moving.at.since(start.at),
        distance: rest.iter().map(distance).fold(0.0, f64::max).to_degrees(),
        velocity,
    }
}

/// The child of process `parent` with this name.
pub(crate) fn child_of(parent: u32, name: &str) -> Option<u32> {
    let processes = fs::read_dir("/proc").expect("Linux").flatten();
    let numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    numbers.into_iter().find(|pid| {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.split_once(") ").is_some_and(|(head, tail)| {
            head.ends_with(&format!("({name}")) && tail.split(' ').nth(1) == Some(&parent.to_string())
        })
    })
}

/// Whether child `pid` has ended. Its parent has not waited for it yet.
fn is_over(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).expect("a child");
    stat.rsplit_once(") ").is_some_and(|(_, tail)| tail.starts_with('Z'))
}

fn signal(pid: u32, name: &str) {
    let sent = Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status();
    assert!(sent.expect("kill").success(), "{name} to {pid}");
}

struct Rig<'a> {
    directory: &'a Directory,
    file: &'a CellFile,
    cell: &'a Path,
    emulator: &'a Emulator,
    ttys: &'a Path,
}

impl Rig<'_> {
    /// Lets a run fail in its cycle `rows` of motion.
    fn fails(&self, failure: Failure, rows: usize) -> Figures {
        let record = self.directory.path("record.csv");
        let _ = fs::remove_file(&record);
        self.emulator.samples.lock().expect("no panic").clear();
        let began = clock::now();
        let socket = self.directory.path("guardian");
        let separate = (failure == Failure::KillAll).then(|| {
            let guard = Running::start(["guard".as_ref(), socket.as_os_str()]);
            (guard, ["--guardian".as_ref(), socket.as_os_str()])
        });
        let options = separate.iter().flat_map(|(_, options)| options);
        let run = Running::start(run_arguments(self.cell, self.ttys, &record).iter().chain(options));
        let moving = ",wrist-roll,Moving,";
        let broken = |text: &str| text.contains(",Stopping,") || text.contains(",Faulted,");
        let began_to_move = run.ended_before(&record, |text| text.matches(moving).count() > rows || broken(text));
        assert_eq!(began_to_move, Ok(()), "the run ended before the failure");
        let record = fs::read_to_string(&record).expect("the record");
        assert!(!broken(&record), "the run stopped before the failure: {:?}", run.output());
        let guardian = child_of(run.id(), NAME);
        assert_eq!(guardian.is_some(), separate.is_none(), "{failure:?}");
        let event = clock::now();
        let mut hang = None;
        match failure {
            Failure::Kill | Failure::KillAll => run.signal("KILL"),
            Failure::Pause(time) => {
                run.signal("STOP");
                clock::sleep_until(clock::now() + time);
                run.signal("CONT");
            }
            Failure::Hang => hang = Some(Hang::of(run.id())),
            Failure::Unguarded => signal(guardian.expect("a child"), "KILL"),
        }
        let stands = self.emulator.at_rest(began);
        let ended = run.output();
        drop(hang);
        let after = self.emulator.at_rest(began);
        let teller = separate.map_or_else(|| ended.stderr.clone(), |(guard, _)| guard.output().stderr);
        let told = match failure {
            Failure::Kill | Failure::KillAll => {
                Some("the controller has ended without switching its drives off: the guardian put all")
            }
            Failure::Pause(_) | Failure::Hang => Some("mrroc: no servo cycle: the guardian put all"),
            Failure::Unguarded => None,
        };
        assert!(told.is_none_or(|told| teller.contains(told)), "{failure:?}: {teller}, {ended:?}");
        let (rested, last) = (stands.last().expect("samples"), after.last().expect("samples"));
        if failure == Failure::Unguarded {
            assert!(ended.json()["faults"][0]["what"].as_str().unwrap().contains("guardian"), "{ended:?}");
        } else if !matches!(failure, Failure::Kill | Failure::KillAll) {
            let first = ended.json()["faults"][0].to_string();
            assert!(first.contains("no servo cycle for"), "{first}");
            assert!(!moved(rested, last), "the robot moved again");
        }
        let event = match failure {
            Failure::Kill | Failure::KillAll | Failure::Unguarded => event,
            Failure::Pause(_) | Failure::Hang => last_telegram(&after),
        };
        figures(self.file, &after, event)
    }
}

/// Time of the last telegram of the controller before the first error state.
fn last_telegram(samples: &[Sample]) -> Instant {
    /// Longest time on the line of the telegram that leads to the error state.
    const ON_LINE: Duration = Duration::from_millis(3);
    // The drives may begin in the error state, in which the failure before left them.
    let mut pairs = samples.windows(2);
    let begins = pairs.find(|pair| !pair[0].error && pair[1].error);
    let error = begins.expect("an error state")[1].at;
    let pairs = samples.windows(2).rev();
    let mut changes = pairs.filter(|pair| pair[0].bytes != pair[1].bytes).map(|pair| &pair[1]);
    changes.find(|sample| sample.at < error && error.since(sample.at) > ON_LINE).expect("telegrams before").wall
}

/// Tries every failure `tries` times on a cell whose guardian permits `silence`.
fn guarded(name: &str, silence: Option<u32>, tries: usize) {
    let directory = Directory::new();
    let cell = directory.cell(name, |cell: &mut Cell| {
        patient(cell);
        cell.guardian_ms = silence;
        // As many as the permitted silence admits. Without disturbances, that is the silence of the example.
        cell.max_missed_in_row = silence.map_or(3, |silence| silence * 1000 / cell.period_us - 2);
        for axis in &mut cell.robot[0].axis {
            axis.following_error = 100.0;
        }
    });
    let file = CellFile::read(&cell).expect("the cell");
    let ttys = directory.path("ttys");
    let emulator = Emulator::start(&file, &ttys);
    let rig = Rig { directory: &directory, file: &file, cell: &cell, emulator: &emulator, ttys: &ttys };
    let permitted = file.cell.guardian_config().silence;
    for failure in FAILURES {
        let mut worst = Figures::default();
        for number in 0..tries {
            let figures = by_the_clock(PROCESSORS, UNBEARABLE, || {
                let figures = rig.fails(failure, 300 + 150 * (number % 8));
                println!("{failure:?}: {figures}");
                let latest = permitted + LATEST;
                assert!(failure == Failure::Unguarded || figures.reaction <= latest, "{failure:?}: {figures}");
                assert!(figures.standstill <= latest + RUN_OUT, "{failure:?}: {figures}");
                figures
            });
            worst = worst.worst(figures);
        }
        println!("{name}, {failure:?}, worst of {tries}: {worst}");
    }
}

/// Latest beginning of the stop after the permitted silence: a look of the guardian, a telegram, and delays by the host,
/// which runs other tests meanwhile.
const LATEST: Duration = Duration::from_millis(50);

/// Longest run-out of a motor whose power stage is open.
pub(crate) const RUN_OUT: Duration = Duration::from_millis(500);

#[test]
fn drives_of_a_run_that_fails_in_motion_are_stopped() {
    guarded("irb6-serial", Some(SILENCE_MS), 1);
}

/// A service that is bound to the guardian is stopped when the guardian ends, so the guardian ends after its controller.
#[test]
fn a_separate_guardian_serves_one_run_and_ends_after_it() {
    by_the_clock(PROCESSORS, UNBEARABLE, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", patient);
        let ttys = directory.path("ttys");
        let _emulator = emulate(&cell, &ttys);
        let (socket, record) = (directory.path("guardian"), directory.path("record.csv"));
        let guard = Running::start(["guard".as_ref(), socket.as_os_str()]);
        let options = ["--guardian".as_ref(), socket.as_os_str()];
        let run = Running::start(run_arguments(&cell, &ttys, &record).into_iter().chain(options));
        let moves = |text: &str| text.contains(",wrist-roll,Moving,");
        assert_eq!(run.ended_before(&record, moves), Ok(()), "{:?}", run.output());
        let second = Running::start(["guard".as_ref(), socket.as_os_str()]);
        run.signal("INT");
        while !is_over(run.id()) {
            assert!(!is_over(guard.id()), "the guardian ended before its controller");
        }
        let (ended, guarded) = (run.output(), guard.output());
        assert_eq!((ended.status.code(), guarded.status.code()), (Some(1), Some(0)), "{ended:?} {guarded:?}");
        assert_eq!(guarded.stderr, "", "no telegram, no message");
        second.signal("TERM");
        assert_ne!(second.output().status.code(), Some(0), "it waited for a run");
    });
}

#[test]
#[ignore = "twenty tries of each failure, for figures"]
fn guarded_20() {
    for name in SERIAL_CELLS {
        guarded(name, None, 20);
    }
}
