//! Parts of a run, made from a cell: drive groups, the servo and the effector control processes.

use std::collections::BTreeMap;
use std::time::Duration;

use can::Port;
use controller::ecp::{Ecp, EcpConfig, Meetings, Subcontrollers};
use controller::generator::Pace;
use controller::robot::Limits;
use drive::bus::CanBus;
use drive::cia402::{AxisConfig, CyclicMode};
use drive::{DriveGroup, axis_controller::AxisControllerGroup};
use serial::Line;
use servo::{EffectorConfig, EffectorLink, HostHoming, ServoAxisConfig, ServoConfig};

use crate::cell::{Bus, CellFile, DeviceConfiguration, ENABLING, Homing, Path, Robot, Serial};

/// Least homing time-out of an effector. The value also applies to a search by the drive of an axis without ends,
/// because the distance of such a search is unknown.
const HOMING: Duration = Duration::from_secs(120);

/// Greatest homing time-out of an effector.
const LONGEST_HOMING: Duration = Duration::from_secs(3600);

/// Longest first step of a generator.
const PLANNING: Duration = Duration::from_secs(60);

/// Number of macrosteps that a generator may be ahead of the servo, if the generator does not need feedback from the
/// servo. At the usual 20 ms, the queue bridges two seconds in which only the servo thread gets the processor. A stop
/// drops these macrosteps.
const MACROSTEPS_AHEAD: u16 = 100;

/// The drives of bus `bus`, in the order of `Cell::axes_on`.
pub fn axis_configs(file: &CellFile, bus: usize) -> Vec<AxisConfig> {
    let config = |(robot, number): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[number];
        let mut config = axis.drive_config(file.arms[robot].robot().home()[number]);
        config.identity = file.identity(robot, number);
        let first = file.configuration(robot, number).map_or_else(Vec::new, DeviceConfiguration::settings);
        // The cell's own parameters prevail, because they are downloaded after those of the file.
        config.configuration.splice(..0, first);
        config
    };
    file.cell.axes_on(bus).map(config).collect()
}

/// One drive group per bus and per bundle of lines, on the given ports and lines. The drive of axis `with_torque`,
/// given as robot and axis number, takes a torque beside the position.
pub fn drive_groups(
    file: &CellFile,
    ports: Vec<Box<dyn Port>>,
    lines: Vec<Vec<Box<dyn Line>>>,
    with_torque: Option<(usize, usize)>,
) -> anyhow::Result<Vec<Box<dyn DriveGroup>>> {
    let group = |((index, _), port): ((usize, &Bus), _)| {
        let mut axes = axis_configs(file, index);
        for (axis, place) in axes.iter_mut().zip(file.cell.axes_on(index)) {
            if Some(place) == with_torque {
                axis.mode = CyclicMode::CspWithTorque;
            }
        }
        let group = CanBus::new(port, file.cell.group_config(index), &axes);
        let refused = |error| file.refuse(&Path::to("bus").then(index), error);
        Ok(Box::new(group.map_err(refused)?) as Box<dyn DriveGroup>)
    };
    let bundle = |((index, bundle), lines): ((usize, &Serial), _)| {
        let config = |(robot, number): (usize, usize)| {
            let axis = &file.cell.robot[robot].axis[number];
            axis.controller_config(file.arms[robot].robot().home()[number])
        };
        let axes: Vec<_> = file.cell.axes_on(file.cell.bus.len() + index).map(config).collect();
        let group = AxisControllerGroup::new(lines, bundle.group_config(file.cell.period()), &axes);
        let refused = |error| file.refuse(&Path::to("serial").then(index), error);
        Ok(Box::new(group.map_err(refused)?) as Box<dyn DriveGroup>)
    };
    let buses = file.cell.bus.iter().enumerate().zip(ports).map(group);
    let bundles = file.cell.serial.iter().enumerate().zip(lines).map(bundle);
    buses.chain(bundles).collect()
}

/// The servo of the whole cell.
pub fn servo_config(file: &CellFile) -> ServoConfig {
    let cell = &file.cell;
    let effector = |(index, robot): (usize, &Robot)| {
        let axes = servo_axes(file, index);
        EffectorConfig {
            name: robot.name.clone(),
            queue: usize::from(MACROSTEPS_AHEAD) + 8,
            enabling_timeout: ENABLING,
            homing_timeout: homing_timeout(file, index, &axes),
            axes,
        }
    };
    ServoConfig {
        period: cell.period(),
        max_missed_in_row: cell.max_missed_in_row,
        effectors: cell.robot.iter().enumerate().map(effector).collect(),
    }
}

/// The effector control processes of a cell, on the links to its servo.
pub fn subcontrollers(file: &CellFile, links: Vec<EffectorLink>) -> Subcontrollers {
    let ecp = |(robot, link): (usize, _)| Ecp::new(file.arms[robot].clone(), link, ecp_config(file, robot));
    let ecps = links.into_iter().enumerate().map(ecp);
    let meetings = Meetings::new(file.cell.meetings().into_iter().map(|meeting| meeting.robots));
    Subcontrollers::new(ecps.collect(), meetings)
}

