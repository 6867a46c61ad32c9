//! Kinematics of the arm that IRb-6 and IRp-6 share.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{ArmParameters, Jacobian, KinematicsError, Limits, Link, solutions::Search};

/// Two axes with a smaller sine of the enclosed angle count as parallel. A point with a smaller distance, m, counts
/// as lying on an axis. A pose this close to a singularity is reached within the same bound.
pub(super) const PARALLEL: f64 = 1e-10;

/// Sine of the angle to a singular pose, below which a pose counts as singular. The open parameter of such a pose is
/// taken from the present posture. A singular pose that was written with nine digits lies within this bound, and only
/// the rounding would determine its open parameter. The error of the orientation lies within the same bound, which is
/// far below one count of an encoder.
pub(super) const INDISTINCT: f64 = 1e-8;

pub(super) const COLUMN: usize = 0;
pub(super) const SHOULDER: usize = 1;
pub(super) const ELBOW: usize = 2;
pub(super) const PITCH: usize = 3;
pub(super) const ROLL: usize = 4;

/// Sines and cosines of the column and of the three inclinations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Posture {
    sin: [f64; 4],
    cos: [f64; 4],
}

impl Posture {
    pub(super) fn new(th1: f64, th2: f64, th3: f64, th4: f64) -> Self {
        let both = [th1, th2, th3, th4].map(f64::sin_cos);
        Self { sin: both.map(|(sin, _)| sin), cos: both.map(|(_, cos)| cos) }
    }

    /// Orientation of the wrist before its roll.
    pub(super) fn wrist(&self) -> Matrix3<f64> {
        wrist((self.sin[0], self.cos[0]), (self.sin[3], self.cos[3]))
    }
}

/// `base_from_wrist` before the roll, for the sine and cosine of column and pitch. The z axis is the roll axis. The
/// column rotates the wrist by th1 about the vertical, the pitch by th4 about the wrist's own -y axis.
pub(super) fn wrist((s1, c1): (f64, f64), (s4, c4): (f64, f64)) -> Matrix3<f64> {
    Matrix3::new(
        c1 * s4,
        s1,
        c1 * c4, //
        s1 * s4,
        -c1,
        s1 * c4, //
        c4,
        0.0,
        -s4,
    )
}

/// A column angle and a pitch for which branches are sought, as (sine, cosine), and the flange origin in the vertical
/// plane of the arm. The flange origin lies `reach` m ahead, negative behind, and `height` m above the base.
pub(super) struct Facing {
    pub(super) th1: (f64, f64),
    pub(super) pitch: (f64, f64),
    pub(super) reach: f64,
    pub(super) height: f64,
}

/// Distance of the flange origin from the column axis, m. Fails on the column axis, where th1 is undetermined.
pub(super) fn radius(origin: &Vector3<f64>) -> Result<f64, KinematicsError> {
    let radius = (origin.x * origin.x + origin.y * origin.y).sqrt();
    regular(COLUMN, radius, PARALLEL)?;
    Ok(radius)
}

/// Refuses a pose that is less than `least` from a pose that leaves `axis` undetermined.
pub(super) fn regular(axis: usize, margin: f64, least: f64) -> Result<(), KinematicsError> {
    if margin < least {
        let axis = axis as u8;
        return Err(KinematicsError::Singular { axis, margin });
    }
    Ok(())
}

