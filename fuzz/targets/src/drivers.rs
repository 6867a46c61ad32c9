//! Drivers of serial lines against emulated devices, while lines have faults and third parties send bytes.

use std::sync::LazyLock;
use std::task::Poll;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use can::Instant;
use drive::axis_controller::{AxisControllerGroup, GroupConfig, Protocol};
use drive::ultrasonic::{UltrasonicConfig, UltrasonicMatrix};
use drive::wrench::{SerialWrenchConfig, SerialWrenchSensor};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, Finite, Setpoint};
use hil::{
    AxisController, AxisControllerConfig, DeviceFault, DriveId, EchoProbe, FaultInEffect, LineDevice, LineFaults,
    LineId, SerialForceSensor, SerialForceSensorConfig, Stuck, TransducerConfig, WireFaults, World, WorldFault,
};
use mrroc::bench::plants;
use mrroc::cell::CellFile;
use serial::nfv2::{Answer, Command, FrameBuilder, Status};
use serial::{Settings, VirtualLine};

use crate::devices::{Load, of_example};

/// Most cycles of an input.
const MOST: u32 = 600;
const PERIOD: Duration = Duration::from_millis(2);
const ADDRESS: u8 = 1;

/// The cells of the drives, by protocol.
static NFV2: LazyLock<CellFile> = LazyLock::new(|| of_example("irb6-serial"));
static HI_MOXA: LazyLock<CellFile> = LazyLock::new(|| of_example("irb6-hi-moxa"));

/// A device at a line and its driver.
struct Bench<G> {
    world: World,
    line: LineId,
    group: G,
    states: Vec<AxisState>,
    now: Instant,
    faults: Vec<FaultInEffect>,
    cycles: u32,
}

/// A world with a device at a line.
fn world(settings: Settings, device: Box<dyn LineDevice>) -> (World, LineId, VirtualLine) {
    let mut world = World::new();
    let line = world.add_line(settings, None, device);
    let host = world.host_line(line, 4096);
    (world, line, host)
}

impl<G: DriveGroup> Bench<G> {
    fn new(group: G, world: World, line: LineId) -> Self {
        let states = vec![AxisState::default(); group.axes()];
        Self { world, line, group, states, now: Instant::ZERO, faults: Vec::new(), cycles: 0 }
    }

    fn pass(&mut self) {
        self.now += PERIOD;
        self.world.advance(self.now);
    }

    /// Brings the group up, with disturbances as long as the input has any. Returns why the group is not up.
    fn bring_up(&mut self, input: &mut Unstructured) -> Result<(), BringUpError> {
        for _ in 0..60_000 {
            match self.group.bring_up(self.now) {
                Poll::Ready(Ok(())) => return Ok(()),
                Poll::Ready(Err(error)) => {
                    assert!(!error.to_string().is_empty());
                    return Err(error);
                }
                Poll::Pending => {}
            }
            if input.is_empty() {
                self.heal();
            } else if bool::arbitrary(input).unwrap_or_default() {
                let _ = self.act(input);
            }
            self.pass();
        }
        panic!("the bring-up does not end");
    }

    /// One disturbance of the line.
    fn act(&mut self, input: &mut Unstructured) -> arbitrary::Result<()> {
        let line = self.line;
        let fault = match input.int_in_range(0..=9_u8)? {
            0..=1 => WorldFault::Bytes { line, to_host: bool::arbitrary(input)?, bytes: Vec::arbitrary(input)? },
            2..=4 => WorldFault::Bytes { line, to_host: true, bytes: answer(input)? },
            5..=6 => WorldFault::Line { line, faults: line_faults(input)? },
            7 => {
                let faults = [
                    DeviceFault::Unplugged,
                    DeviceFault::Reset,
                    DeviceFault::PowerOff,
                    DeviceFault::AnswersFrozen,
                    DeviceFault::AnswersOld,
                    DeviceFault::AnswersReversed,
                    DeviceFault::AnswersGarbled,
                ];
                WorldFault::Device { drive: DriveId::Line(line), fault: *input.choose(&faults)? }
            }
            8 if u8::arbitrary(input)? < 8 => WorldFault::HangUp { line },
            _ => {
                self.heal();
                return Ok(());
            }
        };
        let effect = self.world.begin_fault(&fault, self.now);
        self.faults.push(effect);
        Ok(())
    }

    fn heal(&mut self) {
        for fault in self.faults.drain(..) {
            self.world.end_fault(&fault, self.now);
        }
    }

