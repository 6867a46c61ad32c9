//! Charts in SVG, drawn by plotters: sheets of panels, and linear and logarithmic axes with round ticks.

use std::io;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, KeyPointWeight, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use plotters::style::RGBColor;

/// Units of a drawing in one px: plotters places points on whole units.
pub const UNITS: u32 = 4;

/// Colours of curves, the first one first; each is legible on white and on black.
pub const COLOURS: [RGBColor; 8] = [
    RGBColor(0x16, 0x66, 0xc0),
    RGBColor(0xd9, 0x73, 0x1a),
    RGBColor(0x2e, 0x8b, 0x57),
    RGBColor(0xc2, 0x3b, 0x6b),
    RGBColor(0x7a, 0x5c, 0xc8),
    RGBColor(0x8a, 0x6d, 0x3b),
    RGBColor(0x1a, 0x9b, 0xa8),
    RGBColor(0x80, 0x86, 0x8b),
];

const GRID: RGBColor = RGBColor(0xe3, 0xe6, 0xea);
const FRAME: RGBColor = RGBColor(0x99, 0x99, 0x99);
const INK: RGBColor = RGBColor(0x33, 0x33, 0x33);
const FONT: &str = "Helvetica, Arial, sans-serif";

/// Most ticks of an axis over a wide panel.
const TICKS: usize = 10;

/// Why a chart cannot be drawn.
pub type ChartError = DrawingAreaErrorKind<io::Error>;

/// A part of a sheet.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A panel: two axes, on which series are drawn.
pub type Panel<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;

/// px in units of the drawing.
pub const fn px(length: u32) -> u32 {
    length * UNITS
}

/// A line of a width of 1.5 px.
fn stroke(colour: RGBColor) -> ShapeStyle {
    colour.stroke_width(px(3) / 2)
}

/// The font of texts, of this size, px.
fn font(size: u32) -> TextStyle<'static> {
    (FONT, px(size)).into_font().color(&INK)
}

/// The SVG of a white sheet of this size, px, on which `draw` draws. Screen readers read `title`.
pub fn sheet(
    [width, height]: [u32; 2],
    title: &str,
    draw: impl FnOnce(&Area) -> Result<(), ChartError>,
) -> Result<String, ChartError> {
    let mut drawn = String::new();
    let area = SVGBackend::with_string(&mut drawn, (px(width), px(height))).into_drawing_area();
    area.fill(&WHITE)?;
    draw(&area)?;
    area.present()?;
    drop(area);
    let body = drawn.split_once('>').map_or("", |(_, body)| body);
    let (across, down) = (px(width), px(height));
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {across} {down}\">\n<title>{}</title>{body}",
        escaped(title)
    ))
}

/// A text in which nothing is taken for markup.
pub fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            other => escaped.push(other),
        }
    }
    escaped
}

/// Begins a panel with a grid.
pub fn panel<'a, 'b>(area: &Area<'b>, title: &str, x: &Scale, y: &Scale) -> Result<Panel<'a, 'b>, ChartError> {
    let mut panel = ChartBuilder::on(area)
        .caption(title, font(15))
        .margin(px(8))
        .margin_right(px(20))
        .x_label_area_size(px(42))
        .y_label_area_size(px(62))
        .build_cartesian_2d(x.clone(), y.clone())?;
    let mut mesh = panel.configure_mesh();
    mesh.label_style(font(13)).axis_desc_style(font(13));
    mesh.bold_line_style(GRID.stroke_width(UNITS));
    mesh.light_line_style(TRANSPARENT);
    mesh.axis_style(FRAME.stroke_width(UNITS));
    mesh.set_all_tick_mark_size(px(4));
    mesh.x_desc(&x.name).y_desc(&y.name).draw()?;
    Ok(panel)
}

/// Draws a line through points.
pub fn line(
    panel: &mut Panel,
    colour: RGBColor,
    points: impl IntoIterator<Item = (f64, f64)>,
) -> Result<(), ChartError> {
    panel.draw_series(LineSeries::new(points, stroke(colour))).map(|_| ())
}

/// Draws points, hollow or filled.
pub fn dots(
    panel: &mut Panel,
    colour: RGBColor,
    filled: bool,
    points: impl IntoIterator<Item = (f64, f64)>,
) -> Result<(), ChartError> {
    let fill = if filled { colour } else { WHITE };
    for at in points {
        panel.draw_series([fill.filled(), stroke(colour)].map(|style| Circle::new(at, px(3), style)))?;
    }
    Ok(())
}

