//! The effector control processes of a run, and how far they are.

use anyhow::anyhow;
use can::Instant;
use controller::ecp::{Ecp, EcpError, Meetings};
use drive::Fault;
use indicatif::{ProgressBar, ProgressStyle};
use servo::{EffectorLink, Phase, Servo, ServoFault, StopCause, StopRequest};

use crate::cell_file::CellFile;
use crate::report::FaultReport;
use crate::{rehearsal, setup};

/// One effector control process per robot, each with its program.
pub(crate) struct Programs {
    ecps: Vec<Ecp>,
    meetings: Meetings,
    /// The phase of each that was last told.
    phases: Vec<Phase>,
    pub(crate) faults: Vec<FaultReport>,
    stop: StopRequest,
}

/// What is new of one robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    robot: usize,
    phase: Phase,
    /// Instructions that ended.
    done: u64,
}

impl Programs {
    /// The programs of a cell's robots on the links to its servo, whose handles the meetings and the first failure use.
    pub(crate) fn of(
        file: &CellFile,
        links: Vec<EffectorLink>,
        servo: &Servo,
    ) -> anyhow::Result<Self> {
        let mut ecps = Vec::new();
        for (robot, link) in links.into_iter().enumerate() {
            let arm = &file.arms[robot];
            let mut ecp = Ecp::new(arm.clone(), link, setup::ecp_config(file, robot));
            let task = file.cell.task(robot, arm);
            ecp.execute(task.map_err(|(_, error)| anyhow!(error))?)?;
            ecps.push(ecp);
        }
        Ok(Self {
            phases: vec![Phase::Off; ecps.len()],
            ecps,
            meetings: setup::meetings(file, servo.gates()),
            faults: Vec::new(),
            stop: servo.stop_request(),
        })
    }

    /// Lets every effector control process do what is due; `false` once all are done. The first failure
    /// stops every effector. `tell` hears of what is new, and must not wait.
    pub(crate) fn poll(
        &mut self,
        file: &CellFile,
        now: Instant,
        mut tell: impl FnMut(Seen),
    ) -> bool {
        for (robot, ecp) in self.ecps.iter_mut().enumerate() {
            let mut done = 0;
            while let Some(event) = ecp.poll(now) {
                done += 1;
                let fault = match event.outcome {
                    // What it was stopped for has been told.
                    Err(EcpError::Stopped) => None,
                    Err(error) => Some(describe(file, robot, &error)),
                    Ok(()) if file.cell.robot[robot].begins_behind(event.instruction) => {
                        refused_from_here(file, robot, ecp)
                    }
                    Ok(()) => None,
                };
                if let Some(fault) = fault {
                    self.stop.request();
                    self.faults.push(fault);
                    ecp.stop();
                }
            }
            let phase = ecp.status().phase;
            if done > 0 || phase != self.phases[robot] {
                self.phases[robot] = phase;
                tell(Seen { robot, phase, done });
            }
        }
        self.meetings.poll(&mut self.ecps);
        self.ecps
            .iter()
            .any(|ecp| ecp.status().instruction.is_some())
    }
}

/// Why a robot that is about to begin its program must not, if it stands anywhere but where homing leaves it: its drives
/// kept their reference, and no rehearsal began there.
fn refused_from_here(file: &CellFile, robot: usize, ecp: &Ecp) -> Option<FaultReport> {
    let motors = ecp.commanded()?;
    let home = file.cell.home(robot, &file.arms[robot]);
    if home.admits(&motors) {
        return None;
    }
    let error = rehearsal::rehearse_from(file, robot, motors).err()?;
    Some(FaultReport {
        robot: Some(file.cell.robot[robot].name.clone()),
        axis: None,
        what: format!(
            "was referenced and stands away from its home position, from where {error:#}"
        ),
    })
}

/// The progress bar of a run.
pub(crate) struct Progress {
    bar: ProgressBar,
    names: Vec<String>,
    phases: Vec<Phase>,
}

impl Progress {
    /// A bar over every instruction of every robot, or none.
    pub(crate) fn new(file: &CellFile, shown: bool) -> anyhow::Result<Self> {
        let moves = |robot: &controller::cell::Robot| robot.task_len() as u64;
        let bar = match shown {
            true => ProgressBar::new(file.cell.robot.iter().map(moves).sum()),
            false => ProgressBar::hidden(),
        };
        let style = ProgressStyle::with_template("{elapsed:>4} [{bar:30}] {pos}/{len} {msg}")?;
        bar.set_style(style.progress_chars("=> "));
        Ok(Self {
            bar,
            names: file
                .cell
                .robot
                .iter()
                .map(|robot| robot.name.clone())
                .collect(),
            phases: vec![Phase::Off; file.cell.robot.len()],
        })
    }

    /// Shows what is new.
    pub(crate) fn show(&mut self, seen: Seen) {
        self.bar.inc(seen.done);
        self.phases[seen.robot] = seen.phase;
        let robots = self.names.iter().zip(&self.phases);
        let message: Vec<_> = robots
            .map(|(name, phase)| format!("{name}: {phase:?}"))
            .collect();
        self.bar.set_message(message.join(", "));
    }

    /// Takes the bar away.
    pub(crate) fn finish(self) {
        self.bar.finish_and_clear();
    }
}

/// The failure of an instruction, in the words of the cell.
fn describe(file: &CellFile, robot: usize, error: &EcpError) -> FaultReport {
    match error {
        EcpError::Servo(fault) => describe_fault(file, robot, fault),
        error => FaultReport {
            robot: Some(file.cell.robot[robot].name.clone()),
            axis: None,
            what: file.cell.robot[robot].naming_axes(error),
        },
    }
}

fn describe_fault(file: &CellFile, robot: usize, fault: &ServoFault) -> FaultReport {
    let name = Some(file.cell.robot[robot].name.clone());
    let axis = fault.axis.map(usize::from);
    // Those of the bus are faults of every axis on it.
    let of_bus = match fault.cause {
        StopCause::Drive(Fault::Port(error)) => Some(error.to_string()),
        StopCause::Drive(Fault::OtherController { sign }) => {
            Some(format!("another controller is at work: it sent {sign}"))
        }
        _ => None,
    };
    if let Some((what, axis)) = of_bus.zip(axis) {
        let bus = &file.cell.robot[robot].axis[axis].bus;
        return FaultReport {
            robot: name,
            axis: None,
            what: format!("bus {bus}: {what}"),
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
