//! The fault table of a cell, the effect of each fault on each robot in each phase, in lockstep; and the [`soak`].
//!
//! A row is one run of one robot: bring-up, enabling, reference, a fixed motion, and a fault that strikes one axis. A
//! brake that does not hold is a fault of all axes. Missed deadlines and an emergency stop are faults of the whole cell. The
//! row ends with the detection, the stop and the recovery.
//! Distances are those of the emulated plants, which no controller reads. To save time, robots start at home with their
//! references, except in rows of homing.
//!
//! A row is red if the expected detectors do not detect the fault within its bound, or if the robot moves beyond its
//! bound. A row is also red if a fault that should be tolerated stops the robot. A second run with the same seed must
//! end in the same way, otherwise the row is red.

mod bounds;
mod catalogue;
mod detector;
mod origin;
mod page;
mod phase;
mod row;
pub mod soak;
mod stage;

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use mrroc::cell::{Cell, CellFile, Plant, Protocol};

pub use detector::Detector;
pub use phase::FaultPhase;
pub use row::Row;

use bounds::SmallestSteps;
use catalogue::{CASES, FaultCase, GRIDS, Wire};
use origin::Origin;

/// Options of `mrroc faults`.
#[derive(Args, Clone, Debug, Default)]
pub struct FaultOptions {
    /// Write the table to this file, in Markdown.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Play only these robots.
    #[arg(long, value_name = "NAME")]
    pub robot: Vec<String>,
    /// Play only these faults, by their names in the table.
    #[arg(long, value_name = "NAME")]
    pub fault: Vec<String>,
    /// Play only these phases.
    #[arg(long, value_enum)]
    pub phase: Vec<FaultPhase>,
    /// Turn a detector off, to see its rows turn red. May be given several times.
    #[arg(long, value_enum, value_name = "DETECTOR")]
    pub without: Vec<Detector>,
    /// Play each row once. Without this option, a second run must end in the same verdict.
    #[arg(long)]
    pub once: bool,
    /// Write only the worst phase of each fault and robot.
    #[arg(long)]
    pub summary: bool,
    /// Play the dense grids of delays too, whose faults begin with "grid: ".
    #[arg(long)]
    pub grids: bool,
}

/// Names of the faults of the dense grids.
pub fn grid_faults() -> impl Iterator<Item = &'static str> {
    GRIDS.into_iter().flatten().map(|case| case.name)
}

/// The rows of a cell.
#[derive(Clone, Debug)]
pub struct FaultTable {
    /// Name of the cell.
    pub cell: String,
    /// The rows, in the order of faults, robots and phases.
    pub rows: Vec<Row>,
    without: Vec<Detector>,
    /// Of the robots whose counters jump in the rows.
    steps: Vec<SmallestSteps>,
}

/// Plays all rows that the options select.
pub fn fault_table(file: &CellFile, options: &FaultOptions) -> anyhow::Result<FaultTable> {
    let cell = &file.cell;
    for name in &options.robot {
        if !cell.robot.iter().any(|robot| robot.name == *name) {
            let names: Vec<_> = cell.robot.iter().map(|robot| robot.name.as_str()).collect();
            bail!("--robot {name}: the cell has no such robot; there are {}", names.join(", "));
        }
    }
    let grids = || GRIDS.into_iter().flatten().filter(|_| options.grids);
    let cases = || CASES.iter().chain(grids());
    for name in &options.fault {
        if !cases().any(|case| case.name == name) {
            let names: Vec<_> = cases().map(|case| case.name).collect();
            bail!("--fault {name:?}: there is no such fault; there are {}", names.join(", "));
        }
    }
    let chosen = |list: &[String], name: &str| list.is_empty() || list.iter().any(|it| it == name);
    let mut rows = Vec::new();
    let mut jumping = BTreeSet::new();
    for case in cases().filter(|case| chosen(&options.fault, case.name)) {
        for (robot, _) in cell.robot.iter().enumerate().filter(|(_, robot)| chosen(&options.robot, &robot.name)) {
            let wire = wire(cell, (robot, 0));
            if !case.wires.contains(&wire) {
                continue;
            }
            if case.jump.is_some() {
                jumping.insert(robot);
            }
            for phase in FaultPhase::ALL.into_iter().filter(|it| options.phase.is_empty() || options.phase.contains(it))
            {
                rows.push(row(file, robot, case, wire, phase, options));
            }
        }
    }
    let steps = jumping.into_iter().flat_map(|robot| SmallestSteps::of(file, robot)).collect();
    Ok(FaultTable { cell: cell.name.clone(), rows, without: options.without.clone(), steps })
}

