//! Whatever arrives on a bus, no object panics, none says what was not on the bus, and every
//! transfer ends.

use std::time::Duration;

use can::{Frame, Instant};
use mrroc_canopen::cia402::{Controlword, Goal, ModeOfOperation, PowerStateMachine, Statusword};
use mrroc_canopen::cob::Function;
use mrroc_canopen::emcy::{self, Emergency};
use mrroc_canopen::heartbeat::{self, Heartbeat};
use mrroc_canopen::pdo::{Entry, PdoMapping};
use mrroc_canopen::sdo::{self, Expedited, Initiate, Request, Response, Segment, block};
use mrroc_canopen::sync::Sync;
use mrroc_canopen::time::TimeOfDay;
use mrroc_canopen::{NodeId, Object, cob, guarding, lss, nmt};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();
const TIME_OUT: Duration = Duration::from_millis(100);

/// Any frame at all, mostly with the identifiers and first bytes that objects look at.
fn frames() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        4 => Just(0x582_u32),
        1 => Just(0x602),
        1 => prop_oneof![Just(0x7E4), Just(0x7E5)],
        1 => Just(0x702),
        1 => Just(0x082),
        1 => prop_oneof![Just(0x000), Just(0x080), Just(0x100), Just(0x182), Just(0x4000_0702)],
        1 => 0..0x800_u32,
        1 => any::<u32>(),
    ];
    let lss = prop_oneof![
        Just(0x11),
        Just(0x13),
        Just(0x17),
        Just(0x44),
        Just(0x4F),
        Just(0x50),
        0x5A..=0x5E_u8
    ];
    let block = prop_oneof![Just(0xA2), Just(0xA4), Just(0xC6), Just(0xC1), Just(0xA1)];
    let data = prop_oneof![
        (lss, any::<[u8; 2]>()).prop_map(|(specifier, [a, b])| [
            specifier,
            a & 1,
            b,
            0,
            0,
            0,
            0,
            0
        ]),
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
        (0..6_u8, any::<[u8; 6]>())
            .prop_map(|(number, [a, b, c, d, e, f])| [number, a, b, c, d, e, f, 0]),
        any::<[u8; 8]>(),
        (any::<u8>(), any::<[u8; 4]>())
            .prop_map(|(specifier, [a, b, c, d])| [specifier, 0x08, 0x10, 0, a, b, c, d]),
        (0..=1_u8, any::<[u8; 6]>())
            .prop_map(|(toggle, [a, b, c, d, e, f])| { [toggle << 4, a, b, c, d, e, f, 0] }),
    ];
    let length = prop_oneof![4 => Just(8_u8), 1 => 0..=8_u8];
    (id, length, data)
        .prop_map(|(id, length, data)| Frame::from_raw(id, length, data).expect("at most 8 bytes"))
}

fn objects() -> impl Strategy<Value = Object> {
    (any::<u16>(), any::<u8>()).prop_map(|(index, subindex)| Object::new(index, subindex))
}

fn initiates() -> impl Strategy<Value = Initiate> {
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 1..=4)
            .prop_map(|data| Initiate::Expedited(Expedited::new(&data).expect("1 to 4 bytes"))),
        any::<[u8; 4]>().prop_map(|data| Initiate::Expedited(Expedited::without_size(data))),
        any::<Option<u32>>().prop_map(|size| Initiate::Segmented { size }),
    ]
}

fn segments() -> impl Strategy<Value = Segment> {
    (
        proptest::collection::vec(any::<u8>(), 0..=7),
        any::<bool>(),
        any::<bool>(),
    )
        .prop_map(|(data, toggle, last)| {
            Segment::new(&data, toggle, last).expect("at most 7 bytes")
        })
}

