//! Symbols of joints: discs, drums, arrows, and their legend.

use std::fmt::Write as _;

use super::svg::{self, Point, unit};

pub(super) const DASHED: &str = "stroke=\"#1666c0\" stroke-width=\"1\" stroke-dasharray=\"4 3\"";
pub(super) const BODY: &str = "fill=\"#fff\" stroke=\"#222\" stroke-width=\"2\"";
pub(super) const ACCENT: &str = "#1666c0";

/// Legend of the symbols.
pub(super) fn legend(svg: &mut String, [x, y]: Point) {
    let say = |svg: &mut String, x: f64, said: &str| {
        svg::text(
            svg,
            [x, y + 4.5],
            "start",
            "font-size=\"12\" fill=\"#666\"",
            said,
        );
    };
    for (place, towards) in [(x + 11.0, true), (x + 204.0, false)] {
        svg::circle(svg, [place, y], 9.0, BODY);
        pole(svg, [place, y], towards, "#222");
    }
    say(svg, x + 28.0, "axis towards the viewer");
    say(svg, x + 221.0, "axis away");
    axis_line(svg, [x + 322.0, y], [1.0, 0.0]);
    drum(svg, [x + 322.0, y], [1.0, 0.0], [13.0, 8.0]);
    say(svg, x + 356.0, "axis in the page");
    drum(svg, [x + 486.0, y], [1.0, 0.0], [20.0, 8.0]);
    svg::line(
        svg,
        [x + 473.0, y],
        [x + 498.0, y],
        "stroke=\"#1666c0\" stroke-width=\"2\"",
    );
    svg::arrowhead(svg, [x + 502.0, y], [1.0, 0.0], 8.0, ACCENT);
    say(svg, x + 514.0, "slides");
    svg::line(
        svg,
        [x + 566.0, y],
        [x + 588.0, y],
        "stroke=\"#1666c0\" stroke-width=\"2\"",
    );
    svg::arrowhead(svg, [x + 599.0, y], [1.0, 0.0], 9.0, ACCENT);
    say(svg, x + 607.0, "positive direction");
    svg::line(svg, [x + 730.0, y], [x + 758.0, y], DASHED);
    say(svg, x + 766.0, "zero");
}

/// Arrow parallel to the line of sight: its point or its feathers.
pub(super) fn pole(svg: &mut String, [x, y]: Point, towards: bool, colour: &str) {
    if towards {
        svg::circle(svg, [x, y], 2.8, &format!("fill=\"{colour}\""));
    } else {
        for side in [-1.0, 1.0] {
            let [from, to] = [[x - 5.0, y - 5.0 * side], [x + 5.0, y + 5.0 * side]];
            svg::line(
                svg,
                from,
                to,
                &format!("stroke=\"{colour}\" stroke-width=\"1.6\""),
            );
        }
    }
}

pub(super) fn square(svg: &mut String, at: Point, half: f64) {
    drum(svg, at, [1.0, 0.0], [half, half]);
}

/// A rectangle centred on a line.
pub(super) fn drum(svg: &mut String, at: Point, along: Point, [long, wide]: [f64; 2]) {
    let corner = |a: f64, b: f64| {
        [
            at[0] + a * along[0] - b * along[1],
            at[1] + a * along[1] + b * along[0],
        ]
    };
    let corners = [
        corner(-long, -wide),
        corner(long, -wide),
        corner(long, wide),
        corner(-long, wide),
    ];
    let mut way = String::new();
    for [x, y] in corners {
        let _ = write!(way, "{x:.1},{y:.1} ");
    }
    let _ = writeln!(
        svg,
        "<polygon points=\"{way}\" {BODY} stroke-linejoin=\"round\"/>"
    );
}

pub(super) fn axis_line(svg: &mut String, at: Point, along: Point) {
    let ends = [-26.0, 26.0].map(|reach| [0, 1].map(|side| at[side] + reach * along[side]));
    svg::line(
        svg,
        ends[0],
        ends[1],
        "stroke=\"#222\" stroke-width=\"1\" stroke-dasharray=\"8 3 2 3\"",
    );
}

/// Positive direction of rotation about an axis in the plane of the sheet, on the side of the viewer.
pub(super) fn turn_about(svg: &mut String, at: Point, along: Point) {
    // The near side moves to the right of the direction of the axis, because y points down on the sheet.
    let across = [-along[1], along[0]];
    let point = |share: f64| {
        let (sin, cos) = (std::f64::consts::PI * share).sin_cos();
        [0, 1].map(|side| at[side] - 16.0 * cos * across[side] + (17.0 - 5.0 * sin) * along[side])
    };
    let points: Vec<_> = (0..=16).map(|step| point(f64::from(step) / 16.0)).collect();
    svg::path(
        svg,
        &points,
        &format!("fill=\"none\" stroke=\"{ACCENT}\" stroke-width=\"2\""),
    );
    if let Some(&[before, tip]) = points.last_chunk::<2>() {
        let onwards = [tip[0] - before[0], tip[1] - before[1]];
        svg::arrowhead(
            svg,
            [0, 1].map(|side| tip[side] + 3.0 * unit(onwards)[side]),
            onwards,
            9.0,
            ACCENT,
        );
    }
}