fn row(file: &CellFile, robot: usize, case: &FaultCase, wire: Wire, phase: FaultPhase, options: &FaultOptions) -> Row {
    let given = &file.cell.robot[robot];
    let name = &given.name;
    let expected = match (case.expected)(wire, phase) {
        Ok(expected) => expected,
        Err(reason) => return Row::without_meaning(case.name, name, phase, reason),
    };
    let partner = (1..file.cell.robot.len()).map(|next| (robot + next) % file.cell.robot.len()).next();
    let robots: Vec<_> = match (phase, partner) {
        (FaultPhase::Team, None) => {
            return Row::without_meaning(case.name, name, phase, "the cell has one robot");
        }
        (FaultPhase::Team, Some(partner)) => vec![robot, partner],
        _ => vec![robot],
    };
    if phase == FaultPhase::Contact && given.axis.iter().any(|axis| axis.emulator.plant == Plant::Wut) {
        return Row::without_meaning(case.name, name, phase, "the emulated motor has no contacts");
    }
    let axis = if phase == FaultPhase::Homing { first_homed(file, robot) } else { 0 };
    let in_place = |method| matches!(method, 35 | 37);
    if phase == FaultPhase::Homing && given.axis[axis].homing.method.is_some_and(in_place) {
        return Row::without_meaning(case.name, name, phase, "homing moves nothing");
    }
    let mut staged = staged(file, &robots, phase);
    if case.origin == Origin::EmergencyStop {
        origin::add_contact(&mut staged);
    }
    let play = || stage::play(&staged, case, phase, axis, &options.without);
    let played = play();
    let again = (!options.once).then(play);
    Row::judge(&staged, (case, expected), phase, axis, played, again)
}

/// The wire of an axis, given as robot and axis number.
fn wire(cell: &Cell, (robot, number): (usize, usize)) -> Wire {
    let axis = &cell.robot[robot].axis[number];
    match cell.serial.iter().find(|bundle| bundle.name == axis.bus).map(|bundle| bundle.protocol) {
        None => Wire::Can,
        Some(Protocol::Nfv2) => Wire::Nfv2,
        Some(Protocol::HiMoxa) => Wire::HiMoxa,
    }
}

/// The axis that homes first.
fn first_homed(file: &CellFile, robot: usize) -> usize {
    let orders = file.cell.robot[robot].axis.iter().map(|axis| axis.homing.order).enumerate();
    orders.min_by_key(|(_, order)| *order).map_or(0, |(axis, _)| axis)
}

/// The cell of a row: these robots alone. Except for homing, they start at home, and drives on CAN take their position
/// there as their reference.
fn staged(file: &CellFile, robots: &[usize], phase: FaultPhase) -> CellFile {
    let mut staged = file.with_robots(robots);
    if phase != FaultPhase::Homing {
        for (robot, arm) in staged.cell.robot.iter_mut().zip(&staged.arms) {
            for (number, axis) in robot.axis.iter_mut().enumerate() {
                axis.emulator.start = Some(arm.robot().home()[number]);
                if axis.drive.is_some() {
                    axis.homing.method = Some(37);
                }
            }
        }
    }
    staged
}
