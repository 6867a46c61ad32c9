//! Ultrasonic matrices on serial lines: bring-up, scans and faults.

mod bring_up;
mod faults;
mod scans;
mod scripted;

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use mrroc_drive::ultrasonic::{
    ScanKind, UltrasonicConfig, UltrasonicError, UltrasonicFault, UltrasonicLink, UltrasonicMatrix, UltrasonicState,
};
use mrroc_drive::{BringUpError, DriveGroup};
use scripted::{Script, SharedScript};
use serial::LineError;

const PERIOD: Duration = Duration::from_millis(2);

struct Rig {
    matrix: UltrasonicMatrix<SharedScript>,
    link: UltrasonicLink,
    line: SharedScript,
    now: Instant,
}

impl Rig {
    fn with(config: UltrasonicConfig, script: Script) -> Self {
        let line = script.shared();
        let (matrix, link) = UltrasonicMatrix::new(line.clone(), config).unwrap();
        Self { matrix, link, line, now: Instant::from_nanos(1_000_000_000) }
    }

    fn bring_up(&mut self) -> Result<(), UltrasonicError> {
        for _ in 0..100_000 {
            match self.matrix.bring_up(self.now) {
                Poll::Ready(Ok(())) => return Ok(()),
                Poll::Ready(Err(BringUpError::Ultrasonic { error })) => return Err(error),
                Poll::Ready(Err(error)) => panic!("{error}"),
                Poll::Pending => self.now += PERIOD,
            }
        }
        panic!("bring-up does not end");
    }

    fn up_with(config: UltrasonicConfig, script: Script) -> Self {
        let mut rig = Self::with(config, script);
        assert_eq!(rig.bring_up(), Ok(()));
        rig
    }

    fn up() -> Self {
        Self::up_with(config(), Script::new(3))
    }

    fn cycle(&mut self) -> UltrasonicState {
        self.now += PERIOD;
        self.matrix.read(self.now, &mut []);
        self.matrix.write(self.now, &[]);
        assert!(self.matrix.send(self.now));
        let state = self.link.read();
        assert_eq!(state.at, self.now);
        state
    }

    fn run(&mut self, cycles: usize) -> UltrasonicState {
        (0..cycles).map(|_| self.cycle()).last().unwrap()
    }

    /// Runs until the condition holds, for up to a thousand cycles.
    fn until(&mut self, holds: impl Fn(&UltrasonicState) -> bool) -> UltrasonicState {
        (0..1_000).find_map(|_| Some(self.cycle()).filter(|state| holds(state))).expect("within a thousand cycles")
    }
}

/// A matrix of 3 × 3 elements.
fn config() -> UltrasonicConfig {
    UltrasonicConfig { size: 3, ..UltrasonicConfig::new(PERIOD) }
}
