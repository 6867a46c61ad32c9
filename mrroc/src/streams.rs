//! Standard output and standard error. All output passes through this module. A reader that closes the output, such as
//! `head`, ends no command early, whereas `println!` would panic. The command completes its work, and then
//! [`exit_status`] reports the loss.
//!
//! Lines may contain foreign names and texts: of interfaces, of nodes, of files. A control character in such a text
//! has no effect on the terminal and is shown as `\u001b`, which is also valid in JSON.

use std::fmt::Display;
use std::io::{ErrorKind, Write as _, stderr, stdout};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use serde::Serialize;

/// Reason of a lost answer: the reader has closed standard output.
pub(crate) const CLOSED: &str = "standard output is closed";

/// Whether the reader closed standard output before the last byte. A process has one standard output.
static LOST: AtomicBool = AtomicBool::new(false);

/// Prints a text without a line end.
pub fn print(text: impl Display) -> anyhow::Result<ExitCode> {
    write(text).map(|_| ExitCode::SUCCESS)
}

/// Prints a line, and returns whether the reader is still open.
pub fn say(line: impl Display) -> anyhow::Result<bool> {
    write(format_args!("{}\n", plain(line)))
}

/// The exit status of a command. If the reader closed standard output before the end of the answer, a message is
/// printed, and the exit status is 1 in place of 0.
pub fn exit_status(status: ExitCode) -> ExitCode {
    if !LOST.load(Ordering::Relaxed) {
        return status;
    }
    warn(format_args!("mrroc: the answer cannot be printed: {CLOSED}"));
    if status == ExitCode::SUCCESS { ExitCode::from(1) } else { status }
}

/// Prints an answer as text, or as one JSON object in one line.
pub fn answer(answer: &(impl Serialize + Display), json: bool) -> anyhow::Result<ExitCode> {
    answered(answer, json).map(|_| ExitCode::SUCCESS)
}

/// Prints like [`answer`], and returns whether the reader was still open.
pub fn answered(answer: &(impl Serialize + Display), json: bool) -> anyhow::Result<bool> {
    let text = if json { serde_json::to_string(answer)? } else { answer.to_string() };
    say(text.trim_end_matches('\n'))
}

/// Prints a message to standard error. A failure is ignored, because no other output is left.
pub fn warn(line: impl Display) {
    let _ = writeln!(stderr(), "{}", plain(line));
}

/// Shows the control characters of a text, except line ends and tabulators.
pub fn plain(text: impl Display) -> String {
    let mut shown = String::new();
    for character in text.to_string().chars() {
        match character {
            '\n' | '\t' => shown.push(character),
            _ if character.is_control() => shown += &format!("\\u{:04x}", u32::from(character)),
            _ => shown.push(character),
        }
    }
    shown
}

/// Prints why a command was refused, in one line. Text quoted from a file has no effect on the terminal.
pub fn refuse(refusal: &anyhow::Error) {
    warn(format_args!("mrroc: {}", crate::cell::printable(&format!("{refusal:#}"))));
}

fn write(text: impl Display) -> anyhow::Result<bool> {
    match stdout().write_fmt(format_args!("{text}")) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => {
            LOST.store(true, Ordering::Relaxed);
            Ok(false)
        }
        Err(error) => Err(error).context("standard output"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_of_others_is_a_command_to_the_terminal() {
        let table = [
            ("two\nlines\tand a µ", "two\nlines\tand a µ"),
            ("can\u{1b}[2J", "can\\u001b[2J"),
            ("\u{9b}2J\r\u{7f}\0", "\\u009b2J\\u000d\\u007f\\u0000"),
        ];
        for (text, shown) in table {
            assert_eq!(plain(text), shown);
        }
        let json = serde_json::to_string("\u{1b}\u{9b}").unwrap();
        let read: String = serde_json::from_str(&plain(json)).unwrap();
        assert_eq!(read, "\u{1b}\u{9b}");
    }
}
