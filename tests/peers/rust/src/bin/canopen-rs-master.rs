//! canopen-rs 0.6.1 as the master of an emulated drive: `canopen-rs-master INTERFACE NODE`.
//!
//! Values of the library have at most 32 bytes. Block transfer is assembled here from its frames and two helper
//! functions.

use std::cell::RefCell;
use std::fmt::Display;
use std::process::exit;
use std::time::{Duration, Instant};

use canopen_host::nmt::HeartbeatMonitor;
use canopen_host::transport::{Received, SdoError, SocketCan};
use canopen_rs::emcy::{EmergencyMessage, emcy_cob_id};
use canopen_rs::lss::{self, FASTSCAN_INIT, FastscanMaster, LssAddress, LssFrame};
use canopen_rs::pdo::{self, MappingEntry, PdoKind, PdoMapping, default_cob_id};
use canopen_rs::sdo::block::{self, BlockReceiver, BlockWriter};
use canopen_rs::sdo::{decode_abort, request_cob_id, response_cob_id};
use canopen_rs::{Address, ByteString, DataType, Entry, NmtCommand, NmtState, NodeId, ObjectDictionary, Value};
use mrroc_peers::{Checks, Outcome, PATIENCE, Wire, arguments, bytes, holds, same};

/// Identity of the emulated drive.
const IDENTITY: (u32, u32, u32) = (0x0000_00FB, 0x6150_0000, 0x0170_0000);
/// An object that accepts any bytes.
const DOMAIN: Address = Address::new(0x2FF0, 2);
const SEGMENTED: [usize; 13] = [0, 1, 3, 4, 5, 6, 7, 8, 13, 14, 15, 31, 32];
/// Lengths around the limits of segments and of blocks of 127 segments (889), and the longest value that the drive
/// stores.
const BLOCKS: [usize; 13] = [1, 4, 5, 7, 8, 14, 28, 29, 888, 889, 890, 896, 1022];
const PASSED: usize = 146 * 7;
/// Bit number that starts a fastscan (CiA 305); the library's `FASTSCAN_INIT` is 32.
const FASTSCAN_RESET: u8 = 0x80;
/// A drive answers a fastscan at once, and silence means "no". A busy machine may delay one of the hundred answers.
/// Each attempt therefore waits twice as long as the previous one, up to `LONGEST`.
const SILENCE: Duration = Duration::from_millis(15);
const LONGEST: Duration = Duration::from_millis(120);
const ATTEMPTS: usize = 20;

struct Master {
    bus: SocketCan,
    wire: Wire,
    node: NodeId,
    heard: RefCell<HeartbeatMonitor>,
}

fn main() {
    let (interface, node) = arguments();
    let wire = Wire::new(&interface);
    let bus = SocketCan::open(&interface).expect("the interface is there");
    bus.set_read_timeout(PATIENCE).expect("the socket takes a time-out");
    let mut checks = Checks::new(wire.clone());
    let m = Master { bus, wire, node: id(node), heard: RefCell::new(HeartbeatMonitor::new(PATIENCE)) };
    checks.check("a_reset_drive_boots_and_beats", || m.boots());
    checks.check("nmt_commands_are_obeyed", || m.commands());
    checks.check("the_identity_is_read", || m.identity().map(|_| ()));
    checks.check("numbers_of_every_size_are_written_and_read_back", || m.numbers());
    checks.check("a_text_is_uploaded_in_segments", || m.text());
    checks.check("segments_carry_every_length_both_ways", || m.segments());
    checks.check("blocks_carry_every_length_both_ways", || m.blocks());
    checks.check("refusals_have_the_codes_of_cia_301", || m.refusals());
    checks.check("an_emergency_is_understood", || m.emergency());
    checks.check("pdos_are_configured_and_pass_with_sync", || m.pdos());
    checks.check("layer_settings_renumber_the_drive", || m.renumbers());
    checks.check("a_fastscan_finds_a_drive_without_a_node_id", || m.fastscan());
    exit(checks.finish());
}

fn id(node: u8) -> NodeId {
    NodeId::new(node).expect("a node-ID")
}

fn said(error: impl Display) -> String {
    error.to_string()
}

/// An error of the library during encoding or decoding.
fn library(error: canopen_rs::Error) -> String {
    format!("canopen-rs: {error:?}")
}

