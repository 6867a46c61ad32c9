//! Service ports of emulated drives on pseudo-terminals.

use std::time::Duration;

use hil::Pty;
use kit::mrroc::{Directory, Output, Running, example, mrroc};
use kit::processors;

/// The drives of the IRb-6 behind an slcan adapter, and their service ports.
struct Ports {
    directory: Directory,
    _emulators: Running,
}

impl Ports {
    fn new() -> Self {
        let directory = Directory::new();
        let ports = directory.path("ports");
        let emulators = Running::start([
            "emulate".as_ref(),
            example("irb6").as_os_str(),
            "--slcan".as_ref(),
            directory.path("can0").as_os_str(),
            "--service".as_ref(),
            ports.as_os_str(),
        ]);
        let all = Self { directory, _emulators: emulators };
        let first = all.directory.path("ports").join("column");
        let listening = can::clock::now() + Duration::from_secs(20);
        while !first.exists() {
            assert!(can::clock::now() < listening, "no port appears");
            can::clock::sleep_until(can::clock::now() + Duration::from_millis(20));
        }
        all
    }

    fn run(&self, words: &str, interface: &str) -> Output {
        mrroc(words.split(' ').chain(["--can", interface]))
    }

    fn port(&self, axis: &str) -> String {
        let path = self.directory.path("ports").join(axis);
        format!("epos4:{}", path.display())
    }

    fn says(&self, words: &str) -> String {
        let output = self.run(words, &self.port("column"));
        assert_eq!(output.status.code(), Some(0), "{words}: {output:?}");
        assert_eq!(output.stderr, "", "{words}: {output:?}");
        output.stdout
    }

    /// Checks the one-line refusal of a command.
    fn refused(&self, words: &str, interface: &str, needles: &[&str]) {
        let output = self.run(words, interface);
        assert_eq!(output.status.code(), Some(2), "{words}: {output:?}");
        assert_eq!(output.stdout, "", "{words}: {output:?}");
        assert_eq!(output.stderr.lines().count(), 1, "{words}: {output:?}");
        for needle in needles {
            let found = output.stderr.contains(needle);
            assert!(found, "{words}: {needle:?} is not in {output:?}");
        }
    }
}

#[test]
fn service_commands_reach_an_emulated_drive_over_its_service_port() {
    let _share = processors::take(0.25);
    let ports = Ports::new();
    let read = ports.says("sdo read 1 0x6041 --type u16");
    assert!(read.starts_with("0x6041:00 statusword = 0x"), "{read}");
    assert!(read.contains("(switch on disabled"), "{read}");
    let wrote = ports.says("sdo write 1 0x1017 --type u16 150");
    assert_eq!(wrote, "0x1017:00 heartbeat producer time = 0x0096, 150\n");
    let wrote = ports.says("sdo write 1 0x607a --type i32 -5");
    assert!(wrote.contains("-5"), "{wrote}");
    // With a type, without a type, and by segmented transfer.
    for words in ["sdo read 1 0x1008", "sdo read 1 0x1008 --type string"] {
        assert!(ports.says(words).contains("\"EPOS4"), "{words}");
    }
    let who = ports.says("scan");
    assert!(who.starts_with("epos4:") && who.contains(": CiA 402, servo drive, \"EPOS4"), "{who}");
    assert!(who.contains(", maxon, product 0x"), "{who}");
    let told = ports.says("nmt start 1");
    assert!(told.starts_with("node 1: told"), "{told}");
    // The other drive keeps its own value, and answers under its own node-ID.
    let second = ports.run("sdo read 2 0x1017 --type u16", &ports.port("lower-arm"));
    assert!(second.stdout.ends_with("= 0x0000, 0\n"), "{second:?}");

    let port = ports.port("column");
    ports.refused("sdo write 1 0x6041 --type u16 0", &port, &["node 1", "read-only"]);
    ports.refused("sdo read 2 0x6041", &port, &["node 2", "node-ID"]);
    ports.refused("sdo read 1 0x1000 --block", &port, &["--block"]);
    ports.refused("monitor", &port, &["no CAN bus", "mrroc sdo"]);
    ports.refused("lss scan", &port, &["no CAN bus"]);
    ports.refused("sdo read 1 0x1000", &ports.port("absent"), &["no such device"]);
    let nobody = Pty::open().unwrap();
    let silent = format!("epos4:{}@9600", nobody.path().display());
    ports.refused("sdo read 1 0x1000 --timeout 500", &silent, &["timed out", "wrong baud rate"]);
    ports.refused("scan", &silent, &["no drive answers", "wrong baud rate"]);
    let silent = silent.replace("epos4", "epos2");
    ports.refused("nmt start 1 --timeout 500", &silent, &["timed out", "wrong baud rate"]);
    ports.refused("sdo read 1 0x1000 --type u64", &silent, &["segments"]);
}
