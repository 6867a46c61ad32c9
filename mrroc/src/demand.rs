//! Torque that a rehearsed task needs of the motors, compared with the limits of drives and motors.
//!
//! The rehearsal gives position, velocity and acceleration of each motor. The emulated mechanism gives weight and
//! inertia at the motor in this pose, with the heaviest emulated payload. The tip of a tool that is commanded into a
//! plane or a block of the scene is pushed out by stiffness times depth.
//!
//! Masses of links, inertias, friction, and the limits of drives without `max_torque` are nominal. If the demand
//! exceeds a limit by such numbers, the result is a warning. A refusal needs numbers that the user gave: a payload that
//! hangs on the robot all the time, or a body, that alone needs [`REFUSED_FROM`] times a limit from the cell file.
//!
//! Left out: homing, damping and friction of bodies, contacts of anything but the tip, and contacts of robots that may
//! feel them. These are the robots of a task outside the cell file with a force sensor, a force law or a touch probe.

use std::fmt;
use std::time::Duration;

use controller::generator::Axes;
use hil::Mechanism;
use hil::plant::{Load, MotorConfig, PlantConfig};
use nalgebra::Vector3;
use servo::{MAX_AXES, Phase, Snapshot};

use crate::bench::plants;
use crate::cell::{CellFile, EmulatedPayload, Path};
use crate::lag::{self, Lag};

/// Share of a limit of the cell file from which numbers of the user are refused.
pub(crate) const REFUSED_FROM: f64 = 1.1;

/// Motor displacement for the numerical derivative of the place of the tip, rad.
const STEP: f64 = 1e-3;

/// The origin of the part of a demand that the user gave.
#[derive(Clone, Debug, PartialEq)]
enum Cause {
    Payload,
    /// A plane or a block: its list and its index.
    Body(&'static str, usize),
}

/// Torques, N·m, that an axis needs at one moment of a task.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Demand {
    robot: usize,
    axis: usize,
    needed: f64,
    weight: f64,
    inertia: f64,
    contact: f64,
    limit: f64,
    /// Whether the cell file has the limit.
    limit_given: bool,
    /// Time since the start of the rehearsal.
    at: Duration,
    /// The greatest part by numbers of the user, and its origin.
    given: f64,
    cause: Option<Cause>,
}

impl Demand {
    fn share(&self) -> f64 {
        (self.needed / self.limit).abs()
    }

    fn is_refused(&self) -> bool {
        let given = (self.given / self.limit).abs();
        self.limit_given && self.cause.is_some() && given.min(self.share()) >= REFUSED_FROM
    }
}

impl fmt::Display for Demand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, limit, .. } = self;
        // Parts that act against the whole are negative.
        let [needed, weight, inertia, contact] =
            [self.needed, self.weight, self.inertia, self.contact].map(|it| it * self.needed.signum());
        let at = self.at.as_secs_f64();
        write!(
            f,
            "axis {axis} needs {needed:.2} N·m at {at:.1} s of the task: weight {weight:.2}, inertia {inertia:.2}"
        )?;
        if let (Some(Cause::Body(kind, number)), true) = (&self.cause, contact != 0.0) {
            write!(f, ", contact with scene.{kind}[{number}] {contact:.2}")?;
        }
        let origin = if self.limit_given { "the cell file" } else { "the nominal drive" };
        write!(f, "; the limit of {origin} is {limit:.2} N·m")
    }
}

/// One motor: its limit and its friction.
struct Motor {
    config: MotorConfig,
    limit: f64,
    limit_given: bool,
}

/// A plane or a block that the tip of a robot is inside of.
struct Contact {
    cause: Cause,
    /// Torque of each motor that keeps the tip inside, N·m.
    torques: Axes,
}

/// The demand of one robot.
pub(crate) struct RobotDemand {
    robot: usize,
    /// `None` for the regression model, which has no weight.
    motors: Vec<Option<Motor>>,
    /// The mechanism with its payload, and without.
    mechanisms: Option<(Mechanism, Mechanism)>,
    /// Whether the payload hangs on the robot from the start to the end.
    constant_payload: bool,
    /// Radius of the tip, m, if its contacts are judged.
    tip: Option<f64>,
    /// Velocities of the last cycle, rad/s, and the greatest accelerations since the last evaluation, rad/s².
    last: Option<Axes>,
    accelerations: Axes,
    cycles: u32,
    worst: [Option<Demand>; MAX_AXES],
    refused: Option<Demand>,
    /// Greatest velocities of the motors, rad/s, and greatest weights at the motors, N·m.
    fastest: Axes,
    heaviest: Axes,
}

