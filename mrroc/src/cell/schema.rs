//! The JSON schema of cell files.

use schemars::{Schema, SchemaGenerator, json_schema, schema_for};

use super::Cell;

impl Cell {
    /// The JSON schema of a cell file.
    pub fn schema() -> Schema {
        schema_for!(Self)
    }
}

/// The schema of a name, for fields whose attributes do not reach the schema.
pub(super) fn of_name(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$" })
}
