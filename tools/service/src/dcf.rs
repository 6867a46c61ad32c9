//! `mrroc dcf`: device configuration files (DCF) of drives. Removes refused values from a file, saves the values of a
//! drive, and compares a drive with a file.

mod compare;
mod save;
mod strip;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, anyhow};
use canopen::eds::{DataType, Eds};
use canopen::{NodeId, Object};
use clap::{Args, Subcommand};
use master::sdo::{SdoCause, SdoError};
use mrroc::cell::printable;
use mrroc::input;
use mrroc::outputs::Replacement;

use super::sdo::{Peer, refusal};
use super::value::Type;
use super::{BusArgs, Channel, node_id};

/// Actions of `mrroc dcf`.
#[derive(Subcommand)]
pub enum Action {
    /// Write a device configuration file without its refused values: values of objects that belong to the driver, and
    /// values that are refused for another reason. Each refused line becomes a comment with the reason. All other lines
    /// stay as they are, also values equal to their default.
    Strip {
        /// The file.
        #[arg(value_name = "IN")]
        input: PathBuf,
        /// The file to write.
        #[arg(value_name = "OUT")]
        output: PathBuf,
        /// What happens to an existing file.
        #[command(flatten)]
        replacement: Replacement,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Read the values of a drive into a device configuration file. A cell accepts the file as its key `dcf`: values of
    /// read-only objects and of objects that belong to the driver are notes.
    Save {
        /// The drive.
        #[command(flatten)]
        drive: Addressed,
        /// The file to write.
        #[arg(value_name = "OUT")]
        output: PathBuf,
        /// The data sheet (EDS or DCF) of the drive. Without a data sheet, the objects that this program knows by name
        /// are read, and all values are notes, because the writable objects are not known.
        #[arg(long, value_name = "FILE")]
        eds: Option<PathBuf>,
        /// What happens to an existing file.
        #[command(flatten)]
        replacement: Replacement,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Compare the values of a drive with those of a device configuration file. Exit status 1 if a value differs or cannot
    /// be read.
    Compare {
        /// The drive.
        #[command(flatten)]
        drive: Addressed,
        /// The device configuration file.
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Compare notes as well: values with bit 0 of their ObjFlags, such as measured values.
        #[arg(long)]
        notes: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
}

/// A drive on a bus.
#[derive(Args)]
pub struct Addressed {
    #[command(flatten)]
    bus: BusArgs,
    /// The node-ID.
    #[arg(value_parser = node_id)]
    node: NodeId,
    /// Time to wait for each answer, ms.
    #[arg(long, value_name = "MS", default_value_t = 1000)]
    timeout: u64,
}

/// Runs the action.
pub fn dcf(action: &Action) -> anyhow::Result<ExitCode> {
    match action {
        Action::Strip { input, output, replacement, json } => strip::strip(input, output, *replacement, *json),
        Action::Save { drive, output, eds, replacement, json } => {
            save::save(drive, output, eds.as_deref(), *replacement, *json)
        }
        Action::Compare { drive, file, notes, json } => compare::compare(drive, file, *notes, *json),
    }
}

/// A drive whose objects are read one after the other.
struct Reader {
    channel: Channel,
    peer: Peer,
}

impl Addressed {
    fn open(&self, first: Object) -> anyhow::Result<Reader> {
        let peer = Peer { node: self.node, block: false, timeout: Duration::from_millis(self.timeout) };
        Ok(Reader { channel: peer.open(&self.bus, first)?, peer })
    }
}

impl Reader {
    /// The value of an object, or the abort of the drive. No answer is an error.
    fn read(&mut self, object: Object, ty: Option<Type>) -> anyhow::Result<Result<Vec<u8>, SdoError>> {
        let read = self.peer.transfer(&mut self.channel, object, None, ty)?;
        match read {
            Err(error) if !matches!(error.cause, SdoCause::Aborted { .. }) => {
                Err(refusal(&self.channel, self.peer.node, error))
            }
            read => Ok(read),
        }
    }

    /// Name of the drive in reports.
    fn name(&self) -> String {
        match &self.channel {
            Channel::Bus(bus) => bus.name_of(self.peer.node),
            Channel::Drive(drive) => drive.name_of(self.peer.node),
        }
    }

    /// Bit rate of the bus, kbit/s, if a cell states it.
    fn bitrate(&self) -> Option<u32> {
        let cell = match &self.channel {
            Channel::Bus(bus) => bus.cell.as_ref(),
            Channel::Drive(drive) => drive.cell.as_ref(),
        };
        cell.map(|(file, bus)| file.cell.bus[*bus].bitrate_kbps)
    }
}

/// Path of a file in messages.
fn shown(path: &Path) -> String {
    printable(&path.display().to_string())
}

/// Reads the bytes of a data sheet.
fn bytes(path: &Path) -> anyhow::Result<Vec<u8>> {
    input::read(path, input::SHEET).with_context(|| shown(path))
}

/// Reads a data sheet from its bytes.
fn parsed(path: &Path, bytes: &[u8]) -> anyhow::Result<Eds> {
    Eds::read(bytes).map_err(|error| anyhow!("{}:{error}", shown(path)))
}

/// Type of the values of a data type; `None` for a type that has no name on the command line.
fn value_type(data_type: DataType) -> Option<Type> {
    super::data_sheet::value_type(data_type)
}
