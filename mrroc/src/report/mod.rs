//! What a run says at its end: one JSON object, tables for a person, or a page with plots.
//!
//! The report as data lives here. `text.rs` prints it and `page.rs` makes the page of it. `tool.rs` finds how far each
//! robot was from its commanded path; `curves.rs` and `plots.rs` are what the page shows of that. `last_cycles.rs`
//! keeps the cycles up to a fault.

mod configuration;
mod curves;
mod devices;
mod fault;
mod last_cycles;
#[cfg(feature = "pages")]
mod page;
#[cfg(feature = "pages")]
mod plots;
pub(crate) mod slowed;
mod text;
mod tool;

use std::collections::BTreeMap;
use std::fmt;
use std::mem::take;
use std::time::Duration;

use drive::{Warning, Warnings};
use serde::Serialize;
use servo::thread::{AccountReads, LateCycle, Spike, WaitReport};
use servo::{Counters, Histogram, Servo, Timing};

use crate::{budget::BusBudget, cell::CellFile, run::ServoHang, wire::WireReport};

pub use crate::row_file::IncompleteFile;
pub use can::{counted, counted_as};
pub use configuration::ConfigurationReport;
pub use devices::{DeviceReport, ValueReport};
pub use fault::{ErrorPlace, FaultReport};
pub use last_cycles::{CycleState, LastCycles};
#[cfg(feature = "pages")]
pub(crate) use page::page;
pub use slowed::SlowedReport;
pub(crate) use tool::Tracks;
pub use tool::{Deviation, RobotReport, Subject};

/// What a run leaves behind.
pub(crate) struct RunEnd {
    /// The servo, its robots switched off. A servo thread that hangs keeps its servo.
    pub servo: Result<Servo, ServoHang>,
    pub tracks: Tracks,
    /// Files that lack entries.
    pub incomplete: Vec<IncompleteFile>,
    pub timing: Timing,
    /// The cycles around the latest ones.
    pub spikes: Vec<Spike>,
    /// Real-time requests that the host denied.
    pub denied: Vec<String>,
    /// Faults of the run, the first cause first.
    pub faults: Vec<FaultReport>,
    /// Errors that the task handled.
    pub recovered: Vec<FaultReport>,
    /// Motions that joints slowed, and the number of further ones.
    pub slowed: (Vec<slowed::SlowedMotion>, u64),
    /// Whether the task received the fault that still stops each robot.
    pub received: Vec<bool>,
    pub wire: Vec<WireReport>,
    /// Time that passed in the cell.
    pub cell_time: Duration,
}

/// The report of one run.
#[derive(Debug, Serialize)]
pub struct RunReport {
    /// The cell's name.
    pub cell: String,
    /// The bench it ran on.
    pub bench: &'static str,
    /// Every robot: how far it was from its commanded path.
    pub robots: Vec<RobotReport>,
    /// Records of a robot's cycle that the errors of robots lack, which were not read in time.
    pub lost_records: u64,
    /// Every axis, robot by robot. Empty if the servo thread hangs, which has the figures of axes and buses.
    pub axes: Vec<AxisReport>,
    /// The servo cycle.
    pub cycle: CycleReport,
    /// Every bus. Empty if the servo thread hangs.
    pub buses: Vec<BusReport>,
    /// Every bus on the wire; empty if nothing was heard.
    pub wire: Vec<WireReport>,
    /// What went wrong.
    pub faults: Vec<FaultReport>,
    /// Errors that the task received and handled, and errors of instructions that the task had dropped, in their order.
    pub recovered: Vec<FaultReport>,
    /// Files that were asked for and lack entries, for example because the disk was full. The exit status is then 1.
    pub incomplete_files: Vec<IncompleteFile>,
    /// The devices of other crates; absent without such a device.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub devices: Vec<DeviceReport>,
    /// Figures that the task reported, by name.
    pub figures: BTreeMap<String, f64>,
    /// Motions of which a part was slower than the limits of the tool permit, because of the limits of joints.
    pub slowed: Vec<SlowedReport>,
    /// Further slowed motions, which are counted alone.
    pub more_slowed: u64,
    /// Device configuration files of the axes: what they ask for, and their flaws.
    pub configurations: Vec<ConfigurationReport>,
    /// Axes that oscillated about their set-points.
    pub oscillations: Vec<OscillationReport>,
    /// Errors on CAN buses, and errors that drives reported without a fault.
    pub warnings: Vec<WarningReport>,
    /// Reports of further errors, which are counted alone.
    pub more_warnings: u64,
    /// Faults of the scenario that have not acted, each in one line.
    pub idle_faults: Vec<String>,
    /// What the host denied of the real-time requests.
    pub denied: Vec<String>,
    /// Time of the cell over time of the host: above 1 is faster than real time.
    pub realtime_factor: f64,
    /// How it ended.
    pub outcome: RunOutcome,
}

