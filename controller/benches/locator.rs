//! Computing time of the place of a box by an ultrasonic matrix of 144 elements, with its quantiles.
//!
//! `cargo bench -p mrroc-controller --bench locator` prints one line for a box at rest, and one for a box that moves between
//! any two readings. `MRROC_STEPS` is the number of readings, 2,000 by default. The clock is read around each call.

#![allow(clippy::disallowed_methods, reason = "a benchmark reads the clock and the environment")]

use std::time::Duration;

use can::{Instant, clock};
use drive::ultrasonic::{RehearsedUltrasonic, ScanKind};
use hdrhistogram::Histogram;
use mrroc_controller::robot::Pose;
use mrroc_controller::sensor::{BoxLocator, MatrixConfig};

/// Edges of the box, distance of its upper face, and pitch of the matrix, m.
const SIZE: [f64; 3] = [0.08, 0.06, 0.05];
const DISTANCE: f64 = 0.3;
const PITCH: f64 = 0.02;
const SCAN: Duration = Duration::from_millis(100);

fn main() {
    let readings = std::env::var("MRROC_STEPS").ok().and_then(|count| count.parse().ok()).unwrap_or(2_000_u32);
    let config = MatrixConfig {
        size: 12,
        scan: ScanKind::Rows,
        pitch: PITCH,
        half_cone: 8.0_f64.to_radians(),
        speed_of_sound: 343.0,
        deviation: 1e-3,
        base_from_matrix: Pose::identity(),
    };
    for (name, moves) in [("rests", false), ("moves", true)] {
        let (mut matrix, link) = RehearsedUltrasonic::new(SCAN);
        let mut locator = BoxLocator::new(link, config, SIZE, 1);
        let mut times: Histogram<u64> = Histogram::new_with_max(1_000_000_000, 3).expect("three digits are allowed");
        let mut found = 0;
        for reading in 1..=readings {
            let number = if moves { f64::from(reading) } else { 0.0 };
            let (x, y, yaw) = (0.03 * (7.1 * number).sin(), 0.03 * (3.3 * number).cos(), 1.5 * (5.7 * number).sin());
            let now = Instant::ZERO + SCAN * reading;
            matrix.scan(now, |row, column| {
                let [dx, dy] = [column as f64 - 5.5 - x / PITCH, row as f64 - 5.5 - y / PITCH].map(|it| it * PITCH);
                let local = [yaw.cos() * dx + yaw.sin() * dy, yaw.cos() * dy - yaw.sin() * dx];
                let beyond = (local[0].abs() - SIZE[0] / 2.0).max(0.0).hypot((local[1].abs() - SIZE[1] / 2.0).max(0.0));
                let is_seen = beyond <= DISTANCE * config.half_cone.tan();
                let distance = if is_seen { DISTANCE.hypot(beyond) } else { DISTANCE + SIZE[2] };
                // Noise of up to 1 mm, and one echo in ten is lost.
                let mixed = (row * 31 + column * 17 + reading as usize * 101) * 7919 % 1009;
                let noise = 1e-3 * (mixed as f64 / 504.5 - 1.0);
                (!mixed.is_multiple_of(10))
                    .then(|| Duration::from_secs_f64(2.0 * (distance + noise) / config.speed_of_sound))
            });
            let begun = clock::now();
            let (_, reading) = locator.read();
            times.saturating_record(clock::now().since(begun).as_nanos() as u64);
            found += u32::from(reading.result().is_ok());
        }
        let at = |quantile| times.value_at_quantile(quantile) as f64 / 1e3;
        println!(
            "a box that {name}: p50 {:.0} µs, p99 {:.0} µs, greatest {:.0} µs; found in {found} of {readings} readings",
            at(0.5),
            at(0.99),
            times.max() as f64 / 1e3
        );
    }
}
