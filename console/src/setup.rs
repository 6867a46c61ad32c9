//! From a cell to what runs it: drive groups, the servo and the effector control processes.

use std::time::Duration;

use anyhow::Context;
use can::Port;
use controller::cell::{self, Bus, Cell, ENABLING, Policy, Serial};
use controller::ecp::EcpConfig;
use drive::DriveGroup;
use drive::axis_controller::AxisControllerGroup;
use drive::cia402::{AxisConfig, Cia402Group};
use serial::Line;
use servo::thread::{CellTime, Realtime, RealtimePolicy, Wait};
use servo::{EffectorConfig, ServoConfig};

use crate::cell_file::CellFile;
use crate::configuration::Configuration;

/// Longest time that all axes of an effector may take to home.
const HOMING: Duration = Duration::from_secs(120);

/// Macrosteps that a generator may be ahead of the servo if it need not see what the servo does: at the usual 20 ms
/// this rides through two seconds in which only the servo thread gets the processor. A stop drops them.
const LEAD: u16 = 100;

/// The drives of bus `bus`, in the order of [`Cell::axes_on`].
pub(crate) fn axis_configs(file: &CellFile, bus: usize) -> Vec<AxisConfig> {
    let config = |(robot, number): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[number];
        let configuration = file.configuration(robot, number);
        AxisConfig {
            identity: file.identity(robot, number),
            configuration: configuration.map_or_else(Vec::new, Configuration::settings),
            ..axis.drive_config(file.arms[robot].robot().home()[number])
        }
    };
    file.cell.axes_on(bus).map(config).collect()
}

/// One drive group per bus and bundle of lines, on the given ports and lines.
pub(crate) fn drive_groups(
    file: &CellFile,
    ports: Vec<Box<dyn Port>>,
    lines: Vec<Vec<Box<dyn Line>>>,
) -> anyhow::Result<Vec<Box<dyn DriveGroup>>> {
    let group = |((index, bus), port): ((usize, &Bus), _)| {
        let group = Cia402Group::new(
            port,
            file.cell.group_config(index),
            &axis_configs(file, index),
        );
        Ok(Box::new(group.with_context(|| format!("bus {}", bus.name))?) as Box<dyn DriveGroup>)
    };
    let bundle = |((index, bundle), lines): ((usize, &Serial), _)| {
        let config = |(robot, number): (usize, usize)| {
            let axis = &file.cell.robot[robot].axis[number];
            axis.controller_config(file.arms[robot].robot().home()[number])
        };
        let axes: Vec<_> = file
            .cell
            .axes_on(file.cell.bus.len() + index)
            .map(config)
            .collect();
        let group = AxisControllerGroup::new(lines, bundle.group_config(file.cell.period()), &axes);
        Ok(Box::new(group.with_context(|| format!("bus {}", bundle.name))?) as Box<dyn DriveGroup>)
    };
    let buses = file.cell.bus.iter().enumerate().zip(ports).map(group);
    let bundles = file.cell.serial.iter().enumerate().zip(lines).map(bundle);
    buses.chain(bundles).collect()
}

/// The servo of the whole cell.
pub(crate) fn servo_config(file: &CellFile) -> ServoConfig {
    let cell = &file.cell;
    let axis = |robot: usize, number: usize| {
        let axis = &cell.robot[robot].axis[number];
        let limits = file.arms[robot].robot().motor_limits()[number];
        let group = cell
            .groups()
            .position(|name| name == axis.bus)
            .expect("a parsed cell has the bus");
        let index_in_group = cell
            .axes_on(group)
            .position(|place| place == (robot, number));
        axis.servo_config(
            group,
            index_in_group.expect("the axis is on its bus"),
            limits,
        )
    };
    let effector = |(index, robot): (usize, &cell::Robot)| EffectorConfig {
        name: robot.name.clone(),
        axes: (0..robot.axis.len())
            .map(|number| axis(index, number))
            .collect(),
        queue: usize::from(LEAD) + 8,
        enabling_timeout: ENABLING,
        homing_timeout: HOMING,
    };
    ServoConfig {
        period: cell.period(),
        max_missed_in_row: cell.max_missed_in_row,
        effectors: cell.robot.iter().enumerate().map(effector).collect(),
    }
}

/// How the effector control processes pace their effectors.
pub(crate) fn ecp_config(cell: &Cell) -> EcpConfig {
    EcpConfig {
        period: cell.period(),
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
        wait: match realtime.wait {
            cell::Wait::Plain => Wait::Plain,
            cell::Wait::Hybrid => Wait::Hybrid {
                margin: realtime
                    .margin_us
                    .map(|margin| Duration::from_micros(margin.into())),
                spin_share: realtime.spin_share,
            },
        },
        time,
    }
}
