//! zencan-client 0.0.5 as the master of an emulated drive: `zencan-master INTERFACE NODE`.
//!
//! The client has no EMCY, no NMT command for pre-operational, no PDO transfer and no LSS inquiries.

use std::process::exit;
use std::time::{Duration, Instant};

use mrroc_peers::{Checks, Outcome, PATIENCE, Wire, arguments, bytes, holds, same};
use tokio::runtime::{Builder, Runtime};
use zencan_client::common::lss::{LssIdentity, LssState};
use zencan_client::common::messages::{CanMessage, NmtCommand, NmtCommandSpecifier};
use zencan_client::common::nmt::NmtState;
use zencan_client::common::node_configuration::PdoConfig;
use zencan_client::common::pdo::{PdoCommParameter, PdoMapping};
use zencan_client::common::traits::{AsyncCanReceiver, AsyncCanSender};
use zencan_client::common::{CanId, NodeId};
use zencan_client::{BusManager, LssError, RawAbortCode, SdoClient, SdoClientError, open_socketcan};

/// Identity of the emulated drive.
const IDENTITY: (u32, u32, u32) = (0x0000_00FB, 0x6150_0000, 0x0170_0000);
/// Node-IDs of the emulated drives, followed by an unused node-ID.
const DRIVES: [u8; 5] = [1, 2, 3, 4, 5];
const NOBODY: u8 = 0x7F;
/// An object that accepts any bytes.
const DOMAIN: (u16, u8) = (0x2FF0, 2);
/// Lengths around the limits of frames (4, 7) and of blocks of 127 segments (889), and the longest value that the drive
/// stores.
const SEGMENTED: [usize; 10] = [1, 4, 5, 6, 7, 8, 13, 14, 200, 1022];
const BLOCKS: [usize; 13] = [1, 4, 5, 7, 8, 14, 28, 29, 888, 889, 890, 896, 1022];
/// A drive answers a fastscan at once, and silence means "no". A busy machine may delay one of the hundred answers.
/// Each attempt therefore waits twice as long as the previous one, up to `LONGEST`.
const SILENCE: Duration = Duration::from_millis(15);
const LONGEST: Duration = Duration::from_millis(120);
const ATTEMPTS: usize = 20;

struct Master<S: AsyncCanSender + Send + Sync> {
    runtime: Runtime,
    bus: BusManager<S>,
    sender: S,
    wire: Wire,
    interface: String,
    node: u8,
    /// State of the non-existent node: operational or stopped.
    settled: bool,
}

fn main() {
    let (interface, node) = arguments();
    let wire = Wire::new(&interface);
    let threads = Builder::new_multi_thread().worker_threads(1).enable_all().build();
    let runtime = threads.expect("a thread");
    let entered = runtime.enter();
    let (sender, receiver) = open_socketcan(&interface).expect("the interface is there");
    let bus = BusManager::new(sender.clone(), receiver);
    drop(entered);
    let mut checks = Checks::new(wire.clone());
    let mut master = Master { runtime, bus, sender, wire, interface, node, settled: false };
    let m = &mut master;
    checks.check("a_reset_drive_boots_and_beats", || m.boots());
    checks.check("nmt_commands_are_obeyed", || m.commands());
    checks.check("a_scan_finds_the_drive_and_its_identity", || m.scans());
    checks.check("numbers_of_every_size_are_written_and_read_back", || m.numbers());
    checks.check("a_text_is_uploaded_in_segments", || m.text());
    checks.check("segments_carry_every_length_both_ways", || m.segments());
    checks.check("blocks_carry_every_length_to_the_drive", || m.blocks());
    checks.check("refusals_have_the_codes_of_cia_301", || m.refusals());
    checks.check("pdos_are_configured_and_pass_with_sync", || m.pdos());
    checks.check("layer_settings_renumber_the_drive", || m.renumbers());
    checks.check("a_fastscan_finds_a_drive_without_a_node_id", || m.fastscan());
    exit(checks.finish());
}

impl<S: AsyncCanSender + Clone + Send + Sync> Master<S> {
    /// A client with a socket of its own, on which no earlier answers wait.
    fn client(&self) -> SdoClient<impl AsyncCanSender + use<S>, impl AsyncCanReceiver + use<S>> {
        self.client_of(self.node)
    }

    fn client_of(&self, node: u8) -> SdoClient<impl AsyncCanSender + use<S>, impl AsyncCanReceiver + use<S>> {
        let _entered = self.runtime.enter();
        let (sender, receiver) = open_socketcan(&self.interface).expect("the interface is there");
        let mut client = SdoClient::new_std(node, sender, receiver);
        client.set_timeout(PATIENCE);
        client
    }

