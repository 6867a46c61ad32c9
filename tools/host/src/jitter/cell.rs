//! Measurement of the whole cycle of a cell: the time from a deadline to the transmission of its SYNC.
//!
//! Each turn brings the drives up, switches them on and lets them hold their position. Nothing is homed and nothing
//! moves. The servo thread itself measures every cycle from bring-up to switch-off, so one turn gives one interval.
//! There is no servo between the turns, and the peer has the host for itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use can::clock::{now, sleep_until};
use serde::Serialize;
use servo::thread::{Denial, LateCycles, Realtime, Spike, Tracer, WaitReport};
use servo::{Order, Phase, Servo};

use super::bench::CellBench;
use super::interval::{Interval, Latencies, Ledger};
use super::probe::{LOOK, Turn};
use super::report::percentiles;
use mrroc::bench::clockwork;
use mrroc::bench::{Bench, BenchKind, Places};
use mrroc::cell::CellFile;
use mrroc::report::Percentiles;
use mrroc::run::{ServoHang, Turning, hang_limit};
use mrroc::setup;
use mrroc::wire::{Wire, WireReport};

/// Reason why a turn gave no interval.
pub(super) enum Unmeasured {
    /// The cell cannot be measured.
    Refused(anyhow::Error),
    /// The servo thread hangs, and was left behind.
    Hung(ServoHang),
}

impl<T: Into<anyhow::Error>> From<T> for Unmeasured {
    fn from(why: T) -> Self {
        Self::Refused(why.into())
    }
}

/// A cell under measurement.
pub(super) struct MeasuredCell<'a> {
    file: &'a CellFile,
    bench: CellBench,
    /// Values of `--can`.
    can: &'a [String],
    /// Whether additional frames load the buses.
    traffic: bool,
    step: Latencies,
    bus: Latencies,
    wake_up: Latencies,
    pub missed: u64,
    pub wait: WaitReport,
    /// Late cycles of all turns.
    pub late: LateCycles,
    /// Cycles around the latest cycles of all turns. Each turn numbers its own cycles.
    pub spikes: Vec<Spike>,
    /// Listener on the buses, from the first turn on.
    wire: Option<Wire>,
    /// Whether every robot held its position with its power on in every turn.
    stood: bool,
}

impl<'a> MeasuredCell<'a> {
    pub(super) fn new(file: &'a CellFile, bench: CellBench, can: &'a [String], traffic: bool) -> Self {
        Self {
            file,
            bench,
            can,
            traffic,
            step: Latencies::empty(),
            bus: Latencies::empty(),
            wake_up: Latencies::empty(),
            missed: 0,
            wait: WaitReport::default(),
            late: LateCycles::default(),
            spikes: Vec::new(),
            wire: None,
            stood: true,
        }
    }

    /// Discards everything measured so far.
    pub(super) fn forget(&mut self) {
        *self = Self::new(self.file, self.bench, self.can, self.traffic);
    }

    /// Runs one turn and records it in `ledger`. Returns what the host denied. `look` is called repeatedly during the
    /// turn. A servo thread that hangs is left behind.
    pub(super) fn turn(
        &mut self,
        realtime: Realtime,
        turn: Turn,
        ledger: &mut Ledger,
        mut look: impl FnMut(&mut Ledger),
    ) -> Result<Vec<Denial>, Unmeasured> {
        let file = self.file;
        let kind = match self.bench {
            CellBench::Emulated => BenchKind::Emulated,
            CellBench::Vcan => BenchKind::Vcan,
        };
        let places = Places { can: self.can.to_vec(), ..Places::default() };
        let bench = Bench::open(file, kind, &places, false)?;
        let mut wire = bench.wire.continuing(self.wire.take());
        let groups = setup::devices(file, bench.ports, bench.lines, bench.sensors, None)?.groups;
        let (mut servo, mut links) = Servo::new(&setup::servo_config(file), groups)?;
        let mut emulation = bench.emulation;
        if let Some(emulation) = emulation.as_mut().filter(|_| self.traffic) {
            emulation.add_traffic();
        }
        let since = clockwork::bring_up(&mut servo, &mut emulation);
        let since = since.map_err(|error| mrroc::run::diagnosed(file, &servo, error))?;
        for link in &mut links {
            let ordered = link.orders.push(Order::Enable);
            ordered.map_err(|_| anyhow!("no order could be given"))?;
        }
        let (begun, over) = (now(), turn.over.clone());
        let end = begun + turn.time;
        let done = Arc::new(AtomicBool::new(false));
        let finished = done.clone();
        let is_over = move || over.load(Ordering::Relaxed) || finished.load(Ordering::Relaxed);
        let until = move |_: &Servo| now() >= end || is_over();
        let stop = servo.stop_request();
        let running = clockwork::start(servo, emulation, since, realtime, Arc::default(), || {}, until)?;
        let limit = hang_limit(&file.cell, since.is_some());
        let mut turning = Turning::of(running, done, stop, limit);
        let mut stood = vec![false; links.len()];
        while !turning.is_over() {
            for (link, stood) in links.iter_mut().zip(&mut stood) {
                while let Ok(report) = link.reports.pop() {
                    *stood |= report.snapshot.phase == Phase::Standing;
                }
            }
            wire.look();
            look(ledger);
            sleep_until(now() + LOOK);
        }
        let finished = turning.end().map_err(Unmeasured::Hung)?;
        wire.look();
        self.wire = Some(wire);
        for robot in 0..links.len() {
            if let Some(fault) = finished.servo.fault(robot) {
                return Err(anyhow!("robot {}: {fault}", file.cell.robot[robot].name).into());
            }
        }
        if let Some(panicked) = finished.panicked {
            return Err(anyhow!("the servo thread panicked: {panicked:?}").into());
        }
        let timing = &finished.timing;
        for (all, of_turn) in
            [(&mut self.step, &timing.step), (&mut self.bus, &timing.bus), (&mut self.wake_up, &timing.wake_up)]
        {
            all.add(&Latencies::of(of_turn));
        }
        self.missed += finished.servo.counters().missed_cycles;
        self.wait = timing.wait;
        self.late.add(&timing.late);
        self.spikes.extend(finished.spikes);
        self.spikes.sort_by_key(|spike| std::cmp::Reverse(spike.lateness()));
        self.spikes.truncate(Tracer::KEPT);
        self.stood &= stood.into_iter().all(|stood| stood);
        ledger.add(&Interval { begun, ended: now(), late: Latencies::of(&timing.sync) })?;
        Ok(finished.denied)
    }

    /// Measurements of the cycle other than the delay of SYNC.
    pub(super) fn report(&self) -> CellReport {
        CellReport {
            name: self.file.cell.name.clone(),
            bench: self.bench,
            state: if self.stood {
                "power on, holding position, not homed"
            } else {
                "switching on, holding position not reached in every turn"
            },
            wake_us: percentiles(&self.wake_up),
            step_us: percentiles(&self.step),
            bus_us: percentiles(&self.bus),
            wire: self.wire.as_ref().map_or_else(Vec::new, Wire::reports),
        }
    }
}

/// Measurements of the cycle of a cell.
#[derive(Debug, Serialize)]
pub(super) struct CellReport {
    pub name: String,
    pub bench: CellBench,
    /// State of the drives during the measurement.
    pub state: &'static str,
    /// Lateness of the wake-up, µs.
    pub wake_us: Percentiles,
    /// Duration of the step, µs.
    pub step_us: Percentiles,
    /// Time from SYNC to the last answer, µs.
    pub bus_us: Percentiles,
    /// Measurements of every bus.
    pub wire: Vec<WireReport>,
}
