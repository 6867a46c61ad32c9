//! How the position loops of a robot are closed, and how well.

use std::fmt::Write as _;

use controller::cell::Parameters;

/// A loop: where it is found, how it is closed, its crossover in Hz, its phase margin in degrees or what else is seen.
type Loop = [&'static str; 4];

/// The loop that a CiA 402 drive closes.
const BY_DRIVE: &str = "by the drive (CSP): emulated with a velocity loop at 45 Hz and a position loop at a fifth of it";
const UNSEEN: &str = "not seen from outside";

/// The section of a data sheet; its figures are those that `mrroc identify` prints.
pub(super) fn section(page: &mut String, parameters: &Parameters) {
    let (loops, example) = loops(parameters);
    let _ = write!(
        page,
        "## Loop\n\nEmulated with nominal motors, at 10 rad/s of the motor and a period of 2 ms; as \
         `mrroc identify {example}` measures it.\n\n\
         | axes | position loop | crossover, Hz | phase margin, or command to sample |\n|---|---|---|---|\n"
    );
    for [axes, closed, crossover, margin] in loops {
        let _ = writeln!(page, "| {axes} | {closed} | {crossover} | {margin} |");
    }
    page.push('\n');
}

/// The loops, and the arguments that measure one of them.
fn loops(parameters: &Parameters) -> (Vec<Loop>, &'static str) {
    match parameters {
        Parameters::Irb6(_) => (
            vec![
                [
                    "`cells/irb6-serial.toml`, by current (figures: column)",
                    "by the servo: cascade, 25 / s, 100 J / s, 10 / s, delay 2",
                    "16.8",
                    "48.3°",
                ],
                [
                    "`cells/irb6-serial.toml`, wrist roll, by pulse width",
                    "by the servo: the same per duty, integral at the motor's pole, delay 2",
                    "15.7",
                    "51.6°",
                ],
                [
                    "`cells/irb6.toml`",
                    BY_DRIVE,
                    UNSEEN,
                    "less than 3 dB lost up to 100 Hz, 6.0 dB gained at most",
                ],
            ],
            "cells/irb6-serial.toml --axis column",
        ),
        Parameters::Irp6(_) => (
            vec![
                [
                    "`cells/irp6.toml`",
                    BY_DRIVE,
                    UNSEEN,
                    "less than 3 dB lost up to 100 Hz, 5.8 dB gained at most",
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
                "`cells/irp6-track.toml`",
                BY_DRIVE,
                UNSEEN,
                "less than 3 dB lost up to 100 Hz, 7.4 dB gained at most",
            ]],
            "cells/irp6-track.toml --axis track",
        ),
        Parameters::Rnt(_) => (
            vec![
                [
                    "`cells/rnt.toml`, by velocity (CSV; figures: first leg)",
                    "by the servo: proportional, 50 / s, delay 3",
                    "8.4",
                    "82.3°",
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
                "`cells/polycrank.toml`",
                BY_DRIVE,
                UNSEEN,
                "less than 3 dB lost up to 100 Hz, 5.9 dB gained at most",
            ]],
            "cells/polycrank.toml --axis q1",
        ),
        Parameters::Gripper(_) => (
            vec![[
                "`cells/lab.toml`",
                BY_DRIVE,
                UNSEEN,
                "not seen either: the excitation that its acceleration allows is below a count, 0.049 rad",
            ]],
            "cells/lab.toml --axis jaws",
        ),
        Parameters::Conveyor(_) => (
            vec![[
                "`cells/lab.toml`",
                BY_DRIVE,
                UNSEEN,
                "less than 3 dB lost up to 100 Hz, 6.9 dB gained at most",
            ]],
            "cells/lab.toml --axis belt",
        ),
    }
}
