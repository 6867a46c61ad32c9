//! The serial axis controllers of the IRb-6 and IRp-6, one drive per line, with either of their telegrams.
//!
//! An [`AxisController`] speaks [`serial::nfv2`] or the older [`serial::hi_moxa`], with the same drive behind either.
//! The drive has a power stage on 48 V, a position counter and protections. The power stage follows pulse
//! widths, or currents by its own loop. An index pulse can zero the position counter. The protections against
//! over-current and at the limit switches act without the host. The host closes all other loops. A set-point stays
//! until the next set-point, for any time. The drive keeps counter and reference while it has power, even when its
//! host restarts.
//!
//! When the last byte of a request arrives, the drive reads its sensors, executes the request, and answers after
//! [`AxisControllerConfig::answer_delay`]. The plant moves in sub-steps of 100 µs from power-on. A value that is read
//! is up to one sub-step old. A value that is set acts up to one sub-step early. Both offsets are constant at a
//! steady period.
//!
//! The telegrams are documented, the drive is not. The following behaviour is chosen here:
//!
//! * The current loop runs each sub-step. Its gains are pulse width per mA.
//! * The over-current protection trips at the first sub-step beyond the limit.
//! * A closed limit switch shorts the winding if the set-point drives further into the switch. Other set-points are
//!   followed.
//! * Positive counts run towards the upper switch.
//! * The index flag stays set until the search ends.
//! * A set-point for a mode other than the current mode is ignored.
//! * Bytes that follow an incomplete request after a pause of [`GAP`] begin a new request.
//!
//! Left out: speed and position modes, which no host used, and the limit flags 10 to 12 of NFv2.
//!
//! A drive in error mode opens the emergency stop of its [`Cabinet`]: no drive of the cabinet has power while any
//! drive is in error. A drive whose power stage was in use while the stop was open needs manual mode to regain power.
//! While the stop is open, manual mode shows the fault but does not latch it. Drives can therefore leave error one
//! after the other. A drive that trips stops only itself.

mod answers;
mod drive;
mod hi_moxa;
mod nfv2;
#[cfg(test)]
mod tests;

pub use drive::Cabinet;

use std::time::Duration;

use can::Instant;

use crate::plant::{AxisConfig, Mount};
use crate::{DeviceFault, LineDevice, PlantAxis, outbox::Outbox};
use answers::Answers;
use drive::Drive;
use hi_moxa::HiMoxa;
use nfv2::Nfv2;

/// A serial axis controller with its drive.
pub struct AxisController {
    drive: Drive,
    telegrams: Telegrams,
    outbox: Outbox,
    answer_delay: Duration,
    /// The unit is cut off its line.
    unplugged: bool,
    /// The unit has no supply.
    dead: bool,
    answers: Answers,
}

enum Telegrams {
    Nfv2(Box<Nfv2>),
    HiMoxa(HiMoxa),
}

impl AxisController {
    /// A controller with NFv2 telegrams after power-on, in manual mode.
    ///
    /// A frame is executed whole or not at all, in the order of its commands. A frame that contains a read is
    /// answered. A broadcast frame is executed and not answered. After bytes that form no valid frame, reception
    /// resumes at the next `#` that begins a frame.
    pub fn nfv2(address: u8, config: &AxisControllerConfig) -> Self {
        Self::new(Telegrams::Nfv2(Box::new(Nfv2::new(address))), config)
    }

    /// A controller with the older hi_moxa telegrams after power-on, in manual mode.
    ///
    /// A request is ten bytes from a preamble on. Bytes between requests are skipped. A preamble within a request
    /// begins a new request. The telegram has neither length nor checksum. Bytes that follow a torn request without a
    /// pause can therefore be taken for the rest of that request. Gains are accepted without effect, since no source
    /// gives their scale.
    pub fn hi_moxa(config: &AxisControllerConfig) -> Self {
        Self::new(Telegrams::HiMoxa(HiMoxa::new()), config)
    }

