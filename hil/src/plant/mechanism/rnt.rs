//! RNT as the nominal machine of this project: a platform on three screws and a passive central leg, and a wrist. No
//! parameter of the real machine is public.

use std::f64::consts::TAU;

use nalgebra::Matrix3;

use super::chain::{Body, Chain, Link, Load, Motion, Vector};
use super::kinematics::{Frame, Kinematics, Twist};
use super::{AXES, Loaded};

/// Radius of the universal joints in the base, at 0°, 120° and 240°, m.
const BASE_RADIUS: f64 = 0.350;
const PLATFORM_RADIUS: f64 = 0.160;
/// Distance from the platform to the wrist centre, m.
const WRIST: f64 = 0.200;
/// Motor angle per leg length, rad/m: screws of 5 mm without a gear.
const LEG: f64 = TAU / 5e-3;
/// Motor angle per joint angle of the wrist.
const GEAR: f64 = 100.0;
/// Inertia of the parts that turn with the motors, kg·m²: rotor and screw of a leg; rotor and wave generator of the
/// wrist.
const TURNING: (f64, f64) = (3.0e-4, 2.0e-5);
/// The machine hangs: the z axis of its base, along which the legs extend, points down.
pub(super) const UP: Vector = Vector::new(0.0, 0.0, -1.0);

#[derive(Clone, Debug)]
pub(super) struct Rnt {
    /// The platform with the more mobile half of each leg, in the axes of the platform.
    platform: [Body; 2],
    pub(super) wrist: Chain<3>,
    /// Length of each leg when its own motor is at home, m.
    home_lengths: [f64; 3],
    pose: Pose,
}

/// Pose of the platform. The platform is rotated by `alpha` about the x axis of the base, then by `beta` about the
/// rotated y axis. Its displacement along its own z axis is `extension`.
#[derive(Clone, Copy, Debug)]
struct Pose {
    alpha: f64,
    beta: f64,
    extension: f64,
}

/// Distance of the platform below which its joints jam, m.
const SHORTEST: f64 = 0.3;
/// Greatest number of steps of Newton's method for a pose. The pose of a load takes one step from the last pose.
const STEPS: usize = 12;
/// Error of a leg length, m, below which the next step of Newton's method is the last one. That step leaves an error of
/// about 1e-12 m.
const SOLVED: f64 = 1e-6;

/// Poses for which [`RATES`] holds: greatest inclination about each axis, rad, and least and greatest extension, m.
const MOBILE: (f64, f64, f64) = (0.5, 0.5, 1.4);
/// Greatest angular velocity of the platform, rad/s, and its greatest speed along its own axis, m/s, caused by a leg at
/// 1 m/s in the poses of [`MOBILE`]. A test compares them with all poses of a grid.
const RATES: (f64, f64) = (3.2, 0.45);
/// Distance of a pose from the end of [`MOBILE`], rad and m, from which a tool can move by [`ROOM`] within [`MOBILE`].
const INSIDE: f64 = 0.1;
/// Displacement of the tool by the bound of [`Rnt::travel`], m. The platform turns by less than [`INSIDE`] meanwhile,
/// because the tool is more than [`ROOM`] / [`INSIDE`] from the centre of rotation.
const ROOM: f64 = 0.08;

impl Rnt {
    pub(super) fn new(home_lengths: [f64; 3]) -> Self {
        let disc = PLATFORM_RADIUS / 2.0;
        let half = |spread| Body { spread, ..Body::point(15.0, [0.0; 3]) };
        let reach = BASE_RADIUS - PLATFORM_RADIUS;
        let length = home_lengths.iter().sum::<f64>() / 3.0;
        let mut rnt = Self {
            platform: [half(Vector::new(disc, 0.0, 0.0)), half(Vector::new(0.0, disc, 0.0))],
            wrist: Chain {
                links: [
                    Link::new(0.0, 0.0, -1, Body::point(5.0, [0.0; 3])),
                    Link::new(0.0, 0.0, 1, Body::rod(4.0, Vector::new(0.0, 0.0, 0.10))),
                    Link::new(0.100, 0.0, 0, Body::rod(3.0, Vector::new(0.0, 0.0, 0.15))),
                ],
                payload: Body::NONE,
            },
            home_lengths,
            pose: Pose {
                alpha: 0.0,
                beta: 0.0,
                extension: (length * length - reach * reach).max(SHORTEST * SHORTEST).sqrt(),
            },
        };
        rnt.settle(&[0.0; AXES]);
        rnt
    }

