//! Files: electronic data sheets, device configurations, candump lines, trajectories, cells and scenarios.

use std::path::Path;
use std::sync::LazyLock;

use arbitrary::{Arbitrary, Unstructured};
use can::candump::Entry;
use canopen::eds::Eds;
use canopen::{NodeId, dcf};
use controller::trajectory_file::TrajectoryFile;
use mrroc::bench::plants::EmulatedCell;
use mrroc::cell::{Cell, read_urdf};
use mrroc::scenario::Scenario;
use toml::Value;

use crate::devices::CELL;

/// An EDS or DCF: what is read can be written and read again, and its download has only writable objects.
pub fn eds(data: &[u8]) {
    match Eds::read(data) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(eds) => {
            let again = Eds::read(eds.to_string().as_bytes()).expect("a written data sheet can be read");
            assert_eq!(again.to_string(), eds.to_string());
            for node in [NodeId::new(1).unwrap(), NodeId::MAX] {
                match dcf::download(&eds, node) {
                    Ok(_) => {}
                    Err(refusal) => {
                        assert!(!refusal.errors.is_empty());
                        assert!(refusal.errors.iter().all(|error| !error.to_string().is_empty()));
                    }
                }
            }
        }
    }
}

/// Lines of a candump log, or a trajectory file, or the fault of one line. What is read is written and read again.
pub fn text_lines(data: &[u8]) {
    for line in data.split(|&byte| byte == b'\n') {
        if let Ok(entry) = Entry::parse(line) {
            assert_eq!(Entry::parse(entry.to_string().as_bytes()), Ok(entry));
        }
    }
    let Ok(text) = str::from_utf8(data) else {
        return;
    };
    if let Ok((file, notes)) = TrajectoryFile::read(text, 6) {
        assert!(file.columns() <= 6 && notes.iter().all(|note| !note.to_string().is_empty()));
    }
    match TrajectoryFile::parse(text) {
        Ok(file) => assert_eq!(TrajectoryFile::parse(&file.to_string()), Ok(file)),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if let Some(line) = text.lines().next() {
        let _ = Scenario::of_line(line);
    }
}

/// The examples that an input changes.
static EXAMPLES: LazyLock<Vec<toml::Table>> = LazyLock::new(|| {
    let names = ["irb6-touch", "irb6-serial", "irb6-can-wrist", "irb6-camera", "irb6-sonar", "irb6-conveyor"];
    let names = names.into_iter().chain(["irb6-milling", "irp6-track", "polycrank", "rnt", "two-irb6-bar"]);
    let read = |name: &str| {
        let path = format!("{}/../../cells/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        std::fs::read_to_string(path).unwrap().parse().unwrap()
    };
    names.map(read).collect()
});

/// A cell file: a text, or an example with changed values. A cell that is read has sound parameters.
pub fn cell(data: &[u8]) {
    let text = match data {
        [number, changes @ ..] if *number < 128 => {
            let mut document = Value::Table(EXAMPLES[usize::from(*number) % EXAMPLES.len()].clone());
            let mut input = Unstructured::new(changes);
            for _ in 0..8 {
                if input.is_empty() || change(&mut document, &mut input).is_err() {
                    break;
                }
            }
            match toml::to_string(&document) {
                Ok(text) => text,
                // Every table was removed.
                Err(_) => return,
            }
        }
        _ => match Cell::text(data) {
            Ok(text) => text.to_owned(),
            Err(error) => return assert!(!error.to_string().is_empty()),
        },
    };
    match Cell::parse(&text) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(cell) => {
            for robot in 0..cell.robot.len() {
                cell.arm(robot).expect("a parsed cell has sound parameters");
            }
            for bus in 0..cell.bus.len() {
                let _ = (cell.group_config(bus), cell.io_configs(bus), cell.sensor_configs(bus));
            }
        }
    }
}

/// Changes one value of a document.
fn change(value: &mut Value, input: &mut Unstructured) -> arbitrary::Result<()> {
    let deeper = match value {
        Value::Table(table) if !table.is_empty() => {
            let place = usize::from(u8::arbitrary(input)?) % table.len();
            if u8::arbitrary(input)? < 4 {
                let key = table.keys().nth(place).unwrap().clone();
                table.remove(&key);
                return Ok(());
            }
            table.iter_mut().nth(place).map(|(_, value)| value)
        }
        Value::Array(array) if !array.is_empty() => {
            let place = usize::from(u8::arbitrary(input)?) % array.len();
            match u8::arbitrary(input)? {
                0..4 => {
                    array.remove(place);
                    return Ok(());
                }
                4..8 => {
                    let again = array[place].clone();
                    array.push(again);
                    return Ok(());
                }
                _ => array.get_mut(place),
            }
        }
        _ => None,
    };
    if let Some(deeper) = deeper {
        return change(deeper, input);
    }
    *value = match (&*value, input.int_in_range(0..=11_u8)?) {
        (Value::Integer(number), 0..=5) => Value::Integer(number.wrapping_add(i64::from(i8::arbitrary(input)?))),
        (Value::Integer(number), 6) => Value::Float(*number as f64),
        (Value::Float(number), 0..=5) => Value::Float(number * f64::from(i8::arbitrary(input)?) / 16.0),
        (_, 7) => Value::Integer(i64::arbitrary(input)?),
        (_, 8) => Value::Float(f64::arbitrary(input)?),
        (_, 9) => Value::String(String::arbitrary(input)?),
        (_, 10) => Value::Boolean(bool::arbitrary(input)?),
        (_, 11) => Value::Array(Vec::new()),
        (other, _) => other.clone(),
    };
    Ok(())
}

/// A scenario file: a text, or a list of faults with arbitrary values. What is read has a place in the cell or a reason.
pub fn scenario(data: &[u8]) {
    let text = match data {
        [number, rest @ ..] if *number < 128 => {
            faults(&mut Unstructured::new(rest), u8::min(*number, 7) + 1).unwrap_or_default()
        }
        _ => match str::from_utf8(data) {
            Ok(text) => text.to_owned(),
            Err(_) => return,
        },
    };
    match Scenario::parse(Path::new("scenario"), &text) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(scenario) => {
            let mut world = hil::World::new();
            let emulated = EmulatedCell::of(&CELL);
            emulated.add_bus(&mut world, 0);
            match scenario.resolve(&CELL, &emulated.ids()) {
                Err(error) => assert!(!error.to_string().is_empty()),
                Ok(placed) => {
                    // Each fault begins, acts and ends in its world.
                    let mut now = can::Instant::ZERO;
                    for fault in placed.iter().flat_map(|fault| &fault.faults) {
                        let effect = world.begin_fault(fault, now);
                        now += std::time::Duration::from_millis(2);
                        world.advance(now);
                        world.end_fault(&effect, now);
                    }
                }
            }
        }
    }
}

