//! Figure of an arm: links, joints with their positive directions, dimensions, reach and frames, drawn from
//! [`controller::robot::Robot::links`].

use controller::robot::{Joints, Link, LinkKind};
use nalgebra::Vector3;

use super::ink::{self, Sheet};
use super::posture::{LEAST, Stand, stands};
use super::svg::{NOTE, Point, Svg, TITLE, unit};
use crate::kinematics::Machine;

const WIDTH: f64 = 960.0;
/// Size of the drawing area of a view, px.
const PANEL: [f64; 2] = [400.0, 430.0];
/// Left edges of the two views and common top edge, px.
const LEFT: [f64; 2] = [60.0, 520.0];
const TOP: f64 = 112.0;
const HEIGHT: f64 = TOP + PANEL[1] + 96.0;

/// One view of a robot in one posture.
pub(crate) struct View {
    pub(crate) title: &'static str,
    pub(crate) joints: Joints,
    /// Directions to the right and upwards on the sheet, in the base frame. They span the plane of projection.
    pub(crate) right: Vector3<f64>,
    pub(crate) up: Vector3<f64>,
    /// Outlines and name of the area that a point of the robot can reach.
    pub(crate) reach: Option<(Vec<Vec<Vector3<f64>>>, &'static str)>,
    /// Other parts: rails, legs, platforms.
    pub(crate) others: Vec<Other>,
}

/// A part outside the serial chain of links.
pub(crate) struct Other {
    pub(crate) points: Vec<Vector3<f64>>,
    pub(crate) part: Part,
    pub(crate) said: Option<String>,
}

impl View {
    /// A view of the robot alone, with its directions to the right and upwards.
    pub(crate) fn of(title: &'static str, joints: Joints, [right, up]: [Vector3<f64>; 2]) -> Self {
        Self { title, joints, right, up, reach: None, others: Vec::new() }
    }
}

/// Kind of a part.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Part {
    /// It is rigid.
    Solid,
    /// A leg, whose length is driven.
    Leg,
    /// An invisible line that carries a dimension only.
    Measure,
}

/// Figure of one or two views. `symbols` are the names of the joints in the formulas.
pub(crate) fn figure(machine: &Machine, symbols: &[&str], views: &[View; 2]) -> String {
    let links = machine.robot.links();
    let mut svg = Svg::open([WIDTH, HEIGHT]);
    svg.text([LEFT[0], 34.0], "start", TITLE, &format!("{}: geometry in mm", machine.name));
    if let Some(caution) = machine.caution {
        svg.text([LEFT[0], 55.0], "start", ink::SECONDARY, caution);
    }
    let mut told = Vec::new();
    for (view, left) in views.iter().zip(LEFT) {
        svg.text([left, TOP - 28.0], "start", "font-size=\"15\" fill=\"#111\"", view.title);
        svg.text([left, TOP - 10.0], "start", NOTE, &at(&view.joints, symbols, &links));
        panel(&mut svg, left, symbols, view, &stands(&links, &view.joints), &mut told);
    }
    svg.legend([LEFT[0], HEIGHT - 22.0]);
    svg.close()
}

/// Text of the posture.
fn at(joints: &Joints, symbols: &[&str], links: &[Link]) -> String {
    let values = joints.iter().zip(symbols).zip(links).map(|((joint, symbol), link)| match link.kind {
        LinkKind::Prismatic => format!("{symbol} {:.0} mm", joint * 1e3),
        LinkKind::Revolute | LinkKind::Continuous => format!("{symbol} {:.0}°", joint.to_degrees()),
    });
    values.collect::<Vec<_>>().join(", ").replace('-', "\u{2212}")
}

