//! Cells that differ from an example in one line.

use std::collections::BTreeMap;

use ::mrroc::cell::{Cell, Model};

use super::operators::Operator;
use super::variants;
use super::verdict::Case;
use kit::draw::Draw;

/// One line of a cell and its alteration.
#[derive(Clone, Copy, Debug)]
struct Mutation {
    /// Index in the list of keys.
    key: usize,
    /// Index in the list of cells.
    cell: usize,
    operator: Operator,
}

/// The cells, the keys of their lines, and every alteration of every key of every cell.
pub(super) struct Mutations {
    cells: Vec<String>,
    keys: Vec<Key>,
    /// In the order of the cases, in which the keys alternate.
    mutations: Vec<Mutation>,
}

/// A key or a table, without indices: `robot.axis.node` or `[robot.axis]`.
struct Key {
    name: String,
    /// Numbers of the lines with this key, by the index of the cell.
    lines: BTreeMap<usize, Vec<usize>>,
}

impl Mutations {
    /// The alterations of a seed, which determines their order.
    pub(super) fn of(seed: u64) -> Self {
        let cells = variants::all();
        let mut names = BTreeMap::<String, BTreeMap<usize, Vec<usize>>>::new();
        for (number, cell) in cells.iter().enumerate() {
            for (line, name) in keys(cell) {
                let lines = names.entry(name).or_default();
                lines.entry(number).or_default().push(line);
            }
        }
        let keys: Vec<_> = names.into_iter().map(|(name, lines)| Key { name, lines }).collect();
        let mutations = in_turns(seed, &cells, &keys);
        Self { cells, keys, mutations }
    }

    /// The unaltered cells.
    pub(super) fn cells(&self) -> &[String] {
        &self.cells
    }

    /// Number of keys. This number of cases alters each key once.
    pub(super) fn keys(&self) -> usize {
        self.keys.len()
    }

    /// Number of cases that apply every operator to every key of every cell once.
    pub(super) fn complete(&self) -> usize {
        self.mutations.len()
    }

    fn mutation(&self, case: u64) -> Mutation {
        self.mutations[case as usize % self.mutations.len()]
    }

    /// The key that case `case` alters.
    pub(super) fn key(&self, case: u64) -> &str {
        &self.keys[self.mutation(case).key].name
    }

    /// The operator that case `case` applies to its key.
    pub(super) fn operator(&self, case: u64) -> Operator {
        self.mutation(case).operator
    }

    /// Case `case` of a seed.
    pub(super) fn case(&self, seed: u64, case: u64) -> Case {
        let mut draw = Draw::of(seed, case);
        let Mutation { key, cell, operator } = self.mutation(case);
        let Key { name, lines } = &self.keys[key];
        let places: Vec<_> = lines[&cell].clone();
        let cell = &self.cells[cell];
        let mut lines: Vec<_> = cell.lines().map(str::to_owned).collect();
        // Some of the lines with this key may be arrays and others not.
        let fitting = places.into_iter().filter(|&line| Operator::all(&lines[line]).contains(&operator));
        let number = draw.among(&fitting.collect::<Vec<_>>());
        let before = lines[number].clone();
        let after = operator.apply(&mut draw, &before, cell);
        lines[number].clone_from(&after);
        Case {
            what: format!("{name}, {operator:?}: {before:.200} becomes {after:.200}:"),
            cell: lines.join("\n") + "\n",
        }
    }
}

