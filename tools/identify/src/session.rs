//! Orders of a measurement, as a function of the reports of the servo.

use anyhow::anyhow;
use rtrb::Consumer;
use servo::identify::{Run, Trace};
use servo::{EffectorLink, Order, Phase, Record, ServoAxisConfig, ServoFault};

use super::{Unmeasured, direct};

/// Orders of one measurement: enable, home if allowed, and move. Also collects the recorded samples.
pub(super) struct Session {
    effector: usize,
    run: Run,
    link: EffectorLink,
    records: Consumer<Record>,
    /// Whether homing is allowed.
    homes: bool,
    /// Whether the robot was homed.
    homed: bool,
    trace: Trace,
    stage: Stage,
    /// Number of the next macrostep.
    next: u64,
    /// Configuration of the axis with its limits.
    config: ServoAxisConfig,
}

#[derive(Clone, Debug, PartialEq)]
enum Stage {
    Begin,
    Enabling,
    Homing,
    Moving,
    Done,
    Refused(String),
    Faulted(ServoFault),
    Stopped,
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
            homed: false,
            trace: Trace::default(),
            stage: Stage::Begin,
            next: 1,
            config,
        }
    }

    pub(super) fn is_over(&self) -> bool {
        use Stage::{Done, Faulted, Refused, Stopped};
        matches!(self.stage, Done | Refused(_) | Faulted(_) | Stopped)
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
                self.stage = Stage::Faulted(fault);
                continue;
            }
            match (&self.stage, report.phase) {
                (Stage::Enabling, Phase::Standing) if !report.homed && self.homes => {
                    self.order(Order::Home);
                    self.homed = true;
                    self.stage = Stage::Homing;
                }
                (Stage::Enabling, Phase::Standing) if !report.homed => {
                    self.stage =
                        Stage::Refused("the robot is not homed: run the cell first".into());
                }
                (Stage::Enabling | Stage::Homing, Phase::Standing) if report.homed => {
                    self.begin(report.commanded);
                }
                (Stage::Moving, Phase::Standing)
                    if self.run.macrostep(self.next).is_none()
                        && report.macrostep == self.run.macrosteps() =>
                {
                    self.stage = Stage::Done;
                }
                (Stage::Enabling | Stage::Homing | Stage::Moving, Phase::Off) => {
                    self.stage = Stage::Stopped;
                }
                _ => {}
            }
        }
        if self.stage == Stage::Moving {
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
            Err(why) => self.stage = Stage::Refused(why),
        }
    }

    fn order(&mut self, order: Order) {
        self.link.orders.push(order).expect("there is room");
    }

    /// Returns the run and the recorded samples.
    pub(super) fn finish(mut self) -> Result<(Run, Trace), Unmeasured> {
        self.poll();
        Err(match self.stage {
            Stage::Done => return Ok((self.run, self.trace)),
            Stage::Refused(why) if !self.homed => Unmeasured::Refused(anyhow!(why)),
            Stage::Refused(why) => Unmeasured::Stopped(why),
            Stage::Faulted(fault) => Unmeasured::Stopped(fault.cause.to_string()),
            _ => Unmeasured::Stopped("stopped before it was measured".into()),
        })
    }
}
