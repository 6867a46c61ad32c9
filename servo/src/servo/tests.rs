mod host_homing;
mod host_loops;
mod limit_switches;
mod motion;
mod power;
mod stops;

use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, Homing, Power, Setpoint};
use proptest::prelude::*;

use crate::scripted::{self, FAULT, MAX_ACCELERATION, MAX_VELOCITY, PERIOD, World};
use crate::{
    EffectorLink, MAX_AXES, Macrostep, Order, Phase, Report, Servo, ServoConfig, StopCause,
};

const DT: f64 = 1e-3;

struct Rig {
    servo: Servo,
    link: EffectorLink,
    world: Arc<Mutex<World>>,
    now: Instant,
    axes: usize,
}

impl Rig {
    fn new(axes: usize) -> Self {
        Self::with(&scripted::config(axes))
    }

    fn with(config: &ServoConfig) -> Self {
        let axes = config.effectors[0].axes.len();
        let (group, world) = scripted::group(axes);
        let (servo, mut links) = Servo::new(config, vec![group]).unwrap();
        Self {
            servo,
            link: links.remove(0),
            world,
            now: Instant::ZERO,
            axes,
        }
    }

    /// Homed and standing at zero, with an empty log.
    fn standing(axes: usize) -> Self {
        Self::new(axes).stand()
    }

    fn stand(mut self) -> Self {
        for drive in &mut self.world().axes {
            drive.state.homing = Homing::Attained;
        }
        self.order(Order::Enable);
        self.run(20);
        assert_eq!(self.phase(), Phase::Standing, "{:?}", self.servo.fault(0));
        self.reports();
        self.world().sent.clear();
        self
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }

    fn order(&mut self, order: Order) {
        self.link.orders.push(order).unwrap();
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.servo.step(self.now);
            self.now += PERIOD;
        }
    }

    fn run_until(&mut self, phase: Phase) {
        for _ in 0..1000 {
            if self.phase() == phase {
                return;
            }
            self.run(1);
        }
        panic!("never {phase:?}, but {:?}", self.servo.state(0));
    }

    fn phase(&self) -> Phase {
        self.servo.state(0).unwrap().phase()
    }

    fn cause(&self) -> Option<StopCause> {
        self.servo.fault(0).map(|fault| fault.cause)
    }

    fn reports(&mut self) -> Vec<Report> {
        std::iter::from_fn(|| self.link.reports.pop().ok()).collect()
    }

    fn phases(&mut self) -> Vec<Phase> {
        self.reports().iter().map(|report| report.phase).collect()
    }

    /// Positions that axis `axis` was told to follow, cycle by cycle.
    fn positions(&self, axis: usize) -> Vec<f64> {
        let position = |batch: &Vec<AxisCommand>| match batch[axis] {
            AxisCommand::Follow(Setpoint::Position(position)) => Some(position.get()),
            _ => None,
        };
        self.world().sent.iter().filter_map(position).collect()
    }

    fn last_sent(&self) -> Vec<AxisCommand> {
        self.world().sent.last().unwrap().clone()
    }

    /// Queues constant acceleration over `ramp` macrosteps of 10 periods, then as many of constant
    /// speed as `cruise` says; ends in motion. Position and velocity at the end.
    fn accelerate(&mut self, acceleration: f64, ramp: u64, cruise: u64) -> (f64, f64) {
        let (mut position, mut velocity) = (0.0, 0.0);
        for number in 1..=ramp + cruise {
            let a = if number <= ramp { acceleration } else { 0.0 };
            position += velocity * 10.0 * DT + 0.5 * a * (10.0 * DT).powi(2);
            velocity += a * 10.0 * DT;
            self.order(Order::Move(macrostep(number, 10, position, velocity)));
        }
        (position, velocity)
    }
}

fn macrostep(number: u64, steps: u16, position: f64, velocity: f64) -> Macrostep {
    let (position, velocity) = ([position; MAX_AXES], [velocity; MAX_AXES]);
    Macrostep {
        number,
        steps,
        report_at: steps,
        position,
        velocity,
    }
}

/// First and second difference of a sequence never exceed the limits by more than a thousandth.
fn keeps_limits(positions: &[f64]) -> Result<(), TestCaseError> {
    for (at, three) in positions.windows(3).enumerate() {
        let velocity = (three[2] - three[1]) / DT;
        let acceleration = (three[2] - 2.0 * three[1] + three[0]) / (DT * DT);
        prop_assert!(
            velocity.abs() <= MAX_VELOCITY * 1.0011,
            "{velocity} rad/s at {at}"
        );
        prop_assert!(
            acceleration.abs() <= MAX_ACCELERATION * 1.0011,
            "{acceleration} at {at}"
        );
    }
    Ok(())
}
