//! The fault table of a cell.

mod catalogue;
mod detector;
mod phase;
mod stage;

pub use detector::Detector;
pub use phase::FaultPhase;

use crate::cell::CellFile;
use crate::scenario::FaultKind;
use catalogue::{CASES, FaultCase, Wire};

/// Raw output for calibration.
pub fn raw(file: &CellFile) -> anyhow::Result<()> {
    let only = std::env::var("ONLY").unwrap_or_default();
    for robot in 0..file.cell.robot.len() {
        let partner = (robot + 1) % file.cell.robot.len();
        for kind in FaultKind::ALL {
            if !only.is_empty() && !only.split(',').any(|it| it == kind.name() || it == file.cell.robot[robot].name) {
                continue;
            }
            for phase in FaultPhase::ALL {
                let robots: &[usize] = if phase == FaultPhase::Team { &[robot, partner] } else { &[robot] };
                let mut reduced = file.with_robots(robots);
                if phase != FaultPhase::Homing {
                    for (robot, arm) in reduced.cell.robot.iter_mut().zip(&reduced.arms) {
                        for (number, axis) in robot.axis.iter_mut().enumerate() {
                            axis.emulator.start = Some(arm.robot().home()[number]);
                            if axis.drive.is_some() {
                                axis.homing.method = Some(37);
                            }
                        }
                    }
                }
                let wire = if reduced.cell.robot[0].axis[0].drive.is_some() { Wire::Can } else { Wire::Serial };
                let case = FaultCase { kind, ..CASES[0] };
                let case = FaultCase { count: None, wires: &[Wire::Can], ..case };
                let begun = std::time::Duration::ZERO;
                let _ = (wire, begun);
                let played = stage::play(&reduced, &case, phase, 0, None);
                let text = match played {
                    Ok(it) => {
                        let o = it.observation;
                        format!(
                            "{:?} cat {:?} still {:?} dist {:.2} v {:.1} done {} {:?}",
                            o.detected.map(|(at, fault)| (at, fault.to_string())),
                            o.category,
                            o.still_after,
                            o.distances.iter().fold(0.0_f64, |a, b| a.max(*b)),
                            it.velocity[0],
                            o.completed,
                            o.recovery
                        )
                    }
                    Err(error) => format!("ERR {error:#}"),
                };
                println!("{} {} {}: {text}", file.cell.robot[robot].name, kind.name(), phase.name());
            }
        }
    }
    Ok(())
}
