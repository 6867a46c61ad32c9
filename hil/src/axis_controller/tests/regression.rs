//! The robots' own regulators over telegrams, compared with the emulator of the robots' own software.

use super::*;
use std::f64::consts::TAU;

/// The regulator of the robots' software from 2012 on, which commands currents to the drive.
struct Original {
    a: f64,
    b0: f64,
    b1: f64,
    epsilon: f64,
    /// Gain, mA.
    gain: f64,
    /// Limit, mA.
    limit: f64,
    outputs: [f64; 2],
    errors: [f64; 2],
}

impl Original {
    fn new([a, b0, b1, epsilon, gain, limit]: [f64; 6]) -> Self {
        Self { a, b0, b1, epsilon, gain, limit, outputs: [0.0; 2], errors: [0.0; 2] }
    }

    /// The current, mA, for the position increment missed in one period, counts.
    fn turn(&mut self, missed: f64) -> i16 {
        let Self { a, b0, b1, epsilon, .. } = *self;
        let [before, sum] = self.errors;
        let error = sum + (1.0 + epsilon) * missed - (1.0 - epsilon) * before;
        let [last, older] = self.outputs;
        let output = (1.0 + a) * last - a * older + b0 * error - b1 * sum;
        self.errors = [missed, error];
        self.outputs = [output, last];
        (self.gain * output).clamp(-self.limit, self.limit) as i16
    }
}

/// Trapezoidal motion from standstill to standstill: 100 rad at 50 rad/s and 150 rad/s², after 0.2 s.
fn trapezoid(seconds: f64) -> f64 {
    const RAMP: f64 = 1.0 / 3.0;
    const END: f64 = 2.0 + RAMP;
    match seconds - 0.2 {
        t if t < 0.0 => 0.0,
        t if t < RAMP => 75.0 * t * t,
        t if t < END - RAMP => 50.0 * (t - 0.5 * RAMP),
        t if t < END => 100.0 - 75.0 * (END - t) * (END - t),
        _ => 100.0,
    }
}

#[test]
fn the_original_regulators_follow_as_they_do_on_the_original_emulator() {
    // Regulator, and the largest error, counts, and current, mA, of that emulator. The telegrams add a delay: an
    // answer is one period old when the current computed from it arrives. The roll axis is left out: its phase margin
    // of 8° does not tolerate the delay.
    let table = [
        (Irp6Axis::Column, [0.412429378531, 1.5569592, 1.5028614, 0.010, 200.0, 20_000.0], (147.0, 9978.0)),
        (Irp6Axis::LowerArm, [0.655629139073, 0.6181068, 0.5916852, 0.008, 150.0, 15_000.0], (287.0, 9922.0)),
        (Irp6Axis::UpperArm, [0.315789473684, 1.1984784, 1.1424828, 0.008, 180.0, 15_000.0], (224.0, 9970.0)),
        (Irp6Axis::Pitch, [0.548946716233, 0.6305064, 0.5874396, 0.010, 170.0, 15_000.0], (172.0, 9890.0)),
        (Irp6Axis::Flange, [0.3, 0.5456, 0.5056, 0.005, 11.0, 1_000.0], (81.0, 117.0)),
    ];
    for (axis, numbers, (error, current)) in table {
        let mut config = AxisControllerConfig::new(AxisConfig::wut(axis));
        config.axis.start_angle -= 60.0;
        let counts = f64::from(config.axis.counts_per_revolution) / TAU;
        let mut regulator = Original::new(numbers);
        let mut rig = Rig::nfv2(&config);
        rig.cycle(&[Command::SetMode(Mode::Current)]);
        let (mut set_point, mut target, mut position) = (0, 0.0, 0.0);
        let (mut worst, mut most, mut last) = (0.0_f64, 0.0_f64, 0.0);
        for k in 0..4000 {
            let reading = rig.cycle(&[Command::SetCurrent(set_point)]);
            let next = (trapezoid(f64::from(k) * PERIOD.as_secs_f64()) * counts).trunc();
            let moved = f64::from(reading.position) - position;
            set_point = regulator.turn(next - target - moved);
            (target, position) = (next, f64::from(reading.position));
            last = target - position;
            worst = worst.max(last.abs());
            most = most.max(f64::from(reading.current).abs());
        }
        assert!((worst - error).abs() <= 3.0, "{axis:?}: {worst} counts");
        assert!((most / current - 1.0).abs() < 0.03, "{axis:?}: {most} mA");
        assert!(last.abs() <= 1.0, "{axis:?}: ends {last} counts off");
    }
}
