//! The last servo cycles up to each fault of a robot, from the records of the run.

use std::collections::VecDeque;

use serde::Serialize;
use servo::{MAX_AXES, Phase, Record};

/// Number of cycles up to a fault.
const CYCLES: usize = 16;

/// Greatest number of faults of one robot whose cycles are kept. The cycles of later faults are not kept.
const MOST_FAULTS: usize = 100;

/// The axes of a robot in the last cycles up to a fault, the cycle of the fault included.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LastCycles {
    /// The axes, as in [`AxisReport::name`](super::AxisReport::name).
    pub axes: Vec<String>,
    /// The cycles, the fault last. Their values are in the order of `axes`.
    pub cycles: Vec<CycleState>,
}

/// The axes of a robot in one cycle. All values are of the motor shafts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CycleState {
    /// Number of the cycle, from 0.
    pub cycle: u64,
    /// Time since the first cycle, s.
    pub time_s: f64,
    /// Commanded positions, rad.
    pub commanded_rad: Vec<f64>,
    /// Measured positions, rad.
    pub measured_rad: Vec<f64>,
    /// Measured velocities, rad/s.
    pub velocity_rad_per_s: Vec<f64>,
    /// Measured torques, N·m; zero where the drive does not report them.
    pub torque_nm: Vec<f64>,
}

/// The cycles of one robot, record by record.
#[derive(Default)]
pub(super) struct Recorded {
    last: VecDeque<Kept>,
    faults: Vec<Vec<CycleState>>,
    /// Whether the last record has a latched fault.
    faulted: bool,
    /// Cycles in which stops began, the last [`MOST_FAULTS`].
    stops: VecDeque<u64>,
    /// Whether the last record is of a robot with power that does not brake.
    active: bool,
}

/// What is kept of a record. A whole record is three times as long, and the records of all robots would fill the cache of
/// the processor.
struct Kept {
    cycle: u64,
    time: f64,
    axes: usize,
    /// Commanded position, measured position, velocity and torque of each axis.
    axis: [[f64; 4]; MAX_AXES],
}

impl Recorded {
    /// Takes a record at `time`, s.
    pub(super) fn observe(&mut self, record: &Record, time: f64) {
        if self.last.len() == CYCLES {
            self.last.pop_front();
        }
        let axis = record.axis.each_ref().map(|it| [it.commanded, it.measured, it.velocity, it.torque]);
        self.last.push_back(Kept { cycle: record.cycle, time, axes: record.axes.into(), axis });
        if record.faulted && !self.faulted && self.faults.len() < MOST_FAULTS {
            self.faults.push(self.last.iter().map(CycleState::of).collect());
        }
        self.faulted = record.faulted;
        let active = match record.phase {
            Phase::Enabling | Phase::Homing | Phase::Standing | Phase::Moving => true,
            Phase::Off | Phase::Stopping | Phase::Faulted => false,
        };
        if self.active && !active {
            if self.stops.len() == MOST_FAULTS {
                self.stops.pop_front();
            }
            self.stops.push_back(record.cycle);
        }
        self.active = active;
    }

    /// Whether a stop began in cycle `cycle`, or in the cycle after.
    pub(super) fn stopped_in(&self, cycle: u64) -> bool {
        self.stops.iter().any(|stop| (cycle..=cycle.saturating_add(1)).contains(stop))
    }

    /// The cycles up to the fault that was latched in cycle `cycle`.
    pub(super) fn up_to_fault(&self, cycle: u64) -> Option<&[CycleState]> {
        let begun = |cycles: &&Vec<CycleState>| cycles.last().is_some_and(|fault| fault.cycle <= cycle);
        self.faults.iter().rev().find(begun).map(Vec::as_slice)
    }
}

impl CycleState {
    fn of(kept: &Kept) -> Self {
        let each = |value: usize| kept.axis[..kept.axes].iter().map(|axis| axis[value]).collect();
        Self {
            cycle: kept.cycle,
            time_s: kept.time,
            commanded_rad: each(0),
            measured_rad: each(1),
            velocity_rad_per_s: each(2),
            torque_nm: each(3),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_has_the_sixteen_cycles_up_to_its_own() {
        let mut recorded = Recorded::default();
        for cycle in 0..100 {
            let faulted = (5..30).contains(&cycle) || cycle >= 50;
            recorded.observe(&Record { cycle, faulted, axes: 2, ..Record::default() }, cycle as f64 * 1e-3);
        }
        let cycles = |cycle| {
            let cycles = recorded.up_to_fault(cycle)?;
            Some((cycles.len(), cycles.first()?.cycle, cycles.last()?.cycle))
        };
        assert_eq!(cycles(4), None);
        assert_eq!([cycles(5), cycles(29)], [Some((6, 0, 5)); 2]);
        assert_eq!([cycles(50), cycles(u64::MAX)], [Some((16, 35, 50)); 2]);
        let fault = recorded.up_to_fault(50).unwrap().last().unwrap();
        assert_eq!((fault.time_s, &fault.commanded_rad[..]), (0.05, &[0.0, 0.0][..]));
    }
}
