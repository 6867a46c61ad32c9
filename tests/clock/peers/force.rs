//! Independent peers of the emulated force/torque sensors: a client and an emulator of the serial sensor in Python, and
//! python-canopen as the master of the sensor on a CAN bus.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use ::mrroc::bench::emulated_lines::EmulatedLines;
use can::{Instant, clock};
use canopen::NodeId;
use hil::{
    CanForceSensor, CanForceSensorConfig, Pty, SerialForceSensor, SerialForceSensorConfig, TransducerConfig,
    WrenchProbe,
};
use kit::adapter::Adapter;
use kit::mrroc;
use kit::processors;
use serial::{Line, Tty};

use super::{Bus, PATIENCE, Script, judged, python};
use crate::vcan::wait_until;

/// Range of the sensors in these tests, N and N·m.
const RANGE: [f64; 6] = [400.0, 400.0, 400.0, 10.0, 10.0, 10.0];

/// A load, and the noise of its measurement.
struct Case {
    load: [f64; 6],
    /// Standard deviations, N and N·m.
    noise: [f64; 2],
}

/// A load within the range with noise, and a load beyond the range of four channels.
const CASES: [Case; 2] = [
    Case { load: [12.0, -30.0, 45.0, 1.0, -2.0, 3.0], noise: [0.5, 0.03] },
    Case { load: [500.0, -500.0, 45.0, 11.0, -2.0, -30.0], noise: [0.0, 0.0] },
];

impl Case {
    /// A script with the arguments of this case.
    fn script(&self, python: &Path, name: &str) -> Command {
        let [force, torque] = self.noise.map(|sigma| sigma.to_string());
        let mut command = Command::new("timeout");
        command.args(["--signal=KILL", PATIENCE]).arg(python).args(["-B", "-u"]);
        command.arg(mrroc::root().join("tests/peers").join(name));
        command.arg("--load").args(self.load.map(|component| component.to_string()));
        command.args([
            "--force-noise",
            &force,
            "--torque-noise",
            &torque,
            "--force-range",
            "400",
            "--torque-range",
            "10",
        ]);
        command
    }

    /// Runs the client on a line, and asserts success.
    fn judge(&self, python: &Path, tty: &Path) {
        judged(self.script(python, "force_client.py").arg("--tty").arg(tty).args(["--trailer", "0000"]));
    }
}

struct Constant([f64; 6]);

impl WrenchProbe for Constant {
    fn wrench(&mut self, _now: Instant) -> [f64; 6] {
        self.0
    }
}

/// Stops the emulation at the end of a test, also if the test panics.
struct Stop<'a>(&'a AtomicBool);

impl Drop for Stop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn an_independent_client_finds_the_emulated_force_sensor_right() {
    let test = "peers::force::an_independent_client_finds_the_emulated_force_sensor_right";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    for case in CASES {
        let [force, torque] = case.noise;
        let noise = [force, force, force, torque, torque, torque];
        let transducer = TransducerConfig { range: RANGE, noise, seed: 14, ..TransducerConfig::default() };
        let probe = Box::new(Constant(case.load));
        let sensor = SerialForceSensor::new(SerialForceSensorConfig::new(transducer), probe).unwrap();
        let mut lines = EmulatedLines::default();
        let line = lines.world.add_line(SerialForceSensor::SETTINGS, None, Box::new(sensor));
        let host = lines.world.host_line(line, 4096);
        let pty = Pty::open().unwrap();
        let tty = pty.path().to_owned();
        lines.add_line(host, pty);
        let stop = AtomicBool::new(false);
        thread::scope(|scope| {
            let emulation = scope.spawn(|| lines.serve(&stop));
            let stopping = Stop(&stop);
            case.judge(&python, &tty);
            drop(stopping);
            emulation.join().expect("the emulation does not panic").expect("the pseudo-terminal stays open");
        });
        // The client sends 20 queries during a reply.
        let sensor: &SerialForceSensor = lines.world.line(line).device().expect("the line has this device");
        assert_eq!(sensor.lost_queries(), 20);
    }
}

/// The sensor in Python: `tests/peers/force_sensor.py`, whose help lists the commands.
pub(super) struct PythonSensor {
    /// Line of the sensor.
    pub(super) tty: PathBuf,
    output: BufReader<ChildStdout>,
    script: Script,
}

