//! Layouts of frames and telegrams: what a layout understands, it encodes to the same again.

use arbitrary::{Arbitrary, Unstructured};
use can::slcan::{AdapterReport, Command};
use can::{Frame, slcan};
use canopen::cia402::{Controlword, HomingStatus, ModeOfOperation, Statusword};
use canopen::emcy::Emergency;
use canopen::heartbeat::Heartbeat;
use canopen::sdo::{Request, Response, block};
use canopen::sync::Sync;
use canopen::time::TimeOfDay;
use canopen::{NodeId, cob, lss, nmt};
use serial::camera::{FrameHeader, HEADER};
use serial::{ati, epos2, epos4, hi_moxa, nfv2, ultrasonic};

use crate::frames::{AnyFrame, DRIVE};

/// Frames of CANopen, and telegrams of serial lines.
pub fn layouts(data: &[u8]) {
    let mut input = Unstructured::new(data);
    if let Ok(AnyFrame(frame)) = AnyFrame::arbitrary(&mut input) {
        of_canopen(&frame);
        of_slcan(&frame);
    }
    telegrams(input.take_rest());
}

fn of_canopen(frame: &Frame) {
    for node in [DRIVE, NodeId::MAX] {
        if let Some(request) = Request::decode(frame, node) {
            assert_eq!(Request::decode(&request.encode(node), node), Some(request));
        }
        if let Some(response) = Response::decode(frame, node) {
            assert_eq!(Response::decode(&response.encode(node), node), Some(response));
        }
        for id in [cob::sdo_request(node), cob::sdo_response(node)] {
            if let Some(segment) = block::Segment::decode(frame, id) {
                assert_eq!(segment.encode(id), *frame);
            }
        }
    }
    if let Some(request) = lss::Request::decode(frame) {
        assert_eq!(lss::Request::decode(&request.encode()), Some(request));
    }
    if let Some(response) = lss::Response::decode(frame) {
        assert_eq!(lss::Response::decode(&response.encode()), Some(response));
    }
    if let Some(request) = nmt::Request::decode(frame) {
        assert_eq!(request.encode(), *frame);
    }
    if let Some(heartbeat) = Heartbeat::decode(frame) {
        assert_eq!(heartbeat.encode(), *frame);
    }
    if let Some(time) = TimeOfDay::decode(frame) {
        assert_eq!(TimeOfDay::decode(&time.encode()), Some(time));
    }
    if let Some(sync) = Sync::decode(frame) {
        assert_eq!(sync.encode(), *frame);
    }
    if let Some(emergency) = Emergency::decode(frame) {
        assert_eq!(emergency.encode(), *frame);
    }
    if let &[low, high, mode, ..] = frame.data() {
        let status = Statusword(u16::from_le_bytes([low, high]));
        if let Some(bits) = status.power_state().bits() {
            assert_eq!(bits.power_state(), status.power_state());
        }
        assert_eq!(ModeOfOperation::from_raw(mode as i8).raw(), mode as i8);
        let _ = (HomingStatus::of(status), Controlword(status.0).power_command());
    }
}

fn of_slcan(frame: &Frame) {
    if let Some(line) = Command::Transmit(*frame).encode() {
        let line = line.strip_suffix(b"\r").expect("a command ends with its line");
        assert_eq!(Command::parse(line), Ok(Command::Transmit(*frame)));
    }
    let report = AdapterReport::Received { frame: *frame, stamp: None };
    if let Some(line) = report.encode() {
        let line = line.strip_suffix(b"\r").expect("a report ends with its line");
        assert_eq!(AdapterReport::parse(slcan::Piece::Line(line)), Ok(report));
    }
}

fn telegrams(bytes: &[u8]) {
    if let Some(frame) = nfv2::Frame::parse(bytes) {
        assert!(nfv2::Frame::length(bytes).is_some_and(|length| length <= bytes.len()));
        assert!(frame.commands().count() <= bytes.len() && frame.answers().count() <= bytes.len());
    }
    if let Some(chunk) = bytes.first_chunk::<{ hi_moxa::REQUEST }>()
        && let Some(request) = hi_moxa::Request::decode(chunk)
    {
        assert_eq!(hi_moxa::Request::decode(&request.encode()), Some(request));
    }
    if let Some(&chunk) = bytes.first_chunk::<{ hi_moxa::ANSWER }>() {
        assert_eq!(hi_moxa::Answer::decode(hi_moxa::Answer::decode(chunk).encode()), hi_moxa::Answer::decode(chunk));
    }
    if let Some(&chunk) = bytes.first_chunk::<{ ati::REPLY }>() {
        let reply = ati::Reply::decode(chunk);
        assert_eq!(ati::Reply::decode(reply.encode()), reply);
    }
    if let Some(header) = bytes.first_chunk::<HEADER>().and_then(FrameHeader::decode) {
        assert_eq!(FrameHeader::decode(&header.encode()), Some(header));
        assert!(header.pixels() <= usize::from(serial::camera::MAX_SIDE).pow(2));
    }
    if let Ok(request) = ultrasonic::Request::decode(bytes) {
        let (body, length) = request.body();
        assert_eq!(ultrasonic::Request::decode(&body[..length]), Ok(request));
    }
    if let Some(reply) = ultrasonic::Reply::decode(bytes) {
        let mut body = [0; 256];
        if let Some(length) = reply.encode(&mut body) {
            assert_eq!(ultrasonic::Reply::decode(&body[..length]), Some(reply));
        }
    }
    if let [opcode, body @ ..] = bytes {
        if let Ok(request) = epos2::Request::decode(*opcode, body) {
            let telegram = request.encode();
            assert_eq!(epos2::Request::decode(telegram.opcode(), telegram.body()), Ok(request));
        }
        let _ = epos2::Answer::decode(body);
        if let Some(frame) = epos4::Frame::new(*opcode, body)
            && let Some(request) = epos4::Request::decode(&frame)
        {
            let again = request.encode();
            assert_eq!(epos4::Request::decode(&again), Some(request));
            let _ = epos4::Answer::decode(&frame, &request);
        }
    }
}
