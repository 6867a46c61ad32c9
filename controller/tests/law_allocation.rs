//! A force law in the servo cycle does not allocate, for any arm, nor when it ends.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use drive::wrench::RehearsedWrench;
use mrroc_controller::force::Load;
use mrroc_controller::law::{Compliance, Direction, ForceLimits, ForceTask, Guard, PositionForce, PositionForceConfig};
use mrroc_controller::robot::{
    Arm, Axes, Irb6, Irb6Parameters, Irp6, Irp6Parameters, Polycrank, PolycrankParameters, Pose, Robot,
};
use nalgebra::{UnitQuaternion, Vector3};
use servo::{CycleLaw, Knot, LawAxis, LawInput, LawOutput, LawParameters, MAX_AXES, Trail};

use crate::counting;

const PERIOD: Duration = Duration::from_millis(2);

#[test]
fn ten_thousand_cycles_of_a_law_and_its_ends_do_not_allocate() {
    let irb6 = Irb6::new(&Irb6Parameters::irb6()).expect("its parameters are consistent");
    let irp6 = Irp6::new(&Irp6Parameters::irp6p()).expect("its parameters are consistent");
    let polycrank = Polycrank::new(&PolycrankParameters::polycrank()).expect("its parameters are consistent");
    let robots: [(Arc<dyn Robot>, Axes); 3] = [
        (Arc::new(irb6), [0.3, -FRAC_PI_2, 0.1, FRAC_PI_2, 0.4, 0.0, 0.0, 0.0]),
        (Arc::new(irp6), [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0]),
        (Arc::new(polycrank), [0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2, 0.0]),
    ];
    for (robot, joints) in robots {
        let arm = Arm::new(robot, Pose::identity());
        let axes = arm.axes();
        let motors = arm.motors(&joints).expect("the joints are within their limits");
        let limits = ForceLimits {
            wrench: [100.0; 6],
            age: 3 * PERIOD,
            speed: [50.0; MAX_AXES],
            acceleration: [500.0; MAX_AXES],
        };
        let load = Load::of_weight(0.5, Vector3::new(0.0, 0.0, 0.05)).expect("the load is a body");
        let config = PositionForceConfig {
            arm,
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor: Pose::identity(),
            load: Some(load),
            lag: Duration::ZERO,
            zeroed: None,
            payload: None,
            limits,
        };
        let (mut sensor, link) = RehearsedWrench::new();
        let mut law = PositionForce::new(config, link).expect("the limits are sound");
        let mut task =
            ForceTask { guard: Some(Guard { force: 50.0, torque: 50.0, samples: 1 }), ..ForceTask::default() };
        task.directions[2] = Direction::Admittance { stiffness: 500.0, compliance: Compliance::LINEAR };
        let parameters: LawParameters = task.into();
        let mut now = Instant::ZERO;
        let mut displacement = [0.0; MAX_AXES];
        let mut cycle = |law: &mut PositionForce, push: Option<f64>, first: bool| {
            now += PERIOD;
            if let Some(push) = push {
                sensor.advance(now, [0.0, 0.0, push, 0.0, 0.0, 0.0]);
            }
            // The motors accelerate by 10 rad/s².
            let path = |after: f64| motors.map(|motor| motor + 5.0 * after * after);
            let trail = Trail::along(now, 0.002, 3, path);
            let given: [LawAxis; MAX_AXES] = std::array::from_fn(|axis| LawAxis {
                planned: Knot::at_rest(motors[axis]),
                displacement: displacement[axis],
                ..LawAxis::default()
            });
            let axes = &given[..axes];
            let input = LawInput { now, period: 0.002, periods: 1, rate: 1.0, macrostep: 1, axes, trail: &trail };
            assert_eq!(law.check(&parameters), Ok(()));
            if first {
                law.begin(&input, &parameters);
            }
            let output = law.shift(&input, &parameters);
            if let LawOutput::Displacement(next) = output {
                displacement = next;
            }
            output
        };
        let before = counting::allocations();
        for number in 0..10_000 {
            let push = 10.0 * (0.01 * f64::from(number)).sin();
            let output = cycle(&mut law, Some(push), number == 0);
            assert!(matches!(output, LawOutput::Displacement(_)), "{output:?}");
        }
        let touched = cycle(&mut law, Some(60.0), false);
        let exceeded = cycle(&mut law, Some(200.0), false);
        (0..5).for_each(|_| assert_ne!(cycle(&mut law, None, false), LawOutput::Touched));
        let silent = cycle(&mut law, None, false);
        let counted = counting::allocations() - before;
        assert_eq!(counted, 0);
        assert_eq!(touched, LawOutput::Touched);
        assert!(matches!([exceeded, silent], [LawOutput::Fault(_), LawOutput::Fault(_)]), "{exceeded:?} {silent:?}");
    }
}
