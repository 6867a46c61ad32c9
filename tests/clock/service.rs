//! The service commands on SocketCAN, with emulated drives in another process.

use std::process::{Command, Stdio};
use std::time::Duration;

use can::clock;
use kit::bench::bodies_on_vcan;
use kit::mrroc::{self, Directory, Output, Running, mrroc};

/// Longest time until the emulators listen.
const PATIENCE: Duration = Duration::from_secs(20);

/// A body of a test, with the name of its claim.
type Body = (&'static str, fn(&Stage));

/// The drives of a cell with one IRb-6, emulated in another process.
struct Stage<'a> {
    interface: &'a str,
    cell: String,
    _directory: Directory,
    _emulators: Running,
}

impl<'a> Stage<'a> {
    fn on(interface: &'a str) -> Self {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |_| {}).display().to_string();
        let emulators = Running::start(["emulate", &cell, "--can", interface]);
        let stage = Stage { interface, cell, _directory: directory, _emulators: emulators };
        let listening = clock::now() + PATIENCE;
        while !stage.run("sdo read 1 0x1000").status.success() {
            assert!(clock::now() < listening, "the emulators do not listen");
        }
        stage
    }

    /// Runs `mrroc` with the arguments `words` on the interface.
    fn run(&self, words: &str) -> Output {
        let words = words.split(' ');
        mrroc(words.chain(["--can", self.interface]))
    }

    /// Runs a command that must succeed, and returns its output.
    fn says(&self, words: &str) -> String {
        let output = self.run(words);
        assert_eq!(output.status.code(), Some(0), "{words}: {output:?}");
        assert_eq!(output.stderr, "", "{words}: {output:?}");
        output.stdout
    }

    /// Asserts a refusal with one line on stderr.
    fn refused(&self, words: &str, needles: &[&str]) {
        let output = self.run(words);
        assert_eq!(output.status.code(), Some(2), "{words}: {output:?}");
        assert_eq!(output.stdout, "", "{words}: {output:?}");
        assert_eq!(output.stderr.lines().count(), 1, "{words}: {output:?}");
        for needle in needles {
            assert!(output.stderr.contains(needle), "{words}: {needle:?} is not in {output:?}");
        }
    }
}

#[test]
fn service_commands_on_emulated_drives() {
    let bodies: [Body; 3] = [
        ("a bus is looked at, asked and told", a_bus_is_looked_at_asked_and_told),
        (
            "a monitor shows what passes, and ends when it is told or nobody reads",
            a_monitor_shows_what_passes_and_ends_when_it_is_told_or_nobody_reads,
        ),
        // The emulators of this body end when their interface goes down.
        ("a monitor outlasts an interface that goes down", a_monitor_outlasts_an_interface_that_goes_down),
    ];
    let test = "service::service_commands_on_emulated_drives";
    bodies_on_vcan(test, &bodies, |interface, body| body(&Stage::on(interface)));
}

