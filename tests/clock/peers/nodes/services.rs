//! SDO, NMT and EMCY between this project's host and one peer.

use canopen::Object;
use canopen::emcy::Emergency;
use canopen::nmt::{Command, NmtState};
use canopen::objects::{DEVICE_NAME, DEVICE_TYPE, PRODUCER_HEARTBEAT, VENDOR_ID};
use canopen::sdo::AbortCode;

use super::super::host::Host;
use super::table::Peer;
use super::{EMERGENCY, NUMBER, SHORT};

const BYTE: Object = Object::new(0x2002, 0);

const DOMAIN: Object = Object::new(0x2F00, 0);

/// Lengths around the limits of frames (4, 7) and of blocks of 127 segments (889), and the longest value that all peers
/// store.
const SEGMENTED: &[usize] = &[0, 1, 4, 5, 6, 7, 8, 13, 14, 15, 200, 1022];

const BLOCKS: &[usize] = &[29, 35, 888, 889, 890, 1022];

type Check = fn(&mut Host, &Peer);

/// All checks, each with its claim.
pub(super) const CHECKS: [(&str, Check); 7] = [
    ("its identity is read", identity),
    ("it obeys NMT commands and says so", network_management),
    ("numbers of every size are written and read back", numbers),
    ("segments carry every length both ways", segments),
    ("blocks carry every length both ways", blocks),
    ("it refuses as it should", refusals),
    ("its emergencies are understood", emergencies),
];

fn identity(host: &mut Host, peer: &Peer) {
    let [vendor, product, revision] = peer.identity;
    for (subindex, number) in (1..).zip([vendor, product, revision, peer.serial]) {
        let object = Object::new(VENDOR_ID.index, subindex);
        assert_eq!(host.upload(object), Ok(number.to_le_bytes().into()));
    }
    let device_type = peer.device_type.to_le_bytes();
    assert_eq!(host.upload(DEVICE_TYPE), Ok(device_type.into()));
    let name = host.upload(DEVICE_NAME);
    assert_eq!(name.as_deref(), Ok(peer.own_name().as_bytes()));
}

fn network_management(host: &mut Host, peer: &Peer) {
    let heartbeat = 50_u16.to_le_bytes();
    let own = peer.constant_heartbeat.map(u16::to_le_bytes);
    match own {
        Some(_) => host.refuses(PRODUCER_HEARTBEAT, &heartbeat, AbortCode::READ_ONLY),
        None => assert_eq!(host.download(PRODUCER_HEARTBEAT, &heartbeat), Ok(())),
    }
    for (order, state) in [
        (Command::Start, NmtState::Operational),
        (Command::Stop, NmtState::Stopped),
        (Command::EnterPreOperational, NmtState::PreOperational),
        (Command::Start, NmtState::Operational),
    ] {
        host.command(order);
        host.hears(state);
    }
    for reset in [Command::ResetNode, Command::ResetCommunication] {
        host.command(reset);
        host.hears(peer.boots_as);
        let left = match (own, peer.restores) {
            (Some(own), _) => own,
            (None, true) => [0, 0],
            (None, false) => heartbeat,
        };
        assert_eq!(host.upload_after_reset(PRODUCER_HEARTBEAT), Ok(left.into()));
    }
}

fn numbers(host: &mut Host, _: &Peer) {
    for (object, data) in
        [(BYTE, &[0xA5][..]), (SHORT, &[0xFE, 0xFF]), (NUMBER, &[0x78, 0x56, 0x34, 0x12]), (NUMBER, &[0, 0, 0, 0x80])]
    {
        assert_eq!(host.download(object, data), Ok(()));
        assert_eq!(host.upload(object).as_deref(), Ok(data));
    }
}

/// Test data: neighbouring bytes differ, and so do data of different lengths.
fn bytes(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 31 + length) as u8).collect()
}

fn segments(host: &mut Host, peer: &Peer) {
    for length in SEGMENTED.iter().copied().filter(|it| (peer.lengths)(*it)) {
        let data = bytes(length);
        assert_eq!(host.download(DOMAIN, &data), Ok(()), "{length} bytes");
        let expected = if length == 0 { peer.empty } else { &data };
        let uploaded = host.upload(DOMAIN);
        assert_eq!(uploaded.as_deref(), Ok(expected), "{length} bytes");
    }
}

fn blocks(host: &mut Host, peer: &Peer) {
    for length in BLOCKS.iter().copied().filter(|it| (peer.lengths)(*it)) {
        let data = bytes(length);
        assert_eq!(host.block_download(DOMAIN, &data), Ok(()), "{length} bytes");
        let segmented = host.upload(DOMAIN);
        assert_eq!(segmented.as_deref(), Ok(&data[..]), "{length} bytes");
        let uploaded = host.block_upload(DOMAIN);
        if (peer.blocks)(length) {
            assert_eq!(uploaded, Ok(data), "{length} bytes");
        } else {
            // Damaged data must be refused.
            assert!(uploaded.is_err(), "{length} bytes: {uploaded:?}");
        }
    }
}

fn refusals(host: &mut Host, peer: &Peer) {
    let nowhere = Object::new(0x5FFF, 0);
    host.hides(nowhere, AbortCode::NO_OBJECT);
    host.refuses(nowhere, &[0], AbortCode::NO_OBJECT);
    host.hides(Object::new(0x1018, 9), peer.no_subindex);
    host.refuses(DEVICE_TYPE, &[0; 4], AbortCode::READ_ONLY);
    host.refuses(NUMBER, &[0; 2], peer.too_short);
    host.refuses(SHORT, &[0; 4], peer.too_long);
    host.refuses(NUMBER, &[0; 20], peer.too_long);
    assert_eq!(host.upload(NUMBER), Ok(vec![0, 0, 0, 0x80]));
}

fn emergencies(host: &mut Host, peer: &Peer) {
    if !peer.emergencies {
        return host.hides(EMERGENCY, AbortCode::NO_OBJECT);
    }
    for (code, register, vendor) in [(0x8611_u16, 0x21, [1, 2, 3, 4, 5]), (0, 0, [0; 5])] {
        assert_eq!(host.download(EMERGENCY, &code.to_le_bytes()), Ok(()));
        let said = host.frame("EMCY", Emergency::decode);
        let told = (said.node, said.code, said.error_register.0, said.vendor);
        assert_eq!(told, (peer.node, code, register, vendor));
        let object = host.upload(Object::new(0x1001, 0));
        assert_eq!(object, Ok(vec![register]));
    }
}
