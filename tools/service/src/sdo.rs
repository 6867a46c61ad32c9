//! `mrroc sdo`: reads or writes one object of one node.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::{Frame, Instant, clock};
use canopen::objects::{DEVICE_TYPE, ERROR_CODE, ERROR_HISTORY_NEWEST, RESTORE_ALL, STORE_ALL, VENDOR_ID};
use canopen::sdo::AbortCode;
use canopen::{NodeId, Object};
use clap::{Args, Subcommand};
use drive::cia402::reserved;
use master::sdo::{Client, SdoCause, SdoError, StartError};
use mrroc::bench::interfaces::Interface;
use mrroc::cell::printable;
use mrroc::streams;
use serde::Serialize;

use super::data_sheet::{DataSheet, Selector};
use super::talk::Conversation;
use super::value::{self, Shown, Type};
use super::words::{self, Identification};
use super::{Bus, BusArgs, Channel, Interrupted, node_id};

/// Number of repetitions of a transfer that is not answered.
const RETRIES: u8 = 2;

/// Longest object that is transferred, bytes. Programs and tables of drives are shorter.
const CAPACITY: usize = 1 << 20;

/// Actions of `mrroc sdo`.
#[derive(Subcommand)]
pub enum Action {
    /// Read an object (SDO upload).
    Read {
        /// The object.
        #[command(flatten)]
        target: Target,
        /// Type of the value. [default: the type in the data sheet, or all plausible representations]
        #[arg(long = "type", value_name = "TYPE")]
        ty: Option<Type>,
    },
    /// Write an object (SDO download) and read it back. Writing some objects moves the drive, or stores or erases its
    /// parameters.
    #[command(allow_negative_numbers = true)]
    Write {
        /// The object.
        #[command(flatten)]
        target: Target,
        /// The value: a decimal or hexadecimal (0x…) number, text, or bytes.
        value: String,
        /// Type of the value. [default: the type in the data sheet]
        #[arg(long = "type", value_name = "TYPE", required_unless_present = "eds")]
        ty: Option<Type>,
        /// Do not read the object back.
        #[arg(long)]
        no_read_back: bool,
    },
}

/// Selection of bus, node and object.
#[derive(Args)]
pub struct Target {
    #[command(flatten)]
    bus: BusArgs,
    /// The node-ID.
    #[arg(value_parser = node_id)]
    node: NodeId,
    /// The object, such as 0x6041:0 or 6041:0. Index and sub-index are hexadecimal, with or without 0x. An index
    /// without 0x has four digits. The default sub-index is 0. With --eds, the name of the object in the data sheet is
    /// accepted as well, such as "Statusword" or "Software position limit: Min position limit".
    #[arg(value_name = "INDEX:SUB", value_parser = selector)]
    object: Selector,
    /// The data sheet (EDS or DCF) of the device. The data sheet supplies names and types. An access that the data
    /// sheet does not allow is refused.
    #[arg(long, value_name = "FILE")]
    eds: Option<PathBuf>,
    /// Use block transfer, which is faster for large objects. If the node does not support block transfer, ordinary
    /// transfer is used.
    #[arg(long)]
    block: bool,
    /// Time to wait for an answer, ms. Storing parameters may take seconds.
    #[arg(long, value_name = "MS", default_value_t = 1000)]
    timeout: u64,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Target {
    /// The object and its entry in the data sheet, if a data sheet is given.
    fn resolve(&self) -> anyhow::Result<(Object, Option<DataSheet>)> {
        match (&self.eds, &self.object) {
            (Some(path), selected) => {
                let sheet = DataSheet::read(path, selected)?;
                Ok((sheet.object, Some(sheet)))
            }
            (None, Selector::Address(object)) => Ok((*object, None)),
            (None, Selector::Name(name)) => {
                bail!("{}: {NOTATION}; a name needs --eds", printable(name))
            }
        }
    }

    /// The node, and how its objects are transferred.
    fn peer(&self) -> Peer {
        Peer { node: self.node, block: self.block, timeout: Duration::from_millis(self.timeout) }
    }
}

/// A node, and how its objects are transferred.
#[derive(Clone, Copy)]
pub(super) struct Peer {
    pub(super) node: NodeId,
    /// By blocks.
    pub(super) block: bool,
    /// Time to wait for an answer.
    pub(super) timeout: Duration,
}

impl Peer {
    /// Opens the bus or the service port. On a bus, late answers to requests of an earlier process are passed first.
    pub(super) fn open(&self, bus: &BusArgs, object: Object) -> anyhow::Result<Channel> {
        let mut channel = bus.open_channel(self.timeout)?;
        if let Channel::Bus(bus) = &mut channel {
            // A node that does not answer the question is reported by the transfer.
            bus.hold(&mut question(self.node, object, self.timeout, clock::now())?)?;
        }
        Ok(channel)
    }

