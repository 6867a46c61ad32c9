//! Plants of the IRp-6 on its track, of RNT, of Polycrank, of the gripper and of the conveyor.

use super::axis::{AxisConfig, PlantConfig};
use super::irp6::{COLUMN, Irp6Axis};
use super::mechanism::{Mechanism, MechanismConfig};
use super::motor::{EndStops, Gravity, MotorConfig};
use super::{friction::FrictionConfig, switch::Switch, thermal::ThermalConfig};
use crate::amplifier::AmplifierConfig;

/// Motor angles of the synchronisation position of the arm on the track, rad (public code).
const TRACK_ARM_HOMES: [f64; 6] = [-10.819, -4.012, -6.219, 158.997, 479.5, 769.7];

/// Nominal values.
pub(super) const THERMAL: ThermalConfig = ThermalConfig {
    winding_to_housing: 1.0,
    housing_to_air: 2.0,
    winding_capacity: 60.0,
    housing_capacity: 800.0,
    air: 25.0,
    trip: 155.0,
};

/// Parameters of a motor and its drive, at the motor shaft.
pub(super) struct MotorData {
    /// Motor angle of the synchronisation position, rad.
    pub(super) home: f64,
    /// Angles at which the limit switches close, rad; `None` for an endless axis.
    pub(super) travel: Option<(f64, f64)>,
    pub(super) counts: u32,
    pub(super) torque_constant: f64,
    /// Winding: resistance, Ω, and inductance, H.
    pub(super) winding: (f64, f64),
    /// Inertia of rotor and load, kg·m².
    pub(super) inertia: f64,
    /// Weight of the load: torque, N·m; motor angle per joint angle; joint angle at home above the horizontal, rad.
    pub(super) gravity: (f64, f64, f64),
    /// Viscous friction, N·m·s/rad, Coulomb and static friction, N·m.
    pub(super) friction: (f64, f64, f64),
    /// Working current limit and over-current threshold, A.
    pub(super) max_current: f64,
    pub(super) trip_current: f64,
    pub(super) max_voltage: f64,
    pub(super) brake: f64,
}

/// Natural frequency of an axis in its buffers, rad/s. The damping ratio is one half.
pub(super) const BUFFER_FREQUENCY: f64 = 300.0;
/// Bounce time of the contacts, sub-steps: 2 ms (nominal).
const BOUNCE: u32 = 20;
/// Distance from the home index down to the edge of the home switch, rad: half the distance between two index pulses.
const EDGE: f64 = std::f64::consts::PI;

impl MotorData {
    /// An axis with the edge of its home switch half a motor turn below home.
    fn config(&self, home_from: f64) -> AxisConfig {
        self.axis((home_from, self.home - EDGE), BOUNCE)
    }

    /// An axis with a home switch that is closed over `home_switch`, rad. Contacts bounce for `bounce` sub-steps.
    pub(super) fn axis(&self, home_switch: (f64, f64), bounce: u32) -> AxisConfig {
        let (viscous, coulomb, stiction) = self.friction;
        let (amplitude, ratio, at_home) = self.gravity;
        let switch = |from, to| Switch { from, to, bounce };
        AxisConfig {
            plant: PlantConfig::Physical(MotorConfig {
                torque_constant: self.torque_constant,
                resistance: self.winding.0,
                inductance: self.winding.1,
                inertia: self.inertia,
                viscous,
                friction: FrictionConfig { coulomb, stiction, stribeck_velocity: 5.0 },
                gravity: Gravity { amplitude, ratio, phase: at_home - self.home / ratio },
                end_stops: self.travel.map(|(negative, positive)| EndStops {
                    negative: negative - 3.0,
                    positive: positive + 3.0,
                    stiffness: self.inertia * BUFFER_FREQUENCY * BUFFER_FREQUENCY,
                    damping: self.inertia * BUFFER_FREQUENCY,
                }),
                thermal: THERMAL,
                torque_ripple: 0.01,
            }),
            amplifier: AmplifierConfig {
                setpoint_filter: 0.0,
                max_current: self.max_current,
                trip_current: self.trip_current,
                max_voltage: self.max_voltage,
                inertia: self.inertia,
            },
            counts_per_revolution: self.counts,
            edge_jitter: 0.02,
            index_angle: self.home,
            start_angle: self.home + 20.0,
            brake: self.brake,
            home_switch: Some(switch(home_switch.0, home_switch.1)),
            negative_limit: self.travel.map(|(to, _)| switch(f64::NEG_INFINITY, to)),
            positive_limit: self.travel.map(|(_, from)| switch(from, f64::INFINITY)),
        }
    }
}