/// Keys of a fault and their values.
fn faults(input: &mut Unstructured, count: u8) -> arbitrary::Result<String> {
    const KINDS: [&str; 12] = [
        "lost",
        "late",
        "duplicated",
        "corrupted",
        "swapped",
        "encoder-jump",
        "sagging-supply",
        "collision",
        "bus-off",
        "forged-emergency",
        "blocked",
        "reset",
    ];
    const KEYS: [&str; 18] = [
        "at",
        "when",
        "cycle",
        "bus",
        "node",
        "frame",
        "axis",
        "duration",
        "count",
        "probability",
        "seed",
        "late_ms",
        "increments",
        "share",
        "distance",
        "stiffness",
        "code",
        "kind",
    ];
    let mut text = String::new();
    for _ in 0..count {
        let kind = input.choose(&KINDS)?;
        text += &format!("[[fault]]\nkind = \"{kind}\"\n");
        text += input.choose(&["at = 0.0\n", "cycle = 3\n", "when = \"moving\"\n", ""])?;
        text += input.choose(&["axis = \"column\"\n", "bus = \"arm\"\n", "bus = \"arm\"\nnode = 2\n", ""])?;
        for _ in 0..input.int_in_range(0..=3_u8)? {
            let key = input.choose(&KEYS)?;
            let value = match input.int_in_range(0..=4_u8)? {
                0 => u8::arbitrary(input)?.to_string(),
                1 => i64::arbitrary(input)?.to_string(),
                2 => Value::Float(f64::arbitrary(input)?).to_string(),
                3 => (f64::from(u16::arbitrary(input)?) / 64.0 + 0.001).to_string(),
                _ => Value::String(String::arbitrary(input)?).to_string(),
            };
            text += &format!("{key} = {value}\n");
        }
    }
    Ok(text)
}

/// A robot description in URDF: a line and a problem, or a chain of finite numbers that `mrroc new` and cells can use.
pub fn urdf(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    match read_urdf(text, None, None).or_else(|_| read_urdf(text, None, Some("flange"))) {
        Err(problem) => {
            let line = problem.split(':').next().and_then(|line| line.parse::<u32>().ok());
            assert!(line.is_some(), "{problem}");
        }
        Ok(described) => {
            assert!(!described.joints.is_empty());
            for joint in &described.joints {
                let frame = joint.parent_from_joint.to_homogeneous();
                let body = joint.body.map_or([0.0; 6], |body| body.components());
                let numbers =
                    frame.iter().chain(&joint.axis).chain(&body).chain(joint.velocity.iter().chain(&joint.effort));
                assert!(numbers.into_iter().all(|number| number.is_finite()), "{joint:?}");
            }
        }
    }
}
