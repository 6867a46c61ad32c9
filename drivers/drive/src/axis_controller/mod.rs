//! The axis controllers of the IRb-6 and IRp-6, each on a serial line of its own, in both of their protocols.
//!
//! [`AxisControllerGroup`] brings its drives up, exchanges one telegram and one answer with each drive per cycle, and
//! checks the plausibility of every answer. These drives close at most the current loop, and **they have no watchdog**:
//! a drive that hears nothing follows its last set-point for ever. So a telegram that takes torque away is repeated in
//! every cycle, and a dropped group sends it last. If this process dies, another process must send
//! [`error_state_telegram`] to every drive.
//!
//! # Commands
//! - [`Off`](AxisCommand::Off) sends a zero set-point and manual mode in every cycle. Manual mode clears the faults that
//!   the drive has latched. The faults that the group has latched stay.
//! - [`Stand`](AxisCommand::Stand) sends a zero set-point. Pulse width zero shorts the motor, which brakes; current zero
//!   lets the motor run out. Neither holds a load: follow at once.
//! - [`Follow`](AxisCommand::Follow) is refused before [`Power::On`], for another kind of set-point than the drive's
//!   control, and beyond the greatest current or pulse width. Nothing is clamped. The fault names the axis, whose
//!   set-point is then zero. Every other axis of the group keeps its set-point in that cycle.
//! - [`Seek`](AxisCommand::Seek) follows as well, and the next index pulse zeroes the counter. The drive is first told
//!   to forget a reference that it has; a reference that stays is a fault. In the older protocol this parameter takes
//!   the place of every other set-point.
//! - [`Home`](AxisCommand::Home) is refused: these drives have no homing of their own.
//! - A latched fault makes the set-point zero under any command but `Off` and `ResetFault`.
//!
//! `phase` has the diagram of the phases of an axis.
//!
//! # Emergency stop
//! After some faults ([`AxisControllerFault::is_emergency_stop`]) the state of the drive is unknown: too many answers
//! are missing, or the counter jumped. The drive may not hear the host and may follow its last set-point. So **every
//! drive of the group** is told to be in its error state, from the telegrams of that cycle until its own `ResetFault`.
//! In its error state a drive opens its power stage and the emergency-stop circuit of the cabinet. The open circuit
//! takes the power from every drive, also from a drive that does not hear.
//!
//! The axis with the fault reports the fault first. From the next reading on the other axes report
//! [`AxisControllerFault::Cabinet`] with the line of that axis. A group contains the drives of one cabinet. In a group of
//! one drive no other drive can open the circuit.
//!
//! # Modes and power cycles
//! An answer contains neither power nor mode. A drive is taken to be in its mode after two answers to telegrams with
//! that mode. The mode is then not repeated, so an NFv2 drive that was power-cycled stays off. In the older protocol
//! every set-point names its mode, so a set-point switches such a drive on again. This drive gets zero from the first
//! answer on that shows a counter beyond reach or no reference. It may have taken the set-point of one cycle by then.
//!
//! A power cycle is detected by a counter or a reference that changed. A drive that was unreferenced and stood at zero
//! cannot be told from a drive that was power-cycled.
//!
//! # Plausibility checks
//! The CRC of NFv2 lets one damaged frame in 32 through, and the older protocol has no CRC. So every answer is checked:
//! - The motor can have reached the position since the last accepted position (`plausibility`).
//! - The current is at most one and a half times the greatest current.
//! - **A status bit counts when two answers in a row show it.** Overcurrent, power stage and limit switches are
//!   included: the drive itself acts on them at once. Acting a cycle earlier gains nothing, and a flipped bit would
//!   stop the robot.
//! - A position beyond reach in three answers is a jump of the counter, which is a fault.
//! - A position near zero in two answers is the index pulse, if a search is on and the drive reports its reference.
//!
//! A fault names what explains more than half of the refused answers: old, reversed or garbled ones, or those of another
//! drive (`flaws`, which lists what is not seen).
//!
//! Refused answers are counted ([`AxisCounters`]) and count as missing. `drivers/drive/benches/robustness/results.md`
//! lists the error rates of accepted answers.
//!
//! # Late answers
//! Bring-up refuses a line whose answers take more than a period, and so does operation. Answers carry no number;
//! `delay` describes how late ones are told from those in time, and which delays are not seen. A late answer counts as
//! missing. More late and missing answers in a row than tolerated are the fault [`AxisControllerFault::Delayed`], or
//! [`AxisControllerFault::Silent`] if none came. More than a quarter missing of 200 answers, or more than half missing
//! or late, is the fault [`AxisControllerFault::Late`].
//!
//! In NFv2, a cycle reads either the current or the status or both, besides the position. The state keeps the last
//! value of the object that was not read. In the older protocol, a missing answer is followed by a cycle without a
//! telegram, in which the drive keeps its set-point.
//!
//! Left out: position and speed modes, and all boards of the family that are no drives. Read [`DriveGroup`] first, then
//! `phase`, `axis`, `bring_up`, `stream`, `delay` and `plausibility`.

