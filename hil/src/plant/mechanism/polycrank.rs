//! Polycrank: two planar cranks of three parallel axes each, and a tool roll, on a horizontal first axis.

use super::chain::{Body, Chain, Link, Motion, Vector};
use super::kinematics::{Frame, Kinematics, Twist};
use super::{AXES, Loaded};

/// Number of joints.
const JOINTS: usize = 7;

/// Motor angle per joint angle (nominal).
const RATIO: f64 = 50.0;
/// Inertia of a rotor, kg·m² (nominal).
const TURNING: f64 = 1e-4;
/// The x axis of the first frame points up. The published rotations leave open whether the x or the y axis does.
pub(super) const UP: Vector = Vector::new(1.0, 0.0, 0.0);

#[derive(Clone, Debug)]
pub(super) struct Polycrank {
    pub(super) chain: Chain<JOINTS>,
    /// Whether motors stand at the base and set absolute angles within each group of three.
    coupled: bool,
    /// Joint angles, rad.
    at_home: [f64; JOINTS],
}

impl Polycrank {
    /// Lengths are published. All masses are nominal: uniform rods from joint to joint.
    pub(super) fn new(coupled: bool, at_home: [f64; JOINTS]) -> Self {
        Self {
            chain: Chain {
                links: [
                    Link::rod(0.220, -0.299, 0, 12.0),
                    Link::rod(0.152, 0.180, 0, 9.0),
                    Link::rod(0.335, 0.0, 1, 7.0),
                    Link::rod(0.120, 0.151, 0, 4.0),
                    Link::rod(0.116, 0.151, 0, 3.5),
                    Link::rod(0.060, 0.0, 1, 1.5),
                    Link::rod(0.043, 0.0, 0, 0.6),
                ],
                payload: Body::NONE,
            },
            coupled,
            at_home,
        }
    }

    pub(super) fn load(&mut self, number: usize, motors: &[f64; AXES]) -> Loaded {
        let (angles, rates) = (self.angles(motors), self.rates(number));
        Loaded { links: self.chain.load(&Motion::standing(UP), &angles, &rates), turning: TURNING, ratio: 1.0 }
    }

    /// The flange, and its motion per rad/s of each motor. The z axis of the base frame is axis 1, and x points up.
    pub(super) fn kinematics(&mut self, motors: &[f64; AXES]) -> Kinematics {
        let angles = self.angles(motors);
        let (flange, joints) = self.chain.place(Frame::BASE, &angles);
        let mut twists = [Twist::default(); AXES];
        for (number, twist) in twists.iter_mut().take(JOINTS).enumerate() {
            *twist = Twist::sum(&joints, &self.rates(number));
        }
        Kinematics { flange, motors: twists, room: f64::INFINITY }
    }

    /// Greatest displacement of a point of the tool, at most `distance`, m, from the origin of the flange, per rad of each
    /// motor, m/rad.
    pub(super) fn travel(&self, distance: f64) -> [f64; AXES] {
        let arm = self.chain.length() + distance;
        let mut travel = [0.0; AXES];
        for (number, travel) in travel.iter_mut().take(JOINTS).enumerate() {
            *travel = arm * self.rates(number).iter().map(|rate| rate.abs()).sum::<f64>();
        }
        travel
    }

    fn angles(&self, motors: &[f64; AXES]) -> [f64; JOINTS] {
        let mut angles = std::array::from_fn(|joint| motors[joint] / RATIO);
        if self.coupled {
            for joint in [5, 4, 2, 1] {
                angles[joint] -= angles[joint - 1];
            }
        }
        for (angle, at_home) in angles.iter_mut().zip(self.at_home) {
            *angle += at_home;
        }
        angles
    }

    /// Rates of the joints per rad/s of a motor.
    fn rates(&self, number: usize) -> [f64; JOINTS] {
        let mut rates = [0.0; JOINTS];
        rates[number] = 1.0 / RATIO;
        // The motors of a group set sums of joint angles. If one motor turns alone, the next joint turns back by the
        // same angle, and the later links keep their orientation.
        if self.coupled && !matches!(number, 2 | 5 | 6) {
            rates[number + 1] = -rates[number];
        }
        rates
    }
}
