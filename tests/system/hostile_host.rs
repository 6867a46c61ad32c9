//! A hostile host: no program listens on a socket unless asked, and what others plant under the names of outputs is
//! neither followed nor overwritten.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use kit::mrroc::{Directory, Output, mrroc, text};

/// A directory where every user can write, without a sticky bit, and links to a victim under these names.
fn planted(directory: &Directory, names: &[&str]) -> (std::path::PathBuf, std::path::PathBuf) {
    let (open, victim) = (directory.path("open"), directory.write("victim", "precious"));
    fs::create_dir(&open).unwrap();
    fs::set_permissions(&open, fs::Permissions::from_mode(0o777)).unwrap();
    names.iter().for_each(|name| symlink(&victim, open.join(name)).unwrap());
    (open, victim)
}

fn refused(output: &Output, victim: &Path) {
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert_eq!(fs::read_to_string(victim).unwrap(), "precious", "{output:?}");
}

#[test]
fn links_that_others_planted_are_neither_followed_nor_replaced() {
    let directory = Directory::new();
    let cell = directory.write("cell.toml", &text("irb6"));
    let (open, victim) = planted(&directory, &["report.html", "record.csv", "record.mcap", "record.log", "can0"]);
    let outputs = [["--out", ""], ["--record", "record.csv"], ["--record", "record.mcap"], ["--trace", "record.log"]];
    for [option, name] in outputs {
        let path = open.join(name);
        for force in [&[][..], &["--force".as_ref()]] {
            let arguments = ["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref(), option.as_ref()];
            refused(&mrroc(arguments.into_iter().chain([path.as_os_str()]).chain(force.iter().copied())), &victim);
        }
    }
    let link = open.join("can0");
    let emulator = mrroc(["emulate".as_ref(), cell.as_os_str(), "--slcan".as_ref(), link.as_os_str()]);
    refused(&emulator, &victim);
    assert_eq!(fs::read_link(&link).unwrap(), victim);
}