impl RobotDemand {
    /// The demand of robot `robot`. `of_file`: the task is the program of the cell file.
    pub(crate) fn of(file: &CellFile, robot: usize, of_file: bool) -> Self {
        let (cell, given) = (&file.cell, &file.cell.robot[robot]);
        let motor = |number: usize| {
            let plant = plants::plant(file, robot, number);
            let axis = &given.axis[number];
            let torque_constant = plant.plant.torque_constant();
            let stated = match (&axis.drive, &axis.controller) {
                (Some(drive), _) => drive.max_torque,
                (None, controller) => controller.as_ref().map(|it| it.max_current * it.torque_constant),
            };
            let limit = stated.unwrap_or(plant.amplifier.max_current * torque_constant);
            match plant.plant {
                PlantConfig::Physical(config) => Some(Motor { config, limit, limit_given: stated.is_some() }),
                PlantConfig::Wut(_) => None,
            }
        };
        let heaviest = given.emulated_payload.iter().max_by(|a, b| a.mass.total_cmp(&b.mass));
        let mechanism = |payload: Option<&EmulatedPayload>| {
            let mechanism = Mechanism::new(given.numbers().mechanism()?);
            let homes = file.arms[robot].robot().home();
            for number in 0..given.axis.len() {
                mechanism.mount(number, homes[number])?;
            }
            if let Some(payload) = payload {
                mechanism.set_payload(payload.mass, payload.centre);
            }
            Some(mechanism)
        };
        let scene = cell.scene.as_ref();
        let feels = cell.force_sensor.iter().any(|sensor| sensor.robot == given.name)
            || scene.is_some_and(|it| !it.touch_probe.is_empty() && it.robot.as_ref() == Some(&given.name));
        let tip = scene.and_then(|scene| scene.tips().find(|(name, _)| *name == given.name));
        Self {
            robot,
            motors: (0..given.axis.len()).map(motor).collect(),
            mechanisms: mechanism(heaviest).zip(mechanism(None)),
            constant_payload: matches!(&given.emulated_payload[..], [payload] if payload.at_s == 0.0),
            tip: tip.map(|(_, radius)| radius).filter(|_| of_file || !feels),
            last: None,
            accelerations: [0.0; MAX_AXES],
            cycles: 0,
            worst: Default::default(),
            refused: None,
            fastest: [0.0; MAX_AXES],
            heaviest: [0.0; MAX_AXES],
        }
    }

    /// Takes the commands of a cycle, `at` after the start. `dt`: period, s.
    pub(crate) fn observe(&mut self, file: &CellFile, snapshot: &Snapshot, at: Duration, dt: f64) {
        let follows = matches!(snapshot.phase, Phase::Standing | Phase::Moving) && snapshot.homed;
        if !follows {
            (self.last, self.cycles) = (None, 0);
            return;
        }
        let velocities = snapshot.commanded_velocity;
        for (greatest, velocity) in self.fastest.iter_mut().zip(velocities) {
            *greatest = greatest.max(velocity.abs());
        }
        let last = self.last.replace(velocities).unwrap_or(velocities);
        for ((greatest, now), last) in self.accelerations.iter_mut().zip(velocities).zip(last) {
            let acceleration = (now - last) / dt;
            if acceleration.abs() > greatest.abs() {
                *greatest = acceleration;
            }
        }
        self.cycles += 1;
        if self.cycles >= u32::from(file.cell.macrostep) {
            self.cycles = 0;
            let accelerations = std::mem::take(&mut self.accelerations);
            self.evaluate(file, snapshot, &accelerations, at);
        }
    }

    fn evaluate(&mut self, file: &CellFile, snapshot: &Snapshot, accelerations: &Axes, at: Duration) {
        let motors = &snapshot.commanded;
        let loads = self.mechanisms.as_ref().map(|(laden, bare)| (laden.loads_at(motors), bare.loads_at(motors)));
        let contact = self.contact(file, motors);
        for (axis, motor) in self.motors.iter().enumerate() {
            let Some(Motor { config, limit, limit_given }) = motor else { continue };
            let (laden, bare) = match &loads {
                Some((laden, bare)) => (laden[axis], bare[axis]),
                None => {
                    let own = Load { torque: config.gravity.torque(motors[axis]), inertia: config.inertia };
                    (own, own)
                }
            };
            let (velocity, acceleration) = (snapshot.commanded_velocity[axis], accelerations[axis]);
            let (weight, inertia) = (-laden.torque, laden.inertia * acceleration);
            let heaviest = &mut self.heaviest[axis];
            *heaviest = heaviest.max(weight.abs());
            let dry = if velocity == 0.0 { 0.0 } else { config.friction.coulomb.copysign(velocity) };
            let pushed = contact.as_ref().map_or(0.0, |contact| contact.torques[axis]);
            let payload = bare.torque - laden.torque + (laden.inertia - bare.inertia) * acceleration;
            let payload = if self.constant_payload { payload } else { 0.0 };
            let (given, cause) = match &contact {
                Some(contact) if pushed.abs() >= payload.abs() => (pushed, Some(contact.cause.clone())),
                _ => (payload, self.constant_payload.then_some(Cause::Payload)),
            };
            let demand = Demand {
                robot: self.robot,
                axis,
                needed: weight + inertia + config.viscous * velocity + dry + pushed,
                weight,
                inertia,
                contact: pushed,
                limit: *limit,
                limit_given: *limit_given,
                at,
                given,
                cause,
            };
            if demand.is_refused() && self.refused.is_none() {
                self.refused = Some(demand.clone());
            }
            let worst = &mut self.worst[axis];
            if demand.share() > worst.as_ref().map_or(1.0, Demand::share) {
                *worst = Some(demand);
            }
        }
    }

