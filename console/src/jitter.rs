//! `mrroc jitter`: how punctual a thread is on this host that waits for deadlines as the servo's does.
//!
//! It measures the error of the wake-up, from a deadline to when the thread was there, with the servo's own wait and
//! without a servo. The peer, cyclictest or a probe with its algorithm, takes turns with it within the run, so that
//! both see the same host; what keeps CPUs from deep idle states is held for both, or for neither where it is denied.

mod cyclictest;
mod load;
mod probe;
mod report;

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{anyhow, bail};
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use serde::Serialize;
use servo::thread::{CpuLatency, Denial, Realtime, RealtimePolicy};

use load::Load;
use probe::Wakeups;
use report::{Report, Setting, Side};

/// Shortest and longest period.
const PERIODS: [Duration; 2] = [Duration::from_micros(50), Duration::from_secs(1)];

/// Longest time to measure.
const LONGEST: Duration = Duration::from_secs(7 * 24 * 3600);

/// Turns of each side.
const ROUNDS: u32 = 10;

/// A turn is no shorter, if the time to measure is not, and no longer: cyclictest takes some time to start.
const TURN: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];

/// Options of `mrroc jitter`.
#[derive(Args)]
pub(crate) struct Options {
    /// Time from one deadline to the next, with its unit: 1ms, 250us.
    #[arg(long, default_value = "1ms")]
    period: String,
    /// How long to measure, with its unit: 60s, 10m, 1h; the peer is measured as long.
    #[arg(long, default_value = "60s")]
    duration: String,
    /// Priority under SCHED_FIFO, 1 to 99.
    #[arg(long, default_value_t = 80)]
    priority: u32,
    /// The CPU to stay on.
    #[arg(long)]
    cpu: Option<usize>,
    /// How to wait.
    #[arg(long, value_enum, default_value = "hybrid")]
    wait: Wait,
    /// What loads all CPUs meanwhile; several are separated by commas.
    #[arg(long, value_enum, value_delimiter = ',')]
    load: Vec<load::Kind>,
    /// Who is measured beside it, in turns.
    #[arg(long, value_enum)]
    against: Option<Peer>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// How to wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Wait {
    /// Sleep until the deadline.
    Plain,
    /// Sleep to a learnt margin before the deadline, then spin.
    Hybrid,
}

/// Whom to measure beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Peer {
    /// The one of Debian's package rt-tests.
    Cyclictest,
    /// A thread with its algorithm: an absolute sleep, and one read of the clock.
    Plain,
}

/// What to measure.
struct Plan {
    period: Duration,
    turn: Duration,
    rounds: u32,
    policy: RealtimePolicy,
}

impl Plan {
    fn of(options: &Options) -> anyhow::Result<Self> {
        let period = duration("period", &options.period)?;
        if !(PERIODS[0]..=PERIODS[1]).contains(&period) {
            bail!(
                "--period is {}, must be between 50us and 1s",
                options.period
            );
        }
        if !period.as_nanos().is_multiple_of(1000) {
            bail!("--period is {}, must be whole microseconds", options.period);
        }
        let time = duration("duration", &options.duration)?;
        if !(10 * period..=LONGEST).contains(&time) {
            bail!(
                "--duration is {}, must be between ten periods and a week",
                options.duration
            );
        }
        let priority = u8::try_from(options.priority)
            .ok()
            .filter(|priority| (1..=99).contains(priority))
            .ok_or_else(|| {
                anyhow!(
                    "--priority is {}, must be between 1 and 99",
                    options.priority
                )
            })?;
        let turn = (time / ROUNDS).clamp(TURN[0].min(time), TURN[1]);
        Ok(Self {
            period,
            turn,
            rounds: time.div_duration_f64(turn).ceil() as u32,
            policy: RealtimePolicy {
                realtime: Realtime::BestEffort,
                priority,
                cpu: options.cpu,
                ..RealtimePolicy::BEST_EFFORT
            },
        })
    }
}

