//! `mrroc emulate --slcan`: an arm behind an emulated adapter, accessed as behind any slcan adapter.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::time::Duration;

use can::slcan::{AdapterReport, Command, Splitter};
use can::timing::Bitrate;
use can::{Frame, Instant, clock};
use canopen::sdo::{Expedited, Initiate, Request, Response};
use canopen::{NodeId, nmt, objects};
use hil::pty::{self, Interest};
use kit::mrroc::{Directory, Running, text};
use kit::processors;

/// Upper bound for the duration of every step.
const DEADLINE: Duration = Duration::from_secs(30);

/// Time after which a request is repeated, because a booting drive does not answer.
const AGAIN: Duration = Duration::from_millis(200);

/// The host's end of an adapter.
struct Host {
    tty: File,
    splitter: Splitter,
    reports: Vec<AdapterReport>,
}

impl Host {
    /// Opens the tty as soon as it exists.
    fn open(link: &Path) -> Self {
        let end = clock::now() + DEADLINE;
        while fs::symlink_metadata(link).is_err() {
            assert!(clock::now() < end, "no link appeared");
            clock::sleep_until(clock::now() + Duration::from_millis(10));
        }
        let tty = File::options().read(true).write(true).open(link).unwrap();
        Self { tty, splitter: Splitter::default(), reports: Vec::new() }
    }

    fn say(&mut self, command: Command) {
        self.tty.write_all(&command.encode().unwrap()).unwrap();
    }

    /// Reads reports until `wanted` accepts one, or until `until`.
    fn hear(&mut self, until: Instant, wanted: impl Fn(&AdapterReport) -> bool) -> bool {
        loop {
            if let Some(at) = self.reports.iter().position(&wanted) {
                self.reports.drain(..=at);
                return true;
            }
            if clock::now() >= until {
                return false;
            }
            let readable = Interest { read: true, write: false };
            pty::wait([(self.tty.as_fd(), readable)], until).unwrap();
            if clock::now() >= until {
                return false;
            }
            let mut bytes = [0; 512];
            let count = self.tty.read(&mut bytes).unwrap();
            for &byte in &bytes[..count] {
                if let Some(piece) = self.splitter.push(byte) {
                    self.reports.push(AdapterReport::parse(piece).unwrap());
                }
            }
        }
    }

    /// Sends a frame repeatedly until `answer` is received.
    fn ask(&mut self, frame: Frame, answer: Frame) {
        let answered =
            |report: &AdapterReport| matches!(report, AdapterReport::Received { frame, .. } if *frame == answer);
        let end = clock::now() + DEADLINE;
        while clock::now() < end {
            self.say(Command::Transmit(frame));
            if self.hear(clock::now() + AGAIN, answered) {
                return;
            }
        }
        panic!("no {answer} came; last {:?}", self.reports);
    }
}

#[test]
fn drives_behind_an_adapter_answer_and_the_adapter_goes_with_its_emulator() {
    let _share = processors::take(0.25);
    let directory = Directory::new();
    let cell = directory.write("cell.toml", &text("irb6"));
    let link = directory.path("can0");
    let emulator = Running::start(["emulate".as_ref(), cell.as_os_str(), "--slcan".as_ref(), link.as_os_str()]);
    let mut host = Host::open(&link);
    let soon = clock::now() + DEADLINE;
    for command in [Command::Close, Command::Bitrate(Bitrate::KBPS_1000), Command::Open] {
        host.say(command);
        assert!(host.hear(soon, |report| *report == AdapterReport::Done));
    }
    for number in 1..=5 {
        let node = NodeId::new(number).unwrap();
        let object = objects::VENDOR_ID;
        let initiate = Initiate::Expedited(Expedited::from(0x0000_00FB_u32));
        host.ask(
            Request::InitiateUpload { object }.encode(node),
            Response::InitiateUpload { object, initiate }.encode(node),
        );
    }
    // All nodes receive the command and boot.
    let reset = nmt::Command::ResetNode.to_all();
    host.say(Command::Transmit(reset.encode()));
    let booted = |report: &AdapterReport| matches!(report, AdapterReport::Received { frame, .. } if frame.to_string() == "705#00");
    assert!(host.hear(soon, booted));
    emulator.signal("INT");
    let output = emulator.output();
    assert!(output.status.success(), "{output:?}");
    assert!(output.stdout.contains("behind"), "{output:?}");
    assert!(fs::symlink_metadata(&link).is_err());
}
