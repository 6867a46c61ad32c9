//! Commands whose output nobody reads.

use std::ffi::{OsStr, OsString};
use std::io;
use std::process::{Command, Stdio};

use crate::mrroc::{binary, mrroc};

/// Message of a command whose answer was lost.
const LOST: &str = "mrroc: the answer cannot be printed: standard output is closed\n";

/// Asserts that commands end with status 1 and a message if a reader closes the output before the answer. A command that
/// fails keeps its status. A case consists of arguments and a file.
pub fn is_an_error(cases: &[(&str, Option<&OsStr>)]) {
    ends(cases, true);
}

/// Asserts that commands end with the same status and the same messages if a reader closes the output early, as `head`
/// does. A case consists of arguments and a file.
pub fn ends_as_ever(cases: &[(&str, Option<&OsStr>)]) {
    ends(cases, false);
}

fn ends(cases: &[(&str, Option<&OsStr>)], is_lost: bool) {
    for (words, file) in cases {
        let words = words.split(' ').map(OsString::from);
        let arguments: Vec<_> = words.chain(file.map(OsStr::to_owned)).collect();
        let heard = mrroc(&arguments);
        for both in [false, true] {
            // The other end of the pipe is closed before the first byte.
            let unread = || Stdio::from(io::pipe().expect("a pipe can be made").1);
            let unheard = Command::new(binary())
                .args(&arguments)
                .stdin(Stdio::null())
                .stdout(unread())
                .stderr(if both { unread() } else { Stdio::piped() })
                .output()
                .expect("mrroc starts");
            let lost = is_lost && !heard.stdout.is_empty();
            let status = if lost && heard.status.success() { Some(1) } else { heard.status.code() };
            assert_eq!(unheard.status.code(), status, "{arguments:?}: {unheard:?}");
            let said = String::from_utf8_lossy(&unheard.stderr);
            let expected = heard.stderr.clone() + if lost { LOST } else { "" };
            let expected = if both { "" } else { &expected };
            assert_eq!(said, expected, "{arguments:?}");
        }
    }
}
