//! Chunks of a drive whose axis advances with a scene, in single sub-steps.
//!
//! A chunk lasts 1 ms and has one demand. A received frame ends the chunk early. The set-point generator then returns
//! to its state at the beginning of the chunk, and is run for the shortened duration. The demand of the sub-steps
//! already done does not change.

use std::time::Duration;

use can::Instant;
use canopen::cia402::PowerState;

use super::{Brake, CHUNK, Drive, Homing, Motion, Setpoints};
use crate::Demand;
use crate::node::errors::Error;
use crate::node::objects::Objects;

const SUB_STEP: Duration = Duration::from_micros(100);
const SUB_STEP_NANOS: u64 = SUB_STEP.as_nanos() as u64;

/// A chunk in progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk {
    demand: Demand,
    /// Sub-steps so far.
    steps: u32,
    limit_switches: (bool, bool),
    /// State of the set-point generator at the beginning of the chunk.
    before: Generator,
}

/// State of the set-point generator, for all modes.
#[derive(Clone, Copy, Debug)]
struct Generator {
    motion: Motion,
    profile: Setpoints,
    segment: (f64, f64),
    homing: Homing,
    in_window: Option<f64>,
    offset: i32,
    referenced: bool,
    power: PowerState,
    braking: Option<(Brake, PowerState)>,
}

impl Drive {
    /// Advances the axis to `now`, or to the error at the end of a chunk.
    pub(in super::super) fn advance_sub_steps(&mut self, now: Instant, objects: &mut Objects) -> Option<Error> {
        // A chunk is long, and this code runs for each sub-step: the chunk stays in its place, and the times are integers.
        let steps = self.chunk.as_ref().map_or(0, |chunk| chunk.steps);
        let reached = self.simulated.as_nanos() + u64::from(steps) * SUB_STEP_NANOS;
        for _ in 0..now.as_nanos().saturating_sub(reached) / SUB_STEP_NANOS {
            if self.chunk.is_none() {
                self.chunk = Some(self.begin_chunk(objects));
            }
            let Some(chunk) = &mut self.chunk else {
                continue;
            };
            self.axis.sub_step(chunk.steps, chunk.demand);
            chunk.steps += 1;
            if chunk.steps < CHUNK {
                continue;
            }
            let error = self.chunk.take().and_then(|chunk| self.end_chunk(&chunk, objects));
            if error.is_some() {
                return error;
            }
        }
        None
    }

    /// Ends the chunk in progress, if there is one.
    pub(in super::super) fn cut_chunk(&mut self, objects: &mut Objects) -> Option<Error> {
        let chunk = self.chunk.take()?;
        self.restore(&chunk.before);
        // `generate` arms the index latch again during an index search. An index pulse found in this chunk must not be
        // lost.
        let index = self.axis.index();
        self.generate(chunk.steps, objects);
        self.axis.set_index(index);
        self.end_chunk(&chunk, objects)
    }

    fn begin_chunk(&mut self, objects: &Objects) -> Chunk {
        let before = Generator {
            motion: self.motion,
            profile: self.profile,
            segment: self.segment,
            homing: self.homing,
            in_window: self.in_window,
            offset: self.offset,
            referenced: self.referenced,
            power: self.power,
            braking: self.braking,
        };
        let limit_switches = self.limit_switches();
        let demand = self.generate(CHUNK, objects);
        self.axis.begin(demand);
        Chunk { demand, steps: 0, limit_switches, before }
    }

    fn end_chunk(&mut self, chunk: &Chunk, objects: &mut Objects) -> Option<Error> {
        self.simulated += chunk.steps * SUB_STEP;
        self.axis.end(chunk.steps);
        self.conclude(&chunk.demand, chunk.limit_switches, chunk.steps, objects)
    }

    fn restore(&mut self, generator: &Generator) {
        let Generator { motion, profile, segment, homing, in_window, offset, referenced, power, braking } = *generator;
        (self.motion, self.profile, self.segment, self.homing) = (motion, profile, segment, homing);
        (self.in_window, self.offset, self.referenced) = (in_window, offset, referenced);
        (self.power, self.braking) = (power, braking);
    }
}
