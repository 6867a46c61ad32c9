//! Tests of the cycle on scripted drives.

mod brakes;
mod envelope;
mod host_homing;
mod host_loops;
mod kept_laws;
mod laws;
mod limit_switches;
mod motion;
mod oscillation;
mod power;
mod snapshots;
mod speed;
mod stops;
mod teams;
mod weights;

use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, Homing, Power, Setpoint};
use proptest::prelude::*;

use crate::scripted::{self, FAULT, MAX_ACCELERATION, MAX_VELOCITY, PERIOD, World};
use crate::{EffectorLink, MAX_AXES, Macrostep, Order, Phase, Servo, ServoConfig, ServoReport, StopCause};

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
        Self { servo, link: links.remove(0), world, now: Instant::ZERO, axes }
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

    fn reports(&mut self) -> Vec<ServoReport> {
        std::iter::from_fn(|| self.link.reports.pop().ok()).collect()
    }

    fn phases(&mut self) -> Vec<Phase> {
        self.reports().iter().map(|report| report.snapshot.phase).collect()
    }

    /// Commanded positions of axis `axis`, cycle by cycle.
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

    /// Queues constant acceleration over `ramp` macrosteps of 10 periods, then `cruise` macrosteps of constant speed.
    /// The sequence ends in motion. Returns position and velocity at its end.
    fn accelerate(&mut self, acceleration: f64, ramp: u64, cruise: u64) -> (f64, f64) {
        let steps = accelerating(acceleration, ramp, cruise);
        let end = steps.last().map_or((0.0, 0.0), |last| (last.position[0], last.velocity[0]));
        steps.into_iter().for_each(|step| self.order(Order::Move(step)));
        end
    }
}

/// Macrosteps of 10 periods from zero: `ramp` of them with `acceleration`, then `cruise` of them at constant velocity.
pub(crate) fn accelerating(acceleration: f64, ramp: u64, cruise: u64) -> Vec<Macrostep> {
    let (mut position, mut velocity) = (0.0, 0.0);
    let mut next = |number| {
        let a = if number <= ramp { acceleration } else { 0.0 };
        position += velocity * 10.0 * DT + 0.5 * a * (10.0 * DT).powi(2);
        velocity += a * 10.0 * DT;
        macrostep(number, 10, position, velocity)
    };
    (1..=ramp + cruise).map(&mut next).collect()
}

/// An effector of two axes, each on a bus of its own.
struct TwoBuses {
    servo: Servo,
    links: Vec<EffectorLink>,
    worlds: Vec<Arc<Mutex<World>>>,
    now: Instant,
}

impl TwoBuses {
    /// Homed and standing at zero.
    fn standing(mut config: ServoConfig) -> Self {
        let axis = &mut config.effectors[0].axes[1];
        (axis.group, axis.index_in_group) = (1, 0);
        let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(1)).unzip();
        let (servo, links) = Servo::new(&config, groups).unwrap();
        let mut buses = Self { servo, links, worlds, now: Instant::ZERO };
        (0..2).for_each(|bus| buses.world(bus).axes[0].state.homing = Homing::Attained);
        buses.order(Order::Enable);
        buses.run(20);
        buses
    }

    fn world(&self, bus: usize) -> MutexGuard<'_, World> {
        self.worlds[bus].lock().unwrap()
    }

    fn order(&mut self, order: Order) {
        self.links[0].orders.push(order).unwrap();
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.servo.step(self.now);
            self.now += PERIOD;
        }
    }
}

fn macrostep(number: u64, steps: u16, position: f64, velocity: f64) -> Macrostep {
    let (position, velocity) = ([position; MAX_AXES], [velocity; MAX_AXES]);
    let torque = [0.0; MAX_AXES];
    Macrostep {
        number,
        steps,
        report_at: steps,
        position,
        velocity,
        acceleration: None,
        torque,
        law: None,
        continues_law: false,
    }
}

/// Checks that the first and second difference of a sequence exceed the limits by at most a thousandth.
fn keeps_limits(positions: &[f64]) -> Result<(), TestCaseError> {
    for (at, three) in positions.windows(3).enumerate() {
        let velocity = (three[2] - three[1]) / DT;
        let acceleration = (three[2] - 2.0 * three[1] + three[0]) / (DT * DT);
        prop_assert!(velocity.abs() <= MAX_VELOCITY * 1.0011, "{velocity} rad/s at {at}");
        prop_assert!(acceleration.abs() <= MAX_ACCELERATION * 1.0011, "{acceleration} at {at}");
    }
    Ok(())
}

#[test]
fn control_sees_the_nominal_period_and_records_have_the_real_one() {
    // The same orders under a punctual clock, and under a clock with a jitter of up to 0.4 periods.
    let run = |waver: i32| {
        let (group, world) = scripted::group(2);
        for drive in &mut world.lock().unwrap().axes {
            drive.state.homing = Homing::Attained;
        }
        let (mut servo, mut links) = Servo::new(&scripted::host_config(2), vec![group]).unwrap();
        let mut records = servo.record(200);
        let orders = &mut links[0].orders;
        orders.push(Order::Enable).unwrap();
        for cycle in 0..100_u32 {
            if cycle == 20 {
                let macrostep = Macrostep {
                    number: 1,
                    steps: 40,
                    report_at: 5,
                    position: [0.1; MAX_AXES],
                    velocity: [0.0; MAX_AXES],
                    acceleration: None,
                    torque: [0.0; MAX_AXES],
                    law: None,
                    continues_law: false,
                };
                orders.push(Order::Move(macrostep)).unwrap();
            }
            let late = PERIOD / 5 * (waver as u32 * (cycle * 7 % 3));
            servo.step(Instant::ZERO + PERIOD * cycle + late);
        }
        let records = std::iter::from_fn(move || records.pop().ok()).collect::<Vec<_>>();
        let sent = world.lock().unwrap().sent.clone();
        (records, sent)
    };
    let ((punctual, told), (wavering, told_too)) = (run(0), run(1));
    assert_eq!(told, told_too, "set-points are bit-identical");
    assert!(punctual.iter().any(|record| record.phase == Phase::Moving));
    assert_eq!(punctual[0].dt, Duration::ZERO);
    assert!(punctual[1..].iter().all(|record| record.dt == PERIOD));
    assert!(wavering.windows(2).all(|two| two[1].dt == two[1].at.since(two[0].at)));
    assert!(wavering[1..].iter().any(|record| record.dt != PERIOD));
}
