//! Timing of SYNC and the drives' answers on the wire, for each bus: the listeners and their report.
//!
//! The servo's port knows when it handed a SYNC to the driver, but not when the SYNC was on the bus. A second end
//! therefore listens:
//! - On a virtual bus, the listener gets the time of each frame's last bit.
//! - On SocketCAN, the listener is a socket that also receives the frames of other sockets of this host (kernel
//!   documentation, networking/can.rst, "Local Loopback of Sent Frames"). The driver of a card loops such a frame back
//!   after sending. For a driver without this function, such as that of `slcand`, the CAN core loops the frame back at
//!   the handover to the driver. The report names this case. vcan sends at once. The time stamps are those of the
//!   kernel, taken where the driver passes a frame on. If every frame has a time stamp of the card, those are used
//!   instead.
//! - An slcan adapter on a tty and a serial line have no time stamps, and the report has no times for them.
//!
//! An ordinary thread reads the listeners. The servo thread bears only the kernel's delivery of a few more frames, or
//! on the emulated bench a push into a queue.

mod report;

use std::time::Duration;

use anyhow::Context;
use can::{Frame, Instant, Port, Received, SocketCanOptions, SocketCanPort, StandardId, VirtualPort};
use canopen::wire_timing::{Sample, WireTiming};
use canopen::{cob, pdo::PdoKind};
use drive::cia402::pdo_setups;
use hdrhistogram::Histogram;

use crate::report::{Percentiles, microseconds};
use crate::{bench::interfaces::Interface, cell::CellFile, run::Background, setup};

pub use report::{NodeReport, Source, SyncStamp, WireReport};

/// Longest time between two readings of the listeners. Their queues hold the frames of some seconds.
const LOOK: Duration = Duration::from_millis(20);

/// Greatest number of frames read at a time, and of readings in one pass. No queue holds more frames.
const BATCH: usize = 32;
const BATCHES: usize = 1024;

/// Greatest recorded time, 10 s; longer times count as this one.
const LONGEST: u64 = 10_000_000_000;

/// `IFF_ECHO` of the kernel: the driver itself loops sent frames back.
const ECHO: u32 = 1 << 18;

/// The listener of one bus.
pub enum Listener {
    /// An end of the virtual bus.
    Virtual(VirtualPort),
    /// A separate socket on the interface, and the moment at which it stamps the frames of this host.
    SocketCan(SocketCanPort, SyncStamp),
    /// No time stamps are available.
    None,
}

impl Listener {
    /// A listener on the interface of bus `bus`; none for an slcan adapter.
    pub fn open(file: &CellFile, bus: usize, interface: &Interface) -> anyhow::Result<Self> {
        let Interface::SocketCan(name) = interface else {
            return Ok(Self::None);
        };
        let options = SocketCanOptions {
            accept: [cob::SYNC].into_iter().chain(answers(file, bus)).collect(),
            card_stamps: true,
            ..SocketCanOptions::default()
        };
        let port = SocketCanPort::open(name, &options).context("a second socket to listen")?;
        Ok(Self::SocketCan(port, sync_stamp(name)))
    }
}

/// The moment at which a frame of this host on `interface` is stamped, according to the driver's flag `IFF_ECHO`.
fn sync_stamp(interface: &str) -> SyncStamp {
    let flags = std::fs::read_to_string(format!("/sys/class/net/{interface}/flags"));
    let flags = flags.ok().and_then(|flags| u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16).ok());
    if flags.is_some_and(|flags| flags & ECHO != 0) { SyncStamp::Sent } else { SyncStamp::HandedOver }
}

/// The TPDOs with which the drives of bus `bus` answer SYNC, in the order of [`Cell::axes_on`].
///
/// [`Cell::axes_on`]: crate::cell::Cell::axes_on
fn answers(file: &CellFile, bus: usize) -> impl Iterator<Item = StandardId> {
    setup::axis_configs(file, bus).into_iter().map(|axis| {
        let answer = pdo_setups(&axis).into_iter().find(|setup| setup.kind == PdoKind::Tpdo);
        answer.and_then(|setup| setup.cob_id.id()).expect("every axis answers under an 11-bit identifier")
    })
}

/// The listeners of a cell and their results.
pub struct Wire(Vec<BusWire>);

struct BusWire {
    name: String,
    listener: Listener,
    /// Times from the virtual bus or from the kernel's time stamps.
    times: Times,
    /// Times from the card's time stamps, as long as every frame has one.
    card: Option<Times>,
    /// Each axis and its node-ID.
    axes: Vec<(String, u8)>,
}

