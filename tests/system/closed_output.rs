//! A reader that closes the output early, such as `head`, does not make a command fail.

use std::ffi::{OsStr, OsString};
use std::io;
use std::process::{Command, Stdio};

use crate::mrroc::{Directory, binary, mrroc, shorten};

#[test]
fn a_command_ends_as_ever_where_nobody_reads_what_it_prints() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let nowhere = directory.path("nowhere.toml");
    let cases: [(&str, Option<&OsStr>); 18] = [
        ("check", Some(cell.as_os_str())),
        ("check --json", Some(cell.as_os_str())),
        ("check", Some(nowhere.as_os_str())),
        ("run --bench=lockstep", Some(cell.as_os_str())),
        ("run --bench=lockstep --json", Some(cell.as_os_str())),
        ("doctor", Some(cell.as_os_str())),
        ("doctor --json", Some(cell.as_os_str())),
        ("jitter --duration=1s", None),
        ("jitter --duration=1s --json", None),
        ("kinematics limits --robot=irb6", None),
        ("kinematics limits --robot=irb6 --json", None),
        ("datasheet --robot=polycrank", None),
        ("datasheet --robot=polycrank --figure", None),
        ("urdf --robot=irb6", None),
        ("schema", None),
        ("vm", None),
        ("run --help", None),
        ("--version", None),
    ];
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
