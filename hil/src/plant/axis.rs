//! An emulated axis: motor, encoder, switches.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use thiserror::Error;

use super::faults::{BLOCK, PlantFault, PlantFaults};
use super::mechanism::{Mechanism, Mount};
use super::motor::{EndStops, Motor, MotorConfig};
use super::switch::{Contact, Switch};
use super::wut::{Wut, WutConfig};
use super::{SUB_STEP, encoder::Encoder, noise::Noise};
use crate::amplifier::{Amplifier, AmplifierConfig, OUTER};

/// Configuration of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisConfig {
    /// Motor and load.
    pub plant: PlantConfig,
    /// The drive's settings.
    pub amplifier: AmplifierConfig,
    /// Quadrature counts of one motor turn.
    pub counts_per_revolution: u32,
    /// Half the band of the encoder's edge jitter, counts. The hysteresis of its comparators is as wide as the band.
    pub edge_jitter: f64,
    /// Motor angle of one index pulse, rad. The other index pulses lie whole turns away.
    pub index_angle: f64,
    /// Motor angle at power-on, where the counter reads zero, rad.
    pub start_angle: f64,
    /// Holding torque of the brake, which is closed while the power stage is off, N·m. Zero: no brake.
    pub brake: f64,
    /// Home switch.
    pub home_switch: Option<Switch>,
    /// Limit switch at the negative end of travel.
    pub negative_limit: Option<Switch>,
    /// Limit switch at the positive end of travel.
    pub positive_limit: Option<Switch>,
}

/// The physics behind an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantConfig {
    /// The regression model. Its current follows the drive's set-point at once.
    Wut(WutConfig),
    /// A motor with windings, friction, gravity, end stops and temperature.
    Physical(MotorConfig),
}

impl PlantConfig {
    /// Torque per current, N·m/A.
    pub fn torque_constant(&self) -> f64 {
        match self {
            Self::Wut(wut) => wut.torque_constant,
            Self::Physical(motor) => motor.torque_constant,
        }
    }
}

/// Demand of the drive's state machine on the power stage and the loops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// Power stage off. A brake, if present, holds.
    Off,
    /// Follow a straight ramp: at sub-step k of this demand the set-point is `counts + velocity · k · 100 µs`.
    Position {
        /// Start of the ramp, counts.
        counts: f64,
        /// Slope of the ramp, counts/s. The slope is also the velocity feed-forward.
        velocity: f64,
    },
    /// Hold a velocity, counts/s.
    Velocity(f64),
    /// Hold a torque, N·m.
    Torque(f64),
    /// Hold a current, A, from this sub-step on. [`AmplifierConfig::max_current`] does not apply.
    Current(f64),
    /// Output this share of [`AmplifierConfig::max_voltage`], -1 to 1, from this sub-step on.
    Duty(f64),
}

/// Readings of the drive's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedback {
    /// Encoder counter, zero at power-on. The counter wraps at 32 bits. A fault of the encoder leaves an offset.
    pub counts: i32,
    /// Observed velocity, counts/s.
    pub velocity: f64,
    /// Torque from the measured current, N·m.
    pub torque: f64,
    /// Measured current, A.
    pub current: f64,
    /// Count of the last index pulse since [`PlantAxis::take_index`].
    pub index: Option<i32>,
    /// Whether the home switch is closed.
    pub home_switch: bool,
    /// Whether the negative limit switch is closed.
    pub negative_limit: bool,
    /// Whether the positive limit switch is closed.
    pub positive_limit: bool,
    /// The trip that keeps the power stage off, if any.
    pub trip: Option<Trip>,
}

/// Protections that switch the power stage off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Trip {
    /// The current exceeded the limit of the power stage. Cleared by [`Demand::Off`].
    #[error("over-current")]
    OverCurrent,
    /// The winding is too hot. Cleared when the winding has cooled by 5 K.
    #[error("over-temperature")]
    OverTemperature,
}

/// One motor with its load, its sensors and the inner loops of its drive.
///
/// The caller decides when to call [`PlantAxis::advance`]. Simulated time is the number of sub-steps advanced.
#[derive(Clone, Debug)]
pub struct PlantAxis {
    plant: Plant,
    mount: Option<Mount>,
    pub(crate) amplifier: Amplifier,
    encoder: Encoder,
    brake: f64,
    /// Home switch, negative and positive limit switch.
    contacts: [Option<Contact>; 3],
    noise: Noise,
    trip: Option<Trip>,
    /// Sub-steps since the last step of the outer loops.
    phase: u32,
    probe: Option<AngleProbe>,
    faults: PlantFaults,
}

