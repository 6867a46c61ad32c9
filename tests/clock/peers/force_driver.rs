//! This project's driver of the serial force/torque sensor on the sensor in Python, over a pseudo-terminal.
//!
//! The driver reads no clock: each cycle has a virtual time. Between two cycles the test waits until the reply is there,
//! or until the sensor confirms that the query was lost. A busy machine therefore changes no result.

use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::Command;
use std::task::Poll;
use std::time::Duration;

use can::{Instant, clock};
use drive::wrench::{
    SerialWrenchConfig, SerialWrenchSensor, WrenchAxis, WrenchConfig, WrenchError, WrenchFault, WrenchLink,
    WrenchState, ZeroMethod,
};
use drive::{BringUpError, DriveGroup};
use kit::mrroc;
use kit::processors;
use serial::{LineError, Tty};

use super::force::PythonSensor;
use super::{PATIENCE, python};
use crate::vcan::wait_until;

const PERIOD: Duration = Duration::from_millis(2);

/// Time of one byte on the line, ns: 10 bits at 115,200 bit/s, rounded down or up.
const BYTE: [u64; 2] = [86_805, 86_806];

/// N and N·m per count.
const SCALE: [f64; 6] = {
    let [force, torque] = [10.0 / 115.0, 5.0 / 940.0];
    [force, force, force, torque, torque, torque]
};

/// Longest wait for a reply.
const REPLY: Duration = Duration::from_secs(20);

/// The sensor in Python, and the driver on its line.
struct Rig {
    python: PythonSensor,
    sensor: SerialWrenchSensor<Tty>,
    link: WrenchLink,
    /// The line once more, to wait for bytes.
    line: OwnedFd,
    /// Virtual time.
    now: Instant,
    /// Queries that the sensor is known to have lost.
    lost: u64,
    silent: bool,
}

impl Rig {
    /// A sensor that loses queries, with these further arguments, and a driver before bring-up.
    fn silent(python: &Path, arguments: &[&str], config: WrenchConfig) -> Self {
        let mut script = Command::new("timeout");
        script.args(["--signal=KILL", PATIENCE]).arg(python).args(["-B", "-u"]);
        script.arg(mrroc::root().join("tests/peers/force_sensor.py")).arg("--silent").args(arguments);
        let python = PythonSensor::start(&mut script);
        let mut line_config = SerialWrenchConfig::new(PERIOD);
        line_config.sensor = config;
        let line = Tty::open(&python.tty, line_config.settings).unwrap();
        let waiting = line.as_fd().try_clone_to_owned().unwrap();
        let (sensor, link) = SerialWrenchSensor::new(line, line_config).unwrap();
        let now = Instant::from_nanos(1_000_000_000);
        Self { python, sensor, link, line: waiting, now, lost: 0, silent: true }
    }

    /// Brings the driver up. `wait`: real time per period in which bytes may arrive.
    fn bring_up(&mut self, wait: Duration) -> Result<(), BringUpError> {
        for _ in 0..10_000 {
            if let Poll::Ready(result) = self.sensor.bring_up(self.now) {
                return result;
            }
            clock::wait_readable(self.line.as_fd(), clock::now() + wait).unwrap();
            self.now += PERIOD;
        }
        panic!("bring-up does not end");
    }

    /// A sensor whose driver is up. The text after power-on arrives during bring-up.
    fn up(python: &Path, arguments: &[&str], config: WrenchConfig) -> Self {
        let mut rig = Self::silent(python, arguments, config);
        rig.speak();
        rig.python.command("restart");
        assert_eq!(rig.bring_up(Duration::from_millis(200)), Ok(()));
        rig.cycle();
        rig
    }

    fn speak(&mut self) {
        self.python.command("speak");
        self.silent = false;
    }

    fn be_silent(&mut self) {
        self.python.command("silent");
        self.silent = true;
        self.lost = self.counts()[1];
    }

    /// Numbers of replies, of lost queries and of biases.
    fn counts(&mut self) -> [u64; 3] {
        let text = self.python.command("counts");
        let counts: Vec<u64> = text.split(' ').map(|count| count.parse().expect("a number")).collect();
        counts.try_into().expect("three numbers")
    }

    /// One cycle. Afterwards the reply to its query is there, or the query is lost.
    fn cycle(&mut self) -> WrenchState {
        self.now += PERIOD;
        let sent = self.sensor.counters().port.sent;
        self.sensor.read(self.now, &mut []);
        self.sensor.write(self.now, &[]);
        assert!(self.sensor.send(self.now));
        let state = self.link.read();
        assert_eq!(state.at, self.now);
        assert!(state.wrench.iter().all(|component| component.is_finite()));
        match (self.sensor.counters().port.sent - sent, self.silent) {
            (0, _) => {}
            (1, true) => {
                self.lost += 1;
                wait_until("the query has arrived", || self.counts()[1] == self.lost);
            }
            (1, false) => {
                let come = clock::wait_readable(self.line.as_fd(), clock::now() + REPLY);
                assert_eq!(come, Ok(true), "no reply within {REPLY:?}");
            }
            (more, _) => panic!("{more} queries in a cycle"),
        }
        state
    }

