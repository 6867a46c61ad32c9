//! Parts of a run, made from a cell: drive groups, the servo and the effector control processes.

use std::collections::BTreeMap;
use std::time::Duration;

use can::{Instant, Port};
use controller::ecp::{Ecp, EcpConfig, Meetings, Subcontrollers};
use controller::generator::Pace;
use controller::law::{PositionForce, PositionForceConfig, RehearsedLaw};
use controller::robot::Limits;
use controller::sensor::{ForceSensorConfig, ForceTorque};
use drive::DriveGroup;
use drive::axis_controller::{self, AxisControllerGroup};
use drive::bus::CanBus;
use drive::camera::CameraLink;
use drive::cia401::{IoLink, RehearsedIo};
use drive::cia402::{AxisConfig, CyclicMode};
use drive::ultrasonic::{RehearsedUltrasonic, UltrasonicLink, UltrasonicMatrix};
use drive::wrench::{RehearsedWrench, SerialWrenchSensor, WrenchLink};
use serial::Line;
use servo::{CycleLaw, EffectorConfig, EffectorLink, HostHoming, Servo, ServoAxisConfig, ServoConfig};

use crate::cell::{
    Bus, CellFile, DeviceConfiguration, ENABLING, ForceLaw, Homing, IoNode, Path, Robot, Serial, Ultrasonic,
};

/// Least homing time-out of an effector. The value also applies to a search by the drive of an axis without ends,
/// because the distance of such a search is unknown.
const HOMING: Duration = Duration::from_secs(120);

/// Greatest homing time-out of an effector.
const LONGEST_HOMING: Duration = Duration::from_secs(3600);

/// Longest first step of a generator.
const PLANNING: Duration = Duration::from_secs(60);

/// Number of the cell's macrosteps that a generator may be ahead of the servo, if the generator does not need feedback
/// from the servo. At the usual 20 ms, the queue bridges two seconds in which only the servo thread gets the processor.
/// A stop drops these macrosteps.
const MACROSTEPS_AHEAD: u16 = 100;

/// The drives of bus `bus`, in the order of `Cell::axes_on`.
pub fn axis_configs(file: &CellFile, bus: usize) -> Vec<AxisConfig> {
    let config = |(robot, number): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[number];
        let mut config = axis.drive_config(file.arms[robot].robot().home()[number]);
        config.identity = file.identity(robot, number);
        let limits = file.arms[robot].robot().motor_limits()[number];
        config.position_range =
            Some((axis.min_position.unwrap_or(limits.low), axis.max_position.unwrap_or(limits.high)));
        let first = file.configuration(robot, number).map_or_else(Vec::new, DeviceConfiguration::settings);
        // The cell's own parameters prevail, because they are downloaded after those of the file.
        config.configuration.splice(..0, first);
        config
    };
    file.cell.axes_on(bus).map(config).collect()
}

/// The axis controllers of bundle `bundle`, in the order of `Cell::axes_on`.
pub fn controller_configs(file: &CellFile, bundle: usize) -> Vec<axis_controller::AxisConfig> {
    let config = |(robot, number): (usize, usize)| {
        let axis = &file.cell.robot[robot].axis[number];
        axis.controller_config(file.arms[robot].robot().home()[number])
    };
    file.cell.axes_on(file.cell.bus.len() + bundle).map(config).collect()
}

/// The devices of a cell on their ports and lines.
pub struct Devices {
    /// One drive group per bus, per bundle of lines, per force sensor on a line and per ultrasonic matrix, in the order of
    /// [`Cell::groups`](crate::cell::Cell::groups).
    pub groups: Vec<Box<dyn DriveGroup>>,
    /// One link per I/O node, in the order of [`Cell::io`](crate::cell::Cell::io). Inputs are valid from the end of
    /// bring-up until the groups are dropped.
    pub io: Vec<IoLink>,
    /// One link per force sensor, in the order of [`Cell::force_sensor`](crate::cell::Cell::force_sensor). Readings are
    /// valid from the end of bring-up until the groups are dropped.
    pub sensors: Vec<WrenchLink>,
    /// One link per ultrasonic matrix, in the order of [`Cell::ultrasonic`](crate::cell::Cell::ultrasonic).
    pub matrices: Vec<UltrasonicLink>,
}

