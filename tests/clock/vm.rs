//! `mrroc vm`: clean-up after a machine, and protection against other users of the host.

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Output, Stdio};

use kit::bench::{UML, left_out};
use kit::mrroc;
use kit::processors;

use crate::uml::{Scratch, processes_of};
use crate::vcan::wait_until;

/// `mrroc vm uml` with `scratch` as its directory for temporary files.
fn vm(scratch: &Scratch) -> Command {
    let mut vm = Command::new(mrroc::binary());
    vm.args(["vm", "uml"]).env("TMPDIR", &scratch.0);
    vm.stdin(Stdio::null());
    vm
}

/// A machine with a running command.
struct Begun {
    scratch: Scratch,
    mrroc: Child,
    output: BufReader<ChildStdout>,
}

impl Begun {
    fn new(name: &str) -> Self {
        let scratch = Scratch::new(name);
        let mut vm = vm(&scratch);
        vm.args(["--", "sh", "-c", "echo begun; sleep 1000 & sleep 1000"]);
        let mut mrroc = vm.process_group(0).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(mrroc.stdout.take().unwrap());
        Self { scratch, mrroc, output }
    }

    fn wait_for_the_command(&mut self) {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        assert_eq!(line, "begun\n");
    }

    /// Sends a signal to the whole process group, as a terminal does.
    fn signal(&self, name: &str) {
        let kill = format!("kill -s {name} -- -{}", self.mrroc.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }
}

impl Drop for Begun {
    fn drop(&mut self) {
        // Both calls fail if the process has ended, which does no harm.
        let _ = self.mrroc.kill();
        let _ = self.mrroc.wait();
    }
}

#[test]
fn no_process_and_no_directory_stays_however_the_command_is_ended() {
    if left_out("vm") {
        return;
    }
    let _share = processors::take(UML);
    let ends = [("HUP", 1), ("INT", 2), ("QUIT", 3), ("KILL", 9), ("TERM", 15)];
    let mut begun = ends.map(|(name, number)| (name, number, Begun::new(&format!("vm-{name}"))));
    for (name, number, machine) in &mut begun {
        machine.wait_for_the_command();
        assert!(processes_of(machine.scratch.path()) > 1);
        assert_eq!(machine.scratch.names().len(), 1);
        machine.signal(name);
        let status = machine.mrroc.wait().unwrap();
        let gone = || processes_of(machine.scratch.path()) == 0 && machine.scratch.names().is_empty();
        if *name == "KILL" {
            assert_eq!(status.signal(), Some(*number));
            wait_until("the machine of a command that was killed is gone", gone);
        } else {
            assert_eq!(status.code(), Some(128 + *number), "{name}");
            assert!(gone(), "{name}: {:?}", machine.scratch.names());
        }
        let mut rest = String::new();
        machine.output.read_to_string(&mut rest).unwrap();
        assert_eq!(rest, "", "{name}");
    }
}

#[test]
fn the_directory_of_a_machine_is_its_users_alone_and_has_no_name_to_be_guessed() {
    if left_out("vm") {
        return;
    }
    let _share = processors::take(UML);
    let mut begun = Begun::new("vm-private");
    begun.wait_for_the_command();
    let names = begun.scratch.names();
    let [name] = &names[..] else { panic!("{names:?}") };
    let directory = fs::symlink_metadata(begun.scratch.0.join(name)).unwrap();
    assert!(directory.is_dir());
    assert_eq!(directory.permissions().mode() & 0o7777, 0o700);
    assert!(!name.contains(&begun.mrroc.id().to_string()), "{name}");
    begun.signal("TERM");
    begun.mrroc.wait().unwrap();
}

/// The planted link has the former name of the directory: kind of machine, process ID and number of the run.
#[test]
fn a_planted_link_is_not_followed() {
    if left_out("vm") {
        return;
    }
    let _share = processors::take(UML);
    let [scratch, precious] = ["vm-planted", "vm-precious"].map(Scratch::new);
    fs::write(precious.0.join("file"), "").unwrap();
    let plant = "ln -s \"$1\" \"$TMPDIR/mrroc-uml-$$-0\" && shift && exec \"$@\"";
    let planted = Command::new("sh")
        .args(["-c", plant, "sh"])
        .arg(&precious.0)
        .arg(mrroc::binary())
        .args(["vm", "uml", "--", "sh", "-c", "touch $MRROC_OUT/found"])
        .env("TMPDIR", &scratch.0)
        .output()
        .unwrap();
    assert_eq!(planted.status.code(), Some(0), "{planted:?}");
    assert_eq!(precious.names(), ["file"]);
    assert_eq!(scratch.names().len(), 1);
}

fn refused_out(scratch: &Scratch, out: &Path) -> Output {
    let output = vm(scratch).arg("--out").arg(out).args(["--", "true"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    output
}

#[test]
fn a_directory_that_other_users_can_change_is_refused() {
    if left_out("vm") {
        return;
    }
    let _share = processors::take(UML);
    let scratch = Scratch::new("vm-shared");
    let place = |name: &str| scratch.0.join(name);
    fs::create_dir_all(place("shared/out")).unwrap();
    fs::create_dir(place("own")).unwrap();
    fs::set_permissions(place("shared"), Permissions::from_mode(0o777)).unwrap();
    for out in ["shared", "shared/out", "shared/new", "shared/../shared/out"] {
        let said = refused_out(&scratch, &place(out)).stderr;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("output directory") && said.contains("other users"), "{said}");
    }
    symlink(place("own"), place("shared/link")).unwrap();
    refused_out(&scratch, &place("shared/link/out"));
    assert!(!place("shared/new").exists() && !place("own/out").exists());

    // Also for the directory for temporary files.
    let shared = Scratch(place("shared"));
    let said = String::from_utf8(refused_out(&shared, &place("own")).stderr).unwrap();
    assert!(said.contains("TMPDIR"), "{said}");
    assert!(fs::read_dir(place("own")).unwrap().next().is_none());
}

#[test]
fn directories_of_any_name_are_seen_and_written_to() {
    if left_out("vm") {
        return;
    }
    let _share = processors::take(UML);
    let scratch = Scratch::new("vm-names");
    let place = |name: &str| scratch.0.join(name);
    let (work, out) = ("w\"o'r k,$(x)", "a\"b'c d,e=f");
    fs::create_dir(place(work)).unwrap();
    fs::write(place(work).join("here"), "").unwrap();
    let output = vm(&scratch)
        .args(["--timeout", "60", "--out"])
        .arg(place(out))
        .args(["--", "sh", "-c", "test -e here && touch \"$MRROC_OUT/kept\""])
        .current_dir(place(work))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(place(out).join("kept").exists());
}