impl RunReport {
    /// The report of what `end` in `wall` of the host's time.
    pub(crate) fn of(
        file: &CellFile,
        bench: &'static str,
        end: &mut RunEnd,
        budgets: &[BusBudget],
        wall: Duration,
        outcome: RunOutcome,
    ) -> Self {
        let servo = end.servo.as_ref().ok();
        let counters = match &end.servo {
            Ok(servo) => servo.counters(),
            Err(hang) => Counters { cycles: hang.cycles, ..Counters::default() },
        };
        let robots = servo.into_iter().flat_map(|servo| file.cell.robot.iter().enumerate().map(move |it| (servo, it)));
        let axes = robots.flat_map(|(servo, (robot, value))| {
            let axes = value.axis.iter().zip(servo.tracking(robot));
            let axes = axes.zip(servo.homing_offsets(robot)).enumerate();
            axes.map(move |(number, ((axis, error), homing_offset_counts))| {
                let counts = f64::from(axis.counts_per_revolution()) / std::f64::consts::TAU;
                AxisReport {
                    name: file.axis_name(robot, number),
                    tracking_rms_rad: error.rms(),
                    tracking_peak_rad: error.peak,
                    tracking_rms_counts: error.rms() * counts,
                    tracking_peak_counts: error.peak * counts,
                    homing_offset_counts,
                }
            })
        });
        let robots = servo.into_iter().flat_map(|servo| (0..file.cell.robot.len()).map(move |robot| (servo, robot)));
        let oscillations = robots.flat_map(|(servo, robot)| {
            let axes = servo.oscillations(robot).enumerate();
            axes.filter_map(move |(axis, found)| {
                let (found, after) = found?;
                Some(OscillationReport {
                    axis: file.axis_name(robot, axis),
                    frequency_hz: found.frequency,
                    amplitude_rad: found.amplitude,
                    velocity_rad_s: found.velocity(),
                    at_rest: found.at_rest,
                    time_s: after.as_secs_f64(),
                    what: found.to_string(),
                })
            })
        });
        let groups = servo.into_iter().flat_map(Servo::group_counters).zip(budgets).enumerate();
        let buses = groups.map(|(index, (group, budget))| BusReport {
            name: budget.name.clone(),
            lines: (index >= file.cell.bus.len()).then(|| {
                let is_sensor = index >= file.cell.bus.len() + file.cell.serial.len();
                if is_sensor { 1 } else { file.cell.axes_on(index).count() }
            }),
            frames: group.port.sent + group.port.received,
            load_percent: 100.0 * group.port.bits as f64 / (budget.bits_per_second * end.cell_time.as_secs_f64()),
            worst_case_percent: budget.worst_case_percent,
            dropped_setpoints: group.dropped_setpoints,
            missed_answers: group.missed_answers,
            errors: group.port.errors,
            error_passive: group.port.passive,
            bus_off: group.port.bus_off,
        });
        let buses: Vec<_> = buses.collect();
        let timing = &end.timing;
        let groups = servo.into_iter().flat_map(Servo::warnings).enumerate();
        let warnings = groups
            .flat_map(|(group, warnings)| warnings.iter().map(move |warning| WarningReport::of(file, group, warning)));
        Self {
            cell: file.cell.name.clone(),
            bench,
            configurations: ConfigurationReport::all(file),
            oscillations: oscillations.collect(),
            warnings: buses.iter().filter_map(BusReport::trouble).chain(warnings).collect(),
            robots: end.tracks.reports(),
            lost_records: counters.dropped_records,
            more_warnings: servo.into_iter().flat_map(Servo::warnings).map(Warnings::omitted).sum(),
            axes: axes.collect(),
            cycle: CycleReport {
                period_us: file.cell.period().as_micros() as u32,
                cycles: counters.cycles,
                missed: counters.missed_cycles,
                wake_us: Percentiles::from(&timing.wake_up),
                sync_us: Percentiles::from(&timing.sync),
                step_us: Percentiles::from(&timing.step),
                bus_us: Percentiles::from(&timing.bus),
                wait: WaitCost::from(timing.wait),
                causes: timing.late.causes().map(|(cause, count)| (cause.name(), count)).collect(),
                worst: timing.late.worst().map(WorstCycle::from).collect(),
                account: timing.account,
            },
            buses,
            wire: take(&mut end.wire),
            faults: take(&mut end.faults),
            recovered: take(&mut end.recovered),
            slowed: end.slowed.0.iter().map(|motion| SlowedReport::of(file, motion)).collect(),
            more_slowed: end.slowed.1,
            incomplete_files: take(&mut end.incomplete),
            devices: take(&mut end.tracks.devices),
            figures: BTreeMap::new(),
            idle_faults: Vec::new(),
            denied: take(&mut end.denied),
            realtime_factor: end.cell_time.as_secs_f64() / wall.as_secs_f64(),
            outcome,
        }
    }

