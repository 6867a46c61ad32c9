//! The arm of the IRb-6 and the IRp-6. Lower and upper arm form a parallelogram and are each driven by a screw across
//! a triangle. Rods carry the wrist.

use std::f64::consts::{FRAC_PI_2, PI};

use super::chain::{Body, Chain, Link, Motion, Vector};
use super::kinematics::{Frame, Kinematics, Twist};
use super::{AXES, Loaded, screw::Screw};

/// Constant ratios of motor angle to joint angle (public code). The roll of the wrist is driven through its pitch.
const COLUMN: f64 = -158.0;
const PITCH: f64 = -128.0;
const ROLL: f64 = -76.8;
const FLANGE: f64 = 288.8845;
/// Motor angle per displacement of the track, rad/m: screw of 8 mm, belt 2:1 (public code).
const TRACK: f64 = 2.0 * std::f64::consts::TAU / 8e-3;

/// Mass of the carriage below the column, kg (nominal).
const CARRIAGE: f64 = 60.0;
/// Unit vector against gravity.
pub(super) const UP: Vector = Vector::new(0.0, 0.0, 1.0);
/// The gripper, along its own axis from the end of the wrist (nominal).
const GRIPPER: Body = Body::point(1.35, [0.0, 0.0, 0.15]);

/// Inertia of the parts that turn at motor speed, kg·m²: rotors (public code), screws and wave generators (nominal).
const TURNING: [f64; 6] = [1.7e-4, 1.8e-4, 1.8e-4, 1.6e-4, 2.0e-5, 1.6e-5];
/// Inertia of the track's parts that turn at motor speed, kg·m²: rotor, and long screw behind the belt (nominal).
const TURNING_TRACK: f64 = 4.5e-4;

#[derive(Clone, Debug)]
pub(super) struct Irp6 {
    pub(super) chain: Chain<6>,
    lower: Screw,
    upper: Screw,
    /// The last motor angles of the lower and of the upper arm, rad, with the joint angles and gear ratios there. Both
    /// motors stand still while the load of another motor is computed, so the values are kept.
    kept: [(f64, (f64, f64)); 2],
    /// Number of the first axis of the arm: 1 on the track, otherwise 0.
    first: usize,
}

/// The screws of the lower and of the upper arm. The cranks are 140 mm long. The pivots lie 157.5 and 183 mm off the
/// crank axes. The screws have a lead of 5 mm. The crank of the lower arm is set at 75.01° to the arm. All values are
/// derived from public code.
pub(super) fn screws() -> (Screw, Screw) {
    const PIVOT: (f64, f64) = (157.5e-3, 183e-3);
    let pivot = PIVOT.1.atan2(PIVOT.0);
    let crank = f64::to_radians(75.0106);
    let screw = |opposite, home| Screw::new(140e-3, PIVOT, 5e-3, opposite, home);
    (screw(pivot + PI - crank, -FRAC_PI_2), screw(pivot, 0.0))
}

impl Irp6 {
    /// Lengths follow the public code. All masses and their positions are nominal.
    pub(super) fn new(on_track: bool) -> Self {
        let slender = |mass: f64, centre: f64, length: f64| Body {
            spread: Vector::new(length / 12_f64.sqrt(), 0.0, 0.0),
            ..Body::point(mass, [centre - length, 0.0, 0.0])
        };
        let column = Body { spread: Vector::new(0.2, 0.0, 0.0), ..Body::point(45.0, [0.0; 3]) };
        let wrist = Body::point(4.0, [0.0, -0.095, 0.0]);
        let (lower, upper) = screws();
        Self {
            chain: Chain {
                links: [
                    Link::new(0.0, 0.0, -1, column),
                    Link::new(0.0, 0.455, 0, slender(12.0, 0.20, 0.455)),
                    Link::new(0.0, 0.670, 0, slender(14.0, 0.25, 0.670)),
                    Link::new(0.0, 0.0, -1, Body::NONE),
                    Link::new(0.190, 0.0, 1, wrist),
                    Link::new(0.0, 0.0, 0, GRIPPER),
                ],
                payload: Body::NONE,
            },
            lower,
            upper,
            // No motor angle equals NaN.
            kept: [(f64::NAN, (0.0, 0.0)); 2],
            first: usize::from(on_track),
        }
    }

    /// The IRb-6: shorter, with its gripper along the roll axis. The sixth axis does not exist and stays at rest.
    pub(super) fn with_straight_wrist() -> Self {
        let mut arm = Self::new(false);
        let wrist = Body::point(4.0, [0.0, 0.0, -0.0475]);
        arm.chain.links[4] = Link::new(0.095, 0.0, 0, wrist);
        arm
    }