    /// Length of a leg, m.
    fn length(&self, leg: usize, motors: &[f64; AXES]) -> f64 {
        self.home_lengths[leg] + motors[leg] / LEG
    }

    fn lengths(&self, motors: &[f64; AXES]) -> [f64; 3] {
        [0, 1, 2].map(|leg| self.length(leg, motors))
    }

    /// Moves the platform to the pose that the leg lengths determine.
    pub(super) fn settle(&mut self, motors: &[f64; AXES]) {
        for _ in 0..STEPS {
            if self.follow(motors) < 1e-12 {
                break;
            }
        }
    }

    /// One step of Newton's method towards the pose that the leg lengths determine. Returns the largest error of a
    /// leg length before the step, m. If no pose fits the leg lengths, the platform keeps its last valid pose.
    fn follow(&mut self, motors: &[f64; AXES]) -> f64 {
        let (next, worst) = self.pose.towards(&self.lengths(motors));
        if next.is_possible() {
            self.pose = next;
        }
        worst
    }

    pub(super) fn load(&mut self, number: usize, motors: &[f64; AXES]) -> Loaded {
        self.follow(motors);
        let axes = self.pose.axes();
        let mut base = Motion::standing(into_platform(&axes, UP));
        let mut rates = [0.0; 3];
        let angles = [3, 4, 5].map(|axis| motors[axis] / GEAR);
        let (turning, load) = if number < 3 {
            let (_, rate) = self.pose.legs(&axes)[number];
            base = self.pose.motion(&axes, rate / LEG, base.up);
            let halves = self.platform.map(|body| body.load(&base));
            // The base of the wrist's chain moves with the wrist centre.
            base.velocity += WRIST * base.spin.cross(&Vector::z());
            (TURNING.0, halves[0].and(halves[1]))
        } else {
            rates[number - 3] = 1.0 / GEAR;
            (TURNING.1, Load::default())
        };
        Loaded { links: load.and(self.wrist.load(&base, &angles, &rates)), turning, ratio: 1.0 }
    }

    /// Greatest displacement of a point of the tool, at most `distance`, m, from the origin of the flange, per rad of each
    /// motor, m/rad. It holds in the poses of [`MOBILE`].
    pub(super) fn travel(&self, distance: f64) -> [f64; AXES] {
        let wrist = self.wrist.length() + distance;
        let (spin, along) = RATES;
        let leg = along + spin * (MOBILE.2 + WRIST + wrist);
        let mut travel = [0.0; AXES];
        travel[..3].fill(leg / LEG);
        travel[3..6].fill(wrist / GEAR);
        travel
    }

    /// The flange, and its motion per rad/s of each motor. The origin of the base frame is the centre of the legs' joints
    /// in the base. Axis z is along the central leg. The result depends on the motor angles only. If no pose fits the leg
    /// lengths, the platform has the pose of the last load.
    pub(super) fn kinematics(&mut self, motors: &[f64; AXES]) -> Kinematics {
        let pose = Pose::of(&self.lengths(motors)).unwrap_or(self.pose);
        let columns = pose.axes();
        let axes = Matrix3::from_columns(&columns);
        let centre = axes * Vector::new(0.0, 0.0, pose.extension + WRIST);
        let angles = [3, 4, 5].map(|axis| motors[axis] / GEAR);
        let (flange, joints) = self.wrist.place(Frame { axes, origin: centre }, &angles);
        let mut twists = [Twist::default(); AXES];
        for (twist, (_, rate)) in twists.iter_mut().zip(pose.legs(&columns)) {
            let platform = pose.motion(&columns, rate / LEG, UP);
            let spin = axes * platform.spin;
            let velocity = axes * platform.velocity + spin.cross(&(flange.origin - axes.column(2) * pose.extension));
            *twist = Twist { velocity, spin };
        }
        for (twist, joint) in twists[3..6].iter_mut().zip(joints) {
            *twist = Twist { velocity: joint.velocity / GEAR, spin: joint.spin / GEAR };
        }
        Kinematics { flange, motors: twists, room: pose.room() }
    }
}

