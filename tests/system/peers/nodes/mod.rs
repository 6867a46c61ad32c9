//! Nodes of zencan, canopen-rs and durand, all on one bus: our SDO client, NMT commands, LSS master, drive group and service
//! commands have to do with them.
//!
//! What a peer does otherwise than CiA 301 or CiA 305 say is in its row of [`table::PEERS`], with the standard's word
//! for it.

mod commands;
mod services;
mod table;

use can::Frame;
use canopen::nmt::Command;
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::sync::Sync;
use canopen::{Object, cob};
use drive::cia402::AxisConfig;
use master::pdo::{PdoSetup, remap};

use super::group::run_as_drives;
use super::host::Host;
use crate::vcan::{Stage, on_stage};
use commands::{layer_settings, service_commands};
use table::{PEERS, Peer, Programs};

const NUMBER: Object = Object::new(0x2000, 0);
const SHORT: Object = Object::new(0x2001, 0);
/// What is written here goes out as an emergency; 0 clears it.
const EMERGENCY: Object = Object::new(0x2F01, 0);

#[test]
fn zencan_canopen_rs_and_durand_obey_our_host_side() {
    let test = "peers::nodes::zencan_canopen_rs_and_durand_obey_our_host_side";
    let Some(programs) = Programs::find(test) else {
        return;
    };
    on_stage(test, |stage| {
        let mut hosts = PEERS
            .each_ref()
            .map(|peer| Host::new(stage.interface, peer.node));
        let started = PEERS
            .each_ref()
            .map(|peer| programs.start(stage, peer, Some(peer.node)));
        for (host, peer) in hosts.iter_mut().zip(&PEERS) {
            host.hears(peer.boots_as);
        }
        for (host, peer) in hosts.iter_mut().zip(&PEERS) {
            for (name, check) in services::CHECKS {
                host.forget();
                // The name of a failed check is the last line.
                println!("{}: {name}", peer.name);
                check(host, peer);
            }
        }
        println!("PDOs pass with SYNC");
        process_data(&mut hosts);
        service_commands(stage, &mut hosts);
        drop((hosts, started));
        drive_group(stage, &programs);
        layer_settings(stage, &programs);
    });
}

/// One RPDO and one TPDO with the same two objects, at every SYNC: what goes in comes out.
fn process_data(hosts: &mut [Host]) {
    let entries = [Entry::new(NUMBER, 32), Entry::new(SHORT, 16)];
    let mapping = PdoMapping::new(&entries).unwrap();
    for host in &mut *hosts {
        let (number, node) = (PdoNumber::One, host.node);
        for (kind, cob_id) in [
            (PdoKind::Rpdo, PdoCobId::new(cob::rpdo(number, node))),
            (
                PdoKind::Tpdo,
                PdoCobId::new(cob::tpdo(number, node)).without_rtr(),
            ),
        ] {
            host.writes(remap(&PdoSetup {
                kind,
                number,
                cob_id,
                mapping,
                transmission: TransmissionType::EVERY_SYNC,
                inhibit_time: None,
                event_timer: None,
            }));
        }
        host.command(Command::Start);
    }
    // Each has taken the command once it answers.
    for host in &mut *hosts {
        host.upload(NUMBER).unwrap();
        let (number, node) = (PdoNumber::One, host.node);
        let own = [node.raw(), 1, 2, 3, 4, 0x85];
        let rpdo = Frame::new(cob::rpdo(number, node), &own).unwrap();
        host.send(&rpdo);
        // A node that samples before RPDOs take effect shows the value at the second SYNC.
        host.send(&Sync::default().encode());
        host.upload(NUMBER).unwrap();
        host.send(&Sync::default().encode());
        host.frame("TPDO", |frame| {
            let is_it = frame.standard_data_id() == Some(cob::tpdo(number, node));
            (is_it && frame.data() == own).then_some(())
        });
    }
}

/// The peers of which drives can be made, in one group.
fn drive_group(stage: &Stage, programs: &Programs) {
    let drives = || PEERS.iter().filter(|peer| peer.drive);
    let mut hosts: Vec<_> = drives()
        .map(|peer| Host::new(stage.interface, peer.node))
        .collect();
    let start = |peer: &Peer| programs.start(stage, peer, Some(peer.node));
    let _started: Vec<_> = drives().map(start).collect();
    for (host, peer) in hosts.iter_mut().zip(drives()) {
        host.hears(peer.boots_as);
    }
    drop(hosts);
    let change = |peer: &'static Peer| {
        let [vendor, ..] = peer.identity;
        move |axis: &mut AxisConfig| {
            axis.node = peer.node;
            axis.identity.vendor = vendor;
        }
    };
    let changes: Vec<_> = drives().map(change).collect();
    let changes: Vec<_> = changes
        .iter()
        .map(|change| change as &dyn Fn(&mut _))
        .collect();
    println!("a drive group runs {} of them", changes.len());
    run_as_drives(stage, &changes);
}
