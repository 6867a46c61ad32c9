//! Drives that do not match their cell: `mrroc run` by the clock refuses them and switches none on.

use ::mrroc::cell::{Cell, Instruction};
use can::{Frame, Id, Instant, StandardId, clock};
use canopen::NodeId;
use hil::epos4::{Epos4, Epos4Config};
use hil::{AxisConfig, Device};
use kit::adapter::Adapter;
use kit::mrroc::{Directory, enables, mrroc, text, trace};
use kit::processors;
use kit::refusals::refused;
use kit::{PERIOD, by_the_clock};

#[test]
fn by_the_wall_clock_as_well_no_drive_is_switched_on_that_is_another() {
    by_the_clock(0.25, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |cell| cell.robot[0].axis[2].emulator.vendor = Some(0x1234));
        let log = directory.path("drives.log");
        let run = mrroc(["run".as_ref(), cell.as_os_str(), "--trace".as_ref(), log.as_os_str()]);
        refused(&run, &["bus arm, axis upper-arm: node 3: ", "0x1018:01", "0x00001234", "0x000000fb"]);
        let frames = trace(&log);
        assert!(!frames.is_empty());
        assert_eq!(enables(&frames), 0);
    });
}

/// An emulated EPOS4 with additional or replaced objects. They are the ratio objects of CiA 402-2, which no EPOS4 has.
struct Scaled {
    drive: Epos4,
    node: u8,
    numbers: &'static [(u16, u8, u32)],
    answer: Option<Frame>,
}

impl Device for Scaled {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        let of_this = frame.id() == StandardId::new(0x600 + u16::from(self.node)).map(Id::Standard);
        if let (true, &[0x40, low, high, subindex, ..]) = (of_this, frame.data()) {
            let asked = (u16::from_le_bytes([low, high]), subindex);
            let mut numbers = self.numbers.iter();
            if let Some(&(.., value)) = numbers.find(|it| (it.0, it.1) == asked) {
                let [a, b, c, d] = value.to_le_bytes();
                let id = StandardId::new(0x580 + u16::from(self.node)).unwrap();
                self.answer = Frame::new(id, &[0x43, low, high, subindex, a, b, c, d]);
                return;
            }
        }
        self.drive.handle(frame, now);
    }
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let answer = self.answer.take();
        answer.or_else(|| self.drive.poll_transmit(now))
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.drive.poll_timeout()
    }
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.handle_timeout(now);
    }
}

/// Objects of a drive that define its scale, and the required parts of the refusal.
type Scale = (&'static [(u16, u8, u32)], &'static str);

/// The cell of the belt has 4000 counts per motor revolution, measured at the motor shaft.
const SCALES: &[Scale] = &[
    (
        &[(0x6091, 1, 158), (0x6091, 2, 1)],
        "0x6091:01 is 158 motor revolutions per shaft revolution, the cell says 1: set 1/1",
    ),
    (
        &[(0x6092, 1, 3600), (0x6092, 2, 1), (0x608F, 1, 4000)],
        "0x6092:01 is 3600 position units per shaft revolution, the cell says 4000: correct",
    ),
    (
        &[(0x608F, 1, 8192), (0x608F, 2, 3)],
        "0x608f:01 is 8192/3 encoder increments per motor revolution, the cell says 4000: correct",
    ),
    (&[(0x3000, 5, 4096)], "0x3000:05 is 4096 quadrature counts per revolution, the cell says 4000: correct"),
    (
        &[(0x6076, 0, 840_000)],
        "0x6076:00 is 840000 µN·m of rated torque, the cell says 420000: correct drive.rated_torque",
    ),
];

#[test]
fn a_drive_whose_own_ratios_are_not_the_cells_is_refused_on_a_bus_and_not_switched_on() {
    let _share = processors::take(0.25);
    let directory = Directory::new();
    let cell = directory.cell("lab", |cell| {
        cell.robot.retain(|robot| robot.name == "conveyor");
        cell.robot[0].program.retain(|it| matches!(it, Instruction::Joints(_)));
        let bus = cell.robot[0].axis[0].bus.clone();
        cell.bus.retain(|it| it.name == bus);
        cell.serial.clear();
    });
    let node = Cell::parse(&text("lab")).unwrap().robot.last().unwrap().axis[0].node;
    for &(numbers, needle) in SCALES {
        let config = Epos4Config {
            power_on: clock::now(),
            ..Epos4Config::new(NodeId::new(node).unwrap(), AxisConfig::conveyor())
        };
        let drive = Scaled { drive: Epos4::new(config), node, numbers, answer: None };
        let log = directory.path("scale.log");
        let run = Adapter::new(Some(Box::new(drive))).served(|tty| {
            let interface = format!("slcan:{}", tty.display());
            mrroc([
                "run".as_ref(),
                cell.as_os_str(),
                "--bench=card".as_ref(),
                "--can".as_ref(),
                interface.as_ref(),
                "--force".as_ref(),
                "--trace".as_ref(),
                log.as_os_str(),
            ])
        });
        refused(&run, &["axis belt: node 4: ", needle]);
        let frames = trace(&log);
        assert!(!frames.is_empty(), "{needle}");
        assert_eq!(enables(&frames), 0, "{needle}");
    }
}
