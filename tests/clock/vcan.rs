//! Emulators and controller as two processes on SocketCAN: normal operation, and the reaction of each when the other
//! ends.
//!
//! The test machine has one processor, which a busy host takes away for up to a second. The period of the cell is
//! therefore long, 10 ms. Its time limits are half a second without answers and three seconds without cycles. Required
//! hardware, with `HIL_CAN` set: a virtual interface, and root.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::task::Poll;
use std::time::Duration;

use ::mrroc::cell::{Axis, Cell};
use ::mrroc::recording::{ReplayOptions, replay};
use can::candump::Entry;
use can::{Frame, Instant, Port, Received, SocketCanOptions, SocketCanPort, clock};
use canopen::cia402::{PowerState, Statusword};
use canopen::emcy::{Emergency, ErrorRegister};
use canopen::objects::{POSITION_ACTUAL, STATUSWORD};
use canopen::sdo::{Initiate, Request, Response};
use canopen::{NodeId, Object, cob};
use controller::robot::Limits;
use drive::bus::CanBus;
use drive::cia402::{AxisConfig, GroupConfig, Recording};
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Homing, Increments, Setpoint};
use kit::bench::{bodies_on_vcan, on_vcan};
use kit::mrroc::{self, Directory, Output, Running};
use kit::slow::shorten;
use kit::wire;

/// Longest time until a process is ready.
const PATIENCE: Duration = Duration::from_secs(30);

/// Number of lost heartbeats after which a drive stops.
const LOST: u32 = 3;

/// Interface of a test, its cell, and the directory for output files.
pub(crate) struct Stage<'a> {
    pub(crate) interface: &'a str,
    pub(crate) directory: Directory,
    pub(crate) cell: Cell,
}

/// A body of a test on an interface, with the name of its claim.
pub(crate) type Body = (&'static str, fn(&mut Stage));

/// Runs `body`, by the clock, on an interface with the cell.
pub(crate) fn on_stage(test: &str, mut body: impl FnMut(&mut Stage)) {
    on_vcan(test, |interface| body(&mut Stage::on(interface)));
}

/// Runs independent bodies, one after another, on one interface. Each has a cell of its own, and is reported by its name.
pub(crate) fn bodies_on_stage(test: &str, bodies: &[Body]) {
    bodies_on_vcan(test, bodies, |interface, body| body(&mut Stage::on(interface)));
}

impl<'a> Stage<'a> {
    pub(crate) fn on(interface: &'a str) -> Self {
        let cell = Cell::parse(&mrroc::text("irb6")).unwrap();
        let mut stage = Stage { interface, cell, directory: Directory::new() };
        stage.change(shorten);
        stage
    }

    pub(crate) fn change(&mut self, change: impl FnOnce(&mut Cell)) {
        change(&mut self.cell);
        let text = toml::to_string(&self.cell).unwrap();
        self.directory.write("cell.toml", &text);
    }

    fn heartbeat(&self) -> Duration {
        Duration::from_millis(self.cell.bus[0].heartbeat_ms.into())
    }

    /// Starts `candump` and waits until it listens.
    pub(crate) fn start_candump(&self) -> Recorder {
        let log = File::create(self.directory.path("bus.log")).unwrap();
        let mut candump = Command::new("candump");
        // The buffer holds what arrives while candump waits for the processor.
        candump.args(["-L", "-r", "8388608", self.interface]);
        started(|| Recorder(candump.stdout(log).stdin(Stdio::null()).spawn().unwrap()))
    }

    /// Starts the emulators and waits until they listen.
    pub(crate) fn start_emulators(&self) -> Running {
        let cell = self.directory.path("cell.toml");
        started(|| {
            let arguments = ["emulate".as_ref(), cell.as_os_str()];
            let can = ["--can".as_ref(), self.interface.as_ref()];
            Running::start(arguments.into_iter().chain(can))
        })
    }

    /// Asserts that the file of the flight recorder replays bit for bit, with the fault.
    fn replays_fault(&self) {
        let recording = self.directory.path("flight-irb6-1.mcap");
        let replay = replay(&recording, &ReplayOptions::default()).unwrap();
        assert!(replay.is_equal() && replay.cycles > 100, "{replay}");
        assert_eq!(replay.bench, "vcan");
    }

    /// Starts the controller with output files for states, trace and report.
    pub(crate) fn start_controller(&self) -> Running {
        let path = |name| self.directory.path(name).into_os_string();
        Running::start([
            "run".into(),
            path("cell.toml"),
            "--bench".into(),
            "vcan".into(),
            "--can".into(),
            self.interface.into(),
            "--json".into(),
            "--force".into(),
            "--flight".into(),
            path("."),
            "--record".into(),
            path("states.csv"),
            "--trace".into(),
            path("trace.log"),
        ])
    }

    /// Starts both, and returns after the arm has been in motion for some cycles.
    pub(crate) fn start_moving(&self) -> (Running, Running) {
        let emulators = self.start_emulators();
        let controller = self.start_controller();
        let moving = 20 * self.cell.robot[0].axis.len();
        controller.wait_for(&self.directory.path("states.csv"), |states| states.matches(",Moving,").count() > moving);
        (emulators, controller)
    }

    fn recording(&self, name: &str) -> Recording {
        let host = NodeId::new(self.cell.bus[0].host_node).unwrap();
        Recording::new(frames_of(&self.directory.path(name)), host)
    }
}

/// A running `candump`, killed on drop.
pub(crate) struct Recorder(pub(crate) Child);

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a listener to frames and waits until it listens.
pub(crate) fn started<T>(start: impl FnOnce() -> T) -> T {
    let lines = |kind| {
        let list = fs::read_to_string(format!("/proc/net/can/rcvlist_{kind}"));
        list.map_or(0, |list| list.lines().count())
    };
    let listeners = || ["all", "fil", "sff"].into_iter().map(lines).sum::<usize>();
    let before = listeners();
    let it = start();
    wait_until("it listens", || listeners() > before);
    it
}

pub(crate) fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = clock::now() + PATIENCE;
    while !is_so() {
        assert!(clock::now() < deadline, "waited too long: {what}");
        clock::sleep_until(clock::now() + Duration::from_millis(20));
    }
}