impl Wire {
    /// One listener for each CAN bus of the cell, in its order.
    pub fn new(file: &CellFile, listeners: Vec<Listener>) -> Self {
        let listeners = listeners.into_iter().chain(std::iter::repeat_with(|| Listener::None));
        let bus = file.cell.groups().enumerate().zip(listeners).map(|((group, name), listener)| {
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

    /// These listeners, with the results of `before`, earlier listeners of the same buses.
    pub fn continuing(mut self, before: Option<Self>) -> Self {
        let before = before.into_iter().flat_map(|wire| wire.0);
        for (bus, before) in self.0.iter_mut().zip(before) {
            (bus.times, bus.card) = (before.times, before.card);
            for times in [Some(&mut bus.times), bus.card.as_mut()].into_iter().flatten() {
                times.timing.pause();
                times.follows_bring_up = true;
            }
        }
        self
    }

    /// Takes the frames received since the last call.
    pub fn look(&mut self) {
        self.0.iter_mut().for_each(BusWire::look);
    }

    /// Starts to listen on a separate thread, until the result is dropped or asked for its reports.
    pub(crate) fn listen(self) -> anyhow::Result<Background<Vec<WireReport>>> {
        // Frames that arrived before the end are still in the queues.
        let finish = |mut wire: Self| {
            wire.look();
            wire.reports()
        };
        let thread = Background::start("listener", LOOK, self, Self::look, finish);
        thread.context("no thread to listen to the buses can be made")
    }

    /// The results of each bus.
    pub fn reports(&self) -> Vec<WireReport> {
        self.0.iter().map(BusWire::report).collect()
    }
}

impl BusWire {
    fn look(&mut self) {
        let nothing = Received { frame: canopen::sync::Sync::default().encode(), at: Instant::ZERO };
        let mut frames = [nothing; BATCH];
        for _ in 0..BATCHES {
            // The servo reports a failed bus, which may recover.
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
                let all = port
                    .card_stamps()
                    .iter()
                    .zip(&frames)
                    .all(|(stamp, received)| stamp.map(|at| card.record(at, &received.frame)).is_some());
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
            Listener::Virtual(port) => (Some(Source::Virtual), Some(SyncStamp::Sent), port.counters().dropped),
            Listener::SocketCan(port, stamp) => {
                let source = heard_by_card.map_or(Source::Kernel, |_| Source::Hardware);
                (Some(source), Some(*stamp), port.counters().dropped)
            }
            Listener::None => (None, None, 0),
        };
        let answers = times.answers.iter().zip(times.timing.counts());
        let nodes = self.axes.iter().zip(answers).map(|((axis, node), (after, counts))| NodeReport {
            axis: axis.clone(),
            node: *node,
            sync_to_tpdo_us: after.percentiles(),
            unanswered: counts.unanswered,
            late: counts.late,
            surplus: counts.surplus,
        });
        WireReport {
            bus: self.name.clone(),
            source,
            sync_stamp,
            sync_to_sync_us: times.sync.percentiles(),
            sync_off_period_us: times.off_period.percentiles(),
            nodes: nodes.collect(),
            lost_frames,
        }
    }
}

/// Distributions of the times of one bus.
struct Times {
    timing: WireTiming,
    period: Duration,
    /// The next time between two SYNCs begins with the SYNC of bring-up that stands alone.
    follows_bring_up: bool,
    sync: Spread,
    /// Absolute deviation of the time between two SYNCs from the period.
    off_period: Spread,
    answers: Vec<Spread>,
}

impl Times {
    fn new(period: Duration, ids: &[StandardId]) -> Self {
        Self {
            timing: WireTiming::new(ids.iter().copied()),
            period,
            follows_bring_up: !ids.is_empty(),
            sync: Spread::new(),
            off_period: Spread::new(),
            answers: ids.iter().map(|_| Spread::new()).collect(),
        }
    }

    fn record(&mut self, at: Instant, frame: &Frame) {
        let (sync, off, answers) = (&mut self.sync, &mut self.off_period, &mut self.answers);
        let follows_bring_up = &mut self.follows_bring_up;
        self.timing.observe(at, frame, |sample| match sample {
            Sample::SyncToSync(_) if *follows_bring_up => *follows_bring_up = false,
            Sample::SyncToSync(apart) => {
                sync.record(apart);
                off.record(apart.abs_diff(self.period));
            }
            Sample::SyncToAnswer { index, after } => answers[index].record(after),
        });
    }
}

/// Durations in four significant digits (0.1 µs for a period of 2 ms), and the exact maximum. The memory grows with
/// the recorded values: 0.5 MB up to 2 ms.
struct Spread(Histogram<u32>, Duration);

impl Spread {
    fn new() -> Self {
        Self(Histogram::new(4).expect("the library takes up to five digits"), Duration::ZERO)
    }

    fn record(&mut self, duration: Duration) {
        let nanos = u64::try_from(duration.as_nanos()).unwrap_or(LONGEST);
        self.0.record(nanos.min(LONGEST)).expect("it grows up to any length");
        self.1 = self.1.max(duration);
    }

    /// `None` without values.
    fn percentiles(&self) -> Option<Percentiles> {
        let max = microseconds(self.1);
        let quantile = |share| (self.0.value_at_quantile(share) as f64 / 1e3).min(max);
        (!self.0.is_empty()).then(|| Percentiles::of(quantile, max))
    }
}
