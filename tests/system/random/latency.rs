//! Serial lines behind USB adapters: no false stop with any latency timer that bring-up accepts.

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::axis_controller::{AxisConfig, AxisControllerGroup, Control, GroupConfig, Protocol};
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Scale, Setpoint};
use hil::{AxisController, AxisControllerConfig, LineDevice, World};
use serial::{Settings, VirtualLine};

use super::extent;

const PERIOD: Duration = Duration::from_millis(2);

/// Phases of the host's cycle to the timer.
const PHASES: u32 = 16;

/// Virtual time of each accepted line in a default run: half an hour for all lines, and a day in the long ring.
const USUAL: Duration = Duration::from_secs(31);

/// Cycles between two changes of the sign of the set-points.
const HALF_SWING: u64 = 50;

/// What came of the cycles of a line.
#[derive(Default)]
struct Course {
    state: AxisState,
    /// Greatest age of a sample, periods.
    oldest: u32,
    /// Greatest speed, rad/s.
    fastest: f64,
}

/// A drive behind an adapter, and its host.
struct Line {
    world: World,
    group: AxisControllerGroup<VirtualLine>,
    now: Instant,
}

impl Line {
    /// `start` is the time of the first call: the phase of the host's cycle to the timer of the adapter.
    fn new(protocol: Protocol, timer: Duration, start: Duration) -> Self {
        let plant = hil::AxisConfig::irp6(hil::Irp6Axis::ALL[0]);
        let emulated = AxisControllerConfig::new(plant);
        let device: Box<dyn LineDevice> = match protocol {
            Protocol::Nfv2 => Box::new(AxisController::nfv2(8, &emulated)),
            Protocol::HiMoxa => Box::new(AxisController::hi_moxa(&emulated)),
        };
        let axis = AxisConfig {
            address: 8,
            scale: Scale::new(4_000, 0.0).unwrap(),
            torque_constant: 0.105,
            control: if protocol == Protocol::Nfv2 { Control::Current } else { Control::Pwm },
            max_current: 15.0,
            max_velocity: 300.0,
            max_acceleration: 10_000.0,
        };
        let mut world = World::new();
        let line = world.add_line(Settings::AXIS_CONTROLLER, Some(timer), device);
        let host = world.host_line(line, 4_096);
        let group = AxisControllerGroup::new(vec![host], GroupConfig::new(protocol), &[axis]).unwrap();
        let mut line = Self { world, group, now: Instant::ZERO };
        line.pass(start);
        line
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.world.advance(self.now);
    }

    fn bring_up(&mut self) -> bool {
        loop {
            match self.group.bring_up(self.now) {
                Poll::Pending => self.pass(PERIOD),
                Poll::Ready(result) => return result.is_ok(),
            }
        }
    }

    /// Cycles until a fault, in which the set-points swing the motor. Returns what came of them.
    fn run(&mut self, protocol: Protocol, time: Duration) -> Course {
        let end = self.now + time;
        let mut states = [AxisState::default()];
        let mut course = Course::default();
        for cycle in HALF_SWING / 2.. {
            if self.now >= end || states[0].fault.is_some() {
                break;
            }
            self.pass(PERIOD);
            self.group.read(self.now, &mut states);
            let sign = if (cycle / HALF_SWING).is_multiple_of(2) { 1.0 } else { -1.0 };
            let setpoint = match protocol {
                Protocol::Nfv2 => Setpoint::Torque(Finite::new(sign * 0.4).unwrap()),
                Protocol::HiMoxa => Setpoint::Duty(Finite::new(sign * 0.08).unwrap()),
            };
            let command = if states[0].following { AxisCommand::Follow(setpoint) } else { AxisCommand::Stand };
            self.group.write(self.now, &[command]);
            self.group.send(self.now);
            course.oldest = course.oldest.max(states[0].age);
            course.fastest = course.fastest.max(states[0].velocity.abs());
        }
        course.state = states[0];
        course
    }
}

#[test]
fn no_line_that_bring_up_accepts_is_stopped() {
    let (_, times) = extent();
    for protocol in [Protocol::Nfv2, Protocol::HiMoxa] {
        for timer in 1..=16 {
            let mut accepted = 0;
            for phase in 0..PHASES {
                let start = PERIOD * phase / PHASES + Duration::from_micros(7);
                let mut line = Line::new(protocol, Duration::from_millis(timer), start);
                if line.bring_up() {
                    accepted += 1;
                    let Course { state, oldest, fastest } = line.run(protocol, USUAL * times as u32);
                    assert_eq!(state.fault, None, "{protocol:?}, {timer} ms, phase {phase}");
                    assert!(fastest > 20.0, "{protocol:?}, {timer} ms, phase {phase}: {fastest} rad/s");
                    assert!(oldest <= 2, "{protocol:?}, {timer} ms, phase {phase}: {oldest} periods");
                }
            }
            let expected = match timer {
                1 => PHASES..=PHASES,
                // It depends on the phase whether the answers of a period come within the period.
                2 => 1..=PHASES,
                _ => 0..=0,
            };
            assert!(expected.contains(&accepted), "{protocol:?}, {timer} ms: {accepted} accepted");
        }
    }
}
