//! Arbitrary frames: no layout panics, and every frame that a layout understands encodes to the same frame again.

use can::Frame;
use mrroc_canopen::cia402::{Controlword, HomingStatus, ModeOfOperation, Statusword};
use mrroc_canopen::emcy::Emergency;
use mrroc_canopen::heartbeat::Heartbeat;
use mrroc_canopen::sdo::{self, Expedited, Initiate, Request, Response, Segment, block};
use mrroc_canopen::sync::Sync;
use mrroc_canopen::time::TimeOfDay;
use mrroc_canopen::{NodeId, Object, cob, lss, nmt};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();

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
    (proptest::collection::vec(any::<u8>(), 0..=7), any::<bool>(), any::<bool>())
        .prop_map(|(data, toggle, last)| Segment::new(&data, toggle, last).expect("at most 7 bytes"))
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
        if let Some(time) = TimeOfDay::decode(&frame) {
            prop_assert_eq!(TimeOfDay::decode(&time.encode()), Some(time));
        }
        if let Some(sync) = Sync::decode(&frame) {
            prop_assert_eq!(sync.encode(), frame);
        }
        if let Some(emergency) = Emergency::decode(&frame) {
            prop_assert_eq!(emergency.encode(), frame);
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
    fn words_of_all_values_have_a_meaning(
        status in any::<u16>(),
        control in any::<u16>(),
        mode in any::<i8>(),
    ) {
        let status = Statusword(status);
        if let Some(bits) = status.power_state().bits() {
            prop_assert_eq!(bits.power_state(), status.power_state());
        }
        prop_assert_eq!(ModeOfOperation::from_raw(mode).raw(), mode);
        let _ = (HomingStatus::of(status), Controlword(control).power_command());
    }
}
