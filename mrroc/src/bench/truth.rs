//! The file of the truth of an emulated scene.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use can::Instant;

use crate::bench::scene::SceneTruth;
use crate::cell::CellFile;
use crate::row_file::{FileName, IncompleteFile, RowFile};

/// Writes true places of bars and true wrenches of grippers as CSV, one line per time, until the log is dropped.
pub struct TruthLog {
    /// `None` once the file is complete.
    rows: Option<RowFile>,
    done: SyncSender<Option<IncompleteFile>>,
}

impl TruthLog {
    /// Begins with the names of the columns. The receiver gets the report of the file if the file is incomplete.
    pub(crate) fn new(
        name: FileName,
        sink: File,
        file: &CellFile,
    ) -> io::Result<(Self, Receiver<Option<IncompleteFile>>)> {
        let mut head = "time_s".to_owned();
        if let Some(scene) = &file.cell.scene {
            let bars = scene.bar.iter().map(|bar| (&bar.name, &["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"][..]));
            let columns = &["fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm"][..];
            let grippers = scene.gripper.iter().map(|gripper| (&gripper.robot, columns));
            for (name, columns) in bars.chain(grippers) {
                // Writing to a text cannot fail.
                columns.iter().for_each(|column| _ = write!(head, ",{name}.{column}"));
            }
        }
        head.push('\n');
        let (done, written) = sync_channel(1);
        Ok((Self { rows: Some(RowFile::new(name, sink, &head)?), done }, written))
    }

    /// Writes the present state. After a first failure, nothing more is written.
    pub fn write(&mut self, now: Instant, truth: &SceneTruth) {
        if let Some(rows) = &mut self.rows {
            rows.row(now, |row| line(row, now, truth));
        }
    }
}

impl Drop for TruthLog {
    fn drop(&mut self) {
        if let Some(rows) = self.rows.take() {
            // The run may have ended without waiting.
            let _ = self.done.try_send(rows.finish(0));
        }
    }
}

fn line(row: &mut Vec<u8>, now: Instant, truth: &SceneTruth) -> io::Result<()> {
    write!(row, "{:.6}", now.as_nanos() as f64 * 1e-9)?;
    for bar in &truth.bars {
        let pose = bar.state().pose;
        for value in pose.translation.vector.iter().chain(pose.rotation.coords.iter()) {
            write!(row, ",{value:.9}")?;
        }
    }
    for grip in &truth.grips {
        match grip.last() {
            Some(wrench) => wrench.iter().try_for_each(|value| write!(row, ",{value:.6}"))?,
            // An open gripper.
            None => write!(row, ",,,,,,")?,
        }
    }
    Ok(())
}