/// Frames of a recording. The last line may be incomplete.
pub(crate) fn frames_of(path: &Path) -> Vec<Received> {
    let mut whole = String::new();
    let mut file = BufReader::new(File::open(path).unwrap());
    while file.read_line(&mut whole).unwrap() > 0 {}
    whole.truncate(whole.rfind('\n').map_or(0, |end| end + 1));
    // Where it is not permitted the receive buffer that it was given, candump begins with a remark.
    if whole.starts_with("The socket") {
        whole.drain(..=whole.find('\n').unwrap_or(0));
    }
    let entries = whole.lines().map(|line| Entry::parse(line.as_bytes()).unwrap());
    let received = entries.map(|entry| Received { frame: entry.frame, at: entry.at });
    received.collect()
}

/// Asserts that the run ended with one of these faults, and that the report names the fault.
pub(crate) fn faulted(output: &Output, named: &[&str]) {
    let report = output.json();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert_eq!(report["outcome"], "faulted", "{output:?}");
    let faults = report["faults"].as_array().unwrap();
    let is_named = |fault: &serde_json::Value| {
        let fault = fault.to_string();
        named.iter().any(|name| fault.contains(name))
    };
    assert!(faults.iter().any(is_named), "{faults:?}");
    assert!(!output.stderr.contains("panicked"), "{output:?}");
}

/// Configuration of the drives, computed from the cell as at the start of the run.
fn drives_of(cell: &Cell) -> (GroupConfig, Vec<AxisConfig>) {
    let arm = cell.robot[0].arm().unwrap();
    let home = arm.robot().home();
    let axes = cell.robot[0].axis.iter().zip(home.iter().zip(arm.robot().motor_limits()));
    let config = |(axis, (home, limits)): (&Axis, (&f64, &Limits))| AxisConfig {
        position_range: Some((limits.low, limits.high)),
        ..axis.drive_config(*home)
    };
    (cell.group_config(0), axes.map(config).collect())
}

