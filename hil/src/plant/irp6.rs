//! Plants of the IRp-6 on a pedestal.

use super::axis::{AxisConfig, PlantConfig};
use super::{friction::FrictionConfig, lab::MotorData, wut::WutConfig};

/// The axes of the IRp-6 robot on a pedestal, in the order of its software. The robot is an IRb-6 with a sixth axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Irp6Axis {
    /// Axis 1, about the vertical.
    Column,
    /// Axis 2.
    LowerArm,
    /// Axis 3. Its angle is absolute because of its parallelogram.
    UpperArm,
    /// Axis 4, T. Its angle is absolute because of its rods.
    Pitch,
    /// Axis 5, V.
    Roll,
    /// Axis 6, N. The IRb-6 has no such axis.
    Flange,
}

impl Irp6Axis {
    /// All axes, in order.
    pub const ALL: [Self; 6] = [Self::Column, Self::LowerArm, Self::UpperArm, Self::Pitch, Self::Roll, Self::Flange];
}

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// Rotor inertia, kg·m², and viscous friction, N·m·s/rad, in the robot's own emulator (public code): axes 1 to 4, and
/// axes 5 and 6.
const ARM_WUT: (f64, f64) = (1.5e-4, 0.02);
const WRIST_WUT: (f64, f64) = (1.5e-5, 2e-4);

/// The motor of the column without a load. The maximum voltage is that of the control cards on their supply of 48 V
/// (public code: pulse widths up to 190 of 255). Friction, winding and brake are nominal; home, travel and gravity
/// are placeholders; the other values are from public code.
pub(super) const COLUMN: MotorData = MotorData {
    home: 0.0,
    travel: None,
    counts: 4000,
    torque_constant: 0.105,
    winding: (0.6, 0.5e-3),
    inertia: ARM_WUT.0,
    gravity: (0.0, 1.0, 0.0),
    friction: (1e-3, 0.08, 0.12),
    max_current: 20.0,
    trip_current: 25.0,
    max_voltage: 48.0 * 190.0 / 255.0,
    brake: 5.0,
};

/// The motors of the wrist, as far as they are alike.
const WRIST: MotorData = MotorData { friction: (2e-4, 0.01, 0.015), ..COLUMN };

/// Home, travel, counts, currents, ratios and angles at home are from public code. The over-current threshold of the
/// upper arm is nominal, since the public code contains 15 A twice. The inertia of each load, at home, and the weights
/// are derived from nominal masses: lower arm 12 kg at 0.20 m, upper arm 14 kg at 0.25 m, wrist 4 kg, gripper 1.35 kg;
/// no payload. Friction and windings are nominal.
const AXES: [MotorData; 6] = [
    MotorData {
        home: -15.9,
        travel: Some((-470.0, 450.0)),
        inertia: ARM_WUT.0 + 2.8e-4,
        gravity: (0.0, -158.0, 0.0),
        ..COLUMN
    },
    MotorData {
        home: -5.0,
        travel: Some((-110.0, 100.0)),
        inertia: ARM_WUT.0 + 2.0e-4,
        gravity: (0.63, 173.7, -QUARTER),
        max_current: 15.0,
        trip_current: 18.0,
        ..COLUMN
    },
    MotorData {
        home: -8.527,
        travel: Some((-80.0, 100.0)),
        inertia: ARM_WUT.0 + 1.2e-4,
        gravity: (0.40, 175.1, 0.0),
        max_current: 15.0,
        trip_current: 17.0,
        ..COLUMN
    },
    MotorData {
        home: 151.31,
        travel: Some((-70.0, 380.0)),
        inertia: ARM_WUT.0 + 0.3e-4,
        gravity: (-0.05, -128.0, 0.0),
        friction: (1e-3, 0.06, 0.09),
        max_current: 15.0,
        trip_current: 17.0,
        ..COLUMN
    },
    MotorData {
        home: 435.25,
        travel: Some((-80.0, 490.0)),
        winding: (1.2, 1.0e-3),
        inertia: WRIST_WUT.0 + 1.0e-5,
        gravity: (0.0, -76.8, 0.0),
        max_current: 8.0,
        trip_current: 10.0,
        ..WRIST
    },
    MotorData {
        home: 791.0,
        travel: Some((-1000.0, 3000.0)),
        counts: 2000,
        winding: (3.0, 2.5e-3),
        inertia: WRIST_WUT.0 + 0.1e-5,
        gravity: (0.0, 288.8845, 0.0),
        max_current: 1.0,
        trip_current: 2.0,
        ..WRIST
    },
];

