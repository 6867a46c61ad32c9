//! Drives on CAN whose host dies, is suspended or hangs in motion: they stop by themselves, because each drive watches the
//! heartbeat and the set-points of the host. Each drive reports the silence by an EMCY. On a guarded bus, the guardian stops
//! all nodes before the drives stop by themselves.
//!
//! `mrroc run` is a process of its own, and the emulator is in this process: behind an slcan adapter, or on a virtual
//! interface. The true angles of the motors are read in the time of the emulator.
//! `cargo test --release -p mrroc-tests host_dies_20 -- --ignored --nocapture` makes 20 tries of each failure and prints figures.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Duration;

use ::mrroc::bench::bus_port::BusPort;
use ::mrroc::bench::emulated_lines::EmulatedLines;
use ::mrroc::bench::interfaces::Interface;
use ::mrroc::bench::plants::EmulatedCell;
use ::mrroc::cell::{Cell, CellFile};
use can::{Instant, Port, Received, clock};
use canopen::emcy::Emergency;
use canopen::sync::Sync;
use canopen::{NodeId, cob, nmt};
use hil::{BusId, Pty, World};
use kit::bench::in_uml;
use kit::by_the_clock;
use kit::mrroc::{Directory, Running, shorten};
use kit::processors::ALL;
use kit::slow;

use crate::guardian::{Emulator, Failure, Figures, RUN_OUT, Sample, figures, moved};
use crate::hang::Hang;

const FAILURES: [Failure; 5] = [
    Failure::Kill,
    Failure::Pause(Duration::from_millis(30)),
    Failure::Pause(Duration::from_millis(400)),
    Failure::Pause(Duration::from_secs(5)),
    Failure::Hang,
];

/// Time between two looks of the emulator at its world.
const GRAIN: Duration = Duration::from_millis(1);

/// Shortest delay that disturbs a run before its failure.
const UNBEARABLE: Duration = Duration::from_millis(10);

/// The way from the controller to the drives.
struct Wire {
    name: &'static str,
    /// Arguments of `mrroc run`.
    arguments: [String; 2],
    /// Shortest silence of a host that has failed. The host may delay a cycle by less.
    gap: Duration,
    /// Longest silence of the host until the drives detect the silence or receive the command of the guardian.
    silence: Duration,
    failures: &'static [Failure],
    /// Mean use of processors.
    processors: f64,
}

/// The emulated drives of CAN bus 0, which `connect` adds. A sample has an error if each drive has sent an EMCY. On a
/// guarded bus, a sample has an error instead if the last NMT command has stopped all nodes. The field `bytes` of a
/// sample counts the SYNC messages and heartbeats of the host.
fn emulator(file: &CellFile, connect: impl FnOnce(&mut EmulatedLines, &EmulatedCell) -> BusId) -> Emulator {
    let emulated = EmulatedCell::of(file);
    let mut lines = EmulatedLines::default();
    let bus = connect(&mut lines, &emulated);
    let mut listener = lines.world.host_port(bus, 1 << 12);
    let drives: Vec<_> = emulated.ids().drives.values().copied().collect();
    let sync = Sync::default().encode();
    let heartbeat = NodeId::new(file.cell.bus[0].host_node).map(cob::heartbeat);
    let guarded = file.cell.bus[0].guarded;
    let (mut signs, mut stopped, mut frames) = (0, false, [Received { frame: sync, at: Instant::ZERO }; 64]);
    let mut in_error = BTreeSet::new();
    let sample = move |world: &World, at: Instant| {
        loop {
            let count = listener.receive(Instant::FAR_FUTURE, &mut frames).expect("a virtual bus");
            for Received { frame, .. } in &frames[..count] {
                signs += u64::from(*frame == sync || frame.standard_data_id() == heartbeat);
                if let Some(request) = nmt::Request::decode(frame) {
                    stopped = request == nmt::Command::Stop.to_all();
                }
                match Emergency::decode(frame) {
                    Some(end) if end.is_reset() => in_error.remove(&end.node.raw()),
                    Some(begin) => in_error.insert(begin.node.raw()),
                    None => false,
                };
            }
            if count < frames.len() {
                break;
            }
        }
        let motors = drives.iter().map(|drive| world.plant(*drive).expect("a drive has a plant").angle()).collect();
        let error = if guarded { stopped } else { in_error.len() == drives.len() };
        Sample { wall: clock::now(), at, motors, error, bytes: signs }
    };
    Emulator::serve(lines, sample)
}

