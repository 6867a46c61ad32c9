//! Refusals of force/torque sensors in lockstep: one line before any motion, which names the sensor and what to do.

use std::collections::VecDeque;
use std::fs;
use std::task::Poll;
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{Outcome, join};
use ::mrroc::run::why_not_up;
use ::mrroc::tasks;
use can::Instant;
use drive::DriveGroup;
use drive::wrench::{SerialWrenchConfig, SerialWrenchSensor};
use hil::{CanForceSensor, LineDevice, SerialForceSensor, SerialForceSensorConfig, TransducerConfig, World};
use kit::mrroc::{Directory, example};
use servo::NotUp;

use crate::force_sensors::{Load, SYNC, on_bus, sensor};

const PERIOD: Duration = Duration::from_millis(2);

fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    CellFile::read(Directory::new().cell("irb6-wrist", change)).unwrap()
}

/// Asserts that a message is one line that names the sensor and says what is wrong and what to do.
#[track_caller]
fn is_refusal(message: &str, parts: [&str; 3]) {
    let mut rest = message;
    for part in parts {
        let Some(at) = rest.find(part) else { panic!("{message:?} lacks {part:?} after the part before") };
        rest = &rest[at + part.len()..];
    }
    assert!(!message.contains('\n'), "{message:?} is more than one line");
}

/// A device of another type: a terminal that echoes what it receives, with an end of line.
#[derive(Default)]
struct Terminal(VecDeque<u8>);

impl LineDevice for Terminal {
    fn receive(&mut self, byte: u8, _now: Instant) {
        self.0.extend([byte, b'\r', b'\n']);
    }

    fn poll_transmit(&mut self, _now: Instant) -> Option<u8> {
        self.0.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }

    fn handle_timeout(&mut self, _now: Instant) {}
}

/// Why a sensor with this device on its line does not come up, in the words of the cell.
fn refused_on_line(latency: Option<Duration>, device: Box<dyn LineDevice>) -> String {
    let file = cell(|_| {});
    let mut world = World::new();
    let line = world.add_line(SerialForceSensor::SETTINGS, latency, device);
    let config = SerialWrenchConfig::new(PERIOD);
    let (mut sensor, _link) = SerialWrenchSensor::new(world.host_line(line, 4_096), config).unwrap();
    let mut now = Instant::ZERO;
    let error = loop {
        match sensor.bring_up(now) {
            Poll::Ready(ended) => break ended.unwrap_err(),
            Poll::Pending => {
                now += PERIOD;
                world.advance(now);
            }
        }
    };
    why_not_up(&file, NotUp::Group(file.cell.bus.len() + file.cell.serial.len(), error)).to_string()
}

async fn home(cell: &mut tasks::Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.disable().await
}

#[test]
fn a_serial_sensor_that_cannot_measure_is_refused_before_motion() {
    type Change = fn(&mut Cell);
    const NAME: &str = "force sensor wrist, line /dev/serial/by-id/usb-wrist: ";
    let table: [(&str, Change, [&str; 2]); 3] = [
        (
            "absent",
            |cell| cell.force_sensor[0].emulator.absent = true,
            ["no answer, waited", "check supply and cable of the sensor, and its baud rate"],
        ),
        (
            "silent",
            |cell| cell.force_sensor[0].emulator.silent_from_s = Some(0.0),
            ["no answer, waited", "check supply and cable of the sensor, and its baud rate"],
        ),
        (
            "saturated",
            // The tip is deep in a stiff table.
            |cell| {
                let plane = &mut cell.scene.as_mut().unwrap().plane[0];
                (plane.height, plane.stiffness) = (1.3, 1e5);
            },
            ["is saturated at", "counts: free the tool of contact and load, check the cable of the sensor"],
        ),
    ];
    for (what, change, [why, remedy]) in table {
        // An error in place of a report: no drive was enabled.
        let Err(error) = ::mrroc::run(&cell(change), BenchKind::Lockstep, home) else {
            panic!("{what}: the task runs")
        };
        let error = error.to_string();
        is_refusal(&error, [NAME, why, remedy]);
    }
    // Another device on the line, and an adapter that delays each answer by more than a period.
    let error = refused_on_line(None, Box::new(Terminal::default()));
    is_refusal(&error, [NAME, "no answer of 14 among them", "check the baud rate and the device on the line"]);
    let transducer = TransducerConfig::default();
    let late = SerialForceSensor::new(SerialForceSensorConfig::new(transducer), Box::new(Load::default())).unwrap();
    let error = refused_on_line(Some(Duration::from_millis(16)), Box::new(late));
    is_refusal(&error, [NAME, "answers took more than a period", "set the adapter's latency timer to 1 ms"]);
}

