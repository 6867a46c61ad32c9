//! Plan of a measurement, from the command line and the cell file.

use std::time::Duration;

use anyhow::{anyhow, bail};
use mrroc::cell::Cell;
use servo::thread::{Policy, Realtime, Scheduler, Wait};

use super::Options;

/// Shortest and longest allowed period.
const PERIODS: [Duration; 2] = [Duration::from_micros(50), Duration::from_secs(1)];

/// Period without a cell file.
const USUAL_PERIOD: Duration = Duration::from_millis(1);

/// Unit of the interpolation period of drives. The period of a cell is a multiple.
const INTERPOLATION: Duration = Duration::from_millis(1);

/// Longest duration of a measurement.
const LONGEST: Duration = Duration::from_secs(7 * 24 * 3600);

/// Number of turns of each side.
const ROUNDS: u32 = 10;

/// Shortest and longest turn, since starting cyclictest takes time. A shorter measurement has shorter turns.
const TURN: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];

/// Longest warm-up of each side: several times the time in which the margin is learnt.
const WARM_UP: Duration = Duration::from_secs(1);

/// Plan of a measurement.
pub(super) struct Plan {
    pub(super) period: Duration,
    /// Duration of a turn of each side.
    pub(super) turn: Duration,
    pub(super) rounds: u32,
    /// Duration of the first turn of each side, which is not counted.
    pub(super) warm_up: Duration,
    pub(super) realtime: Realtime,
}

impl Plan {
    /// The values of the options. Defaults come from the cell file, if given.
    pub(super) fn of(options: &Options, cell: Option<&Cell>) -> anyhow::Result<Self> {
        if cell.is_none() && options.bench.is_some() {
            bail!("--bench needs --cell");
        }
        let period = match (&options.period, cell) {
            (Some(text), cell) => period(text, cell.is_some())?,
            (None, Some(cell)) => cell.period(),
            (None, None) => USUAL_PERIOD,
        };
        let time = duration("duration", &options.duration)?;
        if !(10 * period..=LONGEST).contains(&time) {
            bail!("--duration is {}, must be between ten periods and a week", options.duration);
        }
        let usual = cell.map_or_else(Realtime::default, |cell| cell.realtime);
        let given = options.priority.unwrap_or(usual.priority.into());
        let priority = u8::try_from(given)
            .ok()
            .filter(|priority| (1..=99).contains(priority))
            .ok_or_else(|| anyhow!("--priority is {}, must be between 1 and 99", given))?;
        let scheduler = options.scheduler.unwrap_or(usual.scheduler);
        let cpu = options.cpu.or(usual.cpu);
        if let (Scheduler::Deadline, Some(cpu)) = (scheduler, cpu) {
            bail!(
                "CPU {cpu} cannot be had with --scheduler deadline, which the kernel grants only to a thread that may \
                 run on all CPUs"
            );
        }
        let turn = (time / ROUNDS).clamp(TURN[0].min(time), TURN[1]);
        Ok(Self {
            period,
            warm_up: turn.min(WARM_UP),
            turn,
            rounds: time.div_duration_f64(turn).ceil() as u32,
            realtime: Realtime {
                policy: Policy::BestEffort,
                scheduler,
                priority,
                cpu,
                // Both sides alike.
                lock_memory: true,
                ..waiting(options, usual, period)?
            },
        })
    }
}

/// How to wait: as `usual` but for what the options say, within what a cell may say.
fn waiting(options: &Options, usual: Realtime, period: Duration) -> anyhow::Result<Realtime> {
    let wait = options.wait.unwrap_or(usual.wait);
    if wait == Wait::Plain {
        if options.margin.is_some() || options.spin_share.is_some() {
            bail!("--margin and --spin-share need --wait hybrid");
        }
        return Ok(Realtime { wait, ..usual });
    }
    let given = options.margin.as_deref();
    let given = given.map(|text| duration("margin", text)).transpose()?;
    let realtime =
        Realtime { wait, margin: given.or(usual.margin), spin_share: options.spin_share.or(usual.spin_share), ..usual };
    let spin_share = realtime.spin_share();
    if !(0.0..=0.5).contains(&spin_share) {
        bail!("--spin-share is {spin_share}, must be between 0 and 0.5 (of a core)");
    }
    let longest = period.mul_f64(spin_share);
    if let Some(margin) = realtime.margin.filter(|&margin| margin > longest) {
        bail!("--margin is {margin:?}, must be at most the share of the period to spin in, {longest:?}");
    }
    Ok(realtime)
}

