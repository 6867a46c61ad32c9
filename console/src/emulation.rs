//! From a cell to the emulated axis controllers that stand in for its drives.

use can::timing::Bitrate;
use can::{Instant, VirtualPort};
use canopen::NodeId;
use controller::cell::{Model, Plant};
use hil::epos4::{Epos4, Epos4Config};
use hil::plant::Switch;
use hil::{AxisConfig, BusId, Device, Irp6Axis, World};

use crate::cell_file::CellFile;

/// Frames that the host's end of a virtual bus holds each way.
const QUEUE: usize = 256;

/// The emulated cell on virtual buses.
pub(crate) struct Emulation {
    pub(crate) world: World,
}

impl Emulation {
    /// The world of a cell, switched on at [`Instant::ZERO`], and the host's port of each of its buses.
    pub(crate) fn of(file: &CellFile) -> (Self, Vec<VirtualPort>) {
        let mut world = World::new();
        let mut ports = Vec::new();
        for index in 0..file.cell.bus.len() {
            let bus = add_bus(&mut world, file, index);
            ports.push(world.host_port(bus, QUEUE));
        }
        (Self { world }, ports)
    }
}

/// Adds bus `bus` of a cell with its devices, switched on at [`Instant::ZERO`].
pub(crate) fn add_bus(world: &mut World, file: &CellFile, bus: usize) -> BusId {
    let id = world.add_bus(bitrate(file, bus));
    for device in devices(file, bus, Instant::ZERO) {
        world.add_device(id, device);
    }
    id
}

/// The bit rate of bus `bus`.
pub(crate) fn bitrate(file: &CellFile, bus: usize) -> Bitrate {
    Bitrate::from_kbps(file.cell.bus[bus].bitrate_kbps)
        .expect("a parsed cell has possible bit rates")
}

/// The devices on bus `bus`, switched on at `power_on`.
pub(crate) fn devices(file: &CellFile, bus: usize, power_on: Instant) -> Vec<Box<dyn Device>> {
    let present =
        |&(robot, axis): &(usize, usize)| !file.cell.robot[robot].axis[axis].emulator.absent;
    file.cell
        .axes_on(bus)
        .filter(present)
        .map(|(robot, axis)| device(file, robot, axis, power_on))
        .collect()
}

fn device(file: &CellFile, robot: usize, number: usize, power_on: Instant) -> Box<dyn Device> {
    let axis = &file.cell.robot[robot].axis[number];
    let home = file.arms[robot].robot().home()[number];
    let limits = file.arms[robot].robot().motor_limits()[number];
    let kind = match file.cell.robot[robot].model {
        Model::Irb6 | Model::Irp6 | Model::Irp6Calibrated => Irp6Axis::ALL[number],
    };
    let preset = match axis.emulator.plant {
        Plant::Physical => AxisConfig::irp6(kind),
        Plant::Wut => AxisConfig::wut(kind),
    };
    let switch = |from, to| {
        Some(Switch {
            from,
            to,
            bounce: 0,
        })
    };
    let plant = AxisConfig {
        counts_per_revolution: axis.counts_per_revolution(),
        index_angle: home,
        start_angle: axis.emulator.start.unwrap_or(home + 20.0),
        home_switch: switch(home - 20.0, home - 2.0),
        negative_limit: switch(f64::NEG_INFINITY, limits.low),
        positive_limit: switch(limits.high, f64::INFINITY),
        ..preset
    };
    let seed = file
        .cell
        .seed
        .wrapping_mul(1000)
        .wrapping_add((robot * 16 + number) as u64);
    let node = NodeId::new(axis.node).expect("a parsed cell has valid node-IDs");
    let vendor = axis.emulator.vendor.unwrap_or(axis.cia402().vendor);
    let config = Epos4Config {
        vendor,
        seed,
        power_on,
        ..Epos4Config::new(node, plant)
    };
    Box::new(Epos4::new(config))
}
