//! python-canopen as a drive, commanded by this project's SDO client, NMT master and drive group.

use std::path::Path;

use canopen::nmt::{Command, NmtState};
use canopen::objects::{DEVICE_NAME, DEVICE_TYPE, PRODUCER_HEARTBEAT, PROFILE_VELOCITY, STATUSWORD};
use canopen::sdo::AbortCode;
use canopen::{NodeId, Object};
use kit::bench::bodies_on_vcan;
use master::sdo::Client;

use super::group::run_as_drives;
use super::host::Host;
use super::{Bus, Script, python};
use crate::vcan::Stage;

const NODE: NodeId = NodeId::new(1).unwrap();

/// A body beside a LocalNode, with the name of its claim.
type Body = (&'static str, fn(&Stage, Host));

/// Runs `body` with a LocalNode that has booted.
fn beside_a_local_node(python: &Path, stage: &Stage, body: fn(&Stage, Host)) {
    let mut host = Host::new(stage.interface, NODE);
    let bus = Bus::socketcan(stage.interface);
    let mut script = bus.script(python, "slave.py");
    let _slave = Script::start(script.args(["--node", &NODE.raw().to_string()]));
    host.hears(NmtState::Initialising);
    body(stage, host);
}

#[test]
fn python_canopen_as_a_drive() {
    let test = "peers::slave::python_canopen_as_a_drive";
    let Some(python) = python(test) else { return };
    let bodies: [Body; 3] = [
        ("the service client reads and writes a local node", the_service_client_reads_and_writes_a_local_node),
        ("a local node obeys network commands", a_local_node_obeys_network_commands),
        ("a drive group runs a local node", |stage, _| run_as_drives(stage, &[&|_| {}])),
    ];
    bodies_on_vcan(test, &bodies, |interface, body| beside_a_local_node(&python, &Stage::on(interface), *body));
}

fn the_service_client_reads_and_writes_a_local_node(_: &Stage, mut host: Host) {
    assert_eq!(host.upload(DEVICE_TYPE), Ok(0x0002_0192_u32.to_le_bytes().into()));
    assert_eq!(host.upload(DEVICE_NAME).as_deref(), Ok(&b"EPOS4"[..]));
    for (object, data) in
        [(PROFILE_VELOCITY, &0x1234_5678_u32.to_le_bytes()[..]), (PRODUCER_HEARTBEAT, &0_u16.to_le_bytes())]
    {
        assert_eq!(host.download(object, data), Ok(()));
        assert_eq!(host.upload(object).as_deref(), Ok(data));
    }
    host.refuses(STATUSWORD, &[0, 0], AbortCode::READ_ONLY);
    host.refuses(Object::new(0x5FFF, 0), &[0], AbortCode::NO_OBJECT);
    host.refuses(Object::new(0x1018, 9), &[0], AbortCode::NO_SUBINDEX);
    // The value is longer than a frame, so it is sent in segments. The refusal answers the last segment.
    host.refuses(PROFILE_VELOCITY, &[0; 20], AbortCode::LENGTH_MISMATCH);
    assert_eq!(host.upload(PROFILE_VELOCITY), Ok(0x1234_5678_u32.to_le_bytes().into()));
    // LocalNode refuses block download, and answers block upload with an ordinary transfer.
    let domain = Object::new(0x2F00, 0);
    let long: Vec<_> = (0..200).collect();
    let download = |client: &mut Client, now| client.block_download(domain, &long, now);
    assert_eq!(host.transfer(download).map(|_| ()), Ok(()));
    assert_eq!(host.upload(domain).as_deref(), Ok(&long[..]));
    let upload = |client: &mut Client, now| client.block_upload(domain, now);
    assert_eq!(host.transfer(upload).as_deref(), Ok(&long[..]));
}

fn a_local_node_obeys_network_commands(_: &Stage, mut host: Host) {
    let heartbeat = 20_u16.to_le_bytes();
    assert_eq!(host.download(PRODUCER_HEARTBEAT, &heartbeat), Ok(()));
    for (command, state) in [
        (Command::Start, NmtState::Operational),
        (Command::Stop, NmtState::Stopped),
        (Command::EnterPreOperational, NmtState::PreOperational),
    ] {
        host.command(command);
        host.hears(state);
    }
    for reset in [Command::ResetNode, Command::ResetCommunication] {
        assert_eq!(host.download(PRODUCER_HEARTBEAT, &heartbeat), Ok(()));
        host.command(reset);
        host.hears(NmtState::Initialising);
        assert_eq!(host.upload(PRODUCER_HEARTBEAT).as_deref(), Ok(&[0, 0][..]));
    }
}
