//! Weight torques calculated by hand, and masses that are refused.

use super::*;

const G: f64 = 9.81;
const UP: [f64; 3] = [0.0, 0.0, 1.0];

fn load(mass: f64, centre: [f64; 3]) -> Mass {
    Mass { mass, centre }
}

#[test]
fn irp6_at_home_weighs_what_levers_say() {
    let robot = irp6p();
    // Upper arm and wrist are level, with 6 kg in the gripper. Levers of each mass from the elbow, and from the pitch
    // axis.
    let carried = load(6.0, [0.0, 0.0, 0.2]);
    let weight = Weight::new(&robot, &Mass::IRP6, carried, UP).unwrap();
    let found = weight.torque(&robot, &robot.home()).unwrap();
    // Motor angle per joint angle of the upper arm's screw in this posture (derived from public code).
    let gear = 175.1;
    let upper_arm = -G * (14.0 * 0.25 + (4.0 + 1.35 + 6.0) * 0.67) / gear;
    // The hand axis is level across the wrist, and the pitch motor also turns the roll axis.
    let across = G * (1.35 * 0.15 + 6.0 * 0.2) / 76.8;
    let pitch = G * (4.0 * 0.095 + (1.35 + 6.0) * 0.19) / 128.0 + across;
    let expected = [0.0, 0.0, upper_arm, pitch, -across, 0.0];
    for (axis, expected) in expected.into_iter().enumerate() {
        assert!((found[axis] - expected).abs() < 2e-4, "axis {axis}: {} for {expected} N·m", found[axis]);
    }
}

#[test]
fn a_robot_on_its_side_weighs_on_its_column() {
    let robot = irp6p();
    let weight = |up| Weight::new(&robot, &Mass::IRP6, Mass::default(), up).unwrap();
    let home = robot.home();
    let standing = weight(UP).torque(&robot, &home).unwrap();
    assert!(standing[0].abs() < 1e-9, "{standing:?}");
    // The y axis points up and is level in the robot: the masses lie ahead of the column. The column's motor turns in
    // the opposite direction, with a ratio of 158.
    let lying = weight([0.0, 5.0, 0.0]).torque(&robot, &home).unwrap();
    let ahead = 14.0 * 0.25 + 4.0 * 0.765 + 1.35 * 0.86;
    assert!((lying[0] + G * ahead / 158.0).abs() < 1e-6, "{lying:?}");
}

#[test]
fn torque_is_what_energy_says_in_every_pose_of_every_robot() {
    // The work along a straight motion of all motors equals the difference of the potential energies at its ends.
    for (name, robot) in robots() {
        let mut random = Random(SEED);
        let masses: Vec<_> = (0..robot.axes()).map(|link| load(2.0 + link as f64, [0.1, -0.05, 0.2])).collect();
        let weight = Weight::new(&*robot, &masses, load(1.0, [0.0, 0.1, 0.1]), [0.3, 0.1, 1.0]);
        let weight = weight.unwrap();
        for _ in 0..50 {
            let joints = random.joints(&*robot);
            let Ok(from) = robot.motors_from_joints(&joints) else {
                continue;
            };
            let mut middle = from;
            let mut to = from;
            for axis in 0..robot.axes() {
                middle[axis] += 0.05 * (axis as f64 - 2.0);
                to[axis] += 0.1 * (axis as f64 - 2.0);
            }
            let torque = weight.torque(&*robot, &middle).unwrap();
            let work: f64 = (0..robot.axes()).map(|axis| torque[axis] * (to[axis] - from[axis])).sum();
            let gained = weight.potential(&*robot, &to).unwrap() - weight.potential(&*robot, &from).unwrap();
            assert!((work - gained).abs() < 1e-5, "{name}: {work} for {gained} J");
        }
    }
}

#[test]
fn masses_of_no_such_robot_are_refused() {
    let robot = irp6p();
    let with = |change: fn(&mut [Mass; 6], &mut Mass, &mut [f64; 3])| {
        let (mut masses, mut carried, mut up) = (Mass::IRP6, Mass::default(), UP);
        change(&mut masses, &mut carried, &mut up);
        Weight::new(&robot, &masses, carried, up).err()
    };
    let mass = |link, mass| Some(WeightError::Mass { link, mass });
    let centre = |link, coordinate| Some(WeightError::Centre { link, coordinate });
    assert_eq!(with(|_, _, _| {}), None);
    assert_eq!(with(|m, _, _| m[2].mass = -1.0), mass(2, -1.0));
    assert_eq!(with(|m, _, _| m[5].mass = 1001.0), mass(5, 1001.0));
    assert_eq!(with(|_, c, _| c.mass = f64::INFINITY), mass(6, f64::INFINITY));
    assert!(matches!(with(|m, _, _| m[0].mass = f64::NAN), Some(WeightError::Mass { link: 0, .. })));
    assert_eq!(with(|m, _, _| m[1].centre[2] = -11.0), centre(1, -11.0));
    assert!(matches!(with(|_, c, _| c.centre[0] = f64::NAN), Some(WeightError::Centre { link: 6, .. })));
    for up in [0.0, 1e200, f64::NAN, f64::INFINITY] {
        let found = Weight::new(&robot, &Mass::IRP6, Mass::default(), [up; 3]);
        assert_eq!(found, Err(WeightError::Up), "{up}");
    }
    let count = WeightError::Count { links: 6, given: 5 };
    assert_eq!(Weight::new(&robot, &Mass::IRP6[..5], Mass::default(), UP), Err(count));
    let belt = LinearDevice::conveyor(&ConveyorParameters::belt()).unwrap();
    assert_eq!(Weight::new(&belt, &[], Mass::default(), UP), Err(WeightError::NoLinks));
}

#[test]
fn motors_that_are_nowhere_weigh_no_number() {
    let robot = irp6p();
    let weight = Weight::new(&robot, &Mass::IRP6, Mass::default(), UP).unwrap();
    let mut motors = robot.home();
    motors[3] = f64::NAN;
    assert_eq!(weight.torque(&robot, &motors), Err(KinematicsError::NotFinite));
    // A screw longer than its triangle.
    motors = robot.home();
    motors[1] = 1e4;
    assert!(weight.torque(&robot, &motors).is_err());
}
