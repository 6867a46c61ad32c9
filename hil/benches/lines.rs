//! Speed of the emulation of a robot of six serial axis controllers. Each axis has its own line of 921600 baud and
//! speaks NFv2. Every 2 ms each line carries a request with a pulse width and three reads.
//!
//! One iteration simulates one second, so the reciprocal of its duration is the number of simulated seconds per
//! second.

use std::hint::black_box;
use std::time::Duration;

use can::Instant;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_hil::{AxisConfig, AxisController, AxisControllerConfig, Irp6Axis, World};
use serial::nfv2::{Command, FrameBuilder, Mode};
use serial::{Line, Settings, VirtualLine};

const PERIOD: Duration = Duration::from_millis(2);
/// Bytes of an answer to three reads.
const ANSWER: usize = 19;

type Axes = fn(Irp6Axis) -> AxisConfig;

struct Robot {
    world: World,
    hosts: Vec<VirtualLine>,
    now: Instant,
    cycle: u32,
}

impl Robot {
    fn new(axis: Axes) -> Self {
        let mut world = World::new();
        let hosts = (0..).zip(Irp6Axis::ALL).map(|(address, which)| {
            let config = AxisControllerConfig::new(axis(which));
            let device = AxisController::nfv2(address, &config);
            let line = world.add_line(Settings::AXIS_CONTROLLER, None, Box::new(device));
            world.host_line(line, 256)
        });
        let hosts = hosts.collect();
        let mut robot = Self { world, hosts, now: Instant::ZERO, cycle: 0 };
        robot.exchange(Command::SetMode(Mode::Pwm));
        robot
    }

    /// Returns the number of axes that answered.
    fn exchange(&mut self, command: Command) -> usize {
        for (address, host) in (0..).zip(&mut self.hosts) {
            let mut frame = FrameBuilder::new(address);
            frame
                .command(command)
                .command(Command::ReadPosition)
                .command(Command::ReadCurrent)
                .command(Command::ReadStatus);
            let bytes = frame.finish().expect("it fits");
            host.write(self.now, bytes).expect("the line is there");
        }
        self.now += PERIOD;
        self.world.advance(self.now);
        let mut into = [0; 64];
        let mut answered = 0;
        for host in &mut self.hosts {
            let count = host.read(self.now, &mut into).expect("the line is there");
            answered += usize::from(count == ANSWER);
            black_box(&into);
        }
        answered
    }

    /// One cycle: a request to each axis and its answer.
    fn step(&mut self) -> usize {
        self.cycle += 1;
        let angle = f64::from(self.cycle) * PERIOD.as_secs_f64() * std::f64::consts::TAU;
        self.exchange(Command::SetPwm((60.0 * angle.sin()) as i16))
    }
}

fn second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("six serial axes, 2 ms, one simulated second");
    group.throughput(Throughput::Elements(500));
    let plants: [(&str, Axes); 2] = [("motors", AxisConfig::irp6), ("regression model", AxisConfig::wut)];
    for (name, axis) in plants {
        let mut robot = Robot::new(axis);
        assert_eq!(robot.step(), robot.hosts.len(), "every axis answers");
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for _ in 0..500 {
                    black_box(robot.step());
                }
            });
        });
        assert_eq!(robot.step(), robot.hosts.len(), "every axis still does");
    }
    group.finish();
}

criterion_group!(benches, second);
criterion_main!(benches);
