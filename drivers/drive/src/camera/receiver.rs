//! The receiver of the frames of a camera.

use std::mem::swap;
use std::time::Duration;

use can::Instant;
use serial::camera::{FrameHeader, FrameKind, HEADER, checksum};

use super::{CameraConfig, CameraFault, CameraLink, Picture};

/// Greatest relative difference between the declared period and that of the camera.
const RATE: f64 = 0.01;

/// What the next byte belongs to.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A header, of which `filled` bytes are there.
    Header { filled: usize },
    /// The pixels of a picture.
    Pixels(FrameHeader),
}

/// The receiver of the frames of one connection after the other.
///
/// The caller passes each piece of the stream with the time of its arrival ([`receive`](Self::receive)), and calls
/// [`tick`](Self::tick) at least once per period of the pictures. Bytes that are no header are discarded one by one, so
/// that the receiver finds the next frame after garbage. After bring-up the receiver does not allocate.
#[derive(Debug)]
pub struct CameraReceiver {
    config: CameraConfig,
    link: CameraLink,
    part: Part,
    header: [u8; HEADER],
    /// The picture in progress.
    next: Picture,
    greeted: bool,
    /// Time of the last valid picture, or of the connection.
    last: Instant,
    /// Bytes discarded since then.
    discarded: u64,
    /// Sequence number of the last picture of this connection.
    sequence: Option<u32>,
    /// Number of valid pictures.
    number: u64,
}

impl CameraReceiver {
    /// A receiver without a connection, and the controller's end.
    pub fn new(config: CameraConfig) -> (Self, CameraLink) {
        let link = CameraLink::new();
        link.slot().picture = Picture::with_room(&config);
        let receiver = Self {
            config,
            link: link.clone(),
            part: Part::Header { filled: 0 },
            header: [0; HEADER],
            next: Picture::with_room(&config),
            greeted: false,
            last: Instant::ZERO,
            discarded: 0,
            sequence: None,
            number: 0,
        };
        (receiver, link)
    }

    /// The configuration.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Begins a connection at `now`.
    pub fn connected(&mut self, now: Instant) {
        self.part = Part::Header { filled: 0 };
        (self.greeted, self.sequence, self.discarded, self.last) = (false, None, 0, now);
    }

    /// Whether the camera sent its greeting in this connection, and the greeting is that of the declared camera.
    pub fn is_greeted(&self) -> bool {
        self.greeted
    }

    /// Takes bytes that arrived at `now`.
    pub fn receive(&mut self, mut bytes: &[u8], now: Instant) {
        while let Some(&first) = bytes.first() {
            match self.part {
                Part::Header { filled } => {
                    self.header[filled] = first;
                    bytes = &bytes[1..];
                    self.part = Part::Header { filled: filled + 1 };
                    if filled + 1 == HEADER {
                        self.end_header();
                    }
                }
                Part::Pixels(header) => {
                    let missing = header.pixels() - self.next.pixels.len();
                    let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
                    self.next.pixels.extend_from_slice(taken);
                    bytes = rest;
                    if self.next.pixels.len() == header.pixels() {
                        self.part = Part::Header { filled: 0 };
                        self.end_picture(&header, now);
                    }
                }
            }
        }
    }

    /// Judges the age of the last picture at `now`. A camera without its greeting has the same deadline.
    pub fn tick(&mut self, now: Instant) {
        let age = now.since(self.last);
        if age <= self.config.deadline() {
            return;
        }
        let fault = match self.link.fault() {
            // These faults have a better reason than the missing picture.
            Some(CameraFault::Size { .. } | CameraFault::Rate { .. } | CameraFault::Absent { .. }) => return,
            Some(CameraFault::Closed { .. }) => CameraFault::Closed { age },
            _ if self.discarded > 0 => CameraFault::Garbled { age, discarded: self.discarded },
            _ => CameraFault::Silent { age },
        };
        self.fail(fault);
    }

    /// Notes that no connection could be made for `waited`.
    pub fn absent(&mut self, waited: Duration) {
        self.fail(CameraFault::Absent { waited });
    }

    /// Notes the end of the connection at `now`.
    pub fn closed(&mut self, now: Instant) {
        self.fail(CameraFault::Closed { age: now.since(self.last) });
    }

    fn fail(&mut self, fault: CameraFault) {
        self.link.slot().fault = Some(fault);
    }

    fn end_header(&mut self) {
        let Some(header) = FrameHeader::decode(&self.header) else {
            // The next frame may begin at any of the other bytes.
            self.header.copy_within(1.., 0);
            self.part = Part::Header { filled: HEADER - 1 };
            self.discarded += 1;
            return;
        };
        self.part = Part::Header { filled: 0 };
        let CameraConfig { width, height, period: declared, .. } = self.config;
        let found = Duration::from_nanos(header.period_ns.into());
        if (header.width, header.height) != (width, height) {
            let (found_width, found_height) = (header.width, header.height);
            return self.fail(CameraFault::Size { found_width, found_height, width, height });
        }
        if (found.as_secs_f64() / declared.as_secs_f64() - 1.0).abs() > RATE {
            return self.fail(CameraFault::Rate { found, declared });
        }
        match header.kind {
            FrameKind::Greeting => self.greeted = true,
            FrameKind::Picture => {
                self.next.pixels.clear();
                self.part = Part::Pixels(header);
            }
        }
    }

    fn end_picture(&mut self, header: &FrameHeader, now: Instant) {
        if checksum(&self.next.pixels) != header.pixels_crc {
            self.discarded += (HEADER + self.next.pixels.len()) as u64;
            return;
        }
        self.number += 1;
        (self.last, self.discarded) = (now, 0);
        let expected = self.sequence.map_or(header.sequence, |last| last.wrapping_add(1));
        self.sequence = Some(header.sequence);
        let next = &mut self.next;
        (next.number, next.sequence, next.width, next.height) =
            (self.number, header.sequence, header.width, header.height);
        next.exposed = Duration::from_nanos(header.exposed_ns);
        next.exposure = Duration::from_nanos(header.exposure_ns.into());
        let mut slot = self.link.slot();
        swap(&mut slot.picture, next);
        slot.fault = None;
        slot.lost += u64::from(header.sequence.wrapping_sub(expected));
    }
}