proptest! {
    #[test]
    fn every_layout_takes_any_frame(frame in frames()) {
        for node in [NODE, NodeId::MAX] {
            if let Some(request) = Request::decode(&frame, node) {
                prop_assert_eq!(Request::decode(&request.encode(node), node), Some(request));
            }
            if let Some(response) = Response::decode(&frame, node) {
                prop_assert_eq!(Response::decode(&response.encode(node), node), Some(response));
            }
        }
        for node in [NODE, NodeId::MAX] {
            if let Some(request) = block::Request::decode(&frame, node) {
                prop_assert_eq!(block::Request::decode(&request.encode(node), node), Some(request));
            }
            if let Some(response) = block::Response::decode(&frame, node) {
                prop_assert_eq!(block::Response::decode(&response.encode(node), node), Some(response));
            }
            for id in [cob::sdo_request(node), cob::sdo_response(node)] {
                if let Some(segment) = block::Segment::decode(&frame, id) {
                    prop_assert_eq!(segment.encode(id), frame);
                }
            }
        }
        if let Some(request) = lss::Request::decode(&frame) {
            prop_assert_eq!(lss::Request::decode(&request.encode()), Some(request));
        }
        if let Some(response) = lss::Response::decode(&frame) {
            prop_assert_eq!(lss::Response::decode(&response.encode()), Some(response));
        }
        if let Some(request) = nmt::Request::decode(&frame) {
            prop_assert_eq!(request.encode(), frame);
        }
        if let Some(heartbeat) = Heartbeat::decode(&frame) {
            prop_assert_eq!(heartbeat.encode(), frame);
        }
        if let Some(guarded) = guarding::Response::decode(&frame) {
            prop_assert_eq!(guarded.encode(), frame);
        }
        if let Some(asked) = guarding::Request::decode(&frame) {
            prop_assert_eq!(guarding::Request::decode(&asked.encode()), Some(asked));
        }
        if let Some(time) = TimeOfDay::decode(&frame) {
            prop_assert_eq!(TimeOfDay::decode(&time.encode()), Some(time));
        }
        if let Some(sync) = Sync::decode(&frame) {
            prop_assert_eq!(sync.encode(), frame);
        }
        if let Some(emergency) = Emergency::decode(&frame) {
            prop_assert_eq!(emergency.encode(), frame);
        }
        if let Some(function) = frame.standard_data_id().and_then(Function::of) {
            prop_assert_eq!(Some(function.id()), frame.standard_data_id());
        }
    }

    #[test]
    fn every_transfer_that_can_be_built_survives_the_wire(
        object in objects(),
        initiate in initiates(),
        segment in segments(),
        code in any::<u32>(),
        toggle in any::<bool>(),
    ) {
        let code = sdo::AbortCode(code);
        for request in [
            Request::InitiateDownload { object, initiate },
            Request::DownloadSegment(segment),
            Request::InitiateUpload { object },
            Request::UploadSegment { toggle },
            Request::Abort { object, code },
        ] {
            prop_assert_eq!(Request::decode(&request.encode(NODE), NODE), Some(request));
        }
        for response in [
            Response::InitiateDownload { object },
            Response::DownloadSegment { toggle },
            Response::InitiateUpload { object, initiate },
            Response::UploadSegment(segment),
            Response::Abort { object, code },
        ] {
            prop_assert_eq!(Response::decode(&response.encode(NODE), NODE), Some(response));
        }
    }

    #[test]
    fn a_transfer_ends_whatever_is_answered(
        data in proptest::option::of(proptest::collection::vec(any::<u8>(), 0..=sdo::CAPACITY)),
        by_blocks in any::<bool>(),
        answers in proptest::collection::vec((frames(), 0..150_u64), 0..200),
    ) {
        let object = Object::new(0x1008, 0);
        let mut now = Instant::ZERO;
        let mut client = sdo::Client::new(NODE, TIME_OUT, 2);
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
            let sub_block = sdo::CAPACITY / 7 + 1;
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
        service in 0..10_usize,
        answers in proptest::collection::vec((frames(), 0..150_u64), 0..200),
    ) {
        let services = [
            lss::Service::SwitchGlobal(lss::Mode::Configuration),
            lss::Service::SwitchSelective(lss::Identity::default()),
            lss::Service::ConfigureNodeId(Some(NODE)),
            lss::Service::ConfigureBitTiming(lss::BitRate::Kbps500),
            lss::Service::ActivateBitTiming { delay_ms: 100 },
            lss::Service::Store,
            lss::Service::InquireIdentity,
            lss::Service::InquireNodeId,
            lss::Service::IdentifyUnconfigured,
            lss::Service::Fastscan,
        ];
        let mut now = Instant::ZERO;
        let mut master = lss::Master::new();
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
    fn every_listener_takes_any_frame(frames in proptest::collection::vec((frames(), 0..150_u64), 0..100)) {
        let mut master = nmt::Master::new();
        let mut heartbeats = heartbeat::Consumer::new(NODE, TIME_OUT);
        let mut emergencies = emcy::Consumer::new(NODE);
        let mut now = Instant::ZERO;
        let mut guard = guarding::Guard::new(NODE, TIME_OUT, 2, now).expect("times above zero");
        let mut guarded = true;
        let mut alive = false;
        for (frame, millis) in frames {
            now += Duration::from_millis(millis);
            heartbeats.handle_timeout(now);
            guard.handle_timeout(now);
            guard.handle(&frame, now);
            while let Some(event) = guard.poll() {
                match event {
                    guarding::Event::Lost { waited } => {
                        prop_assert!(guarded && waited >= 2 * TIME_OUT);
                        guarded = false;
                    }
                    guarding::Event::Recovered { .. } => {
                        prop_assert!(!guarded);
                        guarded = true;
                    }
                    guarding::Event::Changed { state } => prop_assert_eq!(guard.state(), Some(state)),
                    guarding::Event::Toggle => {}
                }
            }
            prop_assert_eq!(guard.is_lost(), !guarded);
            master.handle(&frame);
            heartbeats.handle(&frame, now);
            emergencies.handle(&frame, now);
            let heard = Heartbeat::decode(&frame);
            match master.poll() {
                Some(nmt::Event::Booted(node) | nmt::Event::Changed { node, .. }) => {
                    prop_assert_eq!(heard.map(|heartbeat| heartbeat.node), Some(node));
                }
                None => {}
            }
            prop_assert_eq!(master.poll(), None);
            while let Some(event) = heartbeats.poll() {
                match event {
                    heartbeat::Event::Lost { waited } => {
                        prop_assert!(alive && waited >= TIME_OUT);
                        alive = false;
                    }
                    heartbeat::Event::Recovered { .. } => prop_assert!(!alive),
                }
            }
            alive = heartbeats.poll_timeout().is_some();
            let emergency = Emergency::decode(&frame).filter(|emergency| emergency.node == NODE);
            prop_assert_eq!(emergencies.poll(), emergency);
        }
    }

    #[test]
    fn words_of_all_values_have_a_meaning(
        status in any::<u16>(),
        control in any::<u16>(),
        mode in any::<i8>(),
        goals in proptest::collection::vec((0..3_usize, any::<u16>()), 0..20),
    ) {
        let status = Statusword(status);
        if let Some(bits) = status.power_state().bits() {
            prop_assert_eq!(bits.power_state(), status.power_state());
        }
        prop_assert_eq!(ModeOfOperation::from_raw(mode).raw(), mode);
        let _ = (status.homing(), Controlword(control).power_command());
        let mut machine = PowerStateMachine::new();
        let mut last = None;
        for (goal, status) in goals {
            let word = machine.step(Statusword(status), Goal::ALL[goal]);
            if word.has(Controlword::RESET) {
                prop_assert!(last.is_some_and(|last: Controlword| !last.has(Controlword::RESET)));
                prop_assert_eq!(Goal::ALL[goal], Goal::ResetFault);
            }
            last = Some(word);
        }
    }

    #[test]
    fn mapped_values_do_not_touch_each_other(
        sizes in proptest::collection::vec(1..=8_u8, 0..=10),
        values in any::<[u64; 8]>(),
    ) {
        let entry = |(at, bytes): (usize, &u8)| Entry::new(Object::new(0x6000 + at as u16, 0), bytes * 8);
        let entries: Vec<_> = sizes.iter().enumerate().map(entry).collect();
        let fits = sizes.len() <= 8 && sizes.iter().sum::<u8>() <= 8;
        let mapping = PdoMapping::new(&entries);
        prop_assert_eq!(mapping.is_ok(), fits);
        if let Ok(mapping) = mapping {
            let mut frame = [0; 8];
            for ((_, slot), value) in mapping.slots().zip(values) {
                slot.write(&mut frame, value);
            }
            for ((_, slot), value) in mapping.slots().zip(values) {
                let unused = 64 - 8 * slot.bytes() as u32;
                prop_assert_eq!(slot.read_unsigned(&frame), value << unused >> unused);
                prop_assert_eq!(slot.read_signed(&frame), (value as i64) << unused >> unused);
            }
        }
    }
}
