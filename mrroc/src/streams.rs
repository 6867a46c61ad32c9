//! Standard output and standard error. All that is printed goes through here: a reader that has gone, such as `head`,
//! has had what it wanted, and is no failure, where `println!` would panic.

use std::fmt::Display;
use std::io::{ErrorKind, Write as _, stderr, stdout};
use std::process::ExitCode;

use anyhow::Context;
use serde::Serialize;

/// Prints a text as it is.
pub fn print(text: impl Display) -> anyhow::Result<ExitCode> {
    write(text).map(|_| ExitCode::SUCCESS)
}

/// Prints a line; whether anybody still reads.
pub fn say(line: impl Display) -> anyhow::Result<bool> {
    write(format_args!("{line}\n"))
}

/// Prints an answer for a person, or as one JSON object in one line.
pub fn answer(answer: &(impl Serialize + Display), json: bool) -> anyhow::Result<ExitCode> {
    let text = if json {
        serde_json::to_string(answer)?
    } else {
        answer.to_string()
    };
    say(text.trim_end_matches('\n')).map(|_| ExitCode::SUCCESS)
}

/// Says what is no answer on standard error; without that there is nobody to be told.
pub fn warn(line: impl Display) {
    let _ = writeln!(stderr(), "{line}");
}

/// Says why a command was refused, in one line. The reason may quote a file: nothing of it acts on a terminal.
pub fn refuse(refusal: &anyhow::Error) {
    let said = crate::cell::printable(&format!("{refusal:#}"));
    warn(format_args!("mrroc: {said}"));
}

fn write(text: impl Display) -> anyhow::Result<bool> {
    match stdout().write_fmt(format_args!("{text}")) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(error).context("standard output"),
    }
}