    fn cycle(&mut self, command: AxisCommand) {
        self.group.read(self.now, &mut self.states);
        for state in &self.states {
            for value in [state.position, state.velocity, state.torque] {
                assert!(value.is_finite(), "{state:?}");
            }
            assert!(state.sampled <= self.now && state.at <= self.now, "{state:?}");
            assert!(state.fault.is_none() || !state.following, "{state:?}");
            assert!(state.fault.is_none_or(|fault| !fault.to_string().is_empty()));
        }
        let commands = vec![command; self.states.len()];
        self.group.write(self.now, &commands);
        self.group.send(self.now);
        self.cycles += 1;
        self.pass();
    }

    /// Cycles and disturbances by turns, with `judge` after each.
    fn disturb(&mut self, input: &mut Unstructured, mut judge: impl FnMut(u8)) -> arbitrary::Result<()> {
        while self.cycles < MOST && !input.is_empty() {
            let choice = u8::arbitrary(input)?;
            if choice < 128 {
                let command = command(input)?;
                for _ in 0..input.int_in_range(1..=20)? {
                    self.cycle(command);
                    judge(choice);
                }
            } else {
                self.act(input)?;
            }
        }
        Ok(())
    }
}

fn command(input: &mut Unstructured) -> arbitrary::Result<AxisCommand> {
    let value = f64::from(i8::arbitrary(input)?) / 100.0;
    let setpoint = match input.int_in_range(0..=3_u8)? {
        0 => Setpoint::Torque(Finite::new(value).unwrap()),
        1 => Setpoint::Position(Finite::new(value).unwrap()),
        _ => Setpoint::Duty(Finite::new(value).unwrap()),
    };
    Ok(match input.int_in_range(0..=7_u8)? {
        0 => AxisCommand::Off,
        1 => AxisCommand::ResetFault,
        2 => AxisCommand::Stand,
        3 => AxisCommand::Home,
        4 => AxisCommand::Seek(setpoint),
        _ => AxisCommand::Follow(setpoint),
    })
}

fn line_faults(input: &mut Unstructured) -> arbitrary::Result<LineFaults> {
    let mut wire = || -> arbitrary::Result<WireFaults> {
        let mut share = |most: f64| Ok(f64::from(u8::arbitrary(input)?.saturating_sub(64)) / 191.0 * most);
        let (bit_error_rate, tear, duplicate) = (share(0.1)?, share(0.5)?, share(0.5)?);
        let stuck = match input.int_in_range(0..=11_u8)? {
            0 => Some(Stuck::Silent),
            1 => Some(Stuck::At(0)),
            2 => Some(Stuck::At(0xFF)),
            3 => Some(Stuck::Garbled),
            _ => None,
        };
        Ok(WireFaults { bit_error_rate, tear, duplicate, stuck })
    };
    let (to_device, to_host) = (wire()?, wire()?);
    let late = Duration::from_micros(u64::from(u16::arbitrary(input)?));
    Ok(LineFaults { seed: u64::from(u8::arbitrary(input)?), to_device, to_host, late, ..LineFaults::default() })
}

/// A whole answer of a device with arbitrary content.
fn answer(input: &mut Unstructured) -> arbitrary::Result<Vec<u8>> {
    Ok(match input.int_in_range(0..=4_u8)? {
        0..=1 => {
            let mut frame = FrameBuilder::new(ADDRESS);
            frame
                .answer(Answer::Position(i32::arbitrary(input)?))
                .answer(Answer::Current(i16::arbitrary(input)?))
                .answer(Answer::Status(Status(u16::arbitrary(input)?)));
            if bool::arbitrary(input)? {
                frame.command(Command::ReadStatus);
            }
            frame.finish().map(<[u8]>::to_vec).unwrap_or_default()
        }
        2 => serial::hi_moxa::Answer::decode(Arbitrary::arbitrary(input)?).encode().to_vec(),
        3 => serial::ati::Reply::decode(Arbitrary::arbitrary(input)?).encode().to_vec(),
        _ => {
            let body = Vec::<u8>::arbitrary(input)?;
            let mut frame = [0; 300];
            let length = serial::ultrasonic::encode(&body[..body.len().min(255)], &mut frame);
            frame[..length.unwrap_or_default()].to_vec()
        }
    })
}

