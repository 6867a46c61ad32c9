//! Plants of the IRp-6 on a pedestal.

use super::axis::{AxisConfig, PlantConfig};
use super::friction::FrictionConfig;
use super::lab::MotorData;
use super::motor::Gravity;
use super::wut::WutConfig;

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
    pub const ALL: [Self; 6] = [
        Self::Column,
        Self::LowerArm,
        Self::UpperArm,
        Self::Pitch,
        Self::Roll,
        Self::Flange,
    ];
}

/// The parameters of one axis, at the motor.
struct Row {
    /// Motor angle of the synchronisation position, rad (public code).
    home: f64,
    /// Motor limits, rad (public code).
    travel: (f64, f64),
    /// Quadrature counts per turn (public code).
    counts: u32,
    /// Working current limit, A (public code).
    max_current: f64,
    /// Over-current threshold, A (public code; the upper arm's is nominal, since the public code contains 15 A
    /// twice).
    trip_current: f64,
    /// Rotor inertia, kg·m², and viscous friction, N·m·s/rad, in the robot's own emulator (public code).
    wut: (f64, f64),
    /// Inertia of the load at the motor, at home, kg·m² (derived from nominal masses).
    load: f64,
    /// Gravity at the motor: torque, N·m; motor angle per joint angle; joint angle at `home` above the horizontal,
    /// rad. Ratio and angle are from public code. The torque is derived from nominal masses: lower arm 12 kg at 0.20
    /// m, upper arm 14 kg at 0.25 m, wrist 4 kg, gripper 1.35 kg; no payload.
    gravity: (f64, f64, f64),
    /// Viscous friction, N·m·s/rad, Coulomb and static friction, N·m (nominal).
    friction: (f64, f64, f64),
    /// Winding: resistance, Ω, and inductance, H (nominal).
    winding: (f64, f64),
}

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

const ROWS: [Row; 6] = [
    Row {
        home: -15.9,
        travel: (-470.0, 450.0),
        counts: 4000,
        max_current: 20.0,
        trip_current: 25.0,
        wut: (1.5e-4, 0.02),
        load: 2.8e-4,
        gravity: (0.0, -158.0, 0.0),
        friction: (1e-3, 0.08, 0.12),
        winding: (0.6, 0.5e-3),
    },
    Row {
        home: -5.0,
        travel: (-110.0, 100.0),
        counts: 4000,
        max_current: 15.0,
        trip_current: 18.0,
        wut: (1.5e-4, 0.02),
        load: 2.0e-4,
        gravity: (0.63, 173.7, -QUARTER),
        friction: (1e-3, 0.08, 0.12),
        winding: (0.6, 0.5e-3),
    },
    Row {
        home: -8.527,
        travel: (-80.0, 100.0),
        counts: 4000,
        max_current: 15.0,
        trip_current: 17.0,
        wut: (1.5e-4, 0.02),
        load: 1.2e-4,
        gravity: (0.40, 175.1, 0.0),
        friction: (1e-3, 0.08, 0.12),
        winding: (0.6, 0.5e-3),
    },
    Row {
        home: 151.31,
        travel: (-70.0, 380.0),
        counts: 4000,
        max_current: 15.0,
        trip_current: 17.0,
        wut: (1.5e-4, 0.02),
        load: 0.3e-4,
        gravity: (-0.05, -128.0, 0.0),
        friction: (1e-3, 0.06, 0.09),
        winding: (0.6, 0.5e-3),
    },
    Row {
        home: 435.25,
        travel: (-80.0, 490.0),
        counts: 4000,
        max_current: 8.0,
        trip_current: 10.0,
        wut: (1.5e-5, 2e-4),
        load: 1.0e-5,
        gravity: (0.0, -76.8, 0.0),
        friction: (2e-4, 0.01, 0.015),
        winding: (1.2, 1.0e-3),
    },
    Row {
        home: 791.0,
        travel: (-1000.0, 3000.0),
        counts: 2000,
        max_current: 1.0,
        trip_current: 2.0,
        wut: (1.5e-5, 2e-4),
        load: 0.1e-5,
        gravity: (0.0, 288.8845, 0.0),
        friction: (2e-4, 0.01, 0.015),
        winding: (3.0, 2.5e-3),
    },
];

/// Torque per current of every motor of the arm, N·m/A (public code).
pub(super) const TORQUE_CONSTANT: f64 = 0.105;

/// Maximum output of the control cards on their supply of 48 V, V (public code: pulse widths up to 190 of 255).
pub(super) const MAX_VOLTAGE: f64 = 48.0 * 190.0 / 255.0;

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
        let row = &ROWS[axis as usize];
        let (amplitude, ratio, at_home) = row.gravity;
        let gravity = Gravity {
            amplitude,
            ratio,
            phase: at_home - row.home / ratio,
        };
        let motor = MotorData {
            home: row.home,
            travel: Some(row.travel),
            counts: row.counts,
            torque_constant: TORQUE_CONSTANT,
            winding: row.winding,
            inertia: row.wut.0 + row.load,
            friction: row.friction,
            max_current: row.max_current,
            trip_current: row.trip_current,
            max_voltage: MAX_VOLTAGE,
            brake: 5.0,
        };
        motor.axis(gravity, (row.home - 20.0, row.home - 2.0), 0)
    }

    /// An axis of the IRp-6 as the robot's own software emulates it. The sensors are the same. The motor has no
    /// windings, dry friction, gravity or noise.
    pub fn wut(axis: Irp6Axis) -> Self {
        let row = &ROWS[axis as usize];
        let (inertia, viscous) = row.wut;
        let mut config = Self::irp6(axis);
        config.plant = PlantConfig::Wut(WutConfig {
            torque_constant: TORQUE_CONSTANT,
            inertia,
            viscous,
            friction: FrictionConfig::NONE,
            resistance: row.winding.0,
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
            let PlantConfig::Physical(motor) = config.plant else {
                unreachable!("the preset is physical")
            };
            let found = motor.gravity.torque(config.index_angle + from_home);
            assert!(
                (found - torque).abs() < 1e-3,
                "{axis:?} at {from_home}: {found} N·m"
            );
        }
    }
}
