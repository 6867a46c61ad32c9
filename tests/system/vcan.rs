//! Emulators and controller as two processes on SocketCAN: what they do together, and what each does
//! when the other one is gone.
//!
//! One processor with coarse timing turns the test machine, so the cell's period is long and its
//! patience longer: 10 ms, with answers that may be missing for half a second.

use std::collections::BTreeMap;
use std::env;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::task::Poll;
use std::time::Duration;

use can::candump::Reader;
use can::{Frame, Received, Tracer, clock};
use canopen::{NodeId, cob};
use controller::cell::Cell;
use drive::cia402::{
    AxisConfig, Cia402Group, CyclicMode, GroupConfig, HomingConfig, Identity, Recording,
};
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Homing, Increments, Scale, Setpoint};

use crate::bench::on_vcan;

/// Longest time that anything here may take.
const PATIENCE: Duration = Duration::from_secs(60);

/// The processes of one test on one interface, killed on drop, and the directory for what they write.
struct Stage<'a> {
    interface: &'a str,
    directory: PathBuf,
    cell: PathBuf,
    text: String,
    children: Vec<Child>,
}

impl Drop for Stage<'_> {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
        let _ = fs::remove_dir_all(&self.directory);
    }
}

/// Runs `body` where `test` has an interface, with the program built before.
fn on_stage(test: &str, body: impl FnOnce(&mut Stage)) {
    // The test machine cannot write what a build writes.
    if env::var_os("MRROC_OUT").is_none() {
        build_mrroc();
    }
    on_vcan(test, |interface| {
        let out = env::var_os("MRROC_OUT").map_or_else(env::temp_dir, PathBuf::from);
        let directory = out.join(format!("vcan-{}", std::process::id()));
        fs::create_dir(&directory).unwrap();
        let text = short_cell();
        let cell = directory.join("cell.toml");
        fs::write(&cell, &text).unwrap();
        body(&mut Stage {
            interface,
            directory,
            cell,
            text,
            children: Vec::new(),
        });
    });
}

/// The program, beside the directory of this test binary.
fn mrroc() -> PathBuf {
    let test = env::current_exe().unwrap();
    test.parent().unwrap().with_file_name("mrroc")
}

fn build_mrroc() {
    let mut build = Command::new(env!("CARGO"));
    build.args(["build", "--quiet", "--package", "mrroc-console"]);
    let release = mrroc()
        .parent()
        .is_some_and(|path| path.ends_with("release"));
    if release {
        build.arg("--release");
    }
    assert!(build.status().unwrap().success());
}

/// The example cell, slower, more patient, and with one short motion behind its homing.
fn short_cell() -> String {
    let cell = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../cells/irb6.toml"));
    let cell = cell.unwrap();
    let (before, _) = cell.split_once("[[robot.program]]").unwrap();
    let mut short = before.to_owned();
    for (from, to) in [
        (
            "period_us = 2000",
            "period_us = 10000\nmax_missed_in_row = 50",
        ),
        ("macrostep = 10", "macrostep = 4"),
        (
            "interface = \"can0\"",
            "interface = \"can0\"\ntolerated_missing = 50\nheartbeat_ms = 300",
        ),
        ("order = 4", "order = 1"),
        ("order = 3", "order = 1"),
        ("order = 2", "order = 1"),
    ] {
        assert!(short.contains(from), "the example cell has no {from}");
        short = short.replace(from, to);
    }
    short
        + "[[robot.program]]\n\
        joints = { poses = [[0.2, -1.7, 0.1, 0.6, 0.1]], velocity = 0.5, acceleration = 0.3 }\n"
}

