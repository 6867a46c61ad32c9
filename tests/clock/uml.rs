//! The test machine: input files, output files, and clean-up.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use std::{env, fs, process};

use hil::uml::{MachineError, Options, run};
use kit::bench::{UML, left_out};
use kit::mrroc;
use kit::{by_the_clock, processors};

fn shell(script: &str) -> Options {
    Options::new(["sh", "-c", script])
}

/// A directory for one test, removed on drop.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(test: &str) -> Self {
        let path = env::temp_dir().join(format!("mrroc-{test}-{}", process::id()));
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    pub(crate) fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }

    pub(crate) fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Number of processes with `word` on their command line.
pub(crate) fn processes_of(word: &str) -> usize {
    process_ids_of(word).len()
}

/// Processes with `word` on their command line.
pub(crate) fn process_ids_of(word: &str) -> Vec<String> {
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let with_word = processes.filter(|process| {
        let command_line = fs::read(process.path().join("cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&command_line).contains(word)
    });
    with_word.filter_map(|process| process.file_name().into_string().ok()).collect()
}

#[test]
fn the_command_gets_its_surroundings_and_its_status_and_output_come_out() {
    if left_out("uml") {
        return;
    }
    let _share = processors::take(UML);
    let options = Options {
        env: vec![("WORD".into(), "it's $HOME".into())],
        directory: "/usr".into(),
        ..shell("pwd; echo \"$WORD\"; ip -o link show vcan0 | grep -c UP; printf end >&2; exit 7")
    };
    let mut output = Vec::new();
    assert_eq!(run(&options, &mut output), Ok(7));
    assert_eq!(String::from_utf8(output).unwrap(), "/usr\nit's $HOME\n1\nend");
}

#[test]
fn only_the_output_directory_can_be_written_to() {
    if left_out("uml") {
        return;
    }
    let _share = processors::take(UML);
    let scratch = Scratch::new("output");
    let home = env::current_dir().unwrap();
    let script = format!(
        "touch \"$MRROC_OUT/kept\"; for place in / /usr {}; do touch \"$place/lost\" && exit 1; done; \
         touch /tmp/lost /run/lost /dev/lost",
        home.display()
    );
    let options = Options { output: Some(scratch.0.clone()), ..shell(&script) };
    let mut output = Vec::new();
    assert_eq!(run(&options, &mut output), Ok(0), "{}", String::from_utf8_lossy(&output));
    assert_eq!(scratch.names(), ["kept"]);
    for place in ["/", "/usr", "/tmp", "/run", "/dev"] {
        assert!(!Path::new(place).join("lost").exists());
    }
}

#[test]
fn a_machine_out_of_time_is_killed_with_all_its_processes() {
    if left_out("uml") {
        return;
    }
    let scratch = Scratch::new("timeout");
    let timeout = Duration::from_secs(12);
    // On a busy host, the boot alone takes longer than the limit.
    by_the_clock(UML, Duration::from_millis(50), || {
        let options = Options {
            output: Some(scratch.0.clone()),
            // Memory size of this machine. Its processes are found by this size, because no other machine of these
            // tests has it.
            memory_mib: 259,
            timeout,
            ..shell("echo begun; sleep 1000 & sleep 1000")
        };
        let mut output = Vec::new();
        assert_eq!(run(&options, &mut output), Err(MachineError::TimedOut(timeout).into()));
        assert_eq!(processes_of("mem=259M"), 0);
        assert_eq!(String::from_utf8(output).unwrap(), "begun\n");
    });
    assert!(scratch.names().is_empty());
}

#[test]
fn the_working_directory_is_seen_inside_wherever_it_lies() {
    if left_out("uml") {
        return;
    }
    let _share = processors::take(UML);
    let scratch = Scratch::new("seen");
    let place = |name: &str| scratch.0.join(name);
    for directory in ["work", "further", "unlisted", "work/out"] {
        fs::create_dir(place(directory)).unwrap();
        fs::write(place(directory).join("file"), directory).unwrap();
    }
    let script = "pwd; cat file ../further/file out/file; touch lost ../further/lost && exit 1; \
                  test ! -e ../unlisted && touch out/kept";
    let options = Options {
        directory: place("work"),
        visible: vec![place("further")],
        output: Some(place("work/out")),
        ..shell(script)
    };
    let mut output = Vec::new();
    let status = run(&options, &mut output);
    let output = String::from_utf8(output).unwrap();
    assert_eq!(status, Ok(0), "{output}");
    let expected = format!("{}\nworkfurtherwork/out", place("work").display());
    assert!(output.starts_with(&expected), "{output}");
    assert!(place("work/out/kept").exists());
    assert!(!place("work/lost").exists() && !place("further/lost").exists());
}

#[test]
fn the_command_of_the_readme_runs_where_it_is_called() {
    if left_out("uml") {
        return;
    }
    let _share = processors::take(UML);
    let scratch = Scratch::new("vm");
    fs::write(scratch.0.join("here"), "").unwrap();
    let script = "test -e here && mrroc --version && ip link show vcan0 >\"$MRROC_OUT/link\"; exit 7";
    let vm = Command::new(mrroc::binary())
        .args(["vm", "uml", "--out", "out", "--", "sh", "-c", script])
        .current_dir(&scratch.0)
        .output()
        .unwrap();
    let printed = String::from_utf8(vm.stdout).unwrap();
    assert_eq!(vm.status.code(), Some(7), "{printed}");
    assert!(printed.starts_with("mrroc "), "{printed}");
    let link = fs::read_to_string(scratch.0.join("out/link")).unwrap();
    assert!(link.contains("vcan0"), "{link}");
}