mod axis;
mod bring_up;
mod config;
mod delay;
mod exchange;
mod fault;
mod flaws;
mod objects;
mod phase;
mod plausibility;
mod stream;
mod telegram;

use std::task::Poll;

use can::{Counters, Instant};
use serial::{Line, LineError};

pub use serial::{Settings, StopBits};

pub use config::{AxisConfig, ConfigError, Control, GroupConfig, Protocol, Quantity};
pub use fault::{AxisControllerError, AxisControllerFault};

#[cfg(doc)]
use crate::Power;
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};
use axis::SerialAxis;
use bring_up::BringUp;
use telegram::Dialect;

/// [`DriveGroup::delay`] of axis controllers, cycles.
pub const DELAY: usize = 2;

/// Bytes of one reading: the whole buffer of the tty layer of Linux, so that no old bytes stay behind.
const READING: usize = 4_096;

/// Axis controllers, each on a line of its own. The docs of the module describe the commands.
///
/// A cycle makes one system call each way per line. The cycle that takes torque away makes one more, which discards
/// old set-points that a stalled line still holds.
pub struct AxisControllerGroup<L: Line> {
    config: GroupConfig,
    controllers: Vec<Controller<L>>,
    /// The last cycle called [`send`](DriveGroup::send), so that answers are due.
    attempted: bool,
    buffer: Box<[u8; READING]>,
    counters: GroupCounters,
    now: Instant,
}

struct Controller<L> {
    line: L,
    config: AxisConfig,
    axis: SerialAxis,
    bring_up: Option<BringUp>,
    setpoint: Option<i16>,
}

/// The bytes that put a drive into its error state: it opens its power stage and the emergency-stop circuit of its
/// cabinet. For a process that stops the drives of a host that is silent. An NFv2 drive does not answer.
pub fn error_state_telegram(protocol: Protocol, axis: &AxisConfig) -> Vec<u8> {
    let dialect = Dialect::new(protocol, axis.address, axis.control);
    dialect.error_state().bytes().to_vec()
}

/// Counters of one axis. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisCounters {
    /// Accepted answers.
    pub accepted: u64,
    /// Whole answers that the plausibility checks refused: positions, currents, or a change not confirmed yet.
    pub implausible: u64,
    /// Damaged answers. In NFv2: headers without an answer. In the older protocol: readings of another length than an
    /// answer, or with another start byte.
    pub damaged: u64,
    /// Answers from another address.
    pub foreign: u64,
    /// Answers to an older request than the last one. They are not accepted.
    pub late: u64,
    /// Answers without a request.
    pub surplus: u64,
    /// Times that an index pulse set the counter.
    pub indexed: u64,
    /// Telegrams sent whole.
    pub sent: u64,
    /// Telegrams that the line did not take, or not whole.
    pub refused: u64,
    /// Telegrams that were left out to find answers that come late. The drive kept its set-point.
    pub left_out: u64,
}

impl<L: Line> AxisControllerGroup<L> {
    /// A group that has sent nothing yet; states and commands come in the order of `axes`, and so do
    /// the lines.
    pub fn new(lines: Vec<L>, config: GroupConfig, axes: &[AxisConfig]) -> Result<Self, ConfigError> {
        config.check(axes, lines.len())?;
        let controllers = lines.into_iter().zip(axes).zip(0..);
        let probes = config.protocol == Protocol::HiMoxa && axes.len() > 1;
        let controllers = controllers.map(|((line, &of_axis), index)| {
            let mut axis = SerialAxis::new(&config, &of_axis, index);
            axis.setup.probes = probes;
            Controller { line, config: of_axis, axis, bring_up: None, setpoint: None }
        });
        Ok(Self {
            config,
            controllers: controllers.collect(),
            attempted: false,
            buffer: Box::new([0; READING]),
            counters: GroupCounters::default(),
            now: Instant::ZERO,
        })
    }

    /// What was counted of each axis.
    pub fn axis_counters(&self) -> impl Iterator<Item = AxisCounters> {
        self.controllers.iter().map(|controller| controller.axis.counters)
    }

    /// Finds axes that get the answers of each other. NFv2 answers name their drive.
    fn find_swapped(&mut self) {
        if self.config.protocol == Protocol::Nfv2 {
            return;
        }
        for index in 0..self.controllers.len() {
            let axis = &self.controllers[index].axis;
            let others = (0_u8..).zip(&self.controllers);
            let mut swapped =
                others.filter(|(line, other)| usize::from(*line) != index && axis.swaps_with(&other.axis));
            let line = swapped.next().map(|(line, _)| line);
            if let Some(line) = line {
                self.controllers[index].axis.faults.latch(AxisControllerFault::Swapped { line });
            }
        }
    }

    fn advance_bring_up(&mut self, now: Instant) -> Result<bool, BringUpError> {
        let mut ready = true;
        for (line, controller) in (0..).zip(&mut self.controllers) {
            let Controller { axis, config, .. } = controller;
            let bring_up =
                controller.bring_up.get_or_insert_with(|| BringUp::new(&self.config, config, axis.setup.dialect, now));
            let buffer = &mut self.buffer[..];
            ready &= bring_up
                .advance(&mut controller.line, buffer, &mut axis.counters, now)
                .map_err(|error| BringUpError::AxisController { line, error })?;
        }
        Ok(ready)
    }
}

