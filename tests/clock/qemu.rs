//! The test machine with cards: input files, output files, and clean-up.

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::Duration;

use hil::qemu::{Clock, Kernel, MachineError, Options, QemuError, run};
use kit::bench::{QEMU, kernel};
use kit::processors;

use crate::uml::{Scratch, process_ids_of, processes_of};
use crate::vcan::wait_until;

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
    let outcome = run(kernel, Clock::Host, &options, &mut output);
    wait_until("no process of the machine is left", || processes_of(scratch.path()) == 0);
    (outcome, String::from_utf8_lossy(&output).into_owned())
}

#[test]
fn the_machine_has_cards_and_the_files_of_the_host_read_only() {
    let Some(kernel) = kernel("qemu") else { return };
    let _share = processors::take(QEMU);
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
    let _share = processors::take(QEMU);
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

/// Output of the machine with [`MEMORY`]. After the word `hold`, the machine stands still for [`HOLD`].
#[derive(Default)]
struct Holding {
    output: String,
}

const HOLD: Duration = Duration::from_secs(4);

/// Memory of the machine that is held, MiB. No other machine of these tests has this size.
const MEMORY: u32 = 517;

impl Write for Holding {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.output.push_str(&String::from_utf8_lossy(bytes));
        if self.output.ends_with("hold\n") {
            let machine = process_ids_of(&format!("-m\0{MEMORY}\0"));
            assert!(!machine.is_empty());
            for (signal, wait) in [("-STOP", HOLD), ("-CONT", Duration::ZERO)] {
                assert!(Command::new("kill").arg(signal).args(&machine).status()?.success());
                thread::sleep(wait);
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_clock_that_counts_instructions_stands_still_while_the_host_holds_the_machine() {
    let Some(kernel) = kernel("qemu") else { return };
    let _share = processors::take(QEMU);
    let scratch = Scratch::new("qemu-clock");
    // A loop with the same number of instructions each time. The script reads the clock, and then prints the word.
    let work = |word| {
        format!(
            "begin=$(date +%s%N); echo {word}; i=0; while [ $i -lt 100000 ]; do i=$((i + 1)); done; \
             echo $((($(date +%s%N) - begin) / 1000000))"
        )
    };
    let script = format!("{}; {}", work("alone"), work("hold"));
    let options = Options {
        directory: scratch.0.clone(),
        memory_mib: MEMORY,
        timeout: Duration::from_secs(240),
        ..Options::new(["sh", "-c", &script])
    };
    let mut holding = Holding::default();
    assert_eq!(run(&kernel, Clock::Instructions, &options, &mut holding), Ok(0), "{}", holding.output);
    let milliseconds: Vec<f64> = holding.output.lines().filter_map(|line| line.parse().ok()).collect();
    let [alone, held] = milliseconds[..] else { panic!("{}", holding.output) };
    println!("{alone} ms, and {held} ms with a hold of {HOLD:?}");
    // The idle time of the machine takes as long as on the host. On a busy host, a read of a file is idle time.
    assert!(alone > 100.0 && held - alone < HOLD.as_secs_f64() * 500.0);
}