impl PythonSensor {
    /// Starts the script with its arguments.
    pub(super) fn start(command: &mut Command) -> Self {
        let mut script = Script::start(command.stdout(Stdio::piped()));
        let mut output = BufReader::new(script.0.stdout.take().expect("the output is a pipe"));
        let mut path = String::new();
        output.read_line(&mut path).expect("the output is text");
        Self { tty: PathBuf::from(path.trim()), output, script }
    }

    /// Sends a command, and returns the lines of the output before its confirmation.
    pub(super) fn command(&mut self, line: &str) -> String {
        let input = self.script.0.stdin.as_mut().expect("the input is open until the end");
        writeln!(input, "{line}").expect("the script reads its input");
        let mut answer = String::new();
        while !answer.ends_with("done\n") {
            let count = self.output.read_line(&mut answer).expect("the output is text");
            assert!(count > 0, "the script ended after {line:?}: {answer}");
        }
        answer.trim_end_matches("done\n").trim_end().to_owned()
    }
}

/// The sensor in Python serves the tests of drivers. Both programs therefore agree on the protocol.
#[test]
fn the_independent_client_finds_the_sensor_in_python_right() {
    let test = "peers::force::the_independent_client_finds_the_sensor_in_python_right";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    for case in CASES {
        let mut sensor = PythonSensor::start(&mut case.script(&python, "force_sensor.py"));
        case.judge(&python, &sensor.tty);
        let counts = sensor.command("counts");
        assert!(counts.ends_with(" 20 1"), "replies, lost queries, biases: {counts}");
    }
}

#[test]
fn the_sensor_in_python_obeys_its_commands() {
    let test = "peers::force::the_sensor_in_python_obeys_its_commands";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let mut sensor = PythonSensor::start(CASES[1].script(&python, "force_sensor.py").arg("--silent"));
    let mut host = Tty::open(&sensor.tty, SerialForceSensor::SETTINGS).unwrap();
    let mut received = Vec::new();
    let mut hear = |host: &mut Tty, count: usize| {
        wait_until("the sensor answers", || {
            let mut bytes = [0; 64];
            let read = host.read(clock::now(), &mut bytes).unwrap();
            received.extend_from_slice(&bytes[..read]);
            received.len() >= count
        });
        std::mem::take(&mut received)
    };
    let query = |host: &mut Tty| assert_eq!(host.write(clock::now(), b"q"), Ok(1));
    // Opening the line discards earlier bytes.
    sensor.command("speak");
    sensor.command("restart");
    let mut text = Vec::new();
    while !text.ends_with(b"\n") {
        text.extend(hear(&mut host, 1));
    }
    assert!(text.is_ascii() && text.len() > 10, "{text:?}");
    // 115 counts of 10/115 N, and 188 counts of 5/940 N·m.
    sensor.command("load 10 0 0 0 0 -1");
    query(&mut host);
    let reply = [0, 115, 0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0x44, 0, 0];
    assert_eq!(hear(&mut host, 14), reply);
    sensor.command("cut 3");
    query(&mut host);
    assert_eq!(hear(&mut host, 3), reply[..3]);
    sensor.command("garbage A5FF");
    query(&mut host);
    assert_eq!(hear(&mut host, 16), [&[0xA5, 0xFF], &reply[..]].concat());
    // The answer to a lost query would arrive before the next reply, which has another load.
    sensor.command("silent");
    query(&mut host);
    wait_until("the query has arrived", || sensor.command("counts") == "3 1 0");
    sensor.command("speak");
    sensor.command("load 0 0 0 0 0 0");
    query(&mut host);
    assert_eq!(hear(&mut host, 14), [0; 14]);
    assert_eq!(sensor.command("counts"), "4 1 0");
}

#[test]
fn python_canopen_finds_the_emulated_force_sensor_right() {
    let test = "peers::force::python_canopen_finds_the_emulated_force_sensor_right";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let load = CASES[0].load;
    let config = CanForceSensorConfig::new(NodeId::new(1).unwrap(), TransducerConfig::default());
    let config = CanForceSensorConfig { power_on: clock::now(), ..config };
    let sensor = CanForceSensor::new(config, Box::new(Constant(load))).unwrap();
    Adapter::new(Some(Box::new(sensor))).served(|tty| {
        let mut script = Bus::slcan(tty).script_with(&python, "force_can.py", "force-sensor-emulated.eds");
        judged(script.arg("--load").args(load.map(|component| component.to_string())));
    });
}
