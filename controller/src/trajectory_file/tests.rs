//! Trajectory files: round trip of random files, accepted forms, refusals by line, and motions.

use std::f64::consts::FRAC_PI_2;

use super::*;
use crate::generator::{EffectorImage, EffectorState, Generator, Pose, Setpoint};
use crate::random::Random;
use crate::robot::{Arm, RobotParameters as _};

/// A file with separators and empty lines as MRROC++ applications have.
const FILE: &str = "JOINT\n2\t\nABSOLUTE\n\t\t\n0.1\t\t0.2 \t1\n0.07 0.07, 0.07\n0.5\t-1.57 0.02\n\n0.1 0.1 0.1\n0.1 0.1 0.1\n\
                    0.25, -1.5, 1e-2";

fn below(random: &mut Random, bound: u64) -> usize {
    (random.next() % bound) as usize
}

#[test]
fn a_written_file_is_read_back_exactly() {
    for seed in 0..2_000 {
        let mut random = Random(seed);
        let coordinates = Coordinates::ALL[below(&mut random, 4)];
        let motion = MotionType::ALL[below(&mut random, 2)];
        let columns = 1 + below(&mut random, 8);
        let pose = |random: &mut Random| SmoothPose {
            position: std::array::from_fn(|_| {
                let finite = f64::from_bits(random.next());
                if finite.is_finite() { finite } else { random.within(0.0, 1.0) }
            }),
            velocity: std::array::from_fn(|_| 1.0 - random.within(0.0, 1.0)),
            acceleration: std::array::from_fn(|_| 1.0 - random.within(0.0, 1.0)),
        };
        let poses: Vec<SmoothPose> = (0..1 + below(&mut random, 5)).map(|_| pose(&mut random)).collect();
        let file = TrajectoryFile::new(coordinates, motion, columns, poses).unwrap();
        assert_eq!(TrajectoryFile::parse(&file.to_string()), Ok(file), "seed {seed}");
    }
}

#[test]
fn rows_are_separated_by_spaces_tabs_or_commas_and_empty_lines_are_ignored() {
    let file = TrajectoryFile::parse(FILE).unwrap();
    assert_eq!((file.coordinates(), file.motion()), (Coordinates::Joint, MotionType::Absolute));
    assert_eq!((file.columns(), file.poses().len()), (3, 2));
    assert_eq!(file.poses()[0].velocity[..3], [0.1, 0.2, 1.0]);
    assert_eq!(file.poses()[0].acceleration[..3], [0.07; 3]);
    assert_eq!(file.poses()[1].position[..3], [0.25, -1.5, 0.01]);
    assert_eq!(TrajectoryFile::parse(&FILE.replace('\n', "\r\n")), Ok(file));
}

#[test]
fn a_refused_file_is_refused_with_its_line() {
    use TrajectoryFileProblem as P;
    let head = "JOINT\n1\nABSOLUTE\n";
    let rows = |rows: &str| format!("{head}{rows}");
    let (ragged, coordinates) = (P::Ragged { columns: 1, expected: 2 }, PoseRow::Coordinates);
    let cases = [
        (String::new(), 1, P::NoHead),
        ("JOINT\n1\n".into(), 3, P::NoHead),
        ("joint\n1\nABSOLUTE\n".into(), 1, P::Coordinates),
        ("\nJOINT\nfour\nABSOLUTE\n".into(), 3, P::Count),
        ("JOINT\n0\nABSOLUTE\n".into(), 2, P::Count),
        ("JOINT\n-1\nABSOLUTE\n".into(), 2, P::Count),
        ("JOINT\n100001\nABSOLUTE\n".into(), 2, P::Count),
        ("JOINT\n1\nabsolute\n0.1 0.1\n0.1 0.1\n1 2\n".into(), 3, P::MotionType),
        ("MOTOR\n1\n2.5 1 2 3 4 5 6 7 8\n".into(), 3, P::TeachIn),
        (rows(""), 4, P::Ended { pose: 1, row: PoseRow::Velocities }),
        (rows("1 1\n1 1\n"), 6, P::Ended { pose: 1, row: coordinates }),
        (rows("1 1\n1 1\n0 0\njoints = absolute\n"), 7, P::Joints),
        ("JOINT\n2\nABSOLUTE\n1 1\n1 1\n0 0\n1 1\n1 1\n0\n".into(), 9, ragged),
        (rows("1 1 1 1 1 1 1 1 1\n"), 4, P::TooWide { columns: 9, max: 8 }),
        (rows(",\n"), 4, P::TooWide { columns: 0, max: 8 }),
        (rows("1 1\n1 1\n0 zero\n"), 6, P::Number { column: 2 }),
        (rows("1 1\n1 1\nnan 0\n"), 6, P::Number { column: 1 }),
        (rows("1 1\n1 1\n0 inf\n"), 6, P::Number { column: 2 }),
        (rows("1 0\n1 1\n0 0\n"), 4, P::Fraction { column: 2, value: 0.0 }),
        (rows("1 1\n-0.5 1\n0 0\n"), 5, P::Fraction { column: 1, value: -0.5 }),
        (rows("1 1.5\n1 1\n0 0\n"), 4, P::Fraction { column: 2, value: 1.5 }),
    ];
    for (text, line, problem) in cases {
        assert_eq!(TrajectoryFile::parse(&text), Err(TrajectoryFileError { line, problem }), "{text:?}");
    }
    let shown = TrajectoryFile::parse("JOINT\n1\nABSOLUTE\n1\n1\n").unwrap_err().to_string();
    assert!(shown.starts_with("6: the file ends before its coordinates of pose 1"), "{shown}");
}

