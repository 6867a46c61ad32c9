//! A drive group without a bus: ideal drives that latch at SYNC, and a script for their faults.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]
#![allow(dead_code, reason = "each test binary uses its part of it")]
#![allow(unreachable_pub, reason = "unit tests and test binaries share it")]

use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use can::{Instant, clock};
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, EmergencyStop, Fault, GroupCounters, Homing, Increments, Power,
    Setpoint,
};

use super::regulator::CascadeConfig;
use super::{
    EffectorConfig, FeedForward, FrozenWatch, HostLoop, Law, Output, PositionLoop, ServoAxisConfig, ServoConfig,
};

pub const PERIOD: Duration = Duration::from_millis(1);
pub const MAX_VELOCITY: f64 = 100.0;
pub const MAX_ACCELERATION: f64 = 1000.0;
/// Inertia of a motor driven by torque, kg·m².
pub const INERTIA: f64 = 5e-4;
/// Time constant of such a motor when it is shorted, s.
const BRAKING_TIME: f64 = 0.01;

/// One effector of `axes` axes on one group; homing orders descend, so the last axis homes first.
pub fn config(axes: usize) -> ServoConfig {
    let axis = |index: usize| ServoAxisConfig {
        group: 0,
        index_in_group: index,
        min_position: -500.0,
        max_position: 500.0,
        max_velocity: MAX_VELOCITY,
        max_acceleration: MAX_ACCELERATION,
        planned_jerk: 5.0 * MAX_ACCELERATION,
        following_error: 0.5,
        homing_order: (axes - index) as u8,
        increments_per_radian: 1000.0,
        position_loop: PositionLoop::Drive,
        torque_offset: None,
        homing: None,
        frozen: FrozenWatch::Always,
        brake_watch: true,
    };
    ServoConfig {
        period: PERIOD,
        max_missed_in_row: 2,
        effectors: vec![EffectorConfig {
            name: "arm".into(),
            axes: (0..axes).map(axis).collect(),
            queue: 64,
            enabling_timeout: Duration::from_millis(100),
            homing_timeout: Duration::from_millis(200),
        }],
    }
}

/// The same with every position loop closed by the servo, with a bandwidth of about 25 Hz and a phase margin above
/// 45°.
pub fn host_config(axes: usize) -> ServoConfig {
    let mut config = config(axes);
    for axis in &mut config.effectors[0].axes {
        axis.position_loop = PositionLoop::Host(HostLoop {
            law: Law::Cascade(CascadeConfig {
                position_gain: 40.0,
                velocity_gain: 160.0 * INERTIA,
                integral_rate: 15.0,
                limit: 2.0,
            }),
            output: Output::Torque,
            feed_forward: FeedForward { acceleration: INERTIA, ..FeedForward::default() },
            runaway_velocity: 120.0,
        });
    }
    config
}

/// State of the drives and commands received.
#[derive(Default)]
pub struct World {
    pub axes: Vec<Drive>,
    /// Commands as written, cycle by cycle, if `log` is set.
    pub sent: Vec<Vec<AxisCommand>>,
    pub log: bool,
    /// Number of polls for which bring-up is pending.
    pub coming_up: u32,
    /// Bring-up fails with [`NEVER_BOOTED`].
    pub absent: bool,
    /// Calls after the bring-up, while other groups came up.
    pub waited: u32,
    /// Number of calls of `write` that panic, beginning with the next call.
    pub panics: u32,
    /// Number of batches that the bus refuses.
    pub refuses: u32,
    /// The bus has failed: every read reports [`FAULT`] for every drive, and no batch is taken.
    pub gone: bool,
    /// Duration of each call of `write` on the wall clock.
    pub work: Duration,
    pub emergency: Option<EmergencyStop>,
    /// The second drive reports power, whatever its commands.
    pub shows_power: bool,
}

/// How a drive reports that the index pulse set its counter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AtIndex {
    /// The new count and the statusword arrive in one answer.
    #[default]
    Prompt,
    /// The statusword arrives one answer after the new count.
    WordLate,
    /// The new count arrives one answer after the statusword.
    CounterLate,
    /// Three answers are missing at that moment.
    Mute,
}

