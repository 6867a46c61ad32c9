//! Arbitrary frames: no state machine of the host panics, every transfer and every LSS service ends, and a fault reset
//! is always a rising edge.

use std::time::Duration;

use can::{Frame, Instant};
use canopen::cia402::{Controlword, Statusword};
use canopen::sdo::Request;
use canopen::{NodeId, Object, lss};
use mrroc_master::lss::{Master, Service};
use mrroc_master::power::{Goal, PowerStateMachine};
use mrroc_master::sdo::{CAPACITY, Client};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();
const TIME_OUT: Duration = Duration::from_millis(100);

/// Arbitrary frames, most of them with the identifiers and first bytes of SDO and LSS answers.
fn frames() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        6 => Just(0x582_u32),
        2 => Just(0x7E4),
        1 => 0..0x800_u32,
        1 => any::<u32>(),
    ];
    let lss = prop_oneof![Just(0x11), Just(0x13), Just(0x17), Just(0x44), Just(0x4F), Just(0x50), 0x5A..=0x5E_u8];
    let block = prop_oneof![Just(0xA2), Just(0xA4), Just(0xC6), Just(0xC1), Just(0xA1)];
    let data = prop_oneof![
        (lss, any::<[u8; 2]>()).prop_map(|(specifier, [a, b])| [specifier, a & 1, b, 0, 0, 0, 0, 0]),
        (block, any::<[u8; 4]>()).prop_map(|(specifier, [a, b, c, d])| [
            specifier,
            0x08,
            0x10,
            0,
            a & 0x7F,
            b & 1,
            c & 1,
            d & 1
        ]),
        (0..6_u8, any::<[u8; 6]>()).prop_map(|(number, [a, b, c, d, e, f])| [number, a, b, c, d, e, f, 0]),
        any::<[u8; 8]>(),
        (any::<u8>(), any::<[u8; 4]>()).prop_map(|(specifier, [a, b, c, d])| [specifier, 0x08, 0x10, 0, a, b, c, d]),
        (0..=1_u8, any::<[u8; 6]>()).prop_map(|(toggle, [a, b, c, d, e, f])| { [toggle << 4, a, b, c, d, e, f, 0] }),
    ];
    let length = prop_oneof![4 => Just(8_u8), 1 => 0..=8_u8];
    (id, length, data).prop_map(|(id, length, data)| Frame::from_raw(id, length, data).expect("at most 8 bytes"))
}

proptest! {
    #[test]
    fn a_transfer_ends_whatever_is_answered(
        data in proptest::option::of(proptest::collection::vec(any::<u8>(), 0..=CAPACITY)),
        by_blocks in any::<bool>(),
        answers in proptest::collection::vec((frames(), 0..150_u64), 0..200),
    ) {
        let object = Object::new(0x1008, 0);
        let mut now = Instant::ZERO;
        let mut client = Client::new(NODE, TIME_OUT, 2);
        match (&data, by_blocks) {
            (None, false) => client.upload(object, now).unwrap(),
            (None, true) => client.block_upload(object, now).unwrap(),
            (Some(data), false) => client.download(object, data, now).unwrap(),
            (Some(data), true) => client.block_download(object, data, now).unwrap(),
        }
        for (frame, millis) in answers {
            now += Duration::from_millis(millis);
            client.handle_timeout(now);
            client.handle(&frame, now);
            let mut sent = 0;
            while let Some(frame) = client.poll_transmit(now) {
                prop_assert!(Request::decode(&frame, NODE).is_some());
                sent += 1;
            }
            let sub_block = CAPACITY / 7 + 1;
            prop_assert!(sent <= if by_blocks { 2 + sub_block } else { 2 }, "{sent} frames at once");
        }
        // A sub-block under way is acknowledged up to seven times, each half as large as the one before.
        for _ in 0..=2 + 7 {
            if let Some(deadline) = client.poll_timeout() {
                client.handle_timeout(deadline);
            }
        }
        let written = client.poll().expect("retries are counted");
        if let (Ok(transfer), Some(data)) = (written, &data) {
            prop_assert_eq!(transfer.data, &data[..]);
        }
        prop_assert_eq!(client.poll_timeout(), None);
    }

    #[test]
    fn an_lss_service_ends_whatever_is_answered(
        service in 0..8_usize,
        answers in proptest::collection::vec((frames(), 0..150_u64), 0..200),
    ) {
        let services = [
            Service::SwitchGlobal(lss::Mode::Configuration),
            Service::SwitchSelective(lss::Identity::default()),
            Service::ConfigureNodeId(Some(NODE)),
            Service::Store,
            Service::InquireIdentity,
            Service::InquireNodeId,
            Service::IdentifyUnconfigured,
            Service::Fastscan,
        ];
        let mut now = Instant::ZERO;
        let mut master = Master::default();
        master.start(services[service], TIME_OUT, now).unwrap();
        let mut sent = 0;
        for (frame, millis) in answers {
            now += Duration::from_millis(millis);
            master.handle_timeout(now);
            master.handle(&frame, now);
            while let Some(frame) = master.poll_transmit(now) {
                prop_assert!(lss::Request::decode(&frame).is_some());
                sent += 1;
            }
        }
        for _ in 0..133 {
            if let Some(deadline) = master.poll_timeout() {
                master.handle_timeout(deadline);
                sent += usize::from(master.poll_transmit(deadline).is_some());
            }
        }
        prop_assert!(sent <= 133);
        prop_assert!(master.poll().is_some());
        prop_assert_eq!(master.poll_timeout(), None);
    }

    #[test]
    fn a_fault_reset_is_a_rising_edge_and_only_for_its_goal(
        goals in proptest::collection::vec(
            (proptest::sample::select(vec![Goal::Off, Goal::ResetFault, Goal::On]), any::<u16>()), 0..20,
        ),
    ) {
        let mut machine = PowerStateMachine::default();
        let mut last = None;
        for (goal, status) in goals {
            let word = machine.step(Statusword(status), goal);
            if word.has(Controlword::RESET) {
                prop_assert!(last.is_some_and(|last: Controlword| !last.has(Controlword::RESET)));
                prop_assert_eq!(goal, Goal::ResetFault);
            }
            last = Some(word);
        }
    }
}
