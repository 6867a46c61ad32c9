//! A CAN port on an slcan adapter.

use std::task::Poll;
use std::time::Duration;

use can::slcan::{AdapterReport, BITRATES_KBPS, BusErrors, Command, LONGEST, Piece, Splitter};
use can::timing::Bitrate;
use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};
use thiserror::Error;

use crate::{Line, LineError};

/// Maximum number of frames that one call of `send` accepts.
const BATCH: usize = 256;

/// Maximum number of bytes per read: the size of a tty's buffer.
const READ: usize = 4096;

/// Time for which the port ignores input after the command to close. Earlier frames of the adapter may still arrive.
const SETTLING: Duration = Duration::from_millis(50);

/// Time that the adapter has to answer one command.
const ANSWER: Duration = Duration::from_millis(200);

/// Host's end of a CAN adapter on a serial line with the slcan protocol (Lawicel's text protocol, see [`can::slcan`]).
///
/// ```text
///             50 ms          done, silence        2 answers, silence       done             version
///   Settling ───────► SettingUp ───────► AcceptingAll ───────► Opening ────► Open ◄─────────── Probing
///    sends \rC\r        sends Sn         sends M…, m…            sends O                        sends V
///                                                                └──────────── silence ──────────┘
/// ```
///
/// [`SlcanPort::new`] starts the opening and [`SlcanPort::poll_open`] completes it. Within 0.9 s the port is open or
/// refused. Until then the port neither accepts nor delivers frames. A bell is a refusal, except after `M` and `m`. An
/// adapter that does not answer `Sn` and `O` counts as open if it answers with its version.
///
/// `M00000000` and `mFFFFFFFF` remove the acceptance filter that another tool may have left. In Lawicel's protocol, a
/// set bit of the mask means that the bit of the identifier is ignored. The commands precede the opening of the
/// channel. Firmware with the opposite meaning of the mask (CANtact) accepts all frames again when it opens. CANable
/// firmware takes the commands for normal mode. `X1`, which enables unsolicited reports, is never sent: WeAct's
/// firmware takes `X` for the command to replace the firmware. An adapter in polled mode, such as a CAN232, must be set
/// to `X1` by hand.
///
/// Frames are sent as far as the line accepts their bytes. A frame counts as sent once the line has accepted a part of
/// it. The rest of its bytes are sent first in the next call of either direction. A frame that is offered repeatedly
/// counts as refused once. The port does not see the queue of the adapter. A frame that the adapter refuses with a
/// bell, or reports as lost, is counted as refused although `send` accepted it. An unreadable line may have been a
/// frame, and is counted as dropped. The time stamp of a frame is the time of reading, which includes the latency of
/// the serial line. The time stamps of adapters only count the milliseconds of a minute.
///
/// The state of the controller is that of the last state line. An adapter without state lines stays active. Dropping
/// the port closes the channel.
pub struct SlcanPort<L: Line> {
    line: L,
    bitrate: Bitrate,
    /// Command that opens the channel.
    how: Command,
    stage: Stage,
    /// Time at which the present stage of the opening ends without an answer.
    until: Instant,
    splitter: Splitter,
    /// Bytes read but not yet processed: `input[read_from..read_to]`.
    input: Box<[u8; READ]>,
    read_from: usize,
    read_to: usize,
    /// Bytes to send: the rest of a frame, then new frames.
    output: Vec<u8>,
    /// The frame that the line did not accept last.
    untaken: Option<Frame>,
    counters: Counters,
    state: ControllerState,
    last: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Settling,
    SettingUp,
    AcceptingAll { answers: u8 },
    Opening,
    Probing,
    Open,
    Refused(SlcanError),
}

/// Reason why an adapter was not opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum SlcanError {
    #[error("slcan has no {kbps} kbit/s: 10, 20, 50, 100, 125, 250, 500, 800 or 1000")]
    NoSuchBitrate { kbps: u32 },
    #[error("the adapter refuses {kbps} kbit/s")]
    BitrateRefused { kbps: u32 },
    #[error("the adapter refuses to open its channel: unplug it and plug it in again")]
    OpenRefused,
    #[error(
        "no answer: there is no slcan adapter on this tty, it needs another firmware, or it speaks at another baud rate"
    )]
    Silent,
    #[error(transparent)]
    Line(#[from] LineError),
}

