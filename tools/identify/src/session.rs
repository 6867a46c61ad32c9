//! Orders of a measurement, as a function of the reports of the servo.

use anyhow::anyhow;
use rtrb::Consumer;
use servo::identify::{Run, Trace};
use servo::{EffectorLink, Order, Phase, Record, ServoAxisConfig};

use super::{Unmeasured, direct};

const UNFINISHED: &str = "stopped before it was measured";

/// Orders of one measurement: enable, home if allowed, and move. Also collects the recorded samples.
pub(super) struct Session {
    effector: usize,
    run: Run,
    link: EffectorLink,
    records: Consumer<Record>,
    /// Whether homing is allowed.
    homes: bool,
    trace: Trace,
    stage: Stage,
    /// Result of the measurement when it is over.
    outcome: Option<Result<(), Unmeasured>>,
    /// Number of the next macrostep.
    next: u64,
    /// Configuration of the axis with its limits.
    config: ServoAxisConfig,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Begin,
    Enabling,
    Homing,
    Moving,
}

impl Session {
    pub(super) fn new(
        effector: usize,
        run: Run,
        config: ServoAxisConfig,
        link: EffectorLink,
        records: Consumer<Record>,
        homes: bool,
    ) -> Self {
        Self {
            effector,
            run,
            link,
            records,
            homes,
            trace: Trace::default(),
            stage: Stage::Begin,
            outcome: None,
            next: 1,
            config,
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.outcome.is_some()
    }

    /// Gives the orders that are due.
    pub(super) fn poll(&mut self) {
        while let Ok(record) = self.records.pop() {
            if usize::from(record.effector) == self.effector {
                self.trace.take(&record, self.run.axis);
            }
        }
        if self.stage == Stage::Begin {
            self.order(Order::Enable);
            self.stage = Stage::Enabling;
        }
        while let Ok(report) = self.link.reports.pop() {
            if self.is_over() {
                continue;
            }
            if let Some(fault) = report.fault {
                self.stop(fault.cause.to_string());
                continue;
            }
            match (self.stage, report.snapshot.phase) {
                (Stage::Enabling, Phase::Standing) if !report.snapshot.homed && self.homes => {
                    self.order(Order::Home);
                    self.stage = Stage::Homing;
                }
                (Stage::Enabling, Phase::Standing) if !report.snapshot.homed => {
                    let why = anyhow!("the robot is not homed: run the cell first");
                    self.outcome = Some(Err(Unmeasured::Refused(why)));
                }
                (Stage::Enabling | Stage::Homing, Phase::Standing) if report.snapshot.homed => {
                    self.begin(report.snapshot.commanded);
                }
                (Stage::Moving, Phase::Standing)
                    if self.run.macrostep(self.next).is_none()
                        && report.snapshot.macrostep == self.run.macrosteps() =>
                {
                    self.outcome = Some(Ok(()));
                }
                (Stage::Enabling | Stage::Homing | Stage::Moving, Phase::Off) => {
                    self.stop(UNFINISHED.into());
                }
                _ => {}
            }
        }
        if self.stage == Stage::Moving && !self.is_over() {
            while self.link.orders.slots() > 2
                && let Some(macrostep) = self.run.macrostep(self.next)
            {
                self.order(Order::Move(macrostep));
                self.next += 1;
            }
        }
    }

    /// Starts the run from the present position.
    fn begin(&mut self, start: [f64; servo::MAX_AXES]) {
        self.run.start = start;
        match direct(&self.run, &self.config, start[self.run.axis]) {
            Ok(velocity) => {
                self.run.velocity = velocity;
                self.stage = Stage::Moving;
            }
            // Homing has moved the axis.
            Err(why) if self.stage == Stage::Homing => self.stop(why),
            Err(why) => self.outcome = Some(Err(Unmeasured::Refused(anyhow!(why)))),
        }
    }

    /// Ends a measurement that was broken off.
    fn stop(&mut self, why: String) {
        self.outcome = Some(Err(Unmeasured::Stopped(why)));
    }

    fn order(&mut self, order: Order) {
        self.link.orders.push(order).expect("there is room");
    }

    /// Returns the run and the recorded samples.
    pub(super) fn finish(mut self) -> Result<(Run, Trace), Unmeasured> {
        self.poll();
        match self.outcome {
            Some(outcome) => outcome.map(|()| (self.run, self.trace)),
            None => Err(Unmeasured::Stopped(UNFINISHED.into())),
        }
    }
}
