//! What the charts are drawn of: an SVG file with its title, its words and its grid.

use std::fmt::Write as _;

/// Begins a picture of `size`, px, with its title and what is said below it, both from `left` on.
pub(crate) fn open([width, height]: [f64; 2], left: f64, title: &str, setting: &str) -> String {
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\" fill=\"#333\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    let style = "font-size=\"19\" fill=\"#111\"";
    text(&mut svg, [left, 32.0], "start", style, title);
    text(&mut svg, [left, 54.0], "start", "fill=\"#666\"", setting);
    svg
}

/// Words at a place, px.
pub(crate) fn text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, style: &str, said: &str) {
    let said = said.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{said}</text>"
    );
}

/// A line of the grid, px.
pub(crate) fn line(svg: &mut String, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
    let _ = writeln!(
        svg,
        "<path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\" stroke=\"#e3e6ea\" stroke-width=\"1\"/>"
    );
}