    /// Rows on the axes, each with its name, tracking errors, homing offset and faults; `none` stands for no offset.
    fn axis_rows(&self, none: &str) -> impl Iterator<Item = [String; 7]> {
        self.axes.iter().map(move |axis| {
            let faults = self.faults.iter().filter(|fault| fault.axis.as_ref() == Some(&axis.name));
            [
                axis.name.clone(),
                format!("{:.6}", axis.tracking_rms_rad),
                format!("{:.6}", axis.tracking_peak_rad),
                format!("{:.2}", axis.tracking_rms_counts),
                format!("{:.1}", axis.tracking_peak_counts),
                axis.homing_offset_counts.map_or(none.to_owned(), |counts| counts.to_string()),
                faults.count().to_string(),
            ]
        })
    }
}

/// One axis whose measured position oscillated about its set-points: the greatest oscillation of the run.
#[derive(Debug, Serialize)]
pub struct OscillationReport {
    /// The axis, as in [`AxisReport::name`].
    axis: String,
    frequency_hz: f64,
    /// Amplitude of the position of the motor, rad.
    amplitude_rad: f64,
    /// Amplitude of the velocity of the motor, rad/s.
    velocity_rad_s: f64,
    /// Whether the set-point stood still.
    at_rest: bool,
    /// Time of the first oscillation, from the first cycle, s.
    time_s: f64,
    what: String,
}

impl fmt::Display for OscillationReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, what, time_s, .. } = self;
        write!(f, "axis {axis}: {what}, at {time_s:.3} s: lower its gains or check its load")
    }
}

/// One error of one drive, and how often the drive reported the error.
#[derive(Debug, Serialize)]
pub struct WarningReport {
    bus: String,
    /// The axis, as in [`AxisReport::name`].
    axis: Option<String>,
    /// Null for errors on a bus.
    node: Option<u8>,
    /// Error code of the EMCY; null for a warning of another kind.
    code: Option<u16>,
    /// Error register of the EMCY (object 0x1001).
    register: Option<u8>,
    /// Time of the first report, from the end of bring-up, s; null for errors on a bus.
    time_s: Option<f64>,
    count: u64,
    what: String,
}

