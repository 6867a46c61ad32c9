//! Elements of a figure in SVG: sheet, texts, lines, arrowheads. Lengths are in px, and y points down.

use std::fmt::Write as _;

/// A point or a direction on the sheet.
pub(super) type Point = [f64; 2];

/// Starts a white sheet of this size; `</svg>` ends it.
pub(super) fn open([width, height]: [f64; 2]) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\" fill=\"#333\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    )
}

/// Adds a text; `anchor` is the SVG attribute text-anchor.
pub(super) fn text(svg: &mut String, [x, y]: Point, anchor: &str, style: &str, said: &str) {
    let said = said.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{said}</text>"
    );
}

/// Adds a straight line.
pub(super) fn line(svg: &mut String, from: Point, to: Point, style: &str) {
    path(svg, &[from, to], style);
}

/// Adds a line through points, or an area if `style` fills it.
pub(super) fn path(svg: &mut String, points: &[Point], style: &str) {
    let mut way = String::new();
    for (number, [x, y]) in points.iter().enumerate() {
        let _ = write!(way, "{}{x:.1} {y:.1}", if number == 0 { 'M' } else { 'L' });
    }
    let _ = writeln!(svg, "<path d=\"{way}\" {style}/>");
}

/// Adds a circle.
pub(super) fn circle(svg: &mut String, [x, y]: Point, radius: f64, style: &str) {
    let _ = writeln!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {style}/>"
    );
}

/// Adds an arrowhead with its tip at `tip`. The arrow points along `direction`, which may have any length.
pub(super) fn arrowhead(svg: &mut String, tip: Point, direction: Point, size: f64, colour: &str) {
    let along = unit(direction);
    let back = |side: f64| {
        [
            tip[0] - size * (along[0] - 0.38 * side * along[1]),
            tip[1] - size * (along[1] + 0.38 * side * along[0]),
        ]
    };
    path(
        svg,
        &[tip, back(1.0), back(-1.0), tip],
        &format!("fill=\"{colour}\""),
    );
}

/// Unit vector; a vector of length zero yields the direction to the right.
pub(super) fn unit([x, y]: Point) -> Point {
    let length = x.hypot(y);
    if length > 0.0 {
        [x / length, y / length]
    } else {
        [1.0, 0.0]
    }
}
