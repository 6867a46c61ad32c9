//! State machine of an effector.

use super::StopCategory;
use crate::Phase;

/// State of an effector: [`Phase`] plus details for the servo.
///
/// An effector is off, on and still, or between the two. Motion begins from standing and returns to standing when the
/// macrosteps end at rest. An order, a fault or a stop request that ends motion brakes first. The servo brakes motion
/// that the servo commands ([`ServoState::Braking`]); the drive brakes motion that the drive commands, homing
/// ([`ServoState::Halting`]). The state after braking is decided when braking begins and can only become stricter: stand,
/// then off, then faulted. A fault of an effector at rest takes its power at once. The loss of a loop that the servo
/// closes takes the power at once in every state (category 0).
///
/// # Envelope of a stop
/// In a stop by set-points, the servo checks each motor in each cycle with a new sample. Motors of faulty drives and motors
/// that were cut are not checked.
///
/// - *Position*, for a motor whose drive closes the position loop. The motor may be ahead of its set-point, in the direction
///   of the stop, by its following error. In a stop of category 1, the lead at the beginning of the stop is added.
/// - *Velocity*. The greatest acceleration of the motor must suffice to bring it to rest at most one following error beyond
///   the end of the stop. If the motor already exceeds this distance when the stop begins, the excess is added. The permitted
///   velocity therefore falls along the stop. Three samples in a row decide.
/// - *Direction*. In the same way, the motor must be able to come to rest within one following error behind its position at
///   the beginning of the stop.
///
/// A motor that leaves this envelope does not brake. Its stop becomes stricter by one category: 2 becomes 1, and 1 becomes 0,
/// which takes the power at once. The envelope is then set anew at the present distances. Under a loop that the servo closes,
/// the power is taken at once in each case.
///
/// In a stop of homing, the drive or the search of the servo brakes the motor. A motor that still has more than half of its
/// speed after the longest stop of the effector loses its power at once, because no other way to brake exists in homing.
///
/// After the last set-point of a stop of category 1, the power is removed when the motors are still, and at the latest after
/// 100 ms, or after the longest stop if a drive has a fault. After a stop of category 2, the motors must stay within their
/// following errors.
///
/// ```text
/// Off ──Enable──▶ Enabling ──Done──▶ Standing ──Move──▶ Moving ──Done──▶ Standing
///                                    Standing ──Home──▶ Homing ──Done──▶ Standing
///
/// Moving ──Stop, Disable, Fault──▶ Braking(after) ─┐        ┌─ stand ─▶ Standing
///                                                  ├─ Done ─┼─ off ───▶ Off
/// Homing ──Stop, Disable, Fault──▶ Halting(after) ─┘        └─ fault ─▶ Faulted
///
/// Enabling, Standing ──Disable──▶ Off
/// Off, Enabling, Standing ──Fault──▶ Faulted ──ResetFault──▶ Resetting ──Done──▶ Off
///                                    Faulted ◀────Fault───── Resetting
///
/// any state ──ControlLost──▶ Faulted
/// Off ──Slip──▶ Enabling
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ServoState {
    /// Drives off.
    #[default]
    Off,
    /// The drives are being switched on.
    Enabling,
    /// On and still.
    Standing,
    /// The drives search their references.
    Homing,
    /// Following macrosteps.
    Moving,
    /// Decelerating by set-points.
    Braking(After),
    /// Waiting for the drives to end the motion of homing.
    Halting(After),
    /// Stopped by a fault, drives off.
    Faulted,
    /// Waiting for the drives to clear their faults, drives off.
    Resetting,
}

/// The state after a stop. The greater value wins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum After {
    /// Stand with power on (category 2).
    Stand,
    /// Switch the drives off (category 1).
    Off,
    /// Switch the drives off and latch the fault (category 1).
    Fault,
}

