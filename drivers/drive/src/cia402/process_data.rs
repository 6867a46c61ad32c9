//! Process data of a drive: content and configuration of its PDOs.

use std::time::Duration;

use can::Frame;
use canopen::cia402::{Controlword, ModeOfOperation, Statusword};
use canopen::objects::{
    CONTROLWORD, DIGITAL_INPUTS, MODE_OF_OPERATION_DISPLAY, POSITION_ACTUAL, STATUSWORD, TARGET_POSITION,
    TARGET_TORQUE, TARGET_VELOCITY, TORQUE_ACTUAL, TORQUE_OFFSET,
};
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::sdo::Write;
use canopen::{NodeId, Object, cob};
use master::pdo::{PdoSetup, remap};

use super::config::{AxisConfig, CyclicMode};
use super::target::Target;
use crate::{Increments, Permille};

/// Content of TPDO 1: statusword, position and torque.
pub(super) const ANSWER: [Entry; 3] =
    [Entry::new(STATUSWORD, 16), Entry::new(POSITION_ACTUAL, 32), Entry::new(TORQUE_ACTUAL, 16)];

/// Content of TPDO 2: the mode of operation that the drive is in.
const SHOWN: [Entry; 1] = [Entry::new(MODE_OF_OPERATION_DISPLAY, 8)];

/// Content of TPDO 3, of a drive with a contact of the emergency stop.
const INPUTS: [Entry; 1] = [Entry::new(DIGITAL_INPUTS, 32)];

/// Inhibit time of TPDO 2, which a drive sends when its mode changes. The inhibit time bounds the bus load, which is
/// normally zero.
pub(crate) const SHOWN_APART: Duration = Duration::from_millis(100);

/// Content of RPDO 1: controlword and the target of the mode.
pub(super) const fn request(mode: CyclicMode) -> &'static [Entry] {
    const WORD: Entry = Entry::new(CONTROLWORD, 16);
    const POSITION: Entry = Entry::new(TARGET_POSITION, 32);
    const ADDED: Entry = Entry::new(TORQUE_OFFSET, 16);
    const VELOCITY: Entry = Entry::new(TARGET_VELOCITY, 32);
    const TORQUE: Entry = Entry::new(TARGET_TORQUE, 16);
    match mode {
        CyclicMode::Csp => &[WORD, POSITION],
        CyclicMode::CspWithTorque => &[WORD, POSITION, ADDED],
        CyclicMode::Csv => &[WORD, VELOCITY],
        CyclicMode::Cst => &[WORD, TORQUE],
    }
}

pub(crate) fn request_len(mode: CyclicMode) -> usize {
    let bits = request(mode).iter().map(|entry| usize::from(entry.bits));
    bits.sum::<usize>() / 8
}

/// The PDOs of a drive. The drive receives the request and transmits the answer at every SYNC, and transmits its mode of
/// operation when the mode changes. A drive with a contact of the emergency stop transmits its digital inputs at every
/// SYNC.
///
/// The default PDOs of an EPOS4 are event-driven with an inhibit time of 1 ms, which is longer than some periods.
pub fn pdo_setups(axis: &AxisConfig) -> Vec<PdoSetup> {
    let (node, mode) = (axis.node, axis.mode);
    let request = PdoSetup {
        kind: PdoKind::Rpdo,
        number: PdoNumber::One,
        cob_id: PdoCobId::new(cob::rpdo(PdoNumber::One, node)),
        mapping: PdoMapping::new(request(mode)).expect("eight bytes fit"),
        transmission: TransmissionType::EVERY_SYNC,
        inhibit_time: None,
        event_timer: Some(0),
    };
    let answer = PdoSetup {
        kind: PdoKind::Tpdo,
        number: PdoNumber::One,
        cob_id: PdoCobId::new(cob::tpdo(PdoNumber::One, node)).without_rtr(),
        mapping: PdoMapping::new(&ANSWER).expect("eight bytes fit"),
        transmission: TransmissionType::EVERY_SYNC,
        inhibit_time: Some(0),
        event_timer: None,
    };
    let shown = PdoSetup {
        number: PdoNumber::Two,
        cob_id: PdoCobId::new(cob::tpdo(PdoNumber::Two, node)).without_rtr(),
        mapping: PdoMapping::new(&SHOWN).expect("one byte fits"),
        transmission: TransmissionType::EVENT_PROFILE,
        inhibit_time: Some((SHOWN_APART.as_micros() / 100) as u16),
        event_timer: Some(0),
        ..answer
    };
    let inputs = axis.emergency_input.map(|_| PdoSetup {
        number: PdoNumber::Three,
        cob_id: PdoCobId::new(cob::tpdo(PdoNumber::Three, node)).without_rtr(),
        mapping: PdoMapping::new(&INPUTS).expect("four bytes fit"),
        ..answer
    });
    [request, answer].into_iter().chain(inputs).chain([shown]).collect()
}

