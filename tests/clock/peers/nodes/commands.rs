//! The service commands `mrroc scan`, `sdo`, `nmt`, `monitor` and `lss` on the bus of the peers.

use std::time::Duration;

use can::clock;
use canopen::NodeId;
use canopen::sync::Sync;
use kit::mrroc::{Output, mrroc};
use serde_json::json;

use super::super::host::Host;
use super::EMERGENCY;
use super::table::{PEERS, Peer, Programs};
use crate::vcan::Stage;

const LOOK: Duration = Duration::from_millis(50);

/// Longest time until scans have found all nodes.
const SCANS: Duration = Duration::from_secs(60);

/// Runs `mrroc` with the arguments `words` on the interface.
fn run(stage: &Stage, words: &str) -> Output {
    let words = words.split(' ');
    mrroc(words.chain(["--can", stage.interface]))
}

/// Runs a command that must succeed, and returns its output.
fn says(stage: &Stage, words: &str) -> String {
    let output = run(stage, words);
    assert_eq!(output.status.code(), Some(0), "{words}: {output:?}");
    output.stdout
}

/// Runs a command that ends when the event `happens` occurs, and returns its output. The command may start to listen
/// late, so the event is repeated.
fn meanwhile(stage: &Stage, words: &str, mut happens: impl FnMut()) -> String {
    std::thread::scope(|scope| {
        let shown = scope.spawn(|| says(stage, words));
        while !shown.is_finished() {
            happens();
            clock::sleep_until(clock::now() + LOOK);
        }
        shown.join().unwrap()
    })
}

/// Asserts that `mrroc scan` finds the peers under these node-IDs and no other node.
fn scan(stage: &Stage, nodes: [NodeId; 3]) {
    let known = |peer: &Peer, node: NodeId| {
        let [vendor, product, revision] = peer.identity;
        json!([node.raw(), peer.device_type, peer.own_name(), vendor, product, revision, peer.serial])
    };
    let expected: Vec<_> = PEERS.iter().zip(nodes).map(|(peer, node)| known(peer, node)).collect();
    let keys = ["node", "device_type", "name", "vendor", "product", "revision", "serial"];
    let end = clock::now() + SCANS;
    loop {
        let scanned = run(stage, "scan --json").json();
        println!("mrroc scan: {scanned}");
        let found = scanned["nodes"].as_array().unwrap().iter();
        let found: Vec<_> = found.map(|it| json!(keys.map(|key| &it[key]))).collect();
        if scanned["unconfigured"] == false && found == expected {
            return;
        }
        // On a busy machine an answer may take 200 ms. The scan then misses the node.
        assert!(clock::now() < end, "expected {expected:?}");
    }
}

pub(super) fn service_commands(stage: &Stage, hosts: &mut [Host]) {
    scan(stage, PEERS.each_ref().map(|peer| peer.node));
    println!("mrroc monitor --map");
    let words = "monitor --map --only pdo --count 3";
    let shown = meanwhile(stage, words, || hosts[0].send(&Sync::default().encode()));
    for peer in &PEERS {
        let node = peer.node;
        let line = format!("node {node}: TPDO 1: 0x2000:00 0x030201{:02x}; 0x2001:00 0x8504", node.raw());
        assert!(shown.contains(&line), "{line} is not in {shown}");
    }
    for peer in &PEERS {
        println!("{}: mrroc sdo and nmt", peer.name);
        let node = peer.node;
        let wrote = says(stage, &format!("sdo write {node} 0x2000 --type u32 305419896"));
        assert!(wrote.starts_with("0x2000:00 = 0x12345678"), "{wrote}");
        let refused = run(stage, &format!("sdo read {node} 0x5fff"));
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        let why = "object does not exist";
        assert!(refused.stderr.contains(why), "{refused:?}");
        if peer.constant_heartbeat.is_none() {
            says(stage, &format!("sdo write {node} 0x1017 --type u16 50"));
        }
        for (order, state) in [("pre-operational", "pre-operational"), ("stop", "stopped"), ("start", "operational")] {
            let told = says(stage, &format!("nmt {order} {node}"));
            assert_eq!(told, format!("node {node}: {state}\n"));
        }
        for reset in ["reset-node", "reset-communication"] {
            let told = run(stage, &format!("nmt {reset} {node} --timeout {}", peer.boot_ms()));
            let line = format!("node {node}: booted\n");
            let booted = told.status.success() && told.stdout == line;
            assert!(booted || !peer.boots(), "{told:?}");
        }
    }
    println!("mrroc monitor");
    for (host, peer) in hosts.iter_mut().zip(&PEERS) {
        if !peer.emergencies {
            continue;
        }
        let node = peer.node;
        let shown = meanwhile(stage, "monitor --only emcy --count 1", || {
            let code = 0x8611_u16.to_le_bytes();
            assert_eq!(host.download(EMERGENCY, &code), Ok(()));
        });
        let frame = format!("{:03X}#1186210102030405", 0x80 + u16::from(node.raw()));
        assert!(shown.contains(&frame), "{shown}");
        assert!(shown.contains(&format!("node {node}: ")), "{shown}");
    }
}

