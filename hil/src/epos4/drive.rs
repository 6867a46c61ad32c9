//! The drive behind the dictionary: power states, modes of operation, and the axis they move.
//!
//! Time advances in chunks of up to 1 ms, the period of the drive's own control. In each chunk the
//! mode's set-point generator says where the axis is to go, the axis goes, and what came of it is
//! published to the dictionary. Positions here are the device's counts: the axis' raw counter plus
//! an offset that homing sets.
//!
//! Not documented by maxon as far as was read, and chosen here: an axis that is switched on stands
//! until the first SYNC or set-point; after a brake in a velocity or torque mode it holds its
//! position; software limits and set-point checks begin with the reference; cyclic modes ignore
//! halt; bits 10 and 12 in the cyclic modes are [`CyclicStatus`]'s choice.

use canopen::cia402::{
    Controlword, HomingMethod, HomingStatus, ModeOfOperation, PowerState, Statusword,
};
use canopen::objects as named;

use super::CyclicStatus;
use super::errors::{self, Error, Reaction};
use super::homing::{Progress, Search, Surroundings};
use super::objects::Objects;
use super::power::{Brake, Options, Transition, on_command, on_fault};
use super::profile::{Limits, Motion};
use super::table::Slot;
use crate::plant::SUB_STEP;
use crate::{Axis, AxisConfig, Demand, Feedback, Trip};

/// Sub-steps of a whole chunk: 1 ms.
pub(super) const CHUNK: u32 = 10;

macro_rules! slots {
    ($($name:ident),* $(,)?) => { $(const $name: Slot = Slot::of(named::$name);)* };
}

slots!(
    CONTROLWORD,
    STATUSWORD,
    MODE_OF_OPERATION,
    MODE_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL,
    VELOCITY_ACTUAL,
    TORQUE_ACTUAL,
    TARGET_POSITION,
    TARGET_VELOCITY,
    TARGET_TORQUE,
    POSITION_OFFSET,
    VELOCITY_OFFSET,
    TORQUE_OFFSET,
    FOLLOWING_ERROR_WINDOW,
    FOLLOWING_ERROR_ACTUAL,
    MIN_POSITION_LIMIT,
    MAX_POSITION_LIMIT,
    MAX_PROFILE_VELOCITY,
    MAX_MOTOR_SPEED,
    PROFILE_VELOCITY,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    QUICK_STOP_DECELERATION,
    QUICK_STOP_OPTION,
    SHUTDOWN_OPTION,
    DISABLE_OPERATION_OPTION,
    HALT_OPTION,
    FAULT_REACTION_OPTION,
    HOMING_METHOD,
    HOMING_SWITCH_SPEED,
    HOMING_ZERO_SPEED,
    HOMING_ACCELERATION,
    EPOS4_HOME_POSITION,
    EPOS4_HOME_OFFSET_MOVE,
    EPOS4_HOMING_CURRENT_THRESHOLD,
    EPOS4_NOMINAL_CURRENT,
    EPOS4_TORQUE_CONSTANT,
    EPOS4_CURRENT_ACTUAL,
    MOTOR_RATED_TORQUE,
    VELOCITY_UNIT,
    INTERPOLATION_PERIOD_VALUE,
    INTERPOLATION_PERIOD_INDEX,
    MAX_ACCELERATION,
    DIGITAL_INPUTS,
    ABORT_CONNECTION_OPTION,
);
const POSITION_DEMAND: Slot = Slot::of(canopen::Object::new(0x6062, 0));
const VELOCITY_DEMAND: Slot = Slot::of(canopen::Object::new(0x606B, 0));
const CURRENT_AVERAGE: Slot = Slot::of(canopen::Object::new(0x30D1, 1));
const OUTPUT_CURRENT_LIMIT: Slot = Slot::of(canopen::Object::new(0x3001, 2));
const INPUT_STATES: Slot = Slot::of(canopen::Object::new(0x3141, 1));
const POSITION_WINDOW: Slot = Slot::of(canopen::Object::new(0x6067, 0));
const POSITION_WINDOW_TIME: Slot = Slot::of(canopen::Object::new(0x6068, 0));