impl<L: Line> SlcanPort<L> {
    /// Starts to open the adapter on `line` at a CAN bit rate.
    pub fn new(line: L, bitrate: Bitrate, now: Instant) -> Result<Self, SlcanError> {
        Self::opened_by(Command::Open, line, bitrate, now)
    }

    /// As [`SlcanPort::new`], in listen-only mode (`L` in place of `O`). The adapter sends no error frames either,
    /// whatever its bit rate.
    pub fn listening(line: L, bitrate: Bitrate, now: Instant) -> Result<Self, SlcanError> {
        Self::opened_by(Command::ListenOnly, line, bitrate, now)
    }

    fn opened_by(how: Command, line: L, bitrate: Bitrate, now: Instant) -> Result<Self, SlcanError> {
        let kbps = bitrate.kbps();
        if !BITRATES_KBPS.contains(&kbps) {
            return Err(SlcanError::NoSuchBitrate { kbps });
        }
        let mut port = Self {
            line,
            bitrate,
            how,
            stage: Stage::Settling,
            until: now + SETTLING,
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

    /// Continues the opening. Call it whenever the line is readable, and at the latest at [`SlcanPort::poll_timeout`].
    pub fn poll_open(&mut self, now: Instant) -> Poll<Result<(), SlcanError>> {
        if let Err(error) = self.go_on(now) {
            self.stage = Stage::Refused(error);
        }
        match self.stage {
            Stage::Open => Poll::Ready(Ok(())),
            Stage::Refused(error) => Poll::Ready(Err(error)),
            Stage::Settling | Stage::SettingUp | Stage::AcceptingAll { .. } | Stage::Opening | Stage::Probing => {
                Poll::Pending
            }
        }
    }

    /// Time at which the opening continues without an answer; `None` after the opening.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let ended = matches!(self.stage, Stage::Open | Stage::Refused(_));
        (!ended).then_some(self.until)
    }

    /// The line, for loops that wait until it is readable.
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
            // The format of the version line depends on the firmware. A line that echoes the command is not an adapter.
            let echo = matches!(piece, Piece::Line(b"V"));
            let report = AdapterReport::parse(piece).ok();
            if !echo {
                self.answered(report, now)?;
            }
        }
        if self.poll_timeout().is_some_and(|until| now >= until) {
            self.silence(now)?;
        }
        Ok(())
    }

    /// Processes a report of the adapter during the opening.
    fn answered(&mut self, report: Option<AdapterReport>, now: Instant) -> Result<(), SlcanError> {
        let kbps = self.bitrate.kbps();
        match (self.stage, report) {
            (Stage::SettingUp, Some(AdapterReport::Refused)) => {
                return Err(SlcanError::BitrateRefused { kbps });
            }
            (Stage::Opening, Some(AdapterReport::Refused)) => return Err(SlcanError::OpenRefused),
            (Stage::SettingUp, Some(AdapterReport::Done)) => self.accept_all(now)?,
            // Both commands are answered, possibly by a bell.
            (Stage::AcceptingAll { answers }, Some(AdapterReport::Done | AdapterReport::Refused)) => {
                let answers = answers + 1;
                self.stage = Stage::AcceptingAll { answers };
                if answers == 2 {
                    self.open_channel(now)?;
                }
            }
            // A frame, a state line or a version line shows an open channel.
            (
                Stage::Opening,
                Some(AdapterReport::Done | AdapterReport::Received { .. } | AdapterReport::State { .. }),
            )
            | (Stage::Probing, _) => self.stage = Stage::Open,
            // Answers to earlier commands, and frames from before the opening.
            (
                Stage::Settling
                | Stage::SettingUp
                | Stage::AcceptingAll { .. }
                | Stage::Opening
                | Stage::Open
                | Stage::Refused(_),
                _,
            ) => {}
        }
        Ok(())
    }

    /// Handles the time-out of a command during the opening.
    fn silence(&mut self, now: Instant) -> Result<(), SlcanError> {
        match self.stage {
            Stage::Settling => {
                self.say(Command::Bitrate(self.bitrate));
                Ok(self.enter(Stage::SettingUp, now)?)
            }
            Stage::SettingUp => Ok(self.accept_all(now)?),
            Stage::AcceptingAll { .. } => Ok(self.open_channel(now)?),
            Stage::Opening => {
                self.say(Command::Version);
                Ok(self.enter(Stage::Probing, now)?)
            }
            Stage::Probing => Err(SlcanError::Silent),
            Stage::Open | Stage::Refused(_) => Ok(()),
        }
    }

    fn accept_all(&mut self, now: Instant) -> Result<(), LineError> {
        self.say(Command::AcceptanceCode(0));
        self.say(Command::AcceptanceMask(u32::MAX));
        self.enter(Stage::AcceptingAll { answers: 0 }, now)
    }

    fn open_channel(&mut self, now: Instant) -> Result<(), LineError> {
        self.say(self.how);
        self.enter(Stage::Opening, now)
    }

    /// Sends what was said, and waits for the answer.
    fn enter(&mut self, stage: Stage, now: Instant) -> Result<(), LineError> {
        self.stage = stage;
        self.until = now + ANSWER;
        self.flush(now)
    }

    fn say(&mut self, command: Command) {
        let line = command.encode().expect("all commands said here have lines");
        self.output.extend_from_slice(&line);
    }

    fn flush(&mut self, now: Instant) -> Result<(), LineError> {
        self.last = now;
        if !self.output.is_empty() {
            let taken = self.line.write(now, &self.output)?;
            self.output.drain(..taken);
        }
        Ok(())
    }

    /// Reads once. All bytes read before have been processed.
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
            let spoilt = self.splitter.dropped();
            let report = self.splitter.push(byte).map(AdapterReport::parse);
            self.counters.dropped += self.splitter.dropped() - spoilt;
            match report {
                Some(Ok(AdapterReport::Received { frame, .. })) => return Some(frame),
                Some(Ok(AdapterReport::State { state, .. })) => {
                    self.counters.count_state(self.state, state);
                    self.state = state;
                }
                Some(Ok(AdapterReport::Errors(errors))) => self.count(errors),
                Some(Ok(AdapterReport::Refused)) => self.counters.refused += 1,
                Some(Err(_)) => self.counters.dropped += 1,
                Some(Ok(
                    AdapterReport::Done
                    | AdapterReport::Transmitted(_)
                    | AdapterReport::Version { .. }
                    | AdapterReport::Firmware { .. }
                    | AdapterReport::SerialNumber(_)
                    | AdapterReport::Flags(_)
                    | AdapterReport::PollEnd,
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
    /// Sends at most 256 frames, after the rest of an incomplete frame. Stops before a frame that slcan cannot carry,
    /// such as an error frame.
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
        let result = if self.output.is_empty() { Ok(0) } else { self.line.write(now, &self.output) };
        self.last = now;
        let written = result.unwrap_or(0);
        // A frame of which a byte was sent counts as sent, and its remaining bytes are kept. The frames after it are
        // left to the caller.
        let mut kept = rest;
        let mut taken = 0;
        while taken < ends && kept < written {
            let length = self.output[kept..].iter().position(|byte| *byte == b'\r').expect("every line has its end");
            kept += length + 1;
            taken += 1;
        }
        self.output.truncate(kept);
        self.output.drain(..written);
        self.counters.count_sent(&frames[..taken]);
        // A frame that was offered before is already counted.
        let again = taken == 0 && !frames.is_empty() && self.untaken == frames.first().copied();
        self.counters.refused += (frames.len() - taken - usize::from(again)) as u64;
        self.untaken = frames.get(taken).copied();
        Ok(result.map(|_| taken)?)
    }

    /// Reads once. Writes first if a frame is partly on the line.
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        if self.stage != Stage::Open {
            return Ok(0);
        }
        self.flush(now)?;
        let mut count = 0;
        for fresh in [false, true] {
            if fresh && count < into.len() {
                match self.read_more(now) {
                    // Frames received before the line was lost are delivered first.
                    Err(_) if count > 0 => {}
                    read => read?,
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

/// Closes the channel, if the line accepts the command.
impl<L: Line> Drop for SlcanPort<L> {
    fn drop(&mut self) {
        // The empty line ends a frame of which the line accepted a part.
        self.output.clear();
        self.say(Command::Empty);
        self.say(Command::Close);
        // An error cannot be reported here.
        let _ = self.line.write(self.last, &self.output);
    }
}

impl From<LineError> for PortError {
    fn from(error: LineError) -> Self {
        match error {
            LineError::Gone => Self::Gone,
            LineError::Os(errno) => Self::Os(errno),
        }
    }
}

#[cfg(test)]
mod tests;
