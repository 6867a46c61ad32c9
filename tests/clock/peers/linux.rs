//! can-utils and the kernel's own drivers as peers.

use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use can::candump::Direction;
use can::{Frame, Instant, Port, Received, SocketCanOptions, SocketCanPort, StandardId, Tracer, clock};
use kit::bench::on_vcan;

use crate::socketcan::{Vcan, sh};
use crate::vcan::{frames_of, on_stage, started, wait_until};

/// Upper bound for the duration of every step.
const PATIENCE: Duration = Duration::from_secs(30);

pub(super) fn open(interface: &str) -> SocketCanPort {
    SocketCanPort::open(interface, &SocketCanOptions::default()).unwrap()
}

/// Receives until there are `count` frames.
fn receive(port: &mut (impl Port + ?Sized), count: usize) -> Vec<Frame> {
    let end = clock::now() + PATIENCE;
    let mut into = [Received { frame: sequence(0), at: Instant::ZERO }; 64];
    let mut all = Vec::new();
    while all.len() < count && clock::now() < end {
        let some = port.receive(clock::now(), &mut into).unwrap();
        all.extend(into[..some].iter().map(|received| received.frame));
        if some == 0 {
            clock::sleep_until(clock::now() + Duration::from_millis(1));
        }
    }
    all
}

/// Frame `number` of a sequence of cansequence.
pub(super) fn sequence(number: usize) -> Frame {
    Frame::new(StandardId::new(2).unwrap(), &[number as u8]).unwrap()
}

/// A process killed on drop.
pub(super) struct Killed(pub(super) Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn cansend_asks_a_drive_and_canplayer_plays_the_session_back() {
    let test = "peers::linux::cansend_asks_a_drive_and_canplayer_plays_the_session_back";
    on_stage(test, |stage| {
        let log = stage.directory.path("bus.log");
        let candump = stage.start_candump();
        let emulators = stage.start_emulators();
        let logged = || fs::read_to_string(&log).unwrap();
        // Each drive boots once after its start. A reset before that boot, and the answer to it, could not be
        // distinguished from it.
        wait_until("every drive boots", || (1..=5).all(|node| logged().contains(&format!(" 70{node}#00"))));
        for (said, answer) in [
            ("000#8101", " 701#00"),
            ("601#4000100000000000", " 581#4300100092010200"),
            ("601#4041600000000000", " 581#4B416000"),
            ("601#40FF5F0000000000", " 581#80FF5F0000000206"),
            ("601#2F60600008000000", " 581#6060600000000000"),
        ] {
            // A booting drive does not process requests. Only an answer after the request is therefore the answer to
            // it.
            let before = logged().len();
            sh(&format!("cansend {} {said}", stage.interface));
            wait_until(answer, || logged()[before..].contains(answer));
        }
        drop((emulators, candump));
        let session: Vec<_> = frames_of(&log).iter().map(|it| it.frame).collect();
        assert!(session.len() >= 10, "{session:?}");

        let (mut port, mut trace) = Tracer::new(open(stage.interface), 256);
        sh(&format!("canplayer -I {}", log.display()));
        assert_eq!(receive(&mut port, session.len()), session);
        let traced: Vec<_> = std::iter::from_fn(|| trace.read()).collect();
        assert!(traced.iter().all(|it| it.direction == Direction::Received));
        let traced: Vec<_> = traced.iter().map(|it| it.frame).collect();
        assert_eq!((traced, trace.lost()), (session, 0));
    });
}

/// Number of frames in each direction: one second of a fully loaded bus.
const COUNT: usize = 8_000;

#[test]
fn cansequence_counts_our_frames_and_we_count_its_own() {
    let test = "peers::linux::cansequence_counts_our_frames_and_we_count_its_own";
    on_vcan(test, |_| {
        let bus = Vcan::new("vcansequence");
        sh(&format!("tc qdisc add dev {} root tbf rate 1mbit burst 200 limit 1600", bus.0));
        let mut port = open(bus.0);
        let sender = Command::new("cansequence")
            .args([bus.0, "--poll", &format!("--loop={COUNT}")])
            .stdout(Stdio::null())
            .spawn();
        let sender = Killed(sender.unwrap());
        let received = receive(&mut port, COUNT);
        let expected: Vec<_> = (0..COUNT).map(sequence).collect();
        assert!(received == expected, "{} of {COUNT} in order", received.len());
        assert_eq!(port.counters().dropped, 0);
        drop(sender);

        // cansequence uses the default receive queue of some 280 frames and shares the processor with this test.
        let queue = "/proc/sys/net/core/rmem_default";
        let default = fs::read_to_string(queue).unwrap();
        fs::write(queue, (COUNT << 10).to_string()).unwrap();
        let mut receiver = started(|| {
            let receiver = Command::new("cansequence")
                .args([bus.0, "--receive", "--quit", "1"])
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn();
            Killed(receiver.unwrap())
        });
        fs::write(queue, default).unwrap();
        let mut taken = 0;
        let end = clock::now() + PATIENCE;
        while taken < COUNT && clock::now() < end {
            let some = expected.len().min(taken + 32);
            taken += port.send(clock::now(), &expected[taken..some]).unwrap();
            clock::sleep_until(clock::now() + Duration::from_millis(1));
        }
        assert_eq!(taken, COUNT);
        // cansequence ends at the first frame out of order, which is this one.
        clock::sleep_until(clock::now() + Duration::from_millis(100));
        assert_eq!(receiver.0.try_wait().unwrap(), None, "it missed a frame");
        assert_eq!(port.send(clock::now(), &[sequence(COUNT + 1)]), Ok(1));
        wait_until("cansequence ends", || receiver.0.try_wait().unwrap().is_some());
    });
}