    /// Sets the load, and takes the two cycles from its query to its reading.
    fn load(&mut self, load: [f64; 6]) -> WrenchState {
        let text = load.map(|component| component.to_string()).join(" ");
        self.python.command(&format!("load {text}"));
        self.cycle();
        self.cycle()
    }

    fn states(&mut self, cycles: usize) -> Vec<WrenchState> {
        (0..cycles).map(|_| self.cycle()).collect()
    }
}

/// The reading of a load: whole counts in N and N·m.
fn reading(load: [f64; 6]) -> [f64; 6] {
    std::array::from_fn(|axis| (load[axis] / SCALE[axis]).round() * SCALE[axis])
}

#[track_caller]
fn close(found: [f64; 6], expected: [f64; 6]) {
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, expected {expected:?}");
}

fn ages(states: &[WrenchState]) -> Vec<u32> {
    states.iter().map(|state| state.age).collect()
}

#[test]
fn the_driver_reads_the_wrenches_of_the_sensor_in_python_and_zeroes_it() {
    let test = "peers::force_driver::the_driver_reads_the_wrenches_of_the_sensor_in_python_and_zeroes_it";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let mut rig = Rig::up(&python, &[], WrenchConfig::ATI);
    let loads = [
        [12.0, -30.0, 45.0, 1.0, -2.0, 3.0],
        [-64.0, 64.0, -129.0, -4.9, 4.9, -0.01],
        [0.05, -0.05, 0.04, 0.003, -0.003, 0.0],
        [0.0; 6],
        [1.0, 2.0, 3.1, 0.1, 0.2, 0.3],
    ];
    for load in loads {
        let state = rig.load(load);
        close(state.wrench, reading(load));
        assert_eq!((state.age, state.fault, state.measured()), (0, None, Some(state.wrench)));
        // The query of the cycle before has arrived one byte after its deadline.
        let since = state.sampled.since(state.at - PERIOD).as_nanos();
        assert!(BYTE.map(u128::from).contains(&since), "{since} ns");
    }
    let [replies, lost, _] = rig.counts();
    let taken = rig.sensor.sensor_counters();
    // The last reply waits on the line. Bring-up takes 8 replies.
    assert_eq!((taken.samples + 8 + 1, taken.missing, taken.garbage, lost), (replies, 0, 0, 0), "{taken:?}");
    // The mean of ten samples in the host.
    let request = rig.link.zero();
    let states = rig.states(11);
    assert!(states[9].zeroing != states[10].zeroing && states[10].zeroing.is_done(request), "{states:?}");
    close(states[10].wrench, [0.0; 6]);
    let load = [-9.0, 2.0, 3.1, 0.1, 0.2, 0.3];
    let [now, then] = [load, loads[4]].map(reading);
    close(rig.load(load).wrench, std::array::from_fn(|axis| now[axis] - then[axis]));
    assert_eq!(rig.counts()[2], 0);
}

#[test]
fn the_bias_of_the_sensor_in_python_is_the_zero_of_the_driver() {
    let test = "peers::force_driver::the_bias_of_the_sensor_in_python_is_the_zero_of_the_driver";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let config = WrenchConfig { zero: ZeroMethod::Device, ..WrenchConfig::ATI };
    let mut rig = Rig::up(&python, &[], config);
    let load = [20.0, -10.0, 5.0, 0.5, -0.5, 1.0];
    close(rig.load(load).wrench, reading(load));
    let request = rig.link.zero();
    // The request is taken, and the bias leaves in place of a query. The bias has no reply.
    rig.now += PERIOD;
    rig.sensor.read(rig.now, &mut []);
    rig.sensor.send(rig.now);
    wait_until("the bias has arrived", || rig.counts()[2] == 1);
    let states = rig.states(3);
    assert_eq!(ages(&states), [1, 0, 0]);
    assert!(states[1].zeroing.is_done(request), "{states:?}");
    close(states[1].wrench, [0.0; 6]);
    let state = rig.load([0.0; 6]);
    assert_eq!(state.fault, None);
    // The bias is no whole number of counts.
    assert!(state.wrench.iter().zip(load).zip(SCALE).all(|((found, load), scale)| (found + load).abs() <= scale));
}

