//! Figures of the devices beside the robots: gripper and conveyor.

use controller::robot::{ConveyorParameters, GripperParameters};

use super::ink;
use super::svg::{Point, Svg, TITLE, curve, stroke};
use super::symbols::{ACCENT, BODY, CENTRE};

const SIZE: [f64; 2] = [960.0, 380.0];

/// The figure of the gripper: opening over the range of the motor.
pub(super) fn gripper(gripper: &GripperParameters) -> String {
    let mut svg = Svg::open(SIZE);
    let [left, right, top, bottom] = [90.0, 910.0, 70.0, 310.0];
    svg.text([left, 34.0], "start", TITLE, "gripper: opening of the jaws");
    let motors = &gripper.motor_limits;
    let x = |motor: f64| left + (right - left) * (motor - motors.low) / (motors.high - motors.low);
    let y = |opening: f64| bottom - (bottom - top) * (opening - 0.03) / (0.10 - 0.03);
    let grid = &stroke("#e3e6ea", 1.0);
    for step in 0..=7 {
        let motor = -2000.0 + 1000.0 * f64::from(step);
        svg.line([x(motor), top], [x(motor), bottom], grid);
        svg.text([x(motor), bottom + 19.0], "middle", "", &motor.to_string().replace('-', "\u{2212}"));
    }
    for step in 0..=7 {
        let millimetres = 30.0 + 10.0 * f64::from(step);
        let y = y(millimetres / 1e3);
        svg.line([left, y], [right, y], grid);
        svg.text([left - 10.0, y + 4.5], "end", "", &millimetres.to_string());
    }
    for (limit, said) in [(gripper.opening_limits.low, "narrowest"), (gripper.opening_limits.high, "widest")] {
        let y = y(limit);
        svg.line([left, y], [right, y], &(stroke("#d9731a", 1.5) + " stroke-dasharray=\"6 4\""));
        let said = format!("{said}, {} mm", ink::millimetres(limit * 1e3));
        svg.text([right - 8.0, y - 6.0], "end", "fill=\"#b35c10\"", &said);
    }
    let value = |motor: f64| (gripper.square * motor + gripper.linear) * motor + gripper.constant;
    let motor = |step| motors.low + (motors.high - motors.low) * f64::from(step) / 140.0;
    let points: Vec<_> = (0..=140).map(motor).map(|motor| [x(motor), y(value(motor))]).collect();
    svg.path(&points, &curve(ACCENT, 2.5));
    let vertex = -gripper.linear / (2.0 * gripper.square);
    for (motor, said, up) in [(vertex, "vertex", -12.0), (gripper.motor_at_home, "home", 22.0)] {
        let at = [x(motor), y(value(motor))];
        svg.circle(at, 4.5, BODY);
        let beside = [at[0].min(right - 52.0), at[1] + up];
        svg.text(beside, "middle", "fill=\"#111\" font-weight=\"bold\"", &format!("{said} {motor:.0} rad"));
    }
    svg.text([f64::midpoint(left, right), bottom + 44.0], "middle", ink::SECONDARY, "motor position, rad");
    let turned = format!("{} transform=\"rotate(-90 34 190)\"", ink::SECONDARY);
    svg.text([34.0, 190.0], "middle", &turned, "opening, mm");
    svg.close()
}

/// The figure of the conveyor: the belt on its rollers, with its motor.
pub(super) fn conveyor(conveyor: &ConveyorParameters) -> String {
    let mut svg = Svg::open(SIZE);
    svg.text([60.0, 34.0], "start", TITLE, "conveyor: a belt behind a gear");
    let (rollers, y, radius) = ([220.0, 740.0], 190.0, 46.0);
    for side in [-1.0, 1.0] {
        let y = y + side * radius;
        svg.line([rollers[0], y], [rollers[1], y], &stroke("#8a939e", 7.0));
    }
    for (roller, sense) in rollers.into_iter().zip([1.0, -1.0]) {
        let arc = (0..=24).map(|step| {
            let angle = std::f64::consts::PI * (0.5 + f64::from(step) / 24.0);
            [roller + sense * radius * angle.cos(), y + radius * angle.sin()]
        });
        svg.path(&arc.collect::<Vec<_>>(), &curve("#8a939e", 7.0));
        svg.circle([roller, y], radius - 6.0, BODY);
        svg.circle([roller, y], 3.0, "fill=\"#222\"");
    }
    let above = y - 84.0;
    svg.line([380.0, above], [566.0, above], &stroke(ACCENT, 2.0));
    svg.arrowhead([576.0, above], Point::x(), 11.0, ACCENT);
    svg.text([478.0, y - 96.0], "middle", "font-weight=\"bold\" fill=\"#111\"", "belt position, m");
    svg.line([220.0, y + 40.0], [220.0, y + 104.0], CENTRE);
    let [left, right, upper, lower] = [176.0, 264.0, y + 104.0, y + 146.0];
    svg.path(&[[left, upper], [right, upper], [right, lower], [left, lower], [left, upper]], BODY);
    svg.text([220.0, y + 130.0], "middle", "fill=\"#111\"", "motor");
    let ratio = conveyor.ratio;
    let said = format!(
        "motor position = {ratio} rad per m of belt; one turn of the motor moves it {:.4} mm",
        std::f64::consts::TAU / ratio * 1e3
    );
    svg.text([284.0, y + 130.0], "start", "fill=\"#111\"", &said);
    svg.close()
}
