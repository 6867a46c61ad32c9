//! Output files of a measurement, in the formats of the HdrHistogram tools.
//!
//! `ours.hgrm` and `peer.hgrm` are percentile distributions, recorded in ns and printed in µs; `ours.hlog` is an
//! interval log, format 1.3, in ns; `jitter.svg` shows both sides.

use std::fs::File;
use std::io::{self, LineWriter, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context;
use can::Instant;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriter, IntervalLogWriterBuilder, IntervalLogWriterError};

use super::interval::{Interval, Latencies};
use mrroc::outputs::Outputs;

/// Recorded unit, ns, per printed unit, µs.
const NANOS_PER_MICRO: f64 = 1e3;

/// Lines of a percentile distribution per halving of the distance to 100 %.
const TICKS: u32 = 5;

/// Output files, opened before the measurement.
pub(super) struct Files {
    directory: PathBuf,
    pub ours: File,
    pub peer: Option<File>,
    pub chart: File,
}

impl Files {
    /// Opens the files in `directory`, and creates the directory if necessary. Returns the interval log separately.
    pub(super) fn open(
        outputs: &mut Outputs,
        directory: &Path,
        peer: bool,
    ) -> anyhow::Result<(Self, LineWriter<File>)> {
        let mut create = |name| outputs.open_in("--out", directory, name);
        let files = Self {
            directory: directory.to_owned(),
            ours: create("ours.hgrm")?,
            peer: peer.then(|| create("peer.hgrm")).transpose()?,
            chart: create("jitter.svg")?,
        };
        Ok((files, LineWriter::new(create("ours.hlog")?)))
    }

    /// Writes the results.
    pub(super) fn write(mut self, ours: &Latencies, peer: &Latencies, chart: &str) -> anyhow::Result<()> {
        let mut write = || {
            percentile_distribution(ours, &mut self.ours)?;
            if let Some(file) = &mut self.peer {
                percentile_distribution(peer, file)?;
            }
            self.chart.write_all(chart.as_bytes())
        };
        write().with_context(|| format!("{} cannot be written", self.directory.display()))
    }
}

/// An interval log, flushed line by line.
pub(super) struct IntervalLog<'a>(IntervalLogWriter<'a, 'a, LineWriter<File>, V2DeflateSerializer>);

impl<'a> IntervalLog<'a> {
    /// Starts the log now.
    pub(super) fn begin(file: &'a mut LineWriter<File>, serializer: &'a mut V2DeflateSerializer) -> io::Result<Self> {
        #[expect(clippy::disallowed_methods, reason = "the log names the day of its zero")]
        let now = SystemTime::now();
        let log = IntervalLogWriterBuilder::new()
            .add_comment("[Histogram log format version 1.3]")
            .add_comment("mrroc jitter: from the deadline to when the thread was there, ns; Interval_Max in µs")
            .with_start_time(now)
            .with_base_time(now)
            .with_max_value_divisor(NANOS_PER_MICRO)
            .begin_log_with(file, serializer)?;
        Ok(Self(log))
    }

    /// Writes one interval. Times are relative to `began`.
    pub(super) fn write(&mut self, interval: &Interval, began: Instant) -> io::Result<()> {
        let (begun, lasted) = (interval.begun.since(began), interval.ended.since(interval.begun));
        let written = self.0.write_histogram(&interval.late.counts, begun, lasted, None);
        written.map_err(|error| match error {
            IntervalLogWriterError::IoError(error) => error,
            IntervalLogWriterError::SerializeError(error) => io::Error::other(error),
        })
    }
}

/// Writes `late` as a percentile distribution in the format of the HdrHistogram tools, in µs.
fn percentile_distribution(late: &Latencies, to: &mut impl Write) -> io::Result<()> {
    let counts = &late.counts;
    let mut text = format!("{:>12} {:>14} {:>10} {:>14}\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
    let mut reached = 0;
    for step in counts.iter_quantiles(TICKS) {
        reached += step.count_since_last_iteration();
        let value = step.value_iterated_to() as f64 / NANOS_PER_MICRO;
        let quantile = step.quantile_iterated_to();
        text += &format!("{value:>12.3} {quantile:>14.12} {reached:>10}");
        if quantile < 1.0 {
            text += &format!(" {:>14.2}", 1.0 / (1.0 - quantile));
        }
        text += "\n";
    }
    text += &format!(
        "#[Mean    = {:>12.3}, StdDeviation   = {:>12.3}]\n\
         #[Max     = {:>12.3}, Total count    = {:>12}]\n\
         #[Buckets = {:>12}, SubBuckets     = {:>12}]\n",
        counts.mean() / NANOS_PER_MICRO,
        counts.stdev() / NANOS_PER_MICRO,
        late.max() as f64 / NANOS_PER_MICRO,
        counts.len(),
        counts.buckets(),
        // Each bucket after the first has only the upper half of the sub-buckets; the first bucket has both halves.
        2 * counts.distinct_values() / (usize::from(counts.buckets()) + 1),
    );
    to.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_percentile_distribution_reads_as_the_tools_print_it() {
        let mut recorded = Latencies::empty();
        (1..=1000).for_each(|micros| recorded.record(micros * 1000, 1));
        let mut text = Vec::new();
        percentile_distribution(&recorded, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(
            lines[..3],
            [
                "       Value     Percentile TotalCount 1/(1-Percentile)",
                "",
                "       1.000 0.000000000000          1           1.00",
            ]
        );
        assert!(lines.contains(&"     500.223 0.500000000000        500           2.00"), "{text}");
        let last = lines.iter().rposition(|line| !line.starts_with('#')).unwrap();
        assert_eq!(lines[last], "    1000.447 1.000000000000       1000");
        assert_eq!(
            lines[last + 2..],
            [
                "#[Max     =     1000.447, Total count    =         1000]",
                "#[Buckets =           24, SubBuckets     =         2048]",
            ]
        );
    }

    #[test]
    fn nothing_measured_is_an_empty_distribution() {
        let mut text = Vec::new();
        percentile_distribution(&Latencies::empty(), &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains("Total count    =            0]") && !text.contains("NaN"), "{text}");
    }
}
