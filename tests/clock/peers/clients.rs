//! zencan-client and canopen-rs as masters of an emulated drive.

use std::process::Command;

use super::{PATIENCE, rust};
use crate::vcan::on_stage;

/// Node-ID of the emulated drive.
const NODE: &str = "1";

#[test]
fn zencan_and_canopen_rs_find_an_emulated_drive_right() {
    let test = "peers::clients::zencan_and_canopen_rs_find_an_emulated_drive_right";
    let masters = ["zencan-master", "canopen-rs-master"];
    let Some(masters) = rust(test, masters) else {
        return;
    };
    on_stage(test, |stage| {
        let mut failed = false;
        for master in &masters {
            let _emulators = stage.start_emulators();
            let mut command = Command::new("timeout");
            command.args(["--signal=KILL", PATIENCE]).arg(master);
            let output = command.args([stage.interface, NODE]).output().unwrap();
            println!("{}", master.display());
            print!("{}", String::from_utf8_lossy(&output.stdout));
            print!("{}", String::from_utf8_lossy(&output.stderr));
            failed |= !output.status.success();
        }
        assert!(!failed, "a check failed");
    });
}
