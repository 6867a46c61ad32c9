//! Motors for tests of loops. Each call simulates one period under a constant output.

use hil::AxisConfig;
use hil::plant::{
    self, Demand, FrictionConfig, Gravity, Irp6Axis, Mechanism, MotorConfig, PlantConfig, Wut, WutConfig,
};

use super::DT;

/// Voltage of a full pulse width, V.
pub(super) const SUPPLY: f64 = 48.0;

/// A motor that is driven by the servo.
pub(super) trait Motor: Send {
    /// Shaft angle, rad.
    fn angle(&self) -> f64;
    /// Simulates one period under a torque, N·m, or a duty.
    fn run(&mut self, input: f64);
}

/// The regression model. The original software integrates it in one step per period. With many steps, the motor moves
/// as under a zero-order hold.
pub(super) struct Regression {
    steps: u32,
    motor: Wut,
    torque_constant: f64,
}

impl Regression {
    pub(super) fn new(config: &WutConfig, steps: u32, angle: f64) -> Self {
        Self { steps, motor: Wut::new(config, angle), torque_constant: config.torque_constant }
    }
}

impl Motor for Regression {
    fn angle(&self) -> f64 {
        self.motor.angle
    }

    fn run(&mut self, input: f64) {
        for _ in 0..self.steps {
            let current = input / self.torque_constant;
            self.motor.step(current, DT / f64::from(self.steps), 0.0);
        }
    }
}

/// The motor of an axis.
pub(super) fn physical(axis: Irp6Axis) -> MotorConfig {
    match AxisConfig::irp6(axis).plant {
        PlantConfig::Physical(motor) => motor,
        PlantConfig::Wut(_) => unreachable!("the preset is physical"),
    }
}

/// An axis that starts 40 rad below its home position and therefore has room to run.
fn axis_config(axis: Irp6Axis) -> AxisConfig {
    let config = AxisConfig::irp6(axis);
    AxisConfig { start_angle: config.index_angle - 40.0, ..config }
}

/// The physical axis with a drive that controls its current.
pub(super) struct ByCurrent(plant::PlantAxis);

impl ByCurrent {
    pub(super) fn new(axis: Irp6Axis) -> Self {
        Self(plant::PlantAxis::new(&axis_config(axis), 7))
    }

    /// The axis at `angle`, rad, with the load of the arm's links.
    pub(super) fn mounted(axis: Irp6Axis, angle: f64, arm: &Mechanism) -> Self {
        let config = AxisConfig { start_angle: angle, ..AxisConfig::irp6(axis) };
        let mount = arm.mount(axis as usize, config.index_angle);
        let seed = 7 + axis as u64;
        Self(plant::PlantAxis::mounted(&config, seed, mount.as_ref()))
    }

    /// The axis at `angle`, rad, without weight and dry friction.
    pub(super) fn weightless(axis: Irp6Axis, angle: f64) -> Self {
        let motor = MotorConfig { gravity: Gravity::NONE, friction: FrictionConfig::NONE, ..physical(axis) };
        let config = AxisConfig { plant: PlantConfig::Physical(motor), start_angle: angle, ..AxisConfig::irp6(axis) };
        Self(plant::PlantAxis::new(&config, 7 + axis as u64))
    }
}

impl Motor for ByCurrent {
    fn angle(&self) -> f64 {
        self.0.angle()
    }

    fn run(&mut self, input: f64) {
        self.0.advance(20, Demand::Torque(input));
    }
}

/// The same motor on a bridge without current control: windings, back-EMF, dry friction, weight.
pub(super) struct ByPulseWidth {
    config: MotorConfig,
    angle: f64,
    velocity: f64,
    current: f64,
}

impl ByPulseWidth {
    const STEP: f64 = 1e-5;

    pub(super) fn new(axis: Irp6Axis) -> Self {
        Self { config: physical(axis), angle: axis_config(axis).start_angle, velocity: 0.0, current: 0.0 }
    }
}

impl Motor for ByPulseWidth {
    fn angle(&self) -> f64 {
        self.angle
    }

    fn run(&mut self, input: f64) {
        let c = &self.config;
        for _ in 0..(DT / Self::STEP).round() as u32 {
            let voltage = input * SUPPLY - c.torque_constant * self.velocity;
            self.current += (voltage - c.resistance * self.current) / c.inductance * Self::STEP;
            let weight = c.gravity.amplitude * (self.angle / c.gravity.ratio + c.gravity.phase).cos();
            let torque = c.torque_constant * self.current + weight - c.viscous * self.velocity;
            let free = self.velocity + torque / c.inertia * Self::STEP;
            let slowing = c.friction.coulomb / c.inertia * Self::STEP;
            self.velocity = free - free.clamp(-slowing, slowing);
            self.angle += self.velocity * Self::STEP;
        }
    }
}
