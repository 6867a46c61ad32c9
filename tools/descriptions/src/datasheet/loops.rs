//! Position loops of a robot: their structure, crossover frequency and phase margin.

use std::fmt::Write as _;

use mrroc::cell::Parameters;

use crate::robots::described;

/// A loop: axes, structure, crossover frequency in Hz, phase margin in degrees.
pub(crate) type Loop = [&'static str; 4];

/// The loop that a CiA 402 drive closes.
pub(crate) const BY_DRIVE: &str = "by the drive (CSP): emulated with a velocity loop at 45 Hz and a position loop at a fifth of it; cut open at the torque";

/// Section of a data sheet. Its figures are the results of `mrroc identify`.
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
