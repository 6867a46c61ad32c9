//! python-canopen as a drive: our SDO client, NMT master and drive group command it.

use std::time::Duration;

use can::{Instant, Port, Received, SocketCanOptions, SocketCanPort, clock};
use canopen::nmt::{Command, Event, Master, State};
use canopen::objects::{
    DEVICE_NAME, DEVICE_TYPE, PRODUCER_HEARTBEAT, PROFILE_VELOCITY, STATUSWORD,
};
use canopen::sdo::{AbortCode, Client, SdoError, StartError};
use canopen::sync::Sync;
use canopen::{NodeId, Object};
use drive::cia402::{AxisConfig, Cia402Group, GroupConfig};
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Homing, Power, Setpoint};

use super::{Bus, Script, python};
use crate::vcan::{Stage, on_stage};

const NODE: NodeId = NodeId::new(1).unwrap();

/// Longest time that anything here may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// Our end of the bus, waiting as the console's commands do.
struct Host {
    port: SocketCanPort,
    nodes: Master,
    client: Client,
}

impl Host {
    fn new(stage: &Stage) -> Self {
        Self {
            port: SocketCanPort::open(stage.interface, &SocketCanOptions::default()).unwrap(),
            nodes: Master::new(),
            client: Client::new(NODE, Duration::from_secs(1), 0),
        }
    }

    /// Receives until `done`; panics at the deadline.
    fn until<T>(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> Option<T>) -> T {
        let end = clock::now() + PATIENCE;
        loop {
            if let Some(it) = done(self) {
                return it;
            }
            assert!(clock::now() < end, "waited too long: {what}");
            if let Some(frame) = self.client.poll_transmit(clock::now()) {
                assert_eq!(self.port.send(clock::now(), &[frame]), Ok(1));
            }
            let look = clock::now() + Duration::from_millis(20);
            self.port.wait_readable(look).unwrap();
            for Received { frame, .. } in self.receive() {
                self.nodes.handle(&frame);
                self.client.handle(&frame, clock::now());
            }
            self.client.handle_timeout(clock::now());
        }
    }

    fn receive(&mut self) -> Vec<Received> {
        let nothing = Received {
            frame: Sync::default().encode(),
            at: Instant::ZERO,
        };
        let mut received = [nothing; 32];
        let count = self.port.receive(clock::now(), &mut received).unwrap();
        received[..count].to_vec()
    }

    fn command(&mut self, command: Command) {
        let frame = self.nodes.command(command.to(NODE));
        assert_eq!(self.port.send(clock::now(), &[frame]), Ok(1));
    }

    fn hears(&mut self, event: Event) {
        self.until(&format!("{event:?}"), |host| {
            std::iter::from_fn(|| host.nodes.poll()).find(|it| *it == event)
        });
    }

    fn transfer(
        &mut self,
        begin: impl FnOnce(&mut Client, Instant) -> Result<(), StartError>,
    ) -> Result<Vec<u8>, SdoError> {
        begin(&mut self.client, clock::now()).unwrap();
        self.until("a transfer", |host| {
            let result = host.client.poll()?;
            Some(result.map(|transfer| transfer.data.to_vec()))
        })
    }

    fn upload(&mut self, object: Object) -> Result<Vec<u8>, SdoError> {
        self.transfer(|client, now| client.upload(object, now))
    }

    fn download(&mut self, object: Object, data: &[u8]) -> Result<(), SdoError> {
        self.transfer(|client, now| client.download(object, data, now))
            .map(|_| ())
    }

    fn refuses(&mut self, object: Object, data: &[u8], code: AbortCode) {
        let refused = self.download(object, data);
        assert_eq!(refused, Err(SdoError::Aborted { object, code }));
    }
}

/// Runs `body` beside a LocalNode that has booted.
fn beside_a_local_node(test: &str, body: impl FnOnce(&Stage, Host)) {
    let Some(python) = python(test) else { return };
    on_stage(test, |stage| {
        let mut host = Host::new(stage);
        let bus = Bus::socketcan(stage.interface);
        let mut script = bus.script(&python, "slave.py");
        let _slave = Script::start(script.args(["--node", &NODE.raw().to_string()]));
        host.hears(Event::Booted(NODE));
        body(stage, host);
    });
}

