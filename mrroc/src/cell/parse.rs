//! Conversion of the text of a cell file into a checked cell.

use super::{Cell, CellError, LARGEST, chain, error, read, validation};

impl Cell {
    /// The text of a cell file. Bytes that are not UTF-8 or more than [`LARGEST`] are refused.
    pub fn text(bytes: &[u8]) -> Result<&str, CellError> {
        if bytes.len() > LARGEST {
            let problem = format!("the file has {} bytes, a cell file may have {LARGEST}", bytes.len());
            return Err(CellError::of_text(1, problem));
        }
        str::from_utf8(bytes).map_err(|error| {
            let end = error.valid_up_to();
            let problem = format!("the byte {:#04x} is no UTF-8 text: save the file as UTF-8", bytes[end]);
            CellError::of_text(error::line_at(bytes, end), problem)
        })
    }

    /// Reads and checks the text of a cell file that names no robot description.
    pub fn parse(text: &str) -> Result<Self, CellError> {
        Self::parse_with(text, &mut |_| Err("is a file, which a text alone does not have".to_owned()))
    }

    /// Reads and checks the text of a cell file. `files` gives the robot descriptions that it names.
    pub(crate) fn parse_with(
        text: &str,
        files: &mut dyn FnMut(&str) -> Result<String, String>,
    ) -> Result<Self, CellError> {
        let document = read::parse(text)?;
        crate::robots::check_own(text, &document)?;
        crate::devices::check(text, &document)?;
        let mut cell: Self = read::read(text, &document)?;
        chain::resolve(&mut cell, files).map_err(|(path, problem)| CellError::at(text, &path, problem))?;
        validation::check(&cell).map_err(|(path, problem)| CellError::at(text, &path, problem))?;
        Ok(cell)
    }
}
