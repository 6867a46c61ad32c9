//! Tests of devices of other crates: keys, refusals, schema, a run with its files, and faults.

use std::time::Duration;

use drive::device::DeviceFault;
use serde::{Deserialize, Serialize};

use super::*;
use crate::bench::BenchKind;
use crate::cell::{Cell, CellFile};
use crate::report::{RunOutcome, RunReport};
use crate::run::{Requests, RunOptions};
use crate::tasks::{self, Outcome, Program};

/// A range finder that answers each byte with its distance from a wall.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(crate) struct Ranger {
    /// Greatest distance, m.
    reach: f64,
    /// Answers that are cut after three bytes.
    #[serde(default)]
    torn: bool,
    /// Answers of up to 400 bytes.
    #[serde(default)]
    long: bool,
}

impl OwnDevice for Ranger {
    const KIND: &'static str = "test-ranger";
    const VALUES: &'static [DeviceValue] =
        &[DeviceValue::new("distance", "m", [0.0, 9.0]), DeviceValue::new("level", "", [0.0, 255.0]).times(2)];
    type Driver = Driver;
    type Emulator = Sensor;

    fn line(&self) -> LineConfig {
        let answer = if self.long { 400 } else { 4 };
        LineConfig::polled(Settings { baud: 115_200, stop_bits: StopBits::One }, 1, answer)
            .every(Duration::from_millis(10))
    }

    fn driver(&self) -> Driver {
        Driver::default()
    }

    fn emulator(&self) -> Sensor {
        Sensor { reach: self.reach, sent: 0, torn: self.torn }
    }

    fn rehearsed(&self) -> Vec<f64> {
        // Keys that a check of the kind forgets.
        if self.reach == 99.0 { vec![1.0] } else { vec![0.5 * self.reach, 1.0, 7.0] }
    }

    fn check(&self) -> Result<(), String> {
        if self.reach > 0.0 { Ok(()) } else { Err("has no reach".to_owned()) }
    }
}

/// Start byte, distance in cm, level, sum.
#[derive(Default)]
pub(crate) struct Driver {
    bytes: [u8; 4],
    count: usize,
}

impl LineDriver for Driver {
    fn query(&mut self, _now: Instant, query: &mut [u8; MOST_QUERY]) -> usize {
        query[0] = b'?';
        1
    }

    fn receive(&mut self, byte: u8, _now: Instant, values: &mut [f64]) -> Reception {
        if self.count == 0 && byte != b'!' {
            return Reception::Skipped;
        }
        self.bytes[self.count] = byte;
        self.count += 1;
        if self.count < 4 {
            return Reception::Pending;
        }
        self.count = 0;
        let [start, distance, level, sum] = self.bytes;
        if start.wrapping_add(distance).wrapping_add(level) != sum {
            return Reception::Skipped;
        }
        values[0] = if distance == 255 { f64::NAN } else { f64::from(distance) / 100.0 };
        (values[1], values[2]) = (f64::from(level), 7.0);
        Reception::Sample
    }

    fn restart(&mut self) {
        self.count = 0;
    }
}

pub(crate) struct Sensor {
    reach: f64,
    sent: u8,
    torn: bool,
}

impl LineEmulator for Sensor {
    fn receive(&mut self, _byte: u8, _now: Instant, around: &mut Surroundings, answer: &mut Answer<'_>) {
        let noise = around.noise();
        let distance = around.distance([1.0, 0.0, 0.0]).filter(|distance| *distance <= self.reach);
        let distance = distance.map_or(255, |distance| (100.0 * (distance + noise)).round() as u8);
        self.sent = self.sent.wrapping_add(1);
        let sum = b'!'.wrapping_add(distance).wrapping_add(self.sent);
        let count = if self.torn && self.sent > 5 { 3 } else { 4 };
        answer.send(Duration::from_millis(1), &[b'!', distance, self.sent, sum][..count]);
    }
}