/// The drive groups, I/O nodes and sensors of a cell, on the given ports and lines. `sensor_lines`: the lines of the force
/// sensors, then of the ultrasonic matrices. The drive of axis `with_torque`, given as robot and axis number, takes a
/// torque in addition to the position.
pub fn devices(
    file: &CellFile,
    ports: Vec<Box<dyn Port>>,
    lines: Vec<Vec<Box<dyn Line>>>,
    sensor_lines: Vec<Box<dyn Line>>,
    with_torque: Option<(usize, usize)>,
) -> anyhow::Result<Devices> {
    let (mut links, mut sensors) = (Vec::new(), Vec::new());
    let group = |((index, _), port): ((usize, &Bus), _)| {
        let mut axes = axis_configs(file, index);
        for (axis, place) in axes.iter_mut().zip(file.cell.axes_on(index)) {
            if Some(place) == with_torque {
                axis.mode = CyclicMode::CspWithTorque;
            }
        }
        let config = file.cell.group_config(index);
        let (io, nodes) = (file.cell.io_configs(index), file.cell.sensor_configs(index));
        let bus = CanBus::with_sensors(port, config, &axes, &io, &nodes);
        let refused = |error| file.refuse(&Path::to("bus").then(index), error);
        let (group, of_bus, of_sensors) = bus.map_err(refused)?;
        sensors.extend(file.cell.sensors_on(index).zip(of_sensors));
        links.extend(file.cell.io_on(index).zip(of_bus));
        Ok(Box::new(group) as Box<dyn DriveGroup>)
    };
    let bundle = |((index, bundle), lines): ((usize, &Serial), _)| {
        let axes = controller_configs(file, index);
        let group = AxisControllerGroup::new(lines, bundle.group_config(file.cell.period()), &axes);
        let refused = |error| file.refuse(&Path::to("serial").then(index), error);
        Ok(Box::new(group.map_err(refused)?) as Box<dyn DriveGroup>)
    };
    let buses = file.cell.bus.iter().enumerate().zip(ports).map(group);
    let bundles = file.cell.serial.iter().enumerate().zip(lines).map(bundle);
    let mut groups = buses.chain(bundles).collect::<anyhow::Result<Vec<_>>>()?;
    links.sort_by_key(|(node, _)| *node);
    let mut matrices = Vec::new();
    let mut sensor_lines = sensor_lines.into_iter();
    for (index, line) in file.cell.serial_sensors().zip(sensor_lines.by_ref()) {
        let driver = SerialWrenchSensor::new(line, file.cell.force_sensor[index].config(file.cell.period()));
        let (driver, link) = driver.map_err(|error| file.refuse(&Path::to("force_sensor").then(index), error))?;
        groups.push(Box::new(driver));
        sensors.push((index, link));
    }
    for ((index, matrix), line) in file.cell.ultrasonic.iter().enumerate().zip(sensor_lines) {
        let driver = UltrasonicMatrix::new(line, matrix.config(file.cell.period()));
        let (driver, link) = driver.map_err(|error| file.refuse(&Path::to("ultrasonic").then(index), error))?;
        groups.push(Box::new(driver));
        matrices.push(link);
    }
    sensors.sort_by_key(|(sensor, _)| *sensor);
    let sensors = sensors.into_iter().map(|(_, link)| link).collect();
    Ok(Devices { groups, io: links.into_iter().map(|(_, link)| link).collect(), sensors, matrices })
}

/// The I/O nodes of a rehearsal whose emulated devices are switched on at [`Instant::ZERO`], and their links in the
/// order of [`Cell::io`](crate::cell::Cell::io). The inputs follow the schedules of the cell file. Touch probes
/// stay at rest.
pub fn rehearsed_io(file: &CellFile) -> (Vec<RehearsedIo>, Vec<IoLink>) {
    let node = |io: &IoNode| {
        let edges = io.emulated_edges().map(|(at, input, _)| (Instant::ZERO + at, input));
        let probes = file.cell.scene.iter().flat_map(|scene| &scene.touch_probe).filter(|probe| probe.closed_at_rest);
        let high = probes.filter_map(|probe| io.input.iter().find(|input| input.name == probe.input));
        let edges = high.map(|input| (Instant::ZERO, input.line)).chain(edges);
        RehearsedIo::new(&io.config(file.cell.period()), edges)
    };
    file.cell.io.iter().map(node).unzip()
}

/// The force sensors of a rehearsal, and their links in the order of
/// [`Cell::force_sensor`](crate::cell::Cell::force_sensor).
pub fn rehearsed_sensors(file: &CellFile) -> (Vec<RehearsedWrench>, Vec<WrenchLink>) {
    file.cell.force_sensor.iter().map(|_| RehearsedWrench::new()).unzip()
}

