//! The JSON schema of cell files.

use schemars::{Schema, SchemaGenerator, json_schema, schema_for};

use serde_json::{Value, json};

use super::{Cell, Model};
use crate::devices::OwnKind;

impl Cell {
    /// The JSON schema of a cell file, with the robots of the program.
    pub fn schema() -> Schema {
        let mut schema = schema_for!(Self);
        for model in Model::all() {
            if let Model::Own(own) = model {
                add(&mut schema, model.name(), own.schema());
            }
        }
        let kinds = OwnKind::all();
        if !kinds.is_empty() {
            add_devices(&mut schema, &kinds);
        }
        schema
    }
}

/// Adds the kinds of devices. Each kind has the keys of every device and its own keys.
fn add_devices(schema: &mut Schema, kinds: &[OwnKind]) {
    let Some(definitions) = schema.get_mut("$defs").and_then(Value::as_object_mut) else {
        return;
    };
    let every = definitions.get("Device").cloned().unwrap_or_default();
    let mut variants = Vec::new();
    for kind in kinds {
        let mut own = kind.schema();
        if let Some(Value::Object(inner)) = own.remove("$defs") {
            for (key, definition) in inner {
                definitions.entry(key).or_insert(definition);
            }
        }
        let mut variant = every.clone();
        if let Some(properties) = variant.get_mut("properties").and_then(Value::as_object_mut) {
            properties.insert("kind".to_owned(), json!({ "type": "string", "const": kind.name() }));
            properties.extend(own.get("properties").and_then(Value::as_object).cloned().unwrap_or_default());
        }
        if let Some(required) = variant.get_mut("required").and_then(Value::as_array_mut) {
            required.extend(own.get("required").and_then(Value::as_array).cloned().unwrap_or_default());
        }
        variant["description"] = own.get("description").cloned().unwrap_or_default();
        variants.push(variant);
    }
    definitions.insert("Device".to_owned(), json!({ "description": every["description"], "oneOf": variants }));
}

/// Adds a model and its numbers.
fn add(schema: &mut Schema, name: &str, mut numbers: Schema) {
    let Some(definitions) = schema.get_mut("$defs").and_then(Value::as_object_mut) else {
        return;
    };
    numbers.remove("$schema");
    if let Some(Value::Object(inner)) = numbers.remove("$defs") {
        for (key, definition) in inner {
            definitions.entry(key).or_insert(definition);
        }
    }
    let description = "A robot of the program that printed this schema.";
    let table = json!({
        "description": format!("For `model = \"{name}\"`."),
        "type": "object",
        "properties": { name: numbers },
        "required": [name],
        "additionalProperties": false
    });
    let model = json!({ "description": description, "type": "string", "const": name });
    for (definition, variant) in [("Model", model), ("Parameters", table)] {
        let variants = definitions.get_mut(definition).and_then(|it| it.get_mut("oneOf")).and_then(Value::as_array_mut);
        variants.expect("models and parameters are lists").push(variant);
    }
}

/// The schema of a name, for fields whose attributes do not reach the schema.
pub(super) fn of_name(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$" })
}
