//! Contours of the IRp-6, and the reference letter.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::path::{BSpline, Curve, Path, PoseState, SplineEnds};
use crate::robot::{Arm, Irp6, Irp6Parameters};

const LIMITS: FeedLimits = FeedLimits {
    max_velocity: 0.1,
    max_acceleration: 1.0,
    max_jerk: 20.0,
    max_normal_acceleration: 1.0,
    max_angular_velocity: 1.0,
    max_angular_acceleration: 4.0,
};

/// Joints in the middle of the IRp-6's workspace, the wrist bent.
const BENT: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];

fn joint_limits() -> MotionLimits {
    MotionLimits::uniform(1.5, 7.0, 70.0)
}

fn irp6() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25))
}

/// The arm at standstill in the middle of its workspace.
fn standing(arm: &Arm) -> (EffectorImage, Pose) {
    let (joints, pose) = (AxesState::at_rest(BENT), arm.forward(&BENT).unwrap());
    (EffectorImage::standing(EffectorState { motors: joints, joints, pose }), pose)
}

/// The reference letter from the pose on, in the xy plane of the base.
fn letter(start: &Pose) -> Path {
    let points = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];
    let point = |(x, y)| start.translation.vector + Vector3::new(f64::from(x), f64::from(y), 0.0) * 1e-3;
    let spline = BSpline::through(&points.map(point), SplineEnds::NotAKnot).unwrap();
    Path::keeping(Curve::spline(spline).unwrap(), start.rotation).unwrap()
}

/// A straight path of the tool, which turns.
fn line(start: &Pose, by: Vector3<f64>, turn: Vector3<f64>) -> Path {
    let from = start.translation.vector;
    let to = UnitQuaternion::from_scaled_axis(turn) * start.rotation;
    Path::turning(Curve::line(from, from + by).unwrap(), start.rotation, to).unwrap()
}

fn contour(arm: &Arm, path: &Path, limits: FeedLimits) -> Contour {
    Contour::along(arm.clone(), path.clone(), limits, joint_limits()).unwrap()
}

/// The commanded states at all macrostep ends, beginning with the start.
fn commanded(contour: &mut Contour, image: &EffectorImage) -> Result<Vec<PoseState>, GeneratorError> {
    assert_eq!(contour.state(0), None, "nothing is planned yet");
    let mut memory = contour.first_step(image, MACROSTEP)?.memory;
    let mut states = vec![contour.state(0).unwrap()];
    while !contour.terminal(&memory, &()) {
        let next = contour.next_step(&memory, &()).unwrap();
        memory = next.memory;
        let state = contour.state(memory).unwrap();
        assert_eq!(next.effector, Some(Setpoint::Tool(state)));
        states.push(state);
    }
    Ok(states)
}

/// Position between two macrostep ends, at a share of the time from 0 to 1.
type Interpolation = fn(&PoseState, &PoseState, f64) -> Vector3<f64>;

/// Position between two macrostep ends: the cubic through position and velocity.
fn cubic(from: &PoseState, to: &PoseState, u: f64) -> Vector3<f64> {
    let (h1, h2) = (u * u * (3.0 - 2.0 * u), MC * u * u * (u - 1.0));
    let (h0, h3) = (1.0 - h1, MC * u * (1.0 - u) * (1.0 - u));
    from.pose.translation.vector * h0 + to.pose.translation.vector * h1 + from.linear * h3 + to.linear * h2
}

/// Position between two macrostep ends: the quintic that fits the acceleration as well.
fn quintic(from: &PoseState, to: &PoseState, u: f64) -> Vector3<f64> {
    // Difference of the accelerations from those of the cubic.
    let distance = to.pose.translation.vector - from.pose.translation.vector;
    let start = from.linear_acceleration - (distance * 6.0 / MC - from.linear * 4.0 - to.linear * 2.0) / MC;
    let end = to.linear_acceleration - (distance * -6.0 / MC + from.linear * 2.0 + to.linear * 4.0) / MC;
    let square = MC * MC / 2.0 * u * u * (1.0 - u) * (1.0 - u);
    cubic(from, to, u) + start * (square * (1.0 - u)) + end * (square * u)
}

/// Distance of a position from a path, near the arc length `s`.
fn aside(path: &Path, position: &Vector3<f64>, mut s: f64) -> f64 {
    for _ in 0..20 {
        let near = path.at(s);
        let offset = position - near.pose.translation.vector;
        let slope = 1.0 - offset.dot(&near.linear_acceleration);
        s = (s + offset.dot(&near.linear) / slope.max(0.5)).clamp(0.0, path.length());
    }
    (position - path.at(s).pose.translation.vector).norm()
}

