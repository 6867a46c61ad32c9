//! A reader that closes the output before the answer makes a command fail. Help and version are exceptions.

use kit::closed_output::{ends_as_ever, is_an_error};
use kit::mrroc::{Directory, shorten};

#[test]
fn an_answer_that_nobody_reads_is_an_error() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let nowhere = directory.path("nowhere.toml");
    is_an_error(&[
        ("check", Some(cell.as_os_str())),
        ("check --json", Some(cell.as_os_str())),
        ("check", Some(nowhere.as_os_str())),
        ("kinematics limits --robot=irb6", None),
        ("kinematics limits --robot=irb6 --json", None),
        ("datasheet --robot=polycrank", None),
        ("datasheet --robot=polycrank --figure", None),
        ("urdf --robot=irb6", None),
        ("schema", None),
        ("schema --reference", None),
    ]);
}

#[test]
fn help_and_version_end_as_ever_where_nobody_reads() {
    ends_as_ever(&[("run --help", None), ("--version", None)]);
}