#[test]
fn poses_that_no_file_can_have_are_not_written() {
    use TrajectoryFileProblem as P;
    let new =
        |columns, poses| TrajectoryFile::new(Coordinates::Motor, MotionType::Absolute, columns, poses).unwrap_err();
    let (sound, mut lost, mut greedy) =
        (SmoothPose::fast([0.0; 8]), SmoothPose::fast([0.0; 8]), SmoothPose::fast([0.0; 8]));
    lost.position[1] = f64::INFINITY;
    greedy.acceleration[0] = 2.0;
    assert_eq!(new(2, vec![]), TrajectoryFileError { line: 2, problem: P::Count });
    let wide = P::TooWide { columns: 9, max: 8 };
    assert_eq!(new(9, vec![sound]), TrajectoryFileError { line: 4, problem: wide });
    assert_eq!(new(2, vec![sound, lost]), TrajectoryFileError { line: 9, problem: P::Number { column: 2 } });
    let fraction = P::Fraction { column: 1, value: 2.0 };
    assert_eq!(new(2, vec![sound, greedy]), TrajectoryFileError { line: 8, problem: fraction });
    // An entry beyond the columns is not written.
    let file = TrajectoryFile::new(Coordinates::Motor, MotionType::Absolute, 1, vec![lost]).unwrap();
    assert_eq!(file.poses()[0].position, Axes::default());
}

/// Positions at the ends of all macrosteps, from `start`.
fn positions(mut motion: Newsmooth, start: Axes) -> Vec<Setpoint> {
    let axes = crate::generator::AxesState::at_rest(start);
    let image = EffectorImage::standing(EffectorState { motors: axes, joints: axes, pose: Pose::identity() });
    let mut memory = motion.first_step(&image, std::time::Duration::from_millis(20)).unwrap().memory;
    let mut setpoints = Vec::new();
    while !motion.terminal(&memory, &()) {
        let next = motion.next_step(&memory, &()).unwrap();
        setpoints.extend(next.effector);
        memory = next.memory;
    }
    setpoints
}

#[test]
fn a_file_becomes_the_newsmooth_motion_through_its_poses() {
    let (joints, motors) = (MotionLimits::uniform(1.5, 7.0, 70.0), MotionLimits::uniform(200.0, 150.0, 1500.0));
    let file = TrajectoryFile::parse(FILE).unwrap();
    let start = [0.3; 8];
    let expected = Newsmooth::new(Space::Joint, 3, joints, file.poses().to_vec()).unwrap();
    let motion = file.motion_of(3, joints, motors).unwrap();
    assert_eq!(positions(motion, start), positions(expected, start));

    let relative = TrajectoryFile::parse(&FILE.replace("JOINT", "MOTOR").replace("ABSOLUTE", "RELATIVE")).unwrap();
    let motion = relative.motion_of(3, joints, motors).unwrap();
    let Some(Setpoint::Motors(end)) = positions(motion, start).pop() else { panic!("a motion of motors") };
    for (axis, by) in [0.75, -3.07, 0.03].into_iter().enumerate() {
        assert!((end.position[axis] - start[axis] - by).abs() < 1e-12, "axis {axis}");
    }
}