struct Rig<'a> {
    directory: &'a Directory,
    file: &'a CellFile,
    cell: &'a Path,
    wire: &'a Wire,
    emulator: &'a Emulator,
}

impl Rig<'_> {
    fn start(&self, record: &Path) -> Running {
        let (cell, record) = (self.cell.as_os_str(), record.as_os_str());
        let wire = self.wire.arguments.iter().map(AsRef::as_ref);
        let run = ["run".as_ref(), cell, "--json".as_ref(), "--force".as_ref(), "--record".as_ref(), record];
        Running::start(run.into_iter().chain(wire))
    }

    /// Lets a run fail in its cycle `rows` of motion.
    fn fails(&self, failure: Failure, rows: usize) -> Figures {
        let record = self.directory.path("record.csv");
        let _ = fs::remove_file(&record);
        self.emulator.samples.lock().expect("no panic").clear();
        let began = clock::now();
        let run = self.start(&record);
        let moving = ",wrist-roll,Moving,";
        let broken = |text: &str| text.contains(",Stopping,") || text.contains(",Faulted,");
        let begun = run.ended_before(&record, |text| text.matches(moving).count() > rows || broken(text));
        assert_eq!(begun, Ok(()), "the run ended before the failure");
        let record = fs::read_to_string(&record).expect("the record");
        assert!(!broken(&record), "the run stopped before the failure: {:?}", run.output());
        let event = clock::now();
        let mut hang = None;
        match failure {
            Failure::Kill => run.signal("KILL"),
            Failure::Pause(time) => {
                run.signal("STOP");
                clock::sleep_until(clock::now() + time);
                run.signal("CONT");
            }
            Failure::Hang => hang = Some(Hang::of(run.id())),
            Failure::Unguarded | Failure::KillAll => unreachable!("a cell without serial lines has no guardian"),
        }
        let stands = self.emulator.at_rest(began);
        let ended = run.output();
        drop(hang);
        let after = self.emulator.at_rest(began);
        if failure != Failure::Kill {
            assert_eq!(ended.status.code(), Some(1), "{failure:?}: {ended:?}");
            let first = ended.json()["faults"][0].to_string();
            assert_eq!(first.contains("thread servo hangs"), failure == Failure::Hang, "{failure:?}: {ended:?}");
        }
        // A drive without power falls by less than the brake's play.
        let (rested, last) = (stands.last().expect("samples"), after.last().expect("samples"));
        assert!(!moved(rested, last), "{failure:?}: the robot moved again: {rested:?} {last:?}");
        figures(self.file, &after, last_sign(&after, event, self.wire.gap))
    }
}

/// Time of the last message of the host before its first silence of at least `gap` after `event`.
fn last_sign(samples: &[Sample], event: Instant, gap: Duration) -> Instant {
    let pairs = samples.windows(2);
    let signs: Vec<_> = pairs.filter(|pair| pair[0].bytes != pair[1].bytes).map(|pair| &pair[1]).collect();
    let silent = |pair: &&[&Sample]| pair[1].wall > event && pair[1].at.since(pair[0].at) >= gap;
    let last = signs.windows(2).find(silent).map_or(*signs.last().expect("messages of the host"), |pair| pair[0]);
    last.wall
}

/// Silence after which a drive stops by itself: three heartbeat periods.
fn of_drives(file: &CellFile) -> Duration {
    3 * Duration::from_millis(u64::from(file.cell.bus[0].heartbeat_ms))
}

/// Tries every failure `tries` times. All axes must come to a standstill within the longest silence plus the run-out.
fn dies(directory: &Directory, cell: &Path, wire: &Wire, emulator: &Emulator, tries: usize) {
    let file = CellFile::read(cell).expect("the cell");
    let rig = Rig { directory, file: &file, cell, wire, emulator };
    // Cycles of motion before the failure: 0.6 to 2.7 s.
    let rows = |number| (600 + 300 * (number % 8)) / file.cell.period().as_millis() as usize;
    for &failure in wire.failures {
        let mut worst = Figures::default();
        for number in 0..tries {
            let figures = by_the_clock(wire.processors, UNBEARABLE, || {
                let figures = rig.fails(failure, rows(number));
                assert!(figures.standstill <= wire.silence + RUN_OUT, "{failure:?}: {figures}");
                let silent = !matches!(failure, Failure::Pause(time) if time < 2 * wire.silence);
                let noticed = (Duration::from_nanos(1)..=wire.silence + GRAIN).contains(&figures.reaction);
                assert!(noticed || !silent, "{failure:?}: the drives do not notice the silence in time: {figures}");
                figures
            });
            worst = worst.worst(figures);
        }
        println!("irb6 {}, {failure:?}, worst of {tries}: {worst}", wire.name);
    }
}

