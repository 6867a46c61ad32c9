//! From the keys of a cell to the configurations of its drive groups and of the servo's axes.

use std::time::Duration;

use drive::Scale;
use drive::axis_controller::{self, Settings, StopBits};
use drive::cia402::{AxisConfig, CyclicMode, GroupConfig, HomingConfig, Identity, NodeId};
use servo::{FeedForward, HomingLeg, HostHoming, HostLoop, Output, PositionLoop, ServoAxisConfig};

use super::{
    Axis, AxisController, Cell, Control, Direction, Drive, DriveControl, Homing, Loop, Parameter,
    Robot, Serial,
};
use controller::robot::Limits;

/// Longest way back from the home switch to the index pulse beside it, rad: five turns of the motor, most of
/// which a switch may be wide.
pub(super) const FARTHEST_INDEX: f64 = 5.0 * std::f64::consts::TAU;

/// Rest between the legs of a search by the host.
const REST: Duration = Duration::from_millis(500);

/// Samples in a row that have to agree on a switch.
const AGREEING: u32 = 3;

/// Longest time from switching an effector's drives on to the last of them following.
pub const ENABLING: Duration = Duration::from_secs(5);

impl Cell {
    /// The servo period.
    pub fn period(&self) -> Duration {
        Duration::from_micros(u64::from(self.period_us))
    }

    /// The names of the drive groups: every CAN bus, then every bundle of serial lines.
    pub fn groups(&self) -> impl Iterator<Item = &str> {
        let buses = self.bus.iter().map(|bus| bus.name.as_str());
        buses.chain(self.serial.iter().map(|serial| serial.name.as_str()))
    }

    /// The axes of drive group `group` of [`groups`](Self::groups) as pairs of robot and axis numbers, in
    /// their order within it.
    pub fn axes_on(&self, group: usize) -> impl Iterator<Item = (usize, usize)> {
        let name = self.groups().nth(group);
        let robots = self.robot.iter().enumerate();
        let axes =
            robots.flat_map(|(robot, value)| (0..value.axis.len()).map(move |axis| (robot, axis)));
        axes.filter(move |&(robot, axis)| Some(self.robot[robot].axis[axis].bus.as_str()) == name)
    }

    /// What the drives of bus `bus` have in common.
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
    /// How its lines are set.
    pub fn settings(&self) -> Settings {
        Settings {
            baud: self.baud,
            stop_bits: StopBits::Two,
        }
    }

    /// Bytes of a cyclic request on one of its lines, and of the answer to it.
    pub fn telegrams(&self) -> (usize, usize) {
        self.protocol.telegrams()
    }

    /// What its axis controllers have in common, at the servo period `period`.
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

impl Axis {
    /// Between motor positions, rad, and the counts of its drive, whose homed counter reads zero at the
    /// motor position `home`, rad.
    pub fn scale(&self, home: f64) -> Scale {
        let reversed = match (&self.drive, &self.controller) {
            (Some(drive), _) => drive.reversed,
            (None, Some(controller)) => controller.reversed,
            (None, None) => false,
        };
        let counts = self.counts_per_revolution() as i32;
        Scale::new(if reversed { -counts } else { counts }, home)
            .expect("a parsed cell has counts and finite home positions")
    }

    /// Quadrature counts per motor revolution.
    pub fn counts_per_revolution(&self) -> u32 {
        match (&self.drive, &self.controller) {
            (Some(drive), _) => drive.counts_per_revolution,
            (None, Some(controller)) => controller.counts_per_revolution,
            (None, None) => unreachable!("{HAS_DRIVE}"),
        }
    }

    /// Its drive on a CAN bus. Not for an axis on a serial line.
    pub fn cia402(&self) -> &Drive {
        self.drive.as_ref().expect(HAS_DRIVE)
    }

    /// Its drive on a CAN bus, homed at the motor position `home`, rad.
    pub fn drive_config(&self, home: f64) -> AxisConfig {
        let drive = self.cia402();
        let parameter = |given: &Parameter| drive::cia402::Parameter {
            index: given.index,
            subindex: given.subindex,
            value: given.value,
            size: given.bytes,
        };
        AxisConfig {
            node: node(self.node),
            identity: Identity {
                vendor: drive.vendor,
                product: drive.product,
                revision: drive.revision,
            },
            mode: match drive.control {
                DriveControl::Position => CyclicMode::Csp,
                DriveControl::Velocity => CyclicMode::Csv,
                DriveControl::Torque => CyclicMode::Cst,
            },
            scale: self.scale(home),
            rated_torque: drive.rated_torque,
            homing: HomingConfig {
                method: self
                    .homing
                    .method
                    .expect("a parsed cell's drives have homing methods"),
                search_speed: self.homing.search_velocity,
                zero_speed: self.homing.zero_velocity,
                acceleration: self.homing.acceleration,
            },
            following_error: self.following_error,
            quick_stop_deceleration: self.max_acceleration,
            configuration: Vec::new(),
            parameters: drive.parameter.iter().map(parameter).collect(),
        }
    }