/// The angle of a motor shaft, read by another device. Clones read the same shaft.
///
/// The angle is that of the last simulated sub-step. A drive that receives SYNC lags by up to a SYNC period, and a drive
/// without any frame by up to 20 ms. The motor of a robot or a belt in a [`Scene`](crate::scene::Scene) does not lag.
#[derive(Clone, Debug)]
pub struct AngleProbe(Arc<Probed>);

#[derive(Debug)]
struct Probed {
    angle: AtomicU64,
    /// Number of belts that the motor drives.
    belts: AtomicU32,
}

impl AngleProbe {
    fn new(angle: f64) -> Self {
        Self(Arc::new(Probed { angle: AtomicU64::new(angle.to_bits()), belts: AtomicU32::new(0) }))
    }

    /// Angle of the motor shaft, rad.
    pub fn angle(&self) -> f64 {
        f64::from_bits(self.0.angle.load(Ordering::Relaxed))
    }

    /// Counts a belt of a scene that this motor drives. The motor advances with the scene from now on.
    pub(crate) fn add_belt(&self) {
        self.0.belts.fetch_add(1, Ordering::Relaxed);
    }

    /// Ends the drive of one belt. After the end of its last belt, the motor advances without the scene.
    pub(crate) fn remove_belt(&self) {
        self.0.belts.fetch_sub(1, Ordering::Relaxed);
    }

    pub(crate) fn in_scene(&self) -> bool {
        self.0.belts.load(Ordering::Relaxed) > 0
    }

    fn show(&self, angle: f64) {
        self.0.angle.store(angle.to_bits(), Ordering::Relaxed);
    }
}

#[derive(Clone, Debug)]
enum Plant {
    Wut(Box<Wut>),
    Physical(Box<Motor>),
}

impl PlantAxis {
    /// An axis at standstill at its start angle. `seed` determines ripple, jitter and bounce.
    pub fn new(config: &AxisConfig, seed: u64) -> Self {
        Self::mounted(config, seed, None)
    }

    /// An axis that carries the load of its place in a mechanism, in place of the inertia and the gravity of
    /// [`MotorConfig`]. The regression model ignores that load, but its angle counts in the load of the other axes.
    pub fn mounted(config: &AxisConfig, seed: u64, mount: Option<&Mount>) -> Self {
        if let Some(mount) = mount {
            mount.place(config.start_angle);
        }
        let mut noise = Noise::new(seed);
        let angle = config.start_angle;
        let switches = [config.home_switch, config.negative_limit, config.positive_limit];
        Self {
            plant: match &config.plant {
                PlantConfig::Wut(wut) => Plant::Wut(Box::new(Wut::new(wut, angle))),
                PlantConfig::Physical(motor) => {
                    let noise = Noise::new(noise.bits());
                    Plant::Physical(Box::new(Motor::new(motor, mount, angle, noise)))
                }
            },
            mount: mount.cloned(),
            amplifier: Amplifier::new(config),
            encoder: Encoder::new(config.counts_per_revolution, config.index_angle, config.edge_jitter, angle),
            brake: config.brake,
            contacts: switches.map(|switch| Some(Contact::new(&switch?, angle))),
            noise,
            trip: None,
            phase: 0,
            probe: None,
            faults: PlantFaults::NONE,
        }
    }

    /// Sets the torque, N·m, added to the velocity loop's output under [`Demand::Position`] and [`Demand::Velocity`].
    pub fn set_torque_offset(&mut self, torque: f64) {
        self.amplifier.torque_offset = torque;
    }

    /// Advances by `dt_steps` sub-steps of 100 µs under one demand.
    ///
    /// In each sub-step the drive reads encoder and current and computes its output, and the plant integrates under
    /// that output. The outer loops run at every tenth sub-step since power-on, independent of the start of a call.
    pub fn advance(&mut self, dt_steps: u32, demand: Demand) {
        self.begin(demand);
        for sub_step in 0..dt_steps {
            self.sub_step(sub_step, demand);
        }
        self.end(dt_steps);
    }

    /// Sets the demand of the sub-steps that follow.
    pub(crate) fn begin(&mut self, demand: Demand) {
        if demand == Demand::Off {
            self.amplifier.release();
            self.trip = self.trip.filter(|trip| *trip != Trip::OverCurrent);
        } else if self.trip.is_none() {
            self.amplifier.command(&demand);
        }
    }