#[test]
fn the_service_client_reads_and_writes_a_local_node() {
    let test = "peers::slave::the_service_client_reads_and_writes_a_local_node";
    beside_a_local_node(test, |_, mut host| {
        assert_eq!(
            host.upload(DEVICE_TYPE),
            Ok(0x0002_0192_u32.to_le_bytes().into())
        );
        assert_eq!(host.upload(DEVICE_NAME).as_deref(), Ok(&b"EPOS4"[..]));
        for (object, data) in [
            (PROFILE_VELOCITY, &0x1234_5678_u32.to_le_bytes()[..]),
            (PRODUCER_HEARTBEAT, &0_u16.to_le_bytes()),
        ] {
            assert_eq!(host.download(object, data), Ok(()));
            assert_eq!(host.upload(object).as_deref(), Ok(data));
        }
        host.refuses(STATUSWORD, &[0, 0], AbortCode::READ_ONLY);
        host.refuses(Object::new(0x5FFF, 0), &[0], AbortCode::NO_OBJECT);
        host.refuses(Object::new(0x1018, 9), &[0], AbortCode::NO_SUBINDEX);
        // Longer than a frame, so in segments, the last of which brings the refusal.
        host.refuses(PROFILE_VELOCITY, &[0; 20], AbortCode::LENGTH_MISMATCH);
        assert_eq!(
            host.upload(PROFILE_VELOCITY),
            Ok(0x1234_5678_u32.to_le_bytes().into())
        );
        // LocalNode refuses blocks one way and answers with an ordinary transfer the other way.
        let domain = Object::new(0x2F00, 0);
        let long: Vec<_> = (0..200).collect();
        let download = |client: &mut Client, now| client.block_download(domain, &long, now);
        assert_eq!(host.transfer(download).map(|_| ()), Ok(()));
        assert_eq!(host.upload(domain).as_deref(), Ok(&long[..]));
        let upload = |client: &mut Client, now| client.block_upload(domain, now);
        assert_eq!(host.transfer(upload).as_deref(), Ok(&long[..]));
    });
}

#[test]
fn the_network_master_commands_a_local_node() {
    let test = "peers::slave::the_network_master_commands_a_local_node";
    beside_a_local_node(test, |_, mut host| {
        let heartbeat = 20_u16.to_le_bytes();
        assert_eq!(host.download(PRODUCER_HEARTBEAT, &heartbeat), Ok(()));
        for (command, state) in [
            (Command::Start, State::Operational),
            (Command::Stop, State::Stopped),
            (Command::EnterPreOperational, State::PreOperational),
        ] {
            host.command(command);
            host.hears(Event::Changed { node: NODE, state });
        }
        for reset in [Command::ResetNode, Command::ResetCommunication] {
            assert_eq!(host.download(PRODUCER_HEARTBEAT, &heartbeat), Ok(()));
            host.command(reset);
            host.hears(Event::Booted(NODE));
            assert_eq!(host.upload(PRODUCER_HEARTBEAT).as_deref(), Ok(&[0, 0][..]));
        }
    });
}

/// One axis, patient with a Python that shares one processor with us.
fn one_axis(stage: &Stage) -> (GroupConfig, Vec<AxisConfig>) {
    let group = GroupConfig {
        period: Duration::from_millis(20),
        tolerated_missing: 50,
        ..stage.cell.group_config(0)
    };
    (group, vec![stage.cell.robot[0].axis[0].drive_config(0.0)])
}

#[test]
fn a_drive_group_runs_a_local_node() {
    let test = "peers::slave::a_drive_group_runs_a_local_node";
    beside_a_local_node(test, |stage, host| {
        let (config, axes) = one_axis(stage);
        let period = config.period;
        let mut group = Cia402Group::new(host.port, config, &axes).unwrap();
        let mut now = clock::now();
        let end = now + PATIENCE;
        while group.bring_up(now).map(Result::unwrap).is_pending() {
            assert!(now < end, "not up");
            now += Duration::from_millis(1);
            clock::sleep_until(now);
        }
        let mut state = AxisState::default();
        let mut cycles = |command: &dyn Fn(usize) -> AxisCommand,
                          done: &dyn Fn(&AxisState) -> bool| {
            let mut now = clock::now();
            for cycle in 0..500 {
                group.read(now, std::slice::from_mut(&mut state));
                assert_eq!(state.fault, None, "{state:?}");
                if done(&state) {
                    return (cycle, state);
                }
                group.write(now, &[command(cycle)]);
                group.send(now);
                now += period;
                clock::sleep_until(now);
            }
            panic!("not reached: {state:?}");
        };
        cycles(&|_| AxisCommand::Stand, &|state| state.power == Power::On);
        let (_, homed) = cycles(&|_| AxisCommand::Home, &|state| {
            state.homing == Homing::Attained
        });
        assert_eq!(homed.increments.0, 0);
        // A turn, and half of it back: the drive is where it was told to be, to an increment.
        let way = |cycle: usize| {
            let turn = std::f64::consts::TAU;
            let after = cycle as f64 / 100.0;
            turn * if after < 1.0 {
                after
            } else {
                (2.0 - after).max(0.5)
            }
        };
        let follow =
            |cycle| AxisCommand::Follow(Setpoint::Position(Finite::new(way(cycle)).unwrap()));
        let drive = stage.cell.robot[0].axis[0].drive.as_ref().unwrap();
        let counts = drive.counts_per_revolution;
        let full = |state: &AxisState| i64::from(state.increments.0) == i64::from(counts);
        cycles(&follow, &full);
        let (_, stood) = cycles(&|cycle| follow(cycle + 100), &|state| {
            i64::from(state.increments.0) == i64::from(counts / 2)
        });
        assert!(stood.following);
        cycles(&|_| AxisCommand::Off, &|state| state.power == Power::Off);
        let counters = group.counters();
        assert_eq!(
            (counters.unexpected, counters.dropped_syncs),
            (0, 0),
            "{counters:?}"
        );
    });
}