    /// Writes `data` into an object of the node, or reads the object if `data` is `None`. The error after Ctrl-C is
    /// [`Interrupted`].
    fn hold(&self, bus: &mut Bus, object: Object, data: Option<&[u8]>) -> anyhow::Result<Client> {
        let mut client = start(self.node, object, data, self.block, self.timeout, clock::now())?;
        bus.hold(&mut client)?;
        Ok(client)
    }

    /// Value that was read, or empty after a write. A service port does not report the length of an object, so `ty` gives
    /// it.
    pub(super) fn transfer(
        &self,
        channel: &mut Channel,
        object: Object,
        data: Option<&[u8]>,
        ty: Option<Type>,
    ) -> anyhow::Result<Result<Vec<u8>, SdoError>> {
        let bus = match channel {
            Channel::Bus(bus) => bus,
            Channel::Drive(_) if self.block => bail!("--block: a service port transfers no blocks"),
            Channel::Drive(drive) => return drive.transfer(self.node.raw(), object, data, ty),
        };
        let mut client = self.hold(bus, object, data)?;
        let found = client.poll().ok_or(Interrupted)?;
        Ok(found.map(|found| found.data.to_vec()))
    }
}

/// How an object is written on the command line.
pub(super) const NOTATION: &str =
    "an object is INDEX:SUB in hexadecimal, such as 0x6041:0, or 6041:0 with all four digits of the index";

/// Parses an object on the command line: an address, or otherwise a name.
fn selector(text: &str) -> Result<Selector, Infallible> {
    Ok(object(text).map_or_else(|_| Selector::Name(text.to_owned()), Selector::Address))
}

/// Parses an address.
fn object(text: &str) -> Result<Object, &'static str> {
    let (index, subindex) = text.split_once(':').unwrap_or((text, "0"));
    let marked = index.starts_with("0x") || index.starts_with("0X");
    let index = hexadecimal(index, 4).filter(|_| marked || index.len() == 4);
    let subindex = hexadecimal(subindex, 2).map(|subindex| subindex as u8);
    match (index, subindex) {
        (Some(index), Some(subindex)) => Ok(Object::new(index, subindex)),
        _ => Err(NOTATION),
    }
}

/// Parses a number of at most `most` hexadecimal digits, with or without 0x.
fn hexadecimal(text: &str, most: usize) -> Option<u16> {
    let marked = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let digits = marked.unwrap_or(text);
    let plain = digits.len() <= most && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    u16::from_str_radix(digits, 16).ok().filter(|_| plain)
}

/// Reads or writes an object.
pub fn sdo(action: &Action) -> anyhow::Result<ExitCode> {
    match action {
        Action::Read { target, ty } => read(target, *ty),
        Action::Write { target, value, ty, no_read_back } => write(target, value, *ty, !no_read_back),
    }
}

fn read(target: &Target, ty: Option<Type>) -> anyhow::Result<ExitCode> {
    let (object, sheet) = target.resolve()?;
    if let Some(sheet) = &sheet {
        sheet.check_read()?;
    }
    let mut channel = target.peer().open(&target.bus, object)?;
    let ty = ty.or_else(|| sheet.as_ref()?.value_type());
    let data = target.peer().transfer(&mut channel, object, None, ty)?;
    let data = data.map_err(|error| refusal(&channel, target.node, error))?;
    // Device type and vendor decide the meaning of error codes.
    let identification = match object {
        ERROR_CODE | ERROR_HISTORY_NEWEST => identification(&mut channel, target)?,
        _ => Identification::default(),
    };
    show(target, object, &data, ty, sheet.as_ref(), identification)
}

/// Refuses an object that belongs to the driver while a controller is at work, which would not notice the change.
fn check_kept(channel: &mut Channel, target: &Target, object: Object) -> anyhow::Result<()> {
    let controller = match channel {
        Channel::Bus(bus) => bus.interface.controller()?,
        Channel::Drive(drive) => drive.cell.as_ref().and_then(|(file, bus)| {
            let interface = Interface::parse(&file.cell.bus[*bus].interface);
            // The bus may be on another interface, or on none.
            interface.controller().ok().flatten()
        }),
    };
    let Some(holder) = controller else {
        return Ok(());
    };
    let Object { index, subindex } = object;
    let kept = match reserved(0, index, subindex) {
        None => identity(channel, target, VENDOR_ID)?.and_then(|vendor| reserved(vendor, index, subindex)),
        kept => kept,
    };
    match kept {
        Some(kept) => bail!("{kept}; {holder} controls the drive: end that process first"),
        None => Ok(()),
    }
}

