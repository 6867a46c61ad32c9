//! Force/torque sensors on serial lines: bring-up, samples, zero and faults.

mod bring_up;
mod faults;
mod samples;
mod zero;

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use mrroc_drive::wrench::{
    Channel, ConfigError, SerialWrenchConfig, SerialWrenchSensor, WrenchAxis, WrenchConfig, WrenchError, WrenchFault,
    WrenchLink, WrenchState, ZeroFailure, ZeroMethod, ZeroRequest, Zeroing,
};
use mrroc_drive::{BringUpError, DriveGroup};
use serial::LineError;

use crate::board::{Board, SharedBoard};

const PERIOD: Duration = Duration::from_millis(2);

/// Time of one byte on the line: 10 bits at 115,200 bit/s.
const BYTE: Duration = Duration::from_nanos(86_806);

/// N per count of force, N·m per count of torque.
const FORCE: f64 = 10.0 / 115.0;
const TORQUE: f64 = 5.0 / 940.0;

struct Rig {
    sensor: SerialWrenchSensor<SharedBoard>,
    link: WrenchLink,
    line: SharedBoard,
    now: Instant,
}

impl Rig {
    fn with(config: SerialWrenchConfig, board: Board) -> Self {
        let line = board.shared();
        let (sensor, link) = SerialWrenchSensor::new(line.clone(), config).unwrap();
        Self { sensor, link, line, now: Instant::from_nanos(1_000_000_000) }
    }

    fn bring_up(&mut self) -> Result<(), BringUpError> {
        for _ in 0..100_000 {
            if let Poll::Ready(result) = self.sensor.bring_up(self.now) {
                return result;
            }
            self.now += PERIOD;
        }
        panic!("bring-up does not end");
    }

    fn up_with(config: SerialWrenchConfig, board: Board) -> Self {
        let mut rig = Self::with(config, board);
        assert_eq!(rig.bring_up(), Ok(()));
        rig
    }

    fn up() -> Self {
        Self::up_with(SerialWrenchConfig::new(PERIOD), Board::new())
    }

    fn cycle(&mut self) -> WrenchState {
        self.now += PERIOD;
        self.sensor.read(self.now, &mut []);
        self.sensor.write(self.now, &[]);
        assert!(self.sensor.send(self.now));
        let state = self.link.read();
        assert!(state.wrench.iter().all(|component| component.is_finite()));
        assert_eq!(state.at, self.now);
        state
    }

    fn run(&mut self, cycles: usize) -> WrenchState {
        (0..cycles).map(|_| self.cycle()).last().unwrap()
    }

    /// Number of cycles until a fault, and the fault.
    fn until_fault(&mut self) -> (usize, WrenchFault) {
        (1..1_000).find_map(|cycle| self.cycle().fault.map(|fault| (cycle, fault))).expect("a fault within 1000 cycles")
    }
}

/// The configuration of the laboratory with another tolerance or zero.
fn config(change: impl FnOnce(&mut WrenchConfig)) -> SerialWrenchConfig {
    let mut config = SerialWrenchConfig::new(PERIOD);
    change(&mut config.sensor);
    config
}
