//! Standard output for what another program may read.

use std::fmt::Display;
use std::io::{ErrorKind, Write as _};
use std::process::ExitCode;

/// Prints a text as it is; a reader that has gone, such as `head`, has had what it wanted.
pub(crate) fn print(text: impl Display) -> anyhow::Result<ExitCode> {
    match std::io::stdout().write_fmt(format_args!("{text}")) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(ExitCode::SUCCESS),
        written => Ok(written.map(|()| ExitCode::SUCCESS)?),
    }
}
