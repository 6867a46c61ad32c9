//! `mrroc monitor --from`: the frames of a candump log as text.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use can::Instant;
use can::candump::{Entry, Head, Line, LineError, OtherFrame};

use super::{Decoder, Described, Kind, MonitorLine, Options, is_broken_pipe, of_cell};
use crate::name_in;
use mrroc::bench::interfaces::Interface;
use mrroc::cell::CellFile;
use mrroc::report::{counted, counted_as};

/// Longest line that is read, bytes: a CAN XL frame with 2048 bytes of data, and its head.
const LONGEST: usize = 8192;

/// Shows the frames of `path` or of standard input, and then the number of lines that are no frame.
pub(super) fn show(path: &Path, options: &Options) -> anyhow::Result<ExitCode> {
    let named = || if path == Path::new("-") { "standard input".to_owned() } else { path.display().to_string() };
    let cell = options.bus.cell.as_ref().map(CellFile::read).transpose()?;
    let chosen = match (&cell, &options.bus.bus) {
        (Some(cell), Some(_)) => Some(options.bus.index_in(cell)?),
        (Some(cell), None) if cell.cell.bus.len() == 1 => Some(0),
        _ => None,
    };
    let mut log = Log { cell, chosen, ..Log::default() };
    let mut out = BufWriter::new(std::io::stdout());
    let read = if path == Path::new("-") {
        log.read(std::io::stdin().lock(), &mut out, options)
    } else {
        let file = File::open(path).with_context(named)?;
        log.read(BufReader::new(file), &mut out, options)
    };
    match read.and_then(|()| Ok(out.flush()?)) {
        Err(error) if is_broken_pipe(&error) => return Ok(ExitCode::SUCCESS),
        read => read.with_context(named)?,
    }
    if log.frames == 0 {
        let why = log.skipped.iter().next().map(|(_, skipped)| format!(": line {}: {}", skipped.line, skipped.error));
        bail!("{}: no line is a frame as `candump -l` or `candump -L` writes it{}", named(), why.unwrap_or_default());
    }
    for line in log.counts() {
        mrroc::streams::warn(format_args!("mrroc: {}: {line}", named()));
    }
    Ok(ExitCode::SUCCESS)
}

/// State of a log up to the present line.
#[derive(Default)]
struct Log {
    cell: Option<CellFile>,
    /// Index of the bus for frames of interfaces that the cell does not have.
    chosen: Option<usize>,
    /// One bus for each interface of the log.
    buses: BTreeMap<String, LogBus>,
    /// Time of the first frame.
    began: Option<Instant>,
    /// Number of the last line.
    line: u64,
    frames: u64,
    newer: u64,
    errors: u64,
    /// Frames that candump did not see.
    dropped: u64,
    /// Lines that are no frame, by the text of their error.
    skipped: BTreeMap<String, Skipped>,
}

/// An interface of a log.
struct LogBus {
    decoder: Decoder,
    /// Index of the bus in the cell.
    cell: Option<usize>,
    /// Whether frames were lost since the last frame of the log.
    lost: bool,
}

/// Lines of one kind that are no frame.
struct Skipped {
    error: LineError,
    count: u64,
    /// Number of the first line.
    line: u64,
}

impl Log {
    fn read(&mut self, mut from: impl BufRead, out: &mut impl Write, options: &Options) -> anyhow::Result<()> {
        let mut left = options.count.unwrap_or(u64::MAX);
        let mut line = Vec::new();
        while left > 0 && read_line(&mut from, &mut line)? {
            self.line += 1;
            if line.trim_ascii().is_empty() {
                continue;
            }
            let shown = match Line::parse(&line) {
                Ok(line) => self.describe(line),
                Err(error) => {
                    let (count, line) = (0, self.line);
                    self.skipped.entry(error.to_string()).or_insert(Skipped { error, count, line }).count += 1;
                    continue;
                }
            };
            let Some((shown, name)) = shown.filter(|(shown, _)| options.wants(shown.described.kind)) else {
                continue;
            };
            left -= 1;
            shown.write(out, name, options.json)?;
        }
        Ok(())
    }