/// Asserts that the transfer was aborted with this code.
fn aborted<T>(result: Result<T, SdoError>, expected: u32) -> Outcome {
    match result {
        Err(SdoError::Aborted(code)) => same("abort code", code, expected),
        Err(other) => Err(format!("{other}, expected abort {expected:#010x}")),
        Ok(_) => Err(format!("went through, expected abort {expected:#010x}")),
    }
}

impl Master {
    fn read(&self, index: u16, subindex: u8, data_type: DataType) -> Result<Value, SdoError> {
        self.bus.sdo_read(self.node, Address::new(index, subindex), data_type)
    }

    fn write(&self, index: u16, subindex: u8, value: Value) -> Result<(), SdoError> {
        self.bus.sdo_write(self.node, Address::new(index, subindex), value)
    }

    fn reads(&self, index: u16, subindex: u8, expected: Value) -> Outcome {
        let what = format!("{index:04X}:{subindex:02X}");
        let found = self.read(index, subindex, expected.data_type());
        same(&what, found.map_err(said)?, expected)
    }

    fn both(&self, index: u16, subindex: u8, value: Value) -> Outcome {
        self.write(index, subindex, value).map_err(said)?;
        self.reads(index, subindex, value)
    }

    fn tell(&self, command: NmtCommand, node: NodeId) -> Outcome {
        self.bus.send_nmt(command, node).map_err(said)
    }