fn servo_axes(file: &CellFile, robot: usize) -> Vec<ServoAxisConfig> {
    let cell = &file.cell;
    let axis = |number: usize| {
        let axis = &cell.robot[robot].axis[number];
        let limits = file.arms[robot].robot().motor_limits()[number];
        let group = cell.groups().position(|name| name == axis.bus).expect("a parsed cell has the bus");
        let index_in_group = cell.axes_on(group).position(|it| it == (robot, number)).expect("the axis is on its bus");
        cell.robot[robot].servo_config(number, group, index_in_group, limits)
    };
    (0..cell.robot[robot].axis.len()).map(axis).collect()
}

/// Homing time-out of an effector: the sum over the homing orders, each with the longest search of its axes. Each
/// phase of a search by the host has its own time-out.
fn homing_timeout(file: &CellFile, robot: usize, axes: &[ServoAxisConfig]) -> Duration {
    let mut orders = BTreeMap::<u8, Duration>::new();
    let limits = file.arms[robot].robot().motor_limits();
    let given = file.cell.robot[robot].axis.iter().zip(limits);
    for (axis, (given, limits)) in axes.iter().zip(given) {
        let longest = orders.entry(axis.homing_order).or_default();
        let search = match axis.homing {
            Some(homing) => longest_search(homing),
            None => longest_search_by_drive(&given.homing, *limits),
        };
        *longest = search.max(*longest);
    }
    let sum = orders.into_values().fold(Duration::ZERO, Duration::saturating_add);
    sum.max(HOMING).min(LONGEST_HOMING)
}

/// Longest search by a drive: to one end of the travel, back over the whole travel, and off a switch of the same
/// width.
fn longest_search_by_drive(homing: &Homing, limits: Limits) -> Duration {
    let travel = limits.high - limits.low;
    let seconds = 2.0 * travel / homing.search_velocity + travel / homing.zero_velocity;
    match Duration::try_from_secs_f64(seconds) {
        Ok(search) if search <= LONGEST_HOMING => search,
        _ => HOMING,
    }
}

/// Longest search by the host. The search starts on the home switch, leaves it, reverses at a limit switch, and
/// returns to the home switch. Each rest begins with a stop.
fn longest_search(homing: HostHoming) -> Duration {
    let velocity = homing.search.velocity.max(homing.zero.velocity);
    let stop = Duration::try_from_secs_f64(velocity / homing.acceleration).unwrap_or(LONGEST_HOMING);
    let rest = stop.saturating_add(homing.pause);
    let legs = homing.search.timeout.saturating_mul(4);
    legs.saturating_add(homing.zero.timeout).saturating_add(rest.saturating_mul(4))
}

/// Timing of the effector control process of robot `robot`.
fn ecp_config(file: &CellFile, robot: usize) -> EcpConfig {
    let cell = &file.cell;
    EcpConfig {
        period: cell.period(),
        pace: Pace { periods: cell.macrostep, read_at: cell.macrostep.saturating_sub(2).max(1) },
        macrosteps_ahead: MACROSTEPS_AHEAD,
        silence: Duration::from_secs(10),
        switching: ENABLING * 2,
        planning: PLANNING,
        homing: homing_timeout(file, robot, &servo_axes(file, robot)) + ENABLING,
        meeting: Duration::from_secs(cell.meeting_timeout_s.into()),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// The time-outs of the robot of an example cell.
    fn timeouts(cell: &str) -> (Duration, Duration) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells").join(cell);
        let file = CellFile::read(&path).unwrap();
        let servo = servo_config(&file).effectors[0].homing_timeout;
        (servo, ecp_config(&file, 0).homing)
    }

    #[test]
    fn searches_of_the_host_get_the_time_of_their_legs_and_those_of_drives_that_of_the_travel() {
        // The Polycrank's axes have no ends: two homing orders of two minutes.
        assert_eq!(timeouts("polycrank.toml").0, HOMING * 2);
        let (servo, ecp) = timeouts("irp6-track.toml");
        // The track alone: 2100 rad at 30 rad/s in both directions, and off the switch at 3.5 rad/s.
        assert!(servo > Duration::from_secs(740) && ecp == servo + ENABLING, "{servo:?}");
        assert!(servo <= LONGEST_HOMING);
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-serial.toml");
        let axes = servo_axes(&CellFile::read(&path).unwrap(), 0);
        // Every axis reverses at a limit switch and returns over its whole travel, in four homing orders.
        let there_and_back = |axis: &ServoAxisConfig| {
            let homing = axis.homing.unwrap();
            3 * homing.search.timeout + homing.zero.timeout + 3 * homing.pause
        };
        let of_order = |order: u8| {
            let axes = axes.iter().filter(|axis| axis.homing_order == order);
            axes.map(there_and_back).max().unwrap()
        };
        let needed: Duration = (1..=4).map(of_order).sum();
        let (servo, ecp) = timeouts("irb6-serial.toml");
        assert!(servo >= needed && needed > HOMING, "{servo:?}, {needed:?}");
        assert!(servo <= LONGEST_HOMING && ecp == servo + ENABLING);
    }
}
