//! `jitter.svg`: latency over percentile on an axis of nines, and the maximum of each interval over time.

use std::fmt::Write as _;

use super::interval::{Counts, Ledger, Series};
use figures::chart::{line, open, text};

/// Size of the chart, px.
const WIDTH: f64 = 960.0;
const HEIGHT: f64 = 720.0;

/// Left and right edges of the panels, px.
const LEFT: f64 = 86.0;
const RIGHT: f64 = 920.0;

/// Top and bottom edges of the panels, px.
const DISTRIBUTION: [f64; 2] = [92.0, 400.0];
const TIME: [f64; 2] = [490.0, 660.0];

/// Colour of our curve, which is drawn last.
const OURS: &str = "#1666c0";
const PEER: &str = "#d9731a";

/// Smallest latency on the chart, µs. Smaller values are drawn here, because the clock does not resolve them.
const EARLIEST: f64 = 0.01;

/// Curve of one side.
pub(super) struct Curve<'a> {
    pub name: &'a str,
    pub late: &'a Counts,
    pub series: &'a Series,
}

impl<'a> Curve<'a> {
    pub(super) fn of(name: &'a str, ledger: &'a Ledger) -> Self {
        Self {
            name,
            late: &ledger.total,
            series: &ledger.series,
        }
    }
}

/// Chart of our measurement and of the peer. `setting` is the text below the title.
pub(super) fn chart(setting: &str, ours: &Curve, peer: Option<&Curve>) -> String {
    let curves = || {
        peer.map(|peer| (peer, PEER))
            .into_iter()
            .chain([(ours, OURS)])
    };
    let worst = curves().map(|(curve, _)| curve.late.max()).max();
    let count = curves().map(|(curve, _)| curve.late.len()).max();
    let latency = Logarithmic::of(EARLIEST, worst.unwrap_or(0) as f64 / 1e3);
    let nines = Logarithmic::of(1.0, count.unwrap_or(0) as f64);
    let end = curves().flat_map(|(curve, _)| curve.series.times.last().map(|last| last[1]));
    let seconds = end.fold(0.0, f64::max).max(1e-3);

    let mut svg = open([WIDTH, HEIGHT], LEFT, "Wake-up error", setting);
    legend(
        &mut svg,
        [(ours, OURS)]
            .into_iter()
            .chain(peer.map(|peer| (peer, PEER))),
    );

    latencies(&mut svg, &latency, DISTRIBUTION);
    for decade in 0..=nines.decades() {
        let x = nines.at(10f64.powi(decade), [LEFT, RIGHT]);
        line(&mut svg, [x, DISTRIBUTION[0]], [x, DISTRIBUTION[1]]);
        let label = percent(decade);
        text(&mut svg, [x, DISTRIBUTION[1] + 19.0], "middle", "", &label);
    }
    let middle = (LEFT + RIGHT) / 2.0;
    text(
        &mut svg,
        [middle, DISTRIBUTION[1] + 40.0],
        "middle",
        "fill=\"#666\"",
        "percentile of cycles, %",
    );
    for (curve, colour) in curves() {
        let points = distribution(curve.late, &nines, &latency);
        let _ = writeln!(
            svg,
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" \
             stroke-linejoin=\"round\"/>"
        );
    }

    latencies(&mut svg, &latency, TIME);
    for (second, label) in seconds_ticks(seconds) {
        let x = LEFT + (RIGHT - LEFT) * second / seconds;
        line(&mut svg, [x, TIME[0]], [x, TIME[1]]);
        text(&mut svg, [x, TIME[1] + 19.0], "middle", "", &label);
    }
    text(
        &mut svg,
        [LEFT, TIME[0] - 12.0],
        "start",
        "fill=\"#666\"",
        "worst of each interval",
    );
    text(
        &mut svg,
        [middle, TIME[1] + 42.0],
        "middle",
        "fill=\"#666\"",
        "time since the beginning, s",
    );
    for (curve, colour) in curves() {
        let mut path = String::new();
        for &[from, to, worst] in &curve.series.times {
            let [from, to] = [from, to].map(|second| LEFT + (RIGHT - LEFT) * second / seconds);
            let y = latency.at(worst, [TIME[1], TIME[0]]);
            let _ = write!(path, "M{from:.1} {y:.1}H{:.1}", to.max(from + 0.1));
        }
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"4\" stroke-linecap=\"round\"/>"
        );
    }
    svg + "</svg>\n"
}

/// A logarithmic axis over whole decades.
struct Logarithmic {
    low: i32,
    high: i32,
}

impl Logarithmic {
    fn of(least: f64, greatest: f64) -> Self {
        let low = least.log10().floor() as i32;
        let high = greatest.max(least).log10().ceil() as i32;
        Self {
            low,
            high: high.max(low + 1),
        }
    }

    fn decades(&self) -> i32 {
        self.high - self.low
    }