/// Draws straight lines of their own, in a width of 3 px.
pub fn segments(
    panel: &mut Panel,
    colour: RGBColor,
    ends: impl IntoIterator<Item = [(f64, f64); 2]>,
) -> Result<(), ChartError> {
    let style = colour.stroke_width(px(3));
    let lines = ends.into_iter().map(|ends| PathElement::new(ends, style));
    panel.draw_series(lines).map(|_| ())
}

/// Draws a dashed straight line.
pub fn dashed(panel: &mut Panel, colour: RGBColor, ends: [(f64, f64); 2]) -> Result<(), ChartError> {
    panel.draw_series(DashedLineSeries::new(ends, px(5), px(4), stroke(colour))).map(|_| ())
}

/// Writes a text beside a point, on the side that has room.
pub fn label(panel: &mut Panel, colour: RGBColor, at: (f64, f64), said: &str) -> Result<(), ChartError> {
    let area = panel.plotting_area();
    let room = area.get_pixel_range().0.end - area.map_coordinate(&at).0;
    let (side, away) = if room > px(120) as i32 { (HPos::Left, 8) } else { (HPos::Right, -8) };
    let style = font(13).color(&colour).pos(Pos::new(side, VPos::Center));
    let text = Text::new(said.to_owned(), (away * px(1) as i32, 0), style);
    let label = EmptyElement::at(at) + text;
    panel.draw_series([label]).map(|_| ())
}

/// Writes a title and what is said below it; returns the part of the sheet beside the title, and the part below.
pub fn titled<'a>(area: &Area<'a>, title: &str, setting: &str) -> Result<(Area<'a>, Area<'a>), ChartError> {
    let (head, rest) = area.split_vertically(px(64));
    let place = |y: u32| (px(62) as i32, px(y) as i32);
    head.draw(&Text::new(title.to_owned(), place(10), font(19)))?;
    head.draw(&Text::new(setting.to_owned(), place(40), font(13)))?;
    let (_, beside) = head.split_horizontally(head.dim_in_pixel().0.saturating_sub(px(220)));
    Ok((beside, rest))
}

/// Draws the names of curves in their colours beside a panel, each `step`, px, from the one before.
pub fn key(
    area: &Area,
    step: [u32; 2],
    curves: impl IntoIterator<Item = (impl Into<String>, RGBColor)>,
) -> Result<(), ChartError> {
    let place = |x: u32, y: u32| (px(x) as i32, px(y) as i32);
    for (number, (name, colour)) in (0..).zip(curves) {
        let [x, y] = step.map(|step| number * step);
        let style = colour.stroke_width(px(3));
        let ends = vec![place(x, y + 14), place(x + 18, y + 14)];
        area.draw(&PathElement::new(ends, style))?;
        let text = font(13).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name.into(), place(x + 24, y + 14), text))?;
    }
    Ok(())
}

/// One axis: its range, its ticks and their labels.
#[derive(Clone, Debug)]
pub struct Scale {
    name: String,
    /// The lowest and the highest value.
    pub ends: [f64; 2],
    logarithmic: bool,
    ticks: Vec<(f64, String)>,
}

impl Scale {
    /// A linear axis over `values` and `least`, widened to whole ticks.
    pub fn linear(name: &str, values: impl IntoIterator<Item = f64>, least: [f64; 2]) -> Self {
        let ends = over(values, least);
        Self::in_steps(name, ends, ends, round_step((ends[1] - ends[0]).max(1e-12)))
    }

    /// A linear axis over `values` and `least` in whole steps.
    pub fn in_steps(name: &str, values: impl IntoIterator<Item = f64>, least: [f64; 2], step: f64) -> Self {
        let [low, high] = over(values, least);
        let range = [(low / step).floor() * step, (high / step).ceil() * step];
        Self::stepped(name, range, step)
    }

    /// A linear axis that ends where `range` does.
    pub fn exact(name: &str, range: [f64; 2]) -> Self {
        Self::stepped(name, range, round_step((range[1] - range[0]).max(1e-12)))
    }

    /// A linear axis with a tick at every multiple of `step`.
    fn stepped(name: &str, range: [f64; 2], step: f64) -> Self {
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let first = (range[0] / step - 1e-9).ceil() as i64;
        let last = (range[1] / step + 1e-9).floor() as i64;
        let tick = |number: i64| {
            let value = number as f64 * step;
            (value, format!("{value:.digits$}"))
        };
        Self { name: name.into(), ends: range, logarithmic: false, ticks: (first..=last).map(tick).collect() }
    }

