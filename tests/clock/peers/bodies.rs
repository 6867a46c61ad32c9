//! pinocchio, the rigid-body library, reads the output of `mrroc urdf`.

use std::process::Command;

use kit::mrroc::{self, ROBOTS};
use kit::processors;

use super::{PATIENCE, judged, python};

#[test]
fn pinocchio_finds_the_same_flange_and_jacobian_for_every_robot() {
    let test = "peers::bodies::pinocchio_finds_the_same_flange_and_jacobian_for_every_robot";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.9);
    for robot in ROBOTS {
        let mut script = Command::new("timeout");
        script.args(["--signal=KILL", PATIENCE]).arg(&python);
        script.arg("-B").arg(mrroc::root().join("tests/peers/bodies.py"));
        script.arg("--mrroc").arg(mrroc::binary());
        judged(script.args(["--robot", robot]));
    }
}
