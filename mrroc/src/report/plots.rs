//! Plots of a run: tool path, errors and joints of each robot over time, histograms of the cycle.

use plotters::prelude::*;
use servo::{Histogram, Timing};

use super::curves::{Curve, Path};
use super::tool::{Curves, Subject, Track};
use crate::cell::printable;
use crate::charts::{self, Area, COLOURS, ChartError, Scale, key, line, over, panel, px, sheet};

/// Size of a plot over the whole page, px.
const WIDE: [u32; 2] = [960, 300];

/// Size of the plot of tool path and error, px.
const TOOL: [u32; 2] = [960, 584];

/// Height of the names of the curves above the path, px.
const KEY: u32 = 24;

/// Width of the names of the curves beside joints, px.
const NAMES: u32 = 80;

/// Width of the part with the path, px.
const PATH: u32 = 420;

/// What the axes of a panel take of its width and height, px.
const AXES: [u32; 2] = [90, 80];

const BARS: u32 = 80;

/// The range of no values.
const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

/// The plots of a robot; none without a cycle that counts.
pub(super) fn robot(track: &Track) -> Result<Vec<String>, ChartError> {
    let Some(curves) = track.curves.as_ref().filter(|curves| !curves.commanded.points().is_empty()) else {
        return Ok(Vec::new());
    };
    let name = printable(&track.name);
    let mut drawn = Vec::new();
    if track.subject == Subject::Tool {
        drawn.push(tool(&name, curves)?);
    }
    for (slides, unit) in [(false, "degrees"), (true, "mm")] {
        let joints = curves.joints.iter().zip(&track.linear).enumerate().filter(|(_, (_, linear))| **linear == slides);
        let joints: Vec<_> = joints.map(|(joint, (curves, _))| (joint, curves)).collect();
        if joints.is_empty() {
            continue;
        }
        for (index, what) in ["position", "error"].into_iter().enumerate() {
            let title = format!("{name}: joint {what}, {unit}");
            let curves = joints.iter().map(|(joint, both)| (*joint, &both[index]));
            drawn.push(over_time(&title, unit, &curves.collect::<Vec<_>>())?);
        }
    }
    Ok(drawn)
}

/// Path of the tool from above and from the side, and its errors over time.
fn tool(name: &str, curves: &Curves) -> Result<String, ChartError> {
    let title = format!("{name}: tool path and its error");
    sheet(TOOL, &title, |area| {
        let (left, right) = area.split_horizontally(px(PATH));
        let (names, left) = left.split_vertically(px(KEY));
        let right = right.split_vertically(px(KEY)).1;
        let both = [("commanded", COLOURS[1]), ("measured", COLOURS[0])];
        key(&names.margin(0, 0, px(72), 0), [120, 0], both)?;
        let left = left.split_evenly((2, 1));
        let right = right.split_evenly((2, 1));
        path(&left[0], "Tool path from above", curves, [("x, mm", 0), ("y, mm", 1)])?;
        path(&left[1], "Tool path from the side", curves, [("x, mm", 0), ("z, mm", 2)])?;
        error(&right[0], "Distance from the commanded position", "mm", &curves.position)?;
        error(&right[1], "Angle from the commanded orientation", "degrees", &curves.orientation)
    })
}

/// The path along two directions, to one scale.
fn path(area: &Area, title: &str, curves: &Curves, [across, up]: [(&str, usize); 2]) -> Result<(), ChartError> {
    let (width, height) = area.dim_in_pixel();
    let room = [(width, AXES[0]), (height, AXES[1])];
    let room = room.map(|(size, axes)| f64::from(size) / f64::from(charts::UNITS) - f64::from(axes));
    let paths = [&curves.commanded, &curves.measured];
    let ends = [across, up].map(|(_, direction)| {
        let points = paths.iter().flat_map(|path| path.points());
        over(points.map(|point| point[direction]), NOTHING)
    });
    // mm per px, with some room around; a robot that stands has a path without extent.
    let scales = [0, 1].map(|it| 1.1 * (ends[it][1] - ends[it][0]) / room[it]);
    let scale = scales[0].max(scales[1]).max(0.05);
    let axis = |it: usize, name: &str| {
        let middle = f64::midpoint(ends[it][0], ends[it][1]);
        let half = 0.5 * scale * room[it];
        Scale::exact(name, [middle - half, middle + half])
    };
    let mut panel = panel(area, title, &axis(0, across.0), &axis(1, up.0))?;
    let projected = |path: &Path| {
        let mut drawn: Vec<(f64, f64)> = Vec::new();
        for point in path.points() {
            let next = (point[across.1], point[up.1]);
            // Half a pixel is seen, and less is not.
            let apart = |last: &(f64, f64)| (next.0 - last.0).hypot(next.1 - last.1) > 0.5 * scale;
            if drawn.last().is_none_or(apart) {
                drawn.push(next);
            }
        }
        drawn
    };
    // The measured path lies on the commanded one, which is wider.
    let wide = COLOURS[1].stroke_width(px(5));
    panel.draw_series(LineSeries::new(projected(paths[0]), wide))?;
    line(&mut panel, COLOURS[0], projected(paths[1]))
}

