//! Objects of an I/O node that belong to the driver.

use canopen::Object;

use crate::cia402::{self, Reserved};

/// Why a cell must not write the objects of digital lines.
const LINES: &str = "the cell's inputs and outputs set it";

/// Why a cell must not write the objects of communication.
const COMMUNICATION: &str = "the driver sets how the node communicates";

/// The reservation of an object of an I/O node. `None` if a cell may write the object, such as one of the vendor or of
/// analogue channels.
pub fn reserved(object: Object) -> Option<Reserved> {
    match object.index {
        // The reasons of drives would speak of drives.
        0x1000..=0x1FFF => {
            let found = cia402::reserved(0, object.index, object.subindex)?;
            Some(Reserved { why: COMMUNICATION, ..found })
        }
        // Inputs and outputs in blocks of 1, 8, 16 and 32 lines.
        0x6000..=0x63FF => Some(Reserved { object, why: LINES }),
        _ => None,
    }
}
