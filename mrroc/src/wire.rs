//! When SYNC and the drives' answers were on the wire, bus by bus: who listens, and what a report says of it.
//!
//! The servo's port cannot tell: it knows when it handed a SYNC over, not when that was on the bus. So a second end
//! listens. On a virtual bus it is told the instant of each frame's last bit. On SocketCAN it is a socket that receives
//! what other sockets of this host send as well (kernel documentation, networking/can.rst, "Local Loopback of Sent
//! Frames"): a card's driver hands such a frame back once it was sent; for a driver that does not, such as that of
//! `slcand`, the CAN core does as soon as it was handed over, and the report says so. vcan sends at once. Stamps are the
//! kernel's, taken where the driver passes a frame on, or the card's own where every frame has one. An slcan adapter on
//! a tty and a serial line tell nothing of the kind, and nothing is made up for them.
//!
//! An ordinary thread reads; the servo thread bears the delivery of a few more frames by the kernel, and on the emulated
//! bench a push into a queue.

mod listening;
mod report;

use std::time::Duration;

use anyhow::Context;
use can::{
    Frame, Instant, Port, Received, SocketCanOptions, SocketCanPort, StandardId, VirtualPort,
};
use canopen::cob;
use canopen::pdo::PdoKind;
use canopen::wire_timing::{Sample, WireTiming};
use drive::cia402::pdo_setups;
use hdrhistogram::Histogram;

use crate::bench::interfaces::Interface;
use crate::cell_file::CellFile;
use crate::report::{Percentiles, microseconds};
use crate::setup;

pub use report::{NodeReport, Source, SyncStamp, WireReport};

/// Frames that are read at a time, and how often at one look: no queue holds more.
const BATCH: usize = 32;
const BATCHES: usize = 1024;

/// Beyond this a time counts as this: 10 s.
const LONGEST: u64 = 10_000_000_000;

/// `IFF_ECHO` of the kernel: the driver itself loops sent frames back.
const ECHO: u32 = 1 << 18;

/// What listens to one bus.
pub enum Listener {
    /// An end of the virtual bus.
    Virtual(VirtualPort),
    /// A socket of its own on the interface, and when that stamps what this host sends.
    SocketCan(SocketCanPort, SyncStamp),
    /// Nothing could tell when a frame was on the wire.
    None,
}

impl Listener {
    /// On the interface of bus `bus`; nothing on an slcan adapter.
    pub fn open(file: &CellFile, bus: usize, interface: &Interface) -> anyhow::Result<Self> {
        let Interface::SocketCan(name) = interface else {
            return Ok(Self::None);
        };
        let options = SocketCanOptions {
            accept: [cob::SYNC].into_iter().chain(answers(file, bus)).collect(),
            card_stamps: true,
            ..SocketCanOptions::default()
        };
        let port = SocketCanPort::open(name, &options);
        let port = port.context("a second socket to listen")?;
        Ok(Self::SocketCan(port, sync_stamp(name)))
    }
}

/// When a frame that this host sends on `interface` gets its stamp: by what its driver says it does (`IFF_ECHO`).
fn sync_stamp(interface: &str) -> SyncStamp {
    let flags = std::fs::read_to_string(format!("/sys/class/net/{interface}/flags"));
    let flags = flags.ok().and_then(|flags| {
        let digits = flags.trim().trim_start_matches("0x");
        u32::from_str_radix(digits, 16).ok()
    });
    match flags {
        Some(flags) if flags & ECHO != 0 => SyncStamp::Sent,
        _ => SyncStamp::HandedOver,
    }
}

/// The TPDOs with which the drives of bus `bus` answer SYNC, in the order of [`Cell::axes_on`].
///
/// [`Cell::axes_on`]: crate::cell::Cell::axes_on
fn answers(file: &CellFile, bus: usize) -> impl Iterator<Item = StandardId> {
    let configs = setup::axis_configs(file, bus).into_iter();
    configs.map(|axis| {
        let mut setups = pdo_setups(axis.node, axis.mode).into_iter();
        let answer = setups.find(|setup| setup.kind == PdoKind::Tpdo);
        let id = answer.and_then(|setup| setup.cob_id.id());
        id.expect("every axis answers under an 11-bit identifier")
    })
}

/// The listeners of a cell and what they have heard.
pub struct Wire(Vec<BusWire>);

struct BusWire {
    name: String,
    listener: Listener,
    /// By the instants of the bus, or the kernel's stamps.
    times: Times,
    /// By the card's own stamps, while every frame has one.
    card: Option<Times>,
    /// Each axis and its node-ID.
    axes: Vec<(String, u8)>,
}

impl Wire {
    /// One listener for each CAN bus of the cell, in its order.
    pub fn new(file: &CellFile, listeners: Vec<Listener>) -> Self {
        let listeners = listeners.into_iter();
        let listeners = listeners.chain(std::iter::repeat_with(|| Listener::None));
        let groups = file.cell.groups().enumerate().zip(listeners);
        let bus = groups.map(|((group, name), listener)| {
            let axes = file.cell.axes_on(group).map(|(robot, axis)| {
                let node = file.cell.robot[robot].axis[axis].node;
                (file.axis_name(robot, axis), node)
            });
            // A bundle of lines has no COB-IDs.
            let ids = match listener {
                Listener::None => Vec::new(),
                _ => answers(file, group).collect(),
            };
            let times = || Times::new(file.cell.period(), &ids);
            let has_card = matches!(listener, Listener::SocketCan(..));
            BusWire {
                name: name.to_owned(),
                times: times(),
                card: has_card.then(times),
                axes: axes.collect(),
                listener,
            }
        });
        Self(bus.collect())
    }

