//! Ideal drives of one robot under the real servo, in virtual time.

#![allow(dead_code, reason = "each test takes what it needs")]

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, Fault, GroupCounters, Homing, Power, Setpoint};
use servo::{EffectorConfig, EffectorLink, PositionLoop, Servo, ServoAxisConfig, ServoConfig};

pub(crate) const PERIOD: Duration = Duration::from_millis(2);

/// Set-points sent, cycle by cycle.
pub(crate) type Sent<const AXES: usize> = Arc<Mutex<Vec<[f64; AXES]>>>;

/// The fault of the first drive of a robot.
pub(crate) type FirstFault = Arc<Mutex<Option<Fault>>>;

/// Ideal drives of one robot, homed.
pub(crate) struct Ideal<const AXES: usize> {
    commands: [AxisCommand; AXES],
    latched: [AxisCommand; AXES],
    position: [f64; AXES],
    now: Instant,
    sent: Sent<AXES>,
    fault: FirstFault,
}

impl<const AXES: usize> Ideal<AXES> {
    /// Drives that are off, with their motors at `position`, rad.
    pub(crate) fn new(position: [f64; AXES], sent: &Sent<AXES>, fault: &FirstFault) -> Self {
        let off = [AxisCommand::Off; AXES];
        let (sent, fault) = (Arc::clone(sent), Arc::clone(fault));
        Self { commands: off, latched: off, position, now: Instant::ZERO, sent, fault }
    }
}

impl<const AXES: usize> DriveGroup for Ideal<AXES> {
    fn axes(&self) -> usize {
        AXES
    }
    fn delay(&self) -> usize {
        2
    }
    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }
    fn read(&mut self, _: Instant, states: &mut [AxisState]) {
        for (axis, state) in states.iter_mut().enumerate() {
            let on = !matches!(self.latched[axis], AxisCommand::Off | AxisCommand::ResetFault);
            *state = AxisState {
                sampled: self.now,
                position: self.position[axis],
                power: if on { Power::On } else { Power::Off },
                homing: Homing::Attained,
                following: on,
                fault: self.fault.lock().expect("one thread").filter(|_| axis == 0),
                ..AxisState::default()
            };
        }
    }
    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        self.commands.copy_from_slice(commands);
    }
    fn send(&mut self, now: Instant) -> bool {
        self.now = now;
        for (axis, command) in self.latched.iter().enumerate() {
            if let AxisCommand::Follow(Setpoint::Position(position)) = command {
                self.position[axis] = position.get();
            }
        }
        self.latched = self.commands;
        let asked = |axis: usize| match self.commands[axis] {
            AxisCommand::Follow(Setpoint::Position(position)) => position.get(),
            _ => self.position[axis],
        };
        self.sent.lock().expect("one thread").push(std::array::from_fn(asked));
        true
    }
    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

/// A servo with ideal drives, whose motors stand at `position`, rad. Limits are those of each motor, rad/s and rad/s².
pub(crate) fn servo<const AXES: usize>(
    position: [f64; AXES],
    max_velocity: f64,
    max_acceleration: f64,
    sent: &Sent<AXES>,
) -> (Servo, EffectorLink) {
    let (servo, mut links) = team(position, max_velocity, max_acceleration, std::array::from_ref(sent));
    (servo, links.remove(0))
}

/// A servo with the ideal drives of one robot for each list of set-points in `sent`. All robots are alike.
pub(crate) fn team<const AXES: usize>(
    position: [f64; AXES],
    max_velocity: f64,
    max_acceleration: f64,
    sent: &[Sent<AXES>],
) -> (Servo, Vec<EffectorLink>) {
    let axis = |group, index_in_group| ServoAxisConfig {
        group,
        index_in_group,
        min_position: -1e4,
        max_position: 1e4,
        max_velocity,
        max_acceleration,
        planned_jerk: 5.0 * max_acceleration,
        following_error: 10.0,
        homing_order: 1,
        increments_per_radian: 1000.0,
        position_loop: PositionLoop::Drive,
        torque_offset: None,
        homing: None,
        frozen: servo::FrozenWatch::Always,
        brake_watch: true,
    };
    let effector = |group| EffectorConfig {
        name: format!("robot {group}"),
        axes: (0..AXES).map(|index| axis(group, index)).collect(),
        queue: 32,
        enabling_timeout: Duration::from_secs(1),
        homing_timeout: Duration::from_secs(1),
    };
    let effectors = (0..sent.len()).map(effector).collect();
    let group = |sent| Box::new(Ideal::new(position, sent, &FirstFault::default())) as Box<dyn DriveGroup>;
    let config = ServoConfig { period: PERIOD, max_missed_in_row: 1, effectors };
    Servo::new(&config, sent.iter().map(group).collect()).expect("a sound servo")
}