/// The text of a cell with a ranger that looks along x at a wall at x = 1.5 m from x = 1 m.
pub(crate) fn text(keys: &str) -> String {
    let cell = include_str!("../../../cells/irb6.toml");
    let device = format!(
        "[[device]]\nname = \"front\"\nkind = \"test-ranger\"\nline = \"/dev/ttyUSB7\"\n\
         position = [1.0, 0.0, 0.2]\n{keys}\n\n\
         [[scene.plane]]\nnormal = [-1.0, 0.0, 0.0]\nheight = -1.5\nstiffness = 1e5\ndamping = 300.0\nfriction = 0.3\n\n"
    );
    cell.replacen("[[robot]]\n", &format!("{device}[[robot]]\n"), 1)
}

fn refused(keys: &str) -> String {
    register::<Ranger>();
    Cell::parse(&text(keys)).unwrap_err().to_string()
}

#[test]
fn keys_of_a_device_are_checked_with_line_key_and_the_known_words() {
    register::<Ranger>();
    register::<Ranger>();
    let cell = Cell::parse(&text("reach = 4.0")).unwrap();
    assert_eq!((cell.device[0].own.kind(), cell.device[0].own.of_crate()), ("test-ranger", "mrroc"));
    assert_eq!(cell.groups().collect::<Vec<_>>(), ["arm", "front"]);
    assert_eq!(cell.device_of_group(1).map(|device| &*device.keys.name), Some("front"));
    let line = text("").lines().position(|line| line == "position = [1.0, 0.0, 0.2]").unwrap() + 2;
    let said = |keys: &str| refused(keys);
    assert_eq!(
        said("raech = 4.0"),
        format!(
            "{line}: device[0].raech: is an unknown key, must be \"reach\", \"torn\" or \"long\"; keys of every device are name, \
             kind, line, robot, position, quaternion, tolerated_missing, boot_timeout_ms, emulator"
        )
    );
    assert!(said("").ends_with("device[0].reach: is missing"), "{}", said(""));
    assert_eq!(said("reach = \"far\"").split(": ").nth(1), Some("device[0].reach"));
    assert_eq!(said("reach = 4.0\nrobot = 3").split(": ").next(), Some(&*(line + 1).to_string()));
    assert!(said("reach = 4.0\nrobot = \"irb7\"").contains("device[0].robot: no robot is called \"irb7\""));
    assert!(said("reach = 0.0").contains("device[0]: has no reach"));
    assert!(said("reach = 30.0").ends_with("device[0].kind: declares 15 as distance for a rehearsal, must be 0 to 9"));
    assert!(said("reach = 99.0").ends_with("device[0].kind: declares 1 number for a rehearsal, must be 3"));
    assert!(said("reach = 4.0\nemulator = { deaf = true }").contains("device[0].emulator.deaf: is an unknown key"));
    assert!(said("reach = 4.0\nemulator = { silent_from_s = -1.0 }").contains("emulator.silent_from_s: is -1"));
    let other = text("reach = 4.0").replace("test-ranger", "acme-range");
    let other = Cell::parse(&other).unwrap_err().to_string();
    assert!(other.contains("device[0].kind: is \"acme-range\", must be \"test-ranger\""), "{other}");
    assert!(other.ends_with("a kind of another program is known to that program alone"), "{other}");
    let twice = text("reach = 4.0").replace("name = \"front\"", "name = \"arm\"");
    let twice = Cell::parse(&twice).unwrap_err().to_string();
    assert!(twice.contains("device[0].name: the name \"arm\" is used twice, first by bus[0]"), "{twice}");
}

#[test]
fn a_cell_is_written_and_read_again() {
    register::<Ranger>();
    let cell = Cell::parse(&text("reach = 4.0\nemulator = { noise = 0.25 }")).unwrap();
    let again = Cell::parse(&toml::to_string(&cell).unwrap()).unwrap();
    assert_eq!(again.device[0].keys.emulator.noise, 0.25);
    assert_eq!(again.device[0].own.table().unwrap()["reach"].as_float(), Some(4.0));
}

#[test]
#[should_panic(expected = "two kinds of devices are called \"test-ranger\"")]
fn a_kind_is_not_replaced() {
    #[derive(Clone, Debug, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    struct Other;
    impl OwnDevice for Other {
        const KIND: &'static str = "test-ranger";
        const VALUES: &'static [DeviceValue] = &[];
        type Driver = Driver;
        type Emulator = Sensor;
        fn line(&self) -> LineConfig {
            unreachable!("never registered")
        }
        fn driver(&self) -> Driver {
            Driver::default()
        }
        fn emulator(&self) -> Sensor {
            unreachable!("never registered")
        }
    }
    register::<Ranger>();
    register::<Other>();
}

