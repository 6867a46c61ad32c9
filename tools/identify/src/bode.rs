//! `bode.svg`: magnitude and phase over frequency, crossover and margin marked.

use mrroc::charts::{
    COLOURS, ChartError, Panel, RGBColor, Scale, dashed, dots, label, line, panel, segments, sheet, titled,
};

use super::report::{IdentifyReport, PointReport};

/// Size of the picture, px.
const SIZE: [u32; 2] = [960, 720];

const CURVE: RGBColor = COLOURS[0];
const MARK: RGBColor = COLOURS[1];

/// The chart of a report.
pub(super) fn chart(report: &IdentifyReport) -> Result<String, ChartError> {
    let points = &report.points;
    let first = points.first().map_or(1.0, |it| it.frequency_hz);
    let last = points.last().map_or(10.0, |it| it.frequency_hz);
    let x = Scale::octaves("frequency, Hz", [first, last.max(1.01 * first)]);
    let decibels = |it: &PointReport| 20.0 * it.magnitude.log10();
    let degrees = |it: &PointReport| it.phase_deg;
    let values = points.iter().map(decibels);
    let magnitude = Scale::in_steps("magnitude, dB", values, [-10.0, 10.0], 10.0);
    let least = if report.open_loop { [-180.0, -90.0] } else { [-90.0, 0.0] };
    let phase = Scale::in_steps("phase, degrees", points.iter().map(degrees), least, 45.0);
    let title = format!("{}: {}", report.axis, report.verdict());
    sheet(SIZE, &title, |area| {
        let (_, area) = titled(area, &title, &report.setting())?;
        let parts = area.split_evenly((2, 1));
        let mut upper = panel(&parts[0], "", &x, &magnitude)?;
        let mut lower = panel(&parts[1], "", &x, &phase)?;
        // The margin first: the curve lies on top.
        if let (Some(crossover), Some(margin)) = (report.crossover_hz, report.phase_margin_deg) {
            across(&mut upper, &x, 0.0)?;
            across(&mut lower, &x, -180.0)?;
            upright(&mut upper, &magnitude, crossover)?;
            upright(&mut lower, &phase, crossover)?;
            let reached = (crossover, margin - 180.0);
            segments(&mut lower, MARK, [[(crossover, -180.0), reached]])?;
            let middle = (crossover, margin / 2.0 - 180.0);
            label(&mut lower, MARK, middle, &format!("{margin:.1}°"))?;
            named(&mut upper, &magnitude, crossover, &format!("{crossover:.1} Hz"))?;
        } else if let Some(bandwidth) = report.bandwidth_hz {
            upright(&mut upper, &magnitude, bandwidth)?;
            upright(&mut lower, &phase, bandwidth)?;
            let said = format!("-3 dB at {bandwidth:.1} Hz");
            named(&mut upper, &magnitude, bandwidth, &said)?;
        }
        curve(&mut upper, points, decibels)?;
        curve(&mut lower, points, degrees)
    })
}

/// A curve with its points; hollow ones whose coherence is below 0.9.
fn curve(panel: &mut Panel, points: &[PointReport], value: impl Fn(&PointReport) -> f64) -> Result<(), ChartError> {
    let place = |it: &PointReport| (it.frequency_hz, value(it));
    line(panel, CURVE, points.iter().map(place))?;
    for coherent in [false, true] {
        let points = points.iter().filter(|it| (it.coherence >= 0.9) == coherent);
        dots(panel, CURVE, coherent, points.map(place))?;
    }
    Ok(())
}

/// A dashed line at one value, over all frequencies.
fn across(panel: &mut Panel, x: &Scale, value: f64) -> Result<(), ChartError> {
    dashed(panel, MARK, x.ends.map(|frequency| (frequency, value)))
}

/// A dashed line at one frequency.
fn upright(panel: &mut Panel, y: &Scale, frequency: f64) -> Result<(), ChartError> {
    dashed(panel, MARK, y.ends.map(|value| (frequency, value)))
}

/// A text at the top of a panel.
fn named(panel: &mut Panel, y: &Scale, frequency: f64, said: &str) -> Result<(), ChartError> {
    let [low, high] = y.ends;
    label(panel, MARK, (frequency, high - 0.06 * (high - low)), said)
}