impl Pose {
    /// The pose that the leg lengths determine, m; `None` if no pose fits them.
    fn of(lengths: &[f64; 3]) -> Option<Self> {
        let mut pose = Self::near(lengths);
        for _ in 0..STEPS {
            let (next, error) = pose.is_possible().then(|| pose.towards(lengths))?;
            pose = next;
            if error < SOLVED {
                return Some(pose).filter(Self::is_possible);
            }
        }
        None
    }

    /// The pose with these leg lengths, m, to the first order in its inclination.
    fn near(lengths: &[f64; 3]) -> Self {
        let squares = lengths.map(|length| length * length);
        let mean = |weights: [f64; 3]| weights.iter().zip(squares).map(|(weight, it)| weight * it).sum::<f64>() / 3.0;
        let reach = BASE_RADIUS - PLATFORM_RADIUS;
        let extension = (mean([1.0; 3]) - reach * reach).sqrt();
        let inclined = |axis: usize| mean(CIRCLE.map(|direction| direction[axis])) / (BASE_RADIUS * extension);
        Self { alpha: inclined(1), beta: -inclined(0), extension }
    }

    /// One step of Newton's method towards the pose with these leg lengths, m, and the largest error of a leg length
    /// before the step, m.
    fn towards(&self, lengths: &[f64; 3]) -> (Self, f64) {
        let legs = self.legs(&self.axes());
        let mut step = Vector::zeros();
        let mut worst = 0.0_f64;
        for (expected, (length, column)) in lengths.iter().zip(legs) {
            let missing = expected - length;
            worst = worst.max(missing.abs());
            step += missing * column;
        }
        let [alpha, beta, extension] = step.into();
        let next = Self { alpha: self.alpha + alpha, beta: self.beta + beta, extension: self.extension + extension };
        (next, worst)
    }

    /// Displacement of the tool from this pose, m, for which the bound of [`Rnt::travel`] holds.
    fn room(&self) -> f64 {
        let inclined = self.alpha.abs().max(self.beta.abs()) > MOBILE.0 - INSIDE;
        let inside = MOBILE.1 + INSIDE..=MOBILE.2 - INSIDE;
        if inclined || !inside.contains(&self.extension) { 0.0 } else { ROOM }
    }

    /// Whether the pose lies outside the range in which the joints jam.
    fn is_possible(&self) -> bool {
        self.alpha.abs() < 1.0 && self.beta.abs() < 1.0 && (SHORTEST..2.0).contains(&self.extension)
    }

    /// The platform's axes, in the base frame.
    fn axes(&self) -> [Vector; 3] {
        let (sa, ca) = self.alpha.sin_cos();
        let (sb, cb) = self.beta.sin_cos();
        [Vector::new(cb, sa * sb, -ca * sb), Vector::new(0.0, ca, sa), Vector::new(sb, -sa * cb, ca * cb)]
    }

    /// Motion of the platform's frame, which has these axes, when the pose changes at these rates.
    fn motion(&self, axes: &[Vector; 3], rates: Vector, up: Vector) -> Motion {
        let spin = rates[0] * Vector::x() + rates[1] * axes[1];
        let spin = into_platform(axes, spin);
        let along = self.extension * Vector::z();
        Motion { up, spin, velocity: rates[2] * Vector::z() + spin.cross(&along) }
    }

