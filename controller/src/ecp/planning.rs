//! Planning: computes the first steps of generators, on another thread or at once.
//!
//! A first step may take long. An ECP hands each first step to a [`Planner`] and polls for the result. The plan of one
//! robot therefore delays no other robot. The first step of a coordinator is computed by the planner of its first member,
//! before the members begin. In lockstep each plan is computed [at once](AtOnce), and every run has the same
//! cycles.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use crate::generator::{Execution, GeneratorError};

/// A first step to compute. All images were read.
pub struct Plan {
    work: Work,
    macrostep: Duration,
    /// Number of the plan in its ECP. The result of an earlier plan is dropped.
    number: u64,
    result: Option<Result<(), GeneratorError>>,
}

/// The agent whose first step is computed.
enum Work {
    Generator(Box<dyn Execution + Send>),
    Coordinator(Box<dyn Preparation>),
}

/// A coordinator before its first step.
pub(crate) trait Preparation: Any + Send {
    /// Computes the first step, and keeps its results.
    fn plan(&mut self, macrostep: Duration) -> Result<(), GeneratorError>;
}

impl Plan {
    fn new(work: Work, macrostep: Duration, number: u64) -> Self {
        Self { work, macrostep, number, result: None }
    }

    /// Computes the first step. A panic of the agent becomes its error.
    pub fn compute(&mut self) {
        let first = || match &mut self.work {
            Work::Generator(run) => run.plan(self.macrostep),
            Work::Coordinator(preparation) => preparation.plan(self.macrostep),
        };
        let first = catch_unwind(AssertUnwindSafe(first));
        self.result = Some(first.unwrap_or(Err(GeneratorError::Panicked)));
    }

    /// The agent and the result of its first step; `None` if the plan has another number or is not computed yet.
    fn into_result(self, number: u64) -> Option<(Work, Result<(), GeneratorError>)> {
        Some((self.work, self.result.filter(|_| self.number == number)?))
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
pub(crate) struct Planning {
    planner: Box<dyn Planner>,
    number: u64,
}

impl Planning {
    pub(crate) fn with(planner: Box<dyn Planner>) -> Self {
        Self { planner, number: 0 }
    }

    pub(super) fn begin(&mut self, run: Box<dyn Execution + Send>, macrostep: Duration) {
        self.begin_work(Work::Generator(run), macrostep);
    }

    /// The generator of the last plan, and the result of its first step.
    pub(super) fn finished(&mut self) -> Option<(Box<dyn Execution + Send>, Result<(), GeneratorError>)> {
        match self.finished_work()? {
            (Work::Generator(run), first) => Some((run, first)),
            (Work::Coordinator(_), _) => None,
        }
    }

    /// Takes a coordinator. The process has no instruction.
    pub(crate) fn prepare(&mut self, coordinator: Box<dyn Preparation>, macrostep: Duration) {
        self.begin_work(Work::Coordinator(coordinator), macrostep);
    }

    /// The coordinator of the last plan, and the result of its first step.
    pub(crate) fn prepared(&mut self) -> Option<(Box<dyn Preparation>, Result<(), GeneratorError>)> {
        match self.finished_work()? {
            (Work::Coordinator(coordinator), first) => Some((coordinator, first)),
            (Work::Generator(_), _) => None,
        }
    }

    fn begin_work(&mut self, work: Work, macrostep: Duration) {
        self.number += 1;
        self.planner.begin(Plan::new(work, macrostep, self.number));
    }

    fn finished_work(&mut self) -> Option<(Work, Result<(), GeneratorError>)> {
        while let Some(plan) = self.planner.finished() {
            if let Some(result) = plan.into_result(self.number) {
                return Some(result);
            }
        }
        None
    }
}