/// Device type and vendor-ID of the node; a value that the node does not give is absent.
fn identification(channel: &mut Channel, target: &Target) -> anyhow::Result<Identification> {
    let device_type = match channel {
        Channel::Bus(_) => identity(channel, target, DEVICE_TYPE)?,
        // Only drives have a service port.
        Channel::Drive(_) => None,
    };
    Ok(Identification { vendor: identity(channel, target, VENDOR_ID)?, device_type })
}

/// The value of `object`, device type or vendor-ID; `None` if the node does not give the value.
fn identity(channel: &mut Channel, target: &Target, object: Object) -> anyhow::Result<Option<u32>> {
    let answer = target.peer().transfer(channel, object, None, None)?;
    Ok(answer.ok().and_then(|data| value::unsigned(&data)).map(|raw| raw as u32))
}

fn write(target: &Target, text: &str, ty: Option<Type>, read_back: bool) -> anyhow::Result<ExitCode> {
    let (object, sheet) = target.resolve()?;
    let ty = ty.or_else(|| sheet.as_ref()?.value_type());
    let ty = ty.with_context(|| format!("{object}: say its --type, such as hex"))?;
    let data = ty.encode(text)?;
    if let Some(sheet) = &sheet {
        sheet.check_write(target.node, &data)?;
    }
    // These objects take a signature and show what they can do.
    let is_order = [STORE_ALL, RESTORE_ALL].map(|order| order.index).contains(&object.index);
    let read_back = read_back && !is_order && sheet.as_ref().is_none_or(|sheet| sheet.check_read().is_ok());
    let mut channel = target.peer().open(&target.bus, object)?;
    check_kept(&mut channel, target, object)?;
    let written = target.peer().transfer(&mut channel, object, Some(&data), Some(ty))?;
    written.map_err(|error| {
        let value = Shown::of(&data, Some(ty), false);
        refusal(&channel, target.node, error).context(format!("writing {value}"))
    })?;
    if !read_back {
        return Ok(ExitCode::SUCCESS);
    }
    let (problem, code) = match read_back_of(&mut channel, target, object, &data, ty)? {
        Ok((found, agrees)) => {
            let shown = show(target, object, &found, Some(ty), sheet.as_ref(), Identification::default())?;
            if agrees {
                return Ok(shown);
            }
            let [wrote, found] = [&data, &found].map(|data| Shown::of(data, Some(ty), false));
            (format!("{object} was written as {wrote} and reads back as {found}"), ExitCode::from(1))
        }
        Err(error) if error.cause.abort_code() == AbortCode::WRITE_ONLY => {
            (format!("{object} is written; it cannot be read back"), ExitCode::SUCCESS)
        }
        Err(error) => (format!("{object} is written; reading it back failed: {error}"), ExitCode::from(1)),
    };
    streams::warn(format_args!("mrroc: {problem}"));
    Ok(code)
}

/// Value that is read back after a write, and whether it equals the written value.
fn read_back_of(
    channel: &mut Channel,
    target: &Target,
    object: Object,
    wrote: &[u8],
    ty: Type,
) -> anyhow::Result<Result<(Vec<u8>, bool), SdoError>> {
    let Channel::Bus(bus) = channel else {
        let found = target.peer().transfer(channel, object, None, Some(ty))?;
        return Ok(found.map(|found| (found.clone(), found == wrote)));
    };
    let mut client = target.peer().hold(bus, object, None)?;
    let found = client.poll().ok_or(Interrupted)?;
    Ok(found.map(|found| (found.data.to_vec(), found.agrees_with(wrote))))
}

/// A client that asks for another object than `object`, which every node has. A node answers requests in their order.
/// Behind its answer, no late answer to a request for `object` of an earlier process follows. Such an answer could not be
/// told from an answer to a request of this process.
pub(super) fn question(node: NodeId, object: Object, timeout: Duration, now: Instant) -> Result<Client, StartError> {
    let asked = if object == DEVICE_TYPE { VENDOR_ID } else { DEVICE_TYPE };
    let mut client = Client::with_capacity(node, timeout, 0, CAPACITY);
    client.upload(asked, now)?;
    Ok(client)
}

/// A client that starts to write `data`, or to read if `data` is `None`.
pub(super) fn start(
    node: NodeId,
    object: Object,
    data: Option<&[u8]>,
    by_blocks: bool,
    timeout: Duration,
    now: Instant,
) -> Result<Client, StartError> {
    let mut client = Client::with_capacity(node, timeout, RETRIES, CAPACITY);
    match (data, by_blocks) {
        (Some(data), false) => client.download(object, data, now)?,
        (Some(data), true) => client.block_download(object, data, now)?,
        (None, false) => client.upload(object, now)?,
        (None, true) => client.block_upload(object, now)?,
    }
    Ok(client)
}