/// The ultrasonic matrices of a rehearsal, and their links in the order of
/// [`Cell::ultrasonic`](crate::cell::Cell::ultrasonic).
pub fn rehearsed_matrices(file: &CellFile) -> (Vec<RehearsedUltrasonic>, Vec<UltrasonicLink>) {
    let period = file.cell.period();
    let matrix = |given: &Ultrasonic| RehearsedUltrasonic::new(given.config(period).scan_time());
    file.cell.ultrasonic.iter().map(matrix).unzip()
}

/// The links to the cameras of a rehearsal, in the order of [`Cell::camera`](crate::cell::Cell::camera). The cameras give no
/// pictures.
pub fn rehearsed_cameras(file: &CellFile) -> Vec<CameraLink> {
    file.cell.camera.iter().map(|_| CameraLink::rehearsed()).collect()
}

/// The virtual force sensors of a cell, on the links to their drivers and to the servo.
pub fn force_sensors(file: &CellFile, links: &[WrenchLink], robots: &[EffectorLink]) -> Vec<ForceTorque> {
    let sensor = |(number, link): (usize, &WrenchLink)| {
        let (given, robot) = (&file.cell.force_sensor[number], file.cell.robot_of_sensor(number));
        let config = ForceSensorConfig {
            arm: file.arms[robot].clone(),
            upright_from_base: file.cell.robot[robot].numbers().upright_from_base(),
            flange_from_sensor: given.flange_from_sensor(),
            lag: given.tool_lag(),
            load: given.load().expect("a parsed cell has sound tools"),
            max_offset: given.max_offsets(),
            range: given.ranges(),
        };
        ForceTorque::new(link.clone(), robots[robot].latest.clone(), config)
    };
    links.iter().enumerate().map(sensor).collect()
}

/// Installs the force laws of the cell in its servo, on the virtual force sensors. Call this function before the first
/// cycle.
pub fn install_laws(file: &CellFile, servo: &mut Servo, sensors: &[ForceTorque]) -> anyhow::Result<()> {
    install(file, servo, |robot, law| {
        let number = law.sensor(&file.cell.force_sensor).expect("a parsed cell has the sensor of a law");
        let (given, sensor) = (&file.cell.force_sensor[number], &sensors[number]);
        let load = given.load().expect("a parsed cell has sound tools");
        let config = PositionForceConfig {
            arm: file.arms[robot].clone(),
            upright_from_base: file.cell.robot[robot].numbers().upright_from_base(),
            flange_from_sensor: given.flange_from_sensor(),
            lag: given.tool_lag(),
            load: (!load.is_none()).then_some(load),
            zeroed: Some(sensor.zeroed_weight()),
            payload: Some(sensor.payload()),
            limits: law.limits(&file.cell),
        };
        Ok(Box::new(PositionForce::new(config, sensor.link().clone())?))
    })
}

/// Installs laws that check their parameters and move nothing, for a rehearsal.
pub fn install_rehearsed_laws(file: &CellFile, servo: &mut Servo) -> anyhow::Result<()> {
    install(file, servo, |_, _| Ok(Box::new(RehearsedLaw)))
}

fn install(
    file: &CellFile,
    servo: &mut Servo,
    make: impl Fn(usize, &ForceLaw) -> anyhow::Result<Box<dyn CycleLaw>>,
) -> anyhow::Result<()> {
    for (index, robot) in file.cell.robot.iter().enumerate() {
        if let Some(law) = &robot.force_law {
            let made = make(index, law)?;
            let refused = |error| file.refuse(&Path::to("robot").then(index).then("force_law"), error);
            servo.install_law(index, made, &law.bounds()).map_err(refused)?;
        }
    }
    Ok(())
}

/// The servo of the whole cell.
pub fn servo_config(file: &CellFile) -> ServoConfig {
    let cell = &file.cell;
    let effector = |(index, robot): (usize, &Robot)| {
        let axes = servo_axes(file, index);
        EffectorConfig {
            name: robot.name.clone(),
            queue: ecp_config(file, index).most_orders() + 8,
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
    fn the_io_nodes_of_a_rehearsal_follow_the_schedules_of_the_cell() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-touch.toml");
        let (mut nodes, links) = rehearsed_io(&CellFile::read(&path).unwrap());
        let mut levels_at = |seconds: f64| {
            nodes[0].advance(Instant::ZERO + Duration::from_secs_f64(seconds));
            let image = links[0].inputs.read();
            [0, 3].map(|line| image.input(line).unwrap().level)
        };
        // The touch probe is closed from the beginning, and inverted.
        let expected = [(0.0, [false, false]), (19.9, [false, true]), (20.1, [true, true]), (26.0, [false, false])];
        for (seconds, levels) in expected {
            assert_eq!(levels_at(seconds), levels, "{seconds} s");
        }
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
