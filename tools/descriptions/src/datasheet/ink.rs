//! Drawing of a view: projection, links, and placement of texts.

use controller::robot::LinkKind;
use nalgebra::{Isometry3, Vector3};

use super::svg::{NOTE, Point, Svg, across, around, curve, stroke, unit};
use super::symbols::{ACCENT, BODY, DASHED};

pub(super) const SECONDARY: &str = "fill=\"#666\"";
const LINK: &str = "fill=\"none\" stroke=\"#8a939e\" stroke-width=\"9\" stroke-linecap=\"round\"";
const THIN: &str = "stroke=\"#98a1ab\" stroke-width=\"1\"";
/// Axes x, y and z of a frame, with their colours.
const AXES: [(&str, &str); 3] = [("x", "#c62828"), ("y", "#2e7d32"), ("z", "#1546a0")];
/// White outline that keeps a text legible on lines.
const HALO: &str = "paint-order=\"stroke\" stroke=\"#fff\" stroke-width=\"4\" stroke-linejoin=\"round\"";

/// Text of a length in mm, without trailing zeros.
pub(super) fn millimetres(length: f64) -> String {
    ((length * 10.0).round() / 10.0).to_string()
}

/// Projection of a view onto the sheet.
pub(super) struct Sheet<'a> {
    svg: &'a mut Svg,
    right: Vector3<f64>,
    up: Vector3<f64>,
    origin: Point,
    /// Scale, px per m.
    scale: f64,
    /// Points that texts avoid.
    taken: Vec<Point>,
}

impl<'a> Sheet<'a> {
    /// Projection that places all of `seen` inside the panel.
    pub(super) fn fit(
        svg: &'a mut Svg,
        [right, up]: [Vector3<f64>; 2],
        seen: &[Vector3<f64>],
        corner: [f64; 2],
        size: [f64; 2],
    ) -> Self {
        const MARGIN: f64 = 62.0;
        let ends = |direction: &Vector3<f64>| {
            let along = seen.iter().map(|point| point.dot(direction));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
        };
        let (across, upwards) = (ends(&right), ends(&up));
        let room = |size: f64, [low, high]: [f64; 2]| (size - 2.0 * MARGIN) / (high - low).max(1e-3);
        let scale = room(size[0], across).min(room(size[1], upwards));
        let middle = |[low, high]: [f64; 2]| f64::midpoint(low, high) * scale;
        Self {
            svg,
            right,
            up,
            origin: Point::new(corner[0] + size[0] / 2.0 - middle(across), corner[1] + size[1] / 2.0 + middle(upwards)),
            scale,
            taken: Vec::new(),
        }
    }

    pub(super) fn at(&self, point: Vector3<f64>) -> Point {
        self.origin + self.direction(point)
    }

    /// Direction on the sheet; zero if the direction is parallel to the line of sight.
    pub(super) fn direction(&self, direction: Vector3<f64>) -> Point {
        Point::new(direction.dot(&self.right), -direction.dot(&self.up)) * self.scale
    }

    /// Direction towards the viewer.
    fn viewer(&self) -> Vector3<f64> {
        self.right.cross(&self.up)
    }

    pub(super) fn is_seen_along(&self, axis: &Vector3<f64>) -> bool {
        axis.dot(&self.viewer()).abs() > 0.9
    }

    /// Marks a line as an obstacle for texts.
    pub(super) fn occupy(&mut self, from: Vector3<f64>, to: Vector3<f64>) {
        let [from, to] = [from, to].map(|end| self.at(end));
        self.occupy_line(from, to);
    }

    fn occupy_line(&mut self, from: Point, to: Point) {
        let steps = ((to - from).norm() / 5.0).ceil().max(1.0);
        let places = (0..=steps as u32).map(|step| f64::from(step) / steps);
        self.taken.extend(places.map(|share| from + (to - from) * share));
    }

