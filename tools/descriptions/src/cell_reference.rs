//! The reference of cell files in Markdown, generated from their JSON schema.

use std::collections::VecDeque;
use std::fmt::Write as _;

use mrroc::cell::Cell;
use serde_json::{Map, Value};

/// Text above the tables.
const HEAD: &str = "# Cell-file reference\n\n\
    `mrroc schema --reference` generates this page from the JSON schema of cell files. A key without a default is \
    required. Ranges that follow from the robot or the drive are checked by `mrroc check`, with file, line and key.\n";

/// Prefix of a reference to a definition of the schema.
const DEFINITIONS: &str = "#/$defs/";

/// The reference: one table for the cell, then one for each type in the order of first mention.
pub fn reference() -> String {
    let schema = Cell::schema().to_value();
    let mut pages = Pages { definitions: &schema["$defs"], queue: VecDeque::new(), seen: Vec::new() };
    let mut text = HEAD.to_owned();
    pages.write(&mut text, "Cell", &schema);
    while let Some(name) = pages.queue.pop_front() {
        let definition = &pages.definitions[name];
        pages.write(&mut text, name, definition);
    }
    text
}

/// Types still to be written.
struct Pages<'a> {
    definitions: &'a Value,
    queue: VecDeque<&'a str>,
    seen: Vec<&'a str>,
}

impl<'a> Pages<'a> {
    fn write(&mut self, text: &mut String, name: &str, schema: &'a Value) {
        let _ = write!(text, "\n## {name}\n\n{}\n", described(schema));
        if let Some(properties) = schema["properties"].as_object() {
            let _ = write!(text, "\n| key | type | default | meaning |\n|---|---|---|---|\n");
            for (key, value) in properties {
                self.row(text, key, value, is_required(schema, key));
            }
        }
        let Some(variants) = schema["oneOf"].as_array() else {
            return;
        };
        let _ = write!(text, "\n| value | meaning |\n|---|---|\n");
        for variant in variants {
            let value = match (variant["const"].as_str(), variant["properties"].as_object()) {
                (Some(value), _) => format!("`\"{value}\"`"),
                (None, Some(keys)) => self.table(keys),
                (None, None) => self.name(variant),
            };
            let _ = writeln!(text, "| {value} | {} |", described(variant));
        }
    }

    fn row(&mut self, text: &mut String, key: &str, value: &'a Value, required: bool) {
        let default = match &value["default"] {
            _ if required => String::new(),
            Value::Null => "absent".to_owned(),
            Value::Object(_) => "see there".to_owned(),
            default => format!("`{default}`"),
        };
        let kind = self.name(value);
        let _ = writeln!(text, "| `{key}` | {kind} | {default} | {} |", described(value));
    }

    /// A table with these keys in the inline notation of TOML.
    fn table(&mut self, keys: &'a Map<String, Value>) -> String {
        let keys: Vec<_> = keys.iter().map(|(key, value)| format!("`{key}` = {}", self.name(value))).collect();
        keys.join(", ")
    }

    /// Name of the type of a value. A type with a table of its own is queued.
    fn name(&mut self, value: &'a Value) -> String {
        if let Some(name) = value["$ref"].as_str().and_then(|it| it.strip_prefix(DEFINITIONS)) {
            if !self.seen.contains(&name) {
                self.seen.push(name);
                self.queue.push_back(name);
            }
            return format!("[{name}](#{})", name.to_lowercase());
        }
        if let Some(choices) = value["anyOf"].as_array() {
            let real = choices.iter().filter(|choice| choice["type"] != "null");
            let names: Vec<_> = real.map(|choice| self.name(choice)).collect();
            return names.join(" or ");
        }
        let kind = match &value["type"] {
            Value::Array(kinds) => kinds.iter().find(|kind| *kind != "null"),
            kind => Some(kind),
        };
        match kind.and_then(Value::as_str) {
            Some("array") if value["items"].is_object() => format!("array of {}", self.name(&value["items"])),
            Some("number") => "float".to_owned(),
            Some(kind) => kind.to_owned(),
            None => "value".to_owned(),
        }
    }
}

fn is_required(schema: &Value, key: &str) -> bool {
    schema["required"].as_array().is_some_and(|keys| keys.iter().any(|it| it == key))
}

/// Description in one line for a table cell.
fn described(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().replace('\n', " ").replace('|', "\\|")
}