/// An axis controller in either protocol: finite positions, and no step that the motor cannot make.
pub fn axis_controllers(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let Ok((old, in_bring_up)) = <(bool, bool)>::arbitrary(&mut input) else {
        return;
    };
    let (file, protocol) = if old { (&*HI_MOXA, Protocol::HiMoxa) } else { (&*NFV2, Protocol::Nfv2) };
    let emulated = AxisControllerConfig::new(plants::plant(file, 0, 0));
    let device = match protocol {
        Protocol::Nfv2 => AxisController::nfv2(ADDRESS, &emulated),
        Protocol::HiMoxa => AxisController::hi_moxa(&emulated),
    };
    let (world, line, host) = world(Settings::AXIS_CONTROLLER, Box::new(device));
    let config = file.cell.robot[0].axis[0].controller_config(0.0);
    let config = drive::axis_controller::AxisConfig { address: ADDRESS, ..config };
    let group = AxisControllerGroup::new(vec![host], GroupConfig::new(protocol), &[config]).unwrap();
    let mut bench = Bench::new(group, world, line);
    if in_bring_up {
        if bench.bring_up(&mut input).is_err() {
            return;
        }
    } else {
        bench.bring_up(&mut Unstructured::new(&[])).expect("nothing disturbs this bring-up");
    }
    let _ = bench.disturb(&mut input, |_| ());
    let plant = bench.world.plant(DriveId::Line(line)).unwrap();
    assert!(plant.angle().is_finite() && plant.velocity().is_finite());
}

/// Echoes at a distance that changes.
struct Wall;

impl EchoProbe for Wall {
    fn distance(&mut self, element: (usize, usize), now: Instant) -> Option<f64> {
        let phase = now.since(Instant::ZERO).as_secs_f64() + element.0 as f64;
        (element != (1, 1)).then(|| 0.4 + 0.1 * phase.sin())
    }
}

/// A force/torque sensor or an ultrasonic matrix: finite readings, and a fault that persists until its reset.
pub fn serial_sensors(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let Ok((sonar, in_bring_up)) = <(bool, bool)>::arbitrary(&mut input) else {
        return;
    };
    if sonar { matrix(&mut input, in_bring_up) } else { force_sensor(&mut input, in_bring_up) }
}

fn force_sensor(input: &mut Unstructured, in_bring_up: bool) {
    let device = SerialForceSensor::new(SerialForceSensorConfig::new(TransducerConfig::default()), Box::new(Load));
    let (world, line, host) = world(SerialForceSensor::SETTINGS, Box::new(device.unwrap()));
    let (group, link) = SerialWrenchSensor::new(host, SerialWrenchConfig::new(PERIOD)).unwrap();
    let mut bench = Bench::new(group, world, line);
    let none = &mut Unstructured::new(&[]);
    if let Err(error) = bench.bring_up(if in_bring_up { input } else { none }) {
        assert!(in_bring_up, "nothing disturbs this bring-up: {error}");
        return;
    }
    let _ = bench.disturb(input, |choice| {
        let state = link.read();
        assert!(state.wrench.iter().all(|component| component.is_finite()), "{state:?}");
        assert!(state.fault.is_none() || state.measured().is_none(), "{state:?}");
        assert!(state.fault.is_none_or(|fault| !fault.to_string().is_empty()));
        match choice {
            0..8 => _ = link.zero(),
            8..16 => link.reset_fault(),
            _ => {}
        }
    });
}

fn matrix(input: &mut Unstructured, in_bring_up: bool) {
    let emulated = hil::UltrasonicConfig { size: 4, ..hil::UltrasonicConfig::default() };
    let device = hil::UltrasonicMatrix::new(emulated, Box::new(Wall)).unwrap();
    let (world, line, host) = world(hil::UltrasonicMatrix::SETTINGS, Box::new(device));
    let config = UltrasonicConfig { size: 4, ..UltrasonicConfig::new(PERIOD) };
    let (group, link) = UltrasonicMatrix::new(host, config).unwrap();
    let mut bench = Bench::new(group, world, line);
    let none = &mut Unstructured::new(&[]);
    if let Err(error) = bench.bring_up(if in_bring_up { input } else { none }) {
        assert!(in_bring_up, "nothing disturbs this bring-up: {error}");
        return;
    }
    let (shots, echoes) = config.shots();
    let _ = bench.disturb(input, |choice| {
        let state = link.read();
        assert!(state.fault.is_none_or(|fault| !fault.to_string().is_empty()));
        if let Some(scan) = state.measured() {
            assert!(state.fault.is_none());
            for shot in 0..shots {
                let within_slot = |echo| scan.echo(shot, echo).is_none_or(|time| time <= config.slot);
                assert!((0..echoes).all(within_slot), "{scan:?}");
            }
        }
        if choice < 8 {
            link.reset_fault();
        }
    });
}