/// A pose given by the axes of its frame as columns.
pub(super) fn pose(origin: Vector3<f64>, axes: Matrix3<f64>) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(axes);
    Isometry3::from_parts(Translation3::from(origin), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Origin and axes of a pose. Refuses values that are not finite.
pub(super) fn parts(pose: &Isometry3<f64>) -> Result<(Vector3<f64>, Matrix3<f64>), KinematicsError> {
    let finite = |value: &f64| value.is_finite();
    let (origin, rotation) = (&pose.translation.vector, &pose.rotation);
    if origin.iter().all(finite) && rotation.coords.iter().all(finite) {
        Ok((*origin, rotation.to_rotation_matrix().into_inner()))
    } else {
        Err(KinematicsError::NotFinite)
    }
}

impl ArmParameters {
    /// The links in the arm's plane: length, and the axis that sets the inclination.
    fn lengths(&self) -> [(usize, f64); 3] {
        [(SHOULDER, self.lower_arm_length), (ELBOW, self.upper_arm_length), (PITCH, self.wrist_length)]
    }

    pub(super) fn origin(&self, Posture { sin, cos }: &Posture) -> Vector3<f64> {
        let (mut reach, mut drop) = (0.0, 0.0);
        for (axis, length) in self.lengths() {
            reach += length * cos[axis];
            drop += length * sin[axis];
        }
        Vector3::new(cos[0] * reach, sin[0] * reach, self.shoulder_height - drop)
    }

    /// The Jacobian's columns of th1 .. th5. The columns of later axes stay zero.
    pub(super) fn jacobian(&self, posture: &Posture) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        let Posture { sin, cos } = posture;
        let origin = self.origin(posture);
        jacobian.fixed_view_mut::<3, 1>(0, 0).copy_from(&Vector3::new(-origin.y, origin.x, 0.0));
        jacobian[(5, 0)] = 1.0;
        for (axis, length) in self.lengths() {
            let (s, c) = (length * sin[axis], length * cos[axis]);
            jacobian.fixed_view_mut::<3, 1>(0, axis).copy_from(&Vector3::new(-cos[0] * s, -sin[0] * s, -c));
        }
        // Parallelograms keep the flange's orientation while lower and upper arm move.
        let wrist = posture.wrist();
        jacobian.fixed_view_mut::<3, 1>(3, PITCH).copy_from(&-wrist.column(1));
        jacobian.fixed_view_mut::<3, 1>(3, ROLL).copy_from(&wrist.column(2));
        jacobian
    }

    /// The links of th1 .. th5. Each link turns about its own z axis. The x axes of lower arm, upper arm and wrist
    /// lie along the links and are level at zero. The y axes then point down.
    pub(super) fn links(&self, limits: &[Limits]) -> Vec<Link> {
        let on = |length| Isometry3::translation(length, 0.0, 0.0);
        let shoulder = Isometry3::rotation(Vector3::x() * -FRAC_PI_2);
        let roll = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let column = Isometry3::translation(0.0, 0.0, self.shoulder_height);
        let behind = [(SHOULDER, -1.0), (ELBOW, 1.0)];
        let pitch = [(ELBOW, -1.0), (PITCH, 1.0)];
        let wrist = pose(Vector3::new(self.wrist_length, 0.0, 0.0), roll);
        vec![
            Link::turning("column", column, &[(COLUMN, 1.0)], limits),
            Link::turning("lower_arm", shoulder, &[(SHOULDER, 1.0)], limits),
            Link::turning("upper_arm", on(self.lower_arm_length), &behind, limits),
            Link::turning("pitch", on(self.upper_arm_length), &pitch, limits),
            Link::turning("roll", wrist, &[(ROLL, 1.0)], limits),
        ]
    }

    /// Follows the branches of one column angle and one pitch. `set_wrist` sets the axes after the pitch from the
    /// wrist's frame before its roll.
    pub(super) fn branches<const N: usize>(
        &self,
        search: &mut Search<'_, N>,
        at: &Facing,
        set_wrist: impl Fn(&Search<'_, N>, &mut [f64; N], &Matrix3<f64>),
    ) {
        let (s4, c4) = at.pitch;
        let mut joints = *search.near;
        search.turn(&mut joints, PITCH, [s4.atan2(c4)]);
        if !search.follows(&joints, PITCH) {
            return;
        }
        let (s1, c1) = at.th1;
        search.turn(&mut joints, COLUMN, [s1.atan2(c1)]);
        let reach = at.reach - self.wrist_length * c4;
        let drop = self.shoulder_height - at.height - self.wrist_length * s4;
        let shoulders = match self.shoulders(reach, drop) {
            Ok(shoulders) => shoulders,
            Err(margin) => return search.out_of_reach(margin),
        };
        for (s2, c2) in shoulders {
            joints[SHOULDER] = s2.atan2(c2);
            if !search.follows(&joints, SHOULDER) {
                continue;
            }
            let lower = self.lower_arm_length;
            joints[ELBOW] = (drop - lower * s2).atan2(reach - lower * c2);
            set_wrist(search, &mut joints, &wrist(at.th1, at.pitch));
            search.offer(joints);
        }
    }

    /// Sine and cosine of the two th2 for which the pitch axis lies `reach` m ahead of the shoulder and `drop` m
    /// below the shoulder. Fails with the distance by which the point is out of reach, m.
    fn shoulders(&self, reach: f64, drop: f64) -> Result<[(f64, f64); 2], f64> {
        let (lower, upper) = (self.lower_arm_length, self.upper_arm_length);
        let square = reach * reach + drop * drop;
        let span = square.sqrt();
        let margin = (span - (lower + upper)).max((lower - upper).abs() - span);
        if margin > 0.0 || span == 0.0 {
            return Err(margin);
        }
        // The angle at the shoulder between the lower arm and the line to the pitch axis.
        let cos = (square + lower * lower - upper * upper) / (2.0 * lower * span);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let th2 = |sin: f64| ((drop * cos + reach * sin) / span, (reach * cos - drop * sin) / span);
        Ok([th2(sin), th2(-sin)])
    }
}
