//! From the keys of a cell to the configurations of its drive groups and of the servo's axes.

use std::time::Duration;

use drive::Scale;
use drive::cia402::{AxisConfig, CyclicMode, GroupConfig, HomingConfig, Identity, NodeId};
use servo::ServoAxisConfig;

use super::{Axis, Cell, Parameter};
use crate::robot::Limits;

/// Longest time from switching an effector's drives on to the last of them following.
pub const ENABLING: Duration = Duration::from_secs(5);

impl Cell {
    /// The servo period.
    pub fn period(&self) -> Duration {
        Duration::from_micros(u64::from(self.period_us))
    }

    /// The axes on bus `bus` as pairs of robot and axis numbers, in the order of the bus's drive group.
    pub fn axes_on(&self, bus: usize) -> impl Iterator<Item = (usize, usize)> {
        let robots = self.robot.iter().enumerate();
        let axes =
            robots.flat_map(|(robot, value)| (0..value.axis.len()).map(move |axis| (robot, axis)));
        axes.filter(move |&(robot, axis)| self.robot[robot].axis[axis].bus == self.bus[bus].name)
    }

    /// What the drives of bus `bus` have in common.
    pub fn group_config(&self, bus: usize) -> GroupConfig {
        let bus = &self.bus[bus];
        let milliseconds = |count: u32| Duration::from_millis(u64::from(count));
        GroupConfig {
            period: self.period(),
            tolerated_missing: bus.tolerated_missing,
            heartbeat_period: milliseconds(u32::from(bus.heartbeat_ms)),
            host_node: node(bus.host_node),
            sdo_timeout: milliseconds(bus.sdo_timeout_ms),
            sdo_retries: 2,
            boot_timeout: milliseconds(bus.boot_timeout_ms),
            transition_timeout: ENABLING,
        }
    }
}

impl Axis {
    /// Between motor positions, rad, and the counts of its drive, whose homed counter reads zero at the
    /// motor position `home`, rad.
    pub fn scale(&self, home: f64) -> Scale {
        let counts = self.drive.counts_per_revolution as i32;
        let signed = if self.drive.reversed { -counts } else { counts };
        Scale::new(signed, home).expect("a parsed cell has counts and finite home positions")
    }

    /// Its drive, homed at the motor position `home`, rad.
    pub fn drive_config(&self, home: f64) -> AxisConfig {
        let parameter = |given: &Parameter| drive::cia402::Parameter {
            index: given.index,
            subindex: given.subindex,
            value: given.value,
            size: given.bytes,
        };
        AxisConfig {
            node: node(self.node),
            identity: Identity {
                vendor: self.drive.vendor,
                product: self.drive.product,
                revision: self.drive.revision,
            },
            mode: CyclicMode::Csp,
            scale: self.scale(home),
            rated_torque: self.drive.rated_torque,
            homing: HomingConfig {
                method: self.homing.method,
                search_speed: self.homing.search_velocity,
                zero_speed: self.homing.zero_velocity,
                acceleration: self.homing.acceleration,
            },
            following_error: self.following_error,
            quick_stop_deceleration: self.max_acceleration,
            configuration: Vec::new(),
            parameters: self.drive.parameter.iter().map(parameter).collect(),
        }
    }

    /// What the servo holds it to, within the motor's own `limits`, as axis `index_in_group` of drive
    /// group `group`.
    pub fn servo_config(
        &self,
        group: usize,
        index_in_group: usize,
        limits: Limits,
    ) -> ServoAxisConfig {
        ServoAxisConfig {
            group,
            index_in_group,
            min_position: self.min_position.unwrap_or(limits.low),
            max_position: self.max_position.unwrap_or(limits.high),
            max_velocity: self.max_velocity,
            max_acceleration: self.max_acceleration,
            following_error: self.following_error,
            homing_order: self.homing.order,
        }
    }
}

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).expect("a parsed cell has valid node-IDs")
}
