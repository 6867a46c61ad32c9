//! Parameters that a cell may write to a drive. With every accepted parameter, the drive must stop when its host falls
//! silent.

use std::fs;
use std::time::Duration;

use ::mrroc::cell::{Cell, CellError, DriveControl, Parameter};
use can::Instant;
use can::timing::Bitrate;
use canopen::NodeId;
use canopen::eds::Eds;
use canopen::objects as named;
use drive::bus::CanBus;
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Power, Setpoint};
use hil::plant::Irp6Axis;
use hil::{AxisConfig, DeviceId, Epos4, Epos4Config, World};
use kit::mrroc::{root, text};

use crate::host_closed::closed_by_host;

/// Motor velocity, rad/s.
const VELOCITY: f64 = 50.0;

/// The first axis of the IRb-6 in velocity mode, with `parameter` for its drive, as `mrroc check` reads it.
fn cell_with(parameter: Parameter) -> Result<Cell, CellError> {
    let mut cell = Cell::parse(&text("irb6")).unwrap();
    let axis = &mut cell.robot[0].axis[0];
    closed_by_host(axis, Irp6Axis::Column, DriveControl::Velocity);
    axis.drive.as_mut().unwrap().parameter.push(parameter);
    Cell::parse(&toml::to_string(&cell).unwrap())
}

/// The axis, its drive and its host, in virtual time.
struct Stage {
    world: World,
    drive: DeviceId,
    group: CanBus<can::VirtualPort>,
    states: [AxisState; 1],
    period: Duration,
    now: Instant,
}

impl Stage {
    fn new(cell: &Cell) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::from_kbps(cell.bus[0].bitrate_kbps).unwrap());
        let port = world.host_port(bus, 256);
        let axis = &cell.robot[0].axis[0];
        let config = Epos4Config::new(NodeId::new(axis.node).unwrap(), AxisConfig::irp6(Irp6Axis::Column));
        let drive = world.add_device(bus, Box::new(Epos4::new(config)));
        let config = cell.group_config(0);
        Self {
            group: CanBus::new(port, config, &[axis.drive_config(0.0)]).unwrap(),
            world,
            drive,
            states: [AxisState::default()],
            period: config.period,
            now: Instant::ZERO,
        }
    }

    fn pass(&mut self) {
        self.now += self.period;
        self.world.advance(self.now);
    }

    fn cycle(&mut self, command: AxisCommand) {
        self.group.read(self.now, &mut self.states);
        self.group.write(self.now, &[command]);
        self.group.send(self.now);
        self.pass();
    }

    fn angle(&self) -> f64 {
        let drive: &Epos4 = self.world.device(self.drive).unwrap();
        drive.axis().angle()
    }

    /// Brings the drive up and moves it. Returns `false` if the drive refuses bring-up or does not switch on.
    fn moves(&mut self) -> bool {
        loop {
            match self.group.bring_up(self.now) {
                std::task::Poll::Pending => self.pass(),
                std::task::Poll::Ready(ended) if ended.is_ok() => break,
                std::task::Poll::Ready(_) => return false,
            }
        }
        for _ in 0..200 {
            self.cycle(AxisCommand::Stand);
        }
        if self.states[0].power != Power::On {
            return false;
        }
        let velocity = Setpoint::Velocity(Finite::new(VELOCITY).unwrap());
        for _ in 0..200 {
            self.cycle(AxisCommand::Follow(velocity));
        }
        true
    }
}

/// Every object of the emulated drive that is writable with up to four bytes, and its size.
fn writable() -> Vec<(u16, u8, u8)> {
    let sheet = fs::read(root().join("cells/epos4-emulated.eds")).unwrap();
    let sheet = Eds::read(&sheet).unwrap();
    let variables = sheet.variables();
    let writable = variables.filter(|(_, variable)| variable.access.writable());
    let sized = writable.filter_map(|(object, variable)| {
        let size = variable.data_type.size().filter(|size| *size <= 4)?;
        Some((object.index, object.subindex, size as u8))
    });
    sized.collect()
}

#[test]
fn an_arm_in_velocity_mode_stops_when_its_host_dies_whatever_parameters_a_cell_has() {
    const SAVE: u32 = u32::from_le_bytes(*b"save");
    let (mut refused, mut moved) = (0, 0);
    for (index, subindex, bytes) in writable() {
        for value in [0, 1, 15, SAVE, u32::MAX] {
            let parameter =
                Parameter { index, subindex, value: value & (u32::MAX >> (32 - 8 * u32::from(bytes))), bytes };
            let Ok(cell) = cell_with(parameter) else {
                refused += 1;
                continue;
            };
            let mut stage = Stage::new(&cell);
            if !stage.moves() {
                continue;
            }
            moved += 1;
            let died_at = stage.angle();
            let watched = 3 * cell.group_config(0).heartbeat_period;
            // The drive brakes at 1500 rad/s², and comes to rest within some tenths of a second.
            let end = stage.now + watched + Duration::from_millis(300);
            while stage.now < end {
                stage.pass();
            }
            let stopped_at = stage.angle();
            let way = (stopped_at - died_at).abs();
            let most = VELOCITY * (watched.as_secs_f64() + 0.1) + 1.0;
            assert!(way < most, "{parameter:?}: {way:.1} rad");
            for _ in 0..100 {
                stage.pass();
            }
            let late = (stage.angle() - stopped_at).abs();
            assert!(late < 0.01, "{parameter:?}: {late:.3} rad after the stop");
        }
    }
    // Both outcomes must occur.
    println!("{refused} refused, {moved} moved");
    assert!(refused > 100 && moved > 50, "{refused} refused, {moved} moved");
}

#[test]
fn parameters_of_the_safety_set_up_are_refused_by_line_key_and_name() {
    let cases = [
        (named::CONSUMER_HEARTBEAT_1, 0, 4, "falls silent"),
        (named::ABORT_CONNECTION_OPTION, 0, 2, "falls silent"),
        (named::QUICK_STOP_DECELERATION, 1, 4, "max_acceleration"),
        (named::FOLLOWING_ERROR_WINDOW, 0xFFFF_FFFF, 4, "following_error"),
        (named::CONTROLWORD, 15, 2, "commands the drive"),
        (named::STORE_ALL, 0x6576_6173, 4, "at every start"),
    ];
    for (object, value, bytes, why) in cases {
        let parameter = Parameter { index: object.index, subindex: object.subindex, value, bytes };
        let error = cell_with(parameter).unwrap_err();
        assert_eq!(error.key, "robot[0].axis[0].drive.parameter[0].index");
        assert!(error.line > 1);
        let text = error.to_string();
        for needle in [&object.to_string(), object.name().unwrap(), why] {
            assert!(text.contains(needle), "{needle}: {text}");
        }
    }
}
