//! LSS master and slaves: drives without node-IDs on a bus receive node-IDs, in virtual time.

use std::time::Duration;

use can::timing::Bitrate;
use can::{Frame, Instant, Port, Received, StandardId, VirtualPort};
use canopen::NodeId;
use canopen::lss::{Identity, Mode};
use hil::{AxisConfig, Epos4, Epos4Config, Irp6Axis, World};
use master::lss::{Answer, LssError, Master, Service};

const TICK: Duration = Duration::from_millis(1);

const TIME_OUT: Duration = Duration::from_millis(5);

struct Bench {
    world: World,
    port: VirtualPort,
    master: Master,
    now: Instant,
    /// Frames other than LSS, in the notation of candump.
    heard: Vec<String>,
}

impl Bench {
    fn new(drives: &[(Option<u8>, u32)]) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 64);
        for &(node, serial) in drives {
            let axis = AxisConfig::wut(Irp6Axis::ALL[0]);
            let config =
                Epos4Config { node: node.and_then(NodeId::new), serial, ..Epos4Config::new(NodeId::MAX, axis) };
            world.add_device(bus, Box::new(Epos4::new(config)));
        }
        let mut bench = Self { world, port, master: Master::default(), now: Instant::ZERO, heard: Vec::new() };
        bench.run(100);
        bench
    }

    fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            while let Some(frame) = self.master.poll_transmit(self.now) {
                assert_eq!(self.port.send(self.now, &[frame]), Ok(1));
            }
            self.now += TICK;
            self.world.advance(self.now);
            let filler = Frame::new(StandardId::MAX, &[]).unwrap();
            let mut received = [Received { frame: filler, at: Instant::ZERO }; 64];
            let count = self.port.receive(self.now, &mut received).unwrap();
            for Received { frame, at } in &received[..count] {
                self.master.handle(frame, *at);
                if frame.standard_data_id() != Some(canopen::cob::LSS_RESPONSE) {
                    self.heard.push(frame.to_string());
                }
            }
            self.master.handle_timeout(self.now);
        }
    }

    fn ask(&mut self, service: Service) -> Result<Answer, LssError> {
        self.master.start(service, TIME_OUT, self.now).unwrap();
        for _ in 0..2000 {
            self.run(1);
            if let Some(result) = self.master.poll() {
                return result;
            }
        }
        panic!("{service} has no end");
    }

    fn heard(&mut self) -> Vec<String> {
        std::mem::take(&mut self.heard)
    }
}

fn identity(serial: u32) -> Identity {
    Identity { vendor: 0x0000_00FB, product: 0x6150_0000, revision: 0x0170_0000, serial }
}

#[test]
fn drives_without_node_ids_are_found_one_by_one_and_boot_under_new_ones() {
    let mut bench = Bench::new(&[(None, 0x1000_0007), (Some(3), 1), (None, 0x1000_0005)]);
    assert_eq!(bench.heard(), ["703#00"]);
    for (serial, node, boot) in [(0x1000_0005, 0x11, "711#00"), (0x1000_0007, 0x12, "712#00")] {
        let unconfigured = bench.ask(Service::IdentifyUnconfigured);
        assert_eq!(unconfigured, Ok(Answer::Unconfigured(true)));
        let found = bench.ask(Service::Fastscan);
        assert_eq!(found, Ok(Answer::Found(Some(identity(serial)))));
        for service in
            [Service::ConfigureNodeId(NodeId::new(node)), Service::Store, Service::SwitchGlobal(Mode::Waiting)]
        {
            assert_eq!(bench.ask(service), Ok(Answer::Done), "{service}");
        }
        bench.run(100);
        assert_eq!(bench.heard(), [boot]);
    }
    let unconfigured = bench.ask(Service::IdentifyUnconfigured);
    assert_eq!(unconfigured, Ok(Answer::Unconfigured(false)));
    assert_eq!(bench.ask(Service::Fastscan), Ok(Answer::Found(None)));
}

#[test]
fn a_drive_is_selected_by_its_identity_and_says_who_it_is() {
    let mut bench = Bench::new(&[(Some(3), 1), (Some(4), 2)]);
    let selected = bench.ask(Service::SwitchSelective(identity(2)));
    assert_eq!(selected, Ok(Answer::Done));
    let said = bench.ask(Service::InquireIdentity);
    assert_eq!(said, Ok(Answer::Identity(identity(2))));
    let said = bench.ask(Service::InquireNodeId);
    assert_eq!(said, Ok(Answer::NodeId(NodeId::new(4))));
    bench.ask(Service::SwitchGlobal(Mode::Waiting)).unwrap();
    let nobody = bench.ask(Service::SwitchSelective(identity(3)));
    assert!(matches!(nobody, Err(LssError::TimedOut { .. })), "{nobody:?}");
}
