//! A CAN port on an slcan adapter.

use std::task::Poll;
use std::time::Duration;

use can::slcan::{BITRATES, BusErrors, Command, LONGEST, Piece, Report, Splitter};
use can::timing::Bitrate;
use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};
use thiserror::Error;

use crate::{Line, LineError};

/// Frames that one call of [`SlcanPort`]'s `send` takes at most.
const BATCH: usize = 256;

/// Bytes that one read takes at most: what a tty holds.
const READ: usize = 4096;

/// How long the adapter is given to fall silent once it is told to close: what it sent before is not ours.
const SETTLING: Duration = Duration::from_millis(50);

/// How long it may take to answer one command.
const ANSWER: Duration = Duration::from_millis(200);

/// The host's end of a CAN adapter on a serial line that speaks slcan (Lawicel's text, see [`can::slcan`]).
///
/// ```text
///             50 ms          done, silence        2 answers, silence       done             version
///   Settling ───────► SettingUp ───────► AcceptingAll ───────► Opening ────► Open ◄─────────── Probing
///    sends \rC\r        sends Sn         sends M…, m…            sends O                        sends V
///                                                                └──────────── silence ──────────┘
/// ```
///
/// [`SlcanPort::new`] begins it, [`SlcanPort::poll_open`] ends it: within 0.9 s the port is open or refused. Until
/// then it takes no frame and has none. A bell is a refusal, except after `M` and `m`. An adapter that does not
/// answer `Sn` and `O` counts as open if it answers with its version.
///
/// `M00000000` and `mFFFFFFFF` take away the acceptance filter that another tool may have left (Lawicel: a set bit of
/// the mask is not looked at). The commands precede the opening of the channel. Firmware in which the mask has the
/// opposite sense (CANtact) accepts everything again when it opens. CANable firmware takes the commands for normal
/// mode. `X1`, which would have the adapter report unasked, is never said: WeAct's firmware takes `X` for the order
/// to be replaced. An adapter that waits to be polled, as a CAN232 may, has to be told `X1` by hand.
///
/// Frames are sent as far as the line takes their bytes. A frame of which the line took a part counts as taken; the
/// rest of its bytes go first in the next call of either direction. A frame that is offered again and again counts as
/// refused once. The port does not see the queue of the adapter. A frame that the adapter refuses with a bell, or
/// reports as lost, is counted as refused although `send` took it. A line that cannot be read may have been a frame,
/// and is counted as dropped. Frames are stamped with the time they are read at: a serial line adds its own latency,
/// and an adapter's stamps only count the milliseconds of a minute.
///
/// The state is that of the last state line. An adapter without state lines stays active. Dropping it closes the
/// channel.
pub struct SlcanPort<L: Line> {
    line: L,
    bitrate: Bitrate,
    /// How the channel is opened.
    how: Command,
    stage: Stage,
    splitter: Splitter,
    /// What was read and is not looked at yet: `input[read_from..read_to]`.
    input: Box<[u8; READ]>,
    read_from: usize,
    read_to: usize,
    /// What goes to the line next: the rest of a frame, then new ones.
    output: Vec<u8>,
    /// The frame that the line did not take last.
    untaken: Option<Frame>,
    counters: Counters,
    state: ControllerState,
    last: Instant,
}

/// Where opening is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Settling { until: Instant },
    SettingUp { until: Instant },
    AcceptingAll { until: Instant, answers: u8 },
    Opening { until: Instant },
    Probing { until: Instant },
    Open,
    Refused(SlcanError),
}