/// One axis in one cycle, as the run recorded it.
struct Row {
    cycle: usize,
    command: AxisCommand,
    state: AxisState,
}

impl Row {
    fn parse(line: &str) -> Self {
        let fields: Vec<_> = line.split(',').collect();
        let number = |field: usize| fields[field].parse::<f64>().unwrap();
        Self {
            cycle: fields[0].parse().unwrap(),
            command: match fields[4] {
                "Off" => AxisCommand::Off,
                "Stand" => AxisCommand::Stand,
                "Home" => AxisCommand::Home,
                "Follow" => AxisCommand::Follow(Setpoint::Position(Finite::new(number(5)).unwrap())),
                other => panic!("{other}"),
            },
            state: AxisState {
                position: number(6),
                increments: Increments(fields[7].parse().unwrap()),
                velocity: number(8),
                torque: number(9),
                homing: match fields[10] {
                    "NotHomed" => Homing::NotHomed,
                    "InProgress" => Homing::InProgress,
                    "Attained" => Homing::Attained,
                    other => panic!("{other}"),
                },
                ..AxisState::default()
            },
        }
    }
}

/// Replays `recording` through the driver with the commands of the run. Asserts that every axis in every cycle has the
/// values that the run recorded. Velocities are quotients with the times of SYNCs and may differ by the relative
/// `tolerance`.
///
/// Cycle *k* of the run corresponds to SYNC *k* of the recording. The frames sent by the driver must equal the frames
/// of the run for each identifier.
fn replays(recording: &Recording, cell: &Cell, states: &str, tolerance: f64) {
    let (config, axes) = drives_of(cell);
    let (port, mut sent) = recording.port();
    let mut group = CanBus::new(port, config, &axes).unwrap();
    assert_eq!(recording.bring_up(&mut group), Poll::Ready(Ok(())));
    // The group sends nothing while frames of an earlier cycle wait.
    let mut replayed: Vec<_> = std::iter::from_fn(|| sent.take_sent()).collect();

    let rows: Vec<_> = states.lines().skip(1).map(Row::parse).collect();
    let cycles: Vec<_> = rows.chunks(axes.len()).collect();
    let mut states = vec![AxisState::default(); axes.len()];
    let mut syncs = 0;
    for ((number, now), cycle) in recording.syncs().enumerate().zip(&cycles) {
        group.read(now, &mut states);
        for (axis, (row, replayed)) in cycle.iter().zip(&states).enumerate() {
            let live = &row.state;
            let at = format!("cycle {number}, axis {axis}: {live:?} replayed as {replayed:?}");
            assert_eq!(row.cycle, number, "{at}");
            assert_eq!(replayed.increments, live.increments, "{at}");
            assert_eq!(replayed.position, live.position, "{at}");
            assert_eq!(replayed.torque, live.torque, "{at}");
            assert_eq!(replayed.homing, live.homing, "{at}");
            assert_eq!(replayed.fault, None, "{at}");
            let difference = (replayed.velocity - live.velocity).abs();
            assert!(difference <= tolerance * live.velocity.abs(), "{at}");
        }
        let commands: Vec<_> = cycle.iter().map(|row| row.command).collect();
        group.write(now, &commands);
        group.send(now);
        replayed.extend(std::iter::from_fn(|| sent.take_sent()));
        syncs += 1;
    }
    assert_eq!((recording.syncs().count(), cycles.len()), (syncs, syncs));

    let replayed = by_identifier(replayed.into_iter().map(|sent| sent.frame));
    let live = by_identifier(recording.from_host().map(|received| received.frame));
    for (id, live) in &live {
        let replayed = replayed.get(id).map_or(&[][..], Vec::as_slice);
        let equal = live.iter().zip(replayed).take_while(|(a, b)| a == b).count();
        let rest = |frames: &[String]| frames[equal..].iter().take(8).cloned().collect::<Vec<_>>();
        let (live, replayed) = (rest(live), rest(replayed));
        assert!(live == replayed, "{id:03X}, frame {equal} and on: {live:?} replayed as {replayed:?}");
    }
}

