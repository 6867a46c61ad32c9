//! Configuration of the PDOs of a node.

use canopen::pdo::{PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::sdo::Write;

/// Configuration of one PDO of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoSetup {
    /// Its direction.
    pub kind: PdoKind,
    /// Its number.
    pub number: PdoNumber,
    /// Its identifier; an invalid one leaves the PDO switched off.
    pub cob_id: PdoCobId,
    /// The mapped objects.
    pub mapping: PdoMapping,
    /// The trigger of the PDO.
    pub transmission: TransmissionType,
    /// Inhibit time of a TPDO, 100 µs. `None` leaves the value of the device. EPOS4 has 1 ms.
    pub inhibit_time: Option<u16>,
    /// Event timer, ms: the longest time between two TPDOs, or the deadline of the next RPDO. `None` leaves the value of
    /// the device.
    pub event_timer: Option<u16>,
}

/// Writes in the order of CiA 301 §7.5.2.36 and §7.5.2.38: switch the PDO off, clear the mapping, fill it, set its
/// count, write the communication parameters, switch the PDO on.
///
/// Devices abort writes in another order.
pub fn remap(setup: &PdoSetup) -> impl Iterator<Item = Write> + use<> {
    let PdoSetup { kind, number, cob_id, mapping, transmission, inhibit_time, event_timer } = *setup;
    let communication = move |subindex| kind.communication(number, subindex);
    let count = kind.mapping(number, 0);
    // At most 8.
    let length = mapping.entries().len() as u8;
    let entries = (1..=length).map(move |subindex| {
        let entry = mapping.entries()[usize::from(subindex) - 1];
        Write::new(kind.mapping(number, subindex), entry.raw())
    });
    [Write::new(communication(1), cob_id.invalid().0), Write::new(count, 0u8)]
        .into_iter()
        .chain(entries)
        .chain([Write::new(count, length), Write::new(communication(2), transmission.0)])
        .chain(inhibit_time.map(|time| Write::new(communication(3), time)))
        .chain(event_timer.map(|time| Write::new(communication(5), time)))
        .chain([Write::new(communication(1), cob_id.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::objects::{CONTROLWORD, TARGET_POSITION};
    use canopen::pdo::Entry;
    use canopen::sdo::{Initiate, Request};
    use canopen::{NodeId, cob};

    #[test]
    fn a_pdo_is_remapped_in_the_strict_order() {
        let node = NodeId::new(2).unwrap();
        let rpdo = PdoSetup {
            kind: PdoKind::Rpdo,
            number: PdoNumber::One,
            cob_id: PdoCobId::new(cob::rpdo(PdoNumber::One, node)),
            mapping: PdoMapping::new(&[Entry::new(CONTROLWORD, 16), Entry::new(TARGET_POSITION, 32)]).unwrap(),
            transmission: TransmissionType::EVERY_SYNC,
            inhibit_time: None,
            event_timer: None,
        };
        check(
            &rpdo,
            &[
                "602#2300140102020080",
                "602#2F00160000000000",
                "602#2300160110004060",
                "602#2300160220007A60",
                "602#2F00160002000000",
                "602#2F00140201000000",
                "602#2300140102020000",
            ],
        );
        let tpdo = PdoSetup {
            kind: PdoKind::Tpdo,
            number: PdoNumber::Two,
            cob_id: PdoCobId::new(cob::tpdo(PdoNumber::Two, node)).without_rtr().invalid(),
            mapping: PdoMapping::EMPTY,
            transmission: TransmissionType::EVENT_PROFILE,
            inhibit_time: Some(10),
            event_timer: Some(100),
        };
        check(
            &tpdo,
            &[
                "602#23011801820200C0",
                "602#2F011A0000000000",
                "602#2F011A0000000000",
                "602#2F011802FF000000",
                "602#2B0118030A000000",
                "602#2B01180564000000",
                "602#23011801820200C0",
            ],
        );
    }

    fn check(setup: &PdoSetup, frames: &[&str]) {
        let sent: Vec<_> = remap(setup)
            .map(|Write { object, data }| {
                let initiate = Initiate::Expedited(data);
                let node = NodeId::new(2).unwrap();
                Request::InitiateDownload { object, initiate }.encode(node).to_string()
            })
            .collect();
        assert_eq!(sent, frames);
    }
}