fn period(text: &str, of_cell: bool) -> anyhow::Result<Duration> {
    let period = duration("period", text)?;
    if !(PERIODS[0]..=PERIODS[1]).contains(&period) {
        bail!("--period is {text}, must be between 50us and 1s");
    }
    if !period.as_nanos().is_multiple_of(1000) {
        bail!("--period is {text}, must be whole microseconds");
    }
    if of_cell && !period.as_nanos().is_multiple_of(INTERPOLATION.as_nanos()) {
        bail!(
            "--period is {text}, must be a multiple of 1ms, the drives' unit of the interpolation period, with --cell"
        );
    }
    Ok(period)
}

/// Parses a time with its unit: us, ms, s, m or h.
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
        .ok_or_else(|| anyhow!("--{option} is {text:?}, must be a number and us, ms, s, m or h, such as 250us"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct CommandLine {
        #[command(flatten)]
        options: Options,
    }

    fn plan(line: &str) -> Result<Plan, String> {
        let words = std::iter::once("jitter").chain(line.split_whitespace());
        let line = CommandLine::try_parse_from(words).map_err(|e| e.to_string())?;
        Plan::of(&line.options, None).map_err(|e| e.to_string())
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
            assert_eq!(duration("period", text).unwrap().as_micros(), micros, "{text}");
        }
        for text in ["", "1", "ms", "1 ms", "-1ms", "1.2.3s", "1d", "9e99s", "nans"] {
            assert!(duration("period", text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn what_cannot_be_measured_is_refused_in_one_line() {
        for (line, needle) in [
            ("--period 0ms", "--period is 0ms, must be between 50us and 1s"),
            ("--period 1001ms", "--period"),
            ("--period 49us", "--period"),
            ("--period 100.5us", "whole microseconds"),
            ("--duration 0s", "--duration"),
            ("--duration 9ms", "--duration"),
            ("--duration 1000h", "--duration"),
            ("--priority 0", "--priority is 0, must be between 1 and 99"),
            ("--priority 100", "--priority"),
            ("--priority 336", "--priority"),
            ("--scheduler deadline --cpu 1", "CPU 1 cannot be had with --scheduler deadline"),
            ("--spin-share 0.6", "--spin-share is 0.6, must be between 0 and 0.5"),
            ("--spin-share nan", "--spin-share"),
            ("--margin 201us", "--margin is 201µs, must be at most the share of the period to spin in, 200µs"),
            ("--margin 200", "--margin is \"200\", must be a number"),
            ("--wait plain --margin 9us", "need --wait hybrid"),
            ("--wait plain --spin-share 0.1", "need --wait hybrid"),
        ] {
            let refusal = plan(line).err().unwrap_or_default();
            assert!(refusal.contains(needle), "{line}: {refusal:?}");
            assert_eq!(refusal.lines().count(), 1, "{line}: {refusal}");
        }
    }

    #[test]
    fn the_thread_is_scheduled_and_waits_as_the_options_say() {
        let usual = Realtime::default();
        let deadline = Realtime { scheduler: Scheduler::Deadline, ..usual };
        for (line, realtime) in [
            ("", usual),
            ("--scheduler fifo --wait plain", Realtime::PLAIN),
            ("--scheduler deadline", deadline),
            (
                "--scheduler deadline --period 2ms --margin 800us --spin-share 0.4",
                Realtime { margin: Some(Duration::from_micros(800)), spin_share: Some(0.4), ..deadline },
            ),
            ("--wait hybrid --spin-share 0", Realtime { spin_share: Some(0.0), ..usual }),
        ] {
            assert_eq!(plan(line).unwrap().realtime, realtime, "{line}");
        }
    }

    #[test]
    fn turns_make_up_the_time() {
        for (duration, rounds, turn) in [("10ms", 1, 10), ("3s", 3, 1000), ("60s", 10, 6000), ("1h", 120, 30_000)] {
            let plan = plan(&format!("--duration {duration}")).unwrap();
            let expected = (rounds, Duration::from_millis(turn));
            assert_eq!((plan.rounds, plan.turn), expected, "{duration}");
        }
    }
}