    /// Sends the command and waits for the boot-up message of `node`.
    fn boots_by(&mut self, command: NmtCommandSpecifier, told: u8, node: u8) -> Outcome {
        let mark = self.wire.mark();
        match command {
            NmtCommandSpecifier::ResetApp => self.runtime.block_on(self.bus.nmt_reset_app(told)),
            _ => self.runtime.block_on(self.bus.nmt_reset_comms(told)),
        }
        let booted = self.boot_since(mark, node);
        holds(&format!("no boot-up of node {node:#x}"), booted)
    }

    fn boot_since(&self, mark: usize, node: u8) -> bool {
        let boot = |seen: &mrroc_peers::Seen| seen.id == 0x700 + u16::from(node) && seen.data == [0];
        self.wire.since(mark, boot).is_some()
    }

    fn send(&mut self, message: CanMessage) -> Outcome {
        let sent = self.runtime.block_on(self.sender.send(message));
        sent.map_err(|_| "not sent".to_owned())
    }

    /// Waits until the bus manager has received this state from the drive.
    fn hears(&mut self, state: NmtState) -> Outcome {
        self.hears_of(self.node, state)
    }

    fn hears_of(&mut self, node: u8, state: NmtState) -> Outcome {
        let end = Instant::now() + PATIENCE;
        loop {
            let nodes = self.runtime.block_on(self.bus.node_list());
            let found = nodes.iter().find(|it| it.node_id == node);
            let heard = found.and_then(|it| it.nmt_state);
            if heard == Some(state) {
                return Ok(());
            }
            holds(&format!("heard {heard:?}, expected {state:?}"), Instant::now() < end)?;
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn boots(&mut self) -> Outcome {
        self.boots_by(NmtCommandSpecifier::ResetApp, self.node, self.node)?;
        let mut client = self.client();
        self.runtime.block_on(client.write_u16(0x1017, 0, 20)).map_err(said)?;
        self.hears(NmtState::PreOperational)
    }

    fn commands(&mut self) -> Outcome {
        let node = self.node;
        self.runtime.block_on(self.bus.nmt_start(node));
        self.hears(NmtState::Operational)?;
        self.runtime.block_on(self.bus.nmt_stop(node));
        self.hears(NmtState::Stopped)?;
        let cs = NmtCommandSpecifier::EnterPreOp;
        self.send(NmtCommand { cs, node }.into())?;
        self.hears(NmtState::PreOperational)?;
        // Addressed to all nodes.
        self.runtime.block_on(self.bus.nmt_start(0));
        self.hears(NmtState::Operational)?;
        self.boots_by(NmtCommandSpecifier::ResetComm, node, node)?;
        let mut client = self.client();
        let heartbeat = self.runtime.block_on(client.read_u16(0x1017, 0));
        same("heartbeat time after the reset", heartbeat, Ok(0))
    }

    /// Waits until no answer to an earlier request is on its way to the bus manager.
    ///
    /// The client accepts every answer of its node, even for another object. Such an answer may be read late by the
    /// manager, or may arrive after the client has given up. Each drive answers in order, so the answer to the request
    /// made here is the last one. The manager has read all earlier frames as soon as it shows the state of a node that
    /// does not exist.
    fn settles(&mut self) -> Outcome {
        for node in DRIVES {
            let mut client = self.client_of(node);
            let read = self.runtime.block_on(client.read_u32(0x1000, 0));
            read.map_err(said)?;
        }
        self.settled = !self.settled;
        let (state, byte) = if self.settled { (NmtState::Operational, 5) } else { (NmtState::Stopped, 4) };
        // The frame is sent from another socket, because the manager does not receive frames of its own socket. The
        // first frame of a node does not set a state.
        let mut sender = {
            let _entered = self.runtime.enter();
            open_socketcan(&self.interface).expect("the interface is there").0
        };
        for _ in 0..2 {
            let beat = CanMessage::new(CanId::std(0x700 + u16::from(NOBODY)), &[byte]);
            let sent = self.runtime.block_on(sender.send(beat));
            sent.map_err(|_| "not sent")?;
        }
        self.hears_of(NOBODY, state)
    }

    fn scans(&mut self) -> Outcome {
        // The client waits 150 ms for each answer of a node, which is too short on a busy machine.
        for _ in 0..ATTEMPTS {
            self.settles()?;
            let nodes = self.runtime.block_on(self.bus.scan_nodes()).map_err(said)?;
            let found: Vec<_> = nodes.iter().map(|it| it.node_id).collect();
            let Some(drive) = nodes.into_iter().find(|it| it.node_id == self.node) else {
                continue;
            };
            // The name of a node that did not report it in time is missing.
            if found != DRIVES || drive.device_name.is_none() {
                continue;
            }
            let identity = drive.identity.ok_or("no identity")?;
            let (vendor, product, revision) = IDENTITY;
            same("vendor", identity.vendor_id, vendor)?;
            same("product", identity.product_code, product)?;
            same("revision", identity.revision, revision)?;
            return same("name", drive.device_name.as_deref(), Some("EPOS4"));
        }
        Err("the five drives were never found".to_owned())
    }

    fn numbers(&mut self) -> Outcome {
        let mut c = self.client();
        self.runtime.block_on(async {
            c.write_i8(0x6098, 0, -3).await.map_err(said)?;
            same("i8", c.read_i8(0x6098, 0).await, Ok(-3))?;
            c.write_u16(0x1017, 0, 0x1234).await.map_err(said)?;
            same("u16", c.read_u16(0x1017, 0).await, Ok(0x1234))?;
            c.write_u16(0x1017, 0, 0).await.map_err(said)?;
            c.write_u32(0x6081, 0, 0x0BCD_EF01).await.map_err(said)?;
            same("u32", c.read_u32(0x6081, 0).await, Ok(0x0BCD_EF01))?;
            same("device type", c.read_u32(0x1000, 0).await, Ok(0x0002_0192))?;
            same("u8", c.read_u8(0x1018, 0).await, Ok(4))
        })
    }

    fn text(&mut self) -> Outcome {
        let mut c = self.client();
        let name = self.runtime.block_on(c.read_device_name());
        same("name", name.as_deref(), Ok("EPOS4"))?;
        let long = self.runtime.block_on(c.read_visible_string(0x2FF0, 1)).map_err(said)?;
        holds(&long, long.starts_with("a record of the emulator") && long.len() > 70)
    }

    fn segments(&mut self) -> Outcome {
        let (index, sub) = DOMAIN;
        let mut c = self.client();
        self.runtime.block_on(async {
            for length in SEGMENTED {
                let data = bytes(length);
                c.download(index, sub, &data).await.map_err(said)?;
                same("uploaded", c.upload(index, sub).await, Ok(data))?;
            }
            // For an empty value, the client sends an expedited frame with 4 unused bytes. The number 4 does not fit
            // its two-bit field and sets a reserved bit (CiA 301: initiate SDO download).
            aborted(c.download(index, sub, &[]).await, 0x0504_0001)
        })
    }

    /// The client takes the size bit in the first answer of an upload for a part of the command (CiA 301, initiate SDO
    /// block upload: `s` is bit 1, `ss` is bit 0). It therefore cannot decode the answer of a server that gives the
    /// size, and stops without an abort.
    fn blocks(&mut self) -> Outcome {
        let (index, sub) = DOMAIN;
        let mut c = self.client();
        self.runtime.block_on(async {
            for length in BLOCKS {
                let data = bytes(length);
                let what = |error| format!("{length} bytes: {}", said(error));
                c.block_download(index, sub, &data).await.map_err(what)?;
                let lost = c.block_upload(index, sub).await;
                same("by blocks", lost, Err(SdoClientError::MalformedResponse))?;
                same("by segments", c.upload(index, sub).await, Ok(data))?;
            }
            Ok(())
        })
    }

    fn refusals(&mut self) -> Outcome {
        let mut c = self.client();
        let (index, sub) = DOMAIN;
        self.runtime.block_on(async {
            aborted(c.upload(0x5FFF, 0).await, 0x0602_0000)?;
            aborted(c.write_u8(0x5FFF, 0, 0).await, 0x0602_0000)?;
            aborted(c.upload(0x1018, 9).await, 0x0609_0011)?;
            aborted(c.write_u32(0x1000, 0, 0).await, 0x0601_0002)?;
            aborted(c.write_u32(0x6040, 0, 0).await, 0x0607_0010)?;
            aborted(c.write_u16(0x6081, 0, 0).await, 0x0607_0013)?;
            aborted(c.download(0x6081, 0, &[0; 20]).await, 0x0607_0010)?;
            aborted(c.write_u8(0x60C2, 1, 200).await, 0x0609_0030)?;
            aborted(c.download(index, sub, &bytes(1023)).await, 0x0504_0005)?;
            aborted(c.block_download(index, sub, &bytes(1023)).await, 0x0504_0005)?;
            aborted(c.block_upload(0x5FFF, 0).await, 0x0602_0000)?;
            aborted(c.block_download(0x1000, 0, &bytes(29)).await, 0x0601_0002)?;
            // The next transfer succeeds.
            same("device type", c.read_u32(0x1000, 0).await, Ok(0x0002_0192))
        })
    }

    fn pdos(&mut self) -> Outcome {
        let node = u16::from(self.node);
        let tpdo = config(0x180 + node, true, &[(0x6041, 16), (0x6064, 32)]);
        let rpdo = config(0x300 + node, false, &[(0x607A, 32), (0x60FF, 32)]);
        let mut c = self.client();
        self.runtime.block_on(async {
            c.configure_tpdo(0, &tpdo).await.map_err(said)?;
            same("TPDO 1", c.read_tpdo_config(0).await, Ok(tpdo))?;
            c.configure_rpdo(1, &rpdo).await.map_err(said)?;
            same("RPDO 2", c.read_rpdo_config(1).await, Ok(rpdo))
        })?;
        self.runtime.block_on(self.bus.nmt_start(self.node));
        let velocity = |client: &mut SdoClient<_, _>| self.runtime.block_on(client.read_i32(0x60FF, 0));
        same("before", velocity(&mut c), Ok(0))?;
        let data = [0, 0, 0, 0, 0xF9, 0xFF, 0xFF, 0xFF];
        self.runtime
            .block_on(self.sender.send(CanMessage::new(CanId::std(0x300 + node), &data)))
            .map_err(|_| "not sent")?;
        same("before SYNC", velocity(&mut c), Ok(0))?;
        let mark = self.wire.mark();
        self.runtime.block_on(self.bus.sync(None));
        let came = self.wire.since(mark, |seen| seen.id == 0x180 + node);
        let came = came.ok_or("no TPDO after SYNC")?.data;
        same("after SYNC", velocity(&mut c), Ok(-7))?;
        let statusword = self.runtime.block_on(c.upload(0x6041, 0)).map_err(said)?;
        let position = self.runtime.block_on(c.upload(0x6064, 0)).map_err(said)?;
        same("TPDO", came, [statusword, position].concat())?;
        self.boots_by(NmtCommandSpecifier::ResetApp, self.node, self.node)
    }

    fn identity(&mut self) -> Result<LssIdentity, String> {
        let mut client = self.client();
        self.runtime.block_on(client.read_identity()).map_err(said)
    }

    /// Switches the drive to configuration mode and assigns a node-ID. The client waits 50 ms for an answer, which is
    /// too short on a busy machine.
    fn set(&mut self, identity: LssIdentity, node: NodeId) -> Outcome {
        let mut last = Ok(());
        for _ in 0..ATTEMPTS {
            last = self.runtime.block_on(async {
                self.bus.lss_activate(identity).await?;
                self.bus.lss_set_node_id(node).await
            });
            if !matches!(last, Err(LssError::Timeout)) {
                break;
            }
        }
        last.map_err(said)?;
        self.runtime.block_on(self.bus.lss_set_global_mode(LssState::Waiting));
        Ok(())
    }

    fn renumbers(&mut self) -> Outcome {
        let (own, other) = (self.node, 0x21);
        let identity = self.identity()?;
        for (present, wanted) in [(own, other), (other, own)] {
            let id = NodeId::new(wanted).map_err(|_| "no node-ID")?;
            self.set(identity, id)?;
            self.boots_by(NmtCommandSpecifier::ResetComm, present, wanted)?;
        }
        Ok(())
    }

    fn fastscan(&mut self) -> Outcome {
        let identity = self.identity()?;
        self.set(identity, NodeId::Unconfigured)?;
        self.runtime.block_on(self.bus.nmt_reset_comms(self.node));
        let mut silence = SILENCE;
        let found = (0..ATTEMPTS).find_map(|_| {
            let found = self.runtime.block_on(self.bus.lss_fastscan(silence));
            silence = LONGEST.min(2 * silence);
            (!found.is_empty()).then_some(found)
        });
        same("found", found, Some(vec![identity]))?;
        let mark = self.wire.mark();
        self.set(identity, NodeId::new(self.node).map_err(|_| "no node-ID")?)?;
        holds("no boot-up with the new node-ID", self.boot_since(mark, self.node))
    }
}

/// Configuration of a synchronous PDO.
fn config(cob_id: u16, rtr_disabled: bool, objects: &[(u16, u8)]) -> PdoConfig {
    PdoConfig {
        comm: PdoCommParameter { valid: true, rtr_disabled, cob_id: CanId::std(cob_id), transmission_type: 1 },
        mappings: objects.iter().map(|&(index, size)| PdoMapping { index, sub: 0, size }).collect(),
    }
}

fn said(error: impl std::fmt::Display) -> String {
    error.to_string()
}

/// Asserts that the transfer was aborted with this code.
fn aborted<T: std::fmt::Debug>(result: Result<T, SdoClientError>, expected: u32) -> Outcome {
    match result {
        Err(SdoClientError::ServerAbort { abort_code, .. }) => {
            let code = match abort_code {
                RawAbortCode::Valid(code) => code as u32,
                RawAbortCode::Unknown(code) => code,
            };
            same("abort code", code, expected)
        }
        other => Err(format!("{other:02x?}, expected abort {expected:#010x}")),
    }
}