/// Reflected inertia of the load of a motor, at home.
fn inertia(mechanism: MechanismConfig, number: usize) -> f64 {
    Mechanism::new(mechanism).load(number).inertia
}

impl AxisConfig {
    /// The same axis with its home at another motor angle, rad. Index, start, switches, buffers and gravity move too.
    pub fn with_home(mut self, home: f64) -> Self {
        let shift = home - self.index_angle;
        let moved = |switch: Option<Switch>| {
            switch.map(|switch| Switch { from: switch.from + shift, to: switch.to + shift, ..switch })
        };
        self.index_angle = home;
        self.start_angle += shift;
        self.home_switch = moved(self.home_switch);
        self.negative_limit = moved(self.negative_limit);
        self.positive_limit = moved(self.positive_limit);
        if let PlantConfig::Physical(motor) = &mut self.plant {
            motor.gravity.phase -= shift / motor.gravity.ratio;
            if let Some(stops) = &mut motor.end_stops {
                stops.negative += shift;
                stops.positive += shift;
            }
        }
        self
    }

    /// An axis of the IRp-6 on its track, to be mounted on [`MechanismConfig::Irp6OnTrack`]: 0 is the track, 1 to 6 are
    /// the arm. `None` for a higher number.
    ///
    /// The arm equals [`AxisConfig::irp6`] with the home positions of this robot (public code). Travel and switches
    /// are as far from home as on the pedestal (nominal).
    ///
    /// Public data of the track: 1570.8 rad/m (screw of 8 mm, belt 2:1), home at 0, travel -200 to 1900 rad, 4000
    /// counts, over-current at 25 A. Nominal data of the track: carriage of 60 kg in addition to the arm's 76 kg,
    /// friction, winding, switches.
    pub fn irp6_track(number: usize) -> Option<Self> {
        if let Some(arm) = number.checked_sub(1) {
            let axis = *Irp6Axis::ALL.get(arm)?;
            return Some(Self::irp6(axis).with_home(TRACK_ARM_HOMES[arm]));
        }
        let track = MotorData {
            travel: Some((-200.0, 1900.0)),
            inertia: inertia(MechanismConfig::Irp6OnTrack, 0),
            friction: (1e-3, 0.15, 0.22),
            ..COLUMN
        };
        Some(track.config(f64::NEG_INFINITY))
    }

    /// Length of RNT's legs at home between their universal joints, m (nominal).
    pub const RNT_HOME_LENGTH: f64 = 0.75;

    /// An axis of RNT: legs 0 to 2 and wrist 3 to 5. The axis is to be mounted on [`MechanismConfig::Rnt`] with all
    /// three lengths equal to [`AxisConfig::RNT_HOME_LENGTH`]. `None` for a higher number. All parameters are
    /// nominal.
    ///
    /// Motors read zero at home. Legs lengthen by 5 mm per positive turn, from 0.55 m to 1.38 m. The wrist has a gear
    /// of 100:1 and turns to ±180°, ±110° and ±180°. The home switch is closed over all of the travel below home.
    pub fn rnt(number: usize) -> Option<Self> {
        use std::f64::consts::{PI, TAU};
        let mechanism = MechanismConfig::Rnt { home_lengths: [Self::RNT_HOME_LENGTH; 3] };
        let leg = |length: f64| (length - Self::RNT_HOME_LENGTH) * TAU / 5e-3;
        let travel = match number {
            0..=2 => (leg(0.55), leg(1.38)),
            3 | 5 => (-100.0 * PI, 100.0 * PI),
            4 => (-11_000.0_f64.to_radians(), 11_000.0_f64.to_radians()),
            _ => return None,
        };
        let leg = MotorData {
            travel: Some(travel),
            inertia: inertia(mechanism, number),
            max_current: 15.0,
            trip_current: 20.0,
            max_voltage: 48.0,
            ..COLUMN
        };
        let wrist = MotorData {
            winding: (1.2, 1.0e-3),
            friction: (2e-4, 0.008, 0.012),
            max_current: 8.0,
            trip_current: 10.0,
            ..leg
        };
        let motor = if number < 3 { leg } else { wrist };
        Some(motor.config(f64::NEG_INFINITY))
    }

