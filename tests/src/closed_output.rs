//! Commands whose output nobody reads.

use std::ffi::{OsStr, OsString};
use std::io;
use std::process::{Command, Stdio};

use crate::mrroc::{binary, mrroc};

/// Asserts that commands end with the same status and the same messages if a reader closes the output early, as `head`
/// does. A case is words and a file.
pub fn ends_as_ever(cases: &[(&str, Option<&OsStr>)]) {
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
            assert_eq!(unheard.status, heard.status, "{arguments:?}: {unheard:?}");
            let said = String::from_utf8_lossy(&unheard.stderr);
            let expected = if both { "" } else { &heard.stderr };
            assert_eq!(said, expected, "{arguments:?}");
        }
    }
}
