//! The fault table as a page in Markdown.

use std::collections::BTreeMap;
use std::fmt::{self, Display, Write as _};
use std::time::Duration;

use super::bounds::SmallestSteps;
use super::{FaultTable, Row};
use mrroc::report::counted;

/// How to read the table.
const HEAD: &str = "A fault strikes the first axis of a robot; in rows of homing, the axis that homes first. A brake \
that does not hold is a fault of all axes; missed deadlines and an emergency stop are faults of the whole cell. \
Times count from the fault. The distance is that of the joint from the fault to standstill, measured at the emulated \
plant, of the axis that comes nearest to its bound. The bound is behind the distance. A row with a mark ✗ is red.";

/// How to read the smallest steps.
const STEPS: &str = "The plausibility check finds steps of a counter from this size on, as an angle of the motor. The size is \
that in the first answer after the step, when the loop may have taken back a part of it.\n\n\
| axis | at rest | at `max_velocity` |\n|---|---|---|";

impl FaultTable {
    /// The red rows.
    pub fn red(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| row.is_red())
    }

    /// Number of rows that were played.
    pub fn played(&self) -> usize {
        self.rows.iter().filter(|row| row.result.is_some()).count()
    }

    /// The page, with all rows and the red ones first, or with the worst phase of each fault and robot.
    pub fn page(&self, summary: bool) -> String {
        let mut page = format!("# Fault table of the cell {}\n\n{HEAD}\n\n", self.cell);
        for detector in &self.without {
            let _ = writeln!(page, "The detector \u{201c}{}\u{201d} was off.\n", detector.name());
        }
        let _ = writeln!(page, "{self}.\n");
        let red: Vec<_> = self.red().collect();
        if !red.is_empty() && !summary {
            let _ = writeln!(page, "## Red rows\n\n{TITLES}");
            for row in red {
                let _ = writeln!(page, "{}", line(row));
            }
            page.push('\n');
        }
        let _ = writeln!(page, "## {}\n\n{TITLES}", if summary { "Worst phases" } else { "All rows" });
        if summary {
            for row in self.worst() {
                let _ = writeln!(page, "{}", line(row));
            }
        } else {
            for row in &self.rows {
                let _ = writeln!(page, "{}", line(row));
            }
        }
        if !self.steps.is_empty() {
            let _ = writeln!(page, "\n## Smallest steps of the counters\n\n{STEPS}");
        }
        for SmallestSteps { axis, at_rest, at_max_velocity } in &self.steps {
            let _ = writeln!(page, "| {axis} | {at_rest:.3} rad | {at_max_velocity:.3} rad |");
        }
        page
    }

    /// The worst row of each fault and robot: a red one, or the one with the greatest share of its bound.
    fn worst(&self) -> Vec<&Row> {
        let mut groups = BTreeMap::<(usize, &str), Vec<&Row>>::new();
        let mut faults = Vec::new();
        for row in self.rows.iter().filter(|row| row.result.is_some()) {
            if faults.last() != Some(&row.fault) {
                faults.push(row.fault);
            }
            groups.entry((faults.len(), &row.robot)).or_default().push(row);
        }
        let badness = |row: &&Row| {
            let share =
                row.result.as_ref().filter(|it| it.detection.is_some()).map_or(0.0, |it| it.distance / it.bound);
            share + if row.is_red() { 1e6 } else { 0.0 }
        };
        let worst = |rows: Vec<_>| rows.into_iter().max_by(|one, other| badness(one).total_cmp(&badness(other)));
        groups.into_values().filter_map(worst).collect()
    }
}

impl Display for FaultTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tolerated = self.rows.iter().filter(|row| row.is_tolerated() && !row.is_red()).count();
        let (played, red) = (self.played(), self.red().count());
        let stopped = played - tolerated - red;
        let rows = counted(played, "row");
        write!(f, "{rows}: {stopped} stopped within their bounds, {tolerated} tolerated, {red} red; ")?;
        write!(f, "{} without a meaning", self.rows.len() - played)
    }
}

const TITLES: &str = "| fault | robot | phase | detected by | after | stop | at rest after | distance (bound) | brought back by |\n\
|---|---|---|---|---|---|---|---|---|";

fn line(row: &Row) -> String {
    let Row { fault, robot, reasons, result, phase } = row;
    let phase = phase.name();
    let Some(result) = result else {
        return format!("| {fault} | {robot} | {phase} | — ({}) | | | | | |", reasons.join(", "));
    };
    let mark = if row.is_red() { format!("✗ {}: ", reasons.join(", ")) } else { String::new() };
    let Some(detection) = result.detection else {
        let verdict = if row.is_red() { "nothing" } else { "tolerated" };
        return format!("| {fault} | {robot} | {phase} | {mark}{verdict} | | | | | |");
    };
    let detector = result.detector.map_or("no detector of the table", |detector| detector.name());
    let category = result.category.map_or_else(|| "—".to_owned(), |category| category.to_string());
    let still = result.still_after.map_or_else(|| "never".to_owned(), milliseconds);
    let unit = if result.linear { "mm" } else { "°" };
    let space = if result.linear { " " } else { "" };
    let (distance, bound) = (result.distance, result.bound);
    format!(
        "| {fault} | {robot} | {phase} | {mark}{detector} | {} | {category} | {still} | {distance:.2}{space}{unit} \
         ({bound:.2}) | {} |",
        milliseconds(detection),
        result.recovery
    )
}

fn milliseconds(time: Duration) -> String {
    format!("{} ms", time.as_millis())
}