/// The drive.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    axis: Axis,
    counts_per_turn: f64,
    cyclic_status: CyclicStatus,
    /// Bits that stand in every statusword.
    vendor_bits: u16,
    feedback: Feedback,
    /// Device position = raw counter + offset.
    offset: i32,
    referenced: bool,
    power: PowerState,
    /// How the axis is being braked and the state that follows.
    braking: Option<(Brake, PowerState)>,
    controlword: Controlword,
    mode: ModeOfOperation,
    /// Where the axis is to be, in device counts.
    motion: Motion,
    profile: Setpoints,
    /// Cyclic synchronous position: where the segment ends and how long it still lasts, s.
    segment: (f64, f64),
    homing: Homing,
    following_error: bool,
    /// How long the position has been within its window, s.
    in_window: f64,
    average_current: f64,
}

/// Profile position mode: the target in progress and the one behind it.
#[derive(Clone, Copy, Debug, Default)]
struct Setpoints {
    active: Option<f64>,
    next: Option<f64>,
    acknowledged: bool,
}

#[derive(Clone, Copy, Debug)]
enum Homing {
    /// Not started, or interrupted.
    Idle,
    Searching(Search),
    /// Found; on the way to where the axis is to rest, in device counts.
    Resting(f64),
    Done,
    Failed {
        standing: bool,
    },
}

impl Drive {
    pub(super) fn new(
        config: &AxisConfig,
        seed: u64,
        cyclic_status: CyclicStatus,
        vendor_bits: u16,
    ) -> Self {
        let axis = Axis::new(config, seed);
        Self {
            feedback: axis.feedback(),
            axis,
            counts_per_turn: f64::from(config.counts_per_revolution),
            cyclic_status,
            vendor_bits,
            offset: 0,
            referenced: false,
            power: PowerState::NotReadyToSwitchOn,
            braking: None,
            controlword: Controlword(0),
            mode: ModeOfOperation::None,
            motion: Motion::default(),
            profile: Setpoints::default(),
            segment: (0.0, 0.0),
            homing: Homing::Idle,
            following_error: false,
            in_window: 0.0,
            average_current: 0.0,
        }
    }

    pub(super) fn axis(&self) -> &Axis {
        &self.axis
    }

    /// The device restarts: no power, no reference, and the counter begins at zero.
    pub(super) fn restart(&mut self) {
        self.offset = self.feedback.counts.wrapping_neg();
        self.referenced = false;
        self.power = PowerState::NotReadyToSwitchOn;
        self.mode = ModeOfOperation::None;
        self.controlword = Controlword(0);
        self.stand();
    }

    /// The restart, if there was one, is over.
    pub(super) fn started(&mut self, objects: &mut Objects) {
        if self.power != PowerState::NotReadyToSwitchOn {
            return;
        }
        self.power = PowerState::SwitchOnDisabled;
        self.change_mode(objects);
        self.publish(objects, 0.0);
    }

    /// Whether the motor has torque.
    pub(super) fn powered(&self) -> bool {
        matches!(
            self.power,
            PowerState::OperationEnabled
                | PowerState::QuickStopActive
                | PowerState::FaultReactionActive
        )
    }

    /// Whether a fault is latched or being braked for.
    pub(super) fn faulted(&self) -> bool {
        matches!(
            self.power,
            PowerState::FaultReactionActive | PowerState::Fault
        )
    }

    /// Whether set-points of a cyclic mode are being followed.
    pub(super) fn follows(&self) -> bool {
        use ModeOfOperation as M;
        self.power == PowerState::OperationEnabled
            && self.braking.is_none()
            && matches!(
                self.mode,
                M::CyclicSynchronousPosition
                    | M::CyclicSynchronousVelocity
                    | M::CyclicSynchronousTorque
            )
    }

    /// Takes over object 0x6060.
    pub(super) fn change_mode(&mut self, objects: &mut Objects) {
        let mode = ModeOfOperation::from_raw(objects.i(MODE_OF_OPERATION) as i8);
        if mode == self.mode {
            return;
        }
        self.mode = mode;
        let velocity = self.motion.velocity;
        self.stand();
        // On the move, a profile goes on from the velocity that the axis has.
        self.motion.velocity = velocity;
    }