    /// Its axis controller on a serial line. Not for an axis on a CAN bus.
    pub fn axis_controller(&self) -> &AxisController {
        self.controller.as_ref().expect(HAS_DRIVE)
    }

    /// Its axis controller on a serial line, homed at the motor position `home`, rad.
    pub fn controller_config(&self, home: f64) -> axis_controller::AxisConfig {
        let controller = self.axis_controller();
        let plausible = |given: Option<f64>, otherwise| given.unwrap_or(otherwise);
        axis_controller::AxisConfig {
            address: self.node,
            scale: self.scale(home),
            torque_constant: controller.torque_constant,
            control: controller.control,
            max_current: controller.max_current,
            max_velocity: plausible(controller.plausible_velocity, 4.0 / 3.0 * self.max_velocity),
            max_acceleration: plausible(
                controller.plausible_acceleration,
                20.0 * self.max_acceleration,
            ),
            current_gains: None,
        }
    }

    /// Who closes its position loop, and how; `weighs` tells of a robot whose weight is known.
    pub(super) fn position_loop(&self, weighs: bool) -> PositionLoop {
        let by_host =
            |given: &Loop, output| PositionLoop::Host(given.of(output, self.max_velocity, weighs));
        match (&self.drive, &self.controller) {
            (Some(drive), _) => {
                let output = match drive.control {
                    DriveControl::Position => return PositionLoop::Drive,
                    DriveControl::Velocity => Output::Velocity,
                    DriveControl::Torque => Output::Torque,
                };
                by_host(drive.r#loop.as_ref().expect(HAS_LOOP), output)
            }
            (None, Some(controller)) => {
                let output = match controller.control {
                    Control::Current => Output::Torque,
                    Control::Pwm => Output::Duty,
                };
                by_host(&controller.r#loop, output)
            }
            (None, None) => unreachable!("{HAS_DRIVE}"),
        }
    }
}

impl Robot {
    /// What the servo holds axis `number` to, within the motor's own `limits`, as axis `index_in_group` of drive
    /// group `group`.
    pub fn servo_config(
        &self,
        number: usize,
        group: usize,
        index_in_group: usize,
        limits: Limits,
    ) -> ServoAxisConfig {
        let axis = &self.axis[number];
        ServoAxisConfig {
            group,
            index_in_group,
            min_position: axis.min_position.unwrap_or(limits.low),
            max_position: axis.max_position.unwrap_or(limits.high),
            max_velocity: axis.max_velocity,
            max_acceleration: axis.max_acceleration,
            following_error: axis.following_error,
            homing_order: axis.homing.order,
            increments_per_radian: axis.scale(0.0).increments_per_radian(),
            position_loop: axis.position_loop(self.weight.is_some()),
            torque_offset: None,
            homing: axis
                .controller
                .as_ref()
                .map(|_| axis.homing.by_host(limits)),
        }
    }
}

impl Loop {
    fn of(&self, output: Output, max_velocity: f64, weighs: bool) -> HostLoop {
        let Loop {
            law,
            feed_forward,
            runaway_velocity,
        } = *self;
        HostLoop {
            law,
            output,
            feed_forward: FeedForward {
                weight: match output {
                    _ if !weighs => None,
                    Output::Torque => Some(feed_forward.weight.unwrap_or(1.0)),
                    Output::Velocity | Output::Duty => feed_forward.weight,
                },
                ..feed_forward
            },
            runaway_velocity: runaway_velocity.unwrap_or(1.2 * max_velocity),
        }
    }
}

impl Homing {
    /// The search that the host makes on a motor with these `limits`.
    fn by_host(&self, limits: Limits) -> HostHoming {
        let leg = |velocity: f64, distance: f64| HomingLeg {
            velocity,
            distance,
            // Its ramps, and as much again for a loop that lags.
            timeout: Duration::try_from_secs_f64(2.0 * distance / velocity + 2.0)
                .unwrap_or(Duration::MAX),
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

const HAS_LOOP: &str = "a parsed cell's drives by velocity or torque have a loop";

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).expect("a parsed cell has valid node-IDs")
}
