//! Kinematics of the Polycrank.

mod cranks;

use std::{
    f64::consts::{FRAC_PI_2, PI},
    sync::Arc,
};

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use super::room::room;
use super::{
    GearAxis, Jacobian, Joints, KinematicsError, Limits, Link, Mass, MotorRating, Motors, ParameterError, Robot,
    RobotParameters, Solutions,
    arm::{self, INDISTINCT},
    drive_train::{DriveTrain, TrainAxis},
    free_parameter, parameters,
    solutions::Search,
};
use cranks::{Cranks, Facing, Stand};

const AXES: usize = 7;
const NAMES: [&str; AXES] = ["q1", "q2", "q3", "q4", "q5", "q6", "q7"];

/// The first axes of the upper cranks, of the forearm, and of the tool.
const UPPER: usize = 0;
const FOREARM: usize = 3;
const ROLL: usize = 6;

const ELBOW: usize = 4;

/// If the sines of both bends are smaller, the two pairs of cranks count as stretched or folded.
const STRETCHED: f64 = 1e-5;
/// Number of candidate planes of the forearm, spread over half a turn, if the tool axis is parallel to axis 1.
const PLANES: u8 = 16;
/// Distance from the ends of its range, m, within which the forearm's reach is moved back as the arm moves.
const BAND: f64 = 0.04;
/// Number of points at which the most dexterous branch is sought before its refinement.
const SAMPLES: usize = 64;

/// Number of steps of the golden section. Each step is 0.618 of the previous step, down to 1e-4 of the distance
/// between two samples.
const REFINEMENTS: usize = 20;
const GOLDEN: f64 = 0.618_033_988_749_895;

/// Tolerance for rounding errors of a given reach outside its range, m.
const REACH_SLACK: f64 = 1e-9;

/// Parameters of one Polycrank.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PolycrankParameters {
    /// Lengths of the two cranks that turn about axes 1 and 2, m. A crank of negative length points backwards at
    /// zero.
    #[doc(alias = "a1")]
    #[doc(alias = "a2")]
    pub upper_cranks: [f64; 2],
    /// Offsets of axes 2, 3 and 4 along axis 1, m.
    #[doc(alias = "d1")]
    pub upper_offsets: [f64; 3],
    /// Length of the two equal cranks that turn about axes 4 and 5, m.
    #[doc(alias = "a4")]
    #[doc(alias = "a5")]
    pub forearm_crank: f64,
    /// Offsets of axes 5, 6 and 7 along axis 4, m.
    #[doc(alias = "d4")]
    pub forearm_offsets: [f64; 3],
    /// Offset of the flange along axis 7, m.
    #[doc(alias = "d7")]
    pub flange_offset: f64,
    /// Whether axes 2, 3 and 5, 6 are driven by fixed motors through the cranks. Each of these motors then sets the
    /// sum of its joint and the preceding joints of its group.
    pub coupled: bool,
    /// The drives.
    pub axes: [GearAxis; AXES],
}

impl PolycrankParameters {
    /// The robot of the WUT.
    ///
    /// From public code: the geometry. One of its two published copies has 0.062 m for the last offset of the
    /// forearm. No data of the drives is public, so the following values are nominal: ratio 50, no coupling, and the
    /// home posture. At home both cranks are bent by a right angle and the tool axis is level. The motor limits are
    /// those of a 32-bit counter of 4000 counts per revolution, ±67 000 rad of the joint.
    pub const fn polycrank() -> Self {
        const fn drive(joint_at_home: f64) -> GearAxis {
            GearAxis {
                ratio: 50.0,
                joint_at_home,
                motor_at_home: 0.0,
                joint_limits: Limits::CONTINUOUS,
                motor_limits: Limits::new(-3.35e6, 3.35e6),
            }
        }
        Self {
            upper_cranks: [-0.299, 0.180],
            upper_offsets: [0.220, 0.152, 0.335],
            forearm_crank: 0.151,
            forearm_offsets: [0.120, 0.116, 0.060],
            flange_offset: 0.043,
            coupled: false,
            axes: [
                drive(0.0),
                drive(FRAC_PI_2),
                drive(-FRAC_PI_2),
                drive(0.0),
                drive(FRAC_PI_2),
                drive(0.0),
                drive(0.0),
            ],
        }
    }