impl WarningReport {
    /// A warning of drive group `group`.
    pub fn of(file: &CellFile, group: usize, warning: &Warning) -> Self {
        let node = |&(robot, axis): &(usize, usize)| file.cell.robot[robot].axis[axis].node == warning.node;
        let axis = file.cell.axes_on(group).find(node);
        let emergency = warning.cause.emergency();
        Self {
            bus: file.cell.groups().nth(group).unwrap_or_default().to_owned(),
            axis: axis.map(|(robot, axis)| file.axis_name(robot, axis)),
            node: Some(warning.node),
            code: emergency.map(|(code, _)| code),
            register: emergency.map(|(_, register)| register),
            time_s: Some(warning.after.as_secs_f64()),
            count: warning.count,
            what: warning.to_string(),
        }
    }
}

impl fmt::Display for WarningReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "bus {}", self.bus)?;
        if let Some(axis) = &self.axis {
            write!(f, ", axis {axis}")?;
        }
        write!(f, ": {}", self.what)?;
        if let Some(time) = self.time_s {
            write!(f, ", at {time:.3} s")?;
        }
        if self.count > 1 {
            write!(f, " and {} more", counted(self.count - 1, "time"))?;
        }
        Ok(())
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunOutcome {
    /// The task ended without an error.
    Completed,
    /// Somebody stopped it.
    Stopped,
    /// A fault stopped it.
    Faulted,
}

impl fmt::Display for RunOutcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Completed => "completed",
            Self::Stopped => "stopped on request",
            Self::Faulted => "stopped by a fault",
        })
    }
}

/// One axis of the report. Errors are of the motor shaft, while moving.
#[derive(Debug, Serialize)]
pub struct AxisReport {
    /// Robot and axis.
    pub name: String,
    /// Root mean square of commanded minus measured motor position, rad.
    pub tracking_rms_rad: f64,
    /// Greatest absolute value of it, rad.
    pub tracking_peak_rad: f64,
    /// The same in increments of the encoder.
    pub tracking_rms_counts: f64,
    /// The same in increments of the encoder.
    pub tracking_peak_counts: f64,
    /// What the counter since power-on showed at the reference, increments; null without a search.
    pub homing_offset_counts: Option<i64>,
}

/// The servo cycle in the report.
#[derive(Debug, Serialize)]
pub struct CycleReport {
    /// Period, µs.
    pub period_us: u32,
    /// Cycles turned.
    pub cycles: u64,
    /// Deadlines missed.
    pub missed: u64,
    /// Lateness of the wake-up, µs.
    pub wake_us: Percentiles,
    /// From the deadline to when SYNC was handed over, µs.
    pub sync_us: Percentiles,
    /// Duration of the step, µs.
    pub step_us: Percentiles,
    /// From SYNC to the last answer to it, µs.
    pub bus_us: Percentiles,
    /// What the wait cost.
    pub wait: WaitCost,
    /// How many cycles were late, by who took the time: SYNC left more than a hundredth of the period after the
    /// deadline, or slots were let go.
    pub causes: BTreeMap<&'static str, u64>,
    /// The latest of them, the worst first.
    pub worst: Vec<WorstCycle>,
    /// How often the kernel was asked who, in the slack.
    pub account: AccountReads,
}

impl CycleReport {
    /// The measured times of the cycle with their names in tables. Virtual time has no delays, and a tty does not tell
    /// when an answer came.
    fn times(&self) -> impl Iterator<Item = (&'static str, Percentiles)> {
        let times = [("wake-up", self.wake_us), ("SYNC", self.sync_us), ("step", self.step_us), ("bus", self.bus_us)];
        times.into_iter().filter(|(_, times)| times.max > 0.0)
    }

    /// Causes of late cycles that occurred, and the lateness from which a cycle counts as late, µs.
    fn late(&self) -> (Vec<(&'static str, u64)>, f64) {
        let occurred = self.causes.iter().map(|(cause, count)| (*cause, *count)).filter(|(_, count)| *count > 0);
        (occurred.collect(), f64::from(self.period_us) / 100.0)
    }
}

/// One late cycle.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WorstCycle {
    /// Its number, from 0.
    pub cycle: u64,
    /// When it was due, from the first deadline, s.
    pub time_s: f64,
    /// How late it was, µs.
    pub late_us: f64,
    /// Who took the time.
    pub cause: &'static str,
}

