//! The axis controllers of the IRb-6 and IRp-6, one on each serial line, in both of their protocols.
//!
//! [`AxisControllerGroup`] brings its drives up, exchanges one telegram and one answer with each per cycle, believes
//! no answer that its motor cannot have given, and watches what is missing. These drives close at most the
//! current loop, and **they have no watchdog**: one that hears nothing follows its last set-point for ever. So
//! what takes torque away is said in every cycle and is the last thing said to a drive whose group is dropped;
//! but against the death of this process only the cabinet's emergency stop helps.
//!
//! # What each command means
//! - [`Off`](AxisCommand::Off) is a zero set-point and manual mode, in every cycle. Manual mode clears what the drive
//!   has latched; what the group has latched stays.
//! - [`Stand`](AxisCommand::Stand) is a zero set-point: pulse width zero shorts the motor, which brakes
//!   it; current zero lets it run out. It is no standing where a load pulls: follow at once.
//! - [`Follow`](AxisCommand::Follow) before [`Power::On`] was seen, of another kind than the drive's control, or
//!   beyond its greatest current or pulse width is refused: the fault names the axis, whose set-point is then zero,
//!   and no other axis of the group changes its own in that cycle. Nothing is clamped.
//! - [`Seek`](AxisCommand::Seek) follows as well, and the next index pulse zeroes the counter. A reference that the
//!   drive had is taken from it first, and one that it keeps is a fault. In the older protocol the parameter for that takes
//!   the place of every other set-point meanwhile.
//! - [`Home`](AxisCommand::Home) is refused: these drives have no homing of their own.
//! - An axis with a latched fault has a zero set-point under any command but `Off` and `ResetFault`.
//! - A **panic** ([`AxisControllerFault::is_panic`]) is a fault after which nobody knows what the drive does: too many
//!   answers missing, a counter that jumped. It may not hear us and go on by its last set-point, so **every drive of the
//!   group** is told, from that cycle's telegrams on and until its own `ResetFault`, to be in its error state, in which it
//!   opens its power stage and the emergency-stop circuit of their cabinet; that takes the power from all, the deaf one
//!   too. The axis that panicked reports it first; from the next reading on the others report
//!   [`AxisControllerFault::Cabinet`] with its line. Both protocols have such a state. A group is the drives of
//!   one cabinet: where it has one drive alone, nobody else can open the circuit for it.
//!
//! Power and mode are no part of an answer: a drive is where it was told to be once it has answered two
//! telegrams that said so, and it is not told again, so that one that was switched off and on stays off in NFv2. That
//! it was is known by its counter and its reference; of one that had no reference and stood at zero it is not. In the older
//! protocol every set-point names its mode, which switches such a drive on again: it gets zero from the first answer on
//! that shows a counter beyond reach or no reference, also before the next ones confirm it. The set-point of one cycle
//! it may have taken by then.
//!
//! # What is believed
//! The CRC of NFv2 lets one damaged frame in 32 through, the older protocol has none. So a position must be where
//! the motor can have got since the last believed one (`gate`), a current below one and a half times the greatest, and
//! **a status bit counts when two answers in a row show it**: also overcurrent, power stage and limit switches, on which
//! the drive acts by itself and at once, so that our acting a cycle earlier gains nothing and a flipped bit would stop
//! the robot. A counter that is elsewhere for three answers is a jump, which is a fault, and while seeking, near
//! zero, and with the drive's word that it is referenced, the index pulse after two. What is refused is counted
//! ([`AxisCounters`]) and counts as missing. What passes all the same, at which error rates, is in
//! `drivers/drive/benches/robustness/results.md`.
//!
//! Answers carry no number. One that comes a cycle late is taken for the next one's if that does not come as well; of a
//! moving motor it is implausible and refused, of a standing one it says the same. More than a quarter missing of 200 is a
//! fault, [`AxisControllerFault::Late`], since a line that delivers in heaps is no line for a loop; one that
//! begins to be late by the same time in every cycle is not seen, as each cycle then has an answer.
//!
//! Left out: position and speed modes, and all boards of the family that are no drives. Read [`DriveGroup`]
//! first, then `axis`, `bring_up`, `stream` and `gate`.

