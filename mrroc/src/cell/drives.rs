//! Configurations of drive groups and servo axes, made from the keys of a cell.

use std::time::Duration;

use drive::Scale;
use drive::axis_controller::{self, Settings, StopBits};
use drive::cia402::{self, AxisConfig, CyclicMode, GroupConfig, HomingConfig, Identity, NodeId, Purpose, Setting};
use servo::{
    FeedForward, FrozenWatch, HomingLeg, HostHoming, HostLoop, Law, LoopPlant, Output, PositionLoop, ServoAxisConfig,
};

use super::{
    Axis, AxisController, Cell, Control, Direction, Drive, DriveControl, Homing, Loop, Parameter, Robot, Serial,
};
use canopen::{Object, objects};
use controller::robot::{Limits, MotorRating};

/// Longest way back from the home switch to its index pulse, rad: five turns of the motor. A switch may take up most
/// of this way.
pub(super) const FARTHEST_INDEX: f64 = 5.0 * std::f64::consts::TAU;

/// Pause between the phases of a search by the host.
const REST: Duration = Duration::from_millis(500);

/// Number of samples in a row that must agree on the state of a switch.
const AGREEING: u32 = 3;

/// Default velocity of a runaway loop, as a multiple of the greatest velocity of the axis.
const RUNAWAY: f64 = 1.2;

/// Plausibility bound of the velocity of a motor on a CAN bus, as a multiple of the velocity of a runaway loop.
const PLAUSIBLE: f64 = 2.0;

/// Default plausibility bound of the acceleration of a motor, as a multiple of the greatest acceleration of the axis.
const PLAUSIBLE_ACCELERATION: f64 = 20.0;

/// Default time within which a drive shows that it searches for its reference.
const SEARCH_START: Duration = Duration::from_secs(1);

/// Longest time from switching on an effector's drives until the last one follows.
pub const ENABLING: Duration = Duration::from_secs(5);

impl Cell {
    /// The servo period.
    pub fn period(&self) -> Duration {
        Duration::from_micros(u64::from(self.period_us))
    }

    /// The names of the drive groups: every CAN bus, then every bundle of serial lines, every force sensor on a serial
    /// line, and every ultrasonic matrix.
    pub fn groups(&self) -> impl Iterator<Item = &str> {
        let buses = self.bus.iter().map(|bus| bus.name.as_str());
        let bundles = self.serial.iter().map(|serial| serial.name.as_str());
        let sensors = self.serial_sensors().map(|sensor| self.force_sensor[sensor].name.as_str());
        let matrices = self.ultrasonic.iter().map(|matrix| matrix.name.as_str());
        buses.chain(bundles).chain(sensors).chain(matrices)
    }

    /// The axes of drive group `group` of [`groups`](Self::groups), as pairs of robot and axis number, in their order
    /// within the group.
    pub fn axes_on(&self, group: usize) -> impl Iterator<Item = (usize, usize)> {
        let name = self.groups().nth(group);
        let robots = self.robot.iter().enumerate();
        let axes = robots.flat_map(|(robot, value)| (0..value.axis.len()).map(move |axis| (robot, axis)));
        axes.filter(move |&(robot, axis)| Some(self.robot[robot].axis[axis].bus.as_str()) == name)
    }

    /// Settings common to the drives of bus `bus`.
    pub fn group_config(&self, bus: usize) -> GroupConfig {
        let bus = &self.bus[bus];
        let milliseconds = |count: u32| Duration::from_millis(u64::from(count));
        GroupConfig {
            period: self.period(),
            tolerated_missing: bus.tolerated_missing,
            heartbeat_period: milliseconds(u32::from(bus.heartbeat_ms)),
            host_node: node(bus.host_node),
            sdo_timeout: milliseconds(bus.sdo_timeout_ms),
            sdo_retries: 2,
            boot_timeout: milliseconds(bus.boot_timeout_ms),
            transition_timeout: ENABLING,
        }
    }
}

impl Serial {
    /// Settings of the serial lines.
    pub fn settings(&self) -> Settings {
        Settings { baud: self.baud, stop_bits: StopBits::Two }
    }

    /// Settings common to the axis controllers, at the servo period `period`.
    pub fn group_config(&self, period: Duration) -> axis_controller::GroupConfig {
        axis_controller::GroupConfig {
            period,
            settings: self.settings(),
            tolerated_missing: self.tolerated_missing,
            answer_timeout: Duration::from_millis(u64::from(self.answer_timeout_ms)),
            ..axis_controller::GroupConfig::new(self.protocol)
        }
    }
}

impl Parameter {
    pub(super) fn setting(&self) -> Setting {
        let data = self.value.to_le_bytes().into_iter().take(self.bytes.into()).collect();
        Setting { object: Object::new(self.index, self.subindex), data, readable: true, purpose: Purpose::Write }
    }
}

