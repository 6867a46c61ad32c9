//! A reader that closes the output early, such as `head`, does not make a command fail. The report of a run is an exception.

use kit::closed_output::ends_as_ever;
use kit::mrroc::{Directory, shorten};

#[test]
fn a_command_ends_as_ever_where_nobody_reads_what_it_prints() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let nowhere = directory.path("nowhere.toml");
    ends_as_ever(&[
        ("check", Some(cell.as_os_str())),
        ("check --json", Some(cell.as_os_str())),
        ("check", Some(nowhere.as_os_str())),
        ("kinematics limits --robot=irb6", None),
        ("kinematics limits --robot=irb6 --json", None),
        ("datasheet --robot=polycrank", None),
        ("datasheet --robot=polycrank --figure", None),
        ("urdf --robot=irb6", None),
        ("schema", None),
        ("vm", None),
        ("run --help", None),
        ("--version", None),
    ]);
}
