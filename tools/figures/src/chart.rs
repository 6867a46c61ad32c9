//! Common parts of charts: a titled sheet and grid lines.

use crate::svg::{self, Point};

pub use crate::svg::text;

/// Starts a chart of `size`, px, with a title and a line of text below it. Both are aligned at `left`.
pub fn open(size: [f64; 2], left: f64, title: &str, setting: &str) -> String {
    let mut sheet = svg::open(size);
    let style = "font-size=\"19\" fill=\"#111\"";
    text(&mut sheet, [left, 32.0], "start", style, title);
    text(&mut sheet, [left, 54.0], "start", "fill=\"#666\"", setting);
    sheet
}

/// Adds a grid line, px.
pub fn line(sheet: &mut String, from: Point, to: Point) {
    svg::line(sheet, from, to, "stroke=\"#e3e6ea\" stroke-width=\"1\"");
}
