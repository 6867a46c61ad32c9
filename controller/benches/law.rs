//! Computing time of one cycle of the force law of the seven-axis Polycrank, with its quantiles.
//!
//! `cargo bench -p mrroc-controller --bench law` prints one line. The command fails if a cycle takes 5 µs or more at the
//! 99th percentile. `MRROC_STEPS` is the number of cycles, 100,000 by default. The clock is read around each call.

#![allow(clippy::disallowed_methods, reason = "a benchmark reads the clock and the environment")]

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use can::{Instant, clock};
use drive::wrench::RehearsedWrench;
use hdrhistogram::Histogram;
use mrroc_controller::force::Load;
use mrroc_controller::law::{Compliance, Direction, ForceLimits, ForceTask, Guard, PositionForce, PositionForceConfig};
use mrroc_controller::robot::{Arm, Polycrank, PolycrankParameters, Pose};
use nalgebra::{UnitQuaternion, Vector3};
use servo::{CycleLaw, Knot, LawAxis, LawInput, LawOutput, LawParameters, MAX_AXES, Trail};

/// Greatest time of a cycle at the 99th percentile, µs.
const WITHIN: f64 = 5.0;
const PERIOD: Duration = Duration::from_millis(2);

fn main() -> ExitCode {
    let cycles = std::env::var("MRROC_STEPS").ok().and_then(|cycles| cycles.parse().ok()).unwrap_or(100_000_u32);
    let robot = Polycrank::new(&PolycrankParameters::polycrank()).expect("its parameters are consistent");
    let arm = Arm::new(Arc::new(robot), Pose::identity());
    let motors = arm.motors(&[0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2, 0.0]).expect("the joints are within their limits");
    let config = PositionForceConfig {
        arm,
        upright_from_base: UnitQuaternion::identity(),
        flange_from_sensor: Pose::identity(),
        load: Some(Load::of_weight(0.5, Vector3::new(0.0, 0.0, 0.05)).expect("the load is a body")),
        lag: Duration::ZERO,
        zeroed: None,
        payload: None,
        limits: ForceLimits {
            wrench: [100.0; 6],
            age: 3 * PERIOD,
            speed: [50.0; MAX_AXES],
            acceleration: [500.0; MAX_AXES],
        },
    };
    let (mut sensor, link) = RehearsedWrench::new();
    let mut law = PositionForce::new(config, link).expect("the limits are sound");
    let linear = Direction::Admittance { stiffness: 500.0, compliance: Compliance::LINEAR };
    let rotary = Direction::Admittance { stiffness: 20.0, compliance: Compliance::ROTARY };
    let task = ForceTask {
        directions: [linear, linear, linear, rotary, rotary, rotary],
        guard: Some(Guard { force: 50.0, torque: 50.0, samples: 1 }),
        ..ForceTask::default()
    };
    let parameters: LawParameters = task.into();
    let mut times: Histogram<u64> = Histogram::new_with_max(1_000_000_000, 3).expect("three digits are allowed");
    let mut displacement = [0.0; MAX_AXES];
    for cycle in 0..cycles {
        let now = Instant::ZERO + PERIOD * (cycle + 1);
        let push = (0.01 * f64::from(cycle)).sin();
        sensor.advance(now, [5.0 * push, 3.0 * push, 10.0 * push, 0.1 * push, 0.0, 0.2 * push]);
        // The motors accelerate by 10 rad/s².
        let path = |after: f64| motors.map(|motor| motor + 5.0 * after * after);
        let trail = Trail::along(now, 0.002, 3, path);
        let given: [LawAxis; MAX_AXES] = std::array::from_fn(|axis| LawAxis {
            planned: Knot::at_rest(motors[axis]),
            displacement: displacement[axis],
            ..LawAxis::default()
        });
        let input =
            LawInput { now, period: 0.002, periods: 1, rate: 1.0, macrostep: 1, axes: &given[..7], trail: &trail };
        if cycle == 0 {
            law.begin(&input, &parameters);
        }
        let begun = clock::now();
        let output = law.shift(&input, &parameters);
        times.saturating_record(clock::now().since(begun).as_nanos() as u64);
        let LawOutput::Displacement(next) = output else { panic!("{output:?} in cycle {cycle}") };
        displacement = next;
    }
    let at = |quantile| times.value_at_quantile(quantile) as f64 / 1e3;
    let p99 = at(0.99);
    println!(
        "force law, seven axes: p50 {:.2} µs, p99 {p99:.2} µs, p99.9 {:.2} µs, of {cycles} cycles",
        at(0.5),
        at(0.999)
    );
    if p99 < WITHIN { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
