//! Nodes of zencan, canopen-rs and durand on one bus, operated by this project's SDO client, NMT and LSS masters, drive
//! group and service commands.
//! Deviations of a peer from CiA 301 or CiA 305 are in its row of [`table::PEERS`], with the text of the standard.
//! for it.

use can::Frame;
use canopen::nmt::Command;
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::sync::Sync;
use canopen::{Object, cob};
use commands::{layer_settings, service_commands};
use drive::cia402::AxisConfig;
use master::pdo::{PdoSetup, remap};
use table::{PEERS, Peer, Programs};

use super::group::run_as_drives;
use super::host::Host;
use crate::vcan::{Stage, on_stage};

mod commands;

mod services;

mod table;

const NUMBER: Object = Object::new(0x2000, 0);

const SHORT: Object = Object::new(0x2001, 0);

/// A value written here is sent as an emergency; 0 clears the error.
const EMERGENCY: Object = Object::new(0x2F01, 0);

#[test]
fn zencan_canopen_rs_and_durand_obey_our_host_side() {
    let test = "peers::nodes::zencan_canopen_rs_and_durand_obey_our_host_side";
    let Some(programs) = Programs::find(test) else {
        return;
    };
    on_stage(test, |stage| {
        let mut hosts = PEERS.each_ref().map(|peer| Host::new(stage.interface, peer.node));
        let started = PEERS.each_ref().map(|peer| programs.start(stage, peer, Some(peer.node)));
        for (host, peer) in hosts.iter_mut().zip(&PEERS) {
            host.hears(peer.boots_as);
        }
        for (host, peer) in hosts.iter_mut().zip(&PEERS) {
            for (name, check) in services::CHECKS {
                host.forget();
                // The last printed line names the failed check.
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

/// One RPDO and one TPDO with the same two objects, at every SYNC: the TPDO returns the values of the RPDO.
fn process_data(hosts: &mut [Host]) {
    let entries = [Entry::new(NUMBER, 32), Entry::new(SHORT, 16)];
    let mapping = PdoMapping::new(&entries).unwrap();
    for host in &mut *hosts {
        let (number, node) = (PdoNumber::One, host.node);
        for (kind, cob_id) in [
            (PdoKind::Rpdo, PdoCobId::new(cob::rpdo(number, node))),
            (PdoKind::Tpdo, PdoCobId::new(cob::tpdo(number, node)).without_rtr()),
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
    // A node has processed the command as soon as it answers.
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

/// Runs the peers that can act as drives in one drive group.
fn drive_group(stage: &Stage, programs: &Programs) {
    let drives = || PEERS.iter().filter(|peer| peer.drive);
    let mut hosts: Vec<_> = drives().map(|peer| Host::new(stage.interface, peer.node)).collect();
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
    let changes: Vec<_> = changes.iter().map(|change| change as &dyn Fn(&mut _)).collect();
    println!("a drive group runs {} of them", changes.len());
    run_as_drives(stage, &changes);
}