impl Drive {
    /// Torque that the drive can ask of its motor, N·m.
    fn max_torque(&self) -> f64 {
        let Object { index, subindex } = objects::MAX_TORQUE;
        let given = self.parameter.iter().rev().find(|it| (it.index, it.subindex) == (index, subindex));
        self.rated_torque * given.map_or(1.0, |it| f64::from(it.value) / 1000.0)
    }
}

impl Axis {
    /// Scale between motor positions, rad, and the counts of the drive. The homed counter reads zero at the motor
    /// position `home`, rad.
    pub fn scale(&self, home: f64) -> Scale {
        let (counts, reversed) = self.counts();
        let counts = counts as i32;
        Scale::new(if reversed { -counts } else { counts }, home)
            .expect("a parsed cell has counts and finite home positions")
    }

    /// Quadrature counts per motor revolution.
    pub fn counts_per_revolution(&self) -> u32 {
        self.counts().0
    }

    /// Quadrature counts per motor revolution, and whether the counter falls in the motor's positive direction.
    fn counts(&self) -> (u32, bool) {
        match (&self.drive, &self.controller) {
            (Some(drive), _) => (drive.counts_per_revolution, drive.reversed),
            (None, Some(controller)) => (controller.counts_per_revolution, controller.reversed),
            (None, None) => unreachable!("{HAS_DRIVE}"),
        }
    }

    /// What the motor can do in this cell: its `max_velocity`, and the torque at the `max_current` of an axis controller.
    /// The torque of a drive is its maximum torque (0x6072) if the table `parameter` sets it, else its rated torque.
    pub fn motor_rating(&self) -> MotorRating {
        let torque = match (&self.drive, &self.controller) {
            (Some(drive), _) => drive.max_torque(),
            (None, Some(controller)) => controller.max_current * controller.torque_constant,
            (None, None) => unreachable!("{HAS_DRIVE}"),
        };
        MotorRating { velocity: self.max_velocity, torque }
    }

    /// The drive on a CAN bus. Not for an axis on a serial line.
    pub fn cia402(&self) -> &Drive {
        self.drive.as_ref().expect(HAS_DRIVE)
    }

    /// Configuration of the drive on a CAN bus without its device configuration file, homed at the motor position
    /// `home`, rad.
    pub fn drive_config(&self, home: f64) -> AxisConfig {
        let drive = self.cia402();
        AxisConfig {
            node: node(self.node),
            identity: Identity { vendor: drive.vendor, product: drive.product, revision: drive.revision },
            mode: match drive.control {
                DriveControl::Position => CyclicMode::Csp,
                DriveControl::Velocity => CyclicMode::Csv,
                DriveControl::Torque => CyclicMode::Cst,
            },
            scale: self.scale(home),
            rated_torque: drive.rated_torque,
            homing: HomingConfig {
                method: self.homing.method.expect(HAS_METHOD),
                search_speed: self.homing.search_velocity,
                zero_speed: self.homing.zero_velocity,
                acceleration: self.homing.acceleration,
                start_timeout: self.homing.start_timeout(),
            },
            plausible_velocity: PLAUSIBLE * self.runaway_velocity(),
            plausible_acceleration: drive
                .plausible_acceleration
                .unwrap_or(PLAUSIBLE_ACCELERATION * self.max_acceleration),
            following_error: self.following_error,
            quick_stop_deceleration: self.max_acceleration,
            emergency_input: drive.emergency_stop.as_ref().map(|contact| contact.input),
            position_range: None,
            configuration: drive.parameter.iter().map(Parameter::setting).collect(),
        }
    }

    /// Motor velocity, rad/s, beyond which a position loop closed by the host counts as a runaway loop. The same bound
    /// applies to a drive that closes its own loop.
    pub(super) fn runaway_velocity(&self) -> f64 {
        self.host_loop().and_then(|(_, given, _)| given.runaway_velocity).unwrap_or(RUNAWAY * self.max_velocity)
    }

    /// The axis controller on a serial line. Not for an axis on a CAN bus.
    pub fn axis_controller(&self) -> &AxisController {
        self.controller.as_ref().expect(HAS_DRIVE)
    }

    /// Configuration of the axis controller on a serial line, homed at the motor position `home`, rad.
    pub fn controller_config(&self, home: f64) -> axis_controller::AxisConfig {
        let controller = self.axis_controller();
        axis_controller::AxisConfig {
            address: self.node,
            scale: self.scale(home),
            torque_constant: controller.torque_constant,
            control: controller.control,
            max_current: controller.max_current,
            max_velocity: controller.plausible_velocity.unwrap_or(4.0 / 3.0 * self.max_velocity),
            max_acceleration: controller
                .plausible_acceleration
                .unwrap_or(PLAUSIBLE_ACCELERATION * self.max_acceleration),
        }
    }

