//! A motion for tests: one trapezoid of velocity for all motors, given to the servo in macrosteps.

use std::time::Duration;

use servo::{MAX_AXES, Macrostep};

use crate::cell::Rig;

/// A motion of all axes by the same distance, rest to rest, at [`Motion::VELOCITY`].
pub struct Motion {
    from: [f64; MAX_AXES],
    distance: f64,
    first: u64,
    sent: u64,
    macrosteps: u64,
}

impl Motion {
    /// Motor velocity, rad/s.
    pub const VELOCITY: f64 = 50.0;
    /// Motor acceleration, rad/s².
    pub const ACCELERATION: f64 = 200.0;
    /// Longest duration of a motion or a stop.
    pub const LONGEST: Duration = Duration::from_secs(5);
    const STEPS: u16 = 10;

    /// A motion by `distance`, rad, from the last commanded position of the robot.
    pub fn new(rig: &Rig, distance: f64) -> Self {
        let duration = distance.abs() / Self::VELOCITY + Self::VELOCITY / Self::ACCELERATION;
        let macrostep = rig.period.as_secs_f64() * f64::from(Self::STEPS);
        Self {
            from: rig.last.axis.map(|axis| axis.commanded),
            distance,
            first: rig.last.cycle,
            sent: 0,
            macrosteps: (duration / macrostep).ceil() as u64,
        }
    }

    /// Whether all macrosteps were given to the servo.
    pub fn is_sent(&self) -> bool {
        self.sent == self.macrosteps
    }

    /// The next macrostep.
    pub fn next(&mut self, period: Duration) -> Macrostep {
        self.sent += 1;
        let t = self.sent as f64 * period.as_secs_f64() * f64::from(Self::STEPS);
        let (way, velocity) = if self.sent == self.macrosteps { (self.distance, 0.0) } else { self.at(t) };
        Macrostep {
            number: self.first + self.sent,
            steps: Self::STEPS,
            report_at: Self::STEPS,
            position: self.from.map(|from| from + way),
            velocity: [velocity; MAX_AXES],
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: None,
            continues_law: false,
        }
    }

    fn at(&self, t: f64) -> (f64, f64) {
        let (v, a, sign) = (Self::VELOCITY, Self::ACCELERATION, self.distance.signum());
        let ramp = v / a;
        let end = self.distance.abs() / v + ramp;
        let (way, velocity) = if t < ramp {
            (0.5 * a * t * t, a * t)
        } else if t < end - ramp {
            (v * (t - 0.5 * ramp), v)
        } else {
            let left = (end - t).max(0.0);
            (self.distance.abs() - 0.5 * a * left * left, a * left)
        };
        (sign * way, sign * velocity)
    }
}
