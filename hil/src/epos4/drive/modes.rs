//! The modes of operation: from set-points and profiles to the demand on the axis.

use canopen::Object;
use canopen::cia402::{Controlword, HomingMethod, ModeOfOperation, PowerState};

use super::{Drive, Homing, POSITION_WINDOW};
use crate::Demand;
use crate::epos4::homing::{Progress, Search, Surroundings};
use crate::epos4::power::Brake;
use crate::epos4::profile::{Limits, Motion};
use crate::epos4::table::{slot, slot_of};
use crate::node::objects::Objects;
use crate::node::table::Slot;

const OUTPUT_CURRENT_LIMIT: Slot = slot_of(Object::new(0x3001, 2));
const POSITION_WINDOW_TIME: Slot = slot_of(Object::new(0x6068, 0));

/// Speed, revolutions/s, below which an axis that brakes at its limits counts as standing.
const STANDING: f64 = 0.1;

impl Drive {
    pub(super) fn new_setpoint(&mut self, started: bool, objects: &Objects) {
        let word = self.controlword;
        let profile = &mut self.profile;
        if started && profile.next.is_none() {
            let base = profile.active.unwrap_or(self.motion.position);
            let target = f64::from(objects.i(slot!(TARGET_POSITION)));
            let target = if word.has(Controlword::RELATIVE) { base + target } else { target };
            let waits = profile.active.is_some() && !word.has(Controlword::CHANGE_IMMEDIATELY);
            if waits {
                profile.next = Some(target);
            } else {
                profile.active = Some(target);
            }
            profile.acknowledged = true;
            self.in_window = None;
        } else if !word.has(Controlword::START) {
            profile.acknowledged = false;
        }
    }

    pub(super) fn start_or_stop_homing(&mut self, started: bool, objects: &Objects) {
        if started && !self.homing_memory.begin(self.simulated) {
            return;
        }
        if started {
            let method = HomingMethod(objects.i(slot!(HOMING_METHOD)) as i8);
            self.referenced = false;
            self.homing = match Search::new(method) {
                Some(search) => Homing::Searching(search),
                None => Homing::Failed { standing: false },
            };
        } else if !self.controlword.has(Controlword::START)
            && matches!(self.homing, Homing::Searching(_) | Homing::Resting(_))
        {
            self.homing = Homing::Idle;
        }
    }

    /// Whether the position has been in its window for its time. 0xFFFF_FFFF disables the check (CiA 402-2 §12).
    pub(super) fn settled(&self, objects: &Objects) -> bool {
        let time = objects.f(POSITION_WINDOW_TIME);
        objects.u(POSITION_WINDOW) == u32::MAX || self.in_window.is_some_and(|passed| passed * 1e3 >= time)
    }

    /// The straight ramp from `start` to the present demand.
    pub(super) fn ramp_demand(&self, start: Motion, dt: f64) -> Demand {
        Demand::Position {
            counts: start.position - f64::from(self.offset),
            velocity: (self.motion.position - start.position) / dt,
        }
    }

    pub(super) fn limits(&self, objects: &Objects) -> Limits {
        let top = objects.f(slot!(MAX_ACCELERATION));
        let rpm = self.counts_per_turn / 60.0;
        Limits {
            velocity: objects.f(slot!(MAX_PROFILE_VELOCITY)).min(objects.f(slot!(MAX_MOTOR_SPEED)))
                * self.counts_per_velocity(objects),
            acceleration: objects.f(slot!(PROFILE_ACCELERATION)).min(top).max(1.0) * rpm,
            deceleration: objects.f(slot!(PROFILE_DECELERATION)).min(top).max(1.0) * rpm,
        }
    }

    /// Counts/s per velocity unit (0x60A9). The unit is revolutions per minute times a power of ten.
    pub(super) fn counts_per_velocity(&self, objects: &Objects) -> f64 {
        let exponent = (objects.u(slot!(VELOCITY_UNIT)) >> 24) as u8 as i8;
        self.counts_per_turn / 60.0 * POWERS_OF_TEN[usize::from(exponent.unsigned_abs().min(6))]
    }

    pub(super) fn brake(
        &mut self,
        brake: Brake,
        then: PowerState,
        limits: &Limits,
        objects: &Objects,
        dt: f64,
    ) -> Demand {
        let start = self.motion;
        let standing = if brake == Brake::AtLimits {
            self.brake_at_limits()
        } else {
            self.motion.ramp(0.0, &self.braking_limits(brake, limits, objects), dt)
        };
        let demand = if brake == Brake::AtLimits {
            Demand::Velocity(0.0)
        } else if self.demands_velocity() {
            Demand::Velocity(self.motion.velocity)
        } else {
            self.ramp_demand(start, dt)
        };
        if standing {
            let position = self.motion.position;
            self.power = then;
            self.stand();
            if !self.demands_velocity() {
                self.motion.position = position;
            }
        }
        demand
    }

