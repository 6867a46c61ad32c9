//! Numbers of a serial chain of revolute and prismatic joints, as a description of an arm gives them.

use nalgebra::{DMatrix, Matrix3, Quaternion, SymmetricEigen, UnitQuaternion};
use thiserror::Error;

use super::AXES;
use super::chain::Vector;

/// A joint of a serial chain, and the link behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChainBodyJoint {
    /// Origin of the joint's frame in the frame of the previous link, m. The frame of the link coincides with the frame
    /// of the joint at joint position zero.
    pub translation: [f64; 3],
    /// Rotation of the joint's frame in the frame of the previous link: a quaternion w, x, y, z of length 1.
    pub rotation: [f64; 4],
    /// Axis in the joint's frame. The length of the vector has no meaning.
    pub axis: [f64; 3],
    /// Whether the link shifts along the axis. Otherwise the link turns about the axis.
    pub prismatic: bool,
    /// Mass of the link, kg.
    pub mass: f64,
    /// Centre of mass in the frame of the link, m.
    pub centre: [f64; 3],
    /// Inertia about the centre of mass, kg·m², in the axes of the link's frame: xx, yy, zz, xy, xz, yz. The last three
    /// are elements of the tensor (the sign convention of URDF).
    pub inertia: [f64; 6],
    /// Joint position with all motors at home, rad or m.
    pub at_home: f64,
}

/// The bodies of a serial arm between a fixed base and a flange. All numbers have been checked.
///
/// A motor has a part that turns at motor speed, its rotor. Joint positions follow the motors:
/// `joint = at_home + J · (motor − home)`, with the constant matrix J.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainBodies {
    pub(super) links: Vec<Link>,
    /// The flange in the frame of the last link.
    pub(super) flange: (Vector, Matrix3<f64>),
    /// Unit vector against gravity, in the base frame.
    pub(super) up: Vector,
    /// Joint velocity per motor velocity: a row per joint, a column per motor. Zero for absent axes.
    pub(super) joints_from_motors: [[f64; AXES]; AXES],
    /// Inertia of each rotor, kg·m². 1 for absent axes.
    pub(super) rotors: [f64; AXES],
}

/// A joint and its link, with the numbers in the form in which the mechanism computes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Link {
    pub(super) offset: Vector,
    pub(super) turn: Matrix3<f64>,
    /// Unit vector.
    pub(super) axis: Vector,
    pub(super) prismatic: bool,
    pub(super) mass: f64,
    pub(super) centre: Vector,
    pub(super) inertia: Matrix3<f64>,
    pub(super) at_home: f64,
}

/// Refused numbers of a chain. Joints and motors are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ChainError {
    /// The number of joints is out of range.
    #[error("{count} joints, 1 to {AXES} are possible")]
    Joints {
        /// Number of joints.
        count: usize,
    },
    /// A number of a joint is NaN or infinite.
    #[error("joint {joint}: {quantity} is not a finite number")]
    JointNotFinite {
        /// Number of the joint.
        joint: usize,
        /// The quantity.
        quantity: &'static str,
    },
    /// Another number is NaN or infinite.
    #[error("{quantity} is not a finite number")]
    NotFinite {
        /// The quantity.
        quantity: &'static str,
    },
    /// A quaternion does not describe a rotation.
    #[error("joint {joint}: the quaternion of the rotation has length {length}, it must have length 1")]
    Rotation {
        /// Number of the joint.
        joint: usize,
        /// Length of the quaternion.
        length: f64,
    },
    /// The quaternion of the flange does not describe a rotation.
    #[error("flange: the quaternion of the rotation has length {length}, it must have length 1")]
    FlangeRotation {
        /// Length of the quaternion.
        length: f64,
    },
    /// An axis has no direction.
    #[error("joint {joint}: the axis is zero, it must have a direction")]
    Axis {
        /// Number of the joint.
        joint: usize,
    },
    /// The vector against gravity has no direction.
    #[error("the vector against gravity is zero, it must have a direction")]
    Up,
    /// A mass is below zero.
    #[error("joint {joint}: the mass of the link is {mass} kg, it must be 0 or above")]
    Mass {
        /// Number of the joint.
        joint: usize,
        /// Mass, kg.
        mass: f64,
    },
    /// Some motion of the link would have a kinetic energy below zero.
    #[error("joint {joint}: no link has the principal moments of inertia {moments:?} kg·m²: none may be below 0")]
    Inertia {
        /// Number of the joint.
        joint: usize,
        /// Principal moments in ascending order, kg·m².
        moments: [f64; 3],
    },
    /// The matrix of joints from motors has another size.
    #[error("joints from motors: a matrix of {joints} rows with {joints} numbers each is needed")]
    Size {
        /// Number of joints.
        joints: usize,
    },
    /// The motors cannot set all joints.
    #[error("joints from motors: the matrix has no inverse, so the motors cannot set all joints")]
    Singular,
    /// The number of rotors differs from the number of joints.
    #[error("{rotors} rotors for {joints} joints, one for each joint is needed")]
    Rotors {
        /// Number of rotors.
        rotors: usize,
        /// Number of joints.
        joints: usize,
    },
    /// A rotor has no inertia.
    #[error("motor {motor}: the inertia of the rotor is {inertia} kg·m², it must be above 0")]
    Rotor {
        /// Number of the motor.
        motor: usize,
        /// Inertia, kg·m².
        inertia: f64,
    },
}

