//! A client of CiA 402: power states, modes of operation, and measurements of the motion.

use Power::{
    Fault, FaultReactionActive, NotReadyToSwitchOn, OperationEnabled, QuickStopActive, ReadyToSwitchOn,
    SwitchOnDisabled, SwitchedOn,
};

use super::rig::{Deviation, Rig, TURN, Verdict, ensure};

/// Power states of CiA 402.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Power {
    NotReadyToSwitchOn,
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    OperationEnabled,
    QuickStopActive,
    FaultReactionActive,
    Fault,
}

/// Masks, patterns of the statusword and their states.
const PATTERNS: [(u32, u32, Power); 8] = [
    (0x4F, 0x00, NotReadyToSwitchOn),
    (0x4F, 0x40, SwitchOnDisabled),
    (0x6F, 0x21, ReadyToSwitchOn),
    (0x6F, 0x23, SwitchedOn),
    (0x6F, 0x27, OperationEnabled),
    (0x6F, 0x07, QuickStopActive),
    (0x4F, 0x0F, FaultReactionActive),
    (0x4F, 0x08, Fault),
];

/// Modes of operation.
pub(super) const PP: i64 = 1;

pub(super) const PV: i64 = 3;

pub(super) const HM: i64 = 6;

pub(super) const CSP: i64 = 8;

pub(super) const CSV: i64 = 9;

pub(super) const CST: i64 = 10;

/// Node-ID of a heartbeat producer that the check emulates.
const PRODUCER: u16 = 0x7E;

impl Power {
    pub(super) fn decode(statusword: u32) -> Option<Self> {
        PATTERNS.iter().find(|(mask, pattern, _)| statusword & mask == *pattern).map(|(.., power)| *power)
    }
}

impl Rig {
    pub(super) fn statusword(&mut self) -> Result<u32, Deviation> {
        self.read(0x6041, 0)
    }

    pub(super) fn power(&mut self) -> Result<Power, Deviation> {
        let word = self.statusword()?;
        Power::decode(word).ok_or_else(|| Deviation(format!("statusword {word:#06x} is no state of CiA 402")))
    }

    pub(super) fn expect_power(&mut self, expected: Power, after: &str) -> Verdict {
        let found = self.power()?;
        ensure!(found == expected, "{found:?} after {after}, expected {expected:?}");
        Ok(())
    }

    /// Writes the controlword and waits 5 ms.
    pub(super) fn control(&mut self, word: u16) -> Verdict {
        self.write(0x6040, 0, i64::from(word), 2)?;
        self.pass(5);
        Ok(())
    }

    /// Expects bits of the statusword: (mask, value).
    pub(super) fn expect_bits(&mut self, (mask, value): (u32, u32), when: &str) -> Verdict {
        let word = self.statusword()?;
        ensure!(word & mask == value, "statusword {word:#06x} {when}, expected {value:#06x} in {mask:#06x}");
        Ok(())
    }

    /// Waits until bits of the statusword have the expected values, for at most `millis` milliseconds.
    pub(super) fn wait_bits(&mut self, (mask, value): (u32, u32), millis: u64, what: &str) -> Verdict {
        let begin = self.now();
        loop {
            let word = self.statusword()?;
            if word & mask == value {
                return Ok(());
            }
            let waited = self.now().since(begin).as_millis() as u64;
            ensure!(
                waited < millis,
                "{what}: statusword {word:#06x} after {waited} ms, expected {value:#06x} in {mask:#06x}"
            );
            self.pass(1);
        }
    }

    pub(super) fn set_mode(&mut self, mode: i64) -> Verdict {
        self.write(0x6060, 0, mode, 1)?;
        self.pass(5);
        let shown = self.read_signed(0x6061, 0)?;
        ensure!(i64::from(shown) == mode, "mode {shown} is shown, expected {mode}");
        Ok(())
    }

    /// Changes the power state from switch on disabled or operation enabled to `power`.
    pub(super) fn bring(&mut self, power: Power) -> Verdict {
        let commands: &[u16] = match power {
            SwitchOnDisabled => &[0x00],
            ReadyToSwitchOn => &[0x00, 0x06],
            SwitchedOn => &[0x00, 0x06, 0x07],
            OperationEnabled => &[0x06, 0x07, 0x0F],
            QuickStopActive => &[0x06, 0x07, 0x0F, 0x02],
            Fault => return self.bring_fault(),
            NotReadyToSwitchOn | FaultReactionActive => {
                unreachable!("a state that the drive leaves by itself")
            }
        };
        for &command in commands {
            self.control(command)?;
        }
        self.expect_power(power, "the commands that lead there")
    }