    fn new(telegrams: Telegrams, config: &AxisControllerConfig) -> Self {
        Self {
            drive: Drive::new(config),
            telegrams,
            outbox: Outbox::new(),
            answer_delay: config.answer_delay,
            unplugged: false,
            dead: false,
            answers: Answers::new(),
        }
    }

    /// The simulated axis, including state that no drive can measure.
    pub fn axis(&self) -> &PlantAxis {
        &self.drive.axis
    }
}

impl LineDevice for AxisController {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.outbox.run(now);
        if self.unplugged || self.dead {
            return;
        }
        let drive = &mut self.drive;
        let (answers, outbox, at) = (&mut self.answers, &mut self.outbox, now + self.answer_delay);
        let answer = |bytes: &[u8]| answers.pass(bytes, |bytes| outbox.put(at, bytes));
        match &mut self.telegrams {
            Telegrams::Nfv2(nfv2) => nfv2.receive(byte, now, drive, answer),
            Telegrams::HiMoxa(hi_moxa) => hi_moxa.receive(byte, now, drive, answer),
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let byte = self.outbox.poll_transmit(now);
        byte.filter(|_| !self.unplugged && !self.dead)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.outbox.poll_timeout().into_iter().chain([self.drive.poll_timeout()]).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.outbox.run(now);
        if self.drive.poll_timeout() <= now {
            self.drive.catch_up(now);
        }
    }

    fn advance_mechanics(&mut self, now: Instant) -> bool {
        self.drive.advance_mechanics(now);
        false
    }

    fn set_fault(&mut self, fault: DeviceFault, on: bool, now: Instant) -> bool {
        self.drive.catch_up(now);
        match fault {
            DeviceFault::Unplugged => self.unplugged = on,
            DeviceFault::Reset if on => self.drive.restart(),
            DeviceFault::Reset => {}
            DeviceFault::PowerOff => {
                self.dead = on;
                self.drive.restart();
            }
            DeviceFault::AnswersFrozen
            | DeviceFault::AnswersOld
            | DeviceFault::AnswersReversed
            | DeviceFault::AnswersGarbled => return self.answers.set_fault(fault, on),
        }
        true
    }

    fn plant(&self) -> Option<&PlantAxis> {
        Some(self.axis())
    }

    fn plant_mut(&mut self) -> Option<&mut PlantAxis> {
        Some(&mut self.drive.axis)
    }

    fn cabinet(&self) -> Option<&Cabinet> {
        Some(self.drive.cabinet())
    }
}

/// A request interrupted for this long is discarded.
pub const GAP: Duration = Duration::from_micros(500);

/// Configuration of one unit.
#[derive(Clone, Debug)]
pub struct AxisControllerConfig {
    /// Time of power-on.
    pub power_on: Instant,
    /// Seed of noise and ripple.
    pub seed: u64,
    /// Motor, load and sensors. Of the amplifier, only the trip current counts, until the host sends its own limit.
    pub axis: AxisConfig,
    /// Mounting point of the axis. `None`: the motor carries a load of its own.
    pub mount: Option<Mount>,
    /// Voltage across the winding at a pulse width of 1000, V.
    pub supply: f64,
    /// Delay from the last byte of a request to the first byte of its answer.
    pub answer_delay: Duration,
    /// Position counter at the start, encoder pulses. A drive that had power before starts with its last count.
    pub counter: i32,
    /// Whether that counter is referenced.
    pub synchronized: bool,
    /// The cabinet of the drive. A clone of this configuration shares the cabinet.
    pub cabinet: Cabinet,
}

impl AxisControllerConfig {
    /// Supply of the power stage, V.
    pub const SUPPLY: f64 = 48.0;

    /// A drive after power-on, with a short answer delay and a cabinet of its own.
    pub fn new(axis: AxisConfig) -> Self {
        Self {
            power_on: Instant::ZERO,
            seed: 0,
            axis,
            mount: None,
            supply: Self::SUPPLY,
            answer_delay: Duration::from_micros(100),
            counter: 0,
            synchronized: false,
            cabinet: Cabinet::default(),
        }
    }
}
