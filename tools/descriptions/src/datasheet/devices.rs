//! Figures of the devices beside the robots: gripper and conveyor.

use controller::robot::{ConveyorParameters, GripperParameters};

use super::ink;
use super::svg::{self, Point};

const SIZE: [f64; 2] = [960.0, 380.0];

/// The figure of the gripper.
pub(super) fn gripper(gripper: &GripperParameters) -> String {
    let mut svg = svg::open(SIZE);
    opening(&mut svg, gripper);
    svg + "</svg>\n"
}

/// The figure of the conveyor.
pub(super) fn conveyor(conveyor: &ConveyorParameters) -> String {
    let mut svg = svg::open(SIZE);
    belt(&mut svg, conveyor);
    svg + "</svg>\n"
}

/// Opening of the gripper over the range of the motor.
fn opening(svg: &mut String, gripper: &GripperParameters) {
    let [left, right, top, bottom] = [90.0, 910.0, 70.0, 310.0];
    svg::text(
        svg,
        [left, 34.0],
        "start",
        "font-size=\"19\" fill=\"#111\"",
        "gripper: opening of the jaws",
    );
    let motors = &gripper.motor_limits;
    let x = |motor: f64| left + (right - left) * (motor - motors.low) / (motors.high - motors.low);
    let y = |opening: f64| bottom - (bottom - top) * (opening - 0.03) / (0.10 - 0.03);
    let grid = "stroke=\"#e3e6ea\" stroke-width=\"1\"";
    for step in 0..=7 {
        let motor = -2000.0 + 1000.0 * f64::from(step);
        svg::line(svg, [x(motor), top], [x(motor), bottom], grid);
        let said = motor.to_string().replace('-', "\u{2212}");
        svg::text(svg, [x(motor), bottom + 19.0], "middle", "", &said);
    }
    for step in 0..=7 {
        let millimetres = 30.0 + 10.0 * f64::from(step);
        let y = y(millimetres / 1e3);
        svg::line(svg, [left, y], [right, y], grid);
        svg::text(
            svg,
            [left - 10.0, y + 4.5],
            "end",
            "",
            &millimetres.to_string(),
        );
    }
    for (limit, said) in [
        (gripper.opening_limits.low, "narrowest"),
        (gripper.opening_limits.high, "widest"),
    ] {
        let y = y(limit);
        svg::line(
            svg,
            [left, y],
            [right, y],
            "stroke=\"#d9731a\" stroke-width=\"1.5\" stroke-dasharray=\"6 4\"",
        );
        let said = format!("{said}, {} mm", ink::millimetres(limit * 1e3));
        svg::text(
            svg,
            [right - 8.0, y - 6.0],
            "end",
            "fill=\"#b35c10\"",
            &said,
        );
    }
    let value = |motor: f64| (gripper.square * motor + gripper.linear) * motor + gripper.constant;
    let points: Vec<Point> = (0..=140)
        .map(|step| motors.low + (motors.high - motors.low) * f64::from(step) / 140.0)
        .map(|motor| [x(motor), y(value(motor))])
        .collect();
    svg::path(
        svg,
        &points,
        "fill=\"none\" stroke=\"#1666c0\" stroke-width=\"2.5\"",
    );
    let vertex = -gripper.linear / (2.0 * gripper.square);
    for (motor, said, up) in [
        (vertex, "vertex", -12.0),
        (gripper.motor_at_home, "home", 22.0),
    ] {
        let at = [x(motor), y(value(motor))];
        svg::circle(
            svg,
            at,
            4.5,
            "fill=\"#fff\" stroke=\"#222\" stroke-width=\"2\"",
        );
        let said = format!("{said} {motor:.0} rad");
        svg::text(
            svg,
            [at[0].min(right - 52.0), at[1] + up],
            "middle",
            "fill=\"#111\" font-weight=\"bold\"",
            &said,
        );
    }
    let middle = f64::midpoint(left, right);
    svg::text(
        svg,
        [middle, bottom + 44.0],
        "middle",
        ink::SECONDARY,
        "motor position, rad",
    );
    let turned = format!("{} transform=\"rotate(-90 34 190)\"", ink::SECONDARY);
    svg::text(svg, [34.0, 190.0], "middle", &turned, "opening, mm");
}

/// The belt on its rollers, with its motor.
fn belt(svg: &mut String, conveyor: &ConveyorParameters) {
    svg::text(
        svg,
        [60.0, 34.0],
        "start",
        "font-size=\"19\" fill=\"#111\"",
        "conveyor: a belt behind a gear",
    );
    let (rollers, y, radius) = ([220.0, 740.0], 190.0, 46.0);
    let body = "fill=\"#fff\" stroke=\"#222\" stroke-width=\"2\"";
    for side in [-1.0, 1.0] {
        let y = y + side * radius;
        svg::line(
            svg,
            [rollers[0], y],
            [rollers[1], y],
            "stroke=\"#8a939e\" stroke-width=\"7\"",
        );
    }
    for (roller, sense) in rollers.into_iter().zip([1.0, -1.0]) {
        let arc = (0..=24).map(|step| {
            let angle = std::f64::consts::PI * (0.5 + f64::from(step) / 24.0);
            [
                roller + sense * radius * angle.cos(),
                y + radius * angle.sin(),
            ]
        });
        let arc: Vec<Point> = arc.collect();
        svg::path(
            svg,
            &arc,
            "fill=\"none\" stroke=\"#8a939e\" stroke-width=\"7\"",
        );
        svg::circle(svg, [roller, y], radius - 6.0, body);
        svg::circle(svg, [roller, y], 3.0, "fill=\"#222\"");
    }
    svg::line(
        svg,
        [380.0, y - 84.0],
        [566.0, y - 84.0],
        "stroke=\"#1666c0\" stroke-width=\"2\"",
    );
    svg::arrowhead(svg, [576.0, y - 84.0], [1.0, 0.0], 11.0, "#1666c0");
    svg::text(
        svg,
        [478.0, y - 96.0],
        "middle",
        "font-weight=\"bold\" fill=\"#111\"",
        "belt position, m",
    );
    svg::line(
        svg,
        [220.0, y + 40.0],
        [220.0, y + 104.0],
        "stroke=\"#222\" stroke-width=\"1\" stroke-dasharray=\"8 3 2 3\"",
    );
    svg::path(
        svg,
        &[
            [176.0, y + 104.0],
            [264.0, y + 104.0],
            [264.0, y + 146.0],
            [176.0, y + 146.0],
            [176.0, y + 104.0],
        ],
        body,
    );
    svg::text(svg, [220.0, y + 130.0], "middle", "fill=\"#111\"", "motor");
    let ratio = conveyor.ratio;
    let said = format!(
        "motor position = {ratio} rad per m of belt; one turn of the motor moves it {:.4} mm",
        std::f64::consts::TAU / ratio * 1e3
    );
    svg::text(svg, [284.0, y + 130.0], "start", "fill=\"#111\"", &said);
}