    /// These listeners with what `before`, others of the same buses, have heard.
    pub fn continuing(mut self, before: Option<Self>) -> Self {
        let before = before.into_iter().flat_map(|wire| wire.0);
        for (bus, before) in self.0.iter_mut().zip(before) {
            (bus.times, bus.card) = (before.times, before.card);
            let times = [Some(&mut bus.times), bus.card.as_mut()];
            times
                .into_iter()
                .flatten()
                .for_each(|times| times.timing.pause());
        }
        self
    }

    /// Takes what was heard since the last call.
    pub fn look(&mut self) {
        self.0.iter_mut().for_each(BusWire::look);
    }

    /// What was heard, bus by bus.
    pub fn reports(&self) -> Vec<WireReport> {
        self.0.iter().map(BusWire::report).collect()
    }
}

impl BusWire {
    fn look(&mut self) {
        let nothing = Received {
            frame: canopen::sync::Sync::default().encode(),
            at: Instant::ZERO,
        };
        let mut frames = [nothing; BATCH];
        for _ in 0..BATCHES {
            // A bus that fails is the servo's to report; it may come back.
            let heard = match &mut self.listener {
                Listener::Virtual(port) => port.receive(Instant::FAR_FUTURE, &mut frames),
                Listener::SocketCan(port, _) => port.receive(Instant::FAR_FUTURE, &mut frames),
                Listener::None => Ok(0),
            };
            let count = heard.unwrap_or(0);
            if count == 0 {
                break;
            }
            for received in &frames[..count] {
                self.times.record(received.at, &received.frame);
            }
            if let (Some(card), Listener::SocketCan(port, _)) = (&mut self.card, &self.listener) {
                let mut stamps = port.card_stamps().iter().zip(&frames);
                let all = stamps.all(|(stamp, received)| {
                    let stamped = stamp.map(|at| card.record(at, &received.frame));
                    stamped.is_some()
                });
                if !all {
                    self.card = None;
                }
            }
        }
    }

    fn report(&self) -> WireReport {
        let heard_by_card = self.card.as_ref().filter(|card| !card.sync.0.is_empty());
        let times = heard_by_card.unwrap_or(&self.times);
        let (source, sync_stamp, lost_frames) = match &self.listener {
            Listener::Virtual(port) => {
                let stamp = Some(SyncStamp::Sent);
                (Some(Source::Virtual), stamp, port.counters().dropped)
            }
            Listener::SocketCan(port, stamp) => {
                let source = heard_by_card.map_or(Source::Kernel, |_| Source::Hardware);
                (Some(source), Some(*stamp), port.counters().dropped)
            }
            Listener::None => (None, None, 0),
        };
        let nodes = self
            .axes
            .iter()
            .zip(times.answers.iter().zip(times.timing.counts()));
        WireReport {
            bus: self.name.clone(),
            source,
            sync_stamp,
            sync_to_sync_us: times.sync.percentiles(),
            sync_off_period_us: times.off_period.percentiles(),
            nodes: nodes
                .map(|((axis, node), (after, counts))| NodeReport {
                    axis: axis.clone(),
                    node: *node,
                    sync_to_tpdo_us: after.percentiles(),
                    unanswered: counts.unanswered,
                    late: counts.late,
                    surplus: counts.surplus,
                })
                .collect(),
            lost_frames,
        }
    }
}

/// The times of one bus, in distributions.
struct Times {
    timing: WireTiming,
    period: Duration,
    sync: Spread,
    /// By how much the distance of two SYNCs was off the period, either way.
    off_period: Spread,
    answers: Vec<Spread>,
}

impl Times {
    fn new(period: Duration, ids: &[StandardId]) -> Self {
        Self {
            timing: WireTiming::new(ids.iter().copied()),
            period,
            sync: Spread::new(),
            off_period: Spread::new(),
            answers: ids.iter().map(|_| Spread::new()).collect(),
        }
    }

    fn record(&mut self, at: Instant, frame: &Frame) {
        let (sync, off, answers) = (&mut self.sync, &mut self.off_period, &mut self.answers);
        self.timing.observe(at, frame, |sample| match sample {
            Sample::SyncToSync(apart) => {
                sync.record(apart);
                off.record(apart.abs_diff(self.period));
            }
            Sample::SyncToAnswer { index, after } => answers[index].record(after),
        });
    }
}

/// Durations in four significant digits, a period of 2 ms to 0.1 µs, and the longest exactly. It grows with what is
/// recorded: 0.5 MB up to 2 ms.
struct Spread(Histogram<u32>, Duration);

impl Spread {
    fn new() -> Self {
        let histogram = Histogram::new(4).expect("the library takes up to five digits");
        Self(histogram, Duration::ZERO)
    }

    fn record(&mut self, duration: Duration) {
        let nanos = u64::try_from(duration.as_nanos()).unwrap_or(LONGEST);
        let recorded = self.0.record(nanos.min(LONGEST));
        recorded.expect("it grows up to any length");
        self.1 = self.1.max(duration);
    }

    /// `None` of nothing.
    fn percentiles(&self) -> Option<Percentiles> {
        let max = microseconds(self.1);
        let quantile = |share| (self.0.value_at_quantile(share) as f64 / 1e3).min(max);
        (!self.0.is_empty()).then(|| Percentiles {
            p50: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max,
        })
    }
}