    /// A logarithmic axis with ticks at 1, 2, 5 and their decades.
    pub fn octaves(name: &str, range: [f64; 2]) -> Self {
        let [low, high] = range.map(f64::log10);
        let decades = low.floor() as i32..=high.ceil() as i32;
        let ticks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|it| it * 10f64.powi(decade)));
        let inside = ticks.filter(|tick| (range[0]..=range[1]).contains(tick));
        Self::logarithmic(name, range, inside.map(|tick| (tick, tick.to_string())))
    }

    /// A logarithmic axis over whole decades, `label` of which is given the exponent.
    pub fn decades(name: &str, range: [f64; 2], label: impl Fn(i32) -> String) -> Self {
        let low = range[0].log10().floor() as i32;
        let high = (range[1].max(range[0]).log10().ceil() as i32).max(low + 1);
        let tick = |decade| (10f64.powi(decade), label(decade));
        let ends = [low, high].map(|decade| 10f64.powi(decade));
        Self::logarithmic(name, ends, (low..=high).map(tick))
    }

    /// A logarithmic axis with these ticks.
    fn logarithmic(name: &str, range: [f64; 2], ticks: impl IntoIterator<Item = (f64, String)>) -> Self {
        Self { name: name.into(), ends: range, logarithmic: true, ticks: ticks.into_iter().collect() }
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    /// A value beyond an end is drawn at the end.
    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let place = |value: f64| {
            if self.logarithmic { value.max(f64::MIN_POSITIVE).log10() } else { value }
        };
        let [low, high] = self.ends.map(place);
        let share = ((place(*value) - low) / (high - low)).clamp(0.0, 1.0);
        first + (f64::from(last - first) * share).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match hint.weight() {
            KeyPointWeight::Bold => self.ticks.iter().map(|tick| tick.0).collect(),
            KeyPointWeight::Any => Vec::new(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.ends[0]..self.ends[1]
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        self.ticks.iter().find(|tick| tick.0 == *value).map_or_else(String::new, |tick| tick.1.clone())
    }
}

/// The range of finite values, at the least `least`.
pub fn over(values: impl IntoIterator<Item = f64>, least: [f64; 2]) -> [f64; 2] {
    let finite = values.into_iter().filter(|value| value.is_finite());
    finite.fold(least, |[low, high], value| [low.min(value), high.max(value)])
}

/// The step, 1, 2 or 5 times a power of ten, that makes at most [`TICKS`] of `span`.
fn round_step(span: f64) -> f64 {
    let decade = 10f64.powf((span / TICKS as f64).log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
    let fits = |step: &f64| span / step <= TICKS as f64 + 1e-9;
    steps.into_iter().find(fits).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_at_most_ten_round_steps() {
        for (end, last, label) in [(0.3, 0.3, "0.30"), (7.0, 7.0, "7"), (61.0, 60.0, "60"), (3600.0, 3500.0, "3500")] {
            let ticks = Scale::exact("", [0.0, end]).ticks;
            assert!((4..=11).contains(&ticks.len()), "{end}: {ticks:?}");
            let (found, said) = ticks.last().unwrap();
            assert!((found - last).abs() < 1e-6, "{end}: {ticks:?}");
            assert_eq!(said, label);
        }
    }

    #[test]
    fn values_beyond_an_axis_are_drawn_at_its_end_and_no_range_is_empty() {
        let linear = Scale::linear("", [], [0.0, 0.0]);
        assert_eq!(linear.map(&1.0, (0, 100)), 100);
        let decades = Scale::decades("", [1.0, 1.0], |decade| decade.to_string());
        assert_eq!(decades.ends, [1.0, 10.0]);
        let places = [0.0, 1.0, 10f64.sqrt(), 10.0, 1e9].map(|it| decades.map(&it, (0, 100)));
        assert_eq!(places, [0, 0, 50, 100, 100]);
    }

    #[test]
    fn texts_of_a_sheet_are_escaped() {
        let x = Scale::exact("<x>", [0.0, 1.0]);
        let drawn = sheet([200, 100], "a & b", |area| {
            let mut panel = panel(area, "\"<b>\"", &x, &x)?;
            line(&mut panel, COLOURS[0], [(0.0, 0.0), (1.0, 1.0)])?;
            key(area, [0, 20], [("<i>", COLOURS[0])])
        });
        let drawn = drawn.unwrap();
        let read = roxmltree::Document::parse(&drawn).unwrap();
        let texts: Vec<_> = read.descendants().filter_map(|node| node.text().map(str::trim)).collect();
        for text in ["a & b", "\"<b>\"", "<x>", "<i>"] {
            assert!(texts.contains(&text), "{text}: {texts:?}");
        }
    }
}
