//! A host that speaks to one drive byte by byte.

mod drive;
mod regression;
mod telegrams;

use std::time::Duration;

use can::Instant;
use serial::nfv2::{Answer, Command, Frame, FrameBuilder, Mode, Status};
use serial::{Line, Settings, VirtualLine, hi_moxa};

use super::{AxisController, AxisControllerConfig, Cabinet, GAP};
use crate::{AxisConfig, Irp6Axis, LineDevice, LineId, World};

const PERIOD: Duration = Duration::from_millis(2);
const ADDRESS: u8 = 8;
const READS: [Command; 3] = [Command::ReadPosition, Command::ReadCurrent, Command::ReadStatus];

struct Rig {
    world: World,
    line: LineId,
    host: VirtualLine,
    now: Instant,
}

impl Rig {
    fn new(device: Box<dyn LineDevice>) -> Self {
        let mut world = World::new();
        let line = world.add_line(Settings::AXIS_CONTROLLER, None, device);
        let host = world.host_line(line, 4096);
        Self { world, line, host, now: Instant::ZERO }
    }

    fn nfv2(config: &AxisControllerConfig) -> Self {
        Self::new(Box::new(AxisController::nfv2(ADDRESS, config)))
    }

    fn hi_moxa(config: &AxisControllerConfig) -> Self {
        Self::new(Box::new(AxisController::hi_moxa(config)))
    }

    /// Writes now, and returns the bytes received one period later.
    fn exchange(&mut self, request: &[u8]) -> Vec<u8> {
        assert_eq!(self.host.write(self.now, request), Ok(request.len()));
        self.now += PERIOD;
        self.world.advance(self.now);
        let mut into = [0; 4096];
        let count = self.host.read(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// One cycle with NFv2: `commands`, then the three reads.
    fn cycle(&mut self, commands: &[Command]) -> Reading {
        let answer = self.exchange(&frame(ADDRESS, commands));
        let frame = Frame::parse(&answer).unwrap_or_else(|| panic!("no frame: {answer:02x?}"));
        assert_eq!(frame.address, ADDRESS);
        let answers: Result<Vec<_>, _> = frame.answers().collect();
        match answers.as_deref() {
            Ok(&[Answer::Position(position), Answer::Current(current), Answer::Status(status)]) => {
                Reading { position, current, status }
            }
            other => panic!("{other:?}"),
        }
    }

    /// One cycle with the older telegrams.
    fn old_cycle(&mut self, request: hi_moxa::Request) -> hi_moxa::Answer {
        let answer = self.exchange(&request.encode_cyclic());
        hi_moxa::Answer::decode(answer.try_into().expect("one answer"))
    }

    fn device(&self) -> &AxisController {
        self.world.line(self.line).device().expect("it is one")
    }
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    position: i32,
    current: i16,
    status: Status,
}

impl Reading {
    fn is(&self, bit: u16) -> bool {
        self.status.any(bit)
    }
}

fn frame(address: u8, commands: &[Command]) -> Vec<u8> {
    let all = commands.iter().chain(&READS);
    let mut builder = FrameBuilder::new(address);
    all.for_each(|command| _ = builder.command(*command));
    builder.finish().expect("it fits").to_vec()
}

fn column() -> AxisControllerConfig {
    AxisControllerConfig::new(AxisConfig::irp6(Irp6Axis::Column))
}
