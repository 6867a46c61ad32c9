//! Refusals of robots, and the limits at which they begin.

use KinematicsError::{AxisCount, BeyondLimit, NotFinite, Singular, ToolPlane};

use super::*;

fn refusal(robot: &dyn Robot, pose: &Isometry3<f64>, near: &Joints) -> KinematicsError {
    robot.inverse(pose, near).unwrap_err()
}

#[test]
fn a_pose_out_of_reach_names_what_is_missing() {
    let six = Joints::from([0.0, -1.5, 0.0, 0.0, FRAC_PI_2, 0.0]);
    let five = Joints::from([0.0, -1.5, 0.0, 0.0, 0.0]);
    let reversed = Joints::from([0.0, -1.5, 0.0, 0.0, -FRAC_PI_2, 0.0]);
    let cases: [(&dyn Robot, Joints, f64, f64, f64); 4] = [
        (&irp6p(), six, 1.5, 0.0, 1.5 - 0.19 - 1.125),
        (&irp6p(), reversed, 1.5, 0.0, 1.5 - 0.19 - 1.125),
        (&irb6(), five, 1.5, 0.7, 1.5 - 0.095 - 1.125),
        (&irb6(), five, 0.2, 0.7, 0.215 - (0.2 - 0.095)),
    ];
    for (robot, near, x, z, margin) in cases {
        let level = robot.forward(&near).unwrap().rotation;
        let pose = Isometry3::from_parts(Vector3::new(x, 0.0, z).into(), level);
        match refusal(robot, &pose, &near) {
            KinematicsError::Unreachable { margin: found } => {
                assert!((found - margin).abs() < 1e-12, "{found} instead of {margin}");
            }
            other => panic!("{other}"),
        }
        let mut elsewhere = near;
        elsewhere[0] = -2.9;
        elsewhere[3] = 1.5;
        assert_eq!(refusal(robot, &pose, &elsewhere), refusal(robot, &pose, &near));
    }
}

#[test]
fn numbers_that_place_no_robot_are_refused() {
    for (name, robot) in robots() {
        let axes = robot.axes();
        let home = robot.joints_from_motors(&robot.home()).unwrap();
        let pose = robot.forward(&home).unwrap();
        let mut spoilt = home;
        spoilt[1] = f64::NAN;
        let short = Joints::from([0.0; 3]);
        let count = AxisCount { axes: axes as u8, given: 3 };
        for (joints, error) in [(spoilt, NotFinite), (short, count)] {
            let motors = Motors::new(&joints).unwrap();
            assert_eq!(robot.forward(&joints).unwrap_err(), error, "{name}");
            assert_eq!(robot.jacobian(&joints).unwrap_err(), error, "{name}");
            assert_eq!(robot.singularity(&joints).unwrap_err(), error, "{name}");
            assert_eq!(robot.motors_from_joints(&joints).unwrap_err(), error, "{name}");
            assert_eq!(robot.joints_from_motors(&motors).unwrap_err(), error, "{name}");
            assert_eq!(refusal(&*robot, &pose, &joints), error, "{name}");
        }
        let mut lost = pose;
        lost.translation.vector.y = f64::NAN;
        assert_eq!(refusal(&*robot, &lost, &home), NotFinite, "{name}");
        assert_eq!(robot.joint_limits().len(), axes);
        assert_eq!(robot.motor_limits().len(), axes);
    }
    for (name, robot) in determined() {
        let home = robot.joints_from_motors(&robot.home()).unwrap();
        let mut over = robot.forward(&home).unwrap();
        over.translation.vector.x = 0.0;
        over.translation.vector.y = 0.0;
        assert_eq!(refusal(&*robot, &over, &home), Singular { axis: 0, margin: 0.0 }, "{name}");
    }
}

#[test]
fn a_tool_axis_out_of_the_arms_plane_is_refused_with_its_lean() {
    let (robot, near) = (irb6(), Joints::from([0.0, -1.5, 0.1, 0.2, 0.0]));
    let pose = robot.forward(&near).unwrap();
    for angle in [0.1, -0.1_f64, 1e-5] {
        let lean = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
        let leaning = Isometry3::from_parts(pose.translation, lean * pose.rotation);
        let ToolPlane { residual } = refusal(&robot, &leaning, &near) else { panic!("{angle}") };
        assert!((residual - angle.sin() * 0.2_f64.cos()).abs() < 1e-12, "{residual}");
    }
}

#[test]
fn joints_and_motors_past_a_limit_are_named() {
    let robot = irp6p();
    let stand = [0.0, -1.5, 0.0, 0.0, 1.0, 0.0];
    let deg = f64::to_radians;
    // The motors limit the column, the outward motion of the arms, and the roll.
    for (axis, value, space, limit) in [
        (0, 2.98, Space::Joint, deg(170.0)),
        (0, 2.95, Space::Motor, -470.0),
        (0, -2.95, Space::Motor, 450.0),
        (1, -2.3, Space::Joint, deg(-130.0)),
        (1, -0.8, Space::Joint, deg(-50.0)),
        (2, -0.5, Space::Joint, deg(-25.0)),
        (2, 0.7, Space::Joint, deg(40.0)),
        (3, 1.58, Space::Joint, deg(90.0)),
        (3, -1.58, Space::Joint, deg(-90.0)),
        (4, 10.1, Space::Joint, 10.0),
        (4, -1.0, Space::Motor, 490.0),
        (4, 6.8, Space::Motor, -80.0),
        (5, 2.94, Space::Joint, 2.93),
        (5, -2.89, Space::Joint, -2.88),
    ] {
        let mut joints = Joints::from(stand);
        joints[axis] = value;
        match robot.motors_from_joints(&joints) {
            Err(BeyondLimit { space: found, axis: named, value: told, limit: passed }) => {
                assert_eq!((found, usize::from(named)), (space, axis), "{value}");
                assert!((passed - limit).abs() < 1e-12, "{axis} {value}: {passed}");
                if space == Space::Joint {
                    assert_eq!(told, value);
                }
            }
            other => panic!("axis {axis} at {value}: {other:?}"),
        }
    }
}

