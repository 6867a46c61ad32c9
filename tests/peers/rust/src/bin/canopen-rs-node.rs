//! A drive made with canopen-rs 0.6.1: `canopen-rs-node INTERFACE NODE SERIAL`, node-ID 255 for none. The program ends
//! when its standard input is closed.
//!
//! The node of the library serves SDO, PDOs, EMCY and LSS. This program implements the application: resets, the
//! heartbeat timer, the reaction to SYNC, and the CiA 402 drive.

use std::io::Read;
use std::process::exit;
use std::thread;
use std::time::{Duration, Instant};

use canopen_host::transport::SocketCan;
use canopen_rs::emcy::{EmergencyMessage, ErrorRegister};
use canopen_rs::lss::UNCONFIGURED_NODE_ID;
use canopen_rs::nmt::{NMT_COMMAND_COB_ID, NmtState};
use canopen_rs::pdo::{PdoKind, default_cob_id};
use canopen_rs::sync::SYNC_COB_ID;
use canopen_rs::{
    Address, ByteString, Entry, LssAddress, LssState, Node, NodeId, ObjectDictionary, StandardObjects, TxFrame, Value,
};
use mrroc_peers::drive::{DEVICE_TYPE, Drive, Objects};

const OBJECTS: usize = 256;
/// A value written here is sent as an emergency; 0 clears the error.
const EMERGENCY: Address = Address::new(0x2F01, 0);
const LOOK: Duration = Duration::from_millis(2);

struct Dictionary<'a>(&'a mut ObjectDictionary<OBJECTS>);

impl Objects for Dictionary<'_> {
    fn get(&self, index: u16) -> i64 {
        match self.0.read(Address::new(index, 0)) {
            Ok(Value::Integer8(it)) => it.into(),
            Ok(Value::Integer32(it)) => it.into(),
            Ok(Value::Unsigned16(it)) => it.into(),
            other => panic!("{index:04X}: {other:?}"),
        }
    }

    fn set(&mut self, index: u16, value: i64) {
        let at = Address::new(index, 0);
        let value = match self.0.read(at) {
            Ok(Value::Integer8(_)) => Value::Integer8(value as i8),
            Ok(Value::Integer32(_)) => Value::Integer32(value as i32),
            Ok(Value::Unsigned16(_)) => Value::Unsigned16(value as u16),
            other => panic!("{index:04X}: {other:?}"),
        };
        self.0.set(at, value).expect("it is there");
    }
}

fn dictionary(node: NodeId, identity: LssAddress) -> ObjectDictionary<OBJECTS> {
    let mut objects = ObjectDictionary::new();
    let standard = StandardObjects::new(DEVICE_TYPE, identity).with_error_history(4).with_device_name("canopen-rs");
    standard.insert_into(&mut objects).expect("there is room");
    let mut put = |index, subindex, entry| {
        let put = objects.insert(Address::new(index, subindex), entry);
        put.expect("there is room");
    };
    let consumers = [Value::Unsigned8(2), Value::Unsigned32(0), Value::Unsigned32(0)];
    for (value, sub) in consumers.into_iter().zip(0..) {
        put(0x1016, sub, if sub == 0 { Entry::constant(value) } else { Entry::rw(value) });
    }
    for number in 0..4 {
        for (kind, at) in [(PdoKind::Receive, 0x1400), (PdoKind::Transmit, 0x1800)] {
            let cob_id = default_cob_id(kind, number as u8 + 1, node).expect("one of four");
            put(at + number, 0, Entry::constant(Value::Unsigned8(3)));
            put(at + number, 1, Entry::rw(Value::Unsigned32(0x8000_0000 | u32::from(cob_id))));
            put(at + number, 2, Entry::rw(Value::Unsigned8(255)));
            put(at + number, 3, Entry::rw(Value::Unsigned16(0)));
            put(at + 0x200 + number, 0, Entry::rw(Value::Unsigned8(0)));
            for sub in 1..=8 {
                put(at + 0x200 + number, sub, Entry::rw(Value::Unsigned32(0)));
            }
        }
    }
    put(0x2000, 0, Entry::rw(Value::Unsigned32(0)));
    put(0x2001, 0, Entry::rw(Value::Integer16(0)));
    put(0x2002, 0, Entry::rw(Value::Unsigned8(0)));
    put(0x2F00, 0, Entry::rw(Value::Domain(ByteString::new())));
    put(EMERGENCY.index, EMERGENCY.subindex, Entry::rw(Value::Unsigned16(0)));
    put(0x603F, 0, Entry::ro(Value::Unsigned16(0)));
    put(0x6040, 0, Entry::rw(Value::Unsigned16(0)));
    put(0x6041, 0, Entry::ro(Value::Unsigned16(0)));
    put(0x6007, 0, Entry::rw(Value::Integer16(0)));
    put(0x605A, 0, Entry::rw(Value::Integer16(0)));
    put(0x6060, 0, Entry::rw(Value::Integer8(0)));
    put(0x6061, 0, Entry::ro(Value::Integer8(0)));
    put(0x6064, 0, Entry::ro(Value::Integer32(1000)));
    put(0x6065, 0, Entry::rw(Value::Unsigned32(0)));
    put(0x6077, 0, Entry::ro(Value::Integer16(0)));
    put(0x607A, 0, Entry::rw(Value::Integer32(0)));
    put(0x6085, 0, Entry::rw(Value::Unsigned32(0)));
    put(0x6098, 0, Entry::rw(Value::Integer8(0)));
    put(0x6099, 0, Entry::constant(Value::Unsigned8(2)));
    put(0x6099, 1, Entry::rw(Value::Unsigned32(0)));
    put(0x6099, 2, Entry::rw(Value::Unsigned32(0)));
    put(0x609A, 0, Entry::rw(Value::Unsigned32(0)));
    put(0x60C2, 0, Entry::constant(Value::Unsigned8(2)));
    put(0x60C2, 1, Entry::rw(Value::Unsigned8(1)));
    put(0x60C2, 2, Entry::rw(Value::Integer8(-3)));
    // Homing and cyclic synchronous position mode.
    put(0x6502, 0, Entry::ro(Value::Unsigned32(0x0000_00A0)));
    objects
}