/// Every alteration of every key of every cell. The alterations of one key come in a random order, and the keys take
/// turns.
fn in_turns(seed: u64, cells: &[String], keys: &[Key]) -> Vec<Mutation> {
    let mut of_keys = Vec::new();
    for (number, key) in keys.iter().enumerate() {
        let mut of_key = Vec::new();
        for (&cell, lines) in &key.lines {
            let texts: Vec<_> = cells[cell].lines().collect();
            let mut operators: Vec<_> = lines.iter().flat_map(|&line| Operator::all(texts[line])).collect();
            operators.sort_unstable();
            operators.dedup();
            of_key.extend(operators.into_iter().map(|operator| Mutation { key: number, cell, operator }));
        }
        let mut draw = Draw::of(seed ^ u64::MAX, number as u64);
        for place in (1..of_key.len()).rev() {
            of_key.swap(place, draw.below(place + 1));
        }
        of_keys.push(of_key);
    }
    let rounds = of_keys.iter().map(Vec::len).max().unwrap_or(0);
    let in_round = |round| of_keys.iter().filter_map(move |of_key| of_key.get(round));
    (0..rounds).flat_map(in_round).copied().collect()
}

/// Line number and key of each line with a key or the header of a table.
fn keys(cell: &str) -> Vec<(usize, String)> {
    let mut table = String::new();
    let mut keys = Vec::new();
    for (number, line) in cell.lines().enumerate() {
        if let Some(name) = line.strip_prefix('[') {
            table = name.trim_matches(['[', ']']).to_owned();
            keys.push((number, format!("[{table}]")));
        } else if let Some((key, _)) = line.split_once(" = ") {
            let path = if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") };
            keys.push((number, path));
        }
    }
    keys
}

/// Paths of all keys with a value under a schema, prefixed by `path`. A name that occurs once in a cell is sufficient
/// if the schema uses the same definition in several places.
fn of_schema(schema: &serde_json::Value, root: &serde_json::Value, path: &str, keys: &mut Vec<String>) {
    let reference = schema["$ref"].as_str().and_then(|it| it.strip_prefix("#/$defs/"));
    if let Some(name) = reference {
        return of_schema(&root["$defs"][name], root, path, keys);
    }
    let mut leaf = true;
    for choice in ["oneOf", "anyOf"] {
        let choices = schema[choice].as_array().into_iter().flatten();
        for choice in choices.filter(|it| it["type"] != "null") {
            leaf = false;
            of_schema(choice, root, path, keys);
        }
    }
    let items = &schema["items"];
    if items["$ref"].is_string() {
        leaf = false;
        of_schema(items, root, path, keys);
    }
    for (name, of_name) in schema["properties"].as_object().into_iter().flatten() {
        leaf = false;
        let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        of_schema(of_name, root, &path, keys);
    }
    if leaf {
        keys.push(path.to_owned());
    }
}

#[test]
fn every_key_that_a_cell_file_can_have_is_altered_in_every_way() {
    let mutations = Mutations::of(1);
    let schema = serde_json::to_value(Cell::schema()).expect("a schema is JSON");
    let mut wanted = Vec::new();
    of_schema(&schema, &schema, "", &mut wanted);
    assert!(wanted.len() > 200, "{wanted:?}");
    // No axis controller closes the velocity loop that this law requires.
    wanted.retain(|key| !key.starts_with("robot.axis.controller.loop.law.proportional."));
    // Only a program that adds a kind of device has devices.
    wanted.retain(|key| !key.starts_with("device."));
    // The keys of this table are the task's own.
    wanted.retain(|key| key != "task");
    let has = |wanted: &String| mutations.keys.iter().any(|key| key.name == *wanted);
    let missing: Vec<_> = wanted.iter().filter(|wanted| !has(wanted)).collect();
    assert!(missing.is_empty(), "{missing:#?}");
    let mut models = Model::ALL.map(Model::name).to_vec();
    models.retain(|model| {
        let line = format!("model = \"{model}\"");
        !mutations.cells.iter().any(|cell| cell.contains(&line))
    });
    assert!(models.iter().all(|model| model.ends_with("calibrated")), "{models:?}");
    let all = 0..mutations.complete() as u64;
    let all = all.map(|case| (mutations.key(case), mutations.operator(case)));
    for key in &mutations.keys {
        let operators = all.clone().filter(|(name, _)| *name == key.name).count();
        let expected = if key.name.starts_with('[') { 4 } else { 17 };
        assert!(operators >= expected * key.lines.len(), "{}", key.name);
    }
}
