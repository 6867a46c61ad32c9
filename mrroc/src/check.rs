//! Check of a cell: finds everything that a run would refuse, before anything moves.

use std::fmt;
use std::sync::Arc;

use controller::robot::Chain;
use controller::sensor::OperatorLink;
use serde::Serialize;
use servo::Servo;

use crate::bench::emulation::{self, Emulation};
use crate::bench::{BenchKind, emulated_lines, emulated_sensors};
use crate::budget::{self, Bundle, BusBudget, MessageBudget, SensorBudget};
use crate::cell::{CellFile, IoNode, Parameters, printable};
use crate::rehearsal::{self, Rehearsed};
use crate::report::{ConfigurationReport, counted};
use crate::{run::RunningTask, setup, tasks::Program};

/// The result of a successful check.
#[derive(Debug, Serialize)]
pub struct CheckReport {
    cell: String,
    period_us: u32,
    robots: Vec<CheckedRobot>,
    /// Duration of the task without homing, s; null if only the rehearsal with the scene came to its end.
    program_s: Option<f64>,
    /// Duration of the rehearsal with the scene, with homing, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    with_scene_s: Option<f64>,
    buses: Vec<BusBudget>,
    io: Vec<CheckedIo>,
    /// Functions that the cell needs and its emulation lacks. Real robots may have them.
    pub problems: Vec<String>,
    /// Flaws of device configuration files, and axes that the task overloads by nominal masses or limits.
    pub warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
struct CheckedRobot {
    name: String,
    axes: usize,
    instructions: usize,
    /// What is special about an arm of the key `chain`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    chain: Vec<String>,
    configurations: Vec<ConfigurationReport>,
}

#[derive(Debug, Serialize)]
struct CheckedIo {
    name: String,
    bus: String,
    node: u8,
    inputs: Vec<String>,
    outputs: Vec<String>,
}

impl CheckedIo {
    fn of(io: &IoNode) -> Self {
        Self {
            name: io.name.clone(),
            bus: io.bus.clone(),
            node: io.node,
            inputs: io.input.iter().map(|input| input.name.clone()).collect(),
            outputs: io.output.iter().map(|output| output.name.clone()).collect(),
        }
    }
}

/// Checks a cell with a task: rehearses the task, computes the load of the buses, and creates all parts of a run. The
/// run is taken to have an operator.
pub fn check(file: &CellFile, program: &Program) -> anyhow::Result<CheckReport> {
    check_by(file, program, rehearsal::rehearse)
}

/// Checks a cell as [`check`] does, and rehearses the task with the emulated scene too.
pub fn check_with_scene(file: &CellFile, program: &Program) -> anyhow::Result<CheckReport> {
    check_by(file, program, |file, program| rehearsal::rehearse_with_scene(file, program, &Arc::default()))
}

fn check_by(
    file: &CellFile,
    program: &Program,
    rehearse: impl FnOnce(&CellFile, &Program) -> anyhow::Result<Rehearsed>,
) -> anyhow::Result<CheckReport> {
    let file = &file.for_one_run();
    let program = &program.clone().with_operator(OperatorLink::new(1).0);
    let buses = budget::check(file)?;
    let rehearsed = rehearse(file, program)?;
    let warnings = file.configuration_warnings().chain(rehearsed.overloads(file)?).collect();
    assemble(file, program, &rehearsed)?;
    let robots = file.cell.robot.iter().enumerate().map(|(number, robot)| CheckedRobot {
        name: robot.name.clone(),
        axes: robot.axis.len(),
        instructions: robot.program.len(),
        chain: chain(&robot.numbers()),
        configurations: configurations(file, number),
    });
    Ok(CheckReport {
        cell: file.cell.name.clone(),
        period_us: file.cell.period_us,
        robots: robots.collect(),
        program_s: rehearsed.duration.map(|duration| duration.as_secs_f64()),
        with_scene_s: rehearsed.with_scene.map(|duration| duration.as_secs_f64()),
        buses,
        io: file.cell.io.iter().map(CheckedIo::of).collect(),
        problems: emulation::problems(file).map(|problem| problem.to_string()).collect(),
        warnings,
    })
}

/// Creates all parts of a run on emulated drives, with the functions of the run.
fn assemble(file: &CellFile, program: &Program, rehearsed: &Rehearsed) -> anyhow::Result<()> {
    let (mut emulation, ends) = Emulation::of(file);
    let lines = emulated_lines(file, BenchKind::Lockstep, &mut emulation, ends.lines)?;
    let sensors = emulated_sensors(file, BenchKind::Lockstep, &mut emulation, ends.sensors)?;
    let devices = setup::devices(file, ends.ports, lines, sensors, None)?;
    let (mut servo, links) = Servo::new(&setup::servo_config(file), devices.groups)?;
    let sensors = setup::force_sensors(file, &devices.sensors, &links);
    setup::install_laws(file, &mut servo, &sensors)?;
    RunningTask::new(
        &Arc::new(file.clone()),
        program,
        links,
        (devices.io, sensors, devices.matrices, devices.own, setup::rehearsed_cameras(file)),
        &servo,
        rehearsed,
    );
    Ok(())
}

/// How the inverse kinematics of a chain works, and what the emulation of a described robot lacks.
fn chain(numbers: &Parameters) -> Vec<String> {
    let given = match numbers {
        Parameters::Chain(given) => given,
        Parameters::Own(_) if numbers.mechanism().is_none() => {
            return vec!["each emulated axis moves a load of its own, without weight".to_owned()];
        }
        _ => return Vec::new(),
    };
    let form = Chain::new(given).expect("a parsed chain is sound").closed_form();
    let inverse = match form {
        Some(form) => format!("inverse kinematics in closed form: {form}"),
        None => "inverse kinematics by a numerical search: no closed form is known for this geometry".to_owned(),
    };
    let unknown = given.joints.iter().filter(|joint| joint.body.is_none()).map(|joint| joint.name.as_str());
    let unknown: Vec<_> = unknown.collect();
    let masses = match unknown.len() {
        0 => None,
        all if all == given.joints.len() => {
            Some("no link has a mass: each emulated axis moves a load of its own, without weight".to_owned())
        }
        _ => Some(format!("links without a mass are emulated without weight: {}", unknown.join(", "))),
    };
    [inverse].into_iter().chain(masses).collect()
}

fn configurations(file: &CellFile, robot: usize) -> Vec<ConfigurationReport> {
    let axes = file.cell.robot[robot].axis.iter().enumerate();
    axes.filter_map(|(number, axis)| ConfigurationReport::of(file, robot, number, axis.name.clone())).collect()
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for robot in &self.robots {
            let (axes, instructions) = (counted(robot.axes, "axis"), counted(robot.instructions, "instruction"));
            writeln!(f, "robot {}: {axes}, {instructions}", robot.name)?;
            for said in &robot.chain {
                writeln!(f, "  {said}")?;
            }
            for configured in &robot.configurations {
                for (number, line) in configured.lines().enumerate() {
                    let indent = if number == 0 { "  " } else { "    " };
                    writeln!(f, "{indent}{line}")?;
                }
            }
        }
        for CheckedIo { name, bus, node, inputs, outputs } in &self.io {
            write!(f, "I/O node {name}: node {node} of bus {bus}")?;
            for (what, lines) in [("inputs", inputs), ("outputs", outputs)] {
                if !lines.is_empty() {
                    write!(f, "; {what} {}", lines.join(", "))?;
                }
            }
            writeln!(f)?;
        }
        if let Some(seconds) = self.program_s {
            writeln!(f, "programs take {seconds:.1} s after homing")?;
        }
        if let Some(seconds) = self.with_scene_s {
            writeln!(f, "rehearsed with the scene: {seconds:.1} s with homing")?;
        }
        for bus in &self.buses {
            self.write_bus(f, bus)?;
        }
        writeln!(f, "\n{} is ready", self.cell)
    }
}