#[test]
fn a_sensor_of_another_rate_is_refused_with_file_and_line() {
    let text = fs::read_to_string(example("irb6-wrist")).unwrap();
    let directory = Directory::new();
    let slow = text.replacen("force_range", "rate_hz = 250\nforce_range", 1);
    let path = directory.write("cell.toml", &slow);
    let line = slow[..slow.find("rate_hz = 250").unwrap()].matches('\n').count() + 1;
    let error = CellFile::read(&path).err().unwrap().to_string();
    is_refusal(
        &error,
        [&format!("cell.toml:{line}"), "force_sensor[0].rate_hz: is 250", "must be 500 (Hz) at the least"],
    );
}

#[test]
fn a_sensor_on_a_bus_that_cannot_measure_is_refused_with_its_node() {
    const NAME: &str = "node 40: ";
    let refused = |change: fn(&mut drive::wrench::WrenchNodeConfig), load: [f64; 6], power: bool| {
        let mut config = sensor(SYNC);
        change(&mut config);
        let (mut stage, device) = on_bus(&config, true);
        stage.load.set(load);
        if !power {
            let now = stage.now;
            stage.world.change(device, now, |sensor: &mut CanForceSensor| sensor.set_power(false, now)).unwrap();
        }
        let error = stage.bring_up().unwrap_err().to_string();
        assert_eq!(stage.states.iter().filter(|state| state.fault.is_some()).count(), 0, "{error}");
        error
    };
    let none = [0.0; 6];
    let error = refused(|_| {}, none, false);
    is_refusal(
        &error,
        [NAME, "force sensor: no answer, waited", "check supply and cable of the sensor, and its node-ID"],
    );
    let error = refused(|config| config.device_type = Some(0x0002_0194), none, true);
    is_refusal(&error, [NAME, "force sensor: 0x1000 is 0x00000000", "another device has this node-ID"]);
    // The status of the emulated sensor has a bit per saturated channel; without it, the counts show the saturation.
    let beyond = [0.0, 0.0, -1e4, 0.0, 0.0, 0.0];
    let error = refused(|_| {}, beyond, true);
    is_refusal(&error, [NAME, "force sensor: sensor reports status 0x4", "see its data sheet"]);
    let narrow = |config: &mut drive::wrench::WrenchNodeConfig| config.sensor.channels[2].range = 1_000;
    let error = refused(narrow, [0.0, 0.0, -100.0, 0.0, 0.0, 0.0], true);
    is_refusal(
        &error,
        [NAME, "force sensor: Fz is saturated at", "free the tool of contact and load, check the cable of the sensor"],
    );
}

#[test]
fn a_zero_while_the_robot_moves_is_refused() {
    async fn moving(cell: &mut tasks::Cell) -> Outcome {
        let mut irb6 = cell.robot("irb6")?;
        let wrist = cell.force_sensor("wrist")?;
        // A robot at rest is zeroed before, with or without power.
        irb6.enable().await?;
        irb6.home().await?;
        wrist.zero().await?;
        let motion = irb6.motions().joints(0.3, &[[0.3, -1.571, 0.0, 1.2, 0.0]])?;
        join(irb6.execute(motion), async {
            cell.sleep(Duration::from_millis(300)).await;
            wrist.zero().await
        })
        .await?;
        irb6.disable().await
    }
    // The rehearsal finds the error before any motion.
    let Err(error) = ::mrroc::run(&cell(|_| {}), BenchKind::Lockstep, moving) else { panic!("the task runs") };
    is_refusal(
        &error.to_string(),
        ["force sensor wrist: ", "not zeroed, the robot moves", "while the robot stands still"],
    );
}
