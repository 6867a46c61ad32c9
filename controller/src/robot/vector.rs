//! Positions of joints and of motors, as different types.

use std::{
    fmt,
    marker::PhantomData,
    ops::{Deref, DerefMut},
};

use servo::MAX_AXES;

use super::KinematicsError;

/// Type marker of joint positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Joint {}

/// Type marker of motor positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motor {}

/// One position per axis of a robot with at most [`MAX_AXES`] axes. Dereferences to a slice.
///
/// Joint and motor positions are different types, so the compiler rejects an interchange.
#[derive(Clone, Copy, PartialEq)]
pub struct Vector<Space> {
    values: [f64; MAX_AXES],
    axes: u8,
    space: PhantomData<Space>,
}

/// Joint positions, rad (m for a linear joint). The robot defines zero and sign.
pub type Joints = Vector<Joint>;

/// Motor shaft positions, rad, as in the set-points of the servo.
pub type Motors = Vector<Motor>;

impl<Space> Vector<Space> {
    /// A vector of `values`, one per axis; `None` for more than [`MAX_AXES`] values.
    pub fn new(values: &[f64]) -> Option<Self> {
        let mut padded = [0.0; MAX_AXES];
        padded.get_mut(..values.len())?.copy_from_slice(values);
        Some(Self { values: padded, axes: values.len() as u8, space: PhantomData })
    }

    /// The positions, padded with zeros to [`MAX_AXES`] as in a [`servo::Macrostep`].
    pub const fn padded(&self) -> [f64; MAX_AXES] {
        self.values
    }

    /// The positions, padded with zeros. Fails if the number of axes is not `axes`, or if a position is not finite.
    pub(super) fn counted(&self, axes: usize) -> Result<&[f64; MAX_AXES], KinematicsError> {
        if usize::from(self.axes) != axes {
            return Err(KinematicsError::AxisCount { axes: axes as u8, given: self.axes });
        }
        if self.values.iter().all(|value| value.is_finite()) {
            Ok(&self.values)
        } else {
            Err(KinematicsError::NotFinite)
        }
    }

    /// A vector of the first `axes` of padded numbers.
    pub(super) fn from_padded(values: &[f64; MAX_AXES], axes: usize) -> Self {
        Self::new(&values[..axes]).expect("a robot has no more axes than the servo")
    }

    /// The positions as an array. Fails if the number of axes is not `N`, or if a position is not finite.
    pub fn exactly<const N: usize>(&self) -> Result<&[f64; N], KinematicsError> {
        let values: &[f64; N] =
            (**self).try_into().map_err(|_| KinematicsError::AxisCount { axes: N as u8, given: self.axes })?;
        if values.iter().all(|value| value.is_finite()) { Ok(values) } else { Err(KinematicsError::NotFinite) }
    }
}

impl<Space, const N: usize> From<[f64; N]> for Vector<Space> {
    fn from(values: [f64; N]) -> Self {
        const { assert!(N <= MAX_AXES) };
        Self::new(&values).expect("N is at most MAX_AXES")
    }
}

impl<Space> Deref for Vector<Space> {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.values[..usize::from(self.axes)]
    }
}

impl<Space> DerefMut for Vector<Space> {
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.values[..usize::from(self.axes)]
    }
}

impl<Space> fmt::Debug for Vector<Space> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_as_many_numbers_as_axes_and_no_more_than_the_servo() {
        let joints = Joints::new(&[1.0, 2.0]).unwrap();
        assert_eq!(&joints[..], [1.0, 2.0]);
        assert_eq!(joints, Joints::from([1.0, 2.0]));
        assert_eq!(joints.padded(), [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(Joints::new(&[0.0; MAX_AXES + 1]), None);
    }

    #[test]
    fn a_robot_takes_finite_numbers_of_its_own_count() {
        let joints = Joints::from([0.0, 1.0]);
        assert_eq!(joints.exactly::<2>(), Ok(&[0.0, 1.0]));
        assert_eq!(joints.exactly::<3>(), Err(KinematicsError::AxisCount { axes: 3, given: 2 }));
        let spoilt = Joints::from([0.0, f64::NAN]);
        assert_eq!(spoilt.exactly::<2>(), Err(KinematicsError::NotFinite));
    }
}
