//! From a cell to the motors, sensors and switches behind its emulated drives, and to the mechanics between them.

use std::collections::VecDeque;
use std::time::Duration;

use crate::cell::{Model, Parameters, Plant};
use can::Instant;
use hil::plant::Switch;
use hil::{AxisConfig, Irp6Axis, Irp6TrackAxis, Mechanism, MechanismConfig, Mount};

use crate::cell_file::CellFile;

/// The mechanism of each robot of a cell that has one, whatever buses and lines its axes are on.
pub struct Mechanisms(Vec<Option<Mechanism>>);

impl Mechanisms {
    /// All at home and without payloads.
    pub fn of(file: &CellFile) -> Self {
        let robots = file.cell.robot.iter();
        let config = |robot: &crate::cell::Robot| {
            let parameters = robot.parameters.unwrap_or(robot.model.parameters());
            Some(Mechanism::new(match parameters {
                Parameters::Irb6(_) => MechanismConfig::Irb6,
                Parameters::Irp6(_) => MechanismConfig::Irp6,
                Parameters::Irp6Track(_) => MechanismConfig::Irp6OnTrack,
                Parameters::Rnt(rnt) => MechanismConfig::Rnt {
                    home_lengths: rnt.legs.map(|leg| leg.length_at_home),
                },
                Parameters::Polycrank(polycrank) => MechanismConfig::Polycrank {
                    coupled: polycrank.coupled,
                    at_home: polycrank.axes.map(|axis| axis.joint_at_home),
                },
                Parameters::Gripper(_) | Parameters::Conveyor(_) => return None,
            }))
        };
        Self(robots.map(config).collect())
    }

    /// The place of an axis in its robot; `None` if it moves a load of its own.
    pub fn mount(&self, file: &CellFile, robot: usize, number: usize) -> Option<Mount> {
        let home = file.arms[robot].robot().home()[number];
        self.0[robot].as_ref()?.mount(number, home)
    }
}

/// The payloads that the robots of a cell take over as time passes.
pub struct Payloads(VecDeque<Payload>);

struct Payload {
    due: Instant,
    mechanism: Mechanism,
    mass: f64,
    centre: [f64; 3],
}

impl Payloads {
    /// Those of a cell whose drives are switched on at `power_on`.
    pub fn of(file: &CellFile, mechanisms: &Mechanisms, power_on: Instant) -> Self {
        let robots = file.cell.robot.iter().zip(&mechanisms.0);
        let payloads = robots.filter_map(|(robot, mechanism)| Some((robot, mechanism.as_ref()?)));
        let payloads = payloads.flat_map(|(robot, mechanism)| {
            robot.emulated_payload.iter().map(|payload| Payload {
                due: power_on + Duration::from_secs_f64(payload.at_s),
                mechanism: mechanism.clone(),
                mass: payload.mass,
                centre: payload.centre,
            })
        });
        let mut payloads: Vec<_> = payloads.collect();
        payloads.sort_by_key(|payload| payload.due);
        Self(payloads.into())
    }

    /// When the next is due.
    pub fn next(&self) -> Option<Instant> {
        self.0.front().map(|payload| payload.due)
    }

    /// Hands the robots those that are due.
    pub fn take_over(&mut self, now: Instant) {
        while self.next().is_some_and(|due| due <= now) {
            if let Some(payload) = self.0.pop_front() {
                payload.mechanism.set_payload(payload.mass, payload.centre);
            }
        }
    }
}

/// Motor, load, sensors and switches of an axis.
pub fn plant(file: &CellFile, robot: usize, number: usize) -> AxisConfig {
    let axis = &file.cell.robot[robot].axis[number];
    let home = file.arms[robot].robot().home()[number];
    let preset = match file.cell.robot[robot].model {
        Model::Irb6 | Model::Irp6 | Model::Irp6Calibrated => {
            return arm_plant(file, robot, number);
        }
        Model::Irp6Track | Model::Irp6TrackCalibrated => {
            AxisConfig::irp6_track(Irp6TrackAxis::ALL[number])
        }
        Model::Rnt => AxisConfig::rnt(number).expect(AS_MANY),
        Model::Polycrank => AxisConfig::polycrank(number).expect(AS_MANY),
        Model::Gripper => AxisConfig::gripper(),
        Model::Conveyor => AxisConfig::conveyor(),
    };
    let preset = preset.with_home(home);
    AxisConfig {
        counts_per_revolution: axis.counts_per_revolution(),
        start_angle: axis.emulator.start.unwrap_or(preset.start_angle),
        ..preset
    }
}

const AS_MANY: &str = "a parsed robot has as many axes as its model";

/// The same of an arm on its pedestal.
fn arm_plant(file: &CellFile, robot: usize, number: usize) -> AxisConfig {
    let axis = &file.cell.robot[robot].axis[number];
    let home = file.arms[robot].robot().home()[number];
    let limits = file.arms[robot].robot().motor_limits()[number];
    let kind = Irp6Axis::ALL[number];
    let preset = match axis.emulator.plant {
        Plant::Physical => AxisConfig::irp6(kind),
        Plant::Wut => AxisConfig::wut(kind),
    };
    let switch = |from, to| {
        Some(Switch {
            from,
            to,
            bounce: 0,
        })
    };
    AxisConfig {
        counts_per_revolution: axis.counts_per_revolution(),
        index_angle: home,
        start_angle: axis.emulator.start.unwrap_or(home + 20.0),
        home_switch: switch(home - 20.0, home - 2.0),
        negative_limit: switch(f64::NEG_INFINITY, limits.low),
        positive_limit: switch(limits.high, f64::INFINITY),
        ..preset
    }
}