/// Why an adapter was not opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SlcanError {
    /// slcan has nine bit rates.
    #[error("slcan has no {kbps} kbit/s: 10, 20, 50, 100, 125, 250, 500, 800 or 1000")]
    NoSuchBitrate {
        /// What was asked for.
        kbps: u32,
    },
    /// The adapter refused the bit rate.
    #[error("the adapter refuses {kbps} kbit/s")]
    BitrateRefused {
        /// What was asked for.
        kbps: u32,
    },
    /// The adapter refused to open the channel.
    #[error("the adapter refuses to open its channel: unplug it and plug it in again")]
    OpenRefused,
    /// Nothing answered.
    #[error(
        "no answer: there is no slcan adapter on this tty, it needs another firmware, or it speaks at another baud rate"
    )]
    Silent,
    /// The line failed.
    #[error(transparent)]
    Line(#[from] LineError),
}

impl<L: Line> SlcanPort<L> {
    /// Begins to open the adapter on `line` at a bit rate of CAN.
    pub fn new(line: L, bitrate: Bitrate, now: Instant) -> Result<Self, SlcanError> {
        Self::opened_by(Command::Open, line, bitrate, now)
    }

    /// The same, but the adapter only listens (`L` in place of `O`): not even error frames go out, whatever the bit rate.
    pub fn listening(line: L, bitrate: Bitrate, now: Instant) -> Result<Self, SlcanError> {
        Self::opened_by(Command::ListenOnly, line, bitrate, now)
    }

    fn opened_by(
        how: Command,
        line: L,
        bitrate: Bitrate,
        now: Instant,
    ) -> Result<Self, SlcanError> {
        if !BITRATES.contains(&bitrate) {
            let kbps = bitrate.kbps();
            return Err(SlcanError::NoSuchBitrate { kbps });
        }
        let mut port = Self {
            line,
            bitrate,
            how,
            stage: Stage::Settling {
                until: now + SETTLING,
            },
            splitter: Splitter::default(),
            input: Box::new([0; READ]),
            read_from: 0,
            read_to: 0,
            output: Vec::with_capacity((BATCH + 1) * LONGEST),
            untaken: None,
            counters: Counters::default(),
            state: ControllerState::Active,
            last: now,
        };
        // The empty line ends an incomplete line of an earlier host.
        port.say(Command::Empty);
        port.say(Command::Close);
        port.flush(now)?;
        Ok(port)
    }

    /// Goes on opening; call it whenever the line can be read, and at the latest at [`SlcanPort::poll_timeout`].
    pub fn poll_open(&mut self, now: Instant) -> Poll<Result<(), SlcanError>> {
        if let Err(error) = self.go_on(now) {
            self.stage = Stage::Refused(error);
        }
        match self.stage {
            Stage::Open => Poll::Ready(Ok(())),
            Stage::Refused(error) => Poll::Ready(Err(error)),
            Stage::Settling { .. }
            | Stage::SettingUp { .. }
            | Stage::AcceptingAll { .. }
            | Stage::Opening { .. }
            | Stage::Probing { .. } => Poll::Pending,
        }
    }

