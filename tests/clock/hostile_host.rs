//! A hostile host: no program listens on a socket unless asked.

use std::collections::BTreeSet;
use std::fs;
use std::time::Duration;

use can::clock;
use kit::mrroc::{Directory, Running, shorten};
use kit::processors;

/// Inodes of the sockets that wait for a peer in the network of this process.
fn listening() -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut take = |table: &str, inode: usize, waits: &dyn Fn(&[&str]) -> bool| {
        // A kernel without a protocol has no table of it.
        let text = fs::read_to_string(format!("/proc/net/{table}")).unwrap_or_default();
        for row in text.lines().skip(1) {
            let columns: Vec<_> = row.split_whitespace().collect();
            if columns.len() > inode && waits(&columns) {
                found.insert(columns[inode].to_owned());
            }
        }
    };
    for table in ["tcp", "tcp6"] {
        take(table, 9, &|columns| columns[3] == "0A");
    }
    // A socket without a connection receives from all.
    for table in ["udp", "udp6", "udplite", "udplite6", "raw", "raw6"] {
        take(table, 9, &|_| true);
    }
    take("packet", 8, &|_| true);
    let accepts = |columns: &[&str]| u32::from_str_radix(columns[3], 16).is_ok_and(|flags| flags & 0x1_0000 != 0);
    take("unix", 6, &accepts);
    found
}

/// Inodes of all sockets of process `pid`.
fn sockets(pid: u32) -> BTreeSet<String> {
    let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).expect("the process runs").flatten();
    let targets = descriptors.filter_map(|entry| fs::read_link(entry.path()).ok());
    let inode =
        |target: std::path::PathBuf| Some(target.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned());
    targets.filter_map(inode).collect()
}

fn listens(pid: u32) -> bool {
    !sockets(pid).is_disjoint(&listening())
}

#[test]
fn a_listening_socket_is_found() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    assert!(listens(std::process::id()));
    drop(listener);
}

#[test]
fn neither_a_run_nor_an_emulator_listens_on_a_socket() {
    let _share = processors::take(0.4);
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let [link, record] = ["can0", "record.csv"].map(|name| directory.path(name));
    let emulator = Running::start(["emulate".as_ref(), cell.as_os_str(), "--slcan".as_ref(), link.as_os_str()]);
    let end = clock::now() + Duration::from_secs(30);
    while fs::symlink_metadata(&link).is_err() {
        assert!(clock::now() < end, "no link appeared");
        clock::sleep_until(clock::now() + Duration::from_millis(10));
    }
    assert!(!listens(emulator.id()));
    // A run that the host disturbs opens the same sockets.
    let run = Running::start([
        "run".as_ref(),
        cell.as_os_str(),
        "--bench=emulated".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ]);
    run.wait_for(&record, |text| text.lines().count() > 100);
    assert!(!listens(run.id()));
    run.signal("INT");
    emulator.signal("INT");
    let (_, ended) = (run.output(), emulator.output());
    assert!(ended.status.success(), "{ended:?}");
}