    /// Waits for the next frame with this identifier.
    fn receive(&self, cob_id: u16) -> Result<Received, String> {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            let frame = self.bus.recv().map_err(said)?;
            if frame.cob_id == cob_id {
                return Ok(frame);
            }
        }
        Err(format!("no frame {cob_id:03X}"))
    }

    /// Waits until the library has decoded this state.
    fn hears(&self, state: NmtState, node: NodeId) -> Outcome {
        let end = Instant::now() + PATIENCE;
        loop {
            let frame = self.bus.recv().map_err(said)?;
            let mut heard = self.heard.borrow_mut();
            let it = heard.on_frame(frame.cob_id, frame.data(), Instant::now());
            if it == Some((node, state)) {
                return Ok(());
            }
            let last = heard.state(node);
            holds(&format!("heard {last:?}, expected {state:?}"), Instant::now() < end)?;
        }
    }

    fn boots_by(&self, command: NmtCommand, told: NodeId, node: NodeId) -> Outcome {
        self.tell(command, told)?;
        self.hears(NmtState::Initialising, node)
    }

    fn boots(&self) -> Outcome {
        self.boots_by(NmtCommand::ResetNode, self.node, self.node)?;
        self.both(0x1017, 0, Value::Unsigned16(20))?;
        self.hears(NmtState::PreOperational, self.node)
    }

    fn commands(&self) -> Outcome {
        for (command, state) in [
            (NmtCommand::StartRemoteNode, NmtState::Operational),
            (NmtCommand::StopRemoteNode, NmtState::Stopped),
            (NmtCommand::EnterPreOperational, NmtState::PreOperational),
        ] {
            self.tell(command, self.node)?;
            self.hears(state, self.node)?;
        }
        self.tell(NmtCommand::StartRemoteNode, NodeId::BROADCAST)?;
        self.hears(NmtState::Operational, self.node)?;
        self.boots_by(NmtCommand::ResetCommunication, self.node, self.node)?;
        self.reads(0x1017, 0, Value::Unsigned16(0))
    }

    fn identity(&self) -> Result<LssAddress, String> {
        let number = |subindex| match self.read(0x1018, subindex, DataType::Unsigned32) {
            Ok(Value::Unsigned32(number)) => Ok(number),
            Ok(other) => Err(format!("1018:{subindex:02X}: {other:?}")),
            Err(error) => Err(said(error)),
        };
        let (vendor, product, revision) = IDENTITY;
        same("vendor", number(1)?, vendor)?;
        same("product", number(2)?, product)?;
        same("revision", number(3)?, revision)?;
        Ok(LssAddress {
            vendor_id: vendor,
            product_code: product,
            revision_number: revision,
            serial_number: number(4)?,
        })
    }

    fn numbers(&self) -> Outcome {
        self.both(0x6098, 0, Value::Integer8(-3))?;
        self.both(0x1017, 0, Value::Unsigned16(0x1234))?;
        self.both(0x1017, 0, Value::Unsigned16(0))?;
        self.both(0x6081, 0, Value::Unsigned32(0x0BCD_EF01))?;
        self.reads(0x1000, 0, Value::Unsigned32(0x0002_0192))?;
        self.reads(0x1018, 0, Value::Unsigned8(4))
    }

    fn text(&self) -> Outcome {
        let name = ByteString::from_str("EPOS4").map_err(library)?;
        self.reads(0x1008, 0, Value::VisibleString(name))
    }

    fn segments(&self) -> Outcome {
        for length in SEGMENTED {
            let data = ByteString::from_bytes(&bytes(length)).map_err(library)?;
            let both = self.both(DOMAIN.index, DOMAIN.subindex, Value::Domain(data));
            both.map_err(|error| format!("{length} bytes: {error}"))?;
        }
        Ok(())
    }

    fn blocks(&self) -> Outcome {
        for length in BLOCKS {
            let data = bytes(length);
            for crc in [true, false] {
                let what = |error| format!("{length} bytes, checksum {crc}: {error}");
                self.block_download(DOMAIN, &data, crc).map_err(what)?;
                let found = self.block_upload(DOMAIN, crc).map_err(what)?;
                same(&what("uploaded".to_owned()), found, data.clone())?;
            }
        }
        Ok(())
    }

    fn request(&self, frame: &[u8; 8]) -> Outcome {
        self.bus.send(request_cob_id(self.node), frame).map_err(said)
    }

    fn response(&self) -> Result<[u8; 8], String> {
        let frame = *self.receive(response_cob_id(self.node))?.payload();
        match decode_abort(&frame) {
            Ok((_, code)) => Err(format!("aborted {code:#010x}")),
            Err(_) => Ok(frame),
        }
    }

    fn block_download(&self, object: Address, data: &[u8], crc: bool) -> Outcome {
        let size = u32::try_from(data.len()).ok();
        self.request(&block::encode_download_initiate(object, size, crc))?;
        let agreed = block::decode_download_initiate_response(&self.response()?).map_err(library)?;
        same("object", agreed.address, object)?;
        let mut writer = BlockWriter::new(data, agreed.blksize);
        while !writer.is_done() {
            let mut sent = 0;
            while let Some(segment) = writer.next_segment() {
                self.request(&segment)?;
                sent += 1;
            }
            let (acknowledged, size) = block::decode_sub_response(&self.response()?).map_err(library)?;
            same("acknowledged", acknowledged, sent)?;
            writer.start_sub_block(size);
        }
        self.request(&writer.end_frame(crc && agreed.crc_support))?;
        block::decode_end_response(&self.response()?).map_err(library)
    }

    fn block_upload(&self, object: Address, crc: bool) -> Result<Vec<u8>, String> {
        self.request(&block::encode_upload_initiate(object, block::MAX_BLKSIZE, crc))?;
        let begun = block::decode_upload_initiate_response(&self.response()?).map_err(library)?;
        same("object", begun.address, object)?;
        self.request(&block::encode_upload_start())?;
        let mut receiver = BlockReceiver::<PASSED>::new();
        while !receiver.is_done() {
            let frame = self.response()?;
            let segment = block::decode_sub_segment(&frame);
            receiver.push(&segment).map_err(library)?;
            if segment.last || segment.seqno == block::MAX_BLKSIZE {
                self.request(&block::encode_sub_response(segment.seqno, block::MAX_BLKSIZE))?;
            }
        }
        let (unused, sum) = block::decode_end(&self.response()?).map_err(library)?;
        let data = receiver.finish(unused, sum, crc && begun.crc_support).map_err(library)?;
        let size = begun.size.map(|size| size as usize);
        same("announced size", size, Some(data.len()))?;
        self.request(&block::encode_end_response())?;
        Ok(data.to_vec())
    }

    fn refusals(&self) -> Outcome {
        let byte = Value::Unsigned8(0);
        aborted(self.read(0x5FFF, 0, DataType::Unsigned8), 0x0602_0000)?;
        aborted(self.write(0x5FFF, 0, byte), 0x0602_0000)?;
        aborted(self.read(0x1018, 9, DataType::Unsigned8), 0x0609_0011)?;
        aborted(self.write(0x1000, 0, Value::Unsigned32(0)), 0x0601_0002)?;
        aborted(self.write(0x6040, 0, Value::Unsigned32(0)), 0x0607_0010)?;
        aborted(self.write(0x6081, 0, Value::Unsigned16(0)), 0x0607_0013)?;
        aborted(self.write(0x6081, 0, Value::Unsigned64(0)), 0x0607_0010)?;
        aborted(self.write(0x60C2, 1, Value::Unsigned8(200)), 0x0609_0030)?;
        let none = self.block_upload(Address::new(0x5FFF, 0), true);
        same("block upload", none, Err("aborted 0x06020000".to_owned()))?;
        let long = self.block_download(DOMAIN, &bytes(PASSED + 1), true);
        same("block download", long, Err("aborted 0x05040005".to_owned()))?;
        // The next transfer succeeds.
        self.reads(0x1000, 0, Value::Unsigned32(0x0002_0192))
    }

    /// Sends an RPDO that is too short.
    fn emergency(&self) -> Outcome {
        self.tell(NmtCommand::StartRemoteNode, self.node)?;
        let rpdo = default_cob_id(PdoKind::Receive, 1, self.node).ok_or("no identifier")?;
        self.bus.send(rpdo, &[6]).map_err(said)?;
        let frame = self.receive(emcy_cob_id(self.node))?;
        let emergency = EmergencyMessage::decode(frame.payload()).map_err(library)?;
        same("error code", emergency.error_code, 0x8210)?;
        same("error register", emergency.error_register.0, 0x11)?;
        self.reads(0x1001, 0, Value::Unsigned8(0x11))?;
        self.boots_by(NmtCommand::ResetNode, self.node, self.node)
    }

    /// Maps a synchronous PDO in the sequence that CiA 301 requires.
    fn map<const N: usize>(&self, at: u16, cob_id: u32, mapping: &PdoMapping<N>) -> Outcome {
        self.both(at, 1, Value::Unsigned32(cob_id | 0x8000_0000))?;
        self.both(at + 0x200, 0, Value::Unsigned8(0))?;
        for (entry, sub) in mapping.entries().iter().zip(1..) {
            self.both(at + 0x200, sub, Value::Unsigned32(entry.to_u32()))?;
        }
        self.both(at + 0x200, 0, Value::Unsigned8(mapping.len() as u8))?;
        self.both(at, 2, Value::Unsigned8(1))?;
        self.both(at, 1, Value::Unsigned32(cob_id))
    }

    fn pdos(&self) -> Outcome {
        let identifier = |kind, number| default_cob_id(kind, number, self.node).ok_or("no identifier");
        let (tpdo, rpdo) = (identifier(PdoKind::Transmit, 1)?, identifier(PdoKind::Receive, 2)?);
        let mut image = ObjectDictionary::<4>::new();
        let mut transmitted = PdoMapping::<8>::new();
        let mut received = PdoMapping::<8>::new();
        for (index, value) in [
            (0x6041, Value::Unsigned16(0)),
            (0x6064, Value::Integer32(0)),
            (0x607A, Value::Integer32(0)),
            (0x60FF, Value::Integer32(-7)),
        ] {
            image.insert(Address::new(index, 0), Entry::rw(value)).map_err(library)?;
            let entry = MappingEntry::new(index, 0, value.size() as u8 * 8);
            let mapping = match index {
                0x6041 | 0x6064 => &mut transmitted,
                _ => &mut received,
            };
            mapping.push(entry).map_err(library)?;
        }
        self.map(0x1800, 0x4000_0000 | u32::from(tpdo), &transmitted)?;
        self.map(0x1401, u32::from(rpdo), &received)?;
        self.tell(NmtCommand::StartRemoteNode, self.node)?;
        let mut data = [0; 8];
        let length = pdo::pack(&received, &image, &mut data).map_err(library)?;
        self.bus.send(rpdo, &data[..length]).map_err(said)?;
        self.reads(0x60FF, 0, Value::Integer32(0))?;
        self.bus.send(canopen_rs::sync::SYNC_COB_ID, &[]).map_err(said)?;
        let frame = self.receive(tpdo)?;
        pdo::unpack(&transmitted, &mut image, frame.data()).map_err(library)?;
        self.reads(0x60FF, 0, Value::Integer32(-7))?;
        for index in [0x6041, 0x6064] {
            self.reads(index, 0, image.read(Address::new(index, 0)).map_err(library)?)?;
        }
        self.boots_by(NmtCommand::ResetNode, self.node, self.node)
    }

    /// Sends an LSS request and waits for its answer.
    fn ask(&self, request: &LssFrame) -> Result<LssFrame, String> {
        self.bus.send(lss::LSS_MASTER_COB_ID, request).map_err(said)?;
        loop {
            let answer = *self.receive(lss::LSS_SLAVE_COB_ID)?.payload();
            // Answers to the fastscan were checked on the wire.
            if !lss::is_identify_slave_response(&answer) {
                return Ok(answer);
            }
        }
    }

    /// Switches the drive to configuration mode and assigns a node-ID.
    fn set(&self, address: &LssAddress, present: u8, node: u8) -> Outcome {
        let [vendor, product, revision, serial] = lss::encode_switch_selective(address);
        for part in [lss::encode_switch_global(false), vendor, product, revision] {
            self.bus.send(lss::LSS_MASTER_COB_ID, &part).map_err(said)?;
        }
        let selected = self.ask(&serial)?;
        holds("not selected", lss::is_switch_selective_response(&selected))?;
        let told = self.ask(&lss::encode_inquire_node_id())?;
        same("node-ID", lss::decode_inquire_node_id_response(&told), Some(present))?;
        let refused = self.ask(&lss::encode_configure_node_id(200))?;
        same("node-ID 200", lss::decode_configure_node_id_response(&refused), Some(Err(1)))?;
        let taken = self.ask(&lss::encode_configure_node_id(node))?;
        same("node-ID", lss::decode_configure_node_id_response(&taken), Some(Ok(())))?;
        let waiting = lss::encode_switch_global(false);
        self.bus.send(lss::LSS_MASTER_COB_ID, &waiting).map_err(said)
    }

    fn renumbers(&self) -> Outcome {
        let (own, other) = (self.node.raw(), 0x21);
        let address = self.identity()?;
        for (present, wanted) in [(own, other), (other, own)] {
            self.set(&address, present, wanted)?;
            self.boots_by(NmtCommand::ResetCommunication, id(present), id(wanted))?;
        }
        Ok(())
    }

    /// Whether any drive answers within the time limit of the scan.
    fn answered(&self, request: &LssFrame, silence: Duration) -> Result<bool, String> {
        let mark = self.wire.mark();
        self.bus.send(lss::LSS_MASTER_COB_ID, request).map_err(said)?;
        std::thread::sleep(silence);
        Ok(self.wire.any(mark, |seen| {
            let frame: Option<LssFrame> = seen.data.clone().try_into().ok();
            seen.id == lss::LSS_SLAVE_COB_ID && frame.is_some_and(|it| lss::is_identify_slave_response(&it))
        }))
    }

    /// The library starts with bit number 32, which CiA 305 reserves; the standard requires 0x80. Drives ignore the
    /// wrong number, as they should. The first frame is corrected here, and the library sends the rest.
    fn fastscan(&self) -> Outcome {
        let address = self.identity()?;
        self.set(&address, self.node.raw(), lss::UNCONFIGURED_NODE_ID)?;
        self.tell(NmtCommand::ResetCommunication, self.node)?;
        let first = FastscanMaster::new().next_request().ok_or("no first frame")?;
        same("bit number of the first frame", first[5], FASTSCAN_INIT)?;
        let mut found = None;
        let mut silence = SILENCE;
        for _ in 0..ATTEMPTS {
            holds("the library's first frame was answered", !self.answered(&first, silence)?)?;
            let mut master = FastscanMaster::new();
            while let Some(mut request) = master.next_request() {
                if request == first {
                    request[5] = FASTSCAN_RESET;
                }
                let answered = self.answered(&request, silence)?;
                master.on_response(answered);
            }
            found = master.found().then(|| master.address());
            if found == Some(address) {
                break;
            }
            silence = LONGEST.min(2 * silence);
        }
        same("found", found, Some(address))?;
        // The scan left the drive in configuration mode.
        let taken = self.ask(&lss::encode_configure_node_id(self.node.raw()))?;
        same("node-ID", lss::decode_configure_node_id_response(&taken), Some(Ok(())))?;
        let waiting = lss::encode_switch_global(false);
        self.bus.send(lss::LSS_MASTER_COB_ID, &waiting).map_err(said)?;
        self.hears(NmtState::Initialising, self.node)
    }
}
