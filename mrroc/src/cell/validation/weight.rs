//! Checks of a robot with a table `weight`.

use servo::{Output, PositionLoop};

use super::{Checked, refused};
use crate::cell::{Axis, FeedForward, Path, Robot};
use controller::robot::WeightError;

pub(super) fn check(robot: &Path, given: &Robot, kinematics: &dyn controller::robot::Robot) -> Checked {
    let mut axes = given.axis.iter().enumerate();
    let Some(weights) = &given.weight else {
        return axes.try_for_each(|(number, axis)| check_weightless(&robot.then("axis").then(number), axis));
    };
    let path = robot.then("weight");
    let at = |error: WeightError| {
        let masses = path.then("masses");
        let links = kinematics.axes();
        let body = |link: usize| {
            if link < links { masses.then(link) } else { path.then("load") }
        };
        let place = match error {
            WeightError::NoLinks => path.clone(),
            WeightError::Count { .. } => masses.clone(),
            WeightError::Mass { link, .. } => body(link).then("mass"),
            WeightError::Centre { link, .. } => body(link).then("centre"),
            WeightError::Up => path.then("up"),
        };
        (place, error.to_string())
    };
    let weight = weights.of(&given.numbers(), kinematics).map_err(at)?;
    let torques = weight.torque(kinematics, &kinematics.home());
    let torques = torques.map_err(|error| (path.clone(), format!("at home: {}", given.naming_axes(error))))?;
    axes.try_for_each(|(number, axis)| {
        let path = robot.then("axis").then(number);
        check_axis(&path, axis)?;
        check_output(&path, axis, torques[number])
    })
}

/// The feed-forward of the position loop, if the host closes the loop.
fn feed_forward(path: &Path, axis: &Axis) -> Option<(Path, FeedForward)> {
    let (family, given, _) = axis.host_loop()?;
    let path = path.then(family).then("loop").then("feed_forward");
    Some((path, given.feed_forward))
}

/// Checks an axis of a robot without a table `weight`: its feed-forward must not use the weight.
fn check_weightless(path: &Path, axis: &Axis) -> Checked {
    match feed_forward(path, axis) {
        Some((path, it)) if it.weight.is_some_and(|weight| weight != 0.0) => refused(
            &path,
            "weight",
            "is for a robot that says what it weighs: give it a table weight, or leave this out",
        ),
        _ => Ok(()),
    }
}

/// Checks that the loop of an axis can output the torque for the weight at home, N·m, and does not add it twice.
fn check_output(path: &Path, axis: &Axis, torque: f64) -> Checked {
    let PositionLoop::Host(host) = axis.position_loop(true) else {
        return Ok(());
    };
    let weight = host.feed_forward.weight.unwrap_or(0.0);
    let Some((path, given)) = feed_forward(path, axis).filter(|_| weight != 0.0) else {
        return Ok(());
    };
    if given.constant != 0.0 {
        let why = "is the mean of a weight that the robot's table weight feeds forward already: leave it out";
        return refused(&path, "constant", why);
    }
    let (output, limit) = (weight * torque, host.law.limit());
    if output.abs() > limit {
        let why = format!(
            "is to hold {torque:.3} N·m at home, {:.3} of an output of {limit} at most: correct the masses or the limit",
            output.abs()
        );
        return Err((path, why));
    }
    Ok(())
}

/// Checks that the weight can be fed forward to a motor.
fn check_axis(path: &Path, axis: &Axis) -> Checked {
    let control = match axis.host_loop() {
        None => "position",
        Some((_, _, Output::Velocity)) => "velocity",
        Some((_, given, Output::Duty)) if given.feed_forward.weight.is_none() => {
            let why = "lacks weight, the pulse width per torque that the robot's weight takes: winding resistance / \
                       (torque constant * supply voltage), or 0 to hold this axis by its loop alone";
            return refused(&path.then("controller").then("loop"), "feed_forward", why);
        }
        Some((_, _, Output::Torque | Output::Duty)) => return Ok(()),
    };
    let why = format!(
        "is {control}, by which the drive's own loop holds the robot's weight: use torque, or leave the weight out"
    );
    refused(&path.then("drive"), "control", why)
}

#[cfg(test)]
mod tests {
    use crate::cell::Cell;

    const SERIAL: &str = include_str!("../../../../cells/irb6-serial.toml");
    const IRB6: &str = include_str!("../../../../cells/irb6.toml");

    /// The cell with `weight` in its robot. `roll` is added to the feed-forward of the axis commanded by pulse width.
    fn weighing(cell: &str, weight: &str, roll: &str) -> String {
        let robot = "model = \"irb6\"\n";
        let cell = cell.replacen(robot, &format!("{robot}weight = {weight}\n"), 1);
        cell.replacen("coulomb = 0.002381", &format!("coulomb = 0.002381{roll}"), 1)
    }