#[test]
fn the_reference_letter_is_within_1_um_and_0_1_percent_of_feed_on_interpolated_setpoints() {
    let arm = irp6();
    let (image, start) = standing(&arm);
    let path = letter(&start);
    for (feed, acceleration, jerk) in [(0.010, 0.05, 0.5), (0.020, 0.1, 1.0), (0.050, 0.5, 25.0)] {
        let limits = FeedLimits {
            max_velocity: feed,
            max_acceleration: acceleration,
            max_jerk: jerk,
            max_normal_acceleration: acceleration,
            ..LIMITS
        };
        let mut contour = contour(&arm, &path, limits);
        let states = commanded(&mut contour, &image).unwrap();
        let profile = contour.feed().unwrap();
        // Cubics are too far off at 50 mm/s: 1.1 µm and 0.3 % of the feed.
        let cubics = (feed < 0.050).then_some(("cubic", cubic as Interpolation));
        for (name, interpolate) in cubics.into_iter().chain([("quintic", quintic as Interpolation)]) {
            let (mut contour_error, mut beyond_chord, mut fluctuation): (f64, f64, f64) = (0.0, 0.0, 0.0);
            let (mut periods, mut at_feed) = (0, 0);
            for (done, pair) in states.windows(2).enumerate() {
                for period in 0..10 {
                    let time = (done as f64 + f64::from(period) / 10.0) * MC;
                    let [from, to] = [time, time + MC / 10.0].map(|time| profile.at(time));
                    let [begin, end] =
                        [period, period + 1].map(|p| interpolate(&pair[0], &pair[1], f64::from(p) / 10.0));
                    contour_error = contour_error.max(aside(&path, &end, to.distance));
                    // Between two set-points the drive moves on a chord.
                    let sharpest = (0..4).map(|part| {
                        let at = |part: i32| from.distance + (to.distance - from.distance) * f64::from(part) / 4.0;
                        path.curve().max_curvature(at(part), at(part + 1))
                    });
                    let bound = sharpest.fold(0.0, f64::max) * (to.distance - from.distance).powi(2) / 8.0;
                    let middle = (begin + end) / 2.0;
                    let off = aside(&path, &middle, (from.distance + to.distance) / 2.0);
                    beyond_chord = beyond_chord.max(off - bound);
                    periods += 1;
                    let beside = (end - begin).norm() - (to.distance - from.distance);
                    fluctuation = fluctuation.max(beside.abs() / (feed * MC / 10.0));
                    let cruises = [from, to].iter().all(|state| (state.velocity / feed - 1.0).abs() < 1e-9);
                    at_feed += u32::from(cruises);
                }
            }
            println!(
                "{name} at {:.0} mm/s: contour error {:.3} µm, beyond the chord {:.3} µm, feed fluctuation {:.4} %, \
                 {at_feed} of {periods} periods at the feed",
                feed * 1e3,
                contour_error * 1e6,
                beyond_chord * 1e6,
                fluctuation * 1e2
            );
            assert!(contour_error < 1e-6, "{name} {feed}: {contour_error}");
            assert!(beyond_chord < 1e-6, "{name} {feed}: {beyond_chord}");
            assert!(fluctuation < 1e-3, "{name} {feed}: {fluctuation}");
            assert!(at_feed * 5 > periods, "{name} {feed}: {at_feed} of {periods}");
        }
    }
}

#[test]
fn a_contour_ends_exactly_and_its_velocity_and_acceleration_are_those_of_its_poses() {
    let arm = irp6();
    let (image, start) = standing(&arm);
    let path = line(&start, Vector3::new(0.06, -0.08, 0.03), Vector3::new(0.1, 0.3, 0.2));
    let mut contour = contour(&arm, &path, LIMITS);
    let states = commanded(&mut contour, &image).unwrap();
    let end = path.at(path.length()).pose;
    let last = states.last().unwrap();
    assert_eq!((last.pose, last.linear, last.angular), (end, Vector3::zeros(), Vector3::zeros()));
    let profile = contour.feed().unwrap();
    for (done, state) in states.iter().enumerate() {
        let h = 1e-5;
        let near = [-h, h].map(|by| {
            let state = profile.at(done as f64 * MC + by);
            path.moving_at(state.distance, state.velocity, state.acceleration)
        });
        let moved = near[1].pose.translation.vector - near[0].pose.translation.vector;
        let turned = (near[1].pose.rotation * near[0].pose.rotation.inverse()).scaled_axis();
        assert!((moved / (2.0 * h) - state.linear).norm() < 1e-8, "{done}");
        assert!((turned / (2.0 * h) - state.angular).norm() < 1e-8, "{done}");
        assert!(((near[1].linear - near[0].linear) / (2.0 * h) - state.linear_acceleration).norm() < 1e-3, "{done}");
        let change = (near[1].angular - near[0].angular) / (2.0 * h);
        assert!((change - state.angular_acceleration).norm() < 1e-2, "{done}");
    }
}

#[test]
fn a_contour_takes_the_duration_of_its_feed_in_whole_macrosteps() {
    let arm = irp6();
    let (image, start) = standing(&arm);
    let path = line(&start, Vector3::new(0.0, 0.1, 0.0), Vector3::zeros());
    let states = commanded(&mut contour(&arm, &path, LIMITS), &image).unwrap();
    // D/v + v/a + a/j, rounded up.
    let time: f64 = 0.1 / 0.1 + 0.1 / 1.0 + 1.0 / 20.0;
    assert_eq!(states.len() - 1, (time / MC).ceil() as usize);
}

