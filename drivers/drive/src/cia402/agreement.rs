use std::f64::consts::TAU;

use canopen::Object;
use canopen::objects::*;

use super::config::AxisConfig;
use super::program::MAXON;
use crate::BringUpError;

/// Vendors whose object 0x6076 has a unit of its own, N·m: maxon counts µN·m (EPOS4 Firmware Specification, 0x6076).
const TORQUE_UNITS: [(u32, f64); 1] = [(MAXON, 1e-6)];
/// The unit of object 0x6076 in CiA 402-2, N·m.
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
/// EPOS4 has none of CiA 402-2's ratios: it counts increments of its main sensor, whose resolution it reckons from the
/// encoder's settings (0x3000:05, quadrature counts). Its gear (0x3003) scales neither positions nor velocities.
///
/// The rated torque counts in every mode: in CST it scales the loop, and elsewhere every torque that is reported.
pub(super) fn of(axis: &AxisConfig) -> Vec<Agreement> {
    let counts = axis.scale.distance(TAU).unwrap_or(u32::MAX);
    let ratio = |object, divisor, expected, what, remedy| Agreement {
        object,
        divisor,
        expected,
        tolerance: 0,
        what,
        remedy,
    };
    let mut agreements = vec![
        ratio(
            POSITION_ENCODER_INCREMENTS,
            Some(POSITION_ENCODER_REVOLUTIONS),
            counts,
            "encoder increments per motor revolution",
            CORRECT_COUNTS,
        ),
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
        expected,
        // 1 %, or the last digit of a small motor.
        tolerance: (expected / 100).max(1),
        what,
        remedy: CORRECT_TORQUE,
    });
    agreements
}
