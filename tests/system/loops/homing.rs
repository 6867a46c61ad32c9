//! Homing by the servo, over the physical axes of the IRp-6 with their switches and index pulses.

use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Increments, Power, Setpoint, Switches,
};
use hil::AxisConfig;
use hil::plant::{self, Demand, Irp6Axis};
use servo::Output;
use servo::{Direction, HomingLeg, HostHoming, Order, Phase};

use super::cascades::serial;
use super::{DT, Rig};

/// A drive group of physical axes. The drives control the current, latch index pulses on request, and answer one
/// telegram later.
struct Latching {
    axes: Vec<Latch>,
    trace: Arc<Mutex<Trace>>,
}

struct Latch {
    axis: plant::PlantAxis,
    counts: f64,
    /// Motor position at the reference, rad, and the counter value there after homing.
    home: f64,
    reference: Option<i32>,
    state: AxisState,
    command: AxisCommand,
}

/// True angles and torques of every axis, cycle by cycle.
#[derive(Default)]
struct Trace {
    angles: Vec<Vec<f64>>,
    torques: Vec<Vec<f64>>,
}

impl DriveGroup for Latching {
    fn axes(&self) -> usize {
        self.axes.len()
    }

    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        for (state, latch) in states.iter_mut().zip(&self.axes) {
            *state = AxisState { at: now, ..latch.state };
        }
    }

    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        for (latch, command) in self.axes.iter_mut().zip(commands) {
            latch.command = *command;
        }
    }

    fn send(&mut self, _: Instant) -> bool {
        let torques = self.axes.iter_mut().map(Latch::exchange).collect();
        let mut trace = self.trace.lock().unwrap();
        trace.torques.push(torques);
        let angles = self.axes.iter().map(|latch| latch.axis.angle());
        trace.angles.push(angles.collect());
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

impl Latch {
    fn new(config: &AxisConfig, seed: u64) -> Self {
        Self {
            axis: plant::PlantAxis::new(config, seed),
            counts: f64::from(config.counts_per_revolution),
            home: config.index_angle,
            reference: None,
            state: AxisState::default(),
            command: AxisCommand::Off,
        }
    }

    /// Takes a sample, then runs for a period under the command. Returns the torque.
    fn exchange(&mut self) -> f64 {
        let feedback = self.axis.feedback();
        let seeks = matches!(self.command, AxisCommand::Seek(_));
        if let (true, None, Some(index)) = (seeks, self.reference, feedback.index) {
            self.reference = Some(index);
        }
        let count = feedback.counts - self.reference.unwrap_or(0);
        let radians = TAU / self.counts;
        let power = match self.command {
            AxisCommand::Off | AxisCommand::ResetFault => Power::Off,
            _ => Power::On,
        };
        self.state = AxisState {
            position: f64::from(count) * radians + self.home,
            increments: Increments(count),
            velocity: feedback.velocity * radians,
            torque: feedback.torque,
            power,
            following: matches!(self.command, AxisCommand::Follow(_) | AxisCommand::Seek(_)),
            homing: match self.reference {
                Some(_) => Homing::Attained,
                None => Homing::NotHomed,
            },
            switches: Switches {
                home: feedback.home_switch,
                lower_limit: feedback.negative_limit,
                upper_limit: feedback.positive_limit,
            },
            ..AxisState::default()
        };
        if !seeks {
            self.axis.take_index();
        }
        let (AxisCommand::Follow(Setpoint::Torque(torque)) | AxisCommand::Seek(Setpoint::Torque(torque))) =
            self.command
        else {
            let idle = match power {
                Power::On => Demand::Torque(0.0),
                Power::Off | Power::Changing => Demand::Off,
            };
            self.axis.advance(20, idle);
            return 0.0;
        };
        self.axis.advance(20, Demand::Torque(torque.get()));
        torque.get()
    }
}

/// Homing parameters of the robot's own software, with ramps.
const HOMING: HostHoming = HostHoming {
    direction: Direction::Negative,
    search: HomingLeg { velocity: 15.0, distance: 100.0, timeout: Duration::from_secs(10) },
    zero: HomingLeg { velocity: 3.5, distance: 10.0, timeout: Duration::from_secs(5) },
    acceleration: 150.0,
    pause: Duration::from_millis(200),
    debounce: 3,
    reverse_at_limit: true,
};

#[test]
fn six_physical_axes_find_their_references_at_once_and_without_a_kick() {
    let bouncing = |axis| {
        let mut config = AxisConfig::irp6(axis);
        let switch = config.home_switch.as_mut().unwrap();
        // 2 ms of contact bounce. Two axes stand on the switch at the start.
        switch.bounce = 20;
        if matches!(axis, Irp6Axis::UpperArm | Irp6Axis::Flange) {
            config.start_angle = config.index_angle - 12.0;
        }
        config
    };
    let configs = Irp6Axis::ALL.map(bouncing);
    let trace = Arc::new(Mutex::new(Trace::default()));
    let latches = configs.iter().zip(1..).map(|(config, seed)| Latch::new(config, seed));
    let group = Latching { axes: latches.collect(), trace: Arc::clone(&trace) };
    let axes = Irp6Axis::ALL.into_iter().enumerate().map(|(index, axis)| {
        let rig: Rig = serial(axis, Output::Torque);
        let mut config = rig.axis_config();
        config.index_in_group = index;
        config.homing = Some(HOMING);
        config
    });
    let (mut servo, mut link) = super::servo(axes.collect(), vec![Box::new(group)]);
    let mut now = Instant::ZERO;
    let mut run = |servo: &mut servo::Servo, cycles: usize| {
        for _ in 0..cycles {
            servo.step(now);
            now += super::PERIOD;
        }
    };
    link.orders.push(Order::Enable).unwrap();
    run(&mut servo, 250);
    assert_eq!(servo.state(0).unwrap().phase(), Phase::Standing, "{:?}", servo.fault(0));
    let begin = trace.lock().unwrap().torques.len();
    link.orders.push(Order::Home).unwrap();
    run(&mut servo, 5000);
    assert_eq!(servo.state(0).unwrap().phase(), Phase::Standing, "{:?}", servo.fault(0));

    let trace = trace.lock().unwrap();
    let offsets: Vec<i64> = servo.homing_offsets(0).map(Option::unwrap).collect();
    for (axis, config) in configs.iter().enumerate() {
        let name = Irp6Axis::ALL[axis];
        let counts = f64::from(config.counts_per_revolution);
        // The counter was zero at power-on.
        let way = (config.index_angle - config.start_angle) / TAU * counts;
        // A count for each of the two roundings, and the motion in the period by which the latch sample may be late.
        assert!((offsets[axis] as f64 - way).abs() < 8.0, "{name:?}: {} for {way}", offsets[axis]);
        let rest = trace.angles.last().unwrap()[axis] - config.index_angle;
        assert!((0.0..0.3).contains(&rest), "{name:?} rests {rest} rad from its reference");
        let angles: Vec<f64> = trace.angles[begin..].iter().map(|angles| angles[axis]).collect();
        let speed = |two: &[f64]| (two[1] - two[0]).abs() / DT;
        let fastest = angles.windows(2).map(speed).fold(0.0, f64::max);
        assert!(fastest < 17.5, "{name:?}: {fastest} rad/s");
        let limit = serial(name, Output::Torque).host.law.limit();
        let torques: Vec<f64> = trace.torques[begin..].iter().map(|t| t[axis]).collect();
        let step = |two: &[f64]| (two[1] - two[0]).abs();
        let kick = torques.windows(2).map(step).fold(0.0, f64::max);
        println!("{name:?}: greatest step of torque {kick:.3} of {limit:.3} N·m");
        assert!(kick < 0.3 * limit, "{name:?}: {kick} N·m in one cycle");
    }
}