/// Deviation of the length of a quaternion from 1 that counts as rounding.
const ROUNDED: f64 = 1e-6;
/// Part of the greatest principal moment by which a principal moment may be below zero. Descriptions of robots
/// round moments of inertia to few digits.
const ROUNDED_MOMENT: f64 = 0.01;

impl ChainBodies {
    /// The bodies of an arm. `flange`: translation, m, and quaternion w, x, y, z of the flange in the frame of the last
    /// link. `up`: direction against gravity in the base frame. `joints_from_motors`: the matrix J, rad/rad or m/rad,
    /// one row for each joint. `rotors`: inertia of the parts that turn at motor speed, kg·m², one for each motor.
    ///
    /// A chain without masses and inertias has links without weight.
    pub fn new(
        joints: &[ChainBodyJoint],
        flange: ([f64; 3], [f64; 4]),
        up: [f64; 3],
        joints_from_motors: &[Vec<f64>],
        rotors: &[f64],
    ) -> Result<Self, ChainError> {
        let count = joints.len();
        if count == 0 || count > AXES {
            return Err(ChainError::Joints { count });
        }
        let links: Result<Vec<Link>, ChainError> =
            joints.iter().enumerate().map(|(index, joint)| joint.link(index + 1)).collect();
        let (translation, rotation) = flange;
        finite("the translation of the flange", &translation)?;
        finite("the rotation of the flange", &rotation)?;
        finite("the vector against gravity", &up)?;
        let turn = turn(rotation).map_err(|length| ChainError::FlangeRotation { length })?;
        let up = Vector::from(up).try_normalize(0.0).ok_or(ChainError::Up)?;
        if rotors.len() != count {
            return Err(ChainError::Rotors { rotors: rotors.len(), joints: count });
        }
        let mut every = [1.0; AXES];
        for (index, (known, &inertia)) in every.iter_mut().zip(rotors).enumerate() {
            if !(inertia > 0.0 && inertia.is_finite()) {
                return Err(ChainError::Rotor { motor: index + 1, inertia });
            }
            *known = inertia;
        }
        Ok(Self {
            links: links?,
            flange: (translation.into(), turn),
            up,
            joints_from_motors: matrix(joints_from_motors, count)?,
            rotors: every,
        })
    }

    /// Number of joints.
    pub fn axes(&self) -> usize {
        self.links.len()
    }
}

