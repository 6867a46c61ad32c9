//! The drive behind the dictionary: power states, modes of operation, and the axis.
//!
//! Time advances in chunks of up to 1 ms, the period of the drive's own control. In each chunk the mode's set-point
//! generator computes the demand, the axis advances under that demand, and the result is written to the dictionary.
//! Positions here are the device's counts: the axis' raw counter plus an offset that homing sets.
//!
//! The maxon documents that were read do not define the following. The behaviour is chosen here:
//!
//! * An axis that is switched on stands until the first SYNC or set-point.
//! * After braking in a velocity or torque mode, the axis holds its position.
//! * Software limits and set-point checks apply only to a referenced axis.
//! * Cyclic modes ignore halt.

mod coupled;
mod homing_memory;
mod modes;
mod standstill;
mod status;

use can::Instant;
use canopen::Object;
use canopen::cia402::{Controlword, ModeOfOperation, PowerCommand, PowerState};

use super::errors;
use super::power::{Brake, Options, Transition, on_command, on_fault};
use super::table::{slot, slot_of};
use super::{DriveContact, Epos4Config, homing::Search, profile::Motion};
use crate::node::errors::Error;
use crate::node::objects::Objects;
use crate::node::table::Slot;
use crate::{Demand, Feedback, PlantAxis, Trip, plant::SUB_STEP};
use coupled::Chunk;
use homing_memory::HomingMemory;
use standstill::Standstill;

const POSITION_WINDOW: Slot = slot_of(Object::new(0x6067, 0));

/// Sub-steps of a whole chunk: 1 ms.
pub(super) const CHUNK: u32 = 10;

#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) axis: PlantAxis,
    /// Time up to which the axis has been simulated.
    pub(super) simulated: Instant,
    pub(super) last_sync: Option<Instant>,
    counts_per_turn: f64,
    vendor_bits: u16,
    feedback: Feedback,
    /// Device position = raw counter + offset.
    offset: i32,
    /// The offset that the position shows.
    shown_offset: i32,
    homing_memory: HomingMemory,
    referenced: bool,
    power: PowerState,
    /// The current braking ramp, and the state that follows.
    braking: Option<(Brake, PowerState)>,
    controlword: Controlword,
    mode: ModeOfOperation,
    /// Demanded position and velocity, in device counts.
    motion: Motion,
    profile: Setpoints,
    /// Cyclic synchronous position: the end of the segment, and its remaining duration, s.
    segment: (f64, f64),
    homing: Homing,
    following_error: bool,
    standstill: Standstill,
    /// Time for which the position has been within the window around its target, s; `None` outside.
    in_window: Option<f64>,
    average_current: f64,
    /// Time of an over-current to come.
    trips_at: Option<Instant>,
    contact: Option<DriveContact>,
    /// The present chunk of an axis in a scene.
    chunk: Option<Chunk>,
}

/// Profile position mode: the current target and the next target.
#[derive(Clone, Copy, Debug, Default)]
struct Setpoints {
    active: Option<f64>,
    next: Option<f64>,
    acknowledged: bool,
}

#[derive(Clone, Copy, Debug)]
enum Homing {
    /// Homing has not started, or was interrupted.
    Idle,
    Searching(Search),
    /// The reference was found. The axis moves to its final position, in device counts.
    Resting(f64),
    Done,
    Failed {
        standing: bool,
    },
}

impl Drive {
    pub(super) fn new(config: &Epos4Config) -> Self {
        let axis = PlantAxis::mounted(&config.axis, config.seed, config.mount.as_ref());
        Self {
            feedback: axis.feedback(),
            axis,
            simulated: config.power_on,
            last_sync: None,
            counts_per_turn: f64::from(config.axis.counts_per_revolution),
            vendor_bits: config.vendor_bits,
            offset: 0,
            shown_offset: 0,
            homing_memory: HomingMemory::new(config.homing),
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
            standstill: Standstill::REACHED,
            in_window: None,
            average_current: 0.0,
            trips_at: config.trips_at,
            contact: config.contact.clone(),
            chunk: None,
        }
    }

