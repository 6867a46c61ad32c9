//! The host's end of slcan with an emulated adapter on a pseudo-terminal and emulated drives behind it.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use can::timing::Bitrate;
use can::{Instant, clock};
use canopen::NodeId;
use hil::epos4::{Epos4, Epos4Config};
use hil::pty::{self, Interest, Pty};
use hil::{AxisConfig, DeviceId, Irp6Axis, SlcanCounts, SlcanDevice, World};
use kit::by_the_clock;
use kit::mrroc::{self, Directory, Output, Running, mrroc};
use kit::processors;

/// Time between two checks whether the adapter is to be unplugged.
const LOOK: Duration = Duration::from_millis(20);

/// Shortest delay that disturbs a run: the servo period of its cell.
const LATE: Duration = Duration::from_millis(10);

/// Emulated adapters on one bus, served by a thread of their own and unplugged on drop.
pub(crate) struct Adapters {
    pub(crate) interfaces: Vec<String>,
    unplugged: Arc<AtomicBool>,
    thread: Option<JoinHandle<Vec<SlcanCounts>>>,
}

impl Adapters {
    /// `count` adapters on a bus of 1 Mbit/s with a drive for each of `nodes`.
    pub(crate) fn with(count: usize, nodes: &[u8]) -> Self {
        let ptys: Vec<_> = (0..count).map(|_| Pty::open().unwrap()).collect();
        let interface = |pty: &Pty| format!("slcan:{}", pty.path().display());
        let interfaces = ptys.iter().map(interface).collect();
        let unplugged = Arc::new(AtomicBool::new(false));
        let (flag, nodes) = (unplugged.clone(), nodes.to_vec());
        let thread = thread::spawn(move || serve(ptys, &nodes, &flag));
        Self { interfaces, unplugged, thread: Some(thread) }
    }

    fn run(&self, words: &str) -> Output {
        mrroc(words.split(' ').chain(["--can", &self.interfaces[0]]))
    }

    /// Runs a command that must succeed, and returns its output.
    fn says(&self, words: &str) -> String {
        let output = self.run(words);
        assert_eq!(output.status.code(), Some(0), "{words}: {output:?}");
        assert_eq!(output.stderr, "", "{words}: {output:?}");
        output.stdout
    }

    fn unplug(&mut self) -> Vec<SlcanCounts> {
        self.unplugged.store(true, Ordering::Relaxed);
        let thread = self.thread.take().expect("it is unplugged once");
        thread.join().expect("the adapters do not panic")
    }
}

impl Drop for Adapters {
    fn drop(&mut self) {
        self.unplugged.store(true, Ordering::Relaxed);
    }
}

fn serve(mut ptys: Vec<Pty>, nodes: &[u8], unplugged: &AtomicBool) -> Vec<SlcanCounts> {
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let power_on = clock::now();
    for &raw in nodes {
        let node = NodeId::new(raw).unwrap();
        let config = Epos4Config { power_on, ..Epos4Config::new(node, AxisConfig::irp6(Irp6Axis::ALL[0])) };
        world.add_device(bus, Box::new(Epos4::new(config)));
    }
    let adapter = || Box::new(SlcanDevice::new(Bitrate::KBPS_1000));
    let adapters: Vec<_> = ptys.iter().map(|_| world.add_device(bus, adapter())).collect();
    let mut bytes = [0; 4096];
    while !unplugged.load(Ordering::Relaxed) {
        let now = clock::now();
        let mut more = Vec::new();
        for (pty, adapter) in ptys.iter_mut().zip(&adapters) {
            let count = pty.read(&mut bytes).unwrap();
            let change = |device: &mut SlcanDevice| {
                device.handle_bytes(&bytes[..count], now);
                let sent = pty.write(device.bytes()).unwrap();
                device.consume(sent);
                !device.bytes().is_empty()
            };
            more.push(world.change(*adapter, now, change).unwrap());
        }
        world.advance(now);
        let wake = world.next_event().unwrap_or(Instant::FAR_FUTURE);
        let interest = more.into_iter().map(|write| Interest { read: true, write });
        let ends = ptys.iter().map(Pty::as_fd).zip(interest);
        pty::wait(ends, wake.min(now + LOOK)).unwrap();
    }
    let counts = |id: &DeviceId| world.device::<SlcanDevice>(*id).unwrap().counts();
    adapters.iter().map(counts).collect()
}