#[test]
fn silence_of_the_sensor_in_python_is_a_fault_with_the_age_of_the_last_sample() {
    let test = "peers::force_driver::silence_of_the_sensor_in_python_is_a_fault_with_the_age_of_the_last_sample";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let mut rig = Rig::silent(&python, &[], WrenchConfig::ATI);
    // No byte can arrive, so the test does not wait.
    match rig.bring_up(Duration::ZERO) {
        Err(BringUpError::WrenchLine { error: WrenchError::Absent { waited, .. } }) => {
            assert!(waited > Duration::from_secs(2), "{waited:?}");
        }
        other => panic!("{other:?}"),
    }
    drop(rig);
    let mut rig = Rig::up(&python, &[], WrenchConfig::ATI);
    let last = rig.load([12.0, -30.0, 45.0, 1.0, -2.0, 3.0]);
    rig.be_silent();
    let states = rig.states(6);
    // The reply to the query before was on the line.
    assert_eq!(ages(&states), [0, 1, 2, 3, 4, 5]);
    let faults: Vec<_> = states.iter().map(|state| state.fault).collect();
    let silent = Some(WrenchFault::Silent { cycles: 4 });
    assert_eq!(faults, [None, None, None, None, silent, silent]);
    assert!(states[4].measured().is_none());
    assert_eq!((states[5].wrench, states[5].sampled), (last.wrench, states[0].sampled));
    // The fault stays until a reset, also when the sensor answers.
    rig.speak();
    let states = rig.states(4);
    assert_eq!((states[3].age, states[3].fault), (0, silent));
    rig.link.reset_fault();
    let state = rig.load([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!((state.age, state.fault), (0, None));
    close(state.wrench, reading([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn garbage_between_telegrams_of_the_sensor_in_python_is_no_wrench() {
    let test = "peers::force_driver::garbage_between_telegrams_of_the_sensor_in_python_is_no_wrench";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let mut rig = Rig::up(&python, &[], WrenchConfig::ATI);
    let load = [12.0, -30.0, 45.0, 1.0, -2.0, 3.0];
    rig.load(load);
    // Too many bytes, too few, and the text of a restart that has the length of no reply.
    for (number, fault) in
        (1..).zip(["garbage A5FF", "cut 13", "cut 1", "garbage 71", "garbage 0000000000000000000000"])
    {
        rig.python.command(fault);
        // The reply to this query is damaged. The next query leaves after a quiet reading.
        let states = rig.states(4);
        assert_eq!(ages(&states), [0, 1, 2, 0], "{fault}");
        for state in states {
            assert_eq!(state.fault, None, "{fault}");
            close(state.wrench, reading(load));
        }
        assert_eq!(rig.sensor.sensor_counters().garbage, number);
    }
    // Endless garbage. Readings with bytes and quiet readings alternate.
    let mut states = Vec::new();
    for _ in 0..6 {
        rig.python.command("garbage 42");
        states.push(rig.cycle());
    }
    assert_eq!(ages(&states), [0, 1, 2, 3, 4, 5]);
    let garbage = Some(WrenchFault::Garbage { readings: 2 });
    assert_eq!((states[3].fault, states[4].fault, states[4].measured()), (None, garbage, None));
    drop(rig.python);
    wait_until("the line has ended", || {
        rig.now += PERIOD;
        rig.sensor.read(rig.now, &mut []);
        rig.sensor.send(rig.now);
        rig.link.reset_fault();
        rig.link.read().fault == Some(WrenchFault::Line(LineError::Gone))
    });
    assert_eq!(rig.link.read().measured(), None);
}

#[test]
fn saturation_of_the_sensor_in_python_is_a_fault_that_names_the_channel() {
    let test = "peers::force_driver::saturation_of_the_sensor_in_python_is_a_fault_that_names_the_channel";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.5);
    let mut rig = Rig::up(&python, &["--force-range", "130", "--torque-range", "5"], WrenchConfig::ATI);
    let cases = [
        // Beyond the range of the transducer, which limits the reading.
        ([0.0, 0.0, -500.0, 1.0, 0.0, 0.0], WrenchAxis::Fz, -1_495),
        ([0.0, 0.0, 1.0, 0.0, 0.0, 30.0], WrenchAxis::Tz, 940),
        // Beyond the range of the configuration alone: 65 N.
        ([70.0, 0.0, 1.0, 0.0, 0.0, 0.0], WrenchAxis::Fx, 805),
    ];
    for (beyond, axis, counts) in cases {
        let within = [-60.0, 60.0, 120.0, -4.9, 4.9, 2.0];
        let last = rig.load(within);
        assert_eq!((last.age, last.fault), (0, None));
        let first = rig.load(beyond);
        // A flipped bit must not stop a robot: one saturated sample is tolerated, and ages the last sample.
        assert_eq!((first.age, first.fault), (1, None), "{axis}");
        let second = rig.cycle();
        assert_eq!((second.age, second.fault), (2, Some(WrenchFault::Saturated { axis, counts })));
        assert_eq!((second.measured(), second.wrench), (None, last.wrench));
        rig.python.command("load 0 0 0 0 0 0");
        rig.cycle();
        rig.link.reset_fault();
        let state = rig.cycle();
        assert_eq!((state.age, state.measured()), (0, Some([0.0; 6])));
    }
}
