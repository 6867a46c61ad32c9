//! The drive as the application of its CANopen node.

use std::time::Duration;

use can::Instant;
use canopen::nmt::NmtState;

use super::drive::{CHUNK, Drive};
use super::errors;
use super::table::{CONTROL, MODE, SETPOINT, slot};
use crate::node::errors::{Error, Reaction};
use crate::node::objects::Objects;
use crate::node::{Application, Applied};

const SUB_STEP: Duration = Duration::from_micros(100);
/// Longest interval between two advances of the drive.
const LAZIEST: Duration = Duration::from_millis(20);

impl Application for Drive {
    /// Advances the axis to `now` in whole chunks. With `exact` the remaining sub-steps are simulated as well. An axis
    /// in a scene was advanced by the scene before, and only its chunk ends.
    fn catch_up(&mut self, now: Instant, exact: bool, objects: &mut Objects) -> Option<Error> {
        // A chunk in progress may have begun in a scene that has ended since.
        let error = self.cut_chunk(objects);
        if error.is_some() || self.axis.in_scene() {
            return error;
        }
        loop {
            let left = now.since(self.simulated);
            let steps = if left >= CHUNK * SUB_STEP {
                CHUNK
            } else if exact {
                (left.as_nanos() / SUB_STEP.as_nanos()) as u32
            } else {
                0
            };
            if steps == 0 {
                return None;
            }
            self.simulated += steps * SUB_STEP;
            let error = self.advance(steps, objects);
            if error.is_some() {
                return error;
            }
        }
    }

    fn advance_mechanics(&mut self, now: Instant, objects: &mut Objects) -> Option<Error> {
        if self.axis.in_scene() { self.advance_sub_steps(now, objects) } else { None }
    }

    fn poll_timeout(&self, event_driven: bool) -> Option<Instant> {
        let synchronised = self.last_sync.is_some_and(|at| self.simulated.since(at) < LAZIEST);
        let alone = event_driven || self.powered() && !synchronised;
        Some(self.simulated + if alone { CHUNK * SUB_STEP } else { LAZIEST })
    }

    /// A drive without power only reports the error.
    fn react(&mut self, error: Error, objects: &mut Objects) {
        match error.reaction {
            Reaction::None => {}
            Reaction::Disable => self.fault(true, objects),
            Reaction::Fault => self.fault(false, objects),
            Reaction::AbortConnection => self.abort_connection(objects),
        }
        Drive::publish(self, objects, 0.0);
    }

    fn faulted(&self) -> bool {
        self.is_faulted()
    }

    /// The end of the connection is an error if object 0x6007 makes a fault of it.
    fn end_connection(&mut self, objects: &mut Objects) -> Option<Error> {
        if objects.i(slot!(ABORT_CONNECTION_OPTION)) == 1 && !self.is_faulted() {
            return Some(errors::CONNECTION_ENDED);
        }
        self.abort_connection(objects);
        None
    }

    fn reset(&mut self, all: bool) {
        if all {
            self.restart();
        }
        self.last_sync = None;
    }

    fn start(&mut self, objects: &mut Objects) {
        self.started(objects);
    }

    fn publish(&mut self, objects: &mut Objects) {
        Drive::publish(self, objects, 0.0);
    }

    fn synchronise(&mut self, objects: &mut Objects, now: Instant) {
        self.last_sync = Some(now);
        if objects.nmt == NmtState::Operational {
            objects.changes.marks |= SETPOINT;
        }
    }

    fn apply(&mut self, marks: u8, objects: &mut Objects) -> Applied {
        if marks & MODE != 0 {
            self.change_mode(objects);
        }
        Applied {
            fault_reset: marks & CONTROL != 0 && self.command(objects),
            error: if marks & SETPOINT != 0 { self.latch(objects) } else { None },
            publish: marks & (MODE | CONTROL) != 0,
        }
    }
}