    /// Takes over object 0x6040. `true` is a fault reset that was obeyed.
    pub(super) fn command(&mut self, objects: &mut Objects) -> bool {
        let before = self.controlword;
        let word = Controlword(objects.u(CONTROLWORD) as u16);
        self.controlword = word;
        if self.power == PowerState::Fault {
            let edge = word.has(Controlword::RESET) && !before.has(Controlword::RESET);
            let reset = edge && self.feedback.trip.is_none();
            if reset {
                self.following_error = false;
                self.power = PowerState::SwitchOnDisabled;
            }
            return reset;
        }
        // Ready to switch on passes through switched on to operation enabled by one word.
        for _ in 0..2 {
            let Some(transition) = on_command(self.power, word.power_command(), &options(objects))
            else {
                break;
            };
            self.perform(transition);
        }
        let started = word.has(Controlword::START) && !before.has(Controlword::START);
        if self.power == PowerState::OperationEnabled && self.braking.is_none() {
            match self.mode {
                ModeOfOperation::ProfilePosition => self.new_setpoint(started, objects),
                ModeOfOperation::Homing => self.start_or_stop_homing(started, objects),
                _ => {}
            }
        }
        false
    }

    /// Does what an error asks for; a drive without power only shows it.
    pub(super) fn react(&mut self, error: Error, objects: &Objects) {
        let options = options(objects);
        let transition = match error.reaction {
            Reaction::Disable => Some(on_fault(self.power, true, &options)),
            Reaction::Fault => Some(on_fault(self.power, false, &options)),
            Reaction::AbortConnection => {
                return self.abort_connection(objects);
            }
        };
        if let Some(transition) = transition {
            self.perform(transition);
        }
    }

    /// Object 0x6007: what to do once the host is not heard any more.
    pub(super) fn abort_connection(&mut self, objects: &Objects) {
        use canopen::cia402::PowerCommand;
        let options = options(objects);
        let transition = match objects.i(ABORT_CONNECTION_OPTION) {
            1 => Some(on_fault(self.power, false, &options)),
            2 => on_command(self.power, PowerCommand::DisableVoltage, &options),
            3 => on_command(self.power, PowerCommand::QuickStop, &options),
            _ => None,
        };
        if let Some(transition) = transition {
            self.perform(transition);
        }
    }

    fn perform(&mut self, transition: Transition) {
        let was_powered = self.powered();
        let stays = transition.brake.is_none() && transition.now == self.power;
        if stays && self.braking.is_none() {
            return;
        }
        self.power = transition.now;
        match transition.brake {
            Some(brake) => {
                // The demand may be far off, or absurd: braking begins with what the axis does.
                self.motion.velocity = self.feedback.velocity;
                if transition.now == PowerState::FaultReactionActive {
                    self.motion.position = self.position();
                }
                self.braking = Some((brake, transition.then));
            }
            None => {
                self.braking = None;
                let motion = self.motion;
                self.stand();
                // An axis that keeps its power goes on from where it was told to be.
                if was_powered && self.powered() {
                    self.motion = motion;
                    self.segment.0 = motion.position;
                }
            }
        }
    }

    /// Forgets every target: the axis stands where it is.
    fn stand(&mut self) {
        self.motion = Motion::at(self.position());
        self.segment = (self.motion.position, 0.0);
        self.profile = Setpoints::default();
        self.homing = Homing::Idle;
        self.in_window = 0.0;
        self.braking = None;
    }

    fn position(&self) -> f64 {
        f64::from(self.feedback.counts.wrapping_add(self.offset))
    }

    fn demands_velocity(&self) -> bool {
        use ModeOfOperation as M;
        matches!(
            self.mode,
            M::ProfileVelocity | M::CyclicSynchronousVelocity | M::CyclicSynchronousTorque
        )
    }

