//! The MCAP library for Python reads recordings.

use std::fs;
use std::process::Command;

use kit::mrroc::{self, Directory, example, mrroc};
use kit::processors;

use super::{PATIENCE, python};

#[test]
fn the_mcap_library_decodes_every_message_of_a_recording() {
    let Some(python) = python("peers::recordings::the_mcap_library_decodes_every_message_of_a_recording") else {
        return;
    };
    let _share = processors::take(0.9);
    let directory = Directory::new();
    let files = ["run.mcap", "axes.csv"].map(|name| directory.path(name));
    for file in &files {
        // Two runs in lockstep are equal.
        let arguments = ["run".into(), example("irb6").into_os_string(), "--bench=lockstep".into()];
        let run = mrroc(arguments.into_iter().chain(["--record".into(), file.clone().into_os_string()]));
        assert_eq!(run.status.code(), Some(0), "{run:?}");
    }
    let length = fs::metadata(&files[0]).unwrap().len() * 9 / 10;
    let judged = Command::new("timeout")
        .arg(PATIENCE)
        .arg(python)
        .arg(mrroc::root().join("tests/peers/recording.py"))
        .args(&files)
        .arg(length.to_string())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&judged.stderr);
    assert!(judged.status.success(), "{said}");
}