fn error(area: &Area, title: &str, unit: &str, curve: &Curve) -> Result<(), ChartError> {
    let y = Scale::linear(unit, curve.points().map(|point| point.1), [0.0, 1e-6]);
    let mut panel = panel(area, title, &time([curve]), &y)?;
    line(&mut panel, COLOURS[0], curve.points())
}

/// Curves of joints over time.
fn over_time(title: &str, unit: &str, curves: &[(usize, &Curve)]) -> Result<String, ChartError> {
    let values: Vec<_> = curves.iter().flat_map(|(_, curve)| curve.points()).map(|point| point.1).collect();
    let first = values.first().copied().unwrap_or(0.0);
    let y = Scale::linear(unit, values, [first - 1e-6, first + 1e-6]);
    sheet(WIDE, title, |area| {
        let x = time(curves.iter().map(|(_, curve)| *curve));
        let (plot, names) = area.split_horizontally(px(WIDE[0] - NAMES));
        let mut panel = panel(&plot, title, &x, &y)?;
        let names = names.margin(px(24), 0, 0, 0);
        let colour = |joint: usize| COLOURS[joint % COLOURS.len()];
        for (joint, curve) in curves {
            line(&mut panel, colour(*joint), curve.points())?;
        }
        let named = curves.iter().map(|(joint, _)| (format!("joint {joint}"), colour(*joint)));
        key(&names, [0, 20], named)
    })
}

/// The axis of the time in which curves have values.
fn time<'a>(curves: impl IntoIterator<Item = &'a Curve>) -> Scale {
    let [first, last] = over(curves.into_iter().flat_map(Curve::points).map(|(time, _)| time), NOTHING);
    Scale::exact("time since the first cycle, s", [first, last.max(first + 1e-3)])
}

/// The histograms of the cycle that have values.
pub(super) fn timing(timing: &Timing) -> Result<Vec<String>, ChartError> {
    let named = [
        ("Wake-up after the time asked for", &timing.wake_up),
        ("SYNC after its deadline", &timing.sync),
        ("Duration of the step", &timing.step),
        ("Last answer after SYNC", &timing.bus),
    ];
    named.into_iter().filter(|(_, times)| times.count() > 0).map(|(title, times)| histogram(title, times)).collect()
}

/// Counts over classes of equal width on the axis, which is linear for times close to each other and logarithmic
/// otherwise.
fn histogram(title: &str, times: &Histogram) -> Result<String, ChartError> {
    let micros = |time| super::microseconds(time).max(1e-2);
    let bins: Vec<_> = times.bins().map(|(time, count)| (micros(time), count)).collect();
    let first = bins.first().map_or(1.0, |bin| bin.0);
    let last = bins.last().map_or(1.0, |bin| bin.0);
    let wide = last > 5.0 * first;
    let place = |micros: f64| if wide { micros.ln() } else { micros };
    let width = ((place(last) - place(first)) / f64::from(BARS)).max(1e-3);
    let edge = |class: u32| {
        let value = place(first) + width * f64::from(class);
        if wide { value.exp() } else { value }
    };
    let mut counts = [0u64; BARS as usize + 1];
    for (micros, count) in bins {
        let class = ((place(micros) - place(first)) / width) as usize;
        counts[class.min(BARS as usize)] += count;
    }
    let ends = [edge(0), edge(BARS + 1)];
    let x = if wide { Scale::octaves("µs", ends) } else { Scale::exact("µs", ends) };
    let most = counts.iter().max().copied().unwrap_or(1);
    let y = Scale::decades("cycles", [0.5, most as f64], |decade| 10f64.powi(decade).to_string());
    sheet(WIDE, title, |area| {
        let mut panel = panel(area, title, &x, &y)?;
        let bars = (0..).zip(counts).filter(|(_, count)| *count > 0).map(|(class, count)| {
            let corners = [(edge(class), y.ends[0]), (edge(class + 1), count as f64)];
            Rectangle::new(corners, COLOURS[0].filled())
        });
        panel.draw_series(bars)?;
        Ok(())
    })
}
