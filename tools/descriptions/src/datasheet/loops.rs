//! How the position loops of a robot are closed, and how well.

use std::fmt::Write as _;

use mrroc::cell::Parameters;

use crate::robots::described;

/// A loop: where it is found, how it is closed, its crossover in Hz, its phase margin in degrees.
pub(crate) type Loop = [&'static str; 4];

/// The loop that a CiA 402 drive closes.
pub(crate) const BY_DRIVE: &str = "by the drive (CSP): emulated with a velocity loop at 45 Hz and a position loop at a fifth of it; cut open at the torque";

/// The section of a data sheet; its figures are those that `mrroc identify` prints.
pub(super) fn section(page: &mut String, parameters: &Parameters) {
    let (loops, example) = described(parameters).loops();
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
