//! The `mrroc` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    mrroc_console::main(&mrroc::Extension::new())
}