impl Stage<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    fn text_of(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Starts a program that ends with the test at the latest; what it prints goes to the file `name`.
    fn start(&mut self, name: &str, command: &mut Command) -> usize {
        let output = File::create(self.path(name)).unwrap();
        let errors = output.try_clone().unwrap();
        let child = command
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            .spawn();
        self.children.push(child.unwrap());
        self.children.len() - 1
    }

    /// Starts `candump`, and returns once it listens.
    fn start_candump(&mut self) -> usize {
        let before = listeners();
        let mut candump = Command::new("candump");
        let started = self.start("bus.log", candump.args(["-L", self.interface]));
        wait_until("candump listens", || listeners() > before);
        started
    }

    /// Starts the emulators, and returns once they answer.
    fn start_emulators(&mut self) -> usize {
        let mut emulate = Command::new(mrroc());
        emulate.arg("emulate").arg(&self.cell);
        let started = self.start("emulate.txt", emulate.args(["--can", self.interface]));
        wait_until("emulators are there", || {
            self.text_of("emulate.txt").contains("emulated")
        });
        started
    }

    /// Starts the controller, writing states, a trace and its report.
    fn start_controller(&mut self) -> usize {
        let mut run = Command::new(mrroc());
        run.arg("run").arg(&self.cell).args(["--bench", "vcan"]);
        run.args(["--can", self.interface, "--json"]);
        run.arg("--record").arg(self.path("states.csv"));
        run.arg("--trace").arg(self.path("trace.log"));
        self.start("report.json", &mut run)
    }

    fn wait_until_it_moves(&self) {
        let states = self.path("states.csv");
        wait_until("the arm moves", || {
            fs::read_to_string(&states).is_ok_and(|text| text.contains(",Moving,"))
        });
    }

    fn signal(&self, child: usize, signal: &str) {
        let id = self.children[child].id().to_string();
        let sent = Command::new("kill")
            .args(["-s", signal, "--", &id])
            .status();
        assert!(sent.unwrap().success());
    }

    fn wait(&mut self, child: usize) -> ExitStatus {
        let deadline = clock::now() + PATIENCE;
        loop {
            if let Some(status) = self.children[child].try_wait().unwrap() {
                return status;
            }
            assert!(
                clock::now() < deadline,
                "process {child} runs on\n{}",
                self.text_of("report.json")
            );
            clock::sleep_until(clock::now() + Duration::from_millis(20));
        }
    }

    /// Waits for the controller's end, and returns its exit status and its report.
    fn report(&mut self, controller: usize) -> (Option<i32>, serde_json::Value) {
        let status = self.wait(controller).code();
        let text = self.text_of("report.json");
        let report = serde_json::from_str(&text);
        (
            status,
            report.unwrap_or_else(|error| panic!("{error}: {text}")),
        )
    }
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = clock::now() + PATIENCE;
    while !is_so() {
        assert!(clock::now() < deadline, "waited too long: {what}");
        clock::sleep_until(clock::now() + Duration::from_millis(20));
    }
}

/// Sockets that receive every frame, this machine over.
fn listeners() -> usize {
    fs::read_to_string("/proc/net/can/rcvlist_all").map_or(0, |list| list.lines().count())
}

fn recording(path: &Path, host_node: u8) -> Recording {
    let reader = Reader::new(BufReader::new(File::open(path).unwrap()));
    let received = reader.map(Result::unwrap).map(|entry| Received {
        frame: entry.frame,
        at: entry.at,
    });
    Recording::new(received, NodeId::new(host_node).unwrap())
}