    /// Demands zero velocity with the velocity loop at its output limits. Returns whether the axis stands.
    fn brake_at_limits(&mut self) -> bool {
        let before = self.motion.velocity;
        self.motion = Motion { position: self.position(), velocity: self.feedback.velocity };
        let slow = self.feedback.velocity.abs() < self.counts_per_turn * STANDING;
        slow || before * self.feedback.velocity < 0.0
    }

    pub(super) fn braking_limits(&self, brake: Brake, limits: &Limits, objects: &Objects) -> Limits {
        let deceleration = match brake {
            Brake::SlowDown => limits.deceleration,
            Brake::QuickStop => objects.f(slot!(QUICK_STOP_DECELERATION)).max(1.0) * self.counts_per_turn / 60.0,
            Brake::AtLimits => f64::INFINITY,
        };
        Limits { deceleration, ..*limits }
    }

    /// One chunk of the mode of operation.
    pub(super) fn operate(&mut self, limits: &Limits, objects: &Objects, dt: f64) -> Demand {
        use ModeOfOperation as M;
        let mut start = self.motion;
        let halted = self.controlword.has(Controlword::HALT);
        let unit = self.counts_per_velocity(objects);
        match self.mode {
            M::ProfilePosition | M::ProfileVelocity | M::Homing if halted => {
                let brake = if objects.i(slot!(HALT_OPTION)) == 2 { Brake::QuickStop } else { Brake::SlowDown };
                let limits = self.braking_limits(brake, limits, objects);
                self.motion.ramp(0.0, &limits, dt);
            }
            M::ProfilePosition => {
                let limits =
                    Limits { velocity: limits.velocity.min(objects.f(slot!(PROFILE_VELOCITY)) * unit), ..*limits };
                match self.profile.active {
                    Some(target) => {
                        if self.motion.approach(target, &limits, dt) {
                            self.profile.active = None;
                        }
                    }
                    None if self.profile.next.is_some() && self.settled(objects) => {
                        self.profile.active = self.profile.next.take();
                        self.in_window = None;
                    }
                    None => {
                        self.motion.ramp(0.0, &limits, dt);
                    }
                }
            }
            M::ProfileVelocity => {
                let target = (objects.f(slot!(TARGET_VELOCITY)) * unit).clamp(-limits.velocity, limits.velocity);
                self.motion.ramp(target, limits, dt);
            }
            M::Homing => start = self.home(objects, dt),
            M::CyclicSynchronousPosition => self.interpolate(dt),
            M::CyclicSynchronousVelocity => {
                let top = objects.f(slot!(MAX_MOTOR_SPEED)) * unit;
                let target = objects.f(slot!(TARGET_VELOCITY)) + objects.f(slot!(VELOCITY_OFFSET));
                self.motion.velocity = (target * unit).clamp(-top, top);
            }
            M::CyclicSynchronousTorque => {
                let constant = objects.f(slot!(EPOS4_TORQUE_CONSTANT)) * 1e-6;
                let top = objects.f(OUTPUT_CURRENT_LIMIT) * 1e-3 * constant;
                let share = objects.f(slot!(TARGET_TORQUE)) + objects.f(slot!(TORQUE_OFFSET));
                let torque = share * 1e-3 * rated_torque(objects);
                return Demand::Torque(torque.clamp(-top, top));
            }
            _ => {}
        }
        if self.demands_velocity() { Demand::Velocity(self.motion.velocity) } else { self.ramp_demand(start, dt) }
    }

    /// The torque that object 0x60B2 adds to the output of the velocity loop, N·m: in CSP and CSV (CiA 402-2
    /// §17.4). EPOS4 maps the object next to the target in its own default PDO of either mode. In CST the target
    /// includes the offset.
    pub(super) fn torque_offset(&self, objects: &Objects) -> f64 {
        use ModeOfOperation as M;
        match self.mode {
            M::CyclicSynchronousPosition | M::CyclicSynchronousVelocity if self.follows() => {
                objects.f(slot!(TORQUE_OFFSET)) * 1e-3 * rated_torque(objects)
            }
            _ => 0.0,
        }
    }

