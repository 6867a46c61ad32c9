//! slcan: a port on an adapter that says anything, and an adapter that is told anything.

use std::collections::VecDeque;
use std::task::Poll;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use can::slcan::{AdapterReport, Command, Piece, Splitter};
use can::timing::Bitrate;
use can::{Instant, Port};
use hil::{Device, SlcanDevice};
use serial::{Line, LineCounters, LineError, SlcanPort};

use crate::frames::{AnyFrame, empty};

/// A line with these bytes to read. The line takes a part of what is written.
struct Bytes {
    inbox: VecDeque<u8>,
    room: usize,
}

impl Line for Bytes {
    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        Ok(bytes.len().min(self.room))
    }
    fn read(&mut self, _now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        // At most 64 bytes at once, as a USB adapter gives.
        let count = into.len().min(self.inbox.len()).min(64);
        into.iter_mut().zip(self.inbox.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }
    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}

/// Text of an adapter, and text for an adapter.
pub fn slcan(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let Ok((room, frames)) = <(u8, [AnyFrame; 2])>::arbitrary(&mut input) else {
        return;
    };
    let text = input.take_rest();
    port(text, usize::from(room), frames);
    adapter(text);
    lines(text);
}

fn port(text: &[u8], room: usize, frames: [AnyFrame; 2]) {
    let mut now = Instant::ZERO;
    let line = Bytes { inbox: text.iter().copied().collect(), room };
    let mut port = SlcanPort::new(line, Bitrate::KBPS_1000, now).unwrap();
    let mut opened = None;
    for _ in 0..text.len() + 16 {
        if let Poll::Ready(result) = port.poll_open(now) {
            opened = Some(result);
            break;
        }
        now = port.poll_timeout().expect("an opening has a deadline").max(now);
    }
    match opened.expect("the opening ends") {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(()) => {
            let mut into = [empty(); 16];
            for _ in 0..text.len() / 16 + 4 {
                now += Duration::from_millis(1);
                let taken = port.send(now, &frames.map(|frame| frame.0)).unwrap();
                assert!(taken <= frames.len());
                let count = port.receive(now, &mut into).unwrap();
                assert!(into[..count].iter().all(|received| received.at <= now));
            }
        }
    }
}

fn adapter(text: &[u8]) {
    let mut device = SlcanDevice::new(Bitrate::KBPS_1000);
    let now = Instant::ZERO;
    for piece in text.chunks(32) {
        device.handle_bytes(piece, now);
        while device.poll_transmit(now).is_some() {}
        if let [number, ..] = piece
            && !number.is_multiple_of(3)
        {
            device.consume(device.bytes().len());
        }
        assert!(device.room() <= 65_536);
    }
}

/// Each line of a command or a report is read back as the same.
fn lines(text: &[u8]) {
    let mut splitter = Splitter::default();
    for &byte in text {
        match splitter.push(byte) {
            Some(Piece::Line(line)) => {
                if let Some(again) = Command::parse(line).ok().and_then(|command| command.encode()) {
                    let line = again.strip_suffix(b"\r").expect("a command ends with its line");
                    let command = Command::parse(line).expect("its own line");
                    assert_eq!(command.encode().as_deref(), Some(&*again));
                }
                if let Ok(report) = AdapterReport::parse(Piece::Line(line))
                    && let Some(again) = report.encode()
                {
                    let line = again.strip_suffix(b"\r").expect("a report ends with its line");
                    assert_eq!(AdapterReport::parse(Piece::Line(line)), Ok(report));
                }
            }
            Some(Piece::Bell) | None => {}
        }
    }
}