/// Measures and reports.
pub(crate) fn jitter(options: &Options) -> anyhow::Result<ExitCode> {
    let plan = Plan::of(options)?;
    if options.against == Some(Peer::Cyclictest) {
        cyclictest::find()?;
    }
    let ((), mut denied) = probe::on_thread(&plan.policy, || ())?;
    if let Some(cpu) = denied.iter().find(|one| matches!(one, Denial::Cpu { .. })) {
        bail!("{cpu}");
    }
    let _load = Load::start(&options.load)?;
    let latency = CpuLatency::hold();
    let progress = if options.json {
        ProgressBar::hidden()
    } else {
        ProgressBar::new(plan.rounds.into())
    };
    let (mut ours, mut peer) = (Wakeups::new(), Wakeups::new());
    let mut waiter = probe::waiter(options.wait == Wait::Hybrid, plan.period);
    for _ in 0..plan.rounds {
        let turn = || probe::wait(&mut waiter, &mut ours, plan.period, plan.turn);
        denied = probe::on_thread(&plan.policy, turn)?.1;
        match options.against {
            None => {}
            Some(Peer::Plain) => {
                let turn = || probe::probe(&mut peer, plan.period, plan.turn);
                probe::on_thread(&plan.policy, turn)?;
            }
            Some(Peer::Cyclictest) => cyclictest::measure(
                &mut peer.late,
                plan.period,
                plan.turn,
                plan.policy.priority,
                plan.policy.cpu,
            )?,
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    let setting = Setting {
        period_us: crate::report::microseconds(plan.period),
        seconds: (plan.turn * plan.rounds).as_secs_f64(),
        rounds: plan.rounds,
        priority: plan.policy.priority,
        cpu: plan.policy.cpu,
        wait: options.wait,
        load: options.load.clone(),
        against: options.against,
        cpu_latency_held: latency.is_ok(),
        denied: denied.iter().map(ToString::to_string).collect(),
    };
    let report = Report::of(
        setting,
        Side::ours(&ours, &waiter.report()),
        options.against.map(|_| Side::of(&peer.late)),
        &ours,
    );
    crate::run::print(&report, options.json)?;
    Ok(ExitCode::SUCCESS)
}

/// A time with its unit: us, ms, s, m or h.
fn duration(option: &str, text: &str) -> anyhow::Result<Duration> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.');
    let (number, unit) = text.split_at(digits.unwrap_or(text.len()));
    let seconds = match unit {
        "us" | "µs" => Some(1e-6),
        "ms" => Some(1e-3),
        "s" => Some(1.0),
        "m" => Some(60.0),
        "h" => Some(3600.0),
        _ => None,
    };
    number
        .parse::<f64>()
        .ok()
        .zip(seconds)
        .and_then(|(number, seconds)| Duration::try_from_secs_f64(number * seconds).ok())
        .ok_or_else(|| {
            anyhow!("--{option} is {text:?}, must be a number and us, ms, s, m or h, such as 250us")
        })
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        options: Options,
    }

    fn plan(line: &str) -> Result<Plan, String> {
        let words = std::iter::once("jitter").chain(line.split_whitespace());
        let line = Line::try_parse_from(words).map_err(|e| e.to_string())?;
        Plan::of(&line.options).map_err(|e| e.to_string())
    }

    #[test]
    fn times_are_read_with_their_unit() {
        for (text, micros) in [
            ("250us", 250),
            ("1ms", 1000),
            ("0.5ms", 500),
            ("20s", 20_000_000),
            ("2m", 120_000_000),
            ("1h", 3_600_000_000),
        ] {
            assert_eq!(
                duration("period", text).unwrap().as_micros(),
                micros,
                "{text}"
            );
        }
        for text in [
            "", "1", "ms", "1 ms", "-1ms", "1.2.3s", "1d", "9e99s", "nans",
        ] {
            assert!(duration("period", text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn what_cannot_be_measured_is_refused_in_one_line() {
        for (line, needle) in [
            (
                "--period 0ms",
                "--period is 0ms, must be between 50us and 1s",
            ),
            ("--period 1001ms", "--period"),
            ("--period 49us", "--period"),
            ("--period 100.5us", "whole microseconds"),
            ("--duration 0s", "--duration"),
            ("--duration 9ms", "--duration"),
            ("--duration 1000h", "--duration"),
            ("--priority 0", "--priority is 0, must be between 1 and 99"),
            ("--priority 100", "--priority"),
            ("--priority 336", "--priority"),
        ] {
            let refusal = plan(line).err().unwrap_or_default();
            assert!(refusal.contains(needle), "{line}: {refusal:?}");
            assert_eq!(refusal.lines().count(), 1, "{line}: {refusal}");
        }
    }

    #[test]
    fn turns_make_up_the_time() {
        for (duration, rounds, turn) in [
            ("10ms", 1, 10),
            ("3s", 3, 1000),
            ("60s", 10, 6000),
            ("1h", 120, 30_000),
        ] {
            let plan = plan(&format!("--duration {duration}")).unwrap();
            let expected = (rounds, Duration::from_millis(turn));
            assert_eq!((plan.rounds, plan.turn), expected, "{duration}");
        }
    }
}