    /// The contact of the tip, with the motors at these positions, rad.
    fn contact(&self, file: &CellFile, motors: &Axes) -> Option<Contact> {
        let radius = self.tip?;
        let scene = file.cell.scene.as_ref()?;
        let arm = &file.arms[self.robot];
        let cell_from_base = file.cell.robot[self.robot].cell_from_base();
        let place = |motors: &Axes| {
            let joints = arm.joints(motors).ok()?;
            Some((cell_from_base * arm.forward(&joints).ok()?).translation.vector)
        };
        let tip = place(motors)?;
        let planes = scene.plane.iter().enumerate().map(|(number, plane)| {
            let normal = Vector3::from(plane.normal).normalize();
            (Cause::Body("plane", number), normal, plane.height - normal.dot(&tip) + radius, plane.stiffness)
        });
        let blocks = scene.block.iter().enumerate().map(|(number, block)| {
            let from_centre = tip - Vector3::from(block.centre);
            // The face that is nearest to the tip pushes it out.
            let depth = |axis: usize| 0.5 * block.size[axis] + radius - from_centre[axis].abs();
            let nearest = (0..3).min_by(|a, b| depth(*a).total_cmp(&depth(*b))).unwrap_or_default();
            let mut normal = Vector3::zeros();
            normal[nearest] = 1.0_f64.copysign(from_centre[nearest]);
            (Cause::Body("block", number), normal, depth(nearest), block.stiffness)
        });
        let touched = planes.chain(blocks).filter(|(_, _, depth, _)| *depth > 0.0);
        let (cause, normal, depth, stiffness) = touched.max_by(|a, b| (a.2 * a.3).total_cmp(&(b.2 * b.3)))?;
        let force = stiffness * depth;
        let mut torques = [0.0; MAX_AXES];
        for (axis, torque) in torques.iter_mut().enumerate().take(self.motors.len()) {
            let at = |step: f64| {
                let mut moved = *motors;
                moved[axis] += step;
                place(&moved)
            };
            // Principle of virtual work. A motor at the end of its range has one side only.
            let (ahead, behind) = (at(STEP).unwrap_or(tip), at(-STEP).unwrap_or(tip));
            *torque = -force * normal.dot(&(ahead - behind)) / (2.0 * STEP);
        }
        Some(Contact { cause, torques })
    }

    /// The axes that may lag behind their set-points.
    pub(crate) fn lags(&self, file: &CellFile) -> Vec<Lag> {
        lag::of(file, self.robot, &self.fastest, &self.heaviest)
    }

    /// What exceeds a limit: a demand to refuse, and the greatest demand of each axis.
    pub(crate) fn found(self) -> (Option<Demand>, Vec<Demand>) {
        (self.refused, self.worst.into_iter().flatten().collect())
    }
}

/// The warnings of a rehearsed task, or the refusal by numbers that the user gave.
pub(crate) fn judge(file: &CellFile, refused: Option<&Demand>, worst: &[Demand]) -> anyhow::Result<Vec<String>> {
    if let Some(demand) = refused {
        let key = match demand.cause {
            Some(Cause::Body(kind, number)) => Path::to("scene").then(kind).then(number),
            Some(Cause::Payload) | None => {
                Path::to("robot").then(demand.robot).then("emulated_payload").then(0).then("mass")
            }
        };
        let robot = &file.cell.robot[demand.robot];
        let text = robot.naming_axes(format!("{demand}, of which this needs {:.2} N·m", demand.given.abs()));
        return Err(file.refuse(&key, format!("robot {}: {text}", robot.name)));
    }
    let warning = |demand: &Demand| {
        let robot = &file.cell.robot[demand.robot];
        let text = robot.naming_axes(demand);
        format!(
            "robot {}: {text}. The axis may be overloaded: reduce acceleration or load, or correct the limit",
            robot.name
        )
    };
    Ok(worst.iter().map(warning).collect())
}
