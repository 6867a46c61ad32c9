//! Agreement of a drive's own scale and rated torque with the cell.

use std::f64::consts::TAU;

use canopen::Object;
use canopen::objects::*;

use super::config::AxisConfig;
use super::program::MAXON;
use crate::BringUpError;

/// Vendors whose object 0x6076 has a unit of its own, N·m: maxon counts µN·m, as published drivers for
/// EPOS4 read it.
const TORQUE_UNITS: [(u32, f64); 1] = [(MAXON, 1e-6)];
/// The unit of object 0x6076 elsewhere, N·m, as manuals of CiA 402 drives give it.
const TORQUE_UNIT: f64 = 1e-3;

const CORRECT_COUNTS: &str = "correct drive.counts_per_revolution or the drive's own setting";
const CORRECT_GEAR: &str = "set 1/1 in the drive, the cell counts at the motor shaft";
const CORRECT_TORQUE: &str = "correct drive.rated_torque or the drive's motor data";

/// A number in which a drive that has the object must agree with the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Agreement {
    pub(super) object: Object,
    /// Of a ratio, the object that the first is divided by.
    pub(super) divisor: Option<Object>,
    /// It counts only where the drive has not the object of the agreement before.
    pub(super) instead: bool,
    expected: u32,
    /// How far it may be from `expected`.
    tolerance: u32,
    what: &'static str,
    remedy: &'static str,
}

impl Agreement {
    /// Whether `found` / `per` is what the cell says.
    pub(super) fn check(&self, node: u8, found: u32, per: u32) -> Result<(), BringUpError> {
        let expected = u64::from(self.expected) * u64::from(per);
        let apart = u64::from(found).abs_diff(expected);
        if per > 0 && apart <= u64::from(self.tolerance) {
            return Ok(());
        }
        Err(BringUpError::WrongScale {
            node,
            index: self.object.index,
            subindex: self.object.subindex,
            found,
            per,
            expected: self.expected,
            what: self.what,
            remedy: self.remedy,
        })
    }
}

/// All that the dictionary of an axis's drive must agree in.
///
/// Position units per motor revolution are feed constant (0x6092) / gear ratio (0x6091): a drive makes its increments of
/// them by encoder resolution (0x608F) * gear ratio / feed constant, as manuals of CiA 402 drives have it, so that its
/// encoder may be finer than the units. One without a feed constant counts increments of its encoder. What a vendor
/// makes of 0x60A8, the SI unit of position, is its own affair and not asked for.
///
/// EPOS4 has none of these ratios: it counts increments of its main sensor, whose resolution in quadrature counts is
/// object 0x3000:05.
///
/// The rated torque counts in every mode: in CST it scales the loop, and elsewhere every torque that is reported.
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
        ratio(
            FEED,
            Some(FEED_SHAFT_REVOLUTIONS),
            counts,
            "position units per shaft revolution",
            CORRECT_COUNTS,
        ),
        Agreement {
            instead: true,
            ..encoder
        },
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
    let mut units = TORQUE_UNITS.iter();
    let own = units.find(|(vendor, _)| *vendor == axis.identity.vendor);
    let (unit, what) = match own {
        Some((_, unit)) => (*unit, "µN·m of rated torque"),
        None => (TORQUE_UNIT, "mN·m of rated torque"),
    };
    let expected = (axis.rated_torque / unit).round() as u32;
    agreements.push(Agreement {
        object: MOTOR_RATED_TORQUE,
        divisor: None,
        instead: false,
        expected,
        // 1 %, or the last digit of a small motor.
        tolerance: (expected / 100).max(1),
        what,
        remedy: CORRECT_TORQUE,
    });
    agreements
}
