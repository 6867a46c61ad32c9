//! Report of a measurement: one JSON object, lines for a person, or CSV.

use std::fmt;

use serde::Serialize;
use servo::identify::{Margin, Point, Response, Run, bandwidth, margin};
use servo::{Law, Output, PositionLoop, ServoAxisConfig};

/// Coherence from which on a point needs no further periods.
const SURE: f64 = 0.9;

/// The report of one axis.
#[derive(Debug, Serialize)]
pub struct IdentifyReport {
    /// ROBOT.AXIS.
    pub axis: String,
    /// The bench of the measurement.
    pub bench: &'static str,
    /// Device that closes the position loop, and the kind of loop.
    pub closed_by: String,
    /// Whether the response is of the open loop, or from command to sampled position.
    pub open_loop: bool,
    /// Amplitude of the excitation.
    pub amplitude: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Motor velocity during the measurement, rad/s.
    pub velocity: f64,
    /// Crossover frequency of the open loop, Hz.
    pub crossover_hz: Option<f64>,
    /// Phase margin at the crossover, degrees.
    pub phase_margin_deg: Option<f64>,
    /// Bandwidth of the closed loop at -3 dB, Hz.
    pub bandwidth_hz: Option<f64>,
    /// Maximum magnitude of the closed loop, dB.
    pub peak_db: Option<f64>,
    /// Lowest coherence in the octave around the crossover or the bandwidth. If neither exists, the lowest of all
    /// points.
    pub coherence: f64,
    /// Points of the frequency response.
    pub points: Vec<PointReport>,
}

/// One frequency of a response.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PointReport {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Magnitude, a ratio of equal units.
    pub magnitude: f64,
    /// Phase, degrees.
    pub phase_deg: f64,
    /// Coherence, 0 to 1.
    pub coherence: f64,
}

impl IdentifyReport {
    pub(crate) fn of(
        axis: String,
        bench: &'static str,
        config: &ServoAxisConfig,
        run: &Run,
        kind: Response,
        points: &[Point],
    ) -> Self {
        let (closed_by, unit) = match &config.position_loop {
            PositionLoop::Drive if config.torque_offset.is_some() => ("the drive".into(), "N·m"),
            PositionLoop::Drive => ("the drive".into(), "rad"),
            PositionLoop::Host(host) => {
                let law = match host.law {
                    Law::Incremental(_) => "incremental law",
                    Law::Cascade(_) => "cascade",
                    Law::Proportional(_) => "proportional law",
                };
                match host.output {
                    Output::Velocity => (format!("the host, {law} by velocity"), "rad/s"),
                    Output::Torque => (format!("the host, {law} by torque"), "N·m"),
                    Output::Duty => (format!("the host, {law} by pulse width"), "of the pulse width"),
                }
            }
        };
        let open = kind == Response::Open;
        let margin: Option<Margin> = margin(points).filter(|_| open);
        let bandwidth = bandwidth(points).filter(|_| !open);
        let peak = points.iter().map(|it| it.magnitude).fold(0.0, f64::max);
        let middle = margin.map(|it| it.crossover).or(bandwidth);
        let judged = points.iter().filter(|it| middle.is_none_or(|middle| (it.frequency / middle).log2().abs() <= 0.5));
        let most = |most: f64, value: &f64| most.max(value.abs());
        Self {
            axis,
            bench,
            closed_by,
            open_loop: open,
            amplitude: run.excitation.iter().fold(0.0, most),
            unit,
            velocity: run.velocity,
            crossover_hz: margin.map(|it| it.crossover),
            phase_margin_deg: margin.map(|it| it.phase.to_degrees()),
            bandwidth_hz: bandwidth,
            peak_db: (!open).then(|| 20.0 * peak.log10()),
            coherence: judged.map(|it| it.coherence).fold(1.0, f64::min),
            points: points
                .iter()
                .map(|point| PointReport {
                    frequency_hz: point.frequency,
                    magnitude: point.magnitude,
                    phase_deg: point.phase.to_degrees(),
                    coherence: point.coherence,
                })
                .collect(),
        }
    }

    /// The frequency response in CSV.
    pub(crate) fn csv(&self) -> String {
        let head = "frequency_hz,magnitude,phase_deg,coherence\n".to_owned();
        let row =
            |it: &PointReport| format!("{},{},{},{}\n", it.frequency_hz, it.magnitude, it.phase_deg, it.coherence);
        head + &self.points.iter().map(row).collect::<String>()
    }

    /// Summary of the conditions.
    pub(crate) fn setting(&self) -> String {
        format!(
            "{} bench, loop closed by {}, excited by {:.4} {} at {:.0} rad/s of the motor",
            self.bench, self.closed_by, self.amplitude, self.unit, self.velocity
        )
    }

    /// Assessment of the quality of the measurement.
    pub(crate) fn verdict(&self) -> String {
        let peak = self.peak_db.unwrap_or_default();
        match (self.crossover_hz, self.phase_margin_deg, self.bandwidth_hz) {
            (Some(crossover), Some(margin), _) => {
                format!("crossover {crossover:.1} Hz, phase margin {margin:.1}°")
            }
            (.., Some(bandwidth)) => {
                format!("3 dB less at {bandwidth:.1} Hz, {peak:.1} dB more at most")
            }
            _ if self.open_loop => "no crossover between these frequencies".into(),
            _ => format!("less than 3 dB lost at these frequencies, {peak:.1} dB more at most"),
        }
    }
}

impl fmt::Display for IdentifyReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.axis, self.setting())?;
        let what = if self.open_loop { "open loop" } else { "from command to sample" };
        write!(f, "{what}: {}; coherence {:.3} or more around there", self.verdict(), self.coherence)?;
        if self.coherence < SURE {
            write!(
                f,
                "\nrough, below a coherence of {SURE}: more --periods make the figures surer, another --velocity or more \
                 --amplitude the coherence"
            )?;
        }
        Ok(())
    }
}