#[test]
fn an_axis_beyond_its_limit_slows_the_contour() {
    let arm = irp6();
    let (image, start) = standing(&arm);
    let path = letter(&start);
    let limits = FeedLimits { max_velocity: 0.1, max_acceleration: 5.0, max_normal_acceleration: 5.0, ..LIMITS };
    let free = commanded(&mut contour(&arm, &path, limits), &image).unwrap();
    let weak = MotionLimits::uniform(0.05, 0.5, 70.0);
    let mut slowed = Contour::along(arm.clone(), path, limits, weak).unwrap();
    let slow = commanded(&mut slowed, &image).unwrap();
    assert!(slow.len() > 2 * free.len(), "{} and {}", slow.len(), free.len());
    let mut joints = vec![BENT];
    for state in &slow[1..] {
        joints.push(arm.inverse(&state.pose, joints.last().unwrap()).unwrap());
    }
    let mut largest: f64 = 0.0;
    for three in joints.windows(3) {
        for (axis, here) in three[1].iter().enumerate() {
            let (behind, ahead) = (here - three[0][axis], three[2][axis] - here);
            let (speed, push) = (behind / MC, (ahead - behind) / (MC * MC));
            largest = largest.max(speed.abs() / weak.max_velocity[axis]).max(push.abs() / weak.max_acceleration[axis]);
        }
    }
    assert!(largest < 1.005 && largest > 0.9, "{largest}");
}

#[test]
fn a_contour_that_the_arm_cannot_follow_is_refused_before_the_motion() {
    let arm = irp6();
    let (image, start) = standing(&arm);
    let still = Vector3::zeros();
    let refused = |path: &Path| commanded(&mut contour(&arm, path, LIMITS), &image).unwrap_err();

    let far = refused(&line(&start, Vector3::new(0.0, 0.0, 3.0), still));
    assert!(matches!(far, GeneratorError::Path { s, .. } if s > 0.0 && s < 1.0), "{far}");
    let mut beside = start;
    beside.translation.vector.x += 1e-3;
    let elsewhere = refused(&line(&beside, Vector3::new(0.0, 0.1, 0.0), still));
    let GeneratorError::NotAtStart { distance, angle } = elsewhere else { panic!("{elsewhere}") };
    assert!((distance - 1e-3).abs() < 1e-12 && angle < 1e-12, "{elsewhere}");
    let along = |limits, joints| Contour::along(arm.clone(), letter(&start), limits, joints).map(|_| ());
    let stuck = FeedLimits { max_jerk: 0.0, ..LIMITS };
    assert_eq!(along(stuck, joint_limits()), Err(GeneratorError::PathLimit));
    let mut lame = joint_limits();
    lame.max_velocity[3] = f64::NAN;
    assert_eq!(along(LIMITS, lame), Err(GeneratorError::Limit { axis: 3 }));
    let weak = MotionLimits::uniform(1e-10, 7.0, 70.0);
    let mut crawling = Contour::along(arm.clone(), letter(&start), LIMITS, weak).unwrap();
    let crawls = commanded(&mut crawling, &image).unwrap_err();
    assert!(matches!(crawls, GeneratorError::TooLong { .. }), "{crawls}");
}

#[test]
fn a_contour_past_a_singular_wrist_is_slow_only_there_unless_its_speed_is_to_be_constant() {
    let arm = irp6();
    let mut joints = BENT;
    joints[4] = 0.05;
    let pose = arm.forward(&joints).unwrap();
    let at_rest = AxesState::at_rest(joints);
    let image = EffectorImage::standing(EffectorState { motors: at_rest, joints: at_rest, pose });
    let path = line(&pose, Vector3::new(0.0, 0.2, 0.1), Vector3::zeros());
    let speeds = |contour: &mut Contour| -> Vec<f64> {
        commanded(contour, &image).unwrap().iter().map(|state| state.linear.norm()).collect()
    };
    let mut there = contour(&arm, &path, LIMITS);
    let slow_there = speeds(&mut there);
    let mut whole = contour(&arm, &path, LIMITS).at_constant_speed();
    let slow = speeds(&mut whole);
    println!("{} and {} macrosteps, {:?}", slow_there.len(), slow.len(), there.slowed());
    let fastest = |speeds: &[f64]| speeds.iter().copied().fold(0.0, f64::max);
    assert!((fastest(&slow_there) / 0.1 - 1.0).abs() < 1e-9, "{}", fastest(&slow_there));
    assert!(slow.len() > slow_there.len() && fastest(&slow) < 0.1, "{}", fastest(&slow));
    let part = there.slowed().unwrap();
    assert!(part.from < 0.1 && part.to < 0.9 && part.times > 1.0, "{part:?}");
    assert!(contour(&arm, &letter(&standing(&arm).1), LIMITS).slowed().is_none());
}