/// What the run had its drives configured to, as its own start made it from the cell.
fn drives_of(cell: &Cell) -> (GroupConfig, Vec<AxisConfig>) {
    let milliseconds = |count| Duration::from_millis(u64::from(count));
    let bus = &cell.bus[0];
    let group = GroupConfig {
        period: Duration::from_micros(cell.period_us.into()),
        tolerated_missing: bus.tolerated_missing,
        heartbeat_period: milliseconds(bus.heartbeat_ms.into()),
        host_node: NodeId::new(bus.host_node).unwrap(),
        sdo_timeout: milliseconds(bus.sdo_timeout_ms),
        sdo_retries: 2,
        boot_timeout: milliseconds(bus.boot_timeout_ms),
        transition_timeout: Duration::from_secs(5),
    };
    let arm = cell.robot[0].arm().unwrap();
    let home = arm.robot().home();
    let axis = |(number, axis): (usize, &controller::cell::Axis)| AxisConfig {
        node: NodeId::new(axis.node).unwrap(),
        identity: Identity {
            vendor: axis.drive.vendor,
            product: axis.drive.product,
            revision: None,
        },
        mode: CyclicMode::Csp,
        scale: Scale::new(axis.drive.counts_per_revolution as i32, home[number]).unwrap(),
        rated_torque: axis.drive.rated_torque,
        homing: HomingConfig {
            method: axis.homing.method,
            search_speed: axis.homing.search_velocity,
            zero_speed: axis.homing.zero_velocity,
            acceleration: axis.homing.acceleration,
        },
        following_error: axis.following_error,
        quick_stop_deceleration: axis.max_acceleration,
        parameters: Vec::new(),
    };
    let axes = cell.robot[0].axis.iter().enumerate();
    (group, axes.map(axis).collect())
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
                "Follow" => {
                    AxisCommand::Follow(Setpoint::Position(Finite::new(number(5)).unwrap()))
                }
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

/// Plays `recording` back through the driver, under the commands of the run, and compares every axis in every
/// cycle with what the run saw there. Velocities are quotients by the times of SYNCs and may differ by
/// the share `tolerance`.
///
/// Cycle *k* of the run is that of SYNC *k* of the recording. What the driver sends must be what the
/// run sent, identifier by identifier.
fn replays(recording: &Recording, cell: &Cell, states: &str, tolerance: f64) {
    let (config, axes) = drives_of(cell);
    let (port, mut sent) = Tracer::new(recording.port(), 1 << 20);
    let mut group = Cia402Group::new(port, config, &axes).unwrap();
    assert_eq!(recording.bring_up(&mut group), Poll::Ready(Ok(())));

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
        syncs += 1;
    }
    assert_eq!((recording.syncs().count(), cycles.len()), (syncs, syncs));

    let replayed = std::iter::from_fn(|| sent.read());
    let replayed = by_identifier(replayed.map(|traced| traced.frame));
    let live = by_identifier(recording.from_host().map(|received| received.frame));
    for (id, live) in &live {
        let replayed = replayed.get(id).map_or(&[][..], Vec::as_slice);
        let equal = live
            .iter()
            .zip(replayed)
            .take_while(|(a, b)| a == b)
            .count();
        let rest = |frames: &[String]| frames[equal..].iter().take(8).cloned().collect::<Vec<_>>();
        let (live, replayed) = (rest(live), rest(replayed));
        assert!(
            live == replayed,
            "{id:03X}, frame {equal} and on: {live:?} replayed as {replayed:?}"
        );
    }
}

/// The frames of each identifier in order, but heartbeats, whose number is one of time.
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
fn a_recorded_run_replays_into_the_same_axis_states() {
    on_stage(
        "vcan::a_recorded_run_replays_into_the_same_axis_states",
        |stage| {
            stage.start_candump();
            stage.start_emulators();
            let controller = stage.start_controller();
            let (status, report) = stage.report(controller);
            assert_eq!(status, Some(0), "{report}");
            assert_eq!(report["outcome"], "completed", "{report}");
            assert_eq!(report["faults"], serde_json::json!([]), "{report}");
            println!("{report}");

            let cell = Cell::parse(&stage.text).unwrap();
            let states = stage.text_of("states.csv");
            let read = |name| recording(&stage.path(name), cell.bus[0].host_node);
            wait_until("candump has written all", || {
                let frames = |recording: Recording| recording.from_host().count();
                frames(read("bus.log")) == frames(read("trace.log"))
            });
            // candump has the kernel's times of the SYNCs, late by whatever held the kernel up; the trace
            // has the run's own, to the microsecond.
            replays(&read("bus.log"), &cell, &states, f64::MAX);
            replays(&read("trace.log"), &cell, &states, 1e-3);
        },
    );
}