impl After {
    /// The category of a stop that ends in this state.
    pub fn category(self) -> StopCategory {
        match self {
            Self::Stand => StopCategory::Two,
            Self::Off | Self::Fault => StopCategory::One,
        }
    }
}

/// Event at an effector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoEvent {
    /// [`Order::Enable`](crate::Order::Enable).
    Enable,
    /// [`Order::Home`](crate::Order::Home).
    Home,
    /// [`Order::Move`](crate::Order::Move).
    Move,
    /// [`Order::Stop`](crate::Order::Stop).
    Stop,
    /// [`Order::Disable`](crate::Order::Disable).
    Disable,
    /// [`Order::ResetFault`](crate::Order::ResetFault).
    ResetFault,
    /// The awaited condition is reached: all drives on, all axes homed, the last macrostep ended at rest, standstill,
    /// or no drive fault left.
    Done,
    /// A fault of a drive, a failed check or a time-out.
    Fault,
    /// A position loop closed by the servo failed, and cannot brake.
    ControlLost,
    /// A brake does not hold the effector after an orderly power-off.
    Slip,
}

/// Effect of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The event moves the machine to this state, which may be the current one.
    To(ServoState),
    /// The event waits in the queue until the state changes.
    Wait,
    /// The event has no meaning in this state and is dropped.
    Refuse,
}

impl ServoState {
    /// The only transition function.
    pub fn next(self, event: ServoEvent) -> Answer {
        use Answer::{Refuse, To, Wait};
        use ServoState::{Braking, Enabling, Faulted, Halting, Homing, Moving, Off, Resetting, Standing};
        match (self, event) {
            (_, ServoEvent::ControlLost) => To(Faulted),
            (Off, ServoEvent::Slip) => To(Enabling),
            (_, ServoEvent::Slip) => Refuse,

            (Off, ServoEvent::Enable) => To(Enabling),
            (Off, ServoEvent::Stop | ServoEvent::Disable | ServoEvent::ResetFault) => To(Off),
            (Off, ServoEvent::Home | ServoEvent::Move | ServoEvent::Done) => Refuse,
            (Off | Enabling | Standing, ServoEvent::Fault) => To(Faulted),

            (Enabling, ServoEvent::Done) => To(Standing),
            (Enabling, ServoEvent::Enable | ServoEvent::Stop | ServoEvent::ResetFault) => To(Enabling),
            (Enabling, ServoEvent::Home | ServoEvent::Move) => Wait,
            (Enabling | Standing, ServoEvent::Disable) => To(Off),

            (Standing, ServoEvent::Home) => To(Homing),
            (Standing, ServoEvent::Move) => To(Moving),
            (Standing, ServoEvent::Enable | ServoEvent::Stop | ServoEvent::ResetFault) => To(Standing),
            (Standing, ServoEvent::Done) => Refuse,

            (Homing, ServoEvent::Done) => To(Standing),
            (Homing, ServoEvent::Enable | ServoEvent::ResetFault) => To(Homing),
            (Homing, ServoEvent::Home | ServoEvent::Move) => Wait,
            (Homing, ServoEvent::Stop) => To(Halting(After::Stand)),
            (Homing, ServoEvent::Disable) => To(Halting(After::Off)),
            (Homing, ServoEvent::Fault) => To(Halting(After::Fault)),

            (Moving, ServoEvent::Move | ServoEvent::Enable | ServoEvent::ResetFault) => To(Moving),
            (Moving, ServoEvent::Home) => Wait,
            (Moving, ServoEvent::Done) => To(Standing),
            (Moving, ServoEvent::Stop) => To(Braking(After::Stand)),
            (Moving, ServoEvent::Disable) => To(Braking(After::Off)),
            (Moving, ServoEvent::Fault) => To(Braking(After::Fault)),

            (Braking(after) | Halting(after), ServoEvent::Done) => To(match after {
                After::Stand => Standing,
                After::Off => Off,
                After::Fault => Faulted,
            }),
            (Braking(_) | Halting(_), ServoEvent::Enable | ServoEvent::Home | ServoEvent::Move) => Wait,
            (Braking(_) | Halting(_), ServoEvent::ResetFault) => Refuse,
            (Braking(_) | Halting(_), ServoEvent::Stop) => To(self),
            (Braking(after), ServoEvent::Disable) => To(Braking(after.max(After::Off))),
            (Halting(after), ServoEvent::Disable) => To(Halting(after.max(After::Off))),
            (Braking(_), ServoEvent::Fault) => To(Braking(After::Fault)),
            (Halting(_), ServoEvent::Fault) => To(Halting(After::Fault)),

            (Faulted, ServoEvent::ResetFault) => To(Resetting),
            (Faulted, ServoEvent::Stop | ServoEvent::Disable | ServoEvent::Fault) => To(Faulted),
            (Faulted, ServoEvent::Enable | ServoEvent::Home | ServoEvent::Move | ServoEvent::Done) => Refuse,

            (Resetting, ServoEvent::Done) => To(Off),
            (Resetting, ServoEvent::Fault) => To(Faulted),
            (Resetting, ServoEvent::Stop | ServoEvent::Disable | ServoEvent::ResetFault) => To(Resetting),
            (Resetting, ServoEvent::Enable | ServoEvent::Home | ServoEvent::Move) => Wait,
        }
    }

