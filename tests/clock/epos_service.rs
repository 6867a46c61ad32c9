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
    configurations_are_saved_and_compared(&ports);
    ports.refused("sdo write 1 0x6041 --type u16 0", &port, &["node 1", "writing 0x0000, 0", "read-only"]);
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

/// Saves the values of a drive, changes one, and compares.
fn configurations_are_saved_and_compared(ports: &Ports) {
    let eds = kit::mrroc::root().join("cells/epos4-emulated.eds");
    let eds = eds.display();
    let path = ports.directory.path("saved.dcf");
    let saved = path.display();
    let told = ports.says(&format!("dcf save 1 {saved} --eds {eds}"));
    assert!(told.starts_with("node 1: ") && told.contains(" of them are notes"), "{told}");
    let text = std::fs::read_to_string(&path).unwrap();
    for line in ["NodeID=1\n", "ProductNumber=0x61500000\n", "ParameterValue=EPOS4\n"] {
        assert!(text.contains(line), "{line}: {text}");
    }
    let compared = ports.says(&format!("dcf compare 1 {saved}"));
    assert!(compared.contains(": 0 of ") && compared.contains(" values differ from "), "{compared}");
    ports.refused(&format!("dcf save 1 {saved} --eds {eds}"), &ports.port("column"), &["the file is there already"]);

    // By name, and a difference.
    let port = ports.port("column");
    let mut words: Vec<String> = ["sdo", "write", "1", "Position window", "1234", "--eds"].map(str::to_owned).to_vec();
    words.extend([eds.to_string(), "--can".to_owned(), port.clone()]);
    let wrote = mrroc(&words);
    assert_eq!(wrote.stdout, "0x6067:00 Position window = 0x000004d2, 1234\n", "{wrote:?}");
    let differs = ports.run(&format!("dcf compare 1 {saved}"), &port);
    assert_eq!(differs.status.code(), Some(1), "{differs:?}");
    let difference = "0x6067:00 Position window: the drive holds 0x000004d2, 1234, line ";
    assert!(differs.stdout.starts_with(difference), "{differs:?}");
    assert!(differs.stdout.contains(" of the file states 0xffffffff, 4294967295\n"), "{differs:?}");
    let json = ports.run(&format!("dcf compare 1 {saved} --json"), &port).json();
    assert_eq!(json["differences"][0]["index"], 0x6067, "{json}");

    // Without a data sheet, all values are notes.
    let names = ports.directory.path("names.dcf");
    let named = ports.run(&format!("dcf save 1 {} --json", names.display()), &port).json();
    assert!(named["values"].as_u64() > Some(20) && named["values"] == named["notes"], "{named}");

    // A cell accepts what was saved.
    let cell = ports.directory.cell("irb6", |cell| {
        cell.robot[0].axis[0].drive.as_mut().unwrap().dcf = Some("saved.dcf".into());
    });
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    assert_eq!((check.status.code(), check.stderr.as_str()), (Some(0), ""), "{check:?}");
    peer_reads(&path);
}

/// python-canopen reads the saved file.
fn peer_reads(saved: &std::path::Path) {
    const SCRIPT: &str = "\
import sys, canopen
device = canopen.import_od(sys.argv[1])
assert device.node_id == 1, device.node_id
assert device[0x1008].value == 'EPOS4', device[0x1008].value
assert device[0x6067].value == 0xFFFFFFFF, device[0x6067].value
assert device[0x1018][1].value == 0xFB, device[0x1018][1].value
assert device[0x607D][1].data_type == canopen.objectdictionary.INTEGER32
";
    let Some(python) =
        crate::peers::python("epos_service::service_commands_reach_an_emulated_drive_over_its_service_port")
    else {
        return;
    };
    let read = std::process::Command::new(python).args(["-B", "-c", SCRIPT]).arg(saved).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
}