struct Device {
    bus: SocketCan,
    node: Node<OBJECTS>,
    identity: LssAddress,
    drive: Drive,
    heartbeat: Option<Instant>,
}

impl Device {
    fn new(bus: SocketCan, node: u8, identity: LssAddress) -> Self {
        let mut device =
            Self { bus, node: Self::fresh(node, identity), identity, drive: Drive::default(), heartbeat: None };
        device.boot(node);
        device
    }

    fn fresh(node: u8, identity: LssAddress) -> Node<OBJECTS> {
        let id = NodeId::new(node).unwrap_or(NodeId::new(127).expect("a node-ID"));
        let mut fresh = Node::new(id, dictionary(id, identity));
        if node == UNCONFIGURED_NODE_ID {
            fresh.enable_lss_unconfigured(identity);
        } else {
            fresh.enable_lss(identity);
        }
        fresh
    }

    fn send(&self, frame: &TxFrame) {
        self.bus.send(frame.cob_id, frame.data()).expect("the interface takes frames");
    }

    fn boot(&mut self, node: u8) {
        if node == UNCONFIGURED_NODE_ID {
            return;
        }
        self.show();
        let boot = self.node.boot();
        self.send(&boot);
    }

    fn show(&mut self) {
        let operational = self.node.state() == NmtState::Operational;
        self.drive.step(&mut Dictionary(self.node.od_mut()), operational);
    }

    /// A reset of the node clears everything except the node-ID. A reset of communication clears the objects below
    /// 0x2000.
    fn reset(&mut self, all: bool) {
        let lss = self.node.lss().expect("it was enabled");
        let node = lss.pending_node_id();
        let before = std::mem::replace(&mut self.node, Self::fresh(node, self.identity));
        if !all {
            for index in (0x2000..0x2F02).chain(0x6000..0x6600) {
                for sub in 0..3 {
                    let at = Address::new(index, sub);
                    if let Ok(value) = before.od().read(at) {
                        self.node.od_mut().set(at, value).expect("it is there");
                    }
                }
            }
        }
        self.drive = Drive::default();
        self.heartbeat = None;
        self.boot(node);
    }

    fn take(&mut self, cob_id: u16, data: &[u8]) {
        if let Some(answer) = self.node.on_frame(cob_id, data) {
            self.send(&answer);
        }
        if let Some(written) = self.node.take_written_object() {
            self.written(written);
        }
        if cob_id == NMT_COMMAND_COB_ID && self.node.state() == NmtState::Initialising {
            let configured = self.node.lss().is_some_and(|lss| lss.node_id() != UNCONFIGURED_NODE_ID);
            if configured {
                self.reset(data.first() == Some(&0x81));
            }
            return;
        }
        // A node without a node-ID adopts the new node-ID when it returns to waiting mode (CiA 305).
        let lss = self.node.lss().expect("it was enabled");
        let given = lss.pending_node_id();
        if lss.node_id() == UNCONFIGURED_NODE_ID && given != UNCONFIGURED_NODE_ID && lss.state() == LssState::Waiting {
            self.reset(false);
        }
        if cob_id == SYNC_COB_ID && self.node.state() == NmtState::Operational {
            self.drive.synchronise(&mut Dictionary(self.node.od_mut()));
            self.show();
            for frame in self.node.sync_tpdos() {
                self.send(&frame);
            }
        }
        self.show();
    }

    fn written(&mut self, at: Address) {
        match (at.index, self.node.od().read(at)) {
            (0x1017, Ok(Value::Unsigned16(ms))) => {
                self.heartbeat = (ms > 0).then(Instant::now);
            }
            (0x1400..=0x1BFF, _) => self.node.configure_pdos_from_od(),
            (index, Ok(Value::Unsigned16(code))) if index == EMERGENCY.index => {
                let frame = match code {
                    0 => self.node.clear_errors(),
                    _ => self.node.raise_emergency(code, ErrorRegister(0x20), [1, 2, 3, 4, 5]),
                };
                let payload = frame.data().try_into().expect("eight bytes");
                assert!(EmergencyMessage::decode(payload).is_ok());
                self.send(&frame);
            }
            _ => {}
        }
    }

    fn serve(&mut self) -> ! {
        self.bus.set_read_timeout(LOOK).expect("the socket takes a time-out");
        loop {
            if let Ok(frame) = self.bus.recv() {
                self.take(frame.cob_id, frame.data());
            }
            if let Some(due) = self.heartbeat.filter(|due| *due <= Instant::now()) {
                self.send(&self.node.heartbeat());
                if let Ok(Value::Unsigned16(ms)) = self.node.od().read(Address::new(0x1017, 0)) {
                    self.heartbeat = Some(due + Duration::from_millis(ms.into()));
                }
            }
        }
    }
}

fn main() {
    let (interface, node, serial) = mrroc_peers::node_arguments();
    let identity = LssAddress {
        vendor_id: 0x0000_0C05,
        product_code: 0x0061_0001,
        revision_number: 0x0000_0601,
        serial_number: serial,
    };
    thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        exit(0);
    });
    let bus = SocketCan::open(&interface).expect("the interface is there");
    Device::new(bus, node, identity).serve()
}