    /// Axis 0 to 6 of Polycrank, to be mounted on [`MechanismConfig::Polycrank`]. `None` for a higher number. All
    /// parameters are nominal.
    ///
    /// Motors read zero at home and turn fifty times per turn of the joint. The joints are endless. The home switch
    /// is a cam on a shaft with a gear of 20:1 from the joint. The cam gives homing its direction and the right one
    /// of fifty index pulses. The cam is closed over the ten turns below home and open over the ten turns above. Its
    /// edge lies half a motor turn below the index of home. Beyond ten turns from home the real cam repeats, and the
    /// emulated switch stays open. Windings are sized for 6 rad/s (axes 0 to 2) and 10 rad/s, each with 40 rad/s² in
    /// the worst pose.
    pub fn polycrank(number: usize) -> Option<Self> {
        let mechanism = MechanismConfig::Polycrank { coupled: false, at_home: [0.0; 7] };
        let (torque_constant, winding, max_current) = match number {
            0..=2 => (0.4, (0.5, 2.0e-3), 24.0),
            3..=5 => (0.2, (1.0, 2.0e-3), 10.0),
            6 => (0.2, (2.0, 4.0e-3), 4.0),
            _ => return None,
        };
        let motor = MotorData {
            torque_constant,
            winding,
            inertia: inertia(mechanism, number),
            friction: (5e-4, 0.03, 0.045),
            max_current,
            trip_current: 1.5 * max_current,
            max_voltage: 170.0,
            brake: 10.0,
            ..COLUMN
        };
        let cam = 10.0 * 50.0 * std::f64::consts::TAU;
        let mut config = motor.config(-cam);
        // The loops are tuned for a pose between the folded and the stretched arm. In the first two axes the inertia
        // of such a pose differs much from the inertia at home.
        config.amplifier.inertia *= match number {
            0 => 1.6,
            1 => 0.6,
            _ => 1.0,
        };
        Some(config)
    }

    /// The two-finger gripper of the IRp-6, without a mechanism. Public data: rotor of 5e-7 kg·m², 2e-6 N·m·s/rad,
    /// 128 counts, home at 4830 rad, travel -2000 to 5000 rad, 60 mA, over-current at 0.2 A. Nominal data: the torque
    /// per current of the arm's motors, winding, dry friction, switches.
    pub fn gripper() -> Self {
        MotorData {
            home: 4830.0,
            travel: Some((-2000.0, 5000.0)),
            counts: 128,
            winding: (30.0, 10e-3),
            inertia: 5e-7,
            friction: (2e-6, 5e-4, 8e-4),
            max_current: 0.06,
            trip_current: 0.2,
            brake: 0.0,
            ..COLUMN
        }
        .config(f64::NEG_INFINITY)
    }

    /// The conveyor, endless and without switches. The belt moves by motor angle / 2250, m. Public data: 1.5e-4
    /// kg·m², 4000 counts. Nominal data: the torque per current of the arm's motors, winding, 60 V for 0.2 m/s,
    /// friction. The 0.01 N·m·s/rad of its own emulator would take 21 A at 0.1 m/s and burn a real winding. As with
    /// the arm's motors, a tenth of that friction is used here.
    pub fn conveyor() -> Self {
        let motor =
            MotorData { inertia: 1.5e-4, friction: (1e-3, 0.05, 0.08), max_voltage: 60.0, brake: 0.0, ..COLUMN };
        Self { home_switch: None, start_angle: 0.0, ..motor.config(f64::NEG_INFINITY) }
    }
}

#[cfg(test)]
mod tests {
    use super::AxisConfig;
    use crate::plant::{Demand, PlantAxis};
    use std::f64::consts::TAU;

    /// Presets by name, with the lowest and the highest start angle relative to home.
    fn presets() -> Vec<(String, AxisConfig, f64, f64)> {
        let mut presets = Vec::new();
        let mut add = |name: String, config: AxisConfig, turns: f64| {
            let (low, high) = match (config.negative_limit, config.positive_limit) {
                (Some(low), Some(high)) => (low.to - config.index_angle, high.from - config.index_angle),
                _ => (-turns * TAU, turns * TAU),
            };
            presets.push((name, config, low, high));
        };
        let track = AxisConfig::irp6_track(0).expect("the track");
        add("track".into(), track, 0.0);
        for number in 0..7 {
            if let Some(config) = AxisConfig::rnt(number) {
                add(format!("rnt {number}"), config, 0.0);
            }
            if let Some(config) = AxisConfig::polycrank(number) {
                add(format!("polycrank {number}"), config, 499.0);
            }
        }
        add("gripper".into(), AxisConfig::gripper(), 0.0);
        presets
    }

