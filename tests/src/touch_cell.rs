//! The example cell with a touch probe, and the parts of a run before bring-up.

use ::mrroc::bench::emulation::Emulation;
use ::mrroc::cell::CellFile;
use ::mrroc::setup::{self, Devices};
use drive::cia401::IoLink;
use servo::Servo;

use crate::mrroc::Directory;

/// The example cell with the given edges of its touch probe, and the parts of a run before bring-up.
pub struct TouchCell {
    pub file: CellFile,
    pub emulation: Emulation,
    pub servo: Servo,
    pub _links: Vec<servo::EffectorLink>,
    pub probe: IoLink,
}

impl TouchCell {
    pub fn with_edges(edges: &[f64]) -> Self {
        let directory = Directory::new();
        let path = directory.cell("irb6-touch", |cell| cell.io[0].input[0].emulated_edges_s = edges.to_vec());
        Self::of(CellFile::read(path).unwrap())
    }

    pub fn of(file: CellFile) -> Self {
        let (emulation, ends) = Emulation::of(&file);
        let Devices { groups, io, .. } = setup::devices(&file, ends.ports, Vec::new(), Vec::new(), None).unwrap();
        let (servo, links) = Servo::new(&setup::servo_config(&file), groups).unwrap();
        Self { file, emulation, servo, _links: links, probe: io[0].clone() }
    }
}