    /// The axis through whose crank the motor of `axis` acts, if the motor is fixed.
    fn carrier(&self, axis: usize) -> Option<usize> {
        (self.coupled && matches!(axis, 1 | 2 | 4 | 5)).then(|| axis - 1)
    }
}

/// The Polycrank of the WUT: seven endless joints.
///
/// Joints: q1 .. q7. Axes 1, 2 and 3 are parallel and carry two cranks, the upper cranks. Axes 4, 5 and 6 are
/// parallel, perpendicular to axes 1 to 3, and carry two more cranks, the forearm. Axis 7 rolls the tool. Positions
/// count turns and do not wrap. The z axis of the **base** frame is axis 1, which is level in the laboratory, 0.925 m
/// above the floor. The flange's z axis is axis 7.
///
/// A pose leaves one parameter open: the forearm's reach, which is the distance of axis 6 from axis 4 perpendicular
/// to axis 1. [`Robot::inverse`] takes the reach from `near` and returns the four or eight branches with that reach.
/// Near an end of the range that the pose admits, the reach moves back as the arm moves, by at most twice the travel
/// of the arm. For a pose far from `near` the reach is 0.04 m inside its range. The reach avoids folded upper cranks
/// from a distance of 0.1 m on. [`Polycrank::inverse_at`] takes the reach from the caller.
/// [`Polycrank::most_dexterous`] searches for the best reach.
///
/// A pose whose tool axis is parallel to axis 1 within 1e-8 also leaves the plane of the forearm open. The plane is
/// then taken from `near`. If the arm cannot reach the pose in this plane, the nearest of 16 planes in which the pose
/// is within reach is taken.
///
/// A pose in which both pairs of cranks are stretched or folded at once, with bends within 1e-5, is the edge of the
/// workspace, and is refused with [`KinematicsError::Singular`]. Its axis is 4, counted from 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Polycrank {
    parameters: PolycrankParameters,
    cranks: Cranks,
    drive_train: DriveTrain<AXES>,
}

impl Polycrank {
    /// A robot with these parameters. Fails if a parameter is invalid.
    pub fn new(parameters: &PolycrankParameters) -> Result<Self, ParameterError> {
        for length in parameters.upper_cranks {
            parameters::positive("upper_cranks", length.abs())?;
        }
        parameters::positive("forearm_crank", parameters.forearm_crank)?;
        for (name, offsets) in [
            ("upper_offsets", parameters.upper_offsets),
            ("forearm_offsets", parameters.forearm_offsets),
            ("flange_offset", [parameters.flange_offset; 3]),
        ] {
            for offset in offsets {
                parameters::finite(name, offset)?;
            }
        }
        let mut drives = Vec::with_capacity(AXES);
        for (axis, (gear, name)) in parameters.axes.iter().zip(NAMES).enumerate() {
            drives.push(TrainAxis { carried_by: parameters.carrier(axis), ..parameters::gear(name, gear)? });
        }
        let drives = drives.try_into().expect("every axis has a drive");
        Ok(Self {
            parameters: *parameters,
            cranks: Cranks {
                upper: parameters.upper_cranks,
                upper_offset: parameters.upper_offsets.iter().sum(),
                forearm: parameters.forearm_crank,
                forearm_offset: parameters.forearm_offsets.iter().sum(),
                flange_offset: parameters.flange_offset,
            },
            drive_train: DriveTrain::new(drives),
        })
    }

    /// The forearm's reach at these joints, m: the distance of axis 6 from axis 4 perpendicular to axis 1.
    pub fn reach(&self, joints: &Joints) -> Result<f64, KinematicsError> {
        Ok(self.cranks.stand(joints.exactly()?).reach)
    }

    /// The branches of a pose for a given reach of the forearm, m, nearest to `near` first.
    pub fn inverse_at(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
        reach: f64,
    ) -> Result<Solutions, KinematicsError> {
        if !reach.is_finite() {
            return Err(KinematicsError::NotFinite);
        }
        self.solve(base_from_flange, near.exactly()?, |facing| {
            let nearest = self.cranks.reaches(facing, 0.0)?.nearest(reach)?;
            let missing = (nearest - reach).abs();
            if missing > REACH_SLACK {
                return Err(missing);
            }
            Ok(nearest)
        })
    }