#[cfg(feature = "schema")]
#[test]
fn the_schema_has_the_keys_of_a_kind_beside_those_of_every_device() {
    register::<Ranger>();
    let schema = Cell::schema();
    let variants = schema.as_value()["$defs"]["Device"]["oneOf"].as_array().unwrap().clone();
    let ranger = variants.iter().find(|it| it["properties"]["kind"]["const"] == "test-ranger").unwrap();
    assert_eq!(ranger["properties"]["reach"]["description"], "Greatest distance, m.");
    assert!(ranger["properties"]["line"].is_object());
    let required = ranger["required"].as_array().unwrap();
    assert!(required.contains(&"reach".into()) && required.contains(&"name".into()), "{required:?}");
    assert_eq!(ranger["additionalProperties"], false);
}

fn file(keys: &str) -> (tempfile::TempDir, CellFile) {
    register::<Ranger>();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cell.toml");
    std::fs::write(&path, text(keys)).unwrap();
    let file = CellFile::read(&path).unwrap();
    (directory, file)
}

fn run(
    file: &CellFile,
    options: &RunOptions,
    task: impl AsyncFn(&mut tasks::Cell) -> Outcome + Send + Sync + 'static,
) -> anyhow::Result<RunReport> {
    crate::run::run(file, options, &Requests::default(), &Program::of(task), &mut |_| {})
}

async fn measure(cell: &mut tasks::Cell) -> Outcome {
    let front = cell.device("front")?;
    let reading = front.read().await?;
    if !cell.rehearsing() {
        assert!(reading.age() <= Duration::from_millis(10), "{reading:?}");
        assert_eq!(reading.numbers("level")?[1], 7.0);
        let unknown = reading.value("hight").unwrap_err().to_string();
        assert_eq!(unknown, "device front: no value is called \"hight\", only distance, level");
        cell.figure("distance_m", reading.value("distance")?);
    }
    cell.sleep(Duration::from_millis(100)).await;
    assert!(front.latest()?.sample().number > reading.sample().number);
    let unknown = cell.device("back").err().unwrap().to_string();
    assert_eq!(unknown, "the cell has no device \"back\", it has: front; add the device as [[device]]");
    Ok(())
}

#[test]
fn a_task_reads_a_device_and_every_output_has_its_declared_values() {
    let (directory, file) = file("reach = 4.0");
    let rows = directory.path().join("rows.csv");
    let options = RunOptions { record: Some(rows.clone()), ..RunOptions::on(BenchKind::Lockstep) };
    let report = run(&file, &options, measure).unwrap();
    assert_eq!((report.outcome, report.figures["distance_m"]), (RunOutcome::Completed, 0.5), "{report:?}");
    let device = &report.devices[0];
    let names: Vec<_> = device.values.iter().map(|value| (&*value.name, value.unit)).collect();
    assert_eq!(names, [("distance", "m"), ("level_0", ""), ("level_1", "")]);
    assert!(device.samples >= 10 && device.values[0].last == Some(0.5), "{device:?}");
    assert!(report.to_string().contains("device front (test-ranger): "), "{report}");
    let rows = std::fs::read_to_string(rows).unwrap();
    let mut rows = rows.lines();
    assert!(rows.next().unwrap().ends_with(",homing,dt_s,front.distance_m,front.level_0,front.level_1"));
    let last = rows.next_back().unwrap();
    assert!(last.contains(",0.5,") && last.ends_with(",7"), "{last}");
}

#[test]
fn noise_is_of_the_seed_and_no_target_is_no_number() {
    let (_directory, noisy) = file("reach = 4.0\nemulator = { noise = 0.02 }");
    let distance = |file: &CellFile| run(file, &RunOptions::on(BenchKind::Lockstep), measure).unwrap().devices;
    let [first, second] = [distance(&noisy), distance(&noisy)];
    assert_eq!(first, second);
    assert!(first[0].values[0].least < first[0].values[0].greatest, "{first:?}");
    let (_directory, short) = file("reach = 0.3");
    let report = run(&short, &RunOptions::on(BenchKind::Lockstep), measure).unwrap();
    assert!(report.faults[0].what.starts_with("device front: distance is not measured"), "{:?}", report.faults);
    assert!(report.to_string().contains("distance was not measured"), "{report}");
}