    /// Marks a square as an obstacle for texts.
    pub(super) fn block(&mut self, at: Point, half: f64) {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (0.0, 0.0)];
        self.taken.extend(corners.map(|(x, y)| at + Point::new(x, y) * half));
        for side in [Point::x() * half, Point::y() * half] {
            self.occupy_line(at - side, at + side);
        }
    }

    /// Number of obstacle points that a text centred at this position would cover.
    fn crowd(&self, at: Point, said: &str, size: f64) -> usize {
        let wide = 0.30 * size * said.chars().count() as f64 + 3.0;
        let high = 0.55 * size + 2.0;
        let covered = |other: &&Point| (other.x - at.x).abs() < wide && (other.y - at.y).abs() < high;
        self.taken.iter().filter(covered).count()
    }

    /// Adds a text at the position with the fewest obstacles; among equals, at the first.
    fn text(&mut self, places: impl IntoIterator<Item = Point>, size: f64, style: &str, said: &str) {
        let places: Vec<_> = places.into_iter().collect();
        let Some(&at) = places.iter().min_by_key(|place| self.crowd(**place, said, size)) else { return };
        let style = format!("font-size=\"{size}\" {style} {HALO}");
        self.svg.text(at + Point::y() * (0.36 * size), "middle", &style, said);
        let half = Point::x() * (0.29 * size * said.chars().count() as f64);
        for down in [-0.4 * size, 0.0, 0.4 * size] {
            let line = at + Point::y() * down;
            self.occupy_line(line - half, line + half);
        }
    }

    /// Fills an area inside closed outlines.
    pub(super) fn area(&mut self, outlines: &[Vec<Vector3<f64>>]) {
        let style = "fill=\"#e8f1fb\" fill-rule=\"evenodd\" stroke=\"#9dc1e8\" stroke-width=\"1\" \
                     stroke-dasharray=\"6 3\"";
        let points = |outline: &Vec<_>| outline.iter().map(|point| self.at(*point)).collect();
        let outlines: Vec<Vec<_>> = outlines.iter().map(points).collect();
        self.svg.area(outlines.into_iter(), style);
    }

    /// Name of an area, below or above it.
    pub(super) fn area_name(&mut self, outlines: &[Vec<Vector3<f64>>], said: &str) {
        let points = outlines.iter().flatten().map(|point| self.at(*point));
        let nothing = [f64::INFINITY, f64::NEG_INFINITY].map(Point::repeat);
        let [low, high] = points.fold(nothing, |[low, high], point| [low.inf(&point), high.sup(&point)]);
        let middle = f64::midpoint(low.x, high.x);
        let heights = [high.y + 14.0, low.y - 12.0, high.y + 28.0, low.y - 26.0];
        self.text(heights.map(|height| Point::new(middle, height)), 12.0, "fill=\"#4a86c5\"", said);
    }

    /// Hatched base, `depth` px below the base frame, drawn only in a side view. The base carries axis 1 along the z
    /// axis of the base frame.
    pub(super) fn ground(&mut self, depth: f64) {
        if self.is_seen_along(&Vector3::z()) {
            return;
        }
        let down = unit(self.direction(-Vector3::z()));
        let (origin, across) = (self.origin, across(down));
        let place = |along: f64, deep: f64| origin + across * along + down * deep;
        let top = [place(-44.0, depth), place(44.0, depth)];
        self.svg.line(place(0.0, 0.0), place(0.0, depth), LINK);
        self.svg.line(top[0], top[1], &stroke("#222", 2.0));
        for step in 0..9 {
            let from = -40.0 + 10.0 * f64::from(step);
            self.svg.line(place(from, depth), place(from - 8.0, depth + 9.0), &stroke("#222", 1.0));
        }
        self.occupy_line(top[0], top[1]);
        self.occupy_line(origin, place(0.0, depth));
    }

    pub(super) fn link(&mut self, from: Vector3<f64>, to: Vector3<f64>) {
        let [from, to] = [from, to].map(|end| self.at(end));
        if (to - from).norm() > 1.0 {
            self.svg.line(from, to, LINK);
        }
    }

    /// A rail, a leg or a platform. A part whose length is driven carries a box.
    pub(super) fn other(&mut self, points: &[Vector3<f64>], slides: bool) {
        let points: Vec<_> = points.iter().map(|point| self.at(*point)).collect();
        self.svg.path(&points, &(curve("#5b6570", 3.0) + " stroke-linejoin=\"round\""));
        for ends in points.windows(2) {
            self.occupy_line(ends[0], ends[1]);
        }
        if let (true, &[from, to]) = (slides, &points[..]) {
            // Joints at both ends, and the screw between them.
            for end in [from, to] {
                self.svg.circle(end, 4.5, BODY);
            }
            let along = to - from;
            self.svg.drum(from + along * 0.45, unit(along), [22.0, 6.0]);
        }
    }

    /// The symbol of a joint and its positive direction.
    pub(super) fn joint(&mut self, at: Point, kind: LinkKind, axis: Vector3<f64>) {
        let towards = axis.dot(&self.viewer());
        let along = unit(self.direction(axis));
        let seen_along = self.is_seen_along(&axis);
        if kind == LinkKind::Prismatic {
            if seen_along {
                self.svg.drum(at, Point::x(), [10.0, 10.0]);
                self.svg.pole(at, towards > 0.0);
            } else {
                self.svg.drum(at, along, [20.0, 10.0]);
                let tip = at + along * 15.0;
                self.svg.line(at - along * 13.0, tip, &stroke(ACCENT, 2.0));
                self.svg.arrowhead(tip, along, 9.0, ACCENT);
            }
        } else if seen_along {
            self.svg.circle(at, 11.0, BODY);
            self.svg.pole(at, towards > 0.0);
        } else {
            self.svg.axis_line(at, along);
            self.svg.drum(at, along, [13.0, 9.0]);
            self.svg.turn_about(at, along);
        }
    }

    /// Angle of a joint that is seen along its axis. A dashed line marks the zero position of the link, and an arrow
    /// marks the positive direction.
    pub(super) fn angle(&mut self, at: Point, [zero, now]: [Vector3<f64>; 2], axis: Vector3<f64>) {
        if !self.is_seen_along(&axis) {
            return;
        }
        let [zero, now] = [zero, now].map(|direction| {
            let seen = self.direction(direction);
            seen.y.atan2(seen.x)
        });
        // On the sheet y points down. A rotation about an axis towards the viewer therefore reduces the angle on the
        // sheet.
        let sense = -axis.dot(&self.viewer()).signum();
        let place = |radius: f64, angle: f64| at + Point::new(angle.cos(), angle.sin()) * radius;
        let end = place(56.0, zero);
        self.svg.line(at, end, DASHED);
        self.occupy_line(at, end);
        let mut swept = now - zero;
        swept -= std::f64::consts::TAU * (swept / std::f64::consts::TAU).round();
        let arc = |radius: f64, from: f64, sweep: f64| -> Vec<Point> {
            (0..=24).map(|step| place(radius, from + sweep * f64::from(step) / 24.0)).collect()
        };
        if swept.abs() > 0.05 {
            let points = arc(40.0, zero, swept);
            self.svg.path(&points, &curve(ACCENT, 1.0));
            self.taken.extend(points);
        }
        let span = 1.3 * sense;
        let points = arc(20.0, zero - span / 2.0 + sense * 0.9, span);
        self.svg.turn(&points, 5.0);
        self.taken.extend(points);
    }

    /// Name of a joint. The dimension line of a joint seen along its axis leaves the joint across its links. Most links
    /// are horizontal or vertical, so the name is placed diagonally.
    pub(super) fn name(&mut self, at: Point, symbol: &str, axis: &Vector3<f64>) {
        let round = |radius: f64| around(at, radius, 1.15, [3, 5, 1, 7, 4, 0, 2, 6]);
        let askew = round(34.0).into_iter().take(if self.is_seen_along(axis) { 2 } else { 0 });
        let places = askew.chain([26.0, 34.0, 46.0].into_iter().flat_map(round));
        self.text(places, 14.0, "fill=\"#111\" font-weight=\"bold\"", symbol);
    }

    /// Adds a dimension beside a line, if the line is parallel to the sheet. Returns whether the dimension was added.
    pub(super) fn dimension(&mut self, ends: [Vector3<f64>; 2], said: &str) -> bool {
        let length = (ends[1] - ends[0]).norm() * self.scale;
        let [from, to] = ends.map(|end| self.at(end));
        let (along, seen) = (to - from, (to - from).norm());
        if seen < 9.0 || seen < 0.999 * length {
            return false;
        }
        let (along, size) = (unit(along), 12.0);
        let across = across(along);
        let beside = |offset: f64, end: Point| end + across * offset;
        let middle = (from + to) / 2.0;
        let offsets = [30.0, -30.0, 48.0, -48.0, 66.0, -66.0, 84.0, -84.0];
        // A text wider than its line is placed farther away.
        let wide = 0.6 * size * said.chars().count() as f64 > seen - 4.0;
        let place = |offset: f64| beside(offset + if wide { 12.0 * offset.signum() } else { 0.0 }, middle);
        let crowd = |offset: &f64| {
            let seen_from = |end: Point, other: Point| [along, across].map(|axis| axis.dot(&(other - end)));
            let on_line = |other: &&Point| {
                let [x, y] = seen_from(middle, **other);
                x.abs() < seen / 2.0 && (y - offset).abs() < 7.0
            };
            let on_mark = |other: &&Point| {
                [from, to].into_iter().any(|end| {
                    let [x, y] = seen_from(end, **other);
                    x.abs() < 3.0 && (14.0..offset.abs()).contains(&(y * offset.signum()))
                })
            };
            let crossed = |other: &&Point| on_line(other) || on_mark(other);
            10 * self.crowd(place(*offset), said, size) + self.taken.iter().filter(crossed).count()
        };
        let Some(&offset) = offsets.iter().min_by_key(|offset| crowd(offset)) else {
            return false;
        };
        let [a, b] = [beside(offset, from), beside(offset, to)];
        for (end, mark) in [(from, a), (to, b)] {
            let past = beside(4.0 * offset.signum(), mark);
            let off = beside(9.0 * offset.signum(), end);
            self.svg.line(off, past, THIN);
            self.occupy_line(off, past);
        }
        self.svg.line(a, b, THIN);
        self.svg.arrowhead(b, along, 7.0, "#6b747e");
        self.svg.arrowhead(a, -along, 7.0, "#6b747e");
        self.occupy_line(a, b);
        self.text([place(offset)], size, "fill=\"#222\"", said);
        true
    }

    /// Draws the axes of a frame.
    pub(super) fn frame(&mut self, frame: &Isometry3<f64>) {
        const LENGTH: f64 = 58.0;
        let origin = self.at(frame.translation.vector);
        let columns = frame.rotation.to_rotation_matrix().into_inner();
        for ((name, colour), axis) in AXES.iter().zip(columns.column_iter()) {
            let axis = axis.into_owned();
            if self.is_seen_along(&axis) {
                continue;
            }
            let direction = self.direction(axis);
            let tip = origin + direction / self.scale * LENGTH;
            self.svg.line(origin, tip, &stroke(colour, 2.0));
            self.svg.arrowhead(tip, direction, 9.0, colour);
            self.occupy_line(origin, tip);
            self.text([tip + unit(direction) * 9.0], 13.0, &format!("fill=\"{colour}\""), name);
        }
    }

    /// Name of a frame.
    pub(super) fn frame_name(&mut self, origin: &Vector3<f64>, said: &str) {
        let origin = self.at(*origin);
        let round = |radius: f64| around(origin, radius, 1.5, [0, 1, 2, 3, 4, 5, 6, 7]);
        let places = [24.0, 36.0, 50.0].into_iter().flat_map(round);
        self.text(places, 12.0, "fill=\"#666\" font-style=\"italic\"", said);
    }

    /// Scale bar of 200 mm.
    pub(super) fn scale(&mut self, [x, y]: [f64; 2]) {
        let end = x + 0.2 * self.scale;
        let [low, middle, high] = [y + 4.0, y, y - 4.0];
        self.svg.path(&[[x, high], [x, low], [x, middle], [end, middle], [end, high], [end, low]], &curve("#666", 1.5));
        self.svg.text([end + 8.0, low], "start", NOTE, "200 mm");
    }
}
