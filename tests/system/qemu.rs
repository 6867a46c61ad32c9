//! The test machine with cards: input files, output files, and clean-up.

use std::fs;
use std::path::Path;
use std::time::Duration;

use hil::qemu::{Kernel, MachineError, Options, QemuError, run};

use crate::bench::kernel;
use crate::uml::{Scratch, processes_of};

/// Characters with a special meaning in shells and in QEMU's options.
const OUT: &str = "o\"u,t's $x";

/// Runs a shell script. Returns its result and its output.
fn shell(kernel: &Kernel, scratch: &Scratch, timeout: Duration, script: &str) -> (Result<u8, QemuError>, String) {
    let options = Options {
        env: vec![("WORD".into(), "it's $HOME".into())],
        directory: scratch.0.clone(),
        output: Some(scratch.0.join(OUT)),
        memory_mib: 512,
        timeout,
        ..Options::new(["sh", "-c", script])
    };
    let mut output = Vec::new();
    let outcome = run(kernel, &options, &mut output);
    assert_eq!(processes_of(scratch.path()), 0);
    (outcome, String::from_utf8_lossy(&output).into_owned())
}

#[test]
fn the_machine_has_cards_and_the_files_of_the_host_read_only() {
    let Some(kernel) = kernel("qemu") else { return };
    let scratch = Scratch::new("qemu-files");
    fs::write(scratch.0.join("here"), "seen\n").unwrap();
    let script = "cat here; echo \"$WORD\"; cat /sys/kernel/realtime; \
                  ip -o link show type can | grep -c 'state DOWN'; \
                  for place in . / /usr; do touch $place/lost 2>/dev/null && exit 1; done; \
                  touch /tmp/lost /run/lost /dev/lost \"$MRROC_OUT/kept\"; printf end >&2; exit 7";
    let (outcome, output) = shell(&kernel, &scratch, Duration::from_secs(120), script);
    assert_eq!(outcome, Ok(7), "{output}");
    assert_eq!(output, "seen\nit's $HOME\n1\n2\nend");
    let left: Vec<_> = fs::read_dir(scratch.0.join(OUT)).unwrap().collect();
    assert!(left.len() == 1 && scratch.0.join(OUT).join("kept").exists(), "{left:?}");
    for place in ["/", "/usr", "/tmp", "/run", "/dev"] {
        assert!(!Path::new(place).join("lost").exists());
    }
}

#[test]
fn a_machine_that_does_not_end_by_itself_is_told_from_one_that_dies() {
    let Some(kernel) = kernel("qemu") else { return };
    let scratch = Scratch::new("qemu-end");
    // Longer than any boot, so the command exceeds the time limit.
    let timeout = Duration::from_secs(80);
    let (outcome, output) = shell(&kernel, &scratch, timeout, "echo begun; sleep 1000");
    assert_eq!((outcome, &*output), (Err(MachineError::TimedOut(timeout).into()), "begun\n"));
    let panic = "echo begun; sleep 1; echo c >/proc/sysrq-trigger";
    let (outcome, output) = shell(&kernel, &scratch, Duration::from_secs(120), panic);
    assert_eq!((outcome, &*output), (Err(MachineError::Died.into()), "begun\n"));
    assert_eq!(fs::read_dir(scratch.0.join(OUT)).unwrap().count(), 0);
    assert_eq!(scratch.names(), [OUT]);
}
