//! Serial axis controllers in both protocols: telegrams, accepted answers and faults.

mod belief;
mod bring_up;
mod commands;
mod delays;
mod emergency_stops;
mod faults;

use std::f64::consts::TAU;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use mrroc_drive::axis_controller::{
    AxisConfig, AxisControllerError, AxisControllerFault, AxisControllerGroup, AxisCounters, ConfigError, Control,
    GroupConfig, Protocol,
};
use mrroc_drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, Fault, Finite, Homing, Power, Refusal, Scale, Setpoint,
};
use serial::LineError;
use serial::nfv2::{Mode, Status};

use crate::scripted::{Drive, Shared};

const PERIOD: Duration = Duration::from_millis(2);
const BOTH: [Protocol; 2] = [Protocol::Nfv2, Protocol::HiMoxa];

/// 4000 increments per turn; 100 rad/s are 127 increments per cycle.
fn axis(protocol: Protocol) -> AxisConfig {
    AxisConfig {
        address: 8,
        scale: Scale::new(4_000, 0.0).unwrap(),
        torque_constant: 0.1,
        control: match protocol {
            Protocol::Nfv2 => Control::Current,
            Protocol::HiMoxa => Control::Pwm,
        },
        max_current: 15.0,
        max_velocity: 100.0,
        max_acceleration: 10_000.0,
    }
}

/// A set-point in mA or in thousandths, depending on the axis of the protocol.
fn raw(protocol: Protocol, value: i16) -> Setpoint {
    let value = f64::from(value) / 1_000.0;
    match protocol {
        Protocol::Nfv2 => Setpoint::Torque(Finite::new(value * 0.1).unwrap()),
        Protocol::HiMoxa => Setpoint::Duty(Finite::new(value).unwrap()),
    }
}

struct Rig {
    group: AxisControllerGroup<Shared>,
    lines: Vec<Shared>,
    states: Vec<AxisState>,
    now: Instant,
}

impl Rig {
    fn with(config: GroupConfig, axes: &[AxisConfig], drives: Vec<Drive>) -> Self {
        let lines: Vec<Shared> = drives.into_iter().map(Drive::shared).collect();
        Self {
            group: AxisControllerGroup::new(lines.clone(), config, axes).unwrap(),
            states: vec![AxisState::default(); axes.len()],
            lines,
            now: Instant::from_nanos(1_000_000_000),
        }
    }

    fn of(drive: Drive) -> Self {
        let protocol = drive.protocol;
        Self::with(GroupConfig::new(protocol), &[axis(protocol)], vec![drive])
    }

    fn bring_up(&mut self) -> Result<(), BringUpError> {
        for _ in 0..1_000 {
            if let Poll::Ready(result) = self.group.bring_up(self.now) {
                return result;
            }
            self.now += PERIOD;
        }
        panic!("bring-up does not end");
    }

    fn up(drive: Drive) -> Self {
        let mut rig = Self::of(drive);
        rig.bring_up().unwrap();
        rig
    }

    /// A drive with torque on.
    fn on(drive: Drive) -> Self {
        let mut rig = Self::up(drive);
        rig.run(6, AxisCommand::Stand);
        assert_eq!(rig.states[0].power, Power::On);
        rig
    }

    fn cycle(&mut self, command: AxisCommand) -> AxisState {
        let commands = vec![command; self.states.len()];
        self.cycle_all(&commands);
        self.states[0]
    }

    fn cycle_all(&mut self, commands: &[AxisCommand]) {
        self.now += PERIOD;
        self.group.read(self.now, &mut self.states);
        self.group.write(self.now, commands);
        self.group.send(self.now);
    }

    fn run(&mut self, cycles: usize, command: AxisCommand) -> AxisState {
        for _ in 0..cycles {
            self.cycle(command);
        }
        self.states[0]
    }

    fn drive(&self) -> std::sync::MutexGuard<'_, Drive> {
        self.lines[0].drive()
    }

    fn counters(&self) -> AxisCounters {
        self.group.axis_counters().next().unwrap()
    }

    fn fault(&self) -> Option<AxisControllerFault> {
        match self.states[0].fault {
            Some(Fault::AxisController { line: 0, fault }) => Some(fault),
            None => None,
            other => panic!("{other:?}"),
        }
    }
}