#[test]
fn a_file_of_another_robot_or_of_the_tool_is_refused() {
    let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    let file = TrajectoryFile::parse(FILE).unwrap();
    let other = file.motion_of(6, limits, limits).unwrap_err();
    assert_eq!(other, TrajectoryError::OtherRobot { columns: 3, axes: 6 });
    let tool = TrajectoryFile::parse(&FILE.replace("JOINT", "XYZ_EULER_ZYZ")).unwrap();
    let refused = tool.motion_of(3, limits, limits).unwrap_err();
    assert_eq!(refused, TrajectoryError::Tool { coordinates: Coordinates::XyzEulerZyz });
    let mut slack = limits;
    slack.max_velocity[0] = 0.0;
    let refused = file.motion_of(3, slack, limits).unwrap_err();
    assert_eq!(refused, TrajectoryError::Generator(GeneratorError::Limit { axis: 0 }));
}

/// A file that is accepted for a robot of this number of axes, with its notes.
#[track_caller]
fn read(text: &str, axes: usize) -> (TrajectoryFile, Vec<TrajectoryNote>) {
    let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    let (file, notes) = TrajectoryFile::read(text, axes).unwrap();
    file.motion_of(axes, limits, limits).unwrap();
    (file, notes)
}

#[test]
fn rows_and_columns_that_mrroc_ignored_are_ignored_with_a_note() {
    use TrajectoryNote as N;
    // The fractions have a column for the gripper, and a spare pose lies behind the count.
    let text =
        "MOTOR\n1\nABSOLUTE\n0.1 0.1 0.1 0.1 0.1 0.1 0\n0.2 0.2 0.2 0.2 0.2 0.2 1\n1 2 3 4 5 6\n\n0.1 0.1\nend\n";
    let (file, notes) = read(text, 6);
    assert_eq!((file.columns(), file.poses().len()), (6, 1));
    let spare = N::SpareRows { line: 8, rows: 2, poses: 1 };
    assert_eq!(notes, [spare, N::SpareColumns { columns: 7, used: 6 }]);
    assert!(spare.to_string().starts_with("lines from 8 on (2) are ignored"), "{spare}");
    // A seventh coordinate, and a row of more columns than any robot has axes.
    let wide = "MOTOR\n1\nABSOLUTE\n1 1 1 1 1 1 1\n1 1 1 1 1 1 0 x\n1 2 3 4 5 6 nan 8 9\n";
    assert_eq!(read(wide, 6).1, [N::SpareColumns { columns: 9, used: 6 }]);
    // Six columns for a robot of five axes belong to the IRp-6.
    let six = TrajectoryFile::read("MOTOR\n1\nABSOLUTE\n1 1 1 1 1 1\n1 1 1 1 1 1\n1 2 3 4 5 6\n", 5).unwrap().0;
    let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    let refused = six.motion_of(5, limits, limits).unwrap_err();
    assert_eq!(refused, TrajectoryError::OtherRobot { columns: 6, axes: 5 });
}

#[test]
fn a_file_of_a_format_before_2010_is_read() {
    use TrajectoryNote as N;
    let old = "JOINT\n1\n\n0.5 0.5 0.5 0.5 0.5 0.5 0.5 1.0\n0.2 0.2 0.2 0.2 0.2 0.2 0.2 0.5\n-1 -2 3 4 5 6 0.074 0.0\n";
    let oldest = old.replace("\n\n", "\n0 0 0 0 0 0 0 0\n0 0 0 0 0 0 0 0\n");
    let wide = N::SpareColumns { columns: 8, used: 6 };
    for (text, expected) in [
        (old, vec![N::OlderFormat, wide]),
        (&oldest, vec![N::OlderFormat, N::EndVelocities, wide]),
        // The words do not change what the file tells.
        (&old.replace("JOINT", "MOTOR"), vec![N::OlderFormat, wide]),
    ] {
        let (file, notes) = read(text, 6);
        assert_eq!(notes, expected, "{text}");
        assert_eq!(file.motion(), MotionType::Absolute);
        assert_eq!(file.poses()[0].velocity[..2], [0.5; 2]);
        assert_eq!(file.poses()[0].position[..3], [-1.0, -2.0, 3.0]);
        let joints = (file.coordinates() == Coordinates::Joint).then_some(JointConvention::Inclination);
        assert_eq!(file.joints(), joints);
        assert_eq!(TrajectoryFile::parse(&file.to_string()), Ok(file), "a written file tells it as well");
    }
}

