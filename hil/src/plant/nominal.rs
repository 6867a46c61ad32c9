//! A nominal motor, with sensors and switches, that can move any joint.

use std::f64::consts::{PI, TAU};

use thiserror::Error;

use super::axis::{AxisConfig, PlantConfig};
use super::lab::{BUFFER_FREQUENCY, THERMAL};
use super::motor::{EndStops, Gravity, MotorConfig};
use super::{friction::FrictionConfig, switch::Switch};
use crate::amplifier::AmplifierConfig;

/// What a joint demands of its motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NominalJoint {
    /// Motor angle per joint position, rad/rad or rad/m.
    pub ratio: f64,
    /// Greatest inertia of the load at the joint, kg·m² or kg, with all other axes at rest.
    pub inertia: f64,
    /// Greatest velocity of the joint, rad/s or m/s.
    pub velocity: f64,
    /// Greatest effort of the joint, N·m or N.
    pub effort: f64,
    /// Motor angle at home, rad.
    pub home: f64,
    /// Motor angles at the ends of travel, rad. `None` for an endless axis without limit switches.
    pub travel: Option<(f64, f64)>,
}

/// A demand that no motor can meet.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{quantity} is {value}, it must be {bound}")]
pub struct NominalError {
    quantity: &'static str,
    value: f64,
    bound: &'static str,
}

/// Reflected inertia of the load per inertia of the rotor. The drive is tuned for the geometric mean of the rotor alone
/// and the rotor with the load, so every load, in every pose and with any coupling, is within a factor of 2.5.
const LOAD_PER_ROTOR: f64 = 5.0;
/// Least inertia of a rotor, kg·m²: a motor of a few watts.
const LEAST_ROTOR: f64 = 1e-7;
/// Time in which the effort alone brings the rotor to the greatest velocity, s, at least. The loop of a lighter rotor would
/// be too soft for the friction of a motor with this torque.
const LEAST_RISE: f64 = 0.02;
/// Torque of the motor per torque that the joint demands.
const MARGIN: f64 = 1.5;
/// Time from rest to the greatest velocity at the greatest acceleration, s, at least.
const RISE: f64 = 0.05;
/// Current at the greatest torque, A, and winding: resistance, Ω, and inductance, H. The demanded effort heats the
/// winding by less than it bears.
const MAX_CURRENT: f64 = 10.0;
const WINDING: (f64, f64) = (0.6, 0.5e-3);
/// Least supply voltage, V, and part of the supply that remains at the greatest velocity and current.
const SUPPLY: (f64, f64) = (24.0, 1.3);
/// Viscous friction at the greatest velocity, Coulomb and static friction, as parts of the greatest torque.
const FRICTION: (f64, f64, f64) = (0.02, 0.02, 0.03);
/// Holding torque of the brake per greatest torque.
const BRAKE: f64 = 2.0;
/// Least number of counts per motor turn, and least number of counts per rad or m of the joint.
const COUNTS: (u32, f64) = (4096, 40_000.0);

impl NominalJoint {
    /// Inertia of the rotor, kg·m².
    pub fn rotor_inertia(&self) -> f64 {
        let of_torque = LEAST_RISE * self.effort / (self.velocity * self.ratio * self.ratio);
        (self.load_inertia() / LOAD_PER_ROTOR).max(of_torque).max(LEAST_ROTOR)
    }

    /// Inertia of the load at the motor, kg·m².
    fn load_inertia(&self) -> f64 {
        self.inertia / (self.ratio * self.ratio)
    }

    fn check(&self) -> Result<(), NominalError> {
        let positive = [
            ("the magnitude of the ratio", self.ratio.abs()),
            ("the greatest velocity of the joint", self.velocity),
            ("the greatest effort of the joint", self.effort),
        ];
        for (quantity, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(NominalError { quantity, value, bound: "above 0 and finite" });
            }
        }
        if !(self.inertia >= 0.0 && self.inertia.is_finite()) {
            let quantity = "the greatest inertia of the load";
            return Err(NominalError { quantity, value: self.inertia, bound: "0 or above, and finite" });
        }
        if !self.home.is_finite() {
            return Err(NominalError { quantity: "the motor angle at home", value: self.home, bound: "finite" });
        }
        match self.travel {
            Some((low, high)) if !(low < high && low.is_finite() && high.is_finite()) => {
                let quantity = "the positive end of travel";
                Err(NominalError { quantity, value: high, bound: "above the negative end, and both finite" })
            }
            _ => Ok(()),
        }
    }
}