/// The writes after which a drive exchanges these PDOs and no others. A drive with deadline monitoring of RPDOs stops by
/// itself `deadline` milliseconds after the last set-point, also while another sender keeps up the host's heartbeat.
pub(super) fn mapping_writes(axis: &AxisConfig, deadline: u16) -> impl Iterator<Item = Write> {
    use PdoNumber::{Four, Three, Two};
    let node = axis.node;
    let rpdo = |number| PdoCobId::new(cob::rpdo(number, node));
    let tpdo = move |number| PdoCobId::new(cob::tpdo(number, node)).without_rtr();
    let off = |kind: PdoKind, number, cob_id: PdoCobId| Write::new(kind.communication(number, 1), cob_id.invalid().0);
    let mut setups = pdo_setups(axis);
    let unused = if axis.emergency_input.is_some() { &[Four][..] } else { &[Three, Four] };
    for request in setups.iter_mut().filter(|setup| setup.kind == PdoKind::Rpdo) {
        request.event_timer = Some(deadline);
    }
    [Two, Three, Four]
        .map(|number| off(PdoKind::Rpdo, number, rpdo(number)))
        .into_iter()
        .chain(unused.iter().map(move |&number| off(PdoKind::Tpdo, number, tpdo(number))))
        .chain(setups.into_iter().flat_map(|setup| remap(&setup)))
}

/// Whether a drive may lack this object of [`mapping_writes`]: an inhibit time or an event timer, which is off where the
/// object is absent (CiA 301 §7.5.2.35, §7.5.2.37), or all of TPDO 2.
pub(super) fn may_be_absent(object: Object) -> bool {
    is_timer(object) || object == PdoKind::Tpdo.communication(PdoNumber::Two, 1)
}

pub(crate) fn is_timer(object: Object) -> bool {
    let communication = matches!(object.index, 0x1400..=0x15FF | 0x1800..=0x19FF);
    communication && matches!(object.subindex, 3 | 5)
}

/// Whether this object of [`mapping_writes`] puts the mode of operation into TPDO 2, which not every drive can do.
pub(super) fn maps_mode(object: Object) -> bool {
    object.index == PdoKind::Tpdo.mapping(PdoNumber::Two, 0).index
}

/// TPDO 2; `None` for a payload of another length.
pub(crate) fn mode_shown(data: &[u8]) -> Option<ModeOfOperation> {
    let &[mode] = data else { return None };
    Some(ModeOfOperation::from_raw(mode as i8))
}

/// The frame of RPDO 1.
pub(super) fn encode(node: NodeId, mode: CyclicMode, word: Controlword, target: Target) -> Frame {
    let mut bytes = [0; 8];
    bytes[..2].copy_from_slice(&word.0.to_le_bytes());
    bytes[2..6].copy_from_slice(&target.value.to_le_bytes());
    bytes[6..].copy_from_slice(&target.torque.0.to_le_bytes());
    Frame::new(cob::rpdo(PdoNumber::One, node), &bytes[..request_len(mode)]).expect("eight bytes fit a frame")
}

/// TPDO 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Answer {
    pub(super) statusword: Statusword,
    pub(super) position: Increments,
    pub(super) torque: Permille,
}

impl Answer {
    /// `None` for a payload of another length.
    pub(super) fn decode(data: &[u8]) -> Option<Self> {
        let &[s0, s1, p0, p1, p2, p3, t0, t1] = data else {
            return None;
        };
        Some(Self {
            statusword: Statusword(u16::from_le_bytes([s0, s1])),
            position: Increments(i32::from_le_bytes([p0, p1, p2, p3])),
            torque: Permille(i16::from_le_bytes([t0, t1])),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_points_lie_behind_the_controlword() {
        let node = NodeId::new(2).unwrap();
        let word = Controlword::ENABLE_OPERATION;
        let table = [
            (CyclicMode::Csp, -2, "202#0F00FEFFFFFF"),
            (CyclicMode::Csv, 0x0102_0304, "202#0F0004030201"),
            (CyclicMode::Cst, -2, "202#0F00FEFF"),
        ];
        for (mode, target, bytes) in table {
            assert_eq!(encode(node, mode, word, target.into()).to_string(), bytes);
        }
        let both = Target { value: -2, torque: Permille(0x0102) };
        let frame = encode(node, CyclicMode::CspWithTorque, word, both);
        assert_eq!(frame.to_string(), "202#0F00FEFFFFFF0201");
    }

    #[test]
    fn answers_are_eight_bytes_or_none() {
        let answer = Answer::decode(&[0x37, 0x07, 0xFE, 0xFF, 0xFF, 0xFF, 0x0C, 0xFE]);
        let expected = Answer { statusword: Statusword(0x0737), position: Increments(-2), torque: Permille(-500) };
        assert_eq!(answer, Some(expected));
        for length in 0..8 {
            assert_eq!(Answer::decode(&[0; 8][..length]), None);
        }
    }
}