    #[test]
    fn home_is_the_first_index_above_the_switch_from_wherever_an_axis_begins() {
        for (name, config, low, high) in presets() {
            let home = config.index_angle;
            let begins = (0..=40).map(|k| low + (high - low) * f64::from(k) / 40.0);
            for begin in begins {
                let config = AxisConfig { start_angle: home + begin, edge_jitter: 0.0, ..config };
                let closed = PlantAxis::new(&config, 1).feedback().home_switch;
                // The only edge lies half a motor turn below home. The switch tells on which side of the edge the
                // axis is.
                assert_eq!(closed, begin <= -TAU / 2.0, "{name} at {begin}");
            }
            let mut config = config;
            config.start_angle = home - TAU;
            let per_radian = f64::from(config.counts_per_revolution) / TAU;
            let mut axis = PlantAxis::new(&config, 1);
            let up = Demand::Velocity(3.0 * per_radian);
            while axis.feedback().home_switch {
                axis.advance(10, up);
            }
            axis.take_index();
            while axis.feedback().index.is_none() {
                axis.advance(10, up);
            }
            let off = (axis.angle() - home) * per_radian;
            assert!((-1.0..=12.0).contains(&off), "{name}: {off} counts off");
        }
    }

    #[test]
    fn contacts_chatter_and_the_first_edge_is_where_it_should_be() {
        let config = AxisConfig { start_angle: 0.0, ..AxisConfig::polycrank(0).expect("it has the axis") };
        let mut axis = PlantAxis::new(&config, 1);
        let mut changes = Vec::new();
        let mut before = axis.feedback().home_switch;
        for _ in 0..10_000 {
            axis.advance(1, Demand::Velocity(-4000.0));
            if axis.feedback().home_switch != before {
                before = !before;
                changes.push(axis.angle());
            }
        }
        assert!(before, "it ends up closed");
        assert!(changes.len() >= 3, "chatters: {changes:?}");
        for angle in changes {
            assert!((-3.17..=-TAU / 2.0).contains(&angle), "an edge at {angle} rad");
        }
    }

    #[test]
    fn renamed_home_changes_names_and_nothing_else() {
        let run = |config: AxisConfig| {
            let mut axis = PlantAxis::new(&config, 4);
            let mut seen = Vec::new();
            for velocity in [-20_000.0, 30_000.0] {
                for _ in 0..20 {
                    axis.advance(1000, Demand::Velocity(velocity));
                    let feedback = axis.feedback();
                    let switches = (feedback.home_switch, feedback.negative_limit);
                    seen.push((axis.angle() - config.index_angle, switches));
                }
            }
            seen
        };
        for axis in crate::Irp6Axis::ALL {
            let config = AxisConfig::irp6(axis);
            let moved = run(config.with_home(config.index_angle + 64.0 * TAU));
            for (found, expected) in moved.iter().zip(run(config)) {
                assert_eq!(found.1, expected.1, "{axis:?}");
                assert!((found.0 - expected.0).abs() < 2e-3, "{axis:?}: {found:?}");
            }
        }
    }

    #[test]
    fn gripper_opens_and_closes_and_is_stopped_at_its_ends() {
        let per_radian = 128.0 / TAU;
        let mut axis = PlantAxis::new(&AxisConfig::gripper(), 1);
        let mut from = 0.0;
        for k in 0..3000 {
            let to = -100.0 * (1.0 - (f64::from(k + 1) * 2e-3).cos()) * per_radian;
            let velocity = (to - from) / 2e-3;
            axis.advance(20, Demand::Position { counts: from, velocity });
            from = to;
            let off = to - f64::from(axis.feedback().counts);
            assert!(off.abs() <= 3.0, "{off} counts off at {k}");
        }
        for (direction, end) in [(1.0, 5003.0), (-1.0, -2003.0)] {
            for _ in 0..4000 {
                axis.advance(100, Demand::Torque(2e-3 * direction));
            }
            let into = (axis.angle() - end) * direction;
            assert!((0.0..1.0).contains(&into), "{into} rad into the buffer");
            let feedback = axis.feedback();
            let limits = (feedback.negative_limit, feedback.positive_limit);
            assert_eq!(limits, (direction < 0.0, direction > 0.0));
        }
    }

    #[test]
    fn conveyor_runs_on_and_on() {
        let mut axis = PlantAxis::new(&AxisConfig::conveyor(), 1);
        // 0.15 m/s.
        let speed = 337.5 * 4000.0 / TAU;
        axis.advance(20_000, Demand::Velocity(speed));
        let before = axis.feedback().counts;
        axis.advance(1_000_000, Demand::Velocity(speed));
        let moved = f64::from(axis.feedback().counts - before) / (100.0 * speed);
        assert!((moved - 1.0).abs() < 1e-4, "{moved} of the way");
        assert_eq!(axis.feedback().trip, None);
        assert!(!axis.feedback().home_switch);
    }
}