    /// For each leg: its length, m, and the change of the pose per metre of its length, other lengths being constant.
    /// `axes`: the axes of the platform.
    fn legs(&self, &[x, y, z]: &[Vector; 3]) -> [(f64, Vector); 3] {
        let legs = CIRCLE.map(|[cos, sin]| {
            let from_base = PLATFORM_RADIUS * cos * x + PLATFORM_RADIUS * sin * y;
            let joint = from_base + self.extension * z;
            let leg = joint - BASE_RADIUS * Vector::new(cos, sin, 0.0);
            let length = leg.dot(&leg).sqrt();
            let along = leg / length;
            // Change of the leg length with the pose.
            let slope = [along.dot(&Vector::x().cross(&joint)), along.dot(&y.cross(&joint)), along.dot(&z)];
            (length, slope)
        });
        let slopes = legs.map(|(_, slope)| Vector::from(slope));
        let volume = slopes[0].dot(&slopes[1].cross(&slopes[2]));
        [0, 1, 2].map(|leg| {
            let column = slopes[(leg + 1) % 3].cross(&slopes[(leg + 2) % 3]);
            (legs[leg].0, column / volume)
        })
    }
}

/// A vector of the base frame in the axes of the platform.
fn into_platform(axes: &[Vector; 3], vector: Vector) -> Vector {
    axes.map(|axis| axis.dot(&vector)).into()
}

/// Cosine and sine of 0°, 120° and 240°.
const CIRCLE: [[f64; 2]; 3] = [[1.0, 0.0], [-0.5, 0.866_025_403_784_438_6], [-0.5, -0.866_025_403_784_438_6]];

#[cfg(test)]
mod tests {
    use super::{AXES, LEG, MOBILE, Pose, RATES, Rnt};

    #[test]
    fn platform_is_where_its_legs_hold_it() {
        let pose = Pose { alpha: 0.2, beta: -0.1, extension: 0.9 };
        let golden = [0.953_705_712, 0.960_914_436, 0.842_363_921];
        for ((length, _), expected) in pose.legs(&pose.axes()).iter().zip(golden) {
            assert!((length - expected).abs() < 1e-9, "{length} for {expected}");
        }
        let mut rnt = Rnt::new([0.75; 3]);
        let mut motors = [0.0; AXES];
        for (motor, length) in motors.iter_mut().zip(golden) {
            *motor = (length - 0.75) * LEG;
        }
        rnt.settle(&motors);
        let found = [rnt.pose.alpha, rnt.pose.beta, rnt.pose.extension];
        for (found, expected) in found.iter().zip([0.2, -0.1, 0.9]) {
            assert!((found - expected).abs() < 1e-8, "{found} for {expected}");
        }
        // The same pose results if each leg has this length at home.
        let home = Rnt::new(golden).pose;
        let found = [home.alpha, home.beta, home.extension];
        for (found, expected) in found.iter().zip([0.2, -0.1, 0.9]) {
            assert!((found - expected).abs() < 1e-8, "{found} for {expected}");
        }
    }

    #[test]
    fn pose_follows_from_the_lengths_of_the_legs_alone() {
        let grid = |from: f64, to: f64| (0..=12).map(move |k| from + (to - from) * f64::from(k) / 12.0);
        for alpha in grid(-0.6, 0.6) {
            for beta in grid(-0.6, 0.6) {
                for extension in grid(0.4, 1.5) {
                    let pose = Pose { alpha, beta, extension };
                    let lengths = pose.legs(&pose.axes()).map(|(length, _)| length);
                    let Some(found) = Pose::of(&lengths) else { panic!("no pose for {pose:?}") };
                    let off = [found.alpha - alpha, found.beta - beta, found.extension - extension];
                    assert!(off.iter().all(|off| off.abs() < 1e-10), "{found:?} for {pose:?}");
                }
            }
        }
        assert!(Pose::of(&[1.25, 0.75, 0.75]).is_none());
    }

