//! Trajectory files: round trip of random files, accepted forms, refusals by line, and motions.

use super::*;
use crate::generator::{EffectorImage, EffectorState, Generator, Pose, Setpoint};
use crate::random::Random;

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
        ("JOINT\n1\n\n0.1 0.1\n0.1 0.1\n1 2\n".into(), 4, P::MotionType),
        (rows(""), 4, P::Ended { pose: 1, row: PoseRow::Velocities }),
        (rows("1 1\n1 1\n"), 6, P::Ended { pose: 1, row: coordinates }),
        (rows("1 1\n1 1\n0 0\n\n1 1\n"), 8, P::Excess { poses: 1 }),
        (rows("1 1\n\n1\n0 0\n"), 6, ragged),
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
