//! Text of the frames of the layer setting services (LSS).

use can::Frame;
use canopen::lss::{self, BitRate, Mode, Part};

use super::words;

pub(super) fn request(frame: &Frame) -> Option<String> {
    let text = match lss::Request::decode(frame)? {
        lss::Request::SwitchGlobal(Mode::Waiting) => "all nodes to waiting".to_owned(),
        lss::Request::SwitchGlobal(Mode::Configuration) => "all nodes to configuration".to_owned(),
        lss::Request::SwitchSelective { part, value } => format!("select {part} {value:#010x}"),
        lss::Request::ConfigureNodeId { node_id: lss::UNCONFIGURED } => "take the node-ID away".to_owned(),
        lss::Request::ConfigureNodeId { node_id } => format!("configure node-ID {node_id}"),
        lss::Request::ConfigureBitTiming { table, index } => {
            let rate = BitRate::from_index(index).filter(|_| table == lss::CIA_TABLE);
            match rate {
                Some(BitRate::Kbps(kbps)) => format!("configure {kbps} kbit/s"),
                Some(BitRate::Automatic) => "configure automatic bit rate".to_owned(),
                None => format!("configure bit timing {index} of table {table}"),
            }
        }
        lss::Request::ActivateBitTiming { delay_ms } => format!("activate bit timing after {delay_ms} ms"),
        lss::Request::Store => "store".to_owned(),
        lss::Request::Inquire(part) => format!("inquire {part}"),
        lss::Request::InquireNodeId => "inquire node-ID".to_owned(),
        lss::Request::Identify { bound, value } => format!("identify, {bound:?} {value:#010x}"),
        lss::Request::IdentifyUnconfigured => "identify unconfigured nodes".to_owned(),
        lss::Request::Fastscan(scan) if scan.bit == lss::FASTSCAN_RESET => "fastscan, who is unconfigured".to_owned(),
        lss::Request::Fastscan(scan) => {
            let part = Part::ALL.into_iter().find(|part| part.index() == scan.sub);
            let part = part.map_or("number".to_owned(), |part| part.to_string());
            format!("fastscan {part} {:#010x} down to bit {}", scan.number, scan.bit)
        }
    };
    Some(format!("LSS {text}"))
}

pub(super) fn response(frame: &Frame) -> Option<String> {
    let text = match lss::Response::decode(frame)? {
        lss::Response::Selected => "selected".to_owned(),
        lss::Response::NodeIdConfigured(outcome) => format!("node-ID: {}", words::lss_outcome(outcome)),
        lss::Response::BitTimingConfigured(outcome) => format!("bit timing: {}", words::lss_outcome(outcome)),
        lss::Response::Stored(outcome) => format!("store: {}", words::lss_outcome(outcome)),
        lss::Response::Inquired { part, value } => format!("{part} {value:#010x}"),
        lss::Response::NodeId { node_id: lss::UNCONFIGURED } => "no node-ID".to_owned(),
        lss::Response::NodeId { node_id } => format!("node-ID {node_id}"),
        lss::Response::Identified => "identified".to_owned(),
        lss::Response::Unconfigured => "unconfigured".to_owned(),
    };
    Some(format!("LSS {text}"))
}