    fn new_setpoint(&mut self, started: bool, objects: &Objects) {
        let word = self.controlword;
        let profile = &mut self.profile;
        if started && profile.next.is_none() {
            let base = profile.active.unwrap_or(self.motion.position);
            let target = f64::from(objects.i(TARGET_POSITION));
            let target = if word.has(Controlword::RELATIVE) {
                base + target
            } else {
                target
            };
            let waits = profile.active.is_some() && !word.has(Controlword::CHANGE_IMMEDIATELY);
            if waits {
                profile.next = Some(target);
            } else {
                profile.active = Some(target);
            }
            profile.acknowledged = true;
            self.in_window = 0.0;
        } else if !word.has(Controlword::START) {
            profile.acknowledged = false;
        }
    }

    fn start_or_stop_homing(&mut self, started: bool, objects: &Objects) {
        if started {
            let method = HomingMethod(objects.i(HOMING_METHOD) as i8);
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

    /// SYNC, or a set-point outside of it: the cyclic modes' set-points take effect.
    pub(super) fn latch(&mut self, objects: &Objects) -> Option<Error> {
        let position = self.mode == ModeOfOperation::CyclicSynchronousPosition;
        if !position || !self.follows() {
            return None;
        }
        let target = objects.f(TARGET_POSITION) + objects.f(POSITION_OFFSET);
        if self.beyond_limits(target, objects) {
            return Some(errors::SOFTWARE_LIMIT);
        }
        self.segment = (target, interpolation_period(objects));
        None
    }

    fn beyond_limits(&self, target: f64, objects: &Objects) -> bool {
        let (min, max) = (objects.f(MIN_POSITION_LIMIT), objects.f(MAX_POSITION_LIMIT));
        self.referenced && (min != 0.0 || max != 0.0) && !(min..=max).contains(&target)
    }

    /// Advances by `steps` sub-steps, at most [`CHUNK`], and publishes; an error if one appeared.
    pub(super) fn advance(&mut self, steps: u32, objects: &mut Objects) -> Option<Error> {
        let dt = f64::from(steps) * SUB_STEP;
        let start = self.motion;
        let limits = self.limits(objects);
        let demand = if !self.powered() {
            Demand::Off
        } else if let Some((brake, then)) = self.braking {
            self.brake(brake, then, &limits, objects, dt)
        } else if self.power == PowerState::OperationEnabled {
            self.operate(&limits, objects, dt)
        } else {
            self.ramp_demand(start, dt)
        };
        let limit_switches = (self.feedback.negative_limit, self.feedback.positive_limit);
        self.axis.advance(steps, demand);
        self.feedback = self.axis.feedback();
        if !matches!(demand, Demand::Position { .. }) {
            // What comes next begins where the axis is.
            self.motion.position = self.position();
            if matches!(demand, Demand::Off | Demand::Torque(_)) {
                self.motion.velocity = self.feedback.velocity;
            }
        }
        let error = self.check(&demand, limit_switches, objects);
        self.publish(objects, dt);
        error
    }

    /// The straight way from `start` to where the motion is now.
    fn ramp_demand(&self, start: Motion, dt: f64) -> Demand {
        Demand::Position {
            counts: start.position - f64::from(self.offset),
            velocity: (self.motion.position - start.position) / dt,
        }
    }

    fn limits(&self, objects: &Objects) -> Limits {
        let top = objects.f(MAX_ACCELERATION);
        let rpm = self.counts_per_turn / 60.0;
        Limits {
            velocity: objects
                .f(MAX_PROFILE_VELOCITY)
                .min(objects.f(MAX_MOTOR_SPEED))
                * self.counts_per_velocity(objects),
            acceleration: objects.f(PROFILE_ACCELERATION).min(top).max(1.0) * rpm,
            deceleration: objects.f(PROFILE_DECELERATION).min(top).max(1.0) * rpm,
        }
    }

    /// Counts/s of one velocity unit (0x60A9): revolutions per minute times a power of ten.
    fn counts_per_velocity(&self, objects: &Objects) -> f64 {
        let exponent = (objects.u(VELOCITY_UNIT) >> 24) as u8 as i8;
        self.counts_per_turn / 60.0 * POWERS_OF_TEN[usize::from(exponent.unsigned_abs().min(6))]
    }

    fn brake(
        &mut self,
        brake: Brake,
        then: PowerState,
        limits: &Limits,
        objects: &Objects,
        dt: f64,
    ) -> Demand {
        let start = self.motion;
        let standing = self
            .motion
            .ramp(0.0, &self.braking_limits(brake, limits, objects), dt);
        let demand = if self.demands_velocity() {
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

    fn braking_limits(&self, brake: Brake, limits: &Limits, objects: &Objects) -> Limits {
        let deceleration = match brake {
            Brake::SlowDown => limits.deceleration,
            Brake::QuickStop => {
                objects.f(QUICK_STOP_DECELERATION).max(1.0) * self.counts_per_turn / 60.0
            }
        };
        Limits {
            deceleration,
            ..*limits
        }
    }

    /// One chunk of the mode of operation.
    fn operate(&mut self, limits: &Limits, objects: &Objects, dt: f64) -> Demand {
        use ModeOfOperation as M;
        let mut start = self.motion;
        let halted = self.controlword.has(Controlword::HALT);
        let unit = self.counts_per_velocity(objects);
        match self.mode {
            M::ProfilePosition | M::ProfileVelocity | M::Homing if halted => {
                let brake = match objects.i(HALT_OPTION) {
                    2 => Brake::QuickStop,
                    _ => Brake::SlowDown,
                };
                let limits = self.braking_limits(brake, limits, objects);
                self.motion.ramp(0.0, &limits, dt);
            }
            M::ProfilePosition => {
                let limits = Limits {
                    velocity: limits.velocity.min(objects.f(PROFILE_VELOCITY) * unit),
                    ..*limits
                };
                match self.profile.active {
                    Some(target) => {
                        if self.motion.approach(target, &limits, dt) {
                            self.profile.active = self.profile.next.take();
                        }
                    }
                    None => {
                        self.motion.ramp(0.0, &limits, dt);
                    }
                }
            }
            M::ProfileVelocity => {
                let target =
                    (objects.f(TARGET_VELOCITY) * unit).clamp(-limits.velocity, limits.velocity);
                self.motion.ramp(target, limits, dt);
            }
            M::Homing => start = self.home(objects, dt),
            M::CyclicSynchronousPosition => self.interpolate(dt),
            M::CyclicSynchronousVelocity => {
                let top = objects.f(MAX_MOTOR_SPEED) * unit;
                let target = objects.f(TARGET_VELOCITY) + objects.f(VELOCITY_OFFSET);
                self.motion.velocity = (target * unit).clamp(-top, top);
            }
            M::CyclicSynchronousTorque => {
                let constant = objects.f(EPOS4_TORQUE_CONSTANT) * 1e-6;
                let top = objects.f(OUTPUT_CURRENT_LIMIT) * 1e-3 * constant;
                let share = objects.f(TARGET_TORQUE) + objects.f(TORQUE_OFFSET);
                let torque = share * 1e-3 * rated_torque(objects);
                return Demand::Torque(torque.clamp(-top, top));
            }
            _ => {}
        }
        if self.demands_velocity() {
            Demand::Velocity(self.motion.velocity)
        } else {
            self.ramp_demand(start, dt)
        }
    }

    /// Goes on along the segment that the last SYNC began, and stands at its end.
    fn interpolate(&mut self, dt: f64) {
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

    /// Returns where this chunk begins: elsewhere than the last one ended if the counter was set.
    fn home(&mut self, objects: &Objects, dt: f64) -> Motion {
        let unit = self.counts_per_velocity(objects);
        let acceleration = objects.f(HOMING_ACCELERATION).max(1.0) * self.counts_per_turn / 60.0;
        let limits = Limits {
            velocity: objects.f(HOMING_ZERO_SPEED) * unit,
            acceleration,
            deceleration: acceleration,
        };
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
                    stop_torque: objects.f(EPOS4_HOMING_CURRENT_THRESHOLD)
                        * 1e-3
                        * (objects.f(EPOS4_TORQUE_CONSTANT) * 1e-6),
                    turn: self.counts_per_turn,
                    dt,
                };
                let progress = search.step(&self.feedback, &around);
                self.homing = Homing::Searching(search);
                let fast = objects.f(HOMING_SWITCH_SPEED) * unit;
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

    /// The raw counter's `counts` is the home position.
    fn reference(&mut self, counts: i32, objects: &Objects) {
        if matches!(self.homing, Homing::Searching(search) if search.feels_for_stop()) {
            // The stop held the axis back; what it was told meanwhile is void.
            self.motion.position = self.position();
        }
        let home = objects.i(EPOS4_HOME_POSITION);
        let offset = home.wrapping_sub(counts);
        let shift = f64::from(offset.wrapping_sub(self.offset));
        self.offset = offset;
        self.motion.position += shift;
        self.segment.0 += shift;
        self.referenced = true;
        let rest = home.wrapping_add(objects.i(EPOS4_HOME_OFFSET_MOVE));
        self.homing = Homing::Resting(f64::from(rest));
    }

    fn check(
        &mut self,
        demand: &Demand,
        (negative, positive): (bool, bool),
        objects: &Objects,
    ) -> Option<Error> {
        if !self.powered() {
            return None;
        }
        if let Some(trip) = self.feedback.trip {
            return Some(match trip {
                Trip::OverCurrent => errors::OVER_CURRENT,
                Trip::OverTemperature => errors::MOTOR_TEMPERATURE,
            });
        }
        let homing = self.mode == ModeOfOperation::Homing;
        if !homing && self.feedback.negative_limit && !negative {
            return Some(errors::NEGATIVE_LIMIT);
        }
        if !homing && self.feedback.positive_limit && !positive {
            return Some(errors::POSITIVE_LIMIT);
        }
        let felt = matches!(self.homing, Homing::Searching(search) if search.feels_for_stop());
        let late = (self.motion.position - self.position()).abs();
        let window = objects.f(FOLLOWING_ERROR_WINDOW);
        if matches!(demand, Demand::Position { .. }) && !felt && late > window {
            self.following_error = true;
            return Some(errors::FOLLOWING);
        }
        if homing || !matches!(self.mode, ModeOfOperation::ProfilePosition) {
            return None;
        }
        let target = self.profile.active?;
        self.beyond_limits(target, objects)
            .then_some(errors::SOFTWARE_LIMIT)
    }

    /// Writes what can be read to the dictionary.
    pub(super) fn publish(&mut self, objects: &mut Objects, dt: f64) {
        let unit = self.counts_per_velocity(objects);
        let position = self.feedback.counts.wrapping_add(self.offset);
        let demand = self.motion.position.round() as i64 as i32;
        let per_amp = objects.f(EPOS4_TORQUE_CONSTANT) * 1e-9;
        let current = self.feedback.torque / per_amp.max(1e-12);
        let rated = rated_torque(objects);
        self.average_current += (current - self.average_current) * (dt / 0.01).min(1.0);
        let late = demand.wrapping_sub(position);
        let settled = f64::from(late.unsigned_abs()) <= objects.f(POSITION_WINDOW);
        self.in_window = if settled { self.in_window + dt } else { 0.0 };
        let signed = |value: f64| value.round() as i32 as u32;
        objects.set(POSITION_ACTUAL, position as u32);
        objects.set(POSITION_DEMAND, demand as u32);
        objects.set(FOLLOWING_ERROR_ACTUAL, late as u32);
        objects.set(VELOCITY_ACTUAL, signed(self.feedback.velocity / unit));
        objects.set(VELOCITY_DEMAND, signed(self.motion.velocity / unit));
        let share = (self.feedback.torque / rated.max(1e-12) * 1e3).clamp(-32_768.0, 32_767.0);
        objects.set(TORQUE_ACTUAL, signed(share));
        objects.set(EPOS4_CURRENT_ACTUAL, signed(current));
        objects.set(CURRENT_AVERAGE, signed(self.average_current));
        objects.set(MOTOR_RATED_TORQUE, (rated * 1e6).round() as u32);
        objects.set(MODE_OF_OPERATION_DISPLAY, i32::from(self.mode.raw()) as u32);
        let inputs = u32::from(self.feedback.negative_limit)
            | u32::from(self.feedback.positive_limit) << 1
            | u32::from(self.feedback.home_switch) << 2;
        objects.set(DIGITAL_INPUTS, inputs);
        objects.set(INPUT_STATES, inputs);
        let word = self.statusword(objects);
        objects.set(STATUSWORD, u32::from(word));
    }

    fn statusword(&self, objects: &Objects) -> u16 {
        use ModeOfOperation as M;
        let operational = objects.nmt == canopen::nmt::State::Operational;
        let state = self.power.bits().unwrap_or_default();
        let limit = self.feedback.negative_limit || self.feedback.positive_limit;
        let word = state
            .with(self.vendor_bits, true)
            .with(Statusword::VOLTAGE_ENABLED, self.powered())
            .with(Statusword::REMOTE, operational)
            .with(Statusword::INTERNAL_LIMIT, limit)
            .with(Statusword::EPOS_REFERENCED, self.referenced)
            .with(Statusword::MODE_SPECIFIC_13, self.following_error);
        let halted = self.controlword.has(Controlword::HALT) || self.braking.is_some();
        let standing = self.motion.velocity == 0.0;
        const REACHED: u16 = Statusword::TARGET_REACHED;
        const BIT_12: u16 = Statusword::MODE_SPECIFIC_12;
        let word = match self.mode {
            M::ProfilePosition => {
                let profile = &self.profile;
                let settled = objects.u(POSITION_WINDOW) == u32::MAX
                    || self.in_window * 1e3 >= objects.f(POSITION_WINDOW_TIME);
                let arrived = profile.active.is_none() && settled;
                word.with(REACHED, if halted { standing } else { arrived })
                    .with(BIT_12, profile.acknowledged || profile.next.is_some())
            }
            M::ProfileVelocity => {
                let target = objects.f(TARGET_VELOCITY) * self.counts_per_velocity(objects);
                let arrived = (self.motion.velocity - target).abs() < 0.5;
                // Standing is less than one revolution per minute.
                let slow = self.feedback.velocity.abs() < self.counts_per_turn / 60.0;
                word.with(REACHED, if halted { standing } else { arrived })
                    .with(BIT_12, slow)
            }
            M::Homing => {
                let status = match self.homing {
                    Homing::Idle if standing => HomingStatus::Interrupted,
                    Homing::Idle | Homing::Searching(_) => HomingStatus::InProgress,
                    Homing::Resting(_) => HomingStatus::Attained,
                    Homing::Done => HomingStatus::Done,
                    Homing::Failed { standing: false } => HomingStatus::ErrorMoving,
                    Homing::Failed { standing: true } => HomingStatus::ErrorStanding,
                };
                word.with(status.bits(), true)
            }
            M::CyclicSynchronousPosition
            | M::CyclicSynchronousVelocity
            | M::CyclicSynchronousTorque => {
                let shown = self.cyclic_status == CyclicStatus::FollowsCommand;
                word.with(BIT_12, shown && self.follows())
            }
            _ => word,
        };
        word.0
    }
}

const POWERS_OF_TEN: [f64; 7] = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// The interpolation period 0x60C2, s; zero is none.
pub(super) fn interpolation_period(objects: &Objects) -> f64 {
    let index = objects.i(INTERPOLATION_PERIOD_INDEX).unsigned_abs();
    objects.f(INTERPOLATION_PERIOD_VALUE) * POWERS_OF_TEN[(index as usize).min(6)]
}

/// Nominal current times torque constant, N·m.
fn rated_torque(objects: &Objects) -> f64 {
    objects.f(EPOS4_NOMINAL_CURRENT) * 1e-3 * (objects.f(EPOS4_TORQUE_CONSTANT) * 1e-6)
}

fn options(objects: &Objects) -> Options {
    Options {
        quick_stop: objects.i(QUICK_STOP_OPTION),
        shutdown: objects.i(SHUTDOWN_OPTION),
        disable_operation: objects.i(DISABLE_OPERATION_OPTION),
        fault_reaction: objects.i(FAULT_REACTION_OPTION),
    }
}