#[test]
fn a_pose_past_a_limit_is_refused_for_the_branch_nearest_to_the_robot() {
    let robot = irp6p();
    for (axis, value) in [(0, 2.95), (1, -2.3), (2, 0.75), (3, 1.65), (5, 3.0)] {
        let mut joints = Joints::from([0.0, -1.5, 0.0, 0.0, 1.0, 0.0]);
        joints[axis] = value;
        let pose = robot.forward(&joints).unwrap();
        match refusal(&robot, &pose, &joints) {
            BeyondLimit { axis: named, .. } => assert_eq!(usize::from(named), axis),
            other => panic!("axis {axis} at {value}: {other}"),
        }
    }
}

#[test]
fn a_screw_no_triangle_can_have_is_refused() {
    let robot = irp6p();
    for motor in [400.0, -170.0, -400.0] {
        let mut motors = robot.home();
        motors[1] = motor;
        match robot.joints_from_motors(&motors) {
            Err(BeyondLimit { space: Space::Motor, axis: 1, value, limit }) => {
                assert_eq!(value, motor);
                motors[1] = limit - limit.signum() * 1e-6;
                assert!(robot.joints_from_motors(&motors).is_ok(), "{limit}");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn limits_themselves_can_be_reached() {
    let robot = irp6p();
    let stand = Joints::from([0.0, -1.5, 0.0, 0.3, 3.0, 0.0]);
    let motors = robot.motors_from_joints(&stand).unwrap();
    for axis in 0..robot.axes() {
        let (joint, motor) = (robot.joint_limits()[axis], robot.motor_limits()[axis]);
        let mut ends = vec![joint.low, joint.high];
        for limit in [motor.low, motor.high] {
            let mut motors = motors;
            motors[axis] = limit;
            ends.push(robot.joints_from_motors(&motors).unwrap()[axis]);
        }
        let mut reached = 0;
        for end in ends {
            let mut joints = stand;
            joints[axis] = end;
            if robot.motors_from_joints(&joints).is_ok() {
                reached += 1;
                let pose = robot.forward(&joints).unwrap();
                let solved = robot.inverse(&pose, &joints).unwrap();
                assert!(largest_difference(solved.preferred(), &joints) < 1e-9, "{axis} {end}");
            }
        }
        assert_eq!(reached, 2, "of the ends of axis {axis} one on each side is the tighter");
    }
}

#[test]
fn parameters_that_make_no_robot_are_refused() {
    use ParameterError::{AmbiguousScrew, EmptyRange, NoRatio, NotFinite, NotPositive};
    type Change = fn(&mut Irp6Parameters);
    let cases: [(Change, ParameterError); 8] = [
        (|p| p.arm.shoulder_height = f64::NAN, NotFinite { name: "shoulder_height" }),
        (|p| p.arm.wrist_length = 0.0, NotPositive { name: "wrist_length", value: 0.0 }),
        (|p| p.arm.column.ratio = 0.0, NoRatio { name: "column" }),
        (|p| p.hand.motor_at_home = f64::INFINITY, NotFinite { name: "hand" }),
        (|p| p.arm.lower_arm.lead = 0.0, NoRatio { name: "lower_arm" }),
        (|p| p.arm.lower_arm.squared = 0.01, AmbiguousScrew { name: "lower_arm" }),
        (|p| p.arm.upper_arm.joint_limits.high = 2.5, AmbiguousScrew { name: "upper_arm" }),
        (
            |p| p.arm.pitch.motor_limits = Limits { low: 1.0, high: 1.0 },
            EmptyRange { name: "pitch", low: 1.0, high: 1.0 },
        ),
    ];
    for (change, error) in cases {
        let mut parameters = Irp6Parameters::irp6p();
        change(&mut parameters);
        assert_eq!(Irp6::new(&parameters), Err(error));
    }
    let slack = Irb6Parameters { tool_plane_tolerance: 0.0, ..Irb6Parameters::irb6() };
    let error = NotPositive { name: "tool_plane_tolerance", value: 0.0 };
    assert_eq!(Irb6::new(&slack), Err(error));
}

#[test]
fn parameters_survive_the_cell_file_and_refuse_unknown_names() {
    let text = toml::to_string(&Irp6Parameters::irp6p_calibrated()).unwrap();
    assert_eq!(toml::from_str(&text), Ok(Irp6Parameters::irp6p_calibrated()));
    let text = text.replace("wrist_length", "wirst_length");
    assert!(toml::from_str::<Irp6Parameters>(&text).is_err());
}
