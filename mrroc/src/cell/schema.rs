//! The JSON schema of cell files.

use schemars::{Schema, SchemaGenerator, json_schema, schema_for};

use serde_json::{Value, json};

use super::{Cell, Model};

impl Cell {
    /// The JSON schema of a cell file, with the robots of the program.
    pub fn schema() -> Schema {
        let mut schema = schema_for!(Self);
        for model in Model::all() {
            if let Model::Own(own) = model {
                add(&mut schema, model.name(), own.schema());
            }
        }
        schema
    }
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