/// One ideal drive.
#[derive(Clone, Default)]
pub struct Drive {
    pub state: AxisState,
    /// The motor does not move.
    pub blocked: bool,
    /// The drive does not answer any more.
    pub silent: bool,
    /// The drive never gets power.
    pub dead: bool,
    /// A reset does not clear the drive's fault.
    pub stubborn: bool,
    /// The drive has power but ignores set-points.
    pub deaf: bool,
    /// Speed, rad/s, at which the motor runs under power, whatever its set-points.
    pub runs_at: Option<f64>,
    /// The search of the drive finds nothing.
    pub homing_fails: bool,
    /// Number of SYNCs that homing takes; homing never ends if zero.
    pub homing_takes: u32,
    /// Number of SYNCs from the end of homing until the drive follows set-points.
    pub changes_mode: u32,
    /// The set-point reaches the motor one SYNC later than with an ideal drive.
    pub lags: bool,
    /// The reported velocity, independent of the motion.
    pub drifts_at: Option<f64>,
    pending: AxisCommand,
    target: Option<f64>,
    enabling: u32,
    homing: u32,
    /// SYNCs left of a change of the mode of operation.
    changing: u32,
    /// Speed of a motor that is driven by torque, rad/s; its inertia is [`INERTIA`].
    pub spin: f64,
    /// Torque of the load, N·m.
    pub load: f64,
    /// The motor turns against its torque.
    pub backwards: bool,
    /// The encoder stands still from this position on.
    pub frozen: Option<f64>,
    /// Distance by which the motor is ahead of its set-points, rad.
    pub ahead: f64,
    /// Number of cycles in which the contact of the home switch chatters, alternately open and closed.
    pub chatter: u32,
    /// While the index is sought, passing this position sets the counter to zero there.
    pub index: f64,
    pub at_index: AtIndex,
    /// Answers still missing after [`AtIndex::Mute`].
    mute: u32,
    /// The home switch is closed below this position.
    pub home_below: Option<f64>,
    /// The home switch is closed between these positions.
    pub home_between: Option<(f64, f64)>,
    /// The lower limit switch is closed below this position.
    pub limit_below: Option<f64>,
    /// The upper limit switch is closed above this position.
    pub limit_above: Option<f64>,
    /// The drive blocks torque towards a closed limit switch and shorts its motor.
    pub guards: bool,
    /// State visible to the host: the sample of the last SYNC.
    seen: AxisState,
}

impl Drive {
    fn sync(&mut self, dt: f64) {
        let state = &mut self.state;
        let before = state.position;
        let homing = state.homing;
        let powered = state.fault.is_none() && !matches!(self.pending, AxisCommand::Off | AxisCommand::ResetFault);
        self.enabling = if powered { self.enabling + 1 } else { 0 };
        state.power = match self.enabling {
            0 => Power::Off,
            _ if self.dead => Power::Changing,
            1..=3 => Power::Changing,
            _ => Power::On,
        };
        let on = state.power == Power::On;
        let follows = matches!(self.pending, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        let homes = matches!(self.pending, AxisCommand::Home);
        self.changing = if homes { self.changes_mode } else { self.changing.saturating_sub(1) };
        state.following = on && !self.deaf && follows && self.changing == 0;
        if self.pending == AxisCommand::ResetFault && !self.stubborn {
            state.fault = None;
        }
        match self.pending {
            AxisCommand::Home if on => {
                self.homing += 1;
                let found = self.homing_takes != 0 && self.homing >= self.homing_takes;
                if self.homing == self.homing_takes {
                    state.position = 0.0;
                }
                state.homing = match found {
                    false => Homing::InProgress,
                    true if self.homing_fails => Homing::Failed,
                    true => Homing::Attained,
                };
            }
            AxisCommand::Follow(Setpoint::Torque(torque)) | AxisCommand::Seek(Setpoint::Torque(torque))
                if state.following =>
            {
                let sense = if self.backwards { -1.0 } else { 1.0 };
                let torque = sense * torque.get();
                let kept = state.switches.lower_limit && torque < 0.0 || state.switches.upper_limit && torque > 0.0;
                let torque = if self.guards && kept { -self.spin * INERTIA / BRAKING_TIME } else { torque };
                self.spin = if self.blocked { 0.0 } else { self.spin + (torque + self.load) / INERTIA * dt };
                state.position += self.spin * dt;
            }
            AxisCommand::Follow(Setpoint::Position(position)) | AxisCommand::Seek(Setpoint::Position(position))
                if state.following =>
            {
                let target = self.target.replace(position.get());
                let position = if self.lags { target.unwrap_or(state.position) } else { position.get() };
                if !self.blocked {
                    state.position = position;
                }
            }
            _ => self.target = None,
        }
        if let Some(speed) = self.runs_at.filter(|_| on) {
            state.position = before + speed * dt;
        }
        if !homes {
            self.homing = 0;
            if state.homing == Homing::InProgress {
                state.homing = Homing::NotHomed;
            }
        }
        let before_jump = state.position;
        let passed = before.min(state.position)..before.max(state.position);
        if matches!(self.pending, AxisCommand::Seek(_)) && passed.contains(&self.index) {
            state.homing = Homing::Attained;
            state.position -= self.index;
            // The switches keep their physical positions.
            for at in [&mut self.home_below, &mut self.limit_below] {
                *at = at.map(|at| at - self.index);
            }
            let home = &mut self.home_between;
            *home = home.map(|(from, to)| (from - self.index, to - self.index));
        }
        let closed = |below: Option<f64>| below.is_some_and(|below| state.position < below);
        let within = |(from, to)| (from..to).contains(&state.position);
        state.switches.home = closed(self.home_below) || self.home_between.is_some_and(within);
        if self.chatter > 0 && state.switches.home {
            self.chatter -= 1;
            state.switches.home = self.chatter % 2 == 1;
        }
        state.switches.lower_limit = closed(self.limit_below);
        state.switches.upper_limit = self.limit_above.is_some_and(|above| state.position > above);
        let moved = if state.following { (before_jump - before) / dt } else { 0.0 };
        state.velocity = self.drifts_at.unwrap_or(moved);
        state.increments = Increments((state.position * 1000.0).round() as i32);
        let set = homing != state.homing && state.homing == Homing::Attained;
        if set && self.at_index == AtIndex::Mute {
            self.mute = 3;
        }
        self.mute = self.mute.saturating_sub(1);
        if self.silent || self.mute > 0 {
            self.seen.age += 1;
        } else {
            self.seen = *state;
            self.seen.position = self.frozen.unwrap_or(state.position) + self.ahead;
            self.seen.increments.0 += (self.ahead * 1000.0).round() as i32;
            match self.at_index {
                AtIndex::WordLate if set => self.seen.homing = homing,
                AtIndex::CounterLate if set => {
                    self.seen.position += self.index;
                    self.seen.increments.0 += (self.index * 1000.0).round() as i32;
                }
                _ => {}
            }
        }
    }
}

/// The group. The test keeps a handle to its world.
pub struct Scripted {
    world: Arc<Mutex<World>>,
    axes: usize,
    written: Vec<AxisCommand>,
}

pub fn group(axes: usize) -> (Box<dyn DriveGroup>, Arc<Mutex<World>>) {
    let drive = Drive { homing_takes: 10, ..Drive::default() };
    let world = World { axes: vec![drive; axes], log: true, ..World::default() };
    let world = Arc::new(Mutex::new(world));
    let written = vec![AxisCommand::Off; axes];
    (Box::new(Scripted { world: Arc::clone(&world), axes, written }), world)
}

impl Scripted {
    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

impl DriveGroup for Scripted {
    fn axes(&self) -> usize {
        self.axes
    }

    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        let mut world = self.world();
        if world.absent {
            Poll::Ready(Err(NEVER_BOOTED))
        } else if world.coming_up > 0 {
            world.coming_up -= 1;
            Poll::Pending
        } else {
            Poll::Ready(Ok(()))
        }
    }