/// Drives behind an slcan adapter.
fn dies_behind_slcan(tries: usize) {
    let directory = Directory::new();
    let cell = directory.cell("irb6", |cell: &mut Cell| {
        shorten(cell);
        // A busy kernel may hold the answers of all drives for some cycles.
        cell.bus[0].tolerated_missing = 30;
        cell.max_missed_in_row = 9;
        cell.flight_recorder_s = 0;
        for axis in &mut cell.robot[0].axis {
            axis.following_error = 100.0;
        }
    });
    let file = CellFile::read(&cell).expect("the cell");
    let link = directory.path("can0");
    let emulator =
        emulator(&file, |lines, emulated| lines.add_bus(emulated, 0, Pty::linked(&link).expect("a pseudo-terminal")));
    let can = format!("--can=slcan:{}", link.display());
    let arguments = ["--bench=card".to_owned(), can];
    let gap = Duration::from_millis(20);
    let wire =
        Wire { name: "behind slcan", arguments, gap, silence: of_drives(&file), failures: &FAILURES, processors: 0.45 };
    dies(&directory, &cell, &wire, &emulator, tries);
}

/// Drives on a virtual interface, in the test machine. This machine may delay the host by as much as the other failures
/// do. The only failure is therefore a kill. On a guarded bus, the guardian detects the end of the host at once. The
/// command of the guardian must precede the time at which the drives would stop by themselves, after 0.6 s.
fn dies_on_vcan(test: &str, longest: Duration, tries: usize, guarded: bool) {
    in_uml(longest, test, |interface| {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |cell: &mut Cell| {
            slow::shorten(cell);
            // The drives wait for three heartbeats, and the controller for 0.3 s.
            cell.bus[0].heartbeat_ms = 200;
            cell.bus[0].tolerated_missing = 30;
            cell.max_missed_in_row = 30;
            cell.flight_recorder_s = 0;
            if guarded {
                cell.bus[0].guarded = true;
                cell.guardian_ms = Some(350);
            }
        });
        let file = CellFile::read(&cell).expect("the cell");
        let port = BusPort::open(&Interface::parse(interface), file.cell.bus[0].bitrate_kbps).expect("the interface");
        let emulator = emulator(&file, |lines, emulated| lines.add_bus_on(emulated, 0, port));
        let arguments = ["--bench=vcan".to_owned(), format!("--can={interface}")];
        let (gap, failures) = (Duration::from_millis(200), &[Failure::Kill]);
        let silence = of_drives(&file) - if guarded { file.cell.period() } else { Duration::ZERO };
        let name = if guarded { "on guarded vcan" } else { "on vcan" };
        let wire = Wire { name, arguments, gap, silence, failures, processors: ALL };
        dies(&directory, &cell, &wire, &emulator, tries);
    });
}

#[test]
fn drives_on_can_stop_by_themselves_when_their_host_fails_in_motion() {
    dies_behind_slcan(1);
}

#[test]
fn drives_on_vcan_stop_by_themselves_when_their_host_fails_in_motion() {
    let test = "host_dies::drives_on_vcan_stop_by_themselves_when_their_host_fails_in_motion";
    dies_on_vcan(test, Duration::from_secs(240), 1, false);
}

#[test]
fn the_guardian_of_a_vcan_stops_its_drives_when_their_host_is_killed_in_motion() {
    let test = "host_dies::the_guardian_of_a_vcan_stops_its_drives_when_their_host_is_killed_in_motion";
    dies_on_vcan(test, Duration::from_secs(240), 1, true);
}

#[test]
#[ignore = "twenty tries of each failure, for figures"]
fn host_dies_20() {
    dies_behind_slcan(20);
}

#[test]
#[ignore = "twenty tries of each failure, for figures"]
fn host_dies_20_on_vcan() {
    dies_on_vcan("host_dies::host_dies_20_on_vcan", Duration::from_secs(3600), 20, false);
}