/// The frames of each identifier in order, except heartbeats, whose number depends on time.
fn by_identifier(frames: impl Iterator<Item = Frame>) -> BTreeMap<u16, Vec<String>> {
    let mut all = BTreeMap::<_, Vec<_>>::new();
    for frame in frames {
        let id = frame.standard_data_id().unwrap();
        if !matches!(cob::Function::of(id), Some(cob::Function::Heartbeat(_))) {
            all.entry(id.raw()).or_default().push(frame.to_string());
        }
    }
    all
}

#[test]
fn a_controller_and_emulators_as_two_processes() {
    bodies_on_stage(
        "vcan::a_controller_and_emulators_as_two_processes",
        &[
            ("a recorded run replays into the same axis states", a_recorded_run_replays_into_the_same_axis_states),
            ("drives that vanish in motion are a fault", drives_that_vanish_in_motion_are_a_fault),
            ("an interface that goes down in motion is a fault", an_interface_that_goes_down_in_motion_is_a_fault),
            (
                "drives brake by themselves when the controller vanishes",
                drives_brake_by_themselves_when_the_controller_vanishes,
            ),
            ("an error that is no fault is in the report", an_error_that_is_no_fault_is_in_the_report),
            ("a bus without drives is refused", a_bus_without_drives_is_refused),
        ],
    );
}

fn a_recorded_run_replays_into_the_same_axis_states(stage: &mut Stage) {
    stage.change(|cell| cell.robot[0].program.truncate(1));
    let (_candump, _emulators) = (stage.start_candump(), stage.start_emulators());
    let output = stage.start_controller().output();
    let report = output.json();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(report["outcome"], "completed", "{report}");
    assert_eq!(report["faults"], serde_json::json!([]), "{report}");
    // A frame that comes between the reading of a cycle and its SYNC, in a cycle that the machine delays, belongs to
    // this cycle in the recording and to the next cycle in the run.
    let step = &report["cycle"]["step_us"];
    assert!(step["max"].as_f64() < Some(f64::from(stage.cell.period_us)), "the machine delayed a cycle: {step}");
    let states = fs::read_to_string(stage.directory.path("states.csv")).unwrap();
    let sent = |name| stage.recording(name).from_host().count();
    wait_until("candump has written all", || sent("bus.log") == sent("trace.log"));
    // candump records the kernel's times of the SYNCs, which include delays of the kernel. The trace records
    // the times of the run with a resolution of a microsecond.
    replays(&stage.recording("bus.log"), &stage.cell, &states, f64::MAX);
    replays(&stage.recording("trace.log"), &stage.cell, &states, 1e-3);
    // candump, as a separate process, received the same time stamps.
    let bus = frames_of(&stage.directory.path("bus.log"));
    wire::agrees(&report["wire"], &stage.cell, &bus);
}

fn drives_that_vanish_in_motion_are_a_fault(stage: &mut Stage) {
    let (emulators, controller) = stage.start_moving();
    emulators.signal("KILL");
    let silence = format!("no answer for {} cycles", stage.cell.bus[0].tolerated_missing + 1);
    faulted(&controller.output(), &[&silence, "no heartbeat"]);
    stage.replays_fault();
}

fn an_interface_that_goes_down_in_motion_is_a_fault(stage: &mut Stage) {
    let (_emulators, controller) = stage.start_moving();
    let down = ["link", "set", stage.interface, "down"];
    assert!(Command::new("ip").args(down).status().unwrap().success());
    let output = controller.output();
    let up = ["link", "set", stage.interface, "up"];
    assert!(Command::new("ip").args(up).status().unwrap().success());
    faulted(&output, &["bus arm: interface is down"]);
    stage.replays_fault();
}