/// No peer has a node-ID at first. Scans distinguish the peers, and each peer receives a node-ID and boots with it.
///
/// durand also answers a fastscan in configuration mode (CiA 305: in waiting mode only). A scan therefore finds durand
/// again and no node after it, and the next scan finds the rest.
pub(super) fn layer_settings(stage: &Stage, programs: &Programs) {
    let start = |peer: &Peer| programs.start(stage, peer, None);
    let [zencan, canopen_rs, durand] = &PEERS;
    // These two peers answer fastscan, but not "identify non-configured slaves".
    let _started = [zencan, canopen_rs].map(start);
    let end = clock::now() + SCANS;
    while run(stage, "scan").stdout != "there are nodes without a node-ID: `mrroc lss scan` finds them\n" {
        assert!(clock::now() < end, "`mrroc scan` does not know of them");
    }
    let _durand = start(durand);
    let nodes = [0x31, 0x32, 0x33].map(|raw| NodeId::new(raw).unwrap());
    let mut left: Vec<_> = PEERS.iter().zip(nodes).collect();
    while !left.is_empty() {
        // A node may not be ready yet, and a busy machine may delay an answer beyond the time-out.
        assert!(clock::now() < end, "not found: {:?}", left[0].0.name);
        let scanned = run(stage, "lss scan --json");
        println!("mrroc lss scan: {}{}", scanned.stdout, scanned.stderr);
        left.retain(|(peer, node)| {
            let found = scanned.stdout.contains(&peer.written());
            if found {
                configure(stage, peer, *node);
            }
            !found
        });
    }
    scan(stage, nodes);
    renumber(stage, durand, nodes[2]);
}

/// Asserts that a peer adopts a new node-ID at its next reset of communication, and not before.
fn renumber(stage: &Stage, peer: &Peer, node: NodeId) {
    println!("{}: another node-ID", peer.name);
    let (identity, other) = (peer.written(), 0x41);
    let words = format!("lss set-node-id --identity {identity} {other}");
    let told = says(stage, &words);
    let when = "at its next reset of communication";
    assert!(told.contains(when), "{told}");
    says(stage, &format!("sdo read {node} 0x1000"));
    let words = format!("nmt reset-communication {node} --timeout 300");
    run(stage, &words);
    says(stage, &format!("sdo read {other} 0x1000"));
}

/// Assigns a node-ID to a peer without one.
fn configure(stage: &Stage, peer: &Peer, node: NodeId) {
    println!("{}: mrroc lss set-node-id", peer.name);
    let identity = peer.written();
    let told = says(stage, &format!("lss set-node-id --identity {identity} {node}"));
    let line = format!("node {node}: configured, and booted\n");
    assert!(told == line || !peer.boots(), "{told}");
    let told = says(stage, &format!("lss inquire --identity {identity}"));
    assert_eq!(told, format!("node {node}: {identity}\n"));
}
