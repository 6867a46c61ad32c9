//! Status of the drive: the objects that can be read or mapped to TPDOs.

use canopen::Object;
use canopen::cia402::{Controlword, HomingStatus, ModeOfOperation, Statusword};

use super::{Drive, Homing, POSITION_WINDOW, modes::rated_torque, standstill::Window};
use crate::epos4::table::{slot, slot_of};
use crate::node::objects::Objects;
use crate::node::table::Slot;

const POSITION_DEMAND: Slot = slot_of(Object::new(0x6062, 0));
const VELOCITY_DEMAND: Slot = slot_of(Object::new(0x606B, 0));
const CURRENT_AVERAGE: Slot = slot_of(Object::new(0x30D1, 1));
const INPUT_STATES: Slot = slot_of(Object::new(0x3141, 1));
const STANDSTILL_WINDOW: Slot = slot_of(Object::new(0x30E0, 1));
const STANDSTILL_WINDOW_TIME: Slot = slot_of(Object::new(0x30E0, 2));
const STANDSTILL_WINDOW_TIME_OUT: Slot = slot_of(Object::new(0x30E0, 3));

impl Drive {
    /// Writes the readable values to the dictionary.
    pub(in crate::epos4) fn publish(&mut self, objects: &mut Objects, dt: f64) {
        let unit = self.counts_per_velocity(objects);
        let position = self.feedback.counts.wrapping_add(self.offset);
        let ended = !matches!(self.homing, Homing::Searching(_) | Homing::Resting(_));
        if self.shown_offset == self.offset || self.homing_memory.shows_counter(ended, self.simulated) {
            self.shown_offset = self.offset;
        }
        let demand = self.motion.position.round() as i64 as i32;
        let per_amp = objects.f(slot!(EPOS4_TORQUE_CONSTANT)) * 1e-9;
        let current = self.feedback.torque / per_amp.max(1e-12);
        let rated = rated_torque(objects);
        self.average_current += (current - self.average_current) * (dt / 0.01).min(1.0);
        let late = demand.wrapping_sub(position);
        let target = self.profile.active.unwrap_or(self.motion.position);
        let near = (target - f64::from(position)).abs() <= objects.f(POSITION_WINDOW);
        self.in_window = near.then(|| self.in_window.map_or(0.0, |passed| passed + dt));
        let told = self.powered() && self.motion.velocity == 0.0;
        let window = Window {
            velocity: objects.f(STANDSTILL_WINDOW) * unit,
            time: objects.f(STANDSTILL_WINDOW_TIME) * 1e-3,
            time_out: objects.f(STANDSTILL_WINDOW_TIME_OUT) * 1e-3,
        };
        self.standstill.advance(self.feedback.velocity, told, &window, dt);
        let signed = |value: f64| value.round() as i32 as u32;
        objects.set(slot!(POSITION_ACTUAL), self.feedback.counts.wrapping_add(self.shown_offset) as u32);
        objects.set(POSITION_DEMAND, demand as u32);
        objects.set(slot!(FOLLOWING_ERROR_ACTUAL), late as u32);
        objects.set(slot!(VELOCITY_ACTUAL), signed(self.feedback.velocity / unit));
        objects.set(VELOCITY_DEMAND, signed(self.motion.velocity / unit));
        let share = (self.feedback.torque / rated.max(1e-12) * 1e3).clamp(-32_768.0, 32_767.0);
        objects.set(slot!(TORQUE_ACTUAL), signed(share));
        objects.set(slot!(EPOS4_CURRENT_ACTUAL), signed(current));
        objects.set(CURRENT_AVERAGE, signed(self.average_current));
        // maxon counts µN·m. With the vendor-ID of another maker the drive counts mN·m, as in CiA 402.
        let of_maxon = objects.u(slot!(VENDOR_ID)) == 0x0000_00FB;
        let unit = if of_maxon { 1e6 } else { 1e3 };
        objects.set(slot!(MOTOR_RATED_TORQUE), (rated * unit).round() as u32);
        objects.set(slot!(MODE_OF_OPERATION_DISPLAY), i32::from(self.mode.raw()) as u32);
        let inputs = u32::from(self.feedback.negative_limit)
            | u32::from(self.feedback.positive_limit) << 1
            | u32::from(self.feedback.home_switch) << 2
            | self.contact.as_ref().map_or(0, |contact| contact.levels(self.simulated));
        objects.set(slot!(DIGITAL_INPUTS), inputs);
        objects.set(INPUT_STATES, inputs);
        let word = self.statusword(objects);
        objects.set(slot!(STATUSWORD), u32::from(word));
    }

    fn statusword(&mut self, objects: &Objects) -> u16 {
        use ModeOfOperation as M;
        let operational = objects.nmt == canopen::nmt::NmtState::Operational;
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
                let ended = profile.active.is_none() && profile.next.is_none();
                let arrived = ended && self.settled(objects);
                word.with(REACHED, if halted { standing } else { arrived })
                    .with(BIT_12, profile.acknowledged || profile.next.is_some())
            }
            M::ProfileVelocity => {
                let target = objects.f(slot!(TARGET_VELOCITY)) * self.counts_per_velocity(objects);
                let arrived = (self.motion.velocity - target).abs() < 0.5;
                word.with(REACHED, if halted { standing } else { arrived }).with(BIT_12, self.standstill.reached)
            }
            M::Homing => {
                let halted = self.controlword.has(Controlword::HALT);
                let status = match self.homing {
                    Homing::Idle if standing => HomingStatus::Interrupted,
                    Homing::Searching(_) | Homing::Resting(_) if halted && standing => HomingStatus::Interrupted,
                    Homing::Idle | Homing::Searching(_) => HomingStatus::InProgress,
                    Homing::Resting(_) => HomingStatus::Attained,
                    Homing::Done => HomingStatus::Done,
                    Homing::Failed { standing: false } if halted && standing => HomingStatus::ErrorStanding,
                    Homing::Failed { standing: false } => HomingStatus::ErrorMoving,
                    Homing::Failed { standing: true } => HomingStatus::ErrorStanding,
                };
                word.with(self.homing_memory.show(status, self.simulated).bits(), true)
            }
            M::CyclicSynchronousPosition | M::CyclicSynchronousVelocity | M::CyclicSynchronousTorque => {
                word.with(BIT_12, self.follows())
            }
            _ => word,
        };
        word.0
    }
}
