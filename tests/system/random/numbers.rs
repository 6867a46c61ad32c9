//! The numbers of a cell as one document, and their alterations.

use ::mrroc::cell::{Cell, CellError};
use kit::draw::Draw;
use toml::{Table, Value};

/// Keys without a quantity that a user tunes: names of devices, places in the scene, and the description of the
/// emulated devices. A trailing dot stands for every key of the table.
const FIXED: &[&str] = &[
    "seed",
    "realtime.",
    "scene.",
    "task.",
    "bus.host_node",
    "camera.",
    "force_sensor.",
    "io.",
    "ultrasonic.",
    "robot.parameters.",
    "robot.base.",
    "robot.tool",
    "robot.emulated_base_error.",
    "robot.program.joints.poses",
    "robot.program.line.position",
    "robot.program.line.quaternion",
    "robot.axis.node",
    "robot.axis.drive.vendor",
    "robot.axis.drive.product",
    "robot.axis.drive.revision",
    "robot.axis.drive.counts_per_revolution",
    "robot.axis.drive.rated_torque",
    "robot.axis.drive.parameter.",
    "robot.axis.drive.emergency_stop.",
    "robot.axis.controller.counts_per_revolution",
    "robot.axis.controller.torque_constant",
    "robot.axis.homing.method",
    "robot.axis.homing.order",
    "robot.axis.emulator.",
];

/// Longest times of a random cell, ms: the bring-up listens to a bus for three heartbeats.
const LONGEST: i64 = 60_000;
const LONGEST_HEARTBEAT: i64 = 1_000;

/// One step from a table or an array to its content.
#[derive(Clone, Debug, PartialEq)]
enum Step {
    Key(String),
    At(usize),
}

/// All numbers of a cell that are altered.
#[derive(Clone)]
pub(super) struct Numbers {
    document: Value,
    /// The key without indices, and the path of each number.
    places: Vec<(String, Vec<Step>)>,
}

/// One key that was altered in a cell.
#[derive(Clone, Debug)]
pub(super) struct Alteration {
    pub(super) key: String,
    /// Indices of the altered numbers, with their values before and after.
    numbers: Vec<(usize, Value, Value)>,
}

impl std::fmt::Display for Alteration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (_, before, after) = &self.numbers[0];
        write!(f, "{} ({} of them): {before} becomes {after}", self.key, self.numbers.len())
    }
}

impl Numbers {
    pub(super) fn of(cell: &Cell) -> Self {
        let document = Value::Table(Table::try_from(cell).expect("a cell is TOML"));
        let mut places = Vec::new();
        collect(&document, &mut Vec::new(), &mut places);
        Self { document, places }
    }

    pub(super) fn text(&self) -> String {
        toml::to_string(&self.document).expect("a document is TOML")
    }

    /// The cell as the file says it, without the checks of [`Cell::parse`].
    pub(super) fn unchecked(&self) -> Option<Cell> {
        self.document.clone().try_into().ok()
    }

    pub(super) fn parse(&self) -> Result<Cell, CellError> {
        Cell::parse(&self.text())
    }

    /// The names of all keys, once each.
    pub(super) fn keys(&self) -> Vec<&str> {
        let mut keys: Vec<_> = self.places.iter().map(|(key, _)| key.as_str()).collect();
        keys.sort_unstable();
        keys.dedup();
        keys
    }

    /// The numbers with this key.
    fn with_key(&self, key: &str) -> Vec<usize> {
        (0..self.places.len()).filter(|&number| self.places[number].0 == key).collect()
    }

    fn get(&self, number: usize) -> &Value {
        let (_, path) = &self.places[number];
        path.iter().fold(&self.document, |value, step| match step {
            Step::Key(key) => &value[key.as_str()],
            Step::At(index) => &value[*index],
        })
    }

    fn set(&mut self, number: usize, to: Value) {
        let (_, path) = &self.places[number];
        let place = path.iter().fold(&mut self.document, |value, step| match step {
            Step::Key(key) => &mut value[key.as_str()],
            Step::At(index) => &mut value[*index],
        });
        *place = to;
    }

    pub(super) fn apply(&mut self, alteration: &Alteration) {
        for (number, _, after) in &alteration.numbers {
            self.set(*number, after.clone());
        }
    }

    pub(super) fn revert(&mut self, alteration: &Alteration) {
        for (number, before, _) in &alteration.numbers {
            self.set(*number, before.clone());
        }
    }

    /// A random alteration of a random key: of all its numbers by the same factor, or of one of them.
    pub(super) fn draw(&self, draw: &mut Draw) -> Alteration {
        let keys = self.keys();
        let key = draw.among(&keys).to_owned();
        let mut numbers = self.with_key(&key);
        if draw.one_in(2) {
            numbers = vec![draw.among(&numbers)];
        }
        let decades = draw.among(&[0.1, 0.5, 1.5]);
        let factor = 10_f64.powf(draw.within(-decades, decades));
        let share = draw.within(0.0, 1.0);
        self.scaled(&key, numbers, |value| altered(&key, value, factor, share))
    }

