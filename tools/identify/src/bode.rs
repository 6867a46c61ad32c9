//! `bode.svg`: magnitude and phase over frequency, with crossover and phase margin marked.

use std::fmt::Write as _;

use super::report::{PointReport, Report};
use figures::chart::{line, open, text};

/// Size of the chart, px.
const SIZE: [f64; 2] = [960.0, 720.0];

/// Left and right edges of the panels, px.
const ENDS: [f64; 2] = [86.0, 920.0];

/// Top and bottom edges of the panels, px.
const MAGNITUDE: [f64; 2] = [92.0, 370.0];
const PHASE: [f64; 2] = [420.0, 660.0];

const CURVE: &str = "#1666c0";
const MARK: &str = "#d9731a";

/// A panel: its position, its range of values from bottom to top, and the step of its grid.
struct Panel {
    place: [f64; 2],
    range: [f64; 2],
    step: f64,
}

impl Panel {
    /// Panel for all of `values`, in whole steps, with at least the range `least`.
    fn of(place: [f64; 2], values: impl Iterator<Item = f64>, least: [f64; 2], step: f64) -> Self {
        let [low, high] = values
            .filter(|value| value.is_finite())
            .fold(least, |[low, high], value| {
                [low.min(value), high.max(value)]
            });
        Self {
            place,
            range: [(low / step).floor() * step, (high / step).ceil() * step],
            step,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        let share = (value - low) / (high - low);
        self.place[1] + (self.place[0] - self.place[1]) * share.clamp(0.0, 1.0)
    }

    fn grid(&self, svg: &mut String, name: &str) {
        let rows = ((self.range[1] - self.range[0]) / self.step).round() as u32;
        for row in 0..=rows {
            let value = self.range[0] + f64::from(row) * self.step;
            let y = self.at(value);
            line(svg, [ENDS[0], y], [ENDS[1], y]);
            text(
                svg,
                [ENDS[0] - 10.0, y + 4.5],
                "end",
                "",
                &format!("{value:.0}"),
            );
        }
        let (x, y) = (24.0, (self.place[0] + self.place[1]) / 2.0);
        let turned = format!("fill=\"#666\" transform=\"rotate(-90 {x} {y})\"");
        text(svg, [x, y], "middle", &turned, name);
    }
}

/// The chart of a report.
pub(super) fn chart(report: &Report) -> String {
    let points = &report.points;
    let first = points.first().map_or(1.0, |it| it.frequency_hz);
    let last = points
        .last()
        .map_or(10.0, |it| it.frequency_hz)
        .max(1.01 * first);
    let x = |frequency: f64| {
        let share = (frequency / first).ln() / (last / first).ln();
        ENDS[0] + (ENDS[1] - ENDS[0]) * share
    };
    let decibels = |it: &PointReport| 20.0 * it.magnitude.log10();
    let magnitude = Panel::of(MAGNITUDE, points.iter().map(decibels), [-10.0, 10.0], 10.0);
    let least = if report.open_loop {
        [-180.0, -90.0]
    } else {
        [-90.0, 0.0]
    };
    let phase = Panel::of(PHASE, points.iter().map(|it| it.phase_deg), least, 45.0);

    let title = format!("{}: {}", report.axis, report.verdict());
    let mut svg = open(SIZE, ENDS[0], &title, &report.setting());
    for (frequency, label) in ticks([first, last]) {
        for place in [MAGNITUDE, PHASE] {
            line(&mut svg, [x(frequency), place[0]], [x(frequency), place[1]]);
        }
        text(
            &mut svg,
            [x(frequency), PHASE[1] + 19.0],
            "middle",
            "",
            &label,
        );
    }
    let middle = (ENDS[0] + ENDS[1]) / 2.0;
    let grey = "fill=\"#666\"";
    text(
        &mut svg,
        [middle, PHASE[1] + 42.0],
        "middle",
        grey,
        "frequency, Hz",
    );
    magnitude.grid(&mut svg, "magnitude, dB");
    phase.grid(&mut svg, "phase, degrees");

    // A label that would leave the chart is placed on the other side.
    let beside = |at: f64| match at > ENDS[1] - 120.0 {
        true => (at - 8.0, "end"),
        false => (at + 8.0, "start"),
    };
    // The margin is drawn first, so that the curve covers it.
    if let (Some(crossover), Some(margin)) = (report.crossover_hz, report.phase_margin_deg) {
        let at = x(crossover);
        let half = phase.at(-180.0);
        dashed(
            &mut svg,
            [ENDS[0], magnitude.at(0.0)],
            [ENDS[1], magnitude.at(0.0)],
        );
        dashed(&mut svg, [at, MAGNITUDE[0]], [at, phase.at(margin - 180.0)]);
        dashed(&mut svg, [ENDS[0], half], [ENDS[1], half]);
        let _ = writeln!(
            svg,
            "<path d=\"M{at:.1} {half:.1}V{:.1}\" stroke=\"{MARK}\" stroke-width=\"4\"/>",
            phase.at(margin - 180.0)
        );
        let style = format!("fill=\"{MARK}\"");
        let (x, anchor) = beside(at);
        let y = (half + phase.at(margin - 180.0)) / 2.0 + 4.5;
        text(&mut svg, [x, y], anchor, &style, &format!("{margin:.1}°"));
        text(
            &mut svg,
            [x, MAGNITUDE[0] + 16.0],
            anchor,
            &style,
            &format!("{crossover:.1} Hz"),
        );
    } else if let Some(bandwidth) = report.bandwidth_hz {
        let at = x(bandwidth);
        dashed(&mut svg, [at, MAGNITUDE[0]], [at, PHASE[1]]);
        let style = format!("fill=\"{MARK}\"");
        let (x, anchor) = beside(at);
        text(
            &mut svg,
            [x, MAGNITUDE[0] + 16.0],
            anchor,
            &style,
            &format!("-3 dB at {bandwidth:.1} Hz"),
        );
    }
    curve(&mut svg, points, |it| {
        [x(it.frequency_hz), magnitude.at(decibels(it))]
    });
    curve(&mut svg, points, |it| {
        [x(it.frequency_hz), phase.at(it.phase_deg)]
    });
    svg + "</svg>\n"
}

/// A curve and its points. Points with a coherence below 0.9 are hollow.
fn curve(svg: &mut String, points: &[PointReport], place: impl Fn(&PointReport) -> [f64; 2]) {
    let mut all = String::new();
    for [x, y] in points.iter().map(&place) {
        let _ = write!(all, "{x:.1},{y:.1} ");
    }
    let _ = writeln!(
        svg,
        "<polyline points=\"{all}\" fill=\"none\" stroke=\"{CURVE}\" stroke-width=\"2\" stroke-linejoin=\"round\"/>"
    );
    for point in points {
        let [x, y] = place(point);
        let fill = if point.coherence < 0.9 { "#fff" } else { CURVE };
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{fill}\" stroke=\"{CURVE}\"/>"
        );
    }
}

fn dashed(svg: &mut String, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
    let _ = writeln!(
        svg,
        "<path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\" stroke=\"{MARK}\" stroke-width=\"1.5\" stroke-dasharray=\"5 4\"/>"
    );
}

/// The numbers 1, 2 and 5 times powers of ten within a range.
fn ticks([first, last]: [f64; 2]) -> impl Iterator<Item = (f64, String)> {
    let decades = first.log10().floor() as i32..=last.log10().ceil() as i32;
    let ticks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|it| it * 10f64.powi(decade)));
    ticks
        .filter(move |it| (first..=last).contains(it))
        .map(|it| (it, it.to_string()))
}
