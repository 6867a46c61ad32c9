//! Output of help, version and one-line error messages for invalid arguments.

use std::process::ExitCode;

use clap::{Error, error::ErrorKind};

/// Prints help, the version or a one-line error. Returns exit status 0 for requested help or version, otherwise 2.
pub(crate) fn answer(error: &Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // A write error is ignored: a reader such as `head` may have closed the pipe.
            let _ = error.print();
            ExitCode::SUCCESS
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(2)
        }
        _ => {
            mrroc::streams::warn(format_args!("mrroc: {}", line(&error.to_string())));
            ExitCode::from(2)
        }
    }
}

/// Joins the lines of an error message of `clap`: the error, a suggestion and the usage.
fn line(message: &str) -> String {
    let mut said = String::new();
    for part in message.lines().map(str::trim) {
        let part = part.strip_prefix("error: ").unwrap_or(part);
        if part.is_empty() {
            continue;
        }
        if said.ends_with(':') {
            said.push(' ');
        } else if !said.is_empty() {
            said.push_str("; ");
        }
        match part {
            "For more information, try '--help'." => said.push_str("see '--help'"),
            part => said.push_str(&part.replacen("Usage:", "usage:", 1)),
        }
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_is_one_line_with_every_part_of_the_message() {
        let message = "error: the following required arguments were not provided:\n  --robot <ROBOT>\n  --joints <JOINTS>\n\n\
                       Usage: mrroc kinematics fk --robot <ROBOT>\n\nFor more information, try '--help'.\n";
        let expected = "the following required arguments were not provided: --robot <ROBOT>; --joints <JOINTS>; \
                        usage: mrroc kinematics fk --robot <ROBOT>; see '--help'";
        assert_eq!(line(message), expected);
    }
}
