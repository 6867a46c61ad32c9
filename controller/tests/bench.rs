//! One robot on ideal drives: the real effector control process and the real servo, in virtual time.

use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use mrroc_controller::ecp::{Ecp, EcpConfig, EcpEvent, Task};
use mrroc_controller::generator::{Axes, Pace};
use mrroc_controller::robot::Arm;
use servo::{Phase, Servo, Snapshot};

use crate::ideal::{PERIOD, Sent, servo};

/// The servo period, s.
pub(crate) const DT: f64 = 0.002;

/// Longest motion, in cycles.
pub(crate) const LONGEST: usize = 20_000;

/// A robot of `N` motors.
pub(crate) struct Bench<const N: usize> {
    pub(crate) servo: Servo,
    pub(crate) ecp: Ecp,
    sent: Sent<N>,
    now: Instant,
}

impl<const N: usize> Bench<N> {
    /// A robot that stands with its motors at `start`, rad. Limits are those of each motor in the servo, rad/s and rad/s².
    pub(crate) fn new(arm: Arm, start: &Axes, [max_velocity, max_acceleration]: [f64; 2], ahead: u16) -> Self {
        let sent = Sent::default();
        let start = std::array::from_fn(|axis| start[axis]);
        let (servo, link) = servo(start, max_velocity, max_acceleration, &sent);
        let config = EcpConfig {
            period: PERIOD,
            pace: Pace { periods: 10, read_at: 8 },
            macrosteps_ahead: ahead,
            silence: Duration::from_secs(1),
            switching: Duration::from_secs(2),
            planning: Duration::from_secs(60),
            homing: Duration::from_secs(2),
            meeting: Duration::from_secs(1),
        };
        Self { servo, ecp: Ecp::new(arm, link, config), sent: Arc::clone(&sent), now: Instant::ZERO }
    }

    /// Executes `task`. `act` is called after each cycle, with the state of the robot. Every instruction must succeed.
    pub(crate) fn execute(&mut self, task: Task, mut act: impl FnMut(&mut Self, &Snapshot)) {
        self.ecp.execute(task).expect("nothing is under way");
        for _ in 0..LONGEST {
            while let Some(EcpEvent { instruction, outcome, .. }) = self.ecp.poll(self.now) {
                assert_eq!(outcome, Ok(()), "instruction {instruction} at {:?}", self.now);
            }
            if self.ecp.status().instruction.is_none() && self.ecp.status().phase == Phase::Standing {
                return;
            }
            self.servo.step(self.now);
            self.now += PERIOD;
            assert_eq!(self.servo.fault(0), None, "at {:?}", self.now);
            let latest = self.ecp.latest();
            act(self, &latest);
        }
        panic!("the task does not end");
    }

    /// Lets the robot stand until motion time has this rate.
    pub(crate) fn settle(&mut self, rate: f64) {
        for _ in 0..LONGEST {
            if self.ecp.latest().rate == rate {
                return;
            }
            self.servo.step(self.now);
            self.now += PERIOD;
            assert_eq!(self.ecp.poll(self.now), None, "the robot stands");
        }
        panic!("the rate does not settle");
    }

    /// Set-points that left the servo, cycle by cycle, rad.
    pub(crate) fn sent(&self) -> Vec<[f64; N]> {
        self.sent.lock().expect("one thread").clone()
    }
}