mod axis;
mod bring_up;
mod config;
mod exchange;
mod fault;
mod phase;
mod plausibility;
mod stream;
mod telegram;

use std::task::Poll;

use can::{Counters, Instant};
use serial::{Line, LineCounters, LineError};

pub use serial::{Settings, StopBits};

pub use config::{AxisConfig, ConfigError, Control, CurrentGains, GroupConfig, Protocol, Quantity};
pub use fault::{AxisControllerError, AxisControllerFault};

#[cfg(doc)]
use crate::Power;
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};
use axis::Axis;
use bring_up::BringUp;

/// What one reading takes: all that the tty layer of Linux ever holds, so that nothing old stays behind.
const READING: usize = 4_096;

/// Axis controllers, each on a line of its own. The module says what it does with each command.
///
/// A cycle makes one system call each way per line, and one more where torque is first taken away: whatever old
/// set-points a stalled line holds are dropped before that.
pub struct AxisControllerGroup<L: Line> {
    config: GroupConfig,
    controllers: Vec<Controller<L>>,
    up: bool,
    /// The last cycle was to send.
    attempted: bool,
    buffer: Box<[u8; READING]>,
    counters: GroupCounters,
    now: Instant,
}

/// One drive and its line.
struct Controller<L> {
    line: L,
    axis: Axis,
    bring_up: BringUp,
    begun: bool,
    setpoint: Option<i16>,
}

/// What is counted of one axis. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisCounters {
    /// Answers that were believed.
    pub accepted: u64,
    /// Whole answers refused by the gates: positions, currents, or a change not confirmed yet.
    pub implausible: u64,
    /// Damaged ones: in NFv2, headers behind which no answer was; in the older protocol, readings of another
    /// length than an answer's or with another start byte.
    pub damaged: u64,
    /// Answers of somebody else's address.
    pub foreign: u64,
    /// Answers that came with a later one, and were passed over.
    pub late: u64,
    /// Answers beyond what was asked for.
    pub surplus: u64,
    /// Times that an index pulse set the counter.
    pub indexed: u64,
    /// Telegrams sent whole.
    pub sent: u64,
    /// Telegrams that the line did not take, or not whole.
    pub refused: u64,
}

impl<L: Line> AxisControllerGroup<L> {
    /// A group that has sent nothing yet; states and commands come in the order of `axes`, and so do
    /// the lines.
    pub fn new(
        lines: Vec<L>,
        config: GroupConfig,
        axes: &[AxisConfig],
    ) -> Result<Self, ConfigError> {
        config.check(axes, lines.len())?;
        let controllers = lines.into_iter().zip(axes).zip(0..);
        let controllers = controllers.map(|((line, config_of_axis), index)| {
            let axis = Axis::new(&config, config_of_axis, index);
            let bring_up = BringUp::new(&config, config_of_axis, axis.dialect());
            Controller {
                line,
                axis,
                bring_up,
                begun: false,
                setpoint: None,
            }
        });
        Ok(Self {
            config,
            controllers: controllers.collect(),
            up: false,
            attempted: false,
            buffer: Box::new([0; READING]),
            counters: GroupCounters::default(),
            now: Instant::ZERO,
        })
    }

    /// What was counted of each axis.
    pub fn axis_counters(&self) -> impl Iterator<Item = AxisCounters> {
        self.controllers
            .iter()
            .map(|controller| controller.axis.counters)
    }

