//! `jitter.svg`: latency by percentile on an axis of nines, and the worst of each interval over time.

use mrroc::charts::{COLOURS, ChartError, RGBColor, Scale, key, line, panel, px, segments, sheet, titled};
use mrroc::report::counted;

use super::interval::{Counts, Ledger};

/// Size of the picture, px.
const SIZE: [u32; 2] = [960, 720];

/// Height of the distribution, px.
const DISTRIBUTION: u32 = 390;

/// Ours is drawn last.
const OURS: RGBColor = COLOURS[0];
const PEER: RGBColor = COLOURS[1];

/// What is earlier is drawn as this late, µs: the clock shows no less.
const EARLIEST: f64 = 0.01;

/// One side of the chart, with its name.
type Curve<'a> = (&'a str, &'a Ledger<'a>);

/// The chart of ours and the peer's; `setting` is said below the title.
pub(super) fn chart(setting: &str, ours: Curve, peer: Option<Curve>) -> Result<String, ChartError> {
    let curves = || {
        let peer = peer.map(|peer| (peer, PEER));
        peer.into_iter().chain([(ours, OURS)])
    };
    let worst = curves().map(|((_, curve), _)| curve.total.max()).max();
    let count = curves().map(|((_, curve), _)| curve.total.len()).max();
    let worst = worst.unwrap_or(0) as f64 / 1e3;
    let late = Scale::decades("late by, µs", [EARLIEST, worst], |decade| 10f64.powi(decade).to_string());
    let count = count.unwrap_or(0) as f64;
    let nines = Scale::decades("percentile of cycles, %", [1.0, count], percent);
    let end = curves().flat_map(|((_, curve), _)| curve.series.times.last().map(|last| last[1]));
    let seconds = end.fold(0.0, f64::max).max(1e-3);
    let time = Scale::exact("time since the beginning, s", [0.0, seconds]);
    let said = |(name, curve): Curve| format!("{name}, {}", counted(curve.total.len(), "cycle"));
    let named: Vec<_> = curves().map(|(curve, colour)| (said(curve), colour)).collect();
    sheet(SIZE, "Wake-up error", |area| {
        let (beside, area) = titled(area, "Wake-up error", setting)?;
        let names = named.iter().rev();
        key(&beside, [0, 22], names.map(|(said, colour)| (said.as_str(), *colour)))?;
        let (upper, lower) = area.split_vertically(px(DISTRIBUTION));
        let mut upper = panel(&upper, "", &nines, &late)?;
        for ((_, curve), colour) in curves() {
            line(&mut upper, colour, distribution(&curve.total.counts))?;
        }
        let mut lower = panel(&lower, "Worst of each interval", &time, &late)?;
        for ((_, curve), colour) in curves() {
            let times = curve.series.times.iter();
            let worst = times.map(|&[from, to, worst]| [(from, worst), (to, worst)]);
            segments(&mut lower, colour, worst)?;
        }
        Ok(())
    })
}

/// The points of a distribution: cycles over those at least as late, and latency, µs; without those that nobody could
/// tell from the point before.
fn distribution(late: &Counts) -> Vec<(f64, f64)> {
    let (total, mut reached) = (late.len() as f64, 0);
    let mut points: Vec<(f64, f64)> = Vec::new();
    for bin in late.iter_recorded() {
        // From the share of cycles before this bin to the share with it, all are as late as it.
        for count in [reached, reached + bin.count_at_value()] {
            let beyond = (total - count as f64).max(1.0);
            let micros = bin.value_iterated_to() as f64 / 1e3;
            let next = (total / beyond, micros.max(EARLIEST));
            let apart = |one: f64, other: f64| (one / other).ln().abs() > 5e-3;
            if (points.last()).is_none_or(|last| apart(next.0, last.0) || apart(next.1, last.1)) {
                points.push(next);
            }
        }
        reached += bin.count_at_value();
    }
    points
}

/// 0, 90, 99, 99.9 and so on.
fn percent(nines: i32) -> String {
    match nines {
        0 => "0".into(),
        1 => "90".into(),
        2 => "99".into(),
        more => format!("99.{}", "9".repeat(more as usize - 2)),
    }
}

#[cfg(test)]
mod tests {
    use can::Instant;

    use super::*;
    use crate::jitter::interval::recording;

    #[test]
    fn a_chart_of_nothing_or_of_one_cycle_has_no_number_that_is_none() {
        let (_, mut ledger) = recording(Instant::ZERO, None);
        for _ in 0..2 {
            let svg = chart("1 ms", ("a & b", &ledger), None).unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains("a &amp; b"), "{svg}");
            ledger.total.record(5, 1);
        }
    }
}
