//! cyclictest of Debian's package rt-tests as the peer: runs the program for a time and reads its histogram.

use std::io;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::clock::{now, sleep_until};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::interval::{Interval, Latencies};
use super::load;
use super::probe::Turn;

/// Number of bins of its histogram, 1 µs each. A larger latency is counted as the maximum.
const BINS: u32 = 20_000;

/// Time that cyclictest has to start and to print its result.
const OVERHEAD: Duration = Duration::from_secs(20);

/// Time between two checks whether cyclictest has ended.
const POLL: Duration = Duration::from_millis(20);

/// Refuses the measurement if cyclictest is not installed.
pub(super) fn find() -> anyhow::Result<()> {
    load::find("cyclictest", "rt-tests", ", --against plain does without")
}

/// Runs cyclictest for one turn and returns its histogram. cyclictest is told not to hold /dev/cpu_dma_latency.
pub(super) fn measure(turn: Turn, priority: u8, cpu: Option<usize>) -> anyhow::Result<Interval> {
    let mut command = Command::new("cyclictest");
    command
        .args(["--mlockall", "--quiet", "--threads=1", "--policy=fifo"])
        .arg("--default-system")
        .arg(format!("--priority={priority}"))
        .arg(format!("--interval={}", turn.period.as_micros()))
        .arg(format!("--loops={}", turn.time.as_nanos() / turn.period.as_nanos()))
        .arg(format!("--histogram={BINS}"))
        .args(cpu.map(|cpu| format!("--affinity={cpu}")));
    let begun = now();
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cyclictest cannot be run")?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    let end = begun + turn.time * 2 + OVERHEAD;
    let mut told = false;
    std::thread::scope(|scope| {
        let out = scope.spawn(move || out.map(io::read_to_string));
        let err = scope.spawn(move || err.map(io::read_to_string));
        let status = loop {
            if let Some(status) = child.try_wait().context("cyclictest cannot be waited for")? {
                break Some(status);
            }
            if turn.is_over() && !told {
                told = true;
                // Makes cyclictest print its result. It may have ended already, since Ctrl-C on a terminal reaches it
                // as well.
                let _ = kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT);
            }
            if now() >= end {
                child.kill().context("cyclictest cannot be ended")?;
                break None;
            }
            sleep_until(now() + POLL);
        };
        // Output that is not text is refused below.
        let [out, err] = [out, err].map(|thread| {
            let text = thread.join().ok().flatten();
            text.and_then(Result::ok).unwrap_or_default()
        });
        match status {
            None => bail!("cyclictest did not end in time"),
            Some(status) if !status.success() => {
                let said = err.lines().chain(out.lines()).find(|line| !line.is_empty());
                bail!("cyclictest failed ({status}): {}", said.unwrap_or(""))
            }
            Some(_) => {
                let late = parse(&out).ok_or_else(|| anyhow!("cyclictest printed no histogram that can be read"))?;
                Ok(Interval { begun, ended: now(), late })
            }
        }
    })
}

/// Histogram of one thread in `text`: lines with bin, µs, and count, followed by totals after `#`.
fn parse(text: &str) -> Option<Latencies> {
    let mut late = Latencies::empty();
    let total = |name: &str| -> Option<u64> {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().parse().ok()
    };
    let overflows = total("# Histogram Overflows:")?;
    let max = total("# Max Latencies:")?;
    let mut counted = 0;
    let bins = text.lines().filter(|line| line.starts_with(|first: char| first.is_ascii_digit()));
    for line in bins {
        let (bin, count) = line.split_once(char::is_whitespace)?;
        let (bin, count): (u64, u64) = (bin.parse().ok()?, count.trim().parse().ok()?);
        if count > 0 {
            // Recording a value zero times would still raise the maximum.
            late.record(1000 * bin, count);
        }
        counted += count;
    }
    if overflows > 0 {
        late.record(1000 * max, overflows);
    }
    (counted == total("# Total:")?).then_some(late)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Part of the output of cyclictest 2.40 for `-m -q -t1 -p80 -i1000 -l 8 -h 4`.
    const PRINTED: &str = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000000 000000\n000001 000002\n\
        000002 000000\n000003 000003\n# Total: 000000005\n# Min Latencies: 00001\n# Avg Latencies: 00035\n\
        # Max Latencies: 01471\n# Histogram Overflows: 00003\n# Histogram Overflow at cycle number:\n\
        # Thread 0: 00004 00006 00007\n";

    #[test]
    fn its_histogram_is_read_with_what_overflowed_as_the_maximum() {
        let late = parse(PRINTED).unwrap();
        assert_eq!(late.len(), 8);
        assert_eq!(late.counts.value_at_quantile(0.2) / 1000, 1);
        assert_eq!(late.counts.value_at_quantile(0.6) / 1000, 3);
        assert_eq!(late.max() / 10_000, 147);
    }

    #[test]
    fn bins_of_nothing_are_not_its_latest() {
        let text = PRINTED.replace("000003 000003", "000002 000003\n019999 000000");
        let text = text.replace("Overflows: 00003", "Overflows: 00000");
        assert_eq!(parse(&text).unwrap().max() / 1000, 2);
    }

    #[test]
    fn what_is_not_its_histogram_is_refused() {
        for (good, bad) in [
            ("000003 000003", "000003 000002"),
            ("000003 000003", "000003"),
            ("000003 000003", "000003 x"),
            ("# Max Latencies", "# Max"),
            ("# Histogram Overflows", "# Overflows"),
            ("# Total: 000000005\n", ""),
        ] {
            let text = PRINTED.replacen(good, bad, 1);
            assert!(parse(&text).is_none(), "{bad}");
        }
    }
}
