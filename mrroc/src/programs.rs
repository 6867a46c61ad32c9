//! The subcontrollers of a run under way: what they report and what stops them.

use can::Instant;
use controller::ecp::{EcpError, Subcontrollers};
use drive::Fault;
use servo::{Phase, Servo, ServoFault, StopCause, StopRequest};

use crate::cell_file::CellFile;
use crate::report::FaultReport;

/// Every task of a run. The first failure stops every robot.
pub(crate) struct Programs {
    subcontrollers: Subcontrollers,
    /// The phase of each robot that was last told.
    phases: Vec<Phase>,
    /// Instructions of each robot that ended in this poll.
    ended: Vec<u64>,
    pub(crate) faults: Vec<FaultReport>,
    stop: StopRequest,
}

/// News of one robot.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Index of the robot in its cell.
    pub robot: usize,
    /// What its effector does.
    pub phase: Phase,
    /// Instructions that ended since the last news.
    pub ended: u64,
}

impl Programs {
    /// The processes of a cell on the links to `servo`.
    pub(crate) fn new(subcontrollers: Subcontrollers, servo: &Servo) -> Self {
        let robots = subcontrollers.statuses().count();
        Self {
            phases: vec![Phase::Off; robots],
            ended: vec![0; robots],
            subcontrollers,
            faults: Vec::new(),
            stop: servo.stop_request(),
        }
    }

    /// Polls every process. Returns whether any has an instruction. `tell` receives news and must not wait.
    pub(crate) fn poll(
        &mut self,
        file: &CellFile,
        now: Instant,
        mut tell: impl FnMut(Progress),
    ) -> bool {
        let ended = &mut self.ended;
        ended.fill(0);
        let busy = self.subcontrollers.poll(now, |robot, event| {
            ended[robot] += 1;
            if let Err(error) = event.outcome {
                self.stop.request();
                self.faults.push(describe(file, robot, &error));
            }
        });
        let news = self.subcontrollers.statuses().zip(&mut self.phases);
        for (robot, ((status, phase), &ended)) in news.zip(&self.ended).enumerate() {
            if ended > 0 || status.phase != *phase {
                *phase = status.phase;
                tell(Progress {
                    robot,
                    phase: status.phase,
                    ended,
                });
            }
        }
        busy
    }
}

/// The failure of an instruction, in the words of the cell.
fn describe(file: &CellFile, robot: usize, error: &EcpError) -> FaultReport {
    match error {
        EcpError::Servo(fault) => describe_fault(file, robot, fault),
        error => FaultReport {
            robot: Some(file.cell.robot[robot].name.clone()),
            axis: None,
            what: error.to_string(),
        },
    }
}

fn describe_fault(file: &CellFile, robot: usize, fault: &ServoFault) -> FaultReport {
    let name = Some(file.cell.robot[robot].name.clone());
    let axis = fault.axis.map(usize::from);
    if let (StopCause::Drive(Fault::Port(error)), Some(axis)) = (fault.cause, axis) {
        // It is the bus's, and of every axis on it.
        let bus = &file.cell.robot[robot].axis[axis].bus;
        return FaultReport {
            robot: name,
            axis: None,
            what: format!("bus {bus}: {error}"),
        };
    }
    FaultReport {
        robot: name,
        axis: axis.map(|axis| file.axis_name(robot, axis)),
        what: fault.cause.to_string(),
    }
}

/// What the servo has latched of each robot, and that not all are without power.
pub(crate) fn servo_faults(file: &CellFile, servo: &Servo) -> Vec<FaultReport> {
    let robots = &file.cell.robot;
    let latched = |robot| Some(describe_fault(file, robot, &servo.fault(robot)?));
    let mut faults: Vec<_> = (0..robots.len()).filter_map(latched).collect();
    if !servo.is_off() {
        // The servo answers for all of them at once.
        let names: Vec<_> = robots.iter().map(|robot| robot.name.as_str()).collect();
        faults.push(FaultReport {
            robot: Some(names.join(" or ")),
            axis: None,
            what: "still has power, or did not say otherwise".into(),
        });
    }
    faults
}
