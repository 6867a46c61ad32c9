//! Frames of further nodes on an emulated bus, which load the bus.

use std::time::Duration;

use can::schedule::{Every, Message, Sender};
use can::timing::{Bitrate, bits_on_wire};
use can::{Frame, Instant, StandardId};
use hil::Device;
use hil::plant::Noise;

/// Identifiers of the frames, used in turn. No CANopen device uses these identifiers: the first has a higher priority
/// than all process data (0x101 to 0x180 are reserved, CiA 301 §7.3.5), and the second a lower priority than all
/// objects but LSS.
const IDS: [u16; 2] = [0x17F, 0x7A0];

/// A node that sends frames of eight bytes at random intervals and ignores received frames.
///
/// The mean load is a given share of the capacity of the bus. The interval between two frames is uniformly distributed
/// from half to one and a half of its mean.
pub(super) struct BusLoad {
    interval: f64,
    noise: Noise,
    sent: usize,
    next: Instant,
    due: u32,
}

impl BusLoad {
    /// Traffic that takes this `share` of the capacity of a bus, above 0 and up to 1, with random intervals.
    pub(super) fn new(bitrate: Bitrate, share: f64, seed: u64) -> Self {
        Self { interval: interval(bitrate, share), noise: Noise::new(seed), sent: 0, next: Instant::ZERO, due: 0 }
    }
}

/// Mean interval between two frames that take this share of the capacity of a bus, s.
fn interval(bitrate: Bitrate, share: f64) -> f64 {
    let bits = [0, 1].map(frame).iter().map(bits_on_wire).sum::<u32>();
    bitrate.duration(bits).as_secs_f64() / 2.0 / share
}

/// The messages of [`BusLoad`] at their highest rate.
pub(crate) fn further(bitrate: Bitrate, share: f64) -> impl Iterator<Item = Message> {
    let ids = IDS.into_iter().filter(move |_| share > 0.0);
    ids.map(move |id| Message {
        id: StandardId::new(id).expect("the identifiers have 11 bits"),
        bytes: 8,
        sender: Sender::Node(0),
        // Two intervals between frames of the same identifier, each at least half of the mean.
        every: Every::Interval(Duration::from_secs_f64(interval(bitrate, share))),
    })
}

fn frame(number: usize) -> Frame {
    let id = StandardId::new(IDS[number % IDS.len()]).expect("the identifiers have 11 bits");
    Frame::new(id, &[0x55; 8]).expect("eight bytes fit a frame")
}

impl Device for BusLoad {
    fn handle(&mut self, _frame: &Frame, _now: Instant) {}

    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        self.due = self.due.checked_sub(1)?;
        self.sent += 1;
        Some(frame(self.sent))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }

    fn handle_timeout(&mut self, now: Instant) {
        while now >= self.next {
            self.due = (self.due + 1).min(4);
            self.next += Duration::from_secs_f64(self.interval * (1.0 + 0.5 * self.noise.symmetric()));
        }
    }
}