    /// Position of a value between the `ends` of the axis, px.
    fn at(&self, value: f64, ends: [f64; 2]) -> f64 {
        let low = f64::from(self.low);
        let share = (value.max(10f64.powi(self.low)).log10() - low) / f64::from(self.decades());
        ends[0] + (ends[1] - ends[0]) * share.min(1.0)
    }
}

/// Points of a distribution. Neighbours are at least half a pixel apart.
fn distribution(late: &Counts, nines: &Logarithmic, latency: &Logarithmic) -> String {
    let (total, mut reached, mut points) = (late.len() as f64, 0, String::new());
    let mut last = [f64::NEG_INFINITY; 2];
    for bin in late.iter_recorded() {
        // A bin is drawn as a horizontal line, from the share of cycles before this bin to the share including this
        // bin.
        for count in [reached, reached + bin.count_at_value()] {
            let beyond = (total - count as f64).max(1.0);
            let x = nines.at(total / beyond, [LEFT, RIGHT]);
            let micros = bin.value_iterated_to() as f64 / 1e3;
            let y = latency.at(micros, [DISTRIBUTION[1], DISTRIBUTION[0]]);
            if (x - last[0]).abs() >= 0.5 || (y - last[1]).abs() >= 0.5 {
                let _ = write!(points, "{x:.1},{y:.1} ");
                last = [x, y];
            }
        }
        reached += bin.count_at_value();
    }
    points
}

/// Latency axis of a panel.
fn latencies(svg: &mut String, latency: &Logarithmic, [top, bottom]: [f64; 2]) {
    let decades = latency.decades();
    for decade in 0..=decades {
        let value = 10f64.powi(latency.low + decade);
        let y = latency.at(value, [bottom, top]);
        line(svg, [LEFT, y], [RIGHT, y]);
        // The lower panel has room for every second label.
        if bottom - top > 20.0 * f64::from(decades) || decade % 2 == decades % 2 {
            text(svg, [LEFT - 10.0, y + 4.5], "end", "", &value.to_string());
        }
    }
    let (x, y) = (24.0, (top + bottom) / 2.0);
    let turned = format!("fill=\"#666\" transform=\"rotate(-90 {x} {y})\"");
    text(svg, [x, y], "middle", &turned, "late by, µs");
}

fn legend<'a>(svg: &mut String, curves: impl Iterator<Item = (&'a Curve<'a>, &'static str)>) {
    for (row, (curve, colour)) in curves.enumerate() {
        let y = 28.0 + 22.0 * row as f64;
        let _ = writeln!(
            svg,
            "<path d=\"M{} {y}h26\" stroke=\"{colour}\" stroke-width=\"4\" stroke-linecap=\"round\"/>",
            RIGHT - 200.0
        );
        let said = format!("{}, {} cycles", curve.name, curve.late.len());
        text(svg, [RIGHT - 164.0, y + 4.5], "start", "", &said);
    }
}

/// Text of a percentile: 0, 90, 99, 99.9 and so on.
fn percent(nines: i32) -> String {
    match nines {
        0 => "0".into(),
        1 => "90".into(),
        2 => "99".into(),
        more => format!("99.{}", "9".repeat(more as usize - 2)),
    }
}

/// Round times on an axis that ends at `end`, s; at most ten.
fn seconds_ticks(end: f64) -> impl Iterator<Item = (f64, String)> {
    let decade = 10f64.powf((end / 10.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
    let step = steps
        .into_iter()
        .find(|step| end / step <= 10.0)
        .unwrap_or(end);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    (0..=(end / step + 1e-9) as u32).map(move |tick| {
        let second = f64::from(tick) * step;
        (second, format!("{second:.digits$}"))
    })
}

#[cfg(test)]
mod tests {
    use can::Instant;

    use super::*;
    use crate::jitter::interval::counts;

    #[test]
    fn times_have_at_most_ten_round_steps() {
        for (end, last, label) in [
            (0.3, 0.3, "0.30"),
            (7.0, 7.0, "7"),
            (61.0, 60.0, "60"),
            (3600.0, 3500.0, "3500"),
        ] {
            let ticks: Vec<_> = seconds_ticks(end).collect();
            assert!((4..=11).contains(&ticks.len()), "{end}: {ticks:?}");
            let (found, said) = ticks.last().unwrap();
            assert!((found - last).abs() < 1e-6, "{end}: {ticks:?}");
            assert_eq!(said, label);
        }
    }

    #[test]
    fn a_chart_of_nothing_or_of_one_cycle_has_no_number_that_is_none() {
        let (mut late, series) = (counts(), Series::new(Instant::ZERO));
        for _ in 0..2 {
            let curve = Curve {
                name: "a & b",
                late: &late,
                series: &series,
            };
            let svg = chart("1 ms", &curve, None);
            assert!(
                !svg.contains("NaN") && !svg.contains("inf") && svg.contains("a &amp; b"),
                "{svg}"
            );
            late.saturating_record(5);
        }
    }
}
