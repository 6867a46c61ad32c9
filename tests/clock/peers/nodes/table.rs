//! The peers: identities, processes, and deviations from the standards.

use std::path::PathBuf;
use std::process::Command;

use canopen::NodeId;
use canopen::nmt::NmtState;
use canopen::sdo::AbortCode;
use kit::mrroc;

use super::super::{PATIENCE, Script, python, rust};
use crate::vcan::Stage;

/// A node and its deviations from the standards.
pub(super) struct Peer {
    pub(super) name: &'static str,
    pub(super) node: NodeId,
    pub(super) identity: [u32; 3],
    pub(super) device_type: u32,
    pub(super) serial: u32,
    /// State in the first message after a boot; CiA 301: initialising. zencan sends that message only if a heartbeat is
    /// due at that moment.
    pub(super) boots_as: NmtState,
    /// Heartbeat time of a peer whose object 0x1017 is a constant, ms; CiA 301: rw.
    pub(super) constant_heartbeat: Option<u16>,
    /// Whether a reset restores the power-on value of object 0x1017; CiA 301: yes.
    pub(super) restores: bool,
    /// Abort code for a sub-index that does not exist; CiA 301: 0x06090011.
    pub(super) no_subindex: AbortCode,
    /// Abort code for too few bytes; CiA 301: 0x06070013, or 0x06070010 in general.
    pub(super) too_short: AbortCode,
    /// Abort code for too many bytes; CiA 301: 0x06070012, or 0x06070010 in general.
    pub(super) too_long: AbortCode,
    /// Possible lengths of the values of its objects, bytes.
    pub(super) lengths: fn(usize) -> bool,
    /// Upload of an empty object; CiA 301: no bytes. zencan sends an expedited frame that does not say its size.
    pub(super) empty: &'static [u8],
    /// Lengths of correct block uploads, bytes; CiA 301: all. zencan and durand report seven unused bytes in a full
    /// last segment. zencan also does not mark a last segment that ends a sub-block of 127.
    pub(super) blocks: fn(usize) -> bool,
    /// Whether the peer sends emergencies.
    pub(super) emergencies: bool,
    /// Whether the peer can act as a CiA 402 drive.
    pub(super) drive: bool,
}

pub(super) static PEERS: [Peer; 3] = [
    Peer {
        name: "zencan-node",
        node: NodeId::new(0x11).unwrap(),
        identity: [0x7A65_6E63, 0x1000_0002, 0x8000_0001],
        device_type: 0,
        serial: 0x5A00_0001,
        boots_as: NmtState::PreOperational,
        constant_heartbeat: Some(5),
        restores: true,
        no_subindex: AbortCode::NO_SUBINDEX,
        too_short: AbortCode::TOO_SHORT,
        too_long: AbortCode::TOO_LONG,
        lengths: |_| true,
        empty: &[0; 4],
        blocks: |length| length % 7 != 0,
        emergencies: false,
        drive: false,
    },
    Peer {
        name: "canopen-rs-node",
        node: NodeId::new(0x12).unwrap(),
        identity: [0x0000_0C05, 0x0061_0001, 0x0000_0601],
        device_type: 0x0002_0192,
        serial: 0x0000_0002,
        boots_as: NmtState::Initialising,
        constant_heartbeat: None,
        restores: true,
        no_subindex: AbortCode::NO_OBJECT,
        too_short: AbortCode::TOO_LONG,
        too_long: AbortCode::TOO_LONG,
        lengths: |length| length <= 32,
        empty: &[],
        blocks: |_| true,
        emergencies: true,
        drive: true,
    },
    Peer {
        name: "durand_node.py",
        node: NodeId::new(0x13).unwrap(),
        identity: [0x0000_0D0D, 0x0050_0000, 0x0000_0005],
        device_type: 0x0002_0192,
        serial: 0xFFFF_FFFF,
        boots_as: NmtState::Initialising,
        constant_heartbeat: None,
        restores: false,
        no_subindex: AbortCode::NO_SUBINDEX,
        too_short: AbortCode::LENGTH_MISMATCH,
        too_long: AbortCode::LENGTH_MISMATCH,
        lengths: |_| true,
        empty: &[],
        blocks: |length| length % 7 != 0,
        emergencies: true,
        drive: true,
    },
];

impl Peer {
    /// Whether a boot-up message is sure to come. No host sees the reset of a peer that sends none.
    pub(super) fn boots(&self) -> bool {
        self.boots_as == NmtState::Initialising
    }

    /// Time to wait for the boot-up message, ms.
    pub(super) fn boot_ms(&self) -> u32 {
        if self.boots() { 10_000 } else { 300 }
    }

    /// Object 0x1008.
    pub(super) fn own_name(&self) -> &str {
        let end = self.name.find("-node").or(self.name.find("_node"));
        &self.name[..end.unwrap_or(self.name.len())]
    }

    /// Identity in the notation of the service commands.
    pub(super) fn written(&self) -> String {
        let [vendor, product, revision] = self.identity;
        let serial = self.serial;
        format!("{vendor:#010x}:{product:#010x}:{revision:#010x}:{serial:#010x}")
    }
}

/// Commands that start each of [`PEERS`].
pub(super) struct Programs {
    zencan: PathBuf,
    canopen_rs: PathBuf,
    python: PathBuf,
}

impl Programs {
    pub(super) fn find(test: &str) -> Option<Self> {
        let [zencan, canopen_rs] = rust(test, ["zencan-node", "canopen-rs-node"])?;
        let python = python(test)?;
        Some(Self { zencan, canopen_rs, python })
    }

    /// Starts a peer; without a node-ID if `node` is `None`.
    pub(super) fn start(&self, stage: &Stage, peer: &Peer, node: Option<NodeId>) -> Script {
        let mut command = Command::new("timeout");
        command.args(["--signal=KILL", PATIENCE]);
        match peer.name {
            "zencan-node" => command.arg(&self.zencan),
            "canopen-rs-node" => command.arg(&self.canopen_rs),
            script => {
                let scripts = mrroc::root().join("tests/peers");
                let python = command.arg(&self.python).args(["-B", "-u"]);
                python.arg(scripts.join(script))
            }
        };
        let node = node.map_or(255, NodeId::raw).to_string();
        Script::start(command.args([stage.interface, &node, &peer.serial.to_string()]))
    }
}
