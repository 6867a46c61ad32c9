//! A node made with zencan-node 0.0.5: `zencan-node INTERFACE NODE SERIAL`, node-ID 255 for none. The program ends when
//! its standard input is closed.
//!
//! The library aborts an SDO transfer after 25 ms without a frame, which is too short on a machine that may pause. Its
//! clock therefore runs at a twentieth of real time here. The library has no EMCY, and its heartbeat time is a
//! constant.

use std::io::Read;
use std::process::exit;
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use socketcan::{CanFrame, CanSocket, EmbeddedFrame, Frame as _, Socket, StandardId};
use zencan_node::common::sdo::AbortCode;
use zencan_node::common::{CanId, CanMessage, NodeId};
use zencan_node::object_dict::SubObjectAccess;
use zencan_node::{Callbacks, Node};

mod zencan {
    zencan_node::include_modules!(ZENCAN_NODE);
}

const LOOK: Duration = Duration::from_millis(1);
const SLOWER: u128 = 20;
/// Longest value of object 0x2F00, bytes.
const ROOM: usize = 1022;

/// Object 0x2F00: bytes of any length.
struct Store(Mutex<(Vec<u8>, Vec<u8>)>);

static STORE: Store = Store(Mutex::new((Vec::new(), Vec::new())));

impl SubObjectAccess for Store {
    fn read(&self, offset: usize, into: &mut [u8]) -> Result<usize, AbortCode> {
        let data = &self.0.lock().expect("nobody panics with it").0;
        let rest = &data[offset.min(data.len())..];
        let length = rest.len().min(into.len());
        into[..length].copy_from_slice(&rest[..length]);
        Ok(length)
    }

    fn read_size(&self) -> usize {
        self.0.lock().expect("nobody panics with it").0.len()
    }

    fn write(&self, data: &[u8]) -> Result<(), AbortCode> {
        self.begin_partial()?;
        self.write_partial(data)?;
        self.end_partial()
    }

    fn begin_partial(&self) -> Result<(), AbortCode> {
        self.0.lock().expect("nobody panics with it").1.clear();
        Ok(())
    }

    fn write_partial(&self, data: &[u8]) -> Result<(), AbortCode> {
        let part = &mut self.0.lock().expect("nobody panics with it").1;
        part.extend_from_slice(data);
        if part.len() > ROOM {
            return Err(AbortCode::OutOfMemory);
        }
        Ok(())
    }

    fn end_partial(&self) -> Result<(), AbortCode> {
        let (whole, part) = &mut *self.0.lock().expect("nobody panics with it");
        std::mem::swap(whole, part);
        Ok(())
    }
}

fn message(frame: &CanFrame) -> Option<CanMessage> {
    let CanFrame::Data(frame) = frame else {
        return None;
    };
    let id = CanId::std(frame.raw_id() as u16);
    (!frame.is_extended()).then(|| CanMessage::new(id, frame.data()))
}

fn main() {
    let (interface, node, serial) = mrroc_peers::node_arguments();
    thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        exit(0);
    });
    zencan::OBJECT1018.set_serial(serial);
    zencan::OBJECT2F00.value.register_handler(&STORE);
    let socket = CanSocket::open(&interface).expect("the interface is there");
    socket.set_read_timeout(LOOK).expect("the socket takes a time-out");
    let id = NodeId::new(node).expect("a node-ID, or 255");
    let (mailbox, state) = (&zencan::NODE_MBOX, &zencan::NODE_STATE);
    let mut node = Node::new(id, Callbacks::new(), mailbox, state, &zencan::OD_TABLE);
    let began = Instant::now();
    loop {
        if let Some(message) = socket.read_frame().ok().as_ref().and_then(message) {
            // Frames of other services are returned by this call.
            let _ = mailbox.store_message(message);
        }
        node.process((began.elapsed().as_micros() / SLOWER) as u64);
        while let Some(message) = mailbox.next_transmit_message() {
            let id = StandardId::new(message.id().raw() as u16).expect("eleven bits");
            let frame = CanFrame::new(id, message.data()).expect("eight bytes");
            socket.write_frame(&frame).expect("the interface takes frames");
        }
    }
}
