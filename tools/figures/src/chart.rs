//! What charts have in common: a titled sheet and the lines of its grid.

use crate::svg::{self, Point};

pub use crate::svg::text;

/// Begins a picture of `size`, px, with its title and what is said below it, both from `left` on.
pub fn open(size: [f64; 2], left: f64, title: &str, setting: &str) -> String {
    let mut sheet = svg::open(size);
    let style = "font-size=\"19\" fill=\"#111\"";
    text(&mut sheet, [left, 32.0], "start", style, title);
    text(&mut sheet, [left, 54.0], "start", "fill=\"#666\"", setting);
    sheet
}

/// A line of the grid, px.
pub fn line(sheet: &mut String, from: Point, to: Point) {
    svg::line(sheet, from, to, "stroke=\"#e3e6ea\" stroke-width=\"1\"");
}
