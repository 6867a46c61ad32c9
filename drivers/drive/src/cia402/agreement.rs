//! Agreement of a drive's scale and rated torque with the cell.

use std::f64::consts::TAU;

use canopen::Object;
use canopen::objects::*;

use super::config::AxisConfig;
use super::program::MAXON;
use crate::BringUpError;

const CORRECT_COUNTS: &str = "correct drive.counts_per_revolution or the drive's own setting";
const CORRECT_GEAR: &str = "set 1/1 in the drive, the cell counts at the motor shaft";
const CORRECT_TORQUE: &str = "correct drive.rated_torque or the drive's motor data";

/// An expected value of an object of the drive's dictionary. A drive without the object is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Agreement {
    pub(crate) object: Object,
    /// The divisor, where the quantity is a ratio of two objects.
    pub(crate) divisor: Option<Object>,
    /// The agreement applies only where the drive lacks the object of the previous agreement.
    pub(crate) instead: bool,
    expected: u32,
    /// Greatest accepted difference from `expected`.
    tolerance: u32,
    what: &'static str,
    remedy: &'static str,
}

impl Agreement {
    /// Checks that `found` / `per` is the expected value, within the tolerance.
    pub(crate) fn check(&self, node: u8, found: u32, per: u32) -> Result<(), BringUpError> {
        let expected = u64::from(self.expected) * u64::from(per);
        let apart = u64::from(found).abs_diff(expected);
        if per > 0 && apart <= u64::from(self.tolerance) {
            return Ok(());
        }
        Err(BringUpError::WrongScale {
            node,
            object: self.object,
            found,
            per,
            expected: self.expected,
            what: self.what,
            remedy: self.remedy,
        })
    }
}

/// All agreements that the dictionary of an axis's drive is checked for.
///
/// Position units per motor revolution are feed constant (0x6092) / gear ratio (0x6091), both of the factor group (CiA
/// 402-2 §9). According to manuals of CiA 402 drives, the drive converts position units to encoder increments by
/// encoder resolution (0x608F) * gear ratio / feed constant. The encoder may therefore be finer than the position
/// units. A drive without a feed constant counts increments of its encoder. Object 0x60A8, the SI unit of position, is
/// not read: its use differs between vendors.
///
/// EPOS4 has none of these ratios. The position unit of an EPOS4 is an increment of the main sensor, and object
/// 0x3000:05 is the resolution of that sensor in quadrature counts.
///
/// The rated torque matters in every mode. In CST, the rated torque scales the torque loop; in the other modes, it
/// scales the reported torque.
pub(super) fn of(axis: &AxisConfig) -> Vec<Agreement> {
    let counts = axis.scale.distance(TAU).unwrap_or(u32::MAX);
    let ratio = |object, divisor, expected, what, remedy| Agreement {
        object,
        divisor,
        instead: false,
        expected,
        tolerance: 0,
        what,
        remedy,
    };
    let encoder = ratio(
        POSITION_ENCODER_INCREMENTS,
        Some(POSITION_ENCODER_REVOLUTIONS),
        counts,
        "encoder increments per motor revolution",
        CORRECT_COUNTS,
    );
    let mut agreements = vec![
        ratio(
            GEAR_MOTOR_REVOLUTIONS,
            Some(GEAR_SHAFT_REVOLUTIONS),
            1,
            "motor revolutions per shaft revolution",
            CORRECT_GEAR,
        ),
        ratio(FEED, Some(FEED_SHAFT_REVOLUTIONS), counts, "position units per shaft revolution", CORRECT_COUNTS),
        Agreement { instead: true, ..encoder },
    ];
    if axis.identity.vendor == MAXON {
        agreements.push(ratio(
            EPOS4_MAIN_SENSOR_RESOLUTION,
            None,
            counts,
            "quadrature counts per revolution",
            CORRECT_COUNTS,
        ));
    }
    // Object 0x6076 counts mN·m, as manuals of CiA 402 drives give it. Maxon counts µN·m, as published drivers for EPOS4
    // read it.
    let (unit, what) = match axis.identity.vendor {
        MAXON => (1e-6, "µN·m of rated torque"),
        _ => (1e-3, "mN·m of rated torque"),
    };
    let expected = (axis.rated_torque / unit).round() as u32;
    agreements.push(Agreement {
        // 1 %, or one unit of the object where 1 % is less.
        tolerance: (expected / 100).max(1),
        ..ratio(MOTOR_RATED_TORQUE, None, expected, what, CORRECT_TORQUE)
    });
    agreements
}
