//! An ultrasonic matrix of a cell, as a task sees it.

use std::time::Duration;

use controller::executor::Agents;
use controller::sensor::{BoxLocator, BoxPlace, EchoError, MatrixConfig};
use drive::ultrasonic::{Scan, UltrasonicFault, UltrasonicLink};

use super::TaskError;
use crate::cell;

/// Longest duration of a reading, as a multiple of its scans without lost queries.
const PATIENCE: u32 = 4;

/// An ultrasonic matrix.
#[derive(Clone)]
pub struct Ultrasonic {
    name: Box<str>,
    link: UltrasonicLink,
    config: MatrixConfig,
    agents: Agents,
    period: Duration,
    scan_time: Duration,
}

impl Ultrasonic {
    pub(super) fn new(given: &cell::Ultrasonic, link: UltrasonicLink, agents: Agents, period: Duration) -> Self {
        let (config, scan_time) = (given.matrix(), given.config(period).scan_time());
        Self { name: given.name.as_str().into(), link, config, agents, period, scan_time }
    }

    /// Name of the matrix in the cell file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The virtual sensor of a box with edges `box_size`, m, for [`Robot::sense`](super::Robot::sense). A reading is the
    /// mean of `scans` scans ([`BoxLocator::new`]).
    pub fn sensor(&self, box_size: [f64; 3], scans: usize) -> BoxLocator {
        BoxLocator::new(self.link.clone(), self.config, box_size, scans)
    }

    /// Waits for `scans` scans and locates a box with edges `box_size`, m. The box must be at rest. Fails if the matrix has
    /// a fault, if its scans do not end, or if the echoes do not determine the place of the box.
    pub async fn locate(&self, box_size: [f64; 3], scans: usize) -> Result<BoxPlace, TaskError> {
        let mut sensor = self.sensor(box_size, scans);
        // The scan in progress may have begun before the call.
        let longest = self.scan_time * (scans as u32 + 1) * PATIENCE;
        let mut waited = Duration::ZERO;
        loop {
            match sensor.read().1.result() {
                Ok(place) => return Ok(place),
                Err(EchoError::NoScan { .. }) if waited < longest => {}
                Err(error) => return Err(TaskError::Ultrasonic { name: self.name.clone(), error }),
            }
            self.agents.sleep(self.period).await;
            waited += self.period;
        }
    }

    /// Waits for the end of a scan, and returns its echoes ([`Scan::echo`]). The scan may have begun before the call.
    /// Fails if the matrix has a fault, or if the scan does not end.
    pub async fn scan(&self) -> Result<Scan, TaskError> {
        let last = self.link.read().scan.number;
        let mut waited = Duration::ZERO;
        loop {
            let state = self.link.read();
            let error = match state.fault {
                Some(fault) => EchoError::Matrix(fault),
                None if state.scan.number != last => return Ok(state.scan),
                None if waited < self.scan_time * PATIENCE => {
                    self.agents.sleep(self.period).await;
                    waited += self.period;
                    continue;
                }
                None => EchoError::NoScan { found: 0, needed: 1 },
            };
            return Err(TaskError::Ultrasonic { name: self.name.clone(), error });
        }
    }

    /// The fault of the matrix in the last servo cycle.
    pub fn fault(&self) -> Option<UltrasonicFault> {
        self.link.read().fault
    }

    /// Requests a reset of the fault of the matrix, and does not wait. The fault ends with the next complete scan.
    pub fn reset_fault(&self) {
        self.link.reset_fault();
    }
}
