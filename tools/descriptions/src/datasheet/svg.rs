//! A figure in SVG: sheet, texts, lines, arrowheads. Lengths are in px, and y points down.

use std::f64::consts::FRAC_PI_4;
use std::fmt::Write as _;

use nalgebra::Vector2;

/// A point or a direction on the sheet.
pub(super) type Point = Vector2<f64>;

/// Style of a title.
pub(super) const TITLE: &str = "font-size=\"19\" fill=\"#111\"";
/// Style of a text beside the drawing.
pub(super) const NOTE: &str = "font-size=\"12\" fill=\"#666\"";

/// Style of a line of this colour and width, px.
pub(super) fn stroke(colour: &str, width: f64) -> String {
    format!("stroke=\"{colour}\" stroke-width=\"{width}\"")
}

/// Style of a curve of this colour and width, px, which surrounds no area.
pub(super) fn curve(colour: &str, width: f64) -> String {
    format!("fill=\"none\" {}", stroke(colour, width))
}

/// A figure under construction.
pub(super) struct Svg(String);

impl Svg {
    /// Starts a white sheet of this size.
    pub(super) fn open([width, height]: [f64; 2]) -> Self {
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\" fill=\"#333\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        ))
    }

    /// The finished figure.
    pub(super) fn close(self) -> String {
        self.0 + "</svg>\n"
    }

    /// Adds a text; `anchor` is the SVG attribute text-anchor.
    pub(super) fn text(&mut self, at: impl Into<[f64; 2]>, anchor: &str, style: &str, said: &str) {
        let [x, y] = at.into();
        let said = said.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(self.0, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{said}</text>");
    }

    pub(super) fn line(&mut self, from: impl Into<[f64; 2]>, to: impl Into<[f64; 2]>, style: &str) {
        self.path(&[from.into(), to.into()], style);
    }

    /// Adds a line through points, or an area if `style` fills it.
    pub(super) fn path(&mut self, points: &[impl Copy + Into<[f64; 2]>], style: &str) {
        let _ = writeln!(self.0, "<path d=\"{}\" {style}/>", way(points));
    }

    /// Adds an area inside closed outlines.
    pub(super) fn area(&mut self, outlines: impl Iterator<Item = Vec<Point>>, style: &str) {
        let way: String = outlines.map(|outline| way(&outline) + "Z").collect();
        let _ = writeln!(self.0, "<path d=\"{way}\" {style}/>");
    }

    pub(super) fn polygon(&mut self, corners: [Point; 4], style: &str) {
        let corners = corners.map(|at| format!("{:.1},{:.1} ", at.x, at.y)).concat();
        let _ = writeln!(self.0, "<polygon points=\"{corners}\" {style}/>");
    }

    pub(super) fn circle(&mut self, at: impl Into<[f64; 2]>, radius: f64, style: &str) {
        let [x, y] = at.into();
        let _ = writeln!(self.0, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {style}/>");
    }

    /// Adds an arrowhead with its tip at `tip`. The arrow points along `direction`, which may have any length.
    pub(super) fn arrowhead(&mut self, tip: impl Into<Point>, direction: Point, size: f64, colour: &str) {
        let (tip, along) = (tip.into(), unit(direction));
        let back = |side: f64| tip - (along + across(along) * (0.38 * side)) * size;
        self.path(&[tip, back(1.0), back(-1.0), tip], &format!("fill=\"{colour}\""));
    }
}

fn way(points: &[impl Copy + Into<[f64; 2]>]) -> String {
    let mut way = String::new();
    for (number, &point) in points.iter().enumerate() {
        let [x, y] = point.into();
        let _ = write!(way, "{}{x:.1} {y:.1}", if number == 0 { 'M' } else { 'L' });
    }
    way
}

/// Unit vector; a vector of length zero yields the direction to the right.
pub(super) fn unit(direction: Point) -> Point {
    direction.try_normalize(0.0).unwrap_or_else(Point::x)
}

/// The direction to the right of another.
pub(super) fn across(along: Point) -> Point {
    Point::new(-along.y, along.x)
}

/// Points around another in the directions of these eighths of a turn. `stretch` widens the circle.
pub(super) fn around(at: Point, radius: f64, stretch: f64, eighths: [i32; 8]) -> [Point; 8] {
    eighths.map(|eighth| {
        let (sin, cos) = (FRAC_PI_4 * f64::from(eighth)).sin_cos();
        at + Point::new(stretch * radius * cos, -radius * sin)
    })
}
