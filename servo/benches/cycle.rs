//! Duration of one cycle of a moving effector on an idle group, without system calls and encoding. The drives close the
//! position loops, or the servo does by either law. A cycle law may displace the set-points.

use std::hint::black_box;
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use criterion::{Criterion, criterion_group, criterion_main};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power};
use mrroc_servo::regulator::{CascadeConfig, IRP6};
use mrroc_servo::{
    CycleLaw, EffectorConfig, EffectorLink, FeedForward, HostLoop, Law, LawBound, LawFault, LawInput, LawOutput,
    LawParameters, MAX_AXES, Macrostep, Order, Output, Phase, PositionLoop, Servo, ServoAxisConfig, ServoConfig,
};

const PERIOD: Duration = Duration::from_millis(1);

/// Drives that are on, homed and always at their commanded position.
struct Trivial(Vec<AxisState>);

impl DriveGroup for Trivial {
    fn axes(&self) -> usize {
        self.0.len()
    }
    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }
    fn read(&mut self, _: Instant, states: &mut [AxisState]) {
        states.copy_from_slice(&self.0);
    }
    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        black_box(commands);
    }
    fn send(&mut self, _: Instant) -> bool {
        true
    }
    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

fn servo(axes: usize, position_loop: PositionLoop) -> (Servo, EffectorLink) {
    let axis = |index_in_group| ServoAxisConfig {
        group: 0,
        index_in_group,
        min_position: -500.0,
        max_position: 500.0,
        max_velocity: 100.0,
        max_acceleration: 1000.0,
        planned_jerk: 5000.0,
        following_error: 1.0,
        homing_order: 0,
        increments_per_radian: 4000.0 / std::f64::consts::TAU,
        position_loop,
        torque_offset: None,
        homing: None,
        frozen: mrroc_servo::FrozenWatch::Always,
        brake_watch: true,
    };
    let config = ServoConfig {
        period: PERIOD,
        max_missed_in_row: 3,
        effectors: vec![EffectorConfig {
            name: "arm".into(),
            axes: (0..axes).map(axis).collect(),
            queue: 16,
            enabling_timeout: Duration::from_secs(1),
            homing_timeout: Duration::from_secs(1),
        }],
    };
    let state = AxisState { power: Power::On, homing: Homing::Attained, following: true, ..AxisState::default() };
    let (servo, mut links) =
        Servo::new(&config, vec![Box::new(Trivial(vec![state; axes]))]).expect("the configuration is sound");
    (servo, links.remove(0))
}

/// A law that swings all motors by 1 mrad.
struct Swing(f64);

impl CycleLaw for Swing {
    fn check(&self, _: &LawParameters) -> Result<(), LawFault> {
        Ok(())
    }

    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {}

    fn shift(&mut self, input: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        self.0 += 10.0 * input.period;
        LawOutput::Displacement([1e-3 * (1.0 - self.0.cos()); MAX_AXES])
    }
}

fn bench(criterion: &mut Criterion, name: &str, axes: usize, position_loop: PositionLoop, law: bool) {
    let (mut servo, mut link) = servo(axes, position_loop);
    if law {
        let bounds = vec![LawBound { displacement: 0.1, speed: 10.0 }; axes];
        servo.install_law(0, Box::new(Swing(0.0)), &bounds).expect("the bounds are sound");
    }
    link.orders.push(Order::Enable).expect("the queue is empty");
    let mut now = Instant::ZERO;
    for _ in 0..10 {
        servo.step(now);
        now += PERIOD;
    }
    let mut number = 0;
    criterion.bench_function(name, |bencher| {
        bencher.iter(|| {
            if link.orders.slots() == 16 {
                // Back and forth by 0.01 rad, ten periods each.
                number += 1;
                let position = [0.01 * (number % 2) as f64; MAX_AXES];
                let velocity = [0.0; MAX_AXES];
                let macrostep = Macrostep {
                    number,
                    steps: 10,
                    report_at: 5,
                    position,
                    velocity,
                    acceleration: None,
                    torque: [0.0; MAX_AXES],
                    law: law.then(LawParameters::default),
                    continues_law: false,
                };
                link.orders.push(Order::Move(macrostep)).expect("there is room");
            }
            while link.reports.pop().is_ok() {}
            servo.step(now);
            now += PERIOD;
        });
        assert_eq!(servo.state(0).map(|state| state.phase()), Some(Phase::Moving));
    });
}

fn cycle(criterion: &mut Criterion) {
    let by = |law| {
        PositionLoop::Host(HostLoop {
            law,
            output: Output::Torque,
            feed_forward: FeedForward { velocity: 1e-3, acceleration: 6.6e-4, coulomb: 0.08, ..FeedForward::default() },
            runaway_velocity: 300.0,
        })
    };
    let cascade = CascadeConfig { position_gain: 25.0, velocity_gain: 0.066, integral_rate: 10.0, limit: 2.1 };
    let rows = [
        ("six moving axes, one step", 6, PositionLoop::Drive, false),
        ("six moving axes, incremental law", 6, by(Law::Incremental(IRP6[0])), false),
        ("six moving axes, cascade", 6, by(Law::Cascade(cascade)), false),
        ("seven moving axes, one step", 7, PositionLoop::Drive, false),
        ("seven moving axes, cycle law", 7, PositionLoop::Drive, true),
    ];
    for (name, axes, position_loop, law) in rows {
        bench(criterion, name, axes, position_loop, law);
    }
}

criterion_group!(benches, cycle);
criterion_main!(benches);
