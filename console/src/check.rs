//! `mrroc check` and `mrroc schema`.

use std::path::Path;
use std::process::ExitCode;

use controller::cell::Cell;
use serde::Serialize;

use crate::budget::{self, BusBudget};
use crate::cell_file::CellFile;
use crate::rehearsal;

/// What a check found, where nothing is wrong.
#[derive(Serialize)]
struct Checked {
    cell: String,
    period_us: u32,
    robots: Vec<CheckedRobot>,
    /// How long the programs take without homing, s.
    program_s: f64,
    buses: Vec<BusBudget>,
}

#[derive(Serialize)]
struct CheckedRobot {
    name: String,
    axes: usize,
    instructions: usize,
    configurations: Vec<CheckedConfiguration>,
}

/// What a device configuration file asks for.
#[derive(Serialize)]
struct CheckedConfiguration {
    axis: String,
    file: String,
    writes: usize,
    /// Values that the file only notes.
    left_out: usize,
}

/// Checks a cell file, its programs and its buses.
pub(crate) fn check(path: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let file = CellFile::read(path)?;
    let buses = budget::check(&file)?;
    let program = rehearsal::rehearse(&file)?;
    let robots = file.cell.robot.iter().enumerate();
    let robots = robots.map(|(number, robot)| CheckedRobot {
        name: robot.name.clone(),
        axes: robot.axis.len(),
        instructions: robot.program.len(),
        configurations: configurations(&file, number),
    });
    let checked = Checked {
        cell: file.cell.name.clone(),
        period_us: file.cell.period_us,
        robots: robots.collect(),
        program_s: program.as_secs_f64(),
        buses,
    };
    if json {
        println!("{}", serde_json::to_string(&checked)?);
    } else {
        print(&checked);
    }
    Ok(ExitCode::SUCCESS)
}

fn configurations(file: &CellFile, robot: usize) -> Vec<CheckedConfiguration> {
    let axes = file.cell.robot[robot].axis.iter().enumerate();
    let configured = axes.filter_map(|(number, axis)| {
        let configuration = file.configuration(robot, number)?;
        Some(CheckedConfiguration {
            axis: axis.name.clone(),
            file: configuration.path.display().to_string(),
            writes: configuration.download.writes.len(),
            left_out: configuration.download.left_out,
        })
    });
    configured.collect()
}

fn print(checked: &Checked) {
    for robot in &checked.robots {
        println!(
            "robot {}: {} axes, {} instructions",
            robot.name, robot.axes, robot.instructions
        );
        for configured in &robot.configurations {
            println!(
                "  axis {}: {} asks for {} writes and notes {} values more",
                configured.axis, configured.file, configured.writes, configured.left_out
            );
        }
    }
    println!("programs take {:.1} s after homing", checked.program_s);
    for bus in &checked.buses {
        println!(
            "\nbus {}: load {:.1} %, the last frame of a cycle has left after {:.1} % of {} µs at the worst",
            bus.name, bus.load_percent, bus.worst_case_percent, checked.period_us
        );
        println!(
            "  {:16} {:>6} {:>5} {:>10} {:>11}",
            "frame", "id", "bytes", "every µs", "response µs"
        );
        for message in &bus.messages {
            let response = message
                .response_us
                .map_or("-".to_owned(), |response| response.to_string());
            let id = message
                .cob_id
                .map_or("-".to_owned(), |id| format!("{id:#x}"));
            println!(
                "  {:16} {id:>6} {:>5} {:>10} {response:>11}",
                message.what, message.bytes, message.period_us
            );
        }
    }
    println!("\n{} is ready", checked.cell);
}

/// Prints the JSON schema of cell files.
pub(crate) fn schema() -> anyhow::Result<ExitCode> {
    println!("{}", serde_json::to_string_pretty(&Cell::schema())?);
    Ok(ExitCode::SUCCESS)
}