impl AxisConfig {
    /// An axis of the IRp-6 as a motor with load, friction, gravity and switches.
    ///
    /// Motor angles follow the robot's own software: each index pulse lies where homing of the axis ends. The
    /// following values are nominal, to be replaced by measurement: windings, friction, masses, temperatures, ripple,
    /// and the positions of the switches. The home switch is closed from 20 rad to 2 rad below the home position. The
    /// motor starts 20 rad above the home position. Limit switches close at the motor limits. The buffers begin 3 rad
    /// beyond the limits.
    ///
    /// Following errors in a trapezoidal motion at 50 rad/s and 150 rad/s², with a set-point each 1 or 2 ms: within
    /// 5, 6, 14, 12, 10 and 7 counts for the axes in order.
    pub fn irp6(axis: Irp6Axis) -> Self {
        let motor = &AXES[axis as usize];
        motor.axis((motor.home - 20.0, motor.home - 2.0), 0)
    }

    /// An axis of the IRp-6 as the robot's own software emulates it. The sensors are the same. The motor has no
    /// windings, dry friction, gravity or noise.
    pub fn wut(axis: Irp6Axis) -> Self {
        let motor = &AXES[axis as usize];
        let (inertia, viscous) = match axis {
            Irp6Axis::Roll | Irp6Axis::Flange => WRIST_WUT,
            Irp6Axis::Column | Irp6Axis::LowerArm | Irp6Axis::UpperArm | Irp6Axis::Pitch => ARM_WUT,
        };
        let mut config = Self::irp6(axis);
        config.plant = PlantConfig::Wut(WutConfig {
            torque_constant: motor.torque_constant,
            inertia,
            viscous,
            friction: FrictionConfig::NONE,
            resistance: motor.winding.0,
        });
        config.amplifier.inertia = inertia;
        config.edge_jitter = 0.0;
        config
    }
}

#[cfg(test)]
mod tests {
    use super::{AxisConfig, Irp6Axis, PlantConfig};

    #[test]
    fn arms_weigh_as_their_pose_says() {
        // At home the lower arm is upright, and the upper arm and the gripper are horizontal. Positive motor angles
        // lean the lower arm out, lower the upper arm and raise the gripper. The weight pulls the upper arm down.
        let cases = [
            (Irp6Axis::Column, 50.0, 0.0),
            (Irp6Axis::LowerArm, 0.0, 0.0),
            (Irp6Axis::LowerArm, 173.7 * 0.5, 0.302),
            (Irp6Axis::LowerArm, -173.7 * 0.5, -0.302),
            (Irp6Axis::UpperArm, 0.0, 0.40),
            (Irp6Axis::UpperArm, 175.1 * 0.5, 0.351),
            (Irp6Axis::Pitch, 0.0, -0.05),
            (Irp6Axis::Roll, 10.0, 0.0),
            (Irp6Axis::Flange, 10.0, 0.0),
        ];
        for (axis, from_home, torque) in cases {
            let config = AxisConfig::irp6(axis);
            let PlantConfig::Physical(motor) = config.plant else { unreachable!("the preset is physical") };
            let found = motor.gravity.torque(config.index_angle + from_home);
            assert!((found - torque).abs() < 1e-3, "{axis:?} at {from_home}: {found} N·m");
        }
    }
}
