//! Planning: computes the first steps of generators, on another thread or at once.
//!
//! A first step may take long. An ECP hands each first step to a [`Planner`] and polls for the result. The plan of one
//! robot therefore delays no other robot. In lockstep each plan is computed [at once](AtOnce), and every run has the same
//! cycles.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use crate::generator::{Execution, GeneratorError};

/// A first step to compute. The generator has read its images.
pub struct Plan {
    run: Box<dyn Execution + Send>,
    macrostep: Duration,
    /// Number of the plan in its ECP. The result of an earlier plan is dropped.
    number: u64,
    result: Option<Result<(), GeneratorError>>,
}

/// A generator with the result of its first step.
type Planned = (Box<dyn Execution + Send>, Result<(), GeneratorError>);

impl Plan {
    pub(super) fn new(run: Box<dyn Execution + Send>, macrostep: Duration, number: u64) -> Self {
        Self { run, macrostep, number, result: None }
    }

    /// Computes the first step. A panic of the generator becomes its error.
    pub fn compute(&mut self) {
        let first = catch_unwind(AssertUnwindSafe(|| self.run.plan(self.macrostep)));
        self.result = Some(first.unwrap_or(Err(GeneratorError::Panicked)));
    }

    /// The generator and the result of its first step; `None` if the plan has another number or is not computed yet.
    fn into_result(self, number: u64) -> Option<Planned> {
        Some((self.run, self.result.filter(|_| self.number == number)?))
    }
}

/// Computes the plans of one ECP. A planner on another thread returns from both functions without a wait.
pub trait Planner: Send {
    /// Takes a plan to compute. At most one plan of the ECP is of interest: a new plan replaces the last one.
    fn begin(&mut self, plan: Plan);

    /// A computed plan, if there is one.
    fn finished(&mut self) -> Option<Plan>;
}

/// Computes a plan on the calling thread as soon as it is handed over.
#[derive(Default)]
pub struct AtOnce(Option<Plan>);

impl Planner for AtOnce {
    fn begin(&mut self, mut plan: Plan) {
        plan.compute();
        self.0 = Some(plan);
    }

    fn finished(&mut self) -> Option<Plan> {
        self.0.take()
    }
}

/// The planner of an ECP, and the number of its last plan.
pub(super) struct Planning {
    planner: Box<dyn Planner>,
    number: u64,
}

impl Planning {
    pub(super) fn with(planner: Box<dyn Planner>) -> Self {
        Self { planner, number: 0 }
    }

    pub(super) fn begin(&mut self, run: Box<dyn Execution + Send>, macrostep: Duration) {
        self.number += 1;
        self.planner.begin(Plan::new(run, macrostep, self.number));
    }

    /// The generator of the last plan, and the result of its first step.
    pub(super) fn finished(&mut self) -> Option<Planned> {
        while let Some(plan) = self.planner.finished() {
            if let Some(result) = plan.into_result(self.number) {
                return Some(result);
            }
        }
        None
    }
}