fn a_bus_is_looked_at_asked_and_told(stage: &Stage) {
    let found = stage.says(&format!("scan --cell {}", stage.cell));
    assert_eq!(found.lines().count(), 5, "{found}");
    assert!(found.starts_with("node 1 (column): CiA 402, servo drive, "), "{found}");
    assert!(found.contains(", maxon, product 0x"), "{found}");
    let scanned = stage.run("scan --json").json();
    assert_eq!(scanned["nodes"][4]["node"], 5, "{scanned}");
    assert_eq!(scanned["nodes"][4]["vendor"], 0xFB, "{scanned}");

    let said = stage.says("sdo read 1 0x6041:0");
    assert!(said.starts_with("0x6041:00 statusword = 0x"), "{said}");
    assert!(said.contains("(switch on disabled"), "{said}");
    let read = stage.run("sdo read 1 1018:1 --json").json();
    assert_eq!((&read["value"], &read["name"]), (&0xFB.into(), &"vendor-ID".into()));
    let wrote = stage.says("sdo write 1 0x1017:0 --type u16 150");
    assert_eq!(wrote, "0x1017:00 heartbeat producer time = 0x0096, 150\n");
    assert_eq!(stage.says("sdo write 1 0x607a --type i32 -5 --no-read-back"), "");

    stage.refused("sdo write 1 0x6041 --type u16 0", &["node 1", "read-only"]);
    stage.refused("sdo read 1 0x5fff", &["object does not exist", "wrong index"]);
    stage.refused("sdo write 1 0x1017 --type u32 1", &["0x1017:00", "--type"]);
    stage.refused("sdo write 1 0x1017 --type u16 65536", &["u16", "0 to 65535"]);
    // Other frames arrive: the heartbeat of node 1.
    let silence = "sdo read 99 0x1000 --timeout 200";
    stage.refused(silence, &["node 99", "timed out", "its bit rate is right"]);

    assert_eq!(stage.says("nmt start 1"), "node 1: operational\n");
    assert_eq!(stage.says("nmt pre-operational 1"), "node 1: pre-operational\n");
    assert_eq!(stage.says("nmt reset-node 1"), "node 1: booted\n");
    let all = stage.says("nmt reset-communication all");
    assert_eq!(all, "node 1: booted\nnode 2: booted\nnode 3: booted\nnode 4: booted\nnode 5: booted\n");
    let absent = stage.run("nmt reset-node 99 --timeout 300");
    assert_eq!(absent.status.code(), Some(1), "{absent:?}");
    assert_eq!(absent.stdout, "node 99: told, and did not boot\n");
}

fn a_monitor_shows_what_passes_and_ends_when_it_is_told_or_nobody_reads(stage: &Stage) {
    let heartbeat = "sdo write 2 0x1017 --type u16 20 --no-read-back";
    assert_eq!(stage.says(heartbeat), "");
    let shown = stage.says("monitor --count 3 --only heartbeat");
    assert_eq!(shown.lines().count(), 3, "{shown}");
    for line in shown.lines() {
        assert!(line.contains("702#7F"), "{shown}");
        assert!(line.ends_with("node 2: pre-operational"), "{shown}");
    }
    let shown = stage.says(&format!("monitor --map --cell {} --json --count 1", stage.cell));
    let line: serde_json::Value = serde_json::from_str(&shown).unwrap();
    assert_eq!(line["kind"], "heartbeat", "{shown}");

    let monitor = Running::start(["monitor", "--can", stage.interface]);
    // The monitor must be listening before it receives the signal to end.
    clock::sleep_until(clock::now() + Duration::from_secs(2));
    monitor.signal("INT");
    let ended = monitor.output();
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    assert!(ended.stdout.contains("pre-operational"), "{ended:?}");

    let mut monitor = Command::new(mrroc::binary())
        .args(["monitor", "--can", stage.interface])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(monitor.stdout.take());
    let ended = monitor.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    assert_eq!(ended.stderr, b"", "{ended:?}");
}

fn a_monitor_outlasts_an_interface_that_goes_down(stage: &Stage) {
    let monitor = Running::start(["monitor", "--can", stage.interface]);
    for state in ["down", "up"] {
        clock::sleep_until(clock::now() + Duration::from_secs(2));
        let set = Command::new("ip").args(["link", "set", stage.interface, state]).status().unwrap();
        assert!(set.success(), "{state}");
    }
    // The monitor looks at the interface every 50 ms.
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    assert!(Command::new("cansend").args([stage.interface, "123#11"]).status().unwrap().success());
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    monitor.signal("INT");
    let ended = monitor.output();
    assert_eq!(ended.status.code(), Some(0), "{}", ended.stderr);
    assert!(
        ended.stderr.contains("the interface is down") && ended.stderr.contains("arrive again"),
        "{}",
        ended.stderr
    );
    assert!(ended.stdout.contains("123#11"), "{}", ended.stderr);
}