    /// The branches of a pose, nearest to `near` first, for the reach of the forearm at which one branch is farthest
    /// from a singularity. The reach is the best of 64 samples, refined by golden section. The call takes about a
    /// millisecond, and is meant for the time before a motion.
    pub fn most_dexterous(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
    ) -> Result<Solutions, KinematicsError> {
        // The reach of `inverse` is also a candidate: a range may be narrower than the distance of the samples.
        let own = self.reach(self.inverse(base_from_flange, near)?.preferred())?;
        let margin = |reach| {
            let solutions = self.inverse_at(base_from_flange, near, reach);
            solutions.map_or(f64::NEG_INFINITY, |solutions| {
                let margins = solutions.iter().map(|joints| self.singularity(joints));
                margins.flatten().map(|singularity| singularity.margin).fold(0.0, f64::max)
            })
        };
        let longest = 2.0 * self.cranks.forearm;
        let step = 2.0 * longest / SAMPLES as f64;
        let samples = (0..SAMPLES).map(|sample| (sample as f64 + 0.5) * step - longest);
        let better = |a: (f64, f64), b: (f64, f64)| if b.1 > a.1 { b } else { a };
        let mut best = samples.map(|reach| (reach, margin(reach))).fold((own, margin(own)), better);
        let (mut low, mut high) = (best.0 - step, best.0 + step);
        for _ in 0..REFINEMENTS {
            let part = (high - low) * GOLDEN;
            let (left, right) = (high - part, low + part);
            let (at_left, at_right) = (margin(left), margin(right));
            best = better(better(best, (left, at_left)), (right, at_right));
            if at_left > at_right {
                high = right;
            } else {
                low = left;
            }
        }
        self.inverse_at(base_from_flange, near, best.0)
    }

    /// The branches of a pose with the reach that `choose` returns for each of the two facings. Fails with the
    /// missing distance, m.
    fn solve(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &[f64; AXES],
        choose: impl Fn(&Facing) -> Result<f64, f64>,
    ) -> Result<Solutions, KinematicsError> {
        let (origin, axes) = arm::parts(base_from_flange)?;
        let across = axes.column(2).xy();
        let tilt = across.norm();
        if tilt >= INDISTINCT {
            let facings = self.cranks.facings(&origin, &axes, (across.x / tilt, across.y / tilt), tilt);
            return self.solve_facings(&facings, near, choose);
        }
        let here = near[..3].iter().sum::<f64>();
        let mut refusal = None;
        for plane in 0..PLANES {
            // 0, 1, -1, 2, -2 and so on. A facing and its opposite are one plane.
            let steps = f64::from(plane.div_ceil(2)) * if plane % 2 == 0 { -1.0 } else { 1.0 };
            let (sin, cos) = (here + steps * PI / f64::from(PLANES)).sin_cos();
            let facings = self.cranks.facings(&origin, &axes, (cos, sin), 0.0);
            match self.solve_facings(&facings, near, &choose) {
                Err(error) => refusal = refusal.or(Some(error)),
                found => return found,
            }
        }
        Err(refusal.unwrap_or(KinematicsError::NotFinite))
    }

    /// The branches of both facings of a pose.
    fn solve_facings(
        &self,
        facings: &[Facing; 2],
        near: &[f64; AXES],
        choose: impl Fn(&Facing) -> Result<f64, f64>,
    ) -> Result<Solutions, KinematicsError> {
        Search::run(&self.drive_train, near, |search| {
            for facing in facings {
                match choose(facing) {
                    Ok(reach) => self.branches(search, facing, reach),
                    Err(margin) => search.out_of_reach(margin),
                }
            }
        })
    }

    /// Offers the four branches of one facing and one reach of the forearm.
    fn branches(&self, search: &mut Search<'_, AXES>, facing: &Facing, reach: f64) {
        let near = search.near;
        let Facing { end, ahead, .. } = facing;
        let (forearm, bend) = cranks::angles([self.cranks.forearm; 2], (reach, end.z), near[FOREARM]);
        let shoulder = (end.x - reach * ahead.x, end.y - reach * ahead.y);
        let (upper, upper_bend) = cranks::angles(self.cranks.upper, shoulder, near[UPPER]);
        if let Err(error) = arm::regular(ELBOW, bend.max(upper_bend), STRETCHED) {
            return search.refuse(error);
        }
        let mut joints = *near;
        search.turn(&mut joints, ROLL, [facing.roll]);
        for (q1, q2) in upper {
            search.turn(&mut joints, UPPER, [q1, q2, facing.phi - q1 - q2]);
            for (q4, q5) in forearm {
                search.turn(&mut joints, FOREARM, [q4, q5, facing.psi - q4 - q5]);
                search.offer(joints);
            }
        }
    }

