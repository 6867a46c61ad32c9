//! Pictures of the workpieces of an emulated scene.
//!
//! A picture is a binary PGM file with 16 bits per pixel, one pixel per cell of the height field. The grey value is
//! 65535 · (1 + height / thickness): white is the uncut face, and black a hole through the workpiece. The first row
//! has the greatest y, and the first pixel of a row has the least x. Comments in the file state the scale.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::bail;
use hil::scene::{HeightField, WorkpieceProbe};

use crate::cell::CellFile;
use crate::outputs::Outputs;
use crate::row_file::{FileName, IncompleteFile};

/// Files of the pictures of all workpieces, which are written after the run.
pub struct Carving(Vec<(WorkpieceProbe, (PathBuf, File))>);

impl Carving {
    /// The pictures of these workpieces, in the same order.
    pub fn new(workpieces: &[WorkpieceProbe], files: Vec<(PathBuf, File)>) -> Self {
        Self(workpieces.iter().cloned().zip(files).collect())
    }

    /// Writes the pictures of the present height fields. Returns the reports of files that cannot be written.
    pub fn write(self) -> Vec<IncompleteFile> {
        let failed = self.0.into_iter().filter_map(|(workpiece, (path, file))| {
            let mut sink = BufWriter::new(file);
            let written = write_picture(&mut sink, &workpiece.field()).and_then(|()| sink.flush());
            let name = FileName::new("--carved", &path, "picture");
            written.err().map(|error| IncompleteFile { lost: 1, ..name.fails(&error) })
        });
        failed.collect()
    }
}

/// Opens a file for each workpiece of a cell in `directory`, in the order of the cell file.
pub fn open(outputs: &mut Outputs, file: &CellFile, directory: Option<&Path>) -> anyhow::Result<Vec<(PathBuf, File)>> {
    let Some(directory) = directory else {
        return Ok(Vec::new());
    };
    let mut workpieces = file.cell.scene.iter().flat_map(|scene| &scene.workpiece).peekable();
    if workpieces.peek().is_none() {
        bail!("--carved needs a workpiece, and the scene of the cell has none: add a table scene.workpiece");
    }
    let mut opened = Vec::new();
    for workpiece in workpieces {
        let name = format!("{}.pgm", workpiece.name);
        opened.push((directory.join(&name), outputs.open_in("--carved", directory, &name)?));
    }
    Ok(opened)
}

/// Greatest grey value.
const WHITE: f64 = 65_535.0;

fn write_picture(sink: &mut impl Write, field: &HeightField) -> io::Result<()> {
    let [columns, rows] = field.cells();
    writeln!(sink, "P5")?;
    writeln!(sink, "# width of a pixel: {} m", field.width())?;
    writeln!(sink, "# height per grey level: {:e} m; 65535 is the uncut face", field.thickness() / WHITE)?;
    writeln!(sink, "{columns} {rows}\n65535")?;
    for row in (0..rows).rev() {
        for column in 0..columns {
            let share = 1.0 + field.height(column, row) / field.thickness();
            let grey = (share.clamp(0.0, 1.0) * WHITE).round() as u16;
            sink.write_all(&grey.to_be_bytes())?;
        }
    }
    Ok(())
}
