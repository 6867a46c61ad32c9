//! PDO mapping and identification of nodes, read from the nodes; the mapping may be taken from a cell file.

use std::collections::{BTreeMap, VecDeque};

use canopen::objects::{DEVICE_TYPE, VENDOR_ID};
use canopen::pdo::{Entry, PdoCobId, PdoKind, PdoNumber};
use canopen::{NodeId, Object};
use master::sdo::SdoCause;

use super::survey::Questions;
use super::value;
use super::words::Identification;

/// Maximum number of entries of a PDO (CiA 301). A node that reports more is in error.
const MOST_ENTRIES: u64 = 64;

/// Mapping of one PDO of one node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pdo {
    pub(super) node: NodeId,
    pub(super) kind: PdoKind,
    pub(super) number: PdoNumber,
    pub(super) entries: Vec<Entry>,
}

/// PDO mappings of a bus by CAN identifier.
pub(super) type PdoMap = BTreeMap<u16, Pdo>;

/// Reads the mapping of the eight PDOs of one node.
#[derive(Debug)]
pub(super) struct MappingQuestions {
    node: NodeId,
    /// Vendor and device type, which every node has. Their presence shows that the node exists.
    pub(super) identification: Identification,
    stage: Stage,
    /// The PDO that is being read, and the PDOs after it.
    pdos: VecDeque<(PdoKind, PdoNumber)>,
    id: u16,
    entries: Vec<Entry>,
    count: u64,
    map: PdoMap,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Vendor,
    DeviceType,
    CobId,
    Count,
    Entry,
}

impl MappingQuestions {
    pub(super) fn of(node: NodeId) -> Self {
        let of_kind = |kind| PdoNumber::ALL.map(|number| (kind, number));
        Self {
            node,
            identification: Identification::default(),
            stage: Stage::Vendor,
            pdos: [PdoKind::Rpdo, PdoKind::Tpdo].map(of_kind).concat().into(),
            id: 0,
            entries: Vec::new(),
            count: 0,
            map: PdoMap::new(),
        }
    }

    /// PDOs that exist.
    pub(super) fn into_map(self) -> PdoMap {
        self.map
    }

    fn next_pdo(&mut self) {
        self.pdos.pop_front();
        self.stage = Stage::CobId;
    }
}

impl Questions for MappingQuestions {
    fn next(&self) -> Option<Object> {
        let &(kind, number) = self.pdos.front()?;
        Some(match self.stage {
            Stage::Vendor => VENDOR_ID,
            Stage::DeviceType => DEVICE_TYPE,
            Stage::CobId => kind.communication(number, 1),
            Stage::Count => kind.mapping(number, 0),
            Stage::Entry => kind.mapping(number, self.entries.len() as u8 + 1),
        })
    }

    fn answer(&mut self, answer: Result<&[u8], SdoCause>) {
        if let Err(SdoCause::TimedOut { .. }) = answer {
            self.pdos.clear();
            return;
        }
        let raw = answer.ok().and_then(value::unsigned);
        match (self.stage, raw) {
            (Stage::Vendor, raw) => {
                self.identification.vendor = raw.map(|raw| raw as u32);
                self.stage = Stage::DeviceType;
            }
            (Stage::DeviceType, raw) => {
                self.identification.device_type = raw.map(|raw| raw as u32);
                self.stage = Stage::CobId;
            }
            (Stage::CobId, Some(raw)) => {
                let cob_id = PdoCobId(raw as u32);
                match cob_id.id().filter(|_| cob_id.is_valid()) {
                    Some(id) => {
                        self.id = id.raw();
                        self.stage = Stage::Count;
                    }
                    None => self.next_pdo(),
                }
            }
            (Stage::Count, Some(count @ 1..=MOST_ENTRIES)) => {
                self.count = count;
                self.entries.clear();
                self.stage = Stage::Entry;
            }
            (Stage::Entry, Some(raw)) => {
                self.entries.push(Entry::from_raw(raw as u32));
                if self.entries.len() as u64 == self.count
                    && let Some(&(kind, number)) = self.pdos.front()
                {
                    let pdo = Pdo { node: self.node, kind, number, entries: self.entries.clone() };
                    self.map.insert(self.id, pdo);
                    self.next_pdo();
                }
            }
            (Stage::CobId | Stage::Count | Stage::Entry, _) => self.next_pdo(),
        }
    }
}