    fn wait(&mut self, _: Instant) {
        self.world().waited += 1;
    }

    fn read(&mut self, _: Instant, states: &mut [AxisState]) {
        let mut world = self.world();
        let gone = world.gone;
        for (state, drive) in states.iter_mut().zip(&mut world.axes) {
            if gone {
                drive.seen.age += 1;
                drive.seen.fault = Some(FAULT);
            }
            *state = drive.seen;
        }
        if world.shows_power {
            states[1].power = Power::On;
        }
    }

    fn doubt_reference(&mut self, axis: usize) {
        self.world().axes[axis].state.homing = Homing::NotHomed;
    }

    fn emergency_stop(&self) -> Option<EmergencyStop> {
        self.world().emergency
    }

    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        self.written.copy_from_slice(commands);
        let mut world = self.world();
        if world.panics > 0 {
            world.panics -= 1;
            drop(world);
            panic!("scripted");
        }
        if !world.work.is_zero() {
            let done = clock::now() + world.work;
            while clock::now() < done {}
        }
    }

    fn send(&mut self, now: Instant) -> bool {
        let mut world = self.world();
        if world.gone {
            return false;
        }
        if world.refuses > 0 {
            world.refuses -= 1;
            // Without a SYNC there is no answer.
            world.axes.iter_mut().for_each(|drive| drive.seen.age += 1);
            return false;
        }
        for (drive, command) in world.axes.iter_mut().zip(&self.written) {
            drive.state.sampled = now;
            drive.sync(PERIOD.as_secs_f64());
            drive.pending = *command;
        }
        if world.log {
            let batch = self.written.clone();
            world.sent.push(batch);
        }
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters { last_bus_time: Duration::from_micros(300), ..GroupCounters::default() }
    }
}

pub const NEVER_BOOTED: BringUpError = BringUpError::NeverBooted { node: 1, waited: Duration::from_secs(1) };

pub const FAULT: Fault = Fault::Drive { node: 1, code: 0x2310 };