/// Text of an abort or a time-out in one line.
pub(super) fn refusal(channel: &Channel, node: NodeId, error: SdoError) -> anyhow::Error {
    let (name, silence) = match channel {
        Channel::Bus(bus) => (bus.name_of(node), bus.silence()),
        Channel::Drive(drive) => (drive.name_of(node), drive.silence()),
    };
    let hint = match error.cause {
        SdoCause::Aborted { code } => words::hint(code),
        SdoCause::TimedOut { .. } => Some(silence.as_str()),
        _ => None,
    };
    let error = match hint {
        Some(hint) => anyhow!("{error}: {hint}"),
        None => anyhow!(error),
    };
    error.context(name)
}

#[derive(Serialize)]
struct Answer {
    node: u8,
    index: u16,
    subindex: u8,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(flatten)]
    shown: Shown,
    #[serde(skip_serializing_if = "Option::is_none")]
    meaning: Option<String>,
}

fn show(
    target: &Target,
    object: Object,
    data: &[u8],
    ty: Option<Type>,
    sheet: Option<&DataSheet>,
    identification: Identification,
) -> anyhow::Result<ExitCode> {
    let ty = ty.or_else(|| sheet?.value_type());
    let meaning = |raw| words::meaning(object, raw, identification.fault_table());
    let answer = Answer {
        node: target.node.raw(),
        index: object.index,
        subindex: object.subindex,
        name: sheet.map_or_else(|| words::object(object), |sheet| Some(sheet.name.clone())),
        shown: Shown::of(data, ty, words::is_signed(object)),
        meaning: value::unsigned(data).and_then(meaning),
    };
    streams::answer(&answer, target.json)
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", Object::new(self.index, self.subindex))?;
        if let Some(name) = &self.name {
            write!(f, " {name}")?;
        }
        write!(f, " = {}", self.shown)?;
        match &self.meaning {
            Some(meaning) => write!(f, " ({meaning})"),
            None => Ok(()),
        }
    }
}

impl Conversation for Client {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.handle(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.handle_timeout(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_answer_to_an_earlier_process_is_passed_before_the_transfer() {
        let node = NodeId::new(1).unwrap();
        let frame = |bytes: &[u8]| Frame::new(can::StandardId::new(0x581).unwrap(), bytes).unwrap();
        let answer = |object: Object, value: u8| {
            let [low, high] = object.index.to_le_bytes();
            frame(&[0x43, low, high, object.subindex, value, 0, 0, 0])
        };
        let (timeout, now) = (Duration::from_secs(1), Instant::ZERO);
        for object in [Object::new(0x6064, 0), DEVICE_TYPE] {
            let mut asking = question(node, object, timeout, now).unwrap();
            let asked = asking.poll_transmit(now).unwrap();
            asking.handle(&answer(object, 111), now);
            assert!(asking.poll_timeout().is_some(), "{object}: the question is not answered");
            let other = Object::new(u16::from_le_bytes([asked.data()[1], asked.data()[2]]), asked.data()[3]);
            asking.handle(&answer(other, 5), now);
            assert!(asking.poll_timeout().is_none(), "{object}: the question is answered");
            let mut client = start(node, object, None, false, timeout, now).unwrap();
            client.poll_transmit(now).unwrap();
            client.handle(&answer(object, 222), now);
            assert_eq!(client.poll().unwrap().unwrap().data, [222, 0, 0, 0], "{object}");
        }
    }

    #[test]
    fn objects_are_hexadecimal_with_0x_or_without() {
        for (text, index, subindex) in [
            ("0x6041:0", 0x6041, 0),
            ("6041:0", 0x6041, 0),
            ("6041", 0x6041, 0),
            ("0x6041", 0x6041, 0),
            ("0X1f80:0A", 0x1F80, 0x0A),
            ("1a00:0x10", 0x1A00, 0x10),
            ("1018:10", 0x1018, 0x10),
            ("0x5:1", 5, 1),
        ] {
            assert_eq!(object(text), Ok(Object::new(index, subindex)), "{text}");
        }
        // An index without 0x that does not have four digits might be meant as a decimal number.
        for text in [
            "24641:0",
            "123:0",
            "0x12345:0",
            "",
            ":",
            ":1",
            "0x",
            "0x:0",
            "6041:",
            "6041:100",
            "6041:1:1",
            "-041:0",
            "+041:0",
            "0x+041:0",
            "60_1:0",
            "604g:0",
            "6041:-1",
            "6041:+1",
        ] {
            let said = object(text).unwrap_err();
            assert!(said.contains("such as 0x6041:0"), "{text}: {said}");
        }
    }
}