impl From<LateCycle> for WorstCycle {
    fn from(late: LateCycle) -> Self {
        Self {
            cycle: late.cycle,
            time_s: late.due.as_secs_f64(),
            late_us: microseconds(late.late),
            cause: late.cause.name(),
        }
    }
}

/// What waiting for deadlines cost.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct WaitCost {
    /// How long before it needs to run the thread asks to be woken, as of last, µs.
    pub margin_us: f64,
    /// How long before the deadline it prepares the cycle, as of last, µs.
    pub preparation_us: f64,
    /// Time spent spinning, percent of a core.
    pub spin_percent: f64,
}

impl From<WaitReport> for WaitCost {
    fn from(wait: WaitReport) -> Self {
        Self {
            margin_us: microseconds(wait.margin),
            preparation_us: microseconds(wait.preparation),
            spin_percent: 100.0 * wait.spin_share,
        }
    }
}

/// A duration in µs.
pub fn microseconds(time: Duration) -> f64 {
    time.as_nanos() as f64 / 1e3
}

/// Four points of a distribution, µs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Greatest.
    pub max: f64,
}

impl Percentiles {
    /// The heads of the columns.
    pub(crate) const HEAD: &str = "       p50        p99      p99.9        max";

    /// The points of a distribution with these quantiles and this maximum, µs.
    pub fn of(quantile: impl Fn(f64) -> f64, max: f64) -> Self {
        Self { p50: quantile(0.5), p99: quantile(0.99), p999: quantile(0.999), max }
    }
}

/// The four points in columns of 10 characters, µs.
impl fmt::Display for Percentiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { p50, p99, p999, max } = self;
        write!(f, "{p50:>10.1} {p99:>10.1} {p999:>10.1} {max:>10.1}")
    }
}

impl From<&Histogram> for Percentiles {
    fn from(histogram: &Histogram) -> Self {
        let quantile = |share| microseconds(histogram.quantile(share));
        Self::of(quantile, microseconds(histogram.max()))
    }
}

/// One bus of the report.
#[derive(Debug, Serialize)]
pub struct BusReport {
    /// Its name.
    pub name: String,
    /// Lines, of a bundle of them; null for a CAN bus.
    pub lines: Option<usize>,
    /// Frames, or telegrams on lines, sent and received by the host.
    pub frames: u64,
    /// Share of the bus's time that those frames took, from bring-up to switch-off, percent.
    pub load_percent: f64,
    /// Share of the period after which the last frame of a cycle has left at the latest, percent.
    pub worst_case_percent: f64,
    /// Set-points that the bus did not take in their cycle and that were dropped.
    pub dropped_setpoints: u64,
    /// Answers of drives that did not come in their cycle.
    pub missed_answers: u64,
    /// Error frames of a CAN bus, error reports of an slcan adapter, or refused answers on lines.
    pub errors: u64,
    /// Times that the CAN controller of the host became error passive.
    pub error_passive: u64,
    /// Times that the CAN controller of the host went bus off.
    pub bus_off: u64,
}

impl BusReport {
    /// A warning of errors on a CAN bus.
    fn trouble(&self) -> Option<WarningReport> {
        let Self { name, errors, error_passive, bus_off, .. } = self;
        let troubled = self.lines.is_none() && errors + error_passive + bus_off > 0;
        troubled.then(|| WarningReport {
            bus: name.clone(),
            axis: None,
            node: None,
            code: None,
            register: None,
            time_s: None,
            count: 1,
            what: bus_errors([*errors, *error_passive, *bus_off], ""),
        })
    }
}

/// Text for errors on a CAN bus: error frames, times error passive and times bus off. `now`: the present state.
pub(crate) fn bus_errors([errors, error_passive, bus_off]: [u64; 3], now: &str) -> String {
    format!(
        "{}, error passive {}, bus off {}{now}: check bit rate, termination, cables, and power of the nodes",
        counted(errors, "error frame"),
        counted(error_passive, "time"),
        counted(bus_off, "time")
    )
}