    pub(super) fn load(&mut self, number: usize, motors: &[f64; AXES]) -> Loaded {
        let posture = self.posture(motors);
        let mut base = Motion::standing(UP);
        let mut rates = [0.0; 6];
        let mut ratio = 1.0;
        let turning = match number.checked_sub(self.first) {
            None => {
                base.velocity[1] = 1.0 / TRACK;
                TURNING_TRACK + CARRIAGE / (TRACK * TRACK)
            }
            Some(axis) => {
                (rates, ratio) = posture.rates(axis);
                TURNING[axis.min(5)]
            }
        };
        Loaded { links: self.chain.load(&base, &posture.angles, &rates), turning, ratio }
    }

    /// The flange, and its motion per rad/s of each motor. The base frame is at the shoulder, z up. The base frame does
    /// not move with the carriage, which moves along y.
    pub(super) fn kinematics(&mut self, motors: &[f64; AXES]) -> Kinematics {
        let posture = self.posture(motors);
        let mut base = Frame::BASE;
        if self.first == 1 {
            base.origin[1] = motors[0] / TRACK;
        }
        let (flange, joints) = self.chain.place(base, &posture.angles);
        let mut kinematics = Kinematics { flange, motors: [Twist::default(); AXES], room: f64::INFINITY };
        for (number, twist) in kinematics.motors.iter_mut().enumerate() {
            match number.checked_sub(self.first) {
                None => twist.velocity[1] = 1.0 / TRACK,
                Some(axis) if axis < 6 => *twist = Twist::sum(&joints, &posture.rates(axis).0),
                Some(_) => {}
            }
        }
        kinematics
    }

    /// Greatest displacement of a point of the tool, at most `distance`, m, from the origin of the flange, per rad of each
    /// motor, m/rad.
    pub(super) fn travel(&self, distance: f64) -> [f64; AXES] {
        let arm = self.chain.length() + distance;
        let mut posture = Posture { angles: [0.0; 6], lower_gear: 1.0, upper_gear: 1.0 };
        posture.lower_gear /= self.lower.steepest();
        posture.upper_gear /= self.upper.steepest();
        std::array::from_fn(|number| match number.checked_sub(self.first) {
            None => 1.0 / TRACK,
            Some(axis) => arm * posture.rates(axis).0.iter().map(|rate| rate.abs()).sum::<f64>(),
        })
    }

    fn posture(&mut self, motors: &[f64; AXES]) -> Posture {
        let first = self.first;
        let arm = |axis: usize| motors[first + axis];
        let [(lower, lower_gear), (upper, upper_gear)] = [(&self.lower, 1), (&self.upper, 2)].map(|(screw, axis)| {
            let (motor, kept) = (arm(axis), &mut self.kept[axis - 1]);
            if kept.0 != motor {
                *kept = (motor, screw.joint(motor));
            }
            kept.1
        });
        let pitch = arm(3) / PITCH;
        let roll = (arm(4) - arm(3)) / ROLL;
        // Parallelogram and rods keep the inclination of each link to the horizontal. The joint angles of the chain are
        // relative to the previous link.
        let angles = [arm(0) / COLUMN, lower, upper - lower, pitch - upper - FRAC_PI_2, roll, arm(5) / FLANGE];
        Posture { angles, lower_gear, upper_gear }
    }
}

/// Joint angles of the chain, rad, and the gear ratios of the ball screws in this pose.
struct Posture {
    angles: [f64; 6],
    lower_gear: f64,
    upper_gear: f64,
}

impl Posture {
    /// Rates of the chain's joints per rad/s of the motor of `axis` of the arm, and the motor's ratio if it changes.
    fn rates(&self, axis: usize) -> ([f64; 6], f64) {
        let mut rates = [0.0; 6];
        let mut ratio = 1.0;
        match axis {
            0 => rates[0] = 1.0 / COLUMN,
            1 => {
                ratio = self.lower_gear;
                rates[1] = 1.0 / ratio;
                rates[2] = -rates[1];
            }
            2 => {
                ratio = self.upper_gear;
                rates[2] = 1.0 / ratio;
                rates[3] = -rates[2];
            }
            3 => {
                rates[3] = 1.0 / PITCH;
                rates[4] = -1.0 / ROLL;
            }
            4 => rates[4] = 1.0 / ROLL,
            _ => rates[5] = 1.0 / FLANGE,
        }
        (rates, ratio)
    }
}
