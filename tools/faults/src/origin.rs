//! Origins of the faults of the table: the emulators, the deadlines of the host, the contact of the emergency stop, and the
//! generator of set-points.

use std::time::Duration;

use mrroc::cell::{Bus, CellFile, InputLine, IoNode};
use mrroc::scenario::FaultKind;

/// Origin of a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Origin {
    /// The emulators simulate the fault.
    Emulated(FaultKind),
    /// The host misses deadlines. The emulated world goes on meanwhile.
    Deadlines(Missed),
    /// The contact of the emergency stop opens, and closes at the end of the observation.
    EmergencyStop,
    /// The generator of the robot gives a wrong macrostep, or none.
    Generator(Flaw),
}

/// Deadlines that the host misses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Missed {
    /// As many in a row as the cell tolerates.
    Tolerated,
    /// One more in a row than the cell tolerates.
    TooMany,
    /// Each third deadline.
    Third,
}

impl Missed {
    /// Number of deadlines missed before a cycle, counted from the strike, in a cell that tolerates `tolerated` in a row.
    pub(super) fn before(self, cycle: u64, tolerated: u32) -> u32 {
        match self {
            Self::Tolerated if cycle == 0 => tolerated,
            Self::TooMany if cycle == 0 => tolerated.saturating_add(1),
            Self::Third if cycle.is_multiple_of(2) => 1,
            Self::Tolerated | Self::TooMany | Self::Third => 0,
        }
    }
}

/// What is wrong with the macrostep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flaw {
    /// Its position is not a number.
    NotANumber,
    /// Its position is beyond the position limit of the axis.
    Position,
    /// It needs more than the greatest velocity of the axis.
    Velocity,
    /// It needs more than the greatest acceleration of the axis.
    Acceleration,
    /// There is no macrostep.
    Absent,
}

/// Index of the I/O node with the contact in the staged cell, and the number of its input.
pub(super) const CONTACT: (usize, u8) = (0, 0);

/// Shortest time between two frames of the node, µs.
const INHIBIT_US: u32 = 500;

/// Adds an I/O node with a contact of the emergency stop to a staged cell, which has no other I/O node. The contact is closed
/// from power-on. The node is on the bus of the first axis, or on a bus of its own if the axis is on a serial line.
pub(super) fn add_contact(file: &mut CellFile) {
    let cell = &mut file.cell;
    let axis = &cell.robot[0].axis[0];
    let name = if axis.drive.is_some() { axis.bus.clone() } else { "emergency-stop".to_owned() };
    if !cell.bus.iter().any(|bus| bus.name == name) {
        cell.bus.push(Bus {
            name: name.clone(),
            bitrate_kbps: 1000,
            interface: "none".to_owned(),
            host_node: 127,
            heartbeat_ms: 100,
            tolerated_missing: 5,
            sdo_timeout_ms: 500,
            boot_timeout_ms: 2000,
            guarded: false,
            emulated_load: 0.0,
        });
    }
    let bus = cell.bus.iter().find(|bus| bus.name == name);
    let host = bus.map(|bus| bus.host_node);
    let axes = || cell.robot.iter().flat_map(|robot| &robot.axis).filter(|axis| axis.bus == name);
    let is_free = |node: &u8| host != Some(*node) && axes().all(|axis| axis.node != *node);
    let node = (1..=127).rev().find(is_free).expect("a bus carries far less than 126 axes");
    let contact = InputLine {
        name: "emergency-stop".to_owned(),
        line: CONTACT.1,
        inverted: false,
        emergency_stop: true,
        filtered: false,
        emulated_edges_s: vec![0.0],
    };
    cell.io.push(IoNode {
        name: "emergency-stop".to_owned(),
        bus: name,
        node,
        vendor: 0,
        product: None,
        revision: None,
        inhibit_us: Some(INHIBIT_US),
        event_timer_ms: 100,
        parameter: Vec::new(),
        input: vec![contact],
        output: Vec::new(),
    });
}

/// Longest time from the opening of the contact to its detection: two periods and the inhibit time, and the cycle of the
/// detection itself.
pub(super) fn contact_delay(period: Duration) -> Duration {
    3 * period + Duration::from_micros(INHIBIT_US.into())
}
