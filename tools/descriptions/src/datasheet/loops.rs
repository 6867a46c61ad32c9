//! Position loops of a robot: their structure, crossover frequency and phase margin.

use std::fmt::Write as _;

use mrroc::cell::Parameters;

/// A loop: axes, structure, crossover frequency in Hz, phase margin in degrees.
type Loop = [&'static str; 4];

/// The loop that a CiA 402 drive closes.
const BY_DRIVE: &str = "by the drive (CSP): emulated with a velocity loop at 45 Hz and a position loop at a fifth of it; cut open at the torque";

/// Section of a data sheet. Its figures are the results of `mrroc identify`.
pub(super) fn section(page: &mut String, parameters: &Parameters) {
    let (loops, example) = loops(parameters);
    let _ = write!(
        page,
        "## Loop\n\nEmulated with nominal motors, at 10 rad/s of the motor and a period of 2 ms; as \
         `mrroc identify {example}` measures it.\n\n\
         | axes | position loop | crossover, Hz | phase margin |\n|---|---|---|---|\n"
    );
    for [axes, closed, crossover, margin] in loops {
        let _ = writeln!(page, "| {axes} | {closed} | {crossover} | {margin} |");
    }
    page.push('\n');
}

/// The loops, and the arguments of the command that measures one of them.
fn loops(parameters: &Parameters) -> (Vec<Loop>, &'static str) {
    match parameters {
        Parameters::Irb6(_) => (
            vec![
                [
                    "`cells/irb6-serial.toml`, column to wrist pitch, by current",
                    "by the servo: cascade, 25 / s, 100 J / s, 10 / s, delay 2",
                    "16.8, 17.2, 15.0, 17.6",
                    "48.2°, 47.5°, 48.0°, 48.1°",
                ],
                [
                    "`cells/irb6-serial.toml`, wrist roll, by pulse width",
                    "by the servo: the same per duty, integral at the motor's pole, delay 2",
                    "15.7",
                    "51.6°",
                ],
                [
                    "`cells/irb6.toml`, axis by axis",
                    BY_DRIVE,
                    "46.4, 48.6, 40.4, 48.9, 52.0",
                    "35.6°, 37.4°, 38.9°, 37.7°, 40.6°",
                ],
            ],
            "cells/irb6-serial.toml --axis column",
        ),
        Parameters::Irp6(_) => (
            vec![
                [
                    "`cells/irp6.toml`, axis by axis",
                    BY_DRIVE,
                    "46.4, 48.4, 41.3, 46.7, 44.3, 43.9",
                    "36.7°, 37.9°, 40.3°, 39.3°, 40.7°, 43.0°",
                ],
                [
                    "its own law on serial lines, by current; axis by axis",
                    "by the servo: incremental law, delay 1",
                    "53.6, 22.9, 34.8, 21.9, 74.6, 7.3",
                    "47.7°, 78.1°, 77.5°, 82.3°, 8.4°, 52.9°",
                ],
            ],
            "cells/irp6.toml --axis column",
        ),
        Parameters::Irp6Track(_) => (
            vec![[
                "`cells/irp6-track.toml`, axis by axis",
                BY_DRIVE,
                "45.7, 45.7, 47.8, 41.1, 45.6, 44.3, 43.9",
                "37.8°, 36.4°, 37.3°, 39.4°, 39.5°, 40.6°, 43.1°",
            ]],
            "cells/irp6-track.toml --axis track",
        ),
        Parameters::Rnt(_) => (
            vec![
                [
                    "`cells/rnt.toml`, by velocity (CSV), axis by axis",
                    "by the servo: proportional, 50 / s, delay 3",
                    "8.4, 8.6, 8.3, 8.6, 8.5, 8.4",
                    "82.3°, 83.0°, 81.5°, 81.1°, 81.9°, 83.1°",
                ],
                [
                    "by torque (CST) instead (figures: column of an IRb-6 so driven)",
                    "by the servo: cascade, two thirds of the gains of the IRb-6, delay 3",
                    "11.2",
                    "47.5°",
                ],
            ],
            "cells/rnt.toml --axis leg-1",
        ),
        Parameters::Polycrank(_) => (
            vec![[
                "`cells/polycrank.toml`, axis by axis",
                BY_DRIVE,
                "42.5, 68.7, 60.9, 59.3, 45.1, 45.3, 45.7",
                "41.6°, 36.5°, 41.0°, 35.0°, 40.1°, 41.9°, 39.5°",
            ]],
            "cells/polycrank.toml --axis q1",
        ),
        Parameters::Gripper(_) => (
            vec![[
                "`cells/lab.toml`",
                BY_DRIVE,
                "48.9",
                "38.8°, roughly: at 98 rad/s and by `--periods 12`, with a coherence of 0.85; its encoder has 128 counts a turn",
            ]],
            "cells/lab.toml --axis jaws",
        ),
        Parameters::Conveyor(_) => (
            vec![["`cells/lab.toml`", BY_DRIVE, "45.9", "39.1°"]],
            "cells/lab.toml --axis belt",
        ),
    }
}