    /// When opening goes on without an answer; `None` once it is over.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.stage {
            Stage::Settling { until }
            | Stage::SettingUp { until }
            | Stage::AcceptingAll { until, .. }
            | Stage::Opening { until }
            | Stage::Probing { until } => Some(until),
            Stage::Open | Stage::Refused(_) => None,
        }
    }

    /// The line, for loops that wait for it.
    pub fn line(&self) -> &L {
        &self.line
    }

    fn go_on(&mut self, now: Instant) -> Result<(), SlcanError> {
        if self.poll_timeout().is_none() {
            return Ok(());
        }
        self.flush(now)?;
        self.read_more(now)?;
        while let Some(byte) = self.next_byte() {
            let Some(piece) = self.splitter.push(byte) else {
                continue;
            };
            // Firmware tells its version as it likes, but a line that echoes is no adapter.
            let echo = matches!(piece, Piece::Line(b"V"));
            let report = Report::parse(piece).ok();
            if !echo {
                self.answered(report, now)?;
            }
        }
        if self.poll_timeout().is_some_and(|until| now >= until) {
            self.silence(now)?;
        }
        Ok(())
    }

    /// The adapter said something while it is being opened.
    fn answered(&mut self, report: Option<Report>, now: Instant) -> Result<(), SlcanError> {
        let kbps = self.bitrate.kbps();
        match (self.stage, report) {
            (Stage::SettingUp { .. }, Some(Report::Refused)) => {
                return Err(SlcanError::BitrateRefused { kbps });
            }
            (Stage::Opening { .. }, Some(Report::Refused)) => return Err(SlcanError::OpenRefused),
            (Stage::SettingUp { .. }, Some(Report::Done)) => self.accept_all(now)?,
            // Both are answered, be it by a bell.
            (Stage::AcceptingAll { until, answers }, Some(Report::Done | Report::Refused)) => {
                let answers = answers + 1;
                self.stage = Stage::AcceptingAll { until, answers };
                if answers == 2 {
                    self.open_channel(now)?;
                }
            }
            // Any frame or state line shows an open channel, and so does a version line.
            (
                Stage::Opening { .. },
                Some(Report::Done | Report::Received { .. } | Report::State { .. }),
            )
            | (Stage::Probing { .. }, _) => self.stage = Stage::Open,
            // Answers to what was said before, and frames from before.
            (
                Stage::Settling { .. }
                | Stage::SettingUp { .. }
                | Stage::AcceptingAll { .. }
                | Stage::Opening { .. },
                _,
            ) => {}
            (Stage::Open | Stage::Refused(_), _) => {}
        }
        Ok(())
    }

    /// The adapter said nothing in its time.
    fn silence(&mut self, now: Instant) -> Result<(), SlcanError> {
        match self.stage {
            Stage::Settling { .. } => {
                self.say(Command::Bitrate(self.bitrate));
                self.stage = Stage::SettingUp {
                    until: now + ANSWER,
                };
            }
            Stage::SettingUp { .. } => return self.accept_all(now),
            Stage::AcceptingAll { .. } => return self.open_channel(now),
            Stage::Opening { .. } => {
                self.say(Command::Version);
                self.stage = Stage::Probing {
                    until: now + ANSWER,
                };
            }
            Stage::Probing { .. } => return Err(SlcanError::Silent),
            Stage::Open | Stage::Refused(_) => {}
        }
        Ok(self.flush(now)?)
    }

    fn accept_all(&mut self, now: Instant) -> Result<(), SlcanError> {
        self.say(Command::AcceptanceCode(0));
        self.say(Command::AcceptanceMask(u32::MAX));
        self.stage = Stage::AcceptingAll {
            until: now + ANSWER,
            answers: 0,
        };
        Ok(self.flush(now)?)
    }

    fn open_channel(&mut self, now: Instant) -> Result<(), SlcanError> {
        self.say(self.how);
        self.stage = Stage::Opening {
            until: now + ANSWER,
        };
        Ok(self.flush(now)?)
    }

    fn say(&mut self, command: Command) {
        let line = command.encode().expect("all commands said here have lines");
        self.output.extend_from_slice(&line);
    }

    /// Hands the line what it takes.
    fn flush(&mut self, now: Instant) -> Result<(), LineError> {
        self.last = now;
        if !self.output.is_empty() {
            let taken = self.line.write(now, &self.output)?;
            self.output.drain(..taken);
        }
        Ok(())
    }

    /// Reads once; all that was read before has been looked at.
    fn read_more(&mut self, now: Instant) -> Result<(), LineError> {
        self.last = now;
        debug_assert_eq!(self.read_from, self.read_to, "bytes would be lost");
        self.read_from = 0;
        self.read_to = 0;
        self.read_to = self.line.read(now, &mut self.input[..])?;
        Ok(())
    }

    fn next_byte(&mut self) -> Option<u8> {
        let byte = *self.input[..self.read_to].get(self.read_from)?;
        self.read_from += 1;
        Some(byte)
    }

    /// Returns the next frame of the bytes read. Other lines are counted.
    fn next_frame(&mut self) -> Option<Frame> {
        while let Some(byte) = self.next_byte() {
            let spoilt = self.splitter.dropped().lines;
            let report = self.splitter.push(byte).map(Report::parse);
            self.counters.dropped += self.splitter.dropped().lines - spoilt;
            match report {
                Some(Ok(Report::Received { frame, .. })) => return Some(frame),
                Some(Ok(Report::State { state, .. })) => self.state = state,
                Some(Ok(Report::Errors(errors))) => self.count(errors),
                Some(Ok(Report::Refused)) => self.counters.refused += 1,
                Some(Err(_)) => self.counters.dropped += 1,
                Some(Ok(
                    Report::Done
                    | Report::Transmitted(_)
                    | Report::Version { .. }
                    | Report::Firmware { .. }
                    | Report::SerialNumber(_)
                    | Report::Flags(_)
                    | Report::PollEnd,
                ))
                | None => {}
            }
        }
        None
    }

    fn count(&mut self, errors: BusErrors) {
        self.counters.errors += 1;
        self.counters.dropped += u64::from(errors.contains(BusErrors::RECEIVE_OVERRUN));
        self.counters.refused += u64::from(errors.contains(BusErrors::TRANSMIT_OVERRUN));
    }
}

