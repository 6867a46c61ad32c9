//! The servo loop of the IRp-6 with the motors that the robot's own software emulates. The regulator of the servo acts
//! on the plant sample by sample, without a drive in between.
//!
//! The results depend on the order within a period. The loop reads the encoder, computes the current from the set-point
//! of the same instant, and writes the current. The motor then runs with this current until the next period. A further
//! period of delay would reduce the phase margin of the column to 9°.

use std::f64::consts::TAU;

use hil::plant::{FrictionConfig, Wut, WutConfig};
use servo::regulator::{IRP6, Incremental, IncrementalConfig};

const PERIOD: f64 = 0.002;

/// A rest-to-rest motion of the motor: distance, rad; velocity, rad/s; acceleration, rad/s².
#[derive(Clone, Copy)]
pub(crate) struct Trapezoid {
    pub(crate) distance: f64,
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
}

impl Trapezoid {
    pub(crate) fn at(self, t: f64) -> f64 {
        let Self { distance, velocity, acceleration } = self;
        let ramp = velocity / acceleration;
        let end = self.duration();
        match t {
            t if t < ramp => 0.5 * acceleration * t * t,
            t if t < end - ramp => velocity * (t - 0.5 * ramp),
            t if t < end => distance - 0.5 * acceleration * (end - t) * (end - t),
            _ => distance,
        }
    }

    /// Velocity at time `t`, rad/s.
    pub(crate) fn velocity_at(self, t: f64) -> f64 {
        let to_end = self.duration() - t;
        (self.acceleration * t.min(to_end)).clamp(0.0, self.velocity)
    }

    pub(crate) fn duration(self) -> f64 {
        self.distance / self.velocity + self.velocity / self.acceleration
    }
}

/// One sample: set-point minus encoder position, counts, and the written current, mA.
type Sample = (f64, i32);

/// The motion and two seconds of rest after it.
fn run(regulator: IncrementalConfig, motor_config: WutConfig, counts: f64, motion: Trapezoid) -> Vec<Sample> {
    let per_radian = counts / TAU;
    let mut regulator = Incremental::new(regulator);
    let mut motor = Wut::new(&motor_config, 0.0);
    let (mut last_demand, mut last_count) = (0.0, 0);
    let periods = (motion.duration() / PERIOD) as u32 + 1000;
    (0..periods)
        .map(|k| {
            let count = (motor.angle * per_radian).floor() as i32;
            let demand = motion.at(f64::from(k) * PERIOD) * per_radian;
            let moved = f64::from(count - last_count);
            let torque = regulator.step(demand - last_demand - moved, 0.0);
            // Drives receive whole milliamperes.
            let current = (torque / motor_config.torque_constant * 1000.0) as i32;
            motor.step(f64::from(current) / 1000.0, PERIOD, 0.0);
            (last_demand, last_count) = (demand, count);
            (demand - f64::from(count), current)
        })
        .collect()
}

fn worst(samples: &[Sample]) -> f64 {
    samples.iter().map(|(error, _)| error.abs()).fold(0.0, f64::max)
}

fn end(samples: &[Sample]) -> f64 {
    samples.last().expect("a run has samples").0
}

fn peak_current(samples: &[Sample]) -> i32 {
    samples.iter().map(|(_, current)| current.abs()).max().expect("a run has samples")
}

pub(crate) const LARGE: WutConfig = WutConfig {
    torque_constant: 0.105,
    inertia: 1.5e-4,
    viscous: 0.02,
    friction: FrictionConfig::NONE,
    resistance: 0.6,
};

pub(crate) const SMALL: WutConfig = WutConfig { inertia: 1.5e-5, viscous: 2e-4, ..LARGE };

pub(crate) const MOTION: Trapezoid = Trapezoid { distance: 100.0, velocity: 50.0, acceleration: 150.0 };

#[test]
fn every_axis_follows_as_the_original_emulator_does() {
    // In counts: largest error, mean error at constant velocity (1.1 to 1.2 s), error after the motion. In mA: largest
    // current, current at 1.2 s and its tolerance.
    let table = [
        (LARGE, 4000.0, 147.0, -0.04, 0.0, 9978, (9488, 1)),
        (LARGE, 4000.0, 287.0, -0.16, 0.0, 9922, (9535, 20)),
        (LARGE, 4000.0, 224.0, 0.02, 0.0, 9970, (9491, 1)),
        (LARGE, 4000.0, 172.0, 0.02, 0.0, 9890, (9517, 1)),
        (SMALL, 4000.0, 3.0, 0.0, 0.0, 176, (100, 20)),
        (SMALL, 2000.0, 81.0, 0.64, 0.0, 117, (97, 5)),
    ];
    for (axis, (regulator, row)) in IRP6.into_iter().zip(table).enumerate() {
        let (motor, counts, error, cruise_error, end_error, current, (cruise_current, tolerance)) = row;
        let samples = run(regulator, motor, counts, MOTION);
        let cruise = &samples[550..600];
        let mean = cruise.iter().map(|(error, _)| error).sum::<f64>() / 50.0;
        let axis = axis + 1;
        assert!((worst(&samples) - error).abs() < 1.0, "axis {axis}: largest error {}", worst(&samples));
        assert!((mean - cruise_error).abs() < 0.006, "axis {axis}: cruise error {mean}");
        assert!((end(&samples) - end_error).abs() < 1.0, "axis {axis}: end error {}", end(&samples));
        assert!((peak_current(&samples) - current).abs() <= 1, "axis {axis}: {} mA", peak_current(&samples));
        let last = samples[600].1;
        assert!((last - cruise_current).abs() <= tolerance, "axis {axis}: {last} mA in cruise");
    }
}

#[test]
fn column_at_twice_the_speed_all_but_needs_its_whole_current() {
    let samples = run(IRP6[0], LARGE, 4000.0, Trapezoid { velocity: 100.0, ..MOTION });
    assert!((worst(&samples) - 156.0).abs() < 1.0, "{} counts", worst(&samples));
    assert!((19_450..=19_550).contains(&peak_current(&samples)), "{} mA", peak_current(&samples));
}

#[test]
fn dry_friction_costs_the_column_four_counts_and_no_limit_cycle() {
    let friction = FrictionConfig { coulomb: 0.1, stiction: 0.15, stribeck_velocity: 5.0 };
    let samples = run(IRP6[0], WutConfig { friction, ..LARGE }, 4000.0, MOTION);
    assert!((worst(&samples) - 151.0).abs() < 1.0, "{} counts", worst(&samples));
    let resting = &samples[samples.len() - 500..];
    let error = resting[0].0;
    assert!(error.abs() < 1.0, "rests {error} counts off");
    assert!(resting.iter().all(|sample| sample.0 == error), "limit cycle");

    let slow = Trapezoid { distance: 3.0, velocity: 1.0, ..MOTION };
    let samples = run(IRP6[0], WutConfig { friction, ..LARGE }, 4000.0, slow);
    assert!((worst(&samples) - 41.0).abs() < 1.0, "{} counts at break-away", worst(&samples));
    let cruise = &samples[500..1400];
    let rms = (cruise.iter().map(|(error, _)| error * error).sum::<f64>() / cruise.len() as f64).sqrt();
    assert!((rms - 0.4).abs() < 0.1, "{rms} counts rms");
}
