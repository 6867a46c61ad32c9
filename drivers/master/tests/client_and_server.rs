//! The SDO client against the SDO server, over a wire that loses frames.

use std::time::Duration;

use can::Instant;
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE, Server};
use canopen::{NodeId, Object};
use mrroc_master::sdo::{CAPACITY, Client, SdoCause, SdoError};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();
const TIME_OUT: Duration = Duration::from_millis(500);
/// A server does not give up before its client has.
const PATIENCE: Duration = Duration::from_secs(60);
/// The longest object that both ends can transfer.
const LONGEST: usize = if CAPACITY < MAX_SIZE { CAPACITY } else { MAX_SIZE };
const OBJECT: Object = Object::new(0x1008, 0);

/// One object of any length.
struct Single(Vec<u8>);

impl Dictionary for Single {
    fn size(&self, _: Object) -> Option<usize> {
        None
    }

    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        if object != OBJECT {
            return Err(AbortCode::NO_OBJECT);
        }
        into[..self.0.len()].copy_from_slice(&self.0);
        Ok(self.0.len())
    }

    fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode> {
        if object != OBJECT {
            return Err(AbortCode::READ_ONLY);
        }
        self.0 = data.to_vec();
        Ok(())
    }
}

/// Runs the transfer to its end. The wire loses the frames whose numbers are listed, both directions
/// counted together.
fn run(client: &mut Client, server: &mut Server, objects: &mut Single, lost: &[usize]) -> Result<Vec<u8>, SdoError> {
    let mut now = Instant::ZERO;
    let mut carried = 0;
    let mut arrives = || {
        carried += 1;
        !lost.contains(&(carried - 1))
    };
    loop {
        let mut quiet = true;
        while let Some(frame) = client.poll_transmit(now) {
            quiet = false;
            if arrives()
                && let Some(answer) = server.handle_frame(&frame, NODE, objects, now)
                && arrives()
            {
                client.handle(&answer, now);
            }
        }
        while let Some(segment) = server.poll_transmit(NODE, now) {
            quiet = false;
            if arrives() {
                client.handle(&segment, now);
            }
        }
        if let Some(result) = client.poll() {
            return result.map(|transfer| transfer.data.to_vec());
        }
        if !quiet {
            continue;
        }
        let deadline = client.poll_timeout();
        now = deadline.expect("a transfer under way has a deadline");
        if let Some(at) = server.poll_timeout().filter(|at| *at < now) {
            now = at;
        }
        client.handle_timeout(now);
        if let Some(abort) = server.handle_timeout(now)
            && arrives()
        {
            client.handle(&abort.encode(NODE), now);
        }
    }
}

proptest! {
    #[test]
    fn objects_of_any_length_come_across_whole_or_not_at_all(
        old in proptest::collection::vec(any::<u8>(), 0..=LONGEST),
        new in proptest::collection::vec(any::<u8>(), 0..=LONGEST),
        lost in proptest::collection::vec(0..60_usize, 0..4),
        retries in 0..5_u8,
    ) {
        let mut client = Client::new(NODE, TIME_OUT, retries);
        let mut server = Server::new(PATIENCE);
        let mut objects = Single(old.clone());
        let enough = usize::from(retries) >= lost.len();

        client.upload(OBJECT, Instant::ZERO).expect("idle");
        match run(&mut client, &mut server, &mut objects, &lost) {
            Ok(read) => prop_assert_eq!(&read, &old),
            Err(error) => prop_assert!(!enough, "{}", error),
        }
        client.download(OBJECT, &new, Instant::ZERO).expect("idle");
        match run(&mut client, &mut server, &mut objects, &lost) {
            Ok(written) => prop_assert!(written == new && objects.0 == new),
            Err(error) => {
                prop_assert!(!enough, "{}", error);
                prop_assert!(objects.0 == old || objects.0 == new);
            }
        }
    }

    #[test]
    fn blocks_of_any_size_come_across_whole_or_not_at_all(
        old in proptest::collection::vec(any::<u8>(), 0..=MAX_SIZE),
        new in proptest::collection::vec(any::<u8>(), 0..=MAX_SIZE),
        lost in proptest::collection::vec(0..200_usize, 0..4),
        retries in 0..5_u8,
        block_size in 1..=127_u8,
    ) {
        let mut client = Client::with_capacity(NODE, TIME_OUT, retries, MAX_SIZE);
        let mut server = Server::new(PATIENCE).with_block_size(block_size);
        let mut objects = Single(old.clone());

        client.block_upload(OBJECT, Instant::ZERO).expect("idle");
        match run(&mut client, &mut server, &mut objects, &lost) {
            Ok(read) => prop_assert_eq!(&read, &old),
            Err(error) => prop_assert!(!lost.is_empty(), "{}", error),
        }
        client.block_download(OBJECT, &new, Instant::ZERO).expect("idle");
        match run(&mut client, &mut server, &mut objects, &lost) {
            Ok(written) => prop_assert!(written == new && objects.0 == new),
            Err(error) => {
                prop_assert!(!lost.is_empty(), "{}", error);
                prop_assert!(objects.0 == old || objects.0 == new);
            }
        }
    }
}

#[test]
fn refusals_reach_the_client_with_their_code() {
    let object = Object::new(0x2000, 7);
    let mut client = Client::new(NODE, TIME_OUT, 3);
    let mut server = Server::new(PATIENCE);
    let mut objects = Single(vec![]);
    client.upload(object, Instant::ZERO).expect("idle");
    let read = run(&mut client, &mut server, &mut objects, &[]);
    assert_eq!(read, Err(SdoCause::Aborted { code: AbortCode::NO_OBJECT }.of(object)));
    client.download(object, &[0; 20], Instant::ZERO).expect("idle");
    let written = run(&mut client, &mut server, &mut objects, &[]);
    assert_eq!(written, Err(SdoCause::Aborted { code: AbortCode::READ_ONLY }.of(object)));
}