    /// One sub-step under `demand`; `number` counts the sub-steps since [`PlantAxis::begin`].
    #[inline]
    pub(crate) fn sub_step(&mut self, number: u32, demand: Demand) {
        self.amplifier.observe(self.encoder.since_power_on());
        let on = demand != Demand::Off && self.trip.is_none();
        if self.phase == 0 && on {
            self.amplifier.regulate(&demand, number, self.encoder.counts());
        }
        self.phase = (self.phase + 1) % OUTER;
        self.integrate(on);
        let angle = self.plant.angle();
        match (self.faults.frozen, self.faults.inverted) {
            (true, _) => self.encoder.read_frozen(angle, &mut self.noise),
            (false, true) => self.encoder.read_inverted(angle, &mut self.noise),
            (false, false) => self.encoder.read(angle, &mut self.noise),
        }
        if self.faults.index_missing {
            self.encoder.latched = None;
        }
        if let Some(probe) = &self.probe {
            probe.show(self.plant.angle());
        }
    }

    /// Reads the switches after `dt_steps` sub-steps.
    pub(crate) fn end(&mut self, dt_steps: u32) {
        let angle = self.plant.angle();
        if let (Plant::Wut(_), Some(mount)) = (&self.plant, &self.mount) {
            mount.load(angle);
        }
        for contact in self.contacts.iter_mut().flatten() {
            contact.advance(angle, dt_steps, &mut self.noise);
        }
    }

    /// Whether another device reads the motor shaft.
    pub(crate) fn is_probed(&self) -> bool {
        self.probe.is_some()
    }

    /// The robot that the motor moves.
    pub(crate) fn mechanism(&self) -> Option<&Mechanism> {
        self.mount.as_ref().map(Mount::mechanism)
    }

    /// Whether the axis moves a robot or a belt in a scene. Such an axis advances with the scene, in single sub-steps.
    pub(crate) fn in_scene(&self) -> bool {
        self.mount.as_ref().is_some_and(Mount::in_scene) || self.probe.as_ref().is_some_and(AngleProbe::in_scene)
    }

    fn integrate(&mut self, on: bool) {
        let released = on || self.faults.brake_slips;
        let brake = if released { 0.0 } else { self.brake } + if self.faults.blocked { BLOCK } else { 0.0 };
        let mount = self.mount.as_ref().filter(|mount| mount.in_scene());
        let outer = mount.map_or(0.0, |mount| mount.shaft().torque());
        match &mut self.plant {
            Plant::Wut(wut) => {
                let current = if on { self.amplifier.settle(wut) } else { 0.0 };
                if self.amplifier.overloaded(current) {
                    self.trip = Some(Trip::OverCurrent);
                    self.amplifier.release();
                }
                wut.step(self.amplifier.current, SUB_STEP, brake);
            }
            Plant::Physical(motor) => {
                let voltage = on.then(|| self.amplifier.voltage(motor.current));
                let most = self.faults.supply * self.amplifier.config.max_voltage;
                let voltage = if self.faults.supply < 1.0 { voltage.map(|it| it.clamp(-most, most)) } else { voltage };
                motor.step(voltage, brake, outer);
                self.trip = if motor.thermal.tripped {
                    Some(Trip::OverTemperature)
                } else if self.amplifier.overloaded(motor.current) {
                    Some(Trip::OverCurrent)
                } else {
                    self.trip.filter(|trip| *trip != Trip::OverTemperature)
                };
                if on && self.trip.is_some() {
                    self.amplifier.release();
                }
            }
        }
        // Over-temperature holds without power. Over-current needs power, and lasts until the power is off.
        if let Some(trip) = self.faults.trip.filter(|trip| on || *trip == Trip::OverTemperature) {
            self.trip = Some(trip);
            self.amplifier.release();
        }
        if let Some(mount) = mount {
            let (angle, velocity) = (self.plant.angle(), self.plant.velocity());
            mount.shaft().set(angle, velocity);
        }
    }