    #[test]
    fn weights_that_nobody_could_hold_are_refused_where_they_stand() {
        let roll = ", weight = 0.119";
        let five = "{ mass = 1.0, centre = [0.0, 0.0, 0.0] }, ".repeat(4);
        let masses = |last: &str| format!("{{ masses = [{five}{last}] }}");
        let good = masses("{ mass = 1.0, centre = [0.0, 0.0, 0.1] }");
        let negative = masses("{ mass = -1.0, centre = [0.0, 0.0, 0.1] }");
        let heavy = masses("{ mass = 1000.5, centre = [0.0, 0.0, 0.1] }");
        let typed = masses("{ mass = 600.0, centre = [0.0, 0.0, 0.1] }");
        let four = format!("{{ masses = [{five}] }}");
        let cases = [
            (SERIAL, "{}", roll, ""),
            (SERIAL, good.as_str(), roll, ""),
            (SERIAL, "{ load = { mass = 6.0, centre = [0.0, 0.0, 0.2] } }", ", weight = 0.0", ""),
            (SERIAL, &negative, roll, "robot[0].weight.masses[4].mass: a mass of -1 kg"),
            (SERIAL, &heavy, roll, "robot[0].weight.masses[4].mass: a mass of 1000.5 kg"),
            (SERIAL, &typed, roll, "feed_forward: is to hold "),
            (
                SERIAL,
                "{}",
                ", weight = 0.119, constant = 0.01",
                "robot[0].axis[4].controller.loop.feed_forward.constant: is the mean of a weight",
            ),
            (SERIAL, &four, roll, "robot[0].weight.masses: 4 masses for 5 links"),
            (
                SERIAL,
                "{ load = { mass = 6.0, centre = [0.0, 20.0, 0.2] } }",
                roll,
                "robot[0].weight.load.centre: a centre of mass at 20 m",
            ),
            (SERIAL, "{ load = { mass = nan, centre = [0.0, 0.0, 0.2] } }", roll, "must be a finite number"),
            (SERIAL, "{ up = [0.0, 0.0, 0.0] }", roll, "robot[0].weight.up: up has no direction"),
            (SERIAL, "{ mass = [] }", roll, "robot[0].weight.mass: is an unknown key"),
            (SERIAL, "{}", "", "robot[0].axis[4].controller.loop.feed_forward: lacks weight"),
            (SERIAL, "{}", ", weight = -0.1", "feed_forward.weight: is -0.1"),
            (IRB6, "{}", "", "robot[0].axis[0].drive.control: is position, by which the drive's own loop holds"),
        ];
        for (cell, weight, roll, refusal) in cases {
            let found = Cell::parse(&weighing(cell, weight, roll));
            let shown = found.map_or_else(|error| error.to_string(), |_| String::new());
            assert!(shown.contains(refusal) && shown.is_empty() == refusal.is_empty(), "{weight}{roll}: {shown}");
            assert!(!shown.contains('\n'), "{shown}");
        }
    }

    #[test]
    fn an_axis_that_is_to_hold_a_weight_nobody_told_is_refused() {
        let roll = "coulomb = 0.002381";
        for (weight, refusal) in [
            (0.0, None),
            (0.119, Some("robot[0].axis[4].controller.loop.feed_forward.weight: is for a robot that says")),
        ] {
            let cell = SERIAL.replacen(roll, &format!("{roll}, weight = {weight}"), 1);
            let found = Cell::parse(&cell).err().map(|error| error.to_string());
            assert_eq!(found.is_some(), refusal.is_some(), "{found:?}");
            assert!(found.iter().all(|it| refusal.is_some_and(|why| it.contains(why))));
        }
    }

    #[test]
    fn only_axes_of_a_robot_that_weighs_are_given_its_torques() {
        let factors = |text: &str| {
            let cell = Cell::parse(text).unwrap();
            let robot = &cell.robot[0];
            let limits = robot.kinematics().unwrap().motor_limits().to_vec();
            let factor = |axis: usize| match robot.servo_config(axis, 0, axis, limits[axis]).position_loop {
                servo::PositionLoop::Host(host) => host.feed_forward.weight,
                servo::PositionLoop::Drive => unreachable!("all of them are the host's"),
            };
            let factors: Vec<_> = (0..5).map(factor).collect();
            let torques = robot.arm().unwrap().torques(&robot.kinematics().unwrap().home().padded());
            (factors, torques.unwrap()[2])
        };
        assert_eq!(factors(SERIAL), (vec![None; 5], 0.0));
        let (factors, upper_arm) = factors(&weighing(SERIAL, "{}", ", weight = 0.119"));
        assert_eq!(factors, [1.0, 1.0, 1.0, 1.0, 0.119].map(Some));
        assert!((upper_arm + 0.397).abs() < 1e-3, "{upper_arm} N·m");
    }

    #[test]
    fn friction_at_break_away_is_refused_unless_it_is_greater_and_falls_somehow() {
        let good = "coulomb = 0.08 }";
        let cases = [
            ("coulomb = 0.08, stiction = 0.12, stribeck_velocity = 5.0", ""),
            (
                "coulomb = 0.08, stiction = 0.07, stribeck_velocity = 5.0",
                "feed_forward.stiction: is 0.07, must be between 0.08 and 2.1 (coulomb at the least",
            ),
            ("coulomb = 0.08, stiction = 0.12", "feed_forward.stiction: needs the velocity"),
            ("coulomb = 0.08, stribeck_velocity = 5.0", "feed_forward.stribeck_velocity: is for a friction"),
            (
                "coulomb = 0.08, stiction = 0.12, stribeck_velocity = 0.0",
                "feed_forward.stribeck_velocity: is 0, must be between 0.001 and",
            ),
        ];
        for (bad, refusal) in cases {
            let found = Cell::parse(&SERIAL.replacen(good, &format!("{bad} }}"), 1));
            let shown = found.map_or_else(|error| error.to_string(), |_| String::new());
            assert!(shown.contains(refusal) && shown.is_empty() == refusal.is_empty(), "{bad}: {shown}");
        }
    }
}