    /// The numbers with this key, multiplied by `factor`. Whole numbers are rounded in the direction of the factor.
    /// `None` without such numbers, and if one of them is zero.
    pub(super) fn multiplied(&self, key: &str, factor: f64) -> Option<Alteration> {
        let numbers = self.with_key(key);
        let round = if factor < 1.0 { f64::floor } else { f64::ceil };
        let multiplied = |value: &Value| match value {
            Value::Integer(value) => Value::Integer(round(*value as f64 * factor) as i64),
            value => Value::Float(number(value) * factor),
        };
        let is_usable = !numbers.is_empty() && numbers.iter().all(|&it| number(self.get(it)) > 0.0);
        is_usable.then(|| self.scaled(key, numbers, multiplied))
    }

    fn scaled(&self, key: &str, numbers: Vec<usize>, of: impl Fn(&Value) -> Value) -> Alteration {
        let numbers = numbers.into_iter().map(|number| {
            let before = self.get(number).clone();
            let after = of(&before);
            (number, before, after)
        });
        Alteration { key: key.to_owned(), numbers: numbers.collect() }
    }

    /// The part of a refused alteration that is just accepted, and the part that is just refused.
    pub(super) fn bound(&mut self, alteration: &Alteration) -> (Alteration, Alteration) {
        let part = |share: f64| {
            let numbers = alteration
                .numbers
                .iter()
                .map(|(number, before, after)| (*number, before.clone(), between(before, after, share)));
            Alteration { numbers: numbers.collect(), ..alteration.clone() }
        };
        let (mut accepted, mut refused) = (0.0, 1.0);
        for _ in 0..20 {
            let middle = 0.5 * (accepted + refused);
            let tried = part(middle);
            self.apply(&tried);
            *if self.parse().is_ok() { &mut accepted } else { &mut refused } = middle;
        }
        self.revert(alteration);
        (part(accepted), part(refused))
    }
}

impl Alteration {
    /// The first altered number after the alteration.
    pub(super) fn value(&self) -> f64 {
        number(&self.numbers[0].2)
    }

    pub(super) fn is_idle(&self) -> bool {
        self.numbers.iter().all(|(_, before, after)| before == after)
    }
}

fn number(value: &Value) -> f64 {
    value.as_float().or(value.as_integer().map(|it| it as f64)).expect("a number")
}

/// A value between two numbers of one sign, on a logarithmic scale where both differ from zero.
fn between(before: &Value, after: &Value, share: f64) -> Value {
    let [low, high] = [before, after].map(number);
    let value = if low * high > 0.0 { low * (high / low).powf(share) } else { low + (high - low) * share };
    match (before, after) {
        _ if share == 0.0 => before.clone(),
        _ if share == 1.0 => after.clone(),
        // A period has whole milliseconds.
        (Value::Integer(a), Value::Integer(b)) if a % 1_000 == 0 && b % 1_000 == 0 && a.abs_diff(*b) > 1_000 => {
            Value::Integer((value / 1e3).round() as i64 * 1_000)
        }
        (Value::Integer(_), _) => Value::Integer(value.round() as i64),
        _ => Value::Float(value),
    }
}

fn altered(key: &str, value: &Value, factor: f64, share: f64) -> Value {
    match *value {
        Value::Float(0.0) if key == "bus.emulated_load" => Value::Float(0.9 * share),
        Value::Float(0.0) => Value::Float(factor * 1e-2),
        Value::Float(value) => Value::Float(value * factor),
        Value::Integer(value) if key == "period_us" => {
            Value::Integer(((value as f64 * factor / 1e3).round() as i64).clamp(1, 100) * 1_000)
        }
        Value::Integer(value) => {
            let most = if key == "bus.heartbeat_ms" { LONGEST_HEARTBEAT } else { LONGEST.max(value) };
            let scaled = if key == "serial.baud" || value > 0 { value as f64 * factor } else { 10.0 * share };
            Value::Integer((scaled.round() as i64).clamp(0, most))
        }
        ref other => other.clone(),
    }
}

/// The numbers of `value` at `path`.
fn collect(value: &Value, path: &mut Vec<Step>, places: &mut Vec<(String, Vec<Step>)>) {
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                path.push(Step::Key(key.clone()));
                collect(value, path, places);
                path.pop();
            }
        }
        Value::Array(array) => {
            for (index, value) in array.iter().enumerate() {
                path.push(Step::At(index));
                collect(value, path, places);
                path.pop();
            }
        }
        Value::Integer(_) | Value::Float(_) => {
            let keys = path.iter().filter_map(|step| match step {
                Step::Key(key) => Some(key.as_str()),
                Step::At(_) => None,
            });
            let key = keys.collect::<Vec<_>>().join(".");
            let is_fixed = FIXED.iter().any(|fixed| match fixed.strip_suffix('.') {
                Some(table) => key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.')),
                None => key == *fixed,
            });
            if !is_fixed {
                places.push((key, path.clone()));
            }
        }
        Value::String(_) | Value::Boolean(_) | Value::Datetime(_) => {}
    }
}
