//! State machine of an effector.

use crate::Phase;

/// State of an effector: [`Phase`] plus details for the servo.
///
/// An effector is off, on and still, or between the two. Motion begins from standing and returns to standing when the
/// macrosteps end at rest. An order, a fault or a stop request that ends motion brakes first. The servo brakes motion
/// that the servo commands ([`State::Braking`]); the drive brakes motion that the drive commands, homing
/// ([`State::Halting`]). The state after braking is decided when braking begins and can only become stricter: stand,
/// then off, then faulted. A fault of an effector at rest takes its power at once. The loss of a loop that the servo
/// closes takes the power at once in every state (category 0).
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
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
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

/// Event at an effector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
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
}

/// Effect of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The event moves the machine to this state, which may be the current one.
    To(State),
    /// The event waits in the queue until the state changes.
    Wait,
    /// The event has no meaning in this state and is dropped.
    Refuse,
}

impl State {
    /// The only transition function.
    pub fn next(self, event: Event) -> Answer {
        use Answer::{Refuse, To, Wait};
        use State::{
            Braking, Enabling, Faulted, Halting, Homing, Moving, Off, Resetting, Standing,
        };
        match (self, event) {
            (_, Event::ControlLost) => To(Faulted),

            (Off, Event::Enable) => To(Enabling),
            (Off, Event::Stop | Event::Disable | Event::ResetFault) => To(Off),
            (Off, Event::Home | Event::Move | Event::Done) => Refuse,
            (Off | Enabling | Standing, Event::Fault) => To(Faulted),

            (Enabling, Event::Done) => To(Standing),
            (Enabling, Event::Enable | Event::Stop | Event::ResetFault) => To(Enabling),
            (Enabling, Event::Home | Event::Move) => Wait,
            (Enabling | Standing, Event::Disable) => To(Off),

            (Standing, Event::Home) => To(Homing),
            (Standing, Event::Move) => To(Moving),
            (Standing, Event::Enable | Event::Stop | Event::ResetFault) => To(Standing),
            (Standing, Event::Done) => Refuse,

            (Homing, Event::Done) => To(Standing),
            (Homing, Event::Enable | Event::ResetFault) => To(Homing),
            (Homing, Event::Home | Event::Move) => Wait,
            (Homing, Event::Stop) => To(Halting(After::Stand)),
            (Homing, Event::Disable) => To(Halting(After::Off)),
            (Homing, Event::Fault) => To(Halting(After::Fault)),

            (Moving, Event::Move | Event::Enable | Event::ResetFault) => To(Moving),
            (Moving, Event::Home) => Wait,
            (Moving, Event::Done) => To(Standing),
            (Moving, Event::Stop) => To(Braking(After::Stand)),
            (Moving, Event::Disable) => To(Braking(After::Off)),
            (Moving, Event::Fault) => To(Braking(After::Fault)),

            (Braking(after) | Halting(after), Event::Done) => To(match after {
                After::Stand => Standing,
                After::Off => Off,
                After::Fault => Faulted,
            }),
            (Braking(_) | Halting(_), Event::Enable | Event::Home | Event::Move) => Wait,
            (Braking(_) | Halting(_), Event::ResetFault) => Refuse,
            (Braking(_) | Halting(_), Event::Stop) => To(self),
            (Braking(after), Event::Disable) => To(Braking(after.max(After::Off))),
            (Halting(after), Event::Disable) => To(Halting(after.max(After::Off))),
            (Braking(_), Event::Fault) => To(Braking(After::Fault)),
            (Halting(_), Event::Fault) => To(Halting(After::Fault)),

            (Faulted, Event::ResetFault) => To(Resetting),
            (Faulted, Event::Stop | Event::Disable | Event::Fault) => To(Faulted),
            (Faulted, Event::Enable | Event::Home | Event::Move | Event::Done) => Refuse,

            (Resetting, Event::Done) => To(Off),
            (Resetting, Event::Fault) => To(Faulted),
            (Resetting, Event::Stop | Event::Disable | Event::ResetFault) => To(Resetting),
            (Resetting, Event::Enable | Event::Home | Event::Move) => Wait,
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
        use State::*;
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
            Event::Enable,
            Event::Home,
            Event::Move,
            Event::Stop,
            Event::Disable,
            Event::ResetFault,
            Event::Done,
            Event::Fault,
            Event::ControlLost,
        ];
        let table = [
            //                      Enable Home Move Stop Disable Reset Done Fault ControlLost
            (Off, "E--...-FF"),
            (Enabling, ".ww.O.SFF"),
            (Standing, ".HM.O.-FF"),
            (Homing, ".ww45.S6F"),
            (Moving, ".w.12.S3F"),
            (Braking(After::Stand), "www.2-S3F"),
            (Braking(After::Off), "www..-O3F"),
            (Braking(After::Fault), "www..-F.F"),
            (Halting(After::Stand), "www.5-S6F"),
            (Halting(After::Off), "www..-O6F"),
            (Halting(After::Fault), "www..-F.F"),
            (Faulted, "---..R-.."),
            (Resetting, "www...OFF"),
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