    #[test]
    fn no_leg_moves_the_platform_faster_than_its_bound() {
        let (inclination, least, most) = MOBILE;
        let grid = |from: f64, to: f64| (0..=24).map(move |k| from + (to - from) * f64::from(k) / 24.0);
        let (mut spin, mut along) = (0.0_f64, 0.0_f64);
        for alpha in grid(-inclination, inclination) {
            for beta in grid(-inclination, inclination) {
                for extension in grid(least, most) {
                    let pose = Pose { alpha, beta, extension };
                    for (_, rate) in pose.legs(&pose.axes()) {
                        spin = spin.max(rate[0].hypot(rate[1]));
                        along = along.max(rate[2].abs());
                    }
                }
            }
        }
        assert!((0.8..0.95).contains(&(spin / RATES.0)), "{spin} rad/s");
        assert!((0.8..0.95).contains(&(along / RATES.1)), "{along} m/s");
    }

    #[test]
    fn legs_that_fit_no_pose_do_not_lose_the_platform() {
        let mut rnt = Rnt::new([0.75; 3]);
        let mut motors = [0.0; AXES];
        motors[0] = 0.5 * LEG;
        rnt.settle(&motors);
        assert!(rnt.pose.is_possible());
        motors[0] = 0.02 * LEG;
        rnt.settle(&motors);
        for (leg, (length, _)) in rnt.pose.legs(&rnt.pose.axes()).iter().enumerate() {
            let expected = rnt.length(leg, &motors);
            assert!((length - expected).abs() < 1e-9, "{length} for {expected}");
        }
    }

    #[test]
    fn legs_carry_what_the_heights_of_the_masses_say() {
        // Potential energy in the hanging base, from the lengths of the legs: platform, then three bodies of the
        // straight wrist.
        let potential = |lengths: [f64; 3]| {
            let mut rnt = Rnt::new([0.75; 3]);
            let mut motors = [0.0; AXES];
            for (motor, length) in motors.iter_mut().zip(lengths) {
                *motor = (length - 0.75) * LEG;
            }
            rnt.settle(&motors);
            let Pose { alpha, beta, extension } = rnt.pose;
            let moment =
                30.0 * extension + 5.0 * (extension + 0.2) + 4.0 * (extension + 0.25) + 3.0 * (extension + 0.375);
            (rnt, motors, -9.81 * moment * alpha.cos() * beta.cos())
        };
        let lengths = [0.953_705_712, 0.960_914_436, 0.842_363_921];
        for leg in 0..3 {
            let moved = |by: f64| {
                let mut lengths = lengths;
                lengths[leg] += by;
                potential(lengths).2
            };
            let expected = -(moved(1e-5) - moved(-1e-5)) / 2e-5 / LEG;
            let (mut rnt, motors, _) = potential(lengths);
            let found = rnt.load(leg, &motors).links.torque;
            assert!((found - expected).abs() < 1e-7, "leg {leg}: {found} for {expected}");
        }
    }

    #[test]
    fn pose_followed_in_single_steps_does_not_drift() {
        let mut rnt = Rnt::new([0.75; 3]);
        let mut motors = [0.0; AXES];
        // All legs move at up to 0.2 m/s. Each leg updates its position once per millisecond.
        let at = |leg: usize, t: f64| 250.0 + 100.0 * (2.5 * t + leg as f64).sin();
        for (leg, motor) in motors.iter_mut().take(3).enumerate() {
            *motor = at(leg, 0.0);
        }
        rnt.settle(&motors);
        for k in 0..90_000 {
            let t = f64::from(k / 3) * 1e-3;
            let leg = k as usize % 3;
            motors[leg] = at(leg, t);
            rnt.load(leg, &motors);
            let legs = rnt.pose.legs(&rnt.pose.axes());
            let off = legs[leg].0 - rnt.length(leg, &motors);
            assert!(off.abs() < 1e-6, "{off} m at {t} s");
        }
    }
}