/// Draws a view. Adds the dimensioned lengths to `told`: number of the joint and number of the segment before it.
fn panel(svg: &mut Svg, left: f64, symbols: &[&str], view: &View, stands: &[Stand], told: &mut Vec<(usize, usize)>) {
    let flange = stands.last().map_or_else(Vector3::zeros, |stand| stand.frame.translation.vector);
    let mut seen: Vec<Vector3<f64>> = vec![Vector3::zeros(), flange];
    seen.extend(stands.iter().flat_map(|stand| stand.way.iter().flatten()));
    seen.extend(view.others.iter().flat_map(|other| &other.points));
    seen.extend(view.reach.iter().flat_map(|(outlines, _)| outlines.iter().flatten()));
    let mut sheet = Sheet::fit(svg, [view.right, view.up], &seen, [left, TOP], PANEL);

    if let Some((outlines, _)) = &view.reach {
        sheet.area(outlines);
    }
    let ways = || stands.iter().flat_map(|stand| &stand.way);
    for [from, to] in ways() {
        sheet.occupy(*from, *to);
    }
    // A base frame below the first joint is drawn on the ground.
    let stands_on_it = stands.first().is_some_and(|stand| !stand.way.is_empty());
    sheet.ground(if stands_on_it { 4.0 } else { 44.0 });
    for other in view.others.iter().filter(|other| other.part != Part::Measure) {
        sheet.other(&other.points, other.part == Part::Leg);
    }
    for [from, to] in ways() {
        sheet.link(*from, *to);
    }
    let places = places(&sheet, stands);
    for place in &places {
        sheet.block(*place, 13.0);
    }
    for (stand, place) in stands.iter().zip(&places) {
        if let Some([zero, now]) = stand.turned {
            sheet.angle(*place, [zero, now], stand.axis);
        }
    }
    for (stand, place) in stands.iter().zip(&places) {
        sheet.joint(*place, stand.kind, stand.axis);
    }
    sheet.frame(&nalgebra::Isometry3::identity());
    if let Some(last) = stands.last() {
        sheet.frame(&last.frame);
    }
    for ((symbol, place), stand) in symbols.iter().zip(&places).zip(stands) {
        sheet.name(*place, symbol, &stand.axis);
    }
    for (joint, (stand, symbol)) in stands.iter().zip(symbols).enumerate() {
        for (part, [from, to]) in stand.way.iter().enumerate() {
            if told.contains(&(joint, part)) {
                continue;
            }
            let along = (to - from).normalize();
            let variable = stand.kind == LinkKind::Prismatic && along.dot(&stand.axis).abs() > 0.99;
            let length = (to - from).norm() * 1e3;
            let said = if variable { (*symbol).to_owned() } else { ink::millimetres(length) };
            if sheet.dimension([*from, *to], &said) {
                told.push((joint, part));
            }
        }
    }
    for other in &view.others {
        if let (Some(said), Some(&[from, to])) = (&other.said, other.points.first_chunk()) {
            sheet.dimension([from, to], said);
        }
    }
    sheet.frame_name(&Vector3::zeros(), "base");
    sheet.frame_name(&flange, "flange");
    if let Some((outlines, said)) = &view.reach {
        sheet.area_name(outlines, said);
    }
    sheet.scale([left, TOP + PANEL[1] + 24.0]);
}

/// Positions of the joint symbols. Joints seen along their axes come first, because their symbols cannot be moved
/// aside.
fn places(sheet: &Sheet, stands: &[Stand]) -> Vec<Point> {
    let mut places = vec![Point::repeat(f64::INFINITY); stands.len()];
    for seen_along in [true, false] {
        for (number, stand) in stands.iter().enumerate() {
            if sheet.is_seen_along(&stand.axis) == seen_along {
                let ends = [number == 0, number + 1 == stands.len()];
                places[number] = place(sheet, stand, ends, &places);
            }
        }
    }
    places
}

/// Position of a joint symbol. A joint that turns about or slides along the segment before it is drawn on that segment.
/// Any other joint is drawn at its frame. If that position is taken, the symbol is moved along the joint axis. The
/// symbol of the first joint leaves room for the base frame.
fn place(sheet: &Sheet, stand: &Stand, [first, last]: [bool; 2], taken: &[Point]) -> Point {
    let own = sheet.at(stand.frame.translation.vector);
    let on_way = stand.way.last().and_then(|[from, to]| {
        let along = (to - from).normalize().dot(&stand.axis).abs() > 0.99;
        let [a, b] = [from, to].map(|end| sheet.at(*end));
        let long = (to - from).norm() > LEAST && (b - a).norm() > 30.0;
        let share = if first { 0.65 } else { 0.5 };
        (along && long).then(|| a + (b - a) * share)
    });
    let is_free = |place: &Point| !taken.iter().any(|other| (other - place).norm() < 27.0);
    // Symbols are moved towards the base, and the symbol of the last joint towards the flange.
    let towards = unit(sheet.direction(if last { stand.axis } else { -stand.axis }));
    let beside = [30.0, -30.0, 56.0, -56.0].map(|away| own + towards * away);
    let aside = beside.into_iter().filter(|_| !sheet.is_seen_along(&stand.axis));
    on_way.into_iter().chain([own]).chain(aside).find(is_free).unwrap_or(own)
}