#[test]
fn absent_silent_and_torn_devices_are_named() {
    let (_directory, absent) = file("reach = 4.0\nemulator = { absent = true }");
    let error = run(&absent, &RunOptions::on(BenchKind::Lockstep), measure).unwrap_err().to_string();
    assert!(error.starts_with("device front (test-ranger), line /dev/ttyUSB7: no answer, waited 2.0s"), "{error}");

    let wait = async |cell: &mut tasks::Cell| {
        let front = cell.device("front")?;
        cell.sleep(Duration::from_secs(2)).await;
        if !cell.rehearsing() {
            assert!(matches!(front.fault(), Some(DeviceFault::Silent { .. } | DeviceFault::Garbage { .. })));
        }
        front.read().await.map(drop)
    };
    let (_directory, silent) = file("reach = 4.0\nemulator = { silent_from_s = 1.0 }");
    let report = run(&silent, &RunOptions::on(BenchKind::Lockstep), wait).unwrap();
    let said: Vec<_> = report.faults.iter().map(|fault| fault.what.clone()).collect();
    assert!(said[0].starts_with("device front: no answer for 4 samples"), "{said:?}");
    assert!(said[1].starts_with("device front (test-ranger): no answer for 4 samples"), "{said:?}");
    assert!(report.faults[1].time_s.is_some_and(|time| time < 2.0), "{:?}", report.faults[1]);

    let (_directory, torn) = file("reach = 4.0\ntorn = true");
    let report = run(&torn, &RunOptions::on(BenchKind::Lockstep), wait).unwrap();
    assert!(report.faults[0].what.contains("readings since the last sample were no answer"), "{:?}", report.faults);
}

#[test]
fn a_wait_for_a_dead_device_ends_with_the_fault_of_its_driver() {
    let wait = async |cell: &mut tasks::Cell| {
        let front = cell.device("front")?;
        loop {
            front.read().await?;
            if cell.rehearsing() {
                return Ok(());
            }
        }
    };
    let (_directory, silent) = file("reach = 4.0\nemulator = { silent_from_s = 1.0 }\ntolerated_missing = 9");
    let report = run(&silent, &RunOptions::on(BenchKind::Lockstep), wait).unwrap();
    assert!(report.faults[0].what.starts_with("device front: no answer for 10 samples"), "{:?}", report.faults);
}

#[cfg(feature = "recording")]
#[test]
fn a_recording_has_the_samples_and_replays_them_bit_for_bit() {
    use crate::recording::{ReplayOptions, replay};
    let (directory, file) = file("reach = 4.0\nemulator = { noise = 0.02 }");
    let path = directory.path().join("run.mcap");
    let options = RunOptions { record: Some(path.clone()), ..RunOptions::on(BenchKind::Lockstep) };
    let report = run(&file, &options, measure).unwrap();
    let replayed = replay(&path, &ReplayOptions::default()).unwrap();
    assert!(replayed.is_equal() && replayed.is_whole(), "{replayed}");
    // A cell whose device has another name is refused.
    let other = directory.path().join("other.toml");
    std::fs::write(&other, text("reach = 4.0").replace("\"front\"", "\"rear\"")).unwrap();
    let error = replay(&path, &ReplayOptions { cell: Some(other) }).unwrap_err();
    assert!(format!("{error:#}").contains("other robots, axes, buses or lines"), "{error:#}");
    assert!(replayed.equal > report.devices[0].samples);
}

#[test]
fn the_check_has_the_line_of_a_device() {
    let (_directory, file) = file("reach = 4.0");
    let report = crate::check(&file, &Program::of(measure)).unwrap();
    let said = report.to_string();
    assert!(said.contains("device front of the cell: /dev/ttyUSB7 at 115200 bit/s, kind test-ranger, 100.0"), "{said}");
}