fn drives_brake_by_themselves_when_the_controller_vanishes(stage: &mut Stage) {
    stage.change(|cell| cell.bus[0].heartbeat_ms = 300);
    let _candump = stage.start_candump();
    let (_emulators, controller) = stage.start_moving();
    controller.signal("KILL");
    let host = NodeId::new(stage.cell.bus[0].host_node).unwrap();
    let said = || frames_of(&stage.directory.path("bus.log"));
    wait_until("every drive has told how it stands", || {
        ask_how_it_stands(stage.interface, &stage.cell, stage.heartbeat());
        let frames = said();
        let mut axes = stage.cell.robot[0].axis.iter();
        axes.all(|axis| lost(&frames, host, axis).is_some_and(|lost| lost.told(&frames, axis)))
    });
    stopped(&said(), &stage.cell);
}

/// Values of `object` that `node` reported after `after`.
fn uploaded(frames: &[Received], node: NodeId, object: Object, after: Instant) -> Vec<i32> {
    let later = frames.iter().filter(|received| received.at > after);
    let value = |received: &Received| match Response::decode(&received.frame, node)? {
        Response::InitiateUpload { object: found, initiate: Initiate::Expedited(data) } if found == object => {
            let mut bytes = [0; 4];
            bytes[..data.data().len()].copy_from_slice(data.data());
            Some(i32::from_le_bytes(bytes))
        }
        _ => None,
    };
    later.filter_map(value).collect()
}

/// Reaction of a drive after the host's last heartbeat, in the time of the drive. The drive's own heartbeats have the
/// host's period and count this time. The time of emulated drives stands still while their machine is paused, and the
/// wall clock does not.
struct Lost {
    /// Number of periods from the host's last heartbeat to the emergency.
    waited: usize,
    /// The second heartbeat of the drive after the emergency, at least a period after it.
    standing: Option<Instant>,
}

/// Reaction of the drive of `axis`; `None` if the drive has not yet reported the loss of the host.
fn lost(frames: &[Received], host: NodeId, axis: &Axis) -> Option<Lost> {
    let node = NodeId::new(axis.node).unwrap();
    let is_lost = |received: &&Received| {
        let emergency = Emergency::decode(&received.frame);
        emergency.is_some_and(|it| it.node == node && it.code == 0x8130)
    };
    let at = frames.iter().find(is_lost)?.at;
    let beats = |node| {
        let id = Some(cob::heartbeat(node));
        let frames = frames.iter();
        let beats = frames.filter(move |received| received.frame.standard_data_id() == id);
        beats.map(|received| received.at)
    };
    let last = beats(host).next_back().unwrap();
    let waited = beats(node).filter(|beat| (last..at).contains(beat));
    Some(Lost { waited: waited.count(), standing: beats(node).filter(|beat| *beat > at).nth(1) })
}

impl Lost {
    /// Whether the drive has sent enough answers after the time at which it must stand.
    fn told(&self, frames: &[Received], axis: &Axis) -> bool {
        let node = NodeId::new(axis.node).unwrap();
        let answers = |object, at| uploaded(frames, node, object, at).len();
        self.standing.is_some_and(|at| answers(STATUSWORD, at).min(answers(POSITION_ACTUAL, at)) > 5)
    }
}

/// Asserts that every drive reported the loss three periods after the host's last heartbeat. Each drive was in motion
/// until then, and stands from one period later on.
fn stopped(frames: &[Received], cell: &Cell) {
    let host = NodeId::new(cell.bus[0].host_node).unwrap();
    for axis in &cell.robot[0].axis {
        let lost = lost(frames, host, axis).expect("every drive lost the host");
        let periods = LOST as usize;
        // The heartbeats of drive and host are not synchronised.
        assert!((periods - 1..=periods + 1).contains(&lost.waited), "{}: {} periods", axis.name, lost.waited);
        stands(frames, axis, lost.standing.expect("it goes on beating"));
    }
}