/// The IRp-6 with a tool.
fn irp6() -> Arm {
    let robot = crate::robot::Irp6Parameters::irp6p().robot().unwrap();
    Arm::new(robot, Pose::translation(0.0, 0.0, 0.25))
}

/// A JOINT file of positions with this one pose.
fn joint_file(position: [f64; 6]) -> TrajectoryFile {
    let mut all = [0.0; 8];
    all[..6].copy_from_slice(&position);
    TrajectoryFile::new(Coordinates::Joint, MotionType::Absolute, 6, vec![SmoothPose::fast(all)]).unwrap()
}

#[test]
fn relative_joints_become_the_inclinations_of_the_same_posture() {
    // The relative joints of the table of Denavit and Hartenberg: th3 = q3 + q2 + 90 degrees, th4 = q4 + th3.
    let inclinations = [0.1, -1.3, 0.2, 0.7, 1.5, -0.4];
    let relative = [0.1, -1.3, 0.2 + 1.3 - FRAC_PI_2, 0.5, 1.5, -0.4];
    let arm = irp6();
    let near = |found: &Axes, expected: [f64; 6]| {
        assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
    };
    let read = joint_file(relative).for_arm(&arm, Some(JointConvention::Relative)).unwrap();
    near(&read.poses()[0].position, inclinations);
    assert_eq!(read.joints(), Some(JointConvention::Inclination));
    let same = joint_file(inclinations).for_arm(&arm, Some(JointConvention::Inclination)).unwrap();
    near(&same.poses()[0].position, inclinations);
    let mut padded = [0.0; 8];
    padded[..6].copy_from_slice(&inclinations);
    near(&JointConvention::Relative.of_inclinations(&padded, 1, MotionType::Absolute), relative);
    // Displacements have no constant: th2 and q3 by 0.1 turn th3 by 0.2, and with q4 by 0.1 they turn th4 by 0.3.
    let by =
        JointConvention::Relative.to_inclinations(&[0.0, 0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0], 1, MotionType::Relative);
    near(&by, [0.0, 0.1, 0.2, 0.3, 0.0, 0.0]);
    // The track comes first.
    let track = crate::robot::Irp6TrackParameters::irp6ot().robot().unwrap();
    assert_eq!((track.lower_arm(), arm.robot().lower_arm()), (Some(2), Some(1)));
}

#[test]
fn a_joint_file_without_a_convention_is_refused_with_both_readings() {
    let arm = irp6();
    let file = joint_file([0.1, -1.3, 0.2, 0.7, 1.5, -0.4]);
    let refused = file.for_arm(&arm, None).unwrap_err().to_string();
    for part in ["joints = \"inclination\" gives", "-1.3000 0.2000 0.7000", "joints = \"relative\" gives", "tool at"] {
        assert!(refused.contains(part), "{part}: {refused}");
    }
    // Where the convention can be set depends on the caller, which adds the place.
    assert!(refused.ends_with("those taught by mrroc are inclinations"), "{refused}");
    let told = file.clone().telling(JointConvention::Relative);
    assert_eq!(TrajectoryFile::parse(&told.to_string()), Ok(told.clone()));
    assert!(told.to_string().ends_with("\njoints = relative\n"), "{told}");
    let contradicted = told.for_arm(&arm, Some(JointConvention::Inclination)).unwrap_err();
    let (told, given) = (JointConvention::Relative, JointConvention::Inclination);
    assert_eq!(contradicted, TrajectoryError::Contradiction { told, given });
    // Where both readings are the same, none is asked for: an upright arm, and motors.
    let upright = joint_file([0.5, -FRAC_PI_2, 0.0, 0.0, 1.0, 2.0]);
    assert!(upright.for_arm(&arm, None).is_ok());
    let motors = TrajectoryFile::parse("MOTOR\n1\nABSOLUTE\n1 1 1 1 1 1\n1 1 1 1 1 1\n1 2 3 4 5 6\n").unwrap();
    assert_eq!(motors.for_arm(&arm, None), Ok(motors));
}