    /// The device restarts: no power, no reference, and the counter begins at zero.
    pub(super) fn restart(&mut self) {
        self.offset = self.feedback.counts.wrapping_neg();
        self.shown_offset = self.offset;
        self.homing_memory.restart();
        self.referenced = false;
        self.power = PowerState::NotReadyToSwitchOn;
        self.mode = ModeOfOperation::None;
        self.controlword = Controlword(0);
        self.following_error = false;
        self.stand();
    }

    /// Ends a restart, if there was one.
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
            PowerState::OperationEnabled | PowerState::QuickStopActive | PowerState::FaultReactionActive
        )
    }

    /// Whether a fault is latched, or the axis is braking because of a fault.
    pub(super) fn is_faulted(&self) -> bool {
        matches!(self.power, PowerState::FaultReactionActive | PowerState::Fault)
    }

    /// Whether set-points of a cyclic mode are being followed.
    pub(super) fn follows(&self) -> bool {
        use ModeOfOperation as M;
        self.power == PowerState::OperationEnabled
            && self.braking.is_none()
            && matches!(
                self.mode,
                M::CyclicSynchronousPosition | M::CyclicSynchronousVelocity | M::CyclicSynchronousTorque
            )
    }

    /// Applies object 0x6060.
    pub(super) fn change_mode(&mut self, objects: &mut Objects) {
        let mode = ModeOfOperation::from_raw(objects.i(slot!(MODE_OF_OPERATION)) as i8);
        if mode == self.mode {
            return;
        }
        self.mode = mode;
        // A moving axis continues from the motion of the previous mode.
        let (motion, braking) = (self.motion, self.braking);
        self.stand();
        self.motion = motion;
        self.segment.0 = motion.position;
        self.braking = braking;
    }

    /// Applies object 0x6040. Returns `true` after a successful fault reset.
    pub(super) fn command(&mut self, objects: &mut Objects) -> bool {
        let before = self.controlword;
        let word = Controlword(objects.u(slot!(CONTROLWORD)) as u16);
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
        // One controlword can lead from ready to switch on through switched on to operation enabled.
        for _ in 0..2 {
            let Some(transition) = on_command(self.power, word.power_command(), &options(objects)) else {
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

    /// Enters the fault state: at once, or as the fault reaction option (0x605E) says.
    pub(super) fn fault(&mut self, at_once: bool, objects: &Objects) {
        self.perform(on_fault(self.power, at_once, &options(objects)));
    }

    /// Object 0x6007: the reaction to a lost connection to the host.
    pub(super) fn abort_connection(&mut self, objects: &Objects) {
        let options = options(objects);
        let transition = match objects.i(slot!(ABORT_CONNECTION_OPTION)) {
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
        // A command that is repeated each cycle does not restart its braking.
        let braking = transition.brake.map(|brake| (brake, transition.then));
        if transition.now == self.power && braking == self.braking {
            return;
        }
        self.power = transition.now;
        match braking {
            Some(_) => {
                // The demand may be far from the actual motion, or invalid: braking begins with the actual velocity.
                self.motion.velocity = self.feedback.velocity;
                if transition.now == PowerState::FaultReactionActive {
                    self.motion.position = self.position();
                }
                self.braking = braking;
            }
            None => {
                let motion = self.motion;
                self.stand();
                // An axis that keeps its power continues from the demanded position.
                if was_powered && self.powered() {
                    self.motion = motion;
                    self.segment.0 = motion.position;
                }
            }
        }
    }

    /// Clears every target: the axis holds its present position.
    fn stand(&mut self) {
        self.motion = Motion::at(self.position());
        self.segment = (self.motion.position, 0.0);
        self.profile = Setpoints::default();
        self.homing = Homing::Idle;
        self.homing_memory.leave();
        self.in_window = None;
        self.braking = None;
    }

    fn position(&self) -> f64 {
        f64::from(self.feedback.counts.wrapping_add(self.offset))
    }

    fn demands_velocity(&self) -> bool {
        use ModeOfOperation as M;
        matches!(self.mode, M::ProfileVelocity | M::CyclicSynchronousVelocity | M::CyclicSynchronousTorque)
    }

    /// Activates the set-points of the cyclic modes. Called at SYNC, or for a set-point outside SYNC.
    pub(super) fn latch(&mut self, objects: &Objects) -> Option<Error> {
        if self.mode != ModeOfOperation::CyclicSynchronousPosition || !self.follows() {
            return None;
        }
        let target = objects.f(slot!(TARGET_POSITION)) + objects.f(slot!(POSITION_OFFSET));
        if self.beyond_limits(target, objects) {
            return Some(errors::SOFTWARE_LIMIT);
        }
        self.segment = (target, modes::interpolation_period(objects));
        None
    }

    fn beyond_limits(&self, target: f64, objects: &Objects) -> bool {
        let (min, max) = (objects.f(slot!(MIN_POSITION_LIMIT)), objects.f(slot!(MAX_POSITION_LIMIT)));
        self.referenced && (min != 0.0 || max != 0.0) && !(min..=max).contains(&target)
    }

    /// Advances by `steps` sub-steps, at most [`CHUNK`], and updates the dictionary. Returns a new error, if any.
    pub(super) fn advance(&mut self, steps: u32, objects: &mut Objects) -> Option<Error> {
        let limit_switches = self.limit_switches();
        let demand = self.generate(steps, objects);
        self.axis.advance(steps, demand);
        self.conclude(&demand, limit_switches, steps, objects)
    }

    /// The demand on the axis for a chunk of `steps` sub-steps.
    fn generate(&mut self, steps: u32, objects: &Objects) -> Demand {
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
        self.axis.set_torque_offset(self.torque_offset(objects));
        demand
    }

    /// Reads the sensors after a chunk of `steps` sub-steps. Returns a new error, if any.
    fn conclude(
        &mut self,
        demand: &Demand,
        limit_switches: (bool, bool),
        steps: u32,
        objects: &mut Objects,
    ) -> Option<Error> {
        self.feedback = self.axis.feedback();
        if !matches!(demand, Demand::Position { .. }) {
            // The next demand begins at the actual position.
            self.motion.position = self.position();
            if matches!(demand, Demand::Off | Demand::Torque(_)) {
                self.motion.velocity = self.feedback.velocity;
            }
        }
        let error = self.check(demand, limit_switches, objects);
        self.publish(objects, f64::from(steps) * SUB_STEP);
        error
    }

    fn limit_switches(&self) -> (bool, bool) {
        (self.feedback.negative_limit, self.feedback.positive_limit)
    }

    fn check(&mut self, demand: &Demand, (negative, positive): (bool, bool), objects: &Objects) -> Option<Error> {
        if !self.powered() {
            return None;
        }
        if self.trips_at.is_some_and(|at| at <= self.simulated) {
            self.trips_at = None;
            return Some(errors::OVER_CURRENT);
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
        let window = objects.f(slot!(FOLLOWING_ERROR_WINDOW));
        if matches!(demand, Demand::Position { .. }) && !felt && late > window {
            self.following_error = true;
            return Some(errors::FOLLOWING);
        }
        let target = self.profile.active.filter(|_| self.mode == ModeOfOperation::ProfilePosition)?;
        self.beyond_limits(target, objects).then_some(errors::SOFTWARE_LIMIT)
    }
}

fn options(objects: &Objects) -> Options {
    Options {
        quick_stop: objects.i(slot!(QUICK_STOP_OPTION)),
        shutdown: objects.i(slot!(SHUTDOWN_OPTION)),
        disable_operation: objects.i(slot!(DISABLE_OPERATION_OPTION)),
        fault_reaction: objects.i(slot!(FAULT_REACTION_OPTION)),
    }
}