    /// The line to print, and the name of its node.
    fn describe(&mut self, line: Line<'_>) -> Option<(MonitorLine, Option<String>)> {
        match line {
            Line::Frame(Entry { at, interface, frame, .. }) => {
                self.frames += 1;
                self.errors += u64::from(frame.is_error());
                let (cell, described) = {
                    let bus = self.bus(interface.as_str(), at);
                    if std::mem::take(&mut bus.lost) {
                        bus.decoder.begin(at);
                    }
                    (bus.cell, bus.decoder.describe(&frame, at))
                };
                let name = described.node.map(|node| format!("{}: ", name_in(self.of_cell(cell), node)));
                Some((self.line(at, interface.as_str(), frame.to_string(), described), name))
            }
            Line::Other(Head { at, interface, .. }, kind, text) => {
                self.frames += 1;
                self.newer += 1;
                let kind = match kind {
                    OtherFrame::Fd => "CAN FD frame",
                    OtherFrame::Xl => "CAN XL frame",
                };
                let described = Described { kind: Kind::Other, node: None, text: format!("{kind}, not decoded") };
                Some((self.line(at, interface.as_str(), text.to_owned(), described), None))
            }
            Line::Dropped(count) => {
                self.dropped += count;
                // The bus of the frames is known by the name of the interface on candump's command line only.
                for bus in self.buses.values_mut() {
                    bus.lost = true;
                }
                None
            }
        }
    }

    fn line(&mut self, at: Instant, interface: &str, frame: String, described: Described) -> MonitorLine {
        let began = *self.began.get_or_insert(at);
        // A log can have times before the time of its first line, for example if it joins logs of several buses, or if
        // the clock was set.
        let at_s = at.since(began).as_secs_f64() - began.since(at).as_secs_f64();
        MonitorLine { at_s, interface: Some(interface.to_owned()), frame, described }
    }

    fn bus(&mut self, interface: &str, at: Instant) -> &mut LogBus {
        let (cell, chosen) = (&self.cell, self.chosen);
        self.buses.entry(interface.to_owned()).or_insert_with(|| {
            let index = cell.as_ref().and_then(|cell| bus_of(cell, interface).or(chosen));
            let of_cell = cell.as_ref().zip(index).map(|(cell, index)| of_cell(cell, index));
            let mut decoder = of_cell.unwrap_or_default();
            decoder.begin(at);
            LogBus { decoder, cell: index, lost: false }
        })
    }

    fn of_cell(&self, bus: Option<usize>) -> Option<(&CellFile, usize)> {
        self.cell.as_ref().zip(bus)
    }

    /// Lines with the numbers of frames and of skipped lines.
    fn counts(&self) -> Vec<String> {
        let Self { frames, newer, errors, dropped, .. } = self;
        let mut counts = vec![format!("{} in {}", counted(*frames, "frame"), counted(self.line, "line"))];
        let newer_told =
            counted_as(*newer, "CAN FD or CAN XL frame is", "CAN FD or CAN XL frames are") + " not decoded";
        let lost = counted_as(*dropped, "frame was", "frames were") + " lost while the log was written (DROPCOUNT)";
        let table = [(newer, newer_told), (errors, counted(*errors, "error frame")), (dropped, lost)];
        counts.extend(table.into_iter().filter(|(count, _)| **count > 0).map(|(_, text)| text));
        counts.extend(self.skipped.values().map(|Skipped { error, count, line }| {
            format!("{} skipped, the first is line {line}: {error}", counted(*count, "line"))
        }));
        counts
    }
}

/// Index of the bus of `cell` whose frames a log names `interface`.
fn bus_of(cell: &CellFile, interface: &str) -> Option<usize> {
    let names = |(index, bus): (usize, &mrroc::cell::Bus)| {
        bus.name == interface || Interface::parse(&bus.interface).log_name(index) == interface
    };
    cell.cell.bus.iter().enumerate().position(names)
}

/// Reads a line without its end. Returns `false` at the end of the file. A line that is too long is cut.
fn read_line(from: &mut impl BufRead, line: &mut Vec<u8>) -> std::io::Result<bool> {
    line.clear();
    let limit = u64::try_from(LONGEST).unwrap_or(u64::MAX);
    let read = from.by_ref().take(limit).read_until(b'\n', line)?;
    if read == LONGEST && !line.ends_with(b"\n") {
        from.skip_until(b'\n')?;
    }
    Ok(read > 0)
}

#[cfg(test)]
mod tests;