impl CheckReport {
    fn write_bus(&self, f: &mut fmt::Formatter<'_>, bus: &BusBudget) -> fmt::Result {
        let (load, worst) = (bus.load_percent, bus.worst_case_percent);
        if let Some(SensorBudget { what, robot, line, baud, kind, samples_per_s, scan_ms }) = &bus.sensor {
            let line = printable(line);
            write!(f, "\n{what} {} of {robot}: {line} at {baud} bit/s, ", bus.name)?;
            match (scan_ms, kind) {
                (_, Some(kind)) => {
                    let rate = samples_per_s.unwrap_or_default();
                    writeln!(f, "kind {kind}, {rate:.1} samples per second at most")?;
                }
                (Some(scan), None) => writeln!(f, "a scan takes {scan:.0} ms")?,
                (None, None) => {
                    writeln!(f, "the answer has come after {worst:.1} % of {} µs at the worst", self.period_us)?;
                }
            }
            return write_messages(f, &bus.messages);
        }
        match &bus.serial {
            // A bus of I/O nodes alone, for example.
            None if bus.messages.iter().all(|message| message.response_us.is_none()) => {
                writeln!(f, "\nbus {}: load {load:.1} %, no frame is sent in every cycle", bus.name)?;
            }
            None => writeln!(
                f,
                "\nbus {}: load {load:.1} %, the last frame of a cycle has left after {worst:.1} % of {} µs at the worst",
                bus.name, self.period_us
            )?,
            Some(Bundle { protocol, baud, lines }) => {
                writeln!(
                    f,
                    "\nserial bundle {}: {} at {baud} bit/s, load {load:.1} % of each line, the answer has come after \
                     {worst:.1} % of {} µs at the worst",
                    bus.name,
                    protocol.name(),
                    self.period_us
                )?;
                for budget in lines {
                    let address = budget.address.map(|address| format!(", address {address}")).unwrap_or_default();
                    writeln!(f, "  axis {}: {}{address}", budget.axis, budget.line)?;
                }
            }
        }
        if let Some(stale) = bus.stale_after_ms {
            writeln!(f, "  no drive acts on frames that an adapter held for {stale} ms or longer")?;
        }
        write_messages(f, &bus.messages)
    }
}

fn write_messages(f: &mut fmt::Formatter<'_>, messages: &[MessageBudget]) -> fmt::Result {
    writeln!(f, "  {:16} {:>6} {:>5} {:>10} {:>11}", "frame", "id", "bytes", "every µs", "response µs")?;
    let shown = |value: Option<String>| value.unwrap_or("-".to_owned());
    for message in messages {
        let response = shown(message.response_us.map(|response| response.to_string()));
        let id = shown(message.cob_id.map(|id| format!("{id:#x}")));
        writeln!(f, "  {:16} {id:>6} {:>5} {:>10} {response:>11}", message.what, message.bytes, message.period_us)?;
    }
    Ok(())
}