impl ChainBodyJoint {
    fn link(&self, joint: usize) -> Result<Link, ChainError> {
        let numbers: [(&'static str, &[f64]); 7] = [
            ("the translation", &self.translation),
            ("the rotation", &self.rotation),
            ("the axis", &self.axis),
            ("the mass of the link", &[self.mass]),
            ("the centre of mass of the link", &self.centre),
            ("the inertia of the link", &self.inertia),
            ("the position at home", &[self.at_home]),
        ];
        for (quantity, numbers) in numbers {
            finite(quantity, numbers).map_err(|_| ChainError::JointNotFinite { joint, quantity })?;
        }
        if self.mass < 0.0 {
            return Err(ChainError::Mass { joint, mass: self.mass });
        }
        Ok(Link {
            offset: self.translation.into(),
            turn: turn(self.rotation).map_err(|length| ChainError::Rotation { joint, length })?,
            axis: Vector::from(self.axis).try_normalize(0.0).ok_or(ChainError::Axis { joint })?,
            prismatic: self.prismatic,
            mass: self.mass,
            centre: self.centre.into(),
            inertia: inertia(self.inertia).map_err(|moments| ChainError::Inertia { joint, moments })?,
            at_home: self.at_home,
        })
    }
}

fn finite(quantity: &'static str, numbers: &[f64]) -> Result<(), ChainError> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(ChainError::NotFinite { quantity }) }
}

/// The rotation matrix of a quaternion, or the length of a quaternion that is no rotation.
fn turn([w, x, y, z]: [f64; 4]) -> Result<Matrix3<f64>, f64> {
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    if (length - 1.0).abs() > ROUNDED {
        return Err(length);
    }
    Ok(UnitQuaternion::new_normalize(quaternion).to_rotation_matrix().into_inner())
}

/// The tensor, without principal moments below zero, or the principal moments that no body has.
pub(super) fn inertia([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Result<Matrix3<f64>, [f64; 3]> {
    let tensor = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let principal = SymmetricEigen::new(tensor);
    let mut moments: [f64; 3] = principal.eigenvalues.into();
    moments.sort_by(f64::total_cmp);
    let [least, _, greatest] = moments;
    let rounding = ROUNDED_MOMENT * greatest.abs();
    // Measured inertias are often of no rigid body: one moment is above the sum of the others. The energy is sound.
    if least < -rounding {
        return Err(moments);
    }
    if least >= 0.0 {
        return Ok(tensor);
    }
    let eigenvalues = principal.eigenvalues.map(|moment| moment.max(0.0));
    Ok(SymmetricEigen { eigenvalues, ..principal }.recompose())
}

fn matrix(rows: &[Vec<f64>], joints: usize) -> Result<[[f64; AXES]; AXES], ChainError> {
    if rows.len() != joints || rows.iter().any(|row| row.len() != joints) {
        return Err(ChainError::Size { joints });
    }
    let mut matrix = [[0.0; AXES]; AXES];
    for (known, row) in matrix.iter_mut().zip(rows) {
        finite("a number of the matrix of joints from motors", row)?;
        known[..joints].copy_from_slice(row);
    }
    // The rows of rotations and shifts have different units. Rows of length 1 make the determinant a pure number.
    let lengths: Vec<f64> = rows.iter().map(|row| row.iter().map(|it| it * it).sum::<f64>().sqrt()).collect();
    let scaled = DMatrix::from_fn(joints, joints, |row, column| rows[row][column] / lengths[row]);
    // A row of zeros gives NaN.
    if scaled.determinant().abs() > 1e-9 { Ok(matrix) } else { Err(ChainError::Singular) }
}

#[cfg(test)]
mod tests {
    use super::{ChainBodies, ChainBodyJoint, ChainError};

    const STRAIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    const JOINT: ChainBodyJoint = ChainBodyJoint {
        translation: [0.0, 0.0, 0.1],
        rotation: STRAIGHT,
        axis: [0.0, 0.0, 2.0],
        prismatic: false,
        mass: 2.0,
        centre: [0.1, 0.0, 0.0],
        inertia: [0.1, 0.2, 0.25, 0.01, 0.0, 0.0],
        at_home: 0.0,
    };

    fn chain(joints: &[ChainBodyJoint]) -> Result<ChainBodies, ChainError> {
        let count = joints.len();
        let rows: Vec<Vec<f64>> =
            (0..count).map(|row| (0..count).map(|column| if row == column { 0.01 } else { 0.0 }).collect()).collect();
        ChainBodies::new(joints, ([0.0; 3], STRAIGHT), [0.0, 0.0, 1.0], &rows, &vec![1e-4; count])
    }

    #[test]
    fn one_to_eight_joints_are_taken() {
        for count in 1..=8 {
            assert_eq!(chain(&vec![JOINT; count]).unwrap().axes(), count);
        }
        for count in [0, 9] {
            assert_eq!(chain(&vec![JOINT; count]), Err(ChainError::Joints { count }));
        }
    }

    #[test]
    fn numbers_of_a_joint_that_no_arm_has_are_refused_in_words() {
        let cases = [
            (ChainBodyJoint { translation: [0.0, f64::NAN, 0.0], ..JOINT }, "the translation is not a finite number"),
            (ChainBodyJoint { rotation: [f64::INFINITY, 0.0, 0.0, 0.0], ..JOINT }, "the rotation is not a finite"),
            (ChainBodyJoint { axis: [0.0, 0.0, f64::NAN], ..JOINT }, "the axis is not a finite number"),
            (ChainBodyJoint { mass: f64::NAN, ..JOINT }, "the mass of the link is not a finite number"),
            (
                ChainBodyJoint { centre: [f64::NAN, 0.0, 0.0], ..JOINT },
                "the centre of mass of the link is not a finite",
            ),
            (ChainBodyJoint { inertia: [f64::INFINITY; 6], ..JOINT }, "the inertia of the link is not a finite number"),
            (ChainBodyJoint { at_home: f64::NAN, ..JOINT }, "the position at home is not a finite number"),
            (ChainBodyJoint { rotation: [1.0, 0.0, 0.0, 0.1], ..JOINT }, "has length 1.00498"),
            (ChainBodyJoint { rotation: [0.0; 4], ..JOINT }, "has length 0, it must have length 1"),
            (ChainBodyJoint { axis: [0.0; 3], ..JOINT }, "the axis is zero"),
            (ChainBodyJoint { mass: -1.0, ..JOINT }, "the mass of the link is -1 kg, it must be 0 or above"),
            (ChainBodyJoint { inertia: [-0.1, 0.1, 0.1, 0.0, 0.0, 0.0], ..JOINT }, "none may be below 0"),
            (ChainBodyJoint { inertia: [0.1, 0.1, 0.1, 0.2, 0.0, 0.0], ..JOINT }, "none may be below 0"),
        ];
        for (joint, words) in cases {
            let text = chain(&[JOINT, joint]).unwrap_err().to_string();
            assert!(text.contains(words) && text.starts_with("joint 2: "), "{text}, not {words}");
        }
    }

    #[test]
    fn rounded_moments_of_inertia_are_taken_and_never_below_zero() {
        // A rod, with digits that a description has lost.
        let rod = ChainBodyJoint { inertia: [1e-4, 0.1, 0.1005, 0.004, 0.0, 0.0], ..JOINT };
        let bodies = chain(&[rod]).unwrap();
        let moments = bodies.links[0].inertia.symmetric_eigenvalues();
        assert!(moments.iter().all(|moment| *moment > -1e-15), "{moments}");
        assert!((moments.max() - 0.1005).abs() < 1e-3, "{moments}");
        let none = ChainBodyJoint { mass: 0.0, inertia: [0.0; 6], ..JOINT };
        assert!(chain(&[none]).is_ok(), "a link without mass");
    }

    #[test]
    fn bad_numbers_of_the_whole_arm_are_refused_in_words() {
        let (flange, up) = (([0.0; 3], STRAIGHT), [0.0, 0.0, 1.0]);
        let (rows, rotors) = (vec![vec![0.01, 0.0], vec![0.0, 0.01]], [1e-4, 1e-4]);
        let nan = ([f64::NAN, 0.0, 0.0], STRAIGHT);
        let turned = ([0.0; 3], [2.0, 0.0, 0.0, 0.0]);
        let (short, lopsided) = (vec![vec![0.01]], vec![vec![0.01, 0.0], vec![0.01]]);
        let (same, zero) = (vec![vec![0.01, 0.02], vec![0.02, 0.04]], vec![vec![0.0, 0.0], vec![0.0, 0.01]]);
        let infinite = vec![vec![0.01, f64::INFINITY], vec![0.0, 0.01]];
        let cases = [
            (nan, up, &rows, &rotors[..], "the translation of the flange is not a finite number"),
            (turned, up, &rows, &rotors, "flange: the quaternion of the rotation has length 2"),
            (flange, [0.0; 3], &rows, &rotors, "the vector against gravity is zero"),
            (flange, [f64::NAN; 3], &rows, &rotors, "the vector against gravity is not a finite number"),
            (flange, up, &short, &rotors, "a matrix of 2 rows with 2 numbers each is needed"),
            (flange, up, &lopsided, &rotors, "a matrix of 2 rows with 2 numbers each is needed"),
            (flange, up, &same, &rotors, "the matrix has no inverse"),
            (flange, up, &zero, &rotors, "the matrix has no inverse"),
            (flange, up, &infinite, &rotors, "a number of the matrix of joints from motors is not a finite number"),
            (flange, up, &rows, &[1e-4][..], "1 rotors for 2 joints"),
            (flange, up, &rows, &[1e-4, 0.0][..], "motor 2: the inertia of the rotor is 0 kg·m², it must be above 0"),
            (flange, up, &rows, &[-1.0, 1.0][..], "motor 1: the inertia of the rotor is -1 kg·m²"),
            (flange, up, &rows, &[f64::NAN, 1.0][..], "motor 1: the inertia of the rotor is NaN kg·m²"),
        ];
        for (flange, up, rows, rotors, words) in cases {
            let text = ChainBodies::new(&[JOINT; 2], flange, up, rows, rotors).unwrap_err().to_string();
            assert!(text.contains(words), "{text}, not {words}");
        }
        assert!(ChainBodies::new(&[JOINT; 2], flange, up, &rows, &rotors).is_ok());
    }
}
