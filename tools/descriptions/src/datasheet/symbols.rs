//! Joint symbols of the figures: circles, rectangles and arrows, and their legend.

use super::svg::{NOTE, Point, Svg, across, curve, stroke, unit};

pub(super) const DASHED: &str = "stroke=\"#1666c0\" stroke-width=\"1\" stroke-dasharray=\"4 3\"";
pub(super) const BODY: &str = "fill=\"#fff\" stroke=\"#222\" stroke-width=\"2\"";
pub(super) const ACCENT: &str = "#1666c0";
/// Style of a centre line.
pub(super) const CENTRE: &str = "stroke=\"#222\" stroke-width=\"1\" stroke-dasharray=\"8 3 2 3\"";

impl Svg {
    /// Draws the legend of the symbols.
    pub(super) fn legend(&mut self, [x, y]: [f64; 2]) {
        let right = Point::x();
        let accent = stroke(ACCENT, 2.0);
        for (place, towards) in [(x + 11.0, true), (x + 204.0, false)] {
            self.circle([place, y], 9.0, BODY);
            self.pole([place, y], towards);
        }
        let say = |svg: &mut Self, along: f64, said: &str| {
            svg.text([x + along, y + 4.5], "start", NOTE, said);
        };
        say(self, 28.0, "axis towards the viewer");
        say(self, 221.0, "axis away");
        self.axis_line(Point::new(x + 322.0, y), right);
        self.drum(Point::new(x + 322.0, y), right, [13.0, 8.0]);
        say(self, 356.0, "axis in the page");
        self.drum(Point::new(x + 486.0, y), right, [20.0, 8.0]);
        self.line([x + 473.0, y], [x + 498.0, y], &accent);
        self.arrowhead([x + 502.0, y], right, 8.0, ACCENT);
        say(self, 514.0, "slides");
        self.line([x + 566.0, y], [x + 588.0, y], &accent);
        self.arrowhead([x + 599.0, y], right, 9.0, ACCENT);
        say(self, 607.0, "positive direction");
        self.line([x + 730.0, y], [x + 758.0, y], DASHED);
        say(self, 766.0, "zero");
    }

    /// Axis along the line of sight: a dot for an axis towards the viewer, a cross for an axis away from the viewer.
    pub(super) fn pole(&mut self, at: impl Into<[f64; 2]>, towards: bool) {
        const COLOUR: &str = "#222";
        let [x, y] = at.into();
        if towards {
            return self.circle([x, y], 2.8, &format!("fill=\"{COLOUR}\""));
        }
        for side in [-5.0, 5.0] {
            self.line([x - 5.0, y - side], [x + 5.0, y + side], &stroke(COLOUR, 1.6));
        }
    }

    /// Rectangle centred at `at`, parallel to `along`. Its dimensions are half the length and half the width, px.
    pub(super) fn drum(&mut self, at: Point, along: Point, [long, wide]: [f64; 2]) {
        let corners = [(-long, -wide), (long, -wide), (long, wide), (-long, wide)]
            .map(|(a, b)| at + along * a + across(along) * b);
        self.polygon(corners, &format!("{BODY} stroke-linejoin=\"round\""));
    }

    pub(super) fn axis_line(&mut self, at: Point, along: Point) {
        self.line(at - along * 26.0, at + along * 26.0, CENTRE);
    }

    /// Arrow of positive rotation about an axis in the plane of the sheet, drawn on the near side of the axis.
    pub(super) fn turn_about(&mut self, at: Point, along: Point) {
        // The near side moves to the right of the axis direction. `across` points there, since y points down.
        let across = across(along);
        let point = |step: i32| {
            let (sin, cos) = (std::f64::consts::PI * (f64::from(step) / 16.0)).sin_cos();
            at - across * (16.0 * cos) + along * (17.0 - 5.0 * sin)
        };
        let points: Vec<_> = (0..=16).map(point).collect();
        self.turn(&points, 3.0);
    }

    /// A curved arrow in the positive direction of rotation. Its tip lies `beyond` px after the last point.
    pub(super) fn turn(&mut self, points: &[Point], beyond: f64) {
        self.path(points, &curve(ACCENT, 2.0));
        if let Some(&[before, tip]) = points.last_chunk() {
            let onwards = tip - before;
            self.arrowhead(tip + unit(onwards) * beyond, onwards, 9.0, ACCENT);
        }
    }
}
