//! The file of the truth of an emulated scene.

use std::fs::File;
use std::io::{self, BufWriter, Write};

use can::Instant;

use crate::bench::scene::SceneTruth;
use crate::cell::CellFile;

/// Writes true places of bars and true wrenches of grippers as CSV, one line per time.
pub struct TruthLog {
    sink: BufWriter<File>,
    failed: Option<io::Error>,
}

impl TruthLog {
    /// Begins with the names of the columns.
    pub fn new(sink: File, file: &CellFile) -> io::Result<Self> {
        let mut sink = BufWriter::new(sink);
        write!(sink, "time_s")?;
        if let Some(scene) = &file.cell.scene {
            for bar in &scene.bar {
                let name = &bar.name;
                for column in ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"] {
                    write!(sink, ",{name}.{column}")?;
                }
            }
            for gripper in &scene.gripper {
                let name = &gripper.robot;
                for column in ["fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm"] {
                    write!(sink, ",{name}.{column}")?;
                }
            }
        }
        writeln!(sink)?;
        Ok(Self { sink, failed: None })
    }

    /// Writes the present state. After a first failure, nothing more is written.
    pub fn write(&mut self, now: Instant, truth: &SceneTruth) {
        if self.failed.is_none() {
            self.failed = self.line(now, truth).err();
        }
    }

    /// Completes the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.failed.take().map_or_else(|| self.sink.flush(), Err)
    }

    fn line(&mut self, now: Instant, truth: &SceneTruth) -> io::Result<()> {
        write!(self.sink, "{:.6}", now.as_nanos() as f64 * 1e-9)?;
        for bar in &truth.bars {
            let pose = bar.state().pose;
            for value in pose.translation.vector.iter().chain(pose.rotation.coords.iter()) {
                write!(self.sink, ",{value:.9}")?;
            }
        }
        for grip in &truth.grips {
            match grip.last() {
                Some(wrench) => wrench.iter().try_for_each(|value| write!(self.sink, ",{value:.6}"))?,
                // An open gripper.
                None => write!(self.sink, ",,,,,,")?,
            }
        }
        writeln!(self.sink)
    }
}