    /// The loop that the host closes with its output, behind the key of the table with the loop; `None` if the drive
    /// closes the position loop.
    pub(super) fn host_loop(&self) -> Option<(&'static str, &Loop, Output)> {
        match (&self.drive, &self.controller) {
            (Some(drive), _) => {
                let output = match drive.control {
                    DriveControl::Position => return None,
                    DriveControl::Velocity => Output::Velocity,
                    DriveControl::Torque => Output::Torque,
                };
                Some(("drive", drive.r#loop.as_ref().expect(HAS_LOOP), output))
            }
            (None, Some(controller)) => {
                let output = match controller.control {
                    Control::Current => Output::Torque,
                    Control::Pwm => Output::Duty,
                };
                Some(("controller", &controller.r#loop, output))
            }
            (None, None) => unreachable!("{HAS_DRIVE}"),
        }
    }

    /// The linear loop of the host, its law and its output. `None` if the drive closes the loop.
    pub(crate) fn loop_plant(&self, period: Duration) -> Option<(LoopPlant, Law, Output)> {
        let (_, given, output) = self.host_loop()?;
        let delay = if self.drive.is_some() { cia402::DELAY } else { axis_controller::DELAY };
        Some((LoopPlant::new(period, delay, &given.law, &given.feed_forward), given.law, output))
    }

    /// A search for a mechanical stop (methods -1 to -4) ends with a motor that is held back.
    fn frozen_watch(&self) -> FrozenWatch {
        match self.homing.method {
            _ if !self.frozen_watch => FrozenWatch::Off,
            Some(-4..=-1) => FrozenWatch::Following,
            _ => FrozenWatch::Always,
        }
    }

    /// Position loop of the axis, closed by drive or host. `weighs` is true if the weight of the robot is known.
    pub(super) fn position_loop(&self, weighs: bool) -> PositionLoop {
        let Some((_, given, output)) = self.host_loop() else {
            return PositionLoop::Drive;
        };
        let weight = match output {
            _ if !weighs => None,
            Output::Torque => Some(given.feed_forward.weight.unwrap_or(1.0)),
            Output::Velocity | Output::Duty => given.feed_forward.weight,
        };
        PositionLoop::Host(HostLoop {
            law: given.law,
            output,
            feed_forward: FeedForward { weight, ..given.feed_forward },
            runaway_velocity: self.runaway_velocity(),
        })
    }
}

impl Robot {
    /// Servo configuration of axis `number`, within the `limits` of its motor. The axis is axis `index_in_group` of
    /// drive group `group`.
    pub fn servo_config(&self, number: usize, group: usize, index_in_group: usize, limits: Limits) -> ServoAxisConfig {
        let axis = &self.axis[number];
        ServoAxisConfig {
            group,
            index_in_group,
            min_position: axis.min_position.unwrap_or(limits.low),
            max_position: axis.max_position.unwrap_or(limits.high),
            max_velocity: axis.max_velocity,
            max_acceleration: axis.max_acceleration,
            planned_jerk: axis.planned_jerk(),
            following_error: axis.following_error,
            homing_order: axis.homing.order,
            increments_per_radian: axis.scale(0.0).increments_per_radian(),
            position_loop: axis.position_loop(self.weight.is_some()),
            torque_offset: None,
            homing: axis.controller.is_some().then(|| axis.homing.by_host(limits)),
            frozen: axis.frozen_watch(),
            brake_watch: axis.brake,
        }
    }
}

impl Homing {
    /// Longest time from the start of homing until a drive shows that it searches.
    pub(super) fn start_timeout(&self) -> Duration {
        self.start_timeout_ms.map_or(SEARCH_START, |given| Duration::from_millis(u64::from(given)))
    }

    /// The search by the host for a motor with these `limits`.
    fn by_host(&self, limits: Limits) -> HostHoming {
        let leg = |velocity: f64, distance: f64| HomingLeg {
            velocity,
            distance,
            // Twice the ideal time for ramps and for a loop that lags.
            timeout: Duration::try_from_secs_f64(2.0 * distance / velocity + 2.0).unwrap_or(Duration::MAX),
        };
        HostHoming {
            direction: self.direction.unwrap_or(Direction::Negative),
            search: leg(self.search_velocity, limits.high - limits.low),
            zero: leg(self.zero_velocity, FARTHEST_INDEX),
            acceleration: self.acceleration,
            pause: REST,
            debounce: AGREEING,
            reverse_at_limit: self.reverse_at_limit.unwrap_or(true),
        }
    }
}

const HAS_DRIVE: &str = "a parsed cell's axes have the drive that their bus needs";
const HAS_METHOD: &str = "a parsed cell's drives have homing methods";
const HAS_LOOP: &str = "a parsed cell's drives by velocity or torque have a loop";

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).expect("a parsed cell has valid node-IDs")
}