impl AxisConfig {
    /// A motor that can move a joint, with a margin. All numbers are nominal, to be replaced by those of a real motor.
    ///
    /// * The rotor has a fifth of the reflected inertia of the load, and at least the inertia that the effort alone brings to
    ///   the greatest velocity in 20 ms.
    /// * The torque is 1.5 times the effort of the joint and the torque that accelerates the rotor meanwhile. The
    ///   greatest current is 10 A. The supply of at least 24 V leaves 30 % at the greatest velocity.
    /// * The friction is 2 % of the torque (3 % at rest), and another 2 % at the greatest velocity.
    /// * The encoder has 4096 counts per turn, or a larger power of two for at least 40,000 counts per rad or m of the
    ///   joint. The index pulse is at home.
    /// * The home switch is closed over all of the travel below home. Its edge is half a motor turn below home, or 5 % of
    ///   the travel if that is less.
    /// * Limit switches close 1 % of the travel (at most 1 rad) beyond its ends. Buffers begin 3 % (at most 3 rad) beyond
    ///   the ends.
    /// * The brake holds twice the torque. The motor starts above home, by a tenth of the travel and at most 20 rad.
    ///
    /// Without a mechanism the motor moves the greatest inertia of the load, without weight. In a
    /// [`Chain`](super::MechanismConfig::Chain), the rotor is [`NominalJoint::rotor_inertia`].
    pub fn nominal(joint: &NominalJoint) -> Result<Self, NominalError> {
        joint.check()?;
        let ratio = joint.ratio.abs();
        let (rotor, load) = (joint.rotor_inertia(), joint.load_inertia());
        let (velocity, effort) = (joint.velocity * ratio, joint.effort / ratio);
        let torque = MARGIN * (effort + rotor * (velocity / RISE).min(joint.effort * ratio / joint.inertia));
        let torque_constant = torque / MAX_CURRENT;
        let tuned = (rotor * (rotor + load)).sqrt();
        let span = joint.travel.map_or(TAU * ratio, |(low, high)| high - low);
        let beyond = |share: f64, most: f64| (share * span).min(most);
        let per_joint = COUNTS.1 * TAU / ratio;
        let counts = (per_joint.min(f64::from(1 << 20)) as u32).next_power_of_two().max(COUNTS.0);
        let (viscous, coulomb, stiction) = FRICTION;
        let switch = |from, to| Switch { from, to, bounce: 0 };
        Ok(Self {
            plant: PlantConfig::Physical(MotorConfig {
                torque_constant,
                resistance: WINDING.0,
                inductance: WINDING.1,
                inertia: rotor + load,
                viscous: viscous * torque / velocity,
                friction: FrictionConfig {
                    coulomb: coulomb * torque,
                    stiction: stiction * torque,
                    stribeck_velocity: 0.02 * velocity,
                },
                gravity: Gravity::NONE,
                end_stops: joint.travel.map(|(low, high)| EndStops {
                    negative: low - beyond(0.03, 3.0),
                    positive: high + beyond(0.03, 3.0),
                    stiffness: tuned * BUFFER_FREQUENCY * BUFFER_FREQUENCY,
                    damping: tuned * BUFFER_FREQUENCY,
                }),
                thermal: THERMAL,
                torque_ripple: 0.01,
            }),
            amplifier: AmplifierConfig {
                max_current: MAX_CURRENT,
                trip_current: 1.5 * MAX_CURRENT,
                max_voltage: (SUPPLY.1 * (torque_constant * velocity + WINDING.0 * MAX_CURRENT)).max(SUPPLY.0),
                inertia: tuned,
                setpoint_filter: 0.0,
            },
            counts_per_revolution: counts,
            edge_jitter: 0.02,
            index_angle: joint.home,
            start_angle: joint.home
                + joint
                    .travel
                    .map_or(beyond(0.1, 20.0), |(_, high)| beyond(0.1, 20.0).min(0.5 * (high - joint.home)).max(0.0)),
            brake: BRAKE * torque,
            home_switch: Some(switch(f64::NEG_INFINITY, joint.home - beyond(0.05, PI))),
            negative_limit: joint.travel.map(|(low, _)| switch(f64::NEG_INFINITY, low - beyond(0.01, 1.0))),
            positive_limit: joint.travel.map(|(_, high)| switch(high + beyond(0.01, 1.0), f64::INFINITY)),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;
    use std::sync::Arc;

    use super::{AxisConfig, NominalJoint};
    use crate::plant::{
        ChainBodies, ChainBodyJoint, Demand, Gravity, Mechanism, MechanismConfig, PlantAxis, PlantConfig,
    };

    const JOINT: NominalJoint = NominalJoint {
        ratio: 100.0,
        inertia: 2.0,
        velocity: 2.0,
        effort: 50.0,
        home: 10.0,
        travel: Some((-200.0, 300.0)),
    };

    /// A chain of one joint whose load has this inertia, across the plumb line.
    fn chain(joint: &NominalJoint, prismatic: bool, inertia: f64) -> Mechanism {
        let (mass, moment) = if prismatic { (inertia, 0.0) } else { (0.0, inertia) };
        let body = ChainBodyJoint {
            translation: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            axis: if prismatic { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] },
            prismatic,
            mass,
            centre: [0.0; 3],
            inertia: [moment, moment, moment, 0.0, 0.0, 0.0],
            at_home: 0.0,
        };
        let rows = vec![vec![1.0 / joint.ratio]];
        let flange = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
        let rotors = [joint.rotor_inertia()];
        let bodies = ChainBodies::new(&[body], flange, [0.0, 0.0, 1.0], &rows, &rotors).unwrap();
        Mechanism::new(MechanismConfig::Chain(Arc::new(bodies)))
    }

    /// Moves there and back with 0.8 of the velocity and half of the effort, and settles.
    fn settles(joint: &NominalJoint, mechanism: Option<&Mechanism>, text: &str) {
        let config = AxisConfig::nominal(joint).unwrap();
        let mount = mechanism.and_then(|mechanism| mechanism.mount(0, joint.home));
        let mut axis = PlantAxis::mounted(&config, 1, mount.as_ref());
        let scale = f64::from(config.counts_per_revolution) / TAU * joint.ratio;
        let velocity = 0.8 * joint.velocity;
        let rate = 0.5 * joint.effort / joint.inertia / velocity;
        let periods = (TAU / rate / 1e-3) as u32;
        let (mut from, mut widest) = (0.0, 0.0_f64);
        for k in 1..=periods + 500 {
            let phase = (rate * f64::from(k) * 1e-3).min(TAU);
            let to = velocity / rate * (1.0 - phase.cos()) * scale;
            axis.advance(10, Demand::Position { counts: from, velocity: (to - from) / 1e-3 });
            from = to;
            widest = widest.max(((axis.angle() - config.start_angle) / joint.ratio).abs());
            assert_eq!(axis.feedback().trip, None, "{text} at {k} ms");
        }
        assert!(widest > 1.9 * velocity / rate, "{text}: {widest} of {}", 2.0 * velocity / rate);
        let off = (0..200).map(|_| {
            axis.advance(10, Demand::Position { counts: 0.0, velocity: 0.0 });
            ((axis.angle() - config.start_angle) / joint.ratio).abs()
        });
        let off = off.fold(0.0, f64::max);
        let count = (1.0 / scale).abs();
        assert!(off < 1e-4_f64.max(4.0 * count), "{text}: {off} rad or m off, a count is {count}");
    }

    #[test]
    fn axis_settles_at_any_ratio_and_inertia() {
        for ratio in [1.0, -3.0, 10.0, 30.0, -100.0, 300.0] {
            for decade in -5..=2 {
                let inertia = 10_f64.powi(decade);
                let joint = NominalJoint { ratio, inertia, effort: 20.0 * inertia, travel: None, ..JOINT };
                settles(&joint, None, &format!("{joint:?} alone"));
                for prismatic in [false, true] {
                    // The load of a pose, and of another pose with a tenth of the inertia.
                    for share in [1.0, 0.1] {
                        let mechanism = chain(&joint, prismatic, share * inertia);
                        settles(&joint, Some(&mechanism), &format!("{joint:?} of {share}, prismatic: {prismatic}"));
                    }
                }
            }
        }
    }

    #[test]
    fn switches_and_buffers_are_outside_the_travel() {
        for ratio in [1.0, 100.0] {
            let travel = (-2.0 * ratio, 3.0 * ratio);
            let config =
                AxisConfig::nominal(&NominalJoint { ratio, home: 0.0, travel: Some(travel), ..JOINT }).unwrap();
            let (low, high) = (config.negative_limit.unwrap().to, config.positive_limit.unwrap().from);
            assert!(low < travel.0 && low > travel.0 - 1.01 && high > travel.1 && high < travel.1 + 1.01);
            let edge = config.home_switch.unwrap().to;
            assert!(edge < 0.0 && edge > travel.0 && edge > -TAU, "{edge}");
            assert!((0.0..=20.0).contains(&config.start_angle) && config.start_angle < travel.1);
            let found = PlantAxis::new(&config, 1).feedback();
            assert!(!found.home_switch && !found.negative_limit && !found.positive_limit);
        }
        let endless = AxisConfig::nominal(&NominalJoint { travel: None, ..JOINT }).unwrap();
        assert!(endless.negative_limit.is_none() && endless.positive_limit.is_none());
    }

    #[test]
    fn motor_bears_the_effort_of_its_joint() {
        let mut axis = PlantAxis::new(&AxisConfig::nominal(&JOINT).unwrap(), 1);
        // A blocked motor holds the effort for five minutes.
        axis.set_fault(crate::PlantFault::Blocked, true);
        for second in 0..300 {
            axis.advance(10_000, Demand::Torque(JOINT.effort / JOINT.ratio));
            assert_eq!(axis.feedback().trip, None, "at {second} s");
        }
    }

    #[test]
    fn a_motor_that_falls_is_caught_by_its_drive_at_any_speed() {
        for speed in [20.0, 100.0, 190.0, -190.0] {
            let mut config = AxisConfig::nominal(&JOINT).unwrap();
            if let PlantConfig::Physical(motor) = &mut config.plant {
                let amplitude = f64::copysign(0.5 * JOINT.effort / JOINT.ratio, speed);
                motor.gravity = Gravity { amplitude, ratio: JOINT.ratio, phase: -config.start_angle / JOINT.ratio };
            }
            // The brake does not hold.
            config.brake = 0.0;
            let mut axis = PlantAxis::new(&config, 1);
            let mut fallen = 0;
            while axis.velocity().abs() < f64::abs(speed) {
                axis.advance(10, Demand::Off);
                fallen += 1;
                assert!(fallen < 1000, "{} of {speed} rad/s", axis.velocity());
            }
            for at in 0..500 {
                axis.advance(10, Demand::Velocity(0.0));
                assert_eq!(axis.feedback().trip, None, "{speed} rad/s, at {at} ms");
            }
            assert!(axis.velocity().abs() < 1.0, "{speed} rad/s: still {} rad/s", axis.velocity());
        }
    }

    #[test]
    fn impossible_joints_are_refused_in_words() {
        let cases = [
            (NominalJoint { ratio: 0.0, ..JOINT }, "the magnitude of the ratio is 0, it must be above 0 and finite"),
            (NominalJoint { velocity: f64::NAN, ..JOINT }, "the greatest velocity of the joint is NaN"),
            (NominalJoint { effort: -1.0, ..JOINT }, "the greatest effort of the joint is -1"),
            (NominalJoint { inertia: -1.0, ..JOINT }, "the greatest inertia of the load is -1, it must be 0 or above"),
            (NominalJoint { home: f64::INFINITY, ..JOINT }, "the motor angle at home is inf, it must be finite"),
            (NominalJoint { travel: Some((1.0, 1.0)), ..JOINT }, "the positive end of travel is 1, it must be above"),
        ];
        for (joint, words) in cases {
            let text = AxisConfig::nominal(&joint).unwrap_err().to_string();
            assert!(text.starts_with(words), "{text}, not {words}");
        }
        assert!(AxisConfig::nominal(&NominalJoint { inertia: 0.0, ..JOINT }).is_ok(), "a joint without a load");
    }
}