impl<L: Line> Port for SlcanPort<L> {
    /// Takes at most 256 frames, behind the rest of a frame that was taken before. Stops before a frame that slcan
    /// cannot carry: an error frame.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let rest = self.output.len();
        let mut ends = 0;
        if self.stage == Stage::Open {
            let lines = frames.iter().take(BATCH);
            for line in lines.map_while(|frame| Command::Transmit(*frame).encode()) {
                self.output.extend_from_slice(&line);
                ends += 1;
            }
        }
        let result = if self.output.is_empty() {
            Ok(0)
        } else {
            self.line.write(now, &self.output)
        };
        self.last = now;
        let written = result.unwrap_or(0);
        // A frame of which a byte went out is taken, and its rest is kept; the ones behind it are the caller's again.
        let mut kept = rest;
        let mut taken = 0;
        while taken < ends && kept < written {
            let length = self.output[kept..]
                .iter()
                .position(|byte| *byte == b'\r')
                .expect("every line has its end");
            kept += length + 1;
            taken += 1;
        }
        self.output.truncate(kept);
        self.output.drain(..written);
        self.counters.count_sent(&frames[..taken]);
        // One that was offered before is counted already.
        let again = taken == 0 && !frames.is_empty() && self.untaken == frames.first().copied();
        self.counters.refused += (frames.len() - taken - usize::from(again)) as u64;
        self.untaken = frames.get(taken).copied();
        result.map(|_| taken).map_err(of_line)
    }

    /// Reads once, and writes first if a frame is half on the line.
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        if self.stage != Stage::Open {
            return Ok(0);
        }
        self.flush(now).map_err(of_line)?;
        let mut count = 0;
        for fresh in [false, true] {
            if fresh && count < into.len() {
                match self.read_more(now) {
                    // What came before the line went is handed over first.
                    Err(_) if count > 0 => {}
                    read => read.map_err(of_line)?,
                }
            }
            while count < into.len()
                && let Some(frame) = self.next_frame()
            {
                into[count] = Received { frame, at: now };
                count += 1;
            }
        }
        self.counters.count_received(&into[..count]);
        Ok(count)
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn state(&self) -> ControllerState {
        self.state
    }
}

/// Closes the channel, as far as the line takes it.
impl<L: Line> Drop for SlcanPort<L> {
    fn drop(&mut self) {
        // The empty line ends a frame of which the line took a part.
        self.output.clear();
        self.say(Command::Empty);
        self.say(Command::Close);
        // An error here has no receiver.
        let _ = self.line.write(self.last, &self.output);
    }
}

fn of_line(error: LineError) -> PortError {
    match error {
        LineError::Gone => PortError::Gone,
        LineError::Os(errno) => PortError::Os(errno),
    }
}

#[cfg(test)]
mod tests;