#[test]
fn a_file_with_two_conventions_is_refused_with_both_lines() {
    let of = |lines: &str| TrajectoryFile::parse(&format!("JOINT\n1\nABSOLUTE\n1 1\n1 1\n0 0\n{lines}"));
    let refused = of("joints = relative\n\n1 1\njoints = \"inclination\"\n").map_err(|error| error.to_string());
    let problem = "10: joints = inclination contradicts line 7, joints = relative: remove one of the two lines";
    assert_eq!(refused, Err(problem.to_owned()));
    let twice = of("joints = relative\njoints = relative\n").unwrap();
    assert_eq!(twice.joints(), Some(JointConvention::Relative));
}

#[test]
fn poses_of_the_tool_and_of_motors_are_converted_to_the_joints_that_reach_them() {
    let arm = irp6();
    let joints = [[0.1, -1.3, 0.2, 0.7, 1.5, -0.4, 0.0, 0.0], [0.3, -1.4, 0.1, 0.6, 1.2, -0.2, 0.0, 0.0]];
    let start = arm.joints(&arm.robot().home().padded()).unwrap();
    let near = |file: &TrajectoryFile, what: &str| {
        assert_eq!((file.coordinates(), file.motion()), (Coordinates::Joint, MotionType::Absolute));
        assert_eq!(TrajectoryFile::parse(&file.to_string()), Ok(file.clone()));
        for (pose, expected) in file.poses().iter().zip(joints) {
            for (found, expected) in pose.position.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{what}: {:?} for {expected:?}", pose.position);
            }
        }
    };
    let poses = joints.map(|joints| arm.forward(&joints).unwrap());
    let six = |of: &Pose, turn: [f64; 3]| {
        let place = of.translation.vector;
        let [a, b, c] = turn;
        let mut pose = SmoothPose::fast([place.x, place.y, place.z, a, b, c, 0.0, 0.0]);
        pose.velocity = [0.5, 0.2, 0.4, 0.5, 0.5, 0.5, 0.1, 0.1];
        pose
    };
    let zyz = |of: &Pose| {
        let m = of.rotation.to_rotation_matrix();
        let b = m[(0, 2)].hypot(m[(1, 2)]).atan2(m[(2, 2)]);
        [m[(1, 2)].atan2(m[(0, 2)]), b, m[(2, 1)].atan2(-m[(2, 0)])]
    };
    let axis = |of: &Pose| of.rotation.scaled_axis().into();
    let file = |coordinates, motion, poses| TrajectoryFile::new(coordinates, motion, 6, poses).unwrap();
    let [first, second] = poses;
    let first_by = arm.forward(&start).unwrap().inverse() * first;
    let second_by = first.inverse() * second;
    for (coordinates, motion, poses) in [
        (Coordinates::XyzEulerZyz, MotionType::Absolute, vec![six(&first, zyz(&first)), six(&second, zyz(&second))]),
        (Coordinates::XyzAngleAxis, MotionType::Absolute, vec![six(&first, axis(&first)), six(&second, axis(&second))]),
        (
            Coordinates::XyzAngleAxis,
            MotionType::Relative,
            vec![six(&first_by, axis(&first_by)), six(&second_by, axis(&second_by))],
        ),
    ] {
        let converted = file(coordinates, motion, poses).to_joints(&arm, None, &start).unwrap();
        near(&converted, coordinates.keyword());
        assert_eq!(converted.poses()[0].velocity[..6], [0.2; 6], "the least fraction of the six");
        assert_eq!(converted.joints(), Some(JointConvention::Inclination));
    }
    let motors = joints.map(|joints| SmoothPose::fast(arm.motors(&joints).unwrap()));
    let motors = file(Coordinates::Motor, MotionType::Absolute, motors.to_vec());
    near(&motors.to_joints(&arm, None, &start).unwrap(), "motors");
    let far = file(Coordinates::XyzAngleAxis, MotionType::Absolute, vec![SmoothPose::fast([9.0; 8])]);
    let refused = far.to_joints(&arm, None, &start).unwrap_err().to_string();
    assert!(refused.starts_with("pose 1: pose is "), "{refused}");
}