/// Asserts that the drive reported more than once after `after` that it has no power and has not moved.
fn stands(frames: &[Received], axis: &Axis, after: Instant) {
    let node = NodeId::new(axis.node).unwrap();
    let words = uploaded(frames, node, STATUSWORD, after);
    let positions = uploaded(frames, node, POSITION_ACTUAL, after);
    assert!(words.len() > 5 && positions.len() > 5, "{}", axis.name);
    for word in words {
        let power = Statusword(word as u16).power_state();
        assert_ne!(power, PowerState::OperationEnabled, "{}", axis.name);
    }
    for position in &positions {
        let moved = position - positions[0];
        assert!(moved.abs() <= 2, "{} moved by {moved}", axis.name);
    }
}

/// Requests state and position of every drive repeatedly. A drive that has lost the host answers SDO requests only.
fn ask_how_it_stands(interface: &str, cell: &Cell, duration: Duration) {
    let port = SocketCanPort::open(interface, &SocketCanOptions::default());
    let mut port = port.unwrap();
    let mut now = clock::now();
    let end = now + duration;
    let objects = [STATUSWORD, POSITION_ACTUAL].into_iter().cycle();
    for object in objects.take_while(|_| clock::now() < end) {
        let ask = |axis: &Axis| Request::InitiateUpload { object }.encode(NodeId::new(axis.node).unwrap());
        let requests: Vec<_> = cell.robot[0].axis.iter().map(ask).collect();
        assert_eq!(port.send(now, &requests), Ok(requests.len()));
        now += Duration::from_millis(20);
        clock::sleep_until(now);
    }
}

/// Asserts that the drives of `cell` have no power and stand one period after the detection of the loss. The drives
/// report this on `interface`; they have already lost the host.
pub(crate) fn stand_without_power(interface: &str, directory: &Directory, cell: &Cell) {
    let heartbeat = Duration::from_millis(cell.bus[0].heartbeat_ms.into());
    clock::sleep_until(clock::now() + heartbeat * (LOST + 1));
    let log = directory.path("standing.log");
    let mut candump = Command::new("candump");
    candump.args(["-L", interface]).stdin(Stdio::null());
    candump.stdout(File::create(&log).unwrap());
    let candump = started(|| Recorder(candump.spawn().unwrap()));
    ask_how_it_stands(interface, cell, Duration::from_secs(4));
    // candump writes every line within this time after it has read the frame.
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    drop(candump);
    let frames = frames_of(&log);
    for axis in &cell.robot[0].axis {
        stands(&frames, axis, Instant::ZERO);
    }
}

fn an_error_that_is_no_fault_is_in_the_report(stage: &mut Stage) {
    stage.change(|cell| cell.robot[0].program.truncate(1));
    let (_emulators, controller) = stage.start_moving();
    let port = SocketCanPort::open(stage.interface, &SocketCanOptions::default());
    let overrun = Emergency {
        node: NodeId::new(1).unwrap(),
        code: 0x8110,
        error_register: ErrorRegister::COMMUNICATION,
        vendor: [0; 5],
    };
    let frames = [overrun.encode(); 2];
    assert_eq!(port.unwrap().send(clock::now(), &frames), Ok(2));
    let output = controller.output();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = output.json();
    let warnings = report["warnings"].as_array().unwrap();
    let [warning] = warnings.as_slice() else {
        panic!("{report}");
    };
    assert_eq!(warning["axis"], "column", "{report}");
    for (key, value) in [("node", 1), ("code", 0x8110), ("register", 16), ("count", 2)] {
        assert_eq!(warning[key], value, "{report}");
    }
    assert!(warning["time_s"].as_f64().unwrap() > 0.0, "{report}");
    assert_eq!(report["more_warnings"], 0, "{report}");
}

fn a_bus_without_drives_is_refused(stage: &mut Stage) {
    stage.change(|cell| cell.bus[0].boot_timeout_ms = 1000);
    let output = stage.start_controller().output();
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(output.stderr.contains("bus arm, axis column: node 1: never booted"), "{output:?}");
}