#[test]
fn service_commands_reach_drives_behind_an_adapter() {
    let _share = processors::take(0.25);
    let adapter = Adapters::with(1, &[3, 7]);
    let found = adapter.says("scan");
    assert_eq!(found.lines().count(), 2, "{found}");
    assert!(found.starts_with("node 3: CiA 402, servo drive"), "{found}");

    // A read of this object shows what the node can store.
    assert_eq!(adapter.says("sdo write 7 0x1010:1 --type u32 0x65766173"), "");
    let wrote = adapter.says("sdo write 7 0x1017 --type u16 50");
    assert_eq!(wrote, "0x1017:00 heartbeat producer time = 0x0032, 50\n");
    // Segmented transfer.
    assert!(adapter.says("sdo read 3 0x1008 --type string").contains('"'));
    assert_eq!(adapter.says("nmt start 7"), "node 7: operational\n");
    let shown = adapter.says("monitor --count 2 --only heartbeat");
    assert!(shown.lines().all(|line| line.ends_with("node 7: operational")), "{shown}");
    let silent = adapter.run("sdo read 9 0x1000 --timeout 100");
    assert_eq!(silent.status.code(), Some(2), "{silent:?}");
    assert!(silent.stderr.contains("its bit rate is right"), "{silent:?}");
}

#[test]
fn a_data_sheet_names_types_and_refuses_before_anything_is_sent() {
    let _share = processors::take(0.25);
    let adapter = Adapters::with(1, &[3]);
    let directory = Directory::new();
    let cell = mrroc::example("irb6").display().to_string();
    let sheet = mrroc(["eds", &cell, "column"]);
    assert_eq!(sheet.status.code(), Some(0), "{sheet:?}");
    let sheet = directory.write("drive.eds", &sheet.stdout).display().to_string();
    let with_sheet = |words: &str| adapter.run(&format!("{words} --eds {sheet}"));

    // The type is not given.
    let wrote = with_sheet("sdo write 3 0x1017 70");
    assert_eq!(wrote.status.code(), Some(0), "{wrote:?}");
    assert!(wrote.stdout.ends_with(" = 0x0046, 70\n"), "{wrote:?}");
    let cases = [
        ("sdo write 3 0x6041 0", "is read-only by"),
        ("sdo write 3 0x1017 65536", "u16"),
        ("sdo read 3 0x5fff", "has no object 0x5fff:00"),
    ];
    for (words, needle) in cases {
        let refused = with_sheet(words);
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        assert_eq!(refused.stderr.lines().count(), 1, "{refused:?}");
        assert!(refused.stderr.contains(needle), "{refused:?}");
    }
}

#[test]
fn a_bit_rate_that_is_not_the_buss_is_silence_and_one_that_slcan_lacks_is_refused() {
    let _share = processors::take(0.25);
    let adapter = Adapters::with(1, &[3]);
    let wrong = adapter.run("scan --bitrate-kbps 500");
    assert_eq!(wrong.status.code(), Some(2), "{wrong:?}");
    assert!(wrong.stderr.to_lowercase().contains("wrong bit rate"), "{wrong:?}");
    let unheard = adapter.run("lss scan --bitrate-kbps 500");
    assert_eq!(unheard.status.code(), Some(1), "{unheard:?}");
    assert!(unheard.stderr.to_lowercase().contains("wrong bit rate"), "{unheard:?}");
    let lacking = adapter.run("scan --bitrate-kbps 40");
    assert_eq!(lacking.status.code(), Some(2), "{lacking:?}");
    assert!(lacking.stderr.contains("slcan has no 40 kbit/s"), "{lacking:?}");
    // The adapter works again at the correct bit rate.
    assert!(adapter.says("scan").starts_with("node 3: "));
}

