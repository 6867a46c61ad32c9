//! Geometries whose inverse kinematics has a closed form, found from the numbers of a chain.

use std::fmt;

use servo::MAX_AXES;

use super::gantry::Gantry;
use super::geometry::Geometry;
use super::parallel::{ParallelArm, Scara};
use super::pose_error::Target;
use super::screws::Screws;
use super::wrist::SphericalWrist;

/// A geometry whose inverse kinematics has a closed form with all branches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClosedForm {
    /// Six revolute axes, of which the last three meet. Of the first three axes, two neighbours meet or are parallel.
    SphericalWrist,
    /// Six revolute axes. Axes 1, 2 and 3 are parallel, and axes 4 and 5 meet.
    ThreeParallelAxes,
    /// Five revolute axes, of which axes 1, 2 and 3 are parallel.
    PlanarFiveAxis,
    /// Three parallel revolute axes and a linear axis along them.
    Scara,
    /// Three linear axes, and up to three revolute axes behind them.
    Cartesian,
}

impl fmt::Display for ClosedForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SphericalWrist => "spherical wrist",
            Self::ThreeParallelAxes => "three parallel axes",
            Self::PlanarFiveAxis => "planar five-axis arm",
            Self::Scara => "SCARA",
            Self::Cartesian => "Cartesian",
        })
    }
}

/// A closed form with its numbers.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Form {
    Wrist(SphericalWrist),
    Parallel(ParallelArm, ClosedForm),
    Scara(Scara),
    Gantry(Gantry),
}

impl Form {
    pub(super) fn find(geometry: &Geometry) -> Option<Self> {
        let screws = &Screws::new(geometry);
        let parallel = match geometry.axes {
            5 => ClosedForm::PlanarFiveAxis,
            _ => ClosedForm::ThreeParallelAxes,
        };
        SphericalWrist::find(screws)
            .map(Self::Wrist)
            .or_else(|| ParallelArm::find(screws).map(|arm| Self::Parallel(arm, parallel)))
            .or_else(|| Scara::find(screws).map(Self::Scara))
            .or_else(|| Gantry::find(screws).map(Self::Gantry))
    }

    pub(super) fn name(&self) -> ClosedForm {
        match self {
            Self::Wrist(_) => ClosedForm::SphericalWrist,
            Self::Parallel(_, name) => *name,
            Self::Scara(_) => ClosedForm::Scara,
            Self::Gantry(_) => ClosedForm::Cartesian,
        }
    }

    /// Offers at most eight branches of a pose. Returns whether the pose leaves an angle open. An open angle is taken
    /// from `near`. A branch may miss a pose that is out of reach.
    pub(super) fn visit(&self, target: &Target, near: &[f64; MAX_AXES], offer: impl FnMut(&[f64; MAX_AXES])) -> bool {
        match self {
            Self::Wrist(form) => form.visit(target, near, offer),
            Self::Parallel(form, _) => form.visit(target, near, offer),
            Self::Scara(form) => form.visit(target, near, offer),
            Self::Gantry(form) => form.visit(target, near, offer),
        }
    }
}
