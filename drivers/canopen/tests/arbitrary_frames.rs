//! Arbitrary SDO transfers survive the wire. The fuzz target `layouts` decodes arbitrary frames.

use mrroc_canopen::sdo::{self, Expedited, Initiate, Request, Response, Segment};
use mrroc_canopen::{NodeId, Object};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();

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
}