    /// The reach for one facing of a pose. `here` is the present state of the arm.
    fn choose(&self, facing: &Facing, here: &Stand) -> Result<f64, f64> {
        let admitted = self.cranks.reaches(facing, 0.0)?;
        let nearest = admitted.nearest(here.reach)?;
        let inside = self.cranks.reaches(facing, BAND);
        let comfort = inside
            .map(|ring| self.cranks.ahead_of_the_hole(facing, ring))
            // The arm cannot move across a hole of the range.
            .map(|ring| if admitted.inner > 0.0 { ring.half(nearest) } else { ring })
            .and_then(|ring| ring.nearest(here.reach))
            .unwrap_or_else(|_| admitted.middle(nearest));
        admitted.nearest(free_parameter::drift(here.reach, comfort, here.way_to(facing), BAND))
    }
}

impl Robot for Polycrank {
    fn joint_limits(&self) -> &[Limits] {
        &self.drive_train.joint_limits
    }

    fn motor_limits(&self) -> &[Limits] {
        &self.drive_train.motor_limits
    }

    fn home(&self) -> Motors {
        self.drive_train.home()
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        Ok(self.cranks.forward(joints.exactly()?))
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        let near = near.exactly()?;
        let here = self.cranks.stand(near);
        self.solve(base_from_flange, near, |facing| self.choose(facing, &here))
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        self.drive_train.motors_from_joints(joints.exactly()?)
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        self.drive_train.joints_from_motors(motors.exactly()?)
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        Ok(self.cranks.jacobian(joints.exactly()?))
    }

    fn links(&self) -> Vec<Link> {
        let PolycrankParameters {
            upper_cranks: [a1, a2],
            upper_offsets: [d1, d2, d3],
            forearm_crank: a4,
            forearm_offsets: [d4, d5, d6],
            flange_offset: d7,
            ..
        } = self.parameters;
        let on = Isometry3::translation;
        let across = Isometry3::rotation(Vector3::x() * FRAC_PI_2);
        let frames = [
            Isometry3::identity(),
            on(a1, 0.0, d1),
            on(a2, 0.0, d2),
            on(0.0, 0.0, d3) * across,
            on(a4, 0.0, d4),
            on(a4, 0.0, d5),
            on(0.0, 0.0, d6) * across * on(0.0, 0.0, d7),
        ];
        let limits = self.joint_limits();
        let links = NAMES.iter().zip(frames).enumerate();
        links.map(|(axis, (&name, frame))| Link::turning(name, frame, &[(axis, 1.0)], limits)).collect()
    }
}

impl RobotParameters for PolycrankParameters {
    fn axes(&self) -> usize {
        7
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Polycrank::new(self)?))
    }

    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        for axis in 0..AXES {
            let carried = self.carrier(axis).map_or(0.0, |by| room(motors, by));
            self.axes[axis] = self.axes[axis].with_room(room(motors, axis), carried);
        }
        self
    }

    // Rods from joint to joint.
    fn masses(&self) -> Vec<Mass> {
        vec![
            Mass::new(12.0, [-0.1495, 0.0, 0.110]),
            Mass::new(9.0, [0.090, 0.0, 0.076]),
            Mass::new(7.0, [0.0, 0.0, 0.1675]),
            Mass::new(4.0, [0.0755, 0.0, 0.060]),
            Mass::new(3.5, [0.0755, 0.0, 0.058]),
            Mass::new(1.5, [0.0, 0.0, 0.030]),
            Mass::new(0.6, [0.0, 0.0, -0.0215]),
        ]
    }

    // Of the two directions that the level axis 1 leaves open x is taken (nominal).
    fn up(&self) -> [f64; 3] {
        [1.0, 0.0, 0.0]
    }

    // 24 A at 0.4 N·m/A, 10 A and 4 A at 0.2 N·m/A.
    fn motors(&self) -> Vec<MotorRating> {
        let (crank, forearm) = (MotorRating::new(250.0, 9.6), MotorRating::new(250.0, 2.0));
        vec![crank, crank, crank, forearm, forearm, forearm, MotorRating::new(250.0, 0.8)]
    }
}