    /// Sensor readings after the last sub-step.
    pub fn feedback(&self) -> Feedback {
        let closed = |contact: &Option<Contact>| contact.as_ref().is_some_and(|it| it.closed);
        let stuck = |number: usize| self.faults.stuck[number].unwrap_or_else(|| closed(&self.contacts[number]));
        let [home_switch, negative_limit, positive_limit] = std::array::from_fn(stuck);
        let current = match &self.plant {
            Plant::Wut(_) => self.amplifier.current,
            Plant::Physical(motor) => motor.current,
        };
        Feedback {
            counts: self.encoder.counts(),
            velocity: self.amplifier.observed_velocity,
            torque: current * self.amplifier.torque_constant,
            current,
            index: self.encoder.latched,
            home_switch,
            negative_limit,
            positive_limit,
            trip: self.trip,
        }
    }

    /// Returns the index latch and arms it again.
    pub fn take_index(&mut self) -> Option<i32> {
        self.encoder.latched.take()
    }

    /// The index latch, without arming it again.
    pub(crate) fn index(&self) -> Option<i32> {
        self.encoder.latched
    }

    /// Sets the index latch.
    pub(crate) fn set_index(&mut self, index: Option<i32>) {
        self.encoder.latched = index;
    }

    /// A probe that follows the motor shaft. A clone of the axis moves the same probe.
    pub fn probe(&mut self) -> AngleProbe {
        let angle = self.plant.angle();
        self.probe.get_or_insert_with(|| AngleProbe::new(angle)).clone()
    }

    /// The true angle of the motor shaft, rad, which no drive can measure.
    pub fn angle(&self) -> f64 {
        self.plant.angle()
    }

    /// The true velocity of the motor shaft, rad/s, which no drive can measure.
    pub fn velocity(&self) -> f64 {
        self.plant.velocity()
    }

    /// Begins or ends a fault. A jump of the encoder happens at the beginning and has no end. A counter that froze, ran
    /// backwards or jumped keeps its offset against the shaft at the end of the fault.
    pub fn set_fault(&mut self, fault: PlantFault, on: bool) {
        let [home, negative, positive] = [0, 1, 2];
        let faults = &mut self.faults;
        match fault {
            PlantFault::Blocked => faults.blocked = on,
            PlantFault::EncoderFrozen => faults.frozen = on,
            PlantFault::EncoderJump(increments) if on => self.encoder.jump(increments),
            PlantFault::EncoderJump(_) => {}
            PlantFault::EncoderInverted => faults.inverted = on,
            PlantFault::HomeSwitchDead => faults.stuck[home] = on.then_some(false),
            PlantFault::LimitSwitchesDead => {
                (faults.stuck[negative], faults.stuck[positive]) = (on.then_some(false), on.then_some(false));
            }
            PlantFault::LimitSwitchClosed => faults.stuck[positive] = on.then_some(true),
            PlantFault::IndexMissing => faults.index_missing = on,
            PlantFault::OverCurrent => faults.trip = on.then_some(Trip::OverCurrent),
            PlantFault::OverTemperature => {
                faults.trip = on.then_some(Trip::OverTemperature);
                self.trip = self.trip.filter(|_| on);
            }
            PlantFault::Sagging(share) => faults.supply = if on { share } else { 1.0 },
            PlantFault::BrakeSlips => faults.brake_slips = on,
            PlantFault::SwappedPhases => match &mut self.plant {
                Plant::Wut(wut) => wut.reverse(),
                Plant::Physical(motor) => motor.reverse(),
            },
            PlantFault::Buffer { distance, stiffness } => self.set_buffer(on.then_some((distance, stiffness))),
        }
    }

    fn set_buffer(&mut self, buffer: Option<(f64, f64)>) {
        let (angle, velocity) = (self.plant.angle(), self.plant.velocity());
        let Plant::Physical(motor) = &mut self.plant else {
            return;
        };
        match buffer {
            Some((distance, stiffness)) => {
                let (negative, positive) = if velocity < 0.0 {
                    (angle - distance, f64::INFINITY)
                } else {
                    (f64::NEG_INFINITY, angle + distance)
                };
                let damping = motor.critical_damping(stiffness);
                let before = motor.set_buffers(Some(EndStops { negative, positive, stiffness, damping }));
                self.faults.buffers.get_or_insert(before);
            }
            None => {
                if let Some(before) = self.faults.buffers.take() {
                    motor.set_buffers(before);
                }
            }
        }
    }
}

impl Plant {
    fn velocity(&self) -> f64 {
        match self {
            Self::Wut(wut) => wut.velocity,
            Self::Physical(motor) => motor.velocity,
        }
    }

    fn angle(&self) -> f64 {
        match self {
            Self::Wut(wut) => wut.angle,
            Self::Physical(motor) => motor.angle,
        }
    }
}