    /// Causes a fault by a lost heartbeat. The cause is removed afterwards.
    fn bring_fault(&mut self) -> Verdict {
        self.write(0x6007, 0, 1, 2)?;
        self.write(0x1029, 1, 1, 1)?;
        self.lose_host(40)?;
        self.write(0x1016, 1, 0, 4)?;
        self.expect_power(Fault, "a lost heartbeat with 0x6007 = 1")
    }

    /// Emulates a producer that sends one heartbeat only and is lost after 20 ms. Then waits `millis` milliseconds.
    pub(super) fn lose_host(&mut self, millis: u64) -> Verdict {
        self.write(0x1016, 1, i64::from(PRODUCER) << 16 | 20, 4)?;
        self.send(0x700 + PRODUCER, &[0x05]);
        self.pass(millis);
        Ok(())
    }

    /// Enables operation in a mode.
    pub(super) fn enable(&mut self, mode: i64) -> Verdict {
        self.set_mode(mode)?;
        self.bring(OperationEnabled)
    }

    pub(super) fn position(&mut self) -> Result<i32, Deviation> {
        self.read_signed(0x6064, 0)
    }

    /// Velocity, rpm.
    pub(super) fn velocity(&mut self) -> Result<i32, Deviation> {
        self.read_signed(0x606C, 0)
    }

    pub(super) fn expect_position(&mut self, expected: i32, tolerance: i32) -> Verdict {
        let found = self.position()?;
        ensure!((found - expected).abs() <= tolerance, "position {found}, expected {expected} within {tolerance}");
        Ok(())
    }

    pub(super) fn expect_velocity(&mut self, expected: i32, tolerance: i32) -> Verdict {
        let found = self.velocity()?;
        ensure!((found - expected).abs() <= tolerance, "velocity {found} rpm, expected {expected} within {tolerance}");
        Ok(())
    }

    /// Enables operation in profile velocity mode at a speed, rpm.
    pub(super) fn spin(&mut self, speed: i32) -> Verdict {
        self.write(0x6083, 0, 100_000, 4)?;
        self.write(0x60FF, 0, i64::from(speed), 4)?;
        self.enable(PV)?;
        self.pass(200);
        self.expect_velocity(speed, 30)
    }

    /// Time until the axis stands, ms; `None` if it still turns after `limit`.
    pub(super) fn stop_time(&mut self, limit: u64) -> Result<Option<f64>, Deviation> {
        let begin = self.now();
        loop {
            let velocity = self.velocity()?;
            let waited = self.now().since(begin).as_secs_f64() * 1e3;
            if velocity.abs() < 20 {
                return Ok(Some(waited));
            }
            if waited > limit as f64 {
                return Ok(None);
            }
        }
    }

    /// Expects a stop after `millis` milliseconds, with a tolerance of a tenth and 15 ms.
    pub(super) fn expect_stop(&mut self, millis: f64, why: &str) -> Verdict {
        let found = self.stop_time(2_000)?;
        let near = |found: f64| (found - millis).abs() <= millis / 10.0 + 15.0;
        ensure!(found.is_some_and(near), "stopped after {found:.0?} ms, expected {millis:.0} ms: {why}");
        Ok(())
    }

    /// Expects that the axis coasts, i.e. keeps its speed, rpm.
    pub(super) fn expect_coasting(&mut self, speed: i32, why: &str) -> Verdict {
        self.pass(100);
        let found = self.velocity()?;
        ensure!((found - speed).abs() <= speed.abs() / 10, "velocity {found} rpm, expected to coast at {speed}: {why}");
        Ok(())
    }

    /// Gives a new set-point in profile position mode, with these bits in addition to bit 4, and waits for its
    /// acknowledgement.
    pub(super) fn set_point(&mut self, target: i32, bits: u16) -> Verdict {
        self.write(0x607A, 0, i64::from(target), 4)?;
        self.write(0x6040, 0, i64::from(0x1F | bits), 2)?;
        self.wait_bits((0x1000, 0x1000), 20, "set-point acknowledge")?;
        self.write(0x6040, 0, i64::from(0x0F | bits), 2)?;
        Ok(())
    }

    /// Waits for target reached.
    pub(super) fn reach(&mut self, millis: u64) -> Verdict {
        self.wait_bits((0x0400, 0x0400), millis, "target reached")
    }
}

/// Converts a speed in rpm to counts/s.
pub(super) fn counts_per_second(speed: f64) -> f64 {
    speed * f64::from(TURN) / 60.0
}