    /// Continues along the segment that the last SYNC began, and stands at its end.
    pub(super) fn interpolate(&mut self, dt: f64) {
        let (target, left) = self.segment;
        if left > dt {
            self.motion.velocity = (target - self.motion.position) / left;
            self.motion.position += self.motion.velocity * dt;
            self.segment.1 = left - dt;
        } else {
            let way = target - self.motion.position;
            self.motion.velocity = if left > 0.0 { way / dt } else { 0.0 };
            self.motion.position = target;
            self.segment.1 = 0.0;
        }
    }

    /// Returns the start of this chunk, which is not the end of the last chunk if homing has set the counter.
    pub(super) fn home(&mut self, objects: &Objects, dt: f64) -> Motion {
        let unit = self.counts_per_velocity(objects);
        let acceleration = objects.f(slot!(HOMING_ACCELERATION)).max(1.0) * self.counts_per_turn / 60.0;
        let limits =
            Limits { velocity: objects.f(slot!(HOMING_ZERO_SPEED)) * unit, acceleration, deceleration: acceleration };
        let mut start = self.motion;
        match self.homing {
            Homing::Idle | Homing::Done | Homing::Failed { .. } => {
                let standing = self.motion.ramp(0.0, &limits, dt);
                if let Homing::Failed { .. } = self.homing {
                    self.homing = Homing::Failed { standing };
                }
            }
            Homing::Resting(target) => {
                if self.motion.approach(target, &limits, dt) {
                    self.homing = Homing::Done;
                }
            }
            Homing::Searching(mut search) => {
                let around = Surroundings {
                    velocity: self.motion.velocity,
                    stop_torque: objects.f(slot!(EPOS4_HOMING_CURRENT_THRESHOLD))
                        * 1e-3
                        * (objects.f(slot!(EPOS4_TORQUE_CONSTANT)) * 1e-6),
                    turn: self.counts_per_turn,
                    dt,
                };
                let progress = search.step(&self.feedback, &around);
                self.homing = Homing::Searching(search);
                let fast = objects.f(slot!(HOMING_SWITCH_SPEED)) * unit;
                let velocity = match progress {
                    Progress::Fast(direction) => direction * fast,
                    Progress::Slow(direction) => direction * limits.velocity,
                    Progress::ArmIndex(direction) => {
                        self.axis.take_index();
                        direction * limits.velocity
                    }
                    Progress::Found(counts) => {
                        self.reference(counts, objects);
                        start = self.motion;
                        0.0
                    }
                    Progress::Failed => {
                        self.homing = Homing::Failed { standing: false };
                        0.0
                    }
                };
                self.motion.ramp(velocity, &limits, dt);
            }
        }
        start
    }

    /// Sets the reference: the switch, stop or index is at `counts` of the raw counter. The zero position lies the
    /// home offset (0x607C) away from there (CiA 402-2 §11.5). The axis moves to the zero position, where the counter
    /// reads the home position (0x30B0).
    pub(super) fn reference(&mut self, counts: i32, objects: &Objects) {
        if matches!(self.homing, Homing::Searching(search) if search.feels_for_stop()) {
            // The stop held the axis back, so that the demanded position is far ahead of the actual position.
            self.motion.position = self.position();
        }
        let home = objects.i(slot!(EPOS4_HOME_POSITION));
        let zero = counts.wrapping_add(objects.i(slot!(EPOS4_HOME_OFFSET_MOVE)));
        let offset = home.wrapping_sub(zero);
        let shift = f64::from(offset.wrapping_sub(self.offset));
        self.offset = offset;
        self.motion.position += shift;
        self.segment.0 += shift;
        self.referenced = true;
        self.homing = Homing::Resting(f64::from(home));
    }
}

const POWERS_OF_TEN: [f64; 7] = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// The interpolation period 0x60C2 (CiA 402-2 §13.5.3), s; zero disables interpolation.
pub(super) fn interpolation_period(objects: &Objects) -> f64 {
    let index = objects.i(slot!(INTERPOLATION_PERIOD_INDEX)).unsigned_abs();
    objects.f(slot!(INTERPOLATION_PERIOD_VALUE)) * POWERS_OF_TEN[(index as usize).min(6)]
}

/// Nominal current times torque constant, N·m.
pub(super) fn rated_torque(objects: &Objects) -> f64 {
    objects.f(slot!(EPOS4_NOMINAL_CURRENT)) * 1e-3 * (objects.f(slot!(EPOS4_TORQUE_CONSTANT)) * 1e-6)
}