#[test]
fn a_tty_that_is_not_there_or_no_adapter_is_refused_in_one_line() {
    let _share = processors::take(0.2);
    let mute = Pty::open().unwrap();
    let nobody = format!("slcan:{}", mute.path().display());
    let cases = [
        ("slcan:/dev/serial/by-id/none", "no such device"),
        ("slcan:/dev/null", "not a tty"),
        (&nobody, "no answer: there is no slcan adapter on this tty"),
    ];
    for (interface, needle) in cases {
        let output = mrroc(["scan", "--can", interface]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert_eq!(output.stderr.lines().count(), 1, "{output:?}");
        assert!(output.stderr.contains(needle), "{output:?}");
    }
}

#[test]
fn a_broken_off_layer_setting_service_sends_all_slaves_back_to_waiting_mode() {
    let _share = processors::take(0.25);
    let adapters = Adapters::with(2, &[3]);
    let [here, there] = &adapters.interfaces[..] else {
        panic!("two adapters");
    };
    let monitor = Running::start(["monitor", "--only", "lss", "--can", there]);
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    // No node has this identity.
    let inquire = "lss inquire --identity 1:2:3:4 --timeout 60000 --can";
    let inquire = Running::start(inquire.split(' ').chain([here.as_str()]));
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    inquire.signal("INT");
    assert_eq!(inquire.output().status.code(), Some(1));
    monitor.signal("INT");
    let heard = monitor.output().stdout;
    let mode = |line: &&str| line.contains("7E5#04");
    assert_eq!(heard.lines().filter(mode).count(), 2, "{heard}");
    assert!(heard.lines().next_back().is_some_and(|line| mode(&line)), "{heard}");
}

#[test]
fn an_adapter_that_is_unplugged_ends_a_monitor() {
    let _share = processors::take(0.25);
    let mut adapter = Adapters::with(1, &[3]);
    let heartbeat = "sdo write 3 0x1017 --type u16 20 --no-read-back";
    assert_eq!(adapter.says(heartbeat), "");
    let monitor = Running::start(["monitor", "--can", &adapter.interfaces[0]]);
    clock::sleep_until(clock::now() + Duration::from_secs(1));
    adapter.unplug();
    let ended = monitor.output();
    assert_eq!(ended.status.code(), Some(2), "{ended:?}");
    assert!(ended.stderr.contains("removed"), "{ended:?}");
    assert!(ended.stdout.contains("node 3: pre-operational"), "{ended:?}");
}

#[test]
fn an_arm_runs_over_one_adapter_with_its_drives_emulated_behind_another() {
    by_the_clock(0.45, LATE, || {
        let mut adapters = Adapters::with(2, &[]);
        let directory = Directory::new();
        // Time limits as on the other benches on the wall clock.
        let cell = directory.cell("irb6", |cell| {
            mrroc::shorten(cell);
            cell.robot[0].program.truncate(1);
            cell.period_us = 10_000;
            cell.macrostep = 4;
            cell.max_missed_in_row = 300;
            cell.bus[0].tolerated_missing = 50;
            cell.bus[0].heartbeat_ms = 1000;
            cell.bus[0].boot_timeout_ms = 10_000;
            for axis in &mut cell.robot[0].axis {
                axis.following_error = 100.0;
            }
        });
        let [here, there] = &adapters.interfaces[..] else {
            panic!("two adapters");
        };
        let cell = cell.display().to_string();
        let emulators = Running::start(["emulate", &cell, "--can", there]);
        let trace = directory.path("trace.log").display().to_string();
        let run = ["run", &cell, "--bench", "card", "--can", here, "--json", "--trace", &trace];
        let run = mrroc(run);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        assert_eq!(report["outcome"], "completed", "{report}");
        let wire = &report["wire"][0];
        assert!(wire["source"].is_null() && wire["sync_to_sync_us"].is_null(), "{wire}");
        assert!(mrroc::enables(&mrroc::trace(&directory.path("trace.log"))) > 100);
        emulators.signal("INT");
        assert_eq!(emulators.output().status.code(), Some(0));
        let counts = adapters.unplug();
        let [here, there] = counts[..] else {
            panic!("two adapters");
        };
        // Closing an adapter loses the frames on their way, on a loaded host those of ten cycles: SYNC and five RPDOs each, or
        // five TPDOs.
        for (sent, received) in [(here.sent, there.received), (there.sent, here.received)] {
            assert!((received..=received + 60).contains(&sent), "{sent} {received}");
        }
        for counts in [here, there] {
            // The closing may cut off a frame that the line has taken only in part. The adapter refuses such a frame.
            assert!(counts.refused <= 1 && (counts.lost, counts.unsaid) == (0, 0), "{counts:?}");
        }
    });
}