impl<L: Line> DriveGroup for AxisControllerGroup<L> {
    fn axes(&self) -> usize {
        self.controllers.len()
    }

    /// A drive samples when a telegram arrives, and then takes its set-point. The answer to the next telegram is the
    /// first to show the effect, and that answer is read a cycle later.
    fn delay(&self) -> usize {
        DELAY
    }

    /// A call after success or after an error begins anew. The error of the first failing axis is returned.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        self.now = now;
        let result = self.advance_bring_up(now);
        if result == Ok(false) {
            return Poll::Pending;
        }
        self.attempted = false;
        for controller in &mut self.controllers {
            let ended = controller.bring_up.take().filter(|_| result.is_ok());
            if let Some(learnt) = ended.and_then(BringUp::learnt) {
                controller.axis.begin(learnt);
            }
        }
        Poll::Ready(result.map(|_| ()))
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        self.now = now;
        for controller in &mut self.controllers {
            let Controller { line, axis, .. } = controller;
            match line.read(now, &mut self.buffer[..]) {
                Ok(count) => axis.take(&self.buffer[..count], now),
                Err(error) => axis.faults.latch(AxisControllerFault::Line(error)),
            }
        }
        self.find_swapped();
        for (controller, state) in self.controllers.iter_mut().zip(states) {
            let axis = &mut controller.axis;
            let (read, missing) = axis.end_of_read(self.attempted);
            *state = read;
            self.counters.missed_answers += u64::from(missing && axis.exchange.was_sent());
        }
        self.attempted = false;
    }

    fn write(&mut self, _now: Instant, commands: &[AxisCommand]) {
        for (controller, &command) in self.controllers.iter_mut().zip(commands) {
            if command == AxisCommand::ResetFault {
                controller.axis.faults.reset();
            }
        }
        // The reading came before: so states show the cause a cycle before the axes that stop with it.
        let cause =
            (0..).zip(&self.controllers).find(|(_, controller)| controller.axis.faults.requires_emergency_stop());
        if let Some((line, _)) = cause {
            for (controller, &command) in self.controllers.iter_mut().zip(commands) {
                if command != AxisCommand::ResetFault {
                    controller.axis.faults.stop_with(line);
                }
            }
        }
        let mut refused = false;
        for (controller, &command) in self.controllers.iter_mut().zip(commands) {
            controller.setpoint = match controller.axis.check(command) {
                Ok(setpoint) => setpoint,
                Err(refusal) => {
                    refused = true;
                    let fault = AxisControllerFault::Refused(refusal);
                    controller.axis.faults.latch(fault);
                    None
                }
            };
        }
        for (controller, &command) in self.controllers.iter_mut().zip(commands) {
            let setpoint = controller.setpoint;
            controller.axis.command(command, setpoint, refused);
        }
    }

    fn send(&mut self, now: Instant) -> bool {
        let mut all = true;
        for Controller { line, axis, .. } in &mut self.controllers {
            if axis.leave_out() {
                continue;
            }
            if axis.discards_unsent {
                line.discard_unsent();
            }
            let taken = match line.write(now, axis.telegram.bytes()) {
                Ok(count) => count == axis.telegram.bytes().len(),
                Err(error) => {
                    axis.faults.latch(AxisControllerFault::Line(error));
                    false
                }
            };
            axis.handed_over(taken, now);
            self.counters.dropped_setpoints += u64::from(!taken);
            all &= taken || axis.faults.is_latched();
        }
        self.attempted = true;
        all
    }

    fn doubt_reference(&mut self, axis: usize) {
        self.controllers[axis].axis.doubt_reference();
    }

    /// The counters of the port are sums over the lines, in telegrams. Errors are the refused answers. A tty does not
    /// say when an answer came, so there is no bus time.
    fn counters(&self) -> GroupCounters {
        let mut counters = self.counters;
        let bits_per_byte = self.config.settings.bits_per_byte();
        for Controller { line, axis, .. } in &self.controllers {
            let axis = axis.counters;
            let line = line.counters();
            let refused = axis.implausible + axis.damaged + axis.foreign + axis.late + axis.surplus;
            counters.unexpected += refused;
            let port = &mut counters.port;
            *port = Counters {
                sent: port.sent + axis.sent,
                received: port.received + axis.accepted,
                refused: port.refused + axis.refused,
                dropped: port.dropped + line.dropped,
                errors: port.errors + refused,
                bits: port.bits + bits_per_byte * (line.sent + line.received),
                ..*port
            };
        }
        counters
    }
}

/// The last telegram tells each drive to be off, or in its error state after an emergency stop.
impl<L: Line> Drop for AxisControllerGroup<L> {
    fn drop(&mut self) {
        for Controller { line, axis, .. } in &mut self.controllers {
            line.discard_unsent();
            // A dropped group cannot report that a line does not take the telegram.
            let _: Result<usize, LineError> = line.write(self.now, axis.farewell().bytes());
        }
    }
}