    fn advance_bring_up(&mut self, now: Instant) -> Result<bool, BringUpError> {
        let mut ready = true;
        for (line, controller) in (0..).zip(&mut self.controllers) {
            let Controller { axis, bring_up, .. } = controller;
            if !controller.begun {
                bring_up.reset(now);
                controller.begun = true;
            }
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

    /// A drive samples when a telegram arrives and only then takes its set-point: the answer to the next
    /// telegram, read a cycle after that was sent, is the first to show where it got.
    fn delay(&self) -> usize {
        2
    }

    /// Called after it was ready, or after an error, it begins anew. The error of the first failing axis
    /// decides.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        self.now = now;
        if std::mem::take(&mut self.up) {
            self.controllers
                .iter_mut()
                .for_each(|controller| controller.begun = false);
        }
        let result = match self.advance_bring_up(now) {
            Ok(false) => return Poll::Pending,
            Ok(true) => Ok(()),
            Err(error) => Err(error),
        };
        self.up = result.is_ok();
        self.attempted = false;
        for controller in &mut self.controllers {
            if self.up
                && let Some(learnt) = controller.bring_up.learnt()
            {
                controller.axis.begin(learnt);
            }
            controller.begun = self.up;
        }
        Poll::Ready(result)
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        self.now = now;
        for (controller, state) in self.controllers.iter_mut().zip(states) {
            let Controller { line, axis, .. } = controller;
            match line.read(now, &mut self.buffer[..]) {
                Ok(count) => axis.take(&self.buffer[..count], now),
                Err(error) => axis.line_failed(error),
            }
            let (read, missing) = axis.end_of_read(self.attempted);
            *state = read;
            self.counters.missed_answers += u64::from(missing && axis.was_sent());
        }
        self.attempted = false;
    }

    fn write(&mut self, _now: Instant, commands: &[AxisCommand]) {
        for (controller, &command) in self.controllers.iter_mut().zip(commands) {
            if command == AxisCommand::ResetFault {
                controller.axis.reset();
            }
        }
        // After the reading, which so shows the axis that panicked a cycle before those that stop with it.
        let panicked = (0..)
            .zip(&self.controllers)
            .find(|(_, controller)| controller.axis.requires_emergency_stop());
        if let Some((line, _)) = panicked {
            for (controller, &command) in self.controllers.iter_mut().zip(commands) {
                if command != AxisCommand::ResetFault {
                    controller.axis.stop_with(line);
                }
            }
        }
        let mut refused = false;
        for (controller, &command) in self.controllers.iter_mut().zip(commands) {
            controller.setpoint = match controller.axis.check(command) {
                Ok(setpoint) => setpoint,
                Err(refusal) => {
                    refused = true;
                    controller.axis.refuse(refusal);
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
            if axis.discards_unsent() {
                line.discard_unsent();
            }
            let taken = match line.write(now, axis.telegram()) {
                Ok(count) => count == axis.telegram().len(),
                Err(error) => {
                    axis.line_failed(error);
                    false
                }
            };
            axis.handed_over(taken, now);
            self.counters.dropped_setpoints += u64::from(!taken);
            all &= taken || axis.is_faulted();
        }
        self.attempted = true;
        all
    }

    /// The port's counters are those of the lines together, in telegrams; their errors are the answers refused. When
    /// an answer came a tty does not say, so that there is no bus time.
    fn counters(&self) -> GroupCounters {
        let mut counters = self.counters;
        let bits_of_a_byte = match self.config.settings.stop_bits {
            StopBits::One => 10,
            StopBits::Two => 11,
        };
        for Controller { line, axis, .. } in &self.controllers {
            let axis = axis.counters;
            let LineCounters {
                sent,
                received,
                dropped,
                ..
            } = line.counters();
            let refused = axis.implausible + axis.damaged + axis.foreign + axis.late + axis.surplus;
            counters.unexpected += refused;
            let port = &mut counters.port;
            *port = Counters {
                sent: port.sent + axis.sent,
                received: port.received + axis.accepted,
                refused: port.refused + axis.refused,
                dropped: port.dropped + dropped,
                errors: port.errors + refused,
                bits: port.bits + bits_of_a_byte * (sent + received),
            };
        }
        counters
    }
}

/// The last thing that a drive hears is to be off, or in error if it was so.
impl<L: Line> Drop for AxisControllerGroup<L> {
    fn drop(&mut self) {
        for Controller { line, axis, .. } in &mut self.controllers {
            line.discard_unsent();
            // There is nobody left to tell of a line that does not take it.
            let _: Result<usize, LineError> = line.write(self.now, axis.farewell().bytes());
        }
    }
}
