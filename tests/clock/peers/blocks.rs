//! Block transfers of python-canopen with this project's server. The objects of the server are longer than the objects
//! of a drive.

use std::collections::VecDeque;
use std::time::Duration;

use can::{Frame, Instant};
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE, Server};
use canopen::{NodeId, Object};
use hil::Device;
use kit::adapter::Adapter;
use kit::processors;

use super::{Bus, judged, python};

const NODE: NodeId = NodeId::new(1).unwrap();

/// A node with one object, 0x2F00, which stores every written value.
struct Store {
    server: Server,
    data: Data,
    queue: VecDeque<Frame>,
}

struct Data(Vec<u8>);

impl Dictionary for Data {
    fn size(&self, _: Object) -> Option<usize> {
        None
    }

    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        known(object)?;
        into[..self.0.len()].copy_from_slice(&self.0);
        Ok(self.0.len())
    }

    fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode> {
        known(object)?;
        self.0 = data.to_vec();
        Ok(())
    }
}

fn known(object: Object) -> Result<(), AbortCode> {
    let found = object == Object::new(0x2F00, 0);
    found.then_some(()).ok_or(AbortCode::NO_OBJECT)
}

impl Device for Store {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        let answer = self.server.handle_frame(frame, NODE, &mut self.data, now);
        self.queue.extend(answer);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let answer = self.queue.pop_front();
        answer.or_else(|| self.server.poll_transmit(NODE, now))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.server.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        let abort = self.server.handle_timeout(now);
        self.queue.extend(abort.map(|abort| abort.encode(NODE)));
    }
}

#[test]
fn python_canopen_moves_blocks_of_every_size_both_ways() {
    let test = "peers::blocks::python_canopen_moves_blocks_of_every_size_both_ways";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.6);
    for block_size in [127, 5] {
        let store = Store {
            server: Server::new(Duration::from_secs(1)).with_block_size(block_size),
            data: Data(Vec::new()),
            queue: VecDeque::new(),
        };
        Adapter::new(Some(Box::new(store))).served(|tty| {
            judged(&mut Bus::slcan(tty).script(&python, "blocks.py"));
        });
    }
}