    /// The phase reported to the controller.
    pub fn phase(self) -> Phase {
        match self {
            Self::Off => Phase::Off,
            Self::Enabling => Phase::Enabling,
            Self::Standing => Phase::Standing,
            Self::Homing => Phase::Homing,
            Self::Moving => Phase::Moving,
            Self::Braking(_) | Self::Halting(_) => Phase::Stopping,
            Self::Faulted | Self::Resetting => Phase::Faulted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_answers_every_event_as_the_table_says() {
        use ServoState::*;
        // One letter per answer: the target state's, `.` for the same state, `w` wait, `-` refuse.
        let letter = |state| match state {
            Off => 'O',
            Enabling => 'E',
            Standing => 'S',
            Homing => 'H',
            Moving => 'M',
            Braking(After::Stand) => '1',
            Braking(After::Off) => '2',
            Braking(After::Fault) => '3',
            Halting(After::Stand) => '4',
            Halting(After::Off) => '5',
            Halting(After::Fault) => '6',
            Faulted => 'F',
            Resetting => 'R',
        };
        let events = [
            ServoEvent::Enable,
            ServoEvent::Home,
            ServoEvent::Move,
            ServoEvent::Stop,
            ServoEvent::Disable,
            ServoEvent::ResetFault,
            ServoEvent::Done,
            ServoEvent::Fault,
            ServoEvent::ControlLost,
            ServoEvent::Slip,
        ];
        let table = [
            //                      Enable Home Move Stop Disable Reset Done Fault ControlLost Slip
            (Off, "E--...-FFE"),
            (Enabling, ".ww.O.SFF-"),
            (Standing, ".HM.O.-FF-"),
            (Homing, ".ww45.S6F-"),
            (Moving, ".w.12.S3F-"),
            (Braking(After::Stand), "www.2-S3F-"),
            (Braking(After::Off), "www..-O3F-"),
            (Braking(After::Fault), "www..-F.F-"),
            (Halting(After::Stand), "www.5-S6F-"),
            (Halting(After::Off), "www..-O6F-"),
            (Halting(After::Fault), "www..-F.F-"),
            (Faulted, "---..R-..-"),
            (Resetting, "www...OFF-"),
        ];
        for (state, expected) in table {
            let row: String = events
                .iter()
                .map(|&event| match state.next(event) {
                    Answer::To(next) if next == state => '.',
                    Answer::To(next) => letter(next),
                    Answer::Wait => 'w',
                    Answer::Refuse => '-',
                })
                .collect();
            assert_eq!(row, expected, "{state:?}");
        }
    }
}
