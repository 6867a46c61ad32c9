//! From a cell to what runs it: drive groups, the servo and the effector control processes.

use std::time::Duration;

use anyhow::Context;
use can::Port;
use canopen::NodeId;
use controller::cell::{Axis, Bus, Cell, Policy};
use controller::ecp::EcpConfig;
use drive::cia402::{
    AxisConfig, Cia402Group, CyclicMode, GroupConfig, HomingConfig, Identity, Parameter,
};
use drive::{DriveGroup, Scale};
use servo::thread::{CellTime, Realtime, RealtimePolicy};
use servo::{EffectorConfig, ServoAxisConfig, ServoConfig};

use crate::cell_file::CellFile;

/// Longest time from switching an effector's drives on to the last of them following.
const ENABLING: Duration = Duration::from_secs(5);

/// Longest time that all axes of an effector may take to home.
const HOMING: Duration = Duration::from_secs(120);

/// Macrosteps that a generator may be ahead of the servo if it need not see what the servo does: at the usual 20 ms
/// this rides through two seconds in which only the servo thread gets the processor. A stop drops them.
const LEAD: u16 = 100;

/// The axes on bus `bus` as pairs of robot and axis numbers, in the order of the bus's drive group.
pub(crate) fn axes_on(cell: &Cell, bus: usize) -> impl Iterator<Item = (usize, usize)> {
    let robots = cell.robot.iter().enumerate();
    let axes =
        robots.flat_map(|(robot, value)| (0..value.axis.len()).map(move |axis| (robot, axis)));
    axes.filter(move |&(robot, axis)| cell.robot[robot].axis[axis].bus == cell.bus[bus].name)
}

/// The servo period.
pub(crate) fn period(cell: &Cell) -> Duration {
    Duration::from_micros(u64::from(cell.period_us))
}

/// What the drives of a bus have in common.
pub(crate) fn group_config(cell: &Cell, bus: &Bus) -> GroupConfig {
    let milliseconds = |count: u32| Duration::from_millis(u64::from(count));
    GroupConfig {
        period: period(cell),
        tolerated_missing: bus.tolerated_missing,
        heartbeat_period: milliseconds(u32::from(bus.heartbeat_ms)),
        host_node: node(bus.host_node),
        sdo_timeout: milliseconds(bus.sdo_timeout_ms),
        sdo_retries: 2,
        boot_timeout: milliseconds(bus.boot_timeout_ms),
        transition_timeout: ENABLING,
    }
}

/// The drives of bus `bus`, in the order of [`axes_on`].
pub(crate) fn axis_configs(file: &CellFile, bus: usize) -> Vec<AxisConfig> {
    let config = |(robot, number): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[number];
        axis_config(axis, file.arms[robot].robot().home()[number])
    };
    axes_on(&file.cell, bus).map(config).collect()
}

fn axis_config(axis: &Axis, home: f64) -> AxisConfig {
    let counts = axis.drive.counts_per_revolution as i32;
    let signed = if axis.drive.reversed { -counts } else { counts };
    let parameter = |given: &controller::cell::Parameter| Parameter {
        index: given.index,
        subindex: given.subindex,
        value: given.value,
        size: given.bytes,
    };
    AxisConfig {
        node: node(axis.node),
        identity: Identity {
            vendor: axis.drive.vendor,
            product: axis.drive.product,
            revision: None,
        },
        mode: CyclicMode::Csp,
        scale: Scale::new(signed, home)
            .expect("a parsed cell has counts and finite home positions"),
        rated_torque: axis.drive.rated_torque,
        homing: HomingConfig {
            method: axis.homing.method,
            search_speed: axis.homing.search_velocity,
            zero_speed: axis.homing.zero_velocity,
            acceleration: axis.homing.acceleration,
        },
        following_error: axis.following_error,
        quick_stop_deceleration: axis.max_acceleration,
        parameters: axis.drive.parameter.iter().map(parameter).collect(),
    }
}

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).expect("a parsed cell has valid node-IDs")
}

/// One drive group per bus, on the given ports.
pub(crate) fn drive_groups(
    file: &CellFile,
    ports: Vec<Box<dyn Port>>,
) -> anyhow::Result<Vec<Box<dyn DriveGroup>>> {
    let group = |((index, bus), port): ((usize, &Bus), _)| {
        let group = Cia402Group::new(
            port,
            group_config(&file.cell, bus),
            &axis_configs(file, index),
        );
        Ok(Box::new(group.with_context(|| format!("bus {}", bus.name))?) as Box<dyn DriveGroup>)
    };
    file.cell
        .bus
        .iter()
        .enumerate()
        .zip(ports)
        .map(group)
        .collect()
}

/// The servo of the whole cell.
pub(crate) fn servo_config(file: &CellFile) -> ServoConfig {
    let cell = &file.cell;
    let axis = |robot: usize, number: usize| {
        let axis = &cell.robot[robot].axis[number];
        let limits = file.arms[robot].robot().motor_limits()[number];
        let group = cell
            .bus
            .iter()
            .position(|bus| bus.name == axis.bus)
            .expect("a parsed cell has the bus");
        let index_in_group = axes_on(cell, group).position(|place| place == (robot, number));
        ServoAxisConfig {
            group,
            index_in_group: index_in_group.expect("the axis is on its bus"),
            min_position: axis.min_position.unwrap_or(limits.low),
            max_position: axis.max_position.unwrap_or(limits.high),
            max_velocity: axis.max_velocity,
            max_acceleration: axis.max_acceleration,
            following_error: axis.following_error,
            homing_order: axis.homing.order,
        }
    };
    let effector = |(index, robot): (usize, &controller::cell::Robot)| EffectorConfig {
        name: robot.name.clone(),
        axes: (0..robot.axis.len())
            .map(|number| axis(index, number))
            .collect(),
        queue: usize::from(LEAD) + 8,
        enabling_timeout: ENABLING,
        homing_timeout: HOMING,
    };
    ServoConfig {
        period: period(cell),
        max_missed_in_row: cell.max_missed_in_row,
        effectors: cell.robot.iter().enumerate().map(effector).collect(),
    }
}

/// How the effector control processes pace their effectors.
pub(crate) fn ecp_config(cell: &Cell) -> EcpConfig {
    EcpConfig {
        period: period(cell),
        steps: cell.macrostep,
        report_at: cell.macrostep.saturating_sub(2).max(1),
        lead: LEAD,
        silence: Duration::from_secs(10),
        switching: ENABLING * 2,
        homing: HOMING + ENABLING,
    }
}

/// What the servo thread asks of the host.
pub(crate) fn realtime_policy(cell: &Cell, time: CellTime) -> RealtimePolicy {
    let realtime = &cell.realtime;
    RealtimePolicy {
        realtime: match realtime.policy {
            Policy::Require => Realtime::Require,
            Policy::BestEffort => Realtime::BestEffort,
        },
        priority: realtime.priority,
        cpu: realtime.cpu,
        lock_memory: realtime.lock_memory,
        lead: Duration::ZERO,
        time,
    }
}
