//! Nothing allocates while two arms carry an object: neither the coordinator, nor the arms, nor their force sensors. Nor
//! does a poll of light gates allocate.

use std::f64::consts::PI;
use std::time::Duration;

use can::Instant;
use drive::cia401::{IoConfig, RehearsedIo};
use drive::cia402::{Identity, NodeId};
use drive::wrench::RehearsedWrench;
use mrroc_controller::coordination::carry::{Carry, Grips, Hold, ObjectLimits, ObjectPath, Regulation};
use mrroc_controller::coordination::{Late, LinkConfig};
use mrroc_controller::ecp::{Ecp, EcpConfig, Meetings, Subcontrollers, Task};
use mrroc_controller::executor::{Agents, Ended, Executor, Team, Turns};
use mrroc_controller::force::Load;
use mrroc_controller::law::RehearsedLaw;
use mrroc_controller::robot::{Arm, Irb6Parameters, Pose, RobotParameters};
use mrroc_controller::sensor::{
    ForceSensorConfig, ForceTorque, GateLine, LightGates, LightGatesConfig, Shell, Travel, VirtualSensor,
};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use servo::LawBound;

use crate::counting;
use crate::ideal::{PERIOD, Sent, team};

const AXES: usize = 5;
const BENT: [f64; 8] = [0.0, -1.571, 0.0, 1.571, 0.0, 0.0, 0.0, 0.0];

/// Turns of the executor in motion, of which nine in ten are checked.
const TURNS: usize = 1_500;
const BEGUN: usize = 150;

fn pose(x: f64, [roll, yaw]: [f64; 2]) -> Pose {
    Pose::from_parts(Translation3::new(x, 0.0, 0.0), UnitQuaternion::from_euler_angles(roll, 0.0, yaw))
}

#[test]
fn no_turn_of_two_arms_that_carry_a_bar_allocates() {
    for regulation in [Regulation::None, Regulation::MACROSTEP, Regulation::CYCLE] {
        carry(regulation);
    }
}

fn carry(regulation: Regulation) {
    let arm = Arm::new(Irb6Parameters::irb6().robot().expect("sound parameters"), Pose::translation(0.0, 0.0, 0.25));
    let grips = Grips {
        cell_from_base: [Pose::identity(), pose(2.2, [0.0, PI])],
        object_from_tool: [pose(-0.4, [PI, 0.0]), pose(0.4, [PI, PI])],
    };
    let limits = ObjectLimits { velocity: 0.05, acceleration: 0.4, radius: 0.4 };
    let places = [[1.1, 0.0, 0.8, 0.0], [1.1, 0.0, 0.86, 0.0], [1.12, 0.1, 0.86, 0.05], [1.1, 0.0, 0.8, 0.0]];
    let path = ObjectPath::through(&places, &limits).expect("a sound path");
    // Both arms see their grip at the same place.
    let joints = arm.inverse(&grips.tool(0, &path.at(0.0)).pose, &BENT).expect("the grip is within reach");
    let motors = arm.motors(&joints).expect("the joints are within their limits");
    let home: [f64; AXES] = std::array::from_fn(|axis| motors[axis]);
    let sent = [Sent::<AXES>::default(), Sent::default()];
    let (mut servo, links) = team(home, 250.0, 1500.0, &sent);
    for effector in 0..2 {
        let bounds = [LawBound { displacement: 1.0, speed: 1.0 }; AXES];
        servo.install_law(effector, Box::new(RehearsedLaw), &bounds).expect("before the first cycle");
    }
    let (mut devices, mut sensors) = (Vec::new(), Vec::new());
    for link in &links {
        let (device, wrench) = RehearsedWrench::new();
        let config = ForceSensorConfig {
            arm: arm.clone(),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor: Pose::translation(0.0, 0.0, 0.09),
            load: Load::of_weight(1.0, Vector3::new(0.0, 0.0, 0.1)).expect("a body"),
            range: [1e3; 6],
            lag: Duration::from_millis(2),
            max_offset: [20.0; 6],
        };
        devices.push(device);
        sensors.push(ForceTorque::new(wrench, link.latest.clone(), config));
    }
    let config = EcpConfig {
        period: PERIOD,
        pace: mrroc_controller::generator::Pace { periods: 10, read_at: 8 },
        macrosteps_ahead: 8,
        silence: Duration::from_secs(1),
        switching: Duration::from_secs(2),
        planning: Duration::from_secs(60),
        homing: Duration::from_secs(2),
        meeting: Duration::from_secs(1),
    };
    let ecps = links.into_iter().map(|link| Ecp::new(arm.clone(), link, config)).collect();
    let agents = Agents::new(Subcontrollers::new(ecps, Meetings::new([])));
    let mut members = [0, 1].map(|robot| agents.agent(robot).expect("nobody has it"));
    for (member, sensor) in members.iter_mut().zip(&sensors) {
        member.sense(sensor.clone(), Shell::NonInteractive, 1).expect("the only sensor");
    }
    let task = async move {
        for member in &mut members {
            member.perform(Task::new().enable()).await.map_err(|error| error.to_string())?;
        }
        let link = LinkConfig { blocking: true, deadline: Duration::from_secs(1), late: Late::Stop };
        let [left, right] = &mut members;
        let mut team = Team::new([left, right], link);
        let hold = Hold::new(Duration::from_millis(100));
        team.execute(Carry::new(grips, path, regulation, 100.0), [hold; 2]).await.map_err(|error| error.to_string())
    };
    let mut executor = Executor::new(agents, task, Turns::default());
    let mut now = Instant::ZERO;
    let mut counts = Vec::with_capacity(20_000);
    let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
    loop {
        for (device, sensor) in devices.iter_mut().zip(&sensors) {
            device.advance(now, sensor.load(now).unwrap_or_default().components());
        }
        let before = counting::allocations();
        let goes_on = executor.poll(now, |_, _| {});
        let _ = sensors[0].read();
        counts.push(counting::allocations() - before);
        if !goes_on {
            break;
        }
        let in_motion = (BEGUN..TURNS).contains(&counts.len());
        assert!(!in_motion || counts.last() == Some(&0), "{regulation:?}: turn {}: {:?}", counts.len(), counts.last());
        servo.step(now);
        let column = sensors[0].load(now).map_or(0.0, |load| load.force.x);
        (least, greatest) = (least.min(column), greatest.max(column));
        now += PERIOD;
    }
    let (ended, errors) = executor.finish();
    assert!(matches!(ended, Some(Ended::Task(Ok(())))) && errors.is_empty(), "{ended:?} {errors:?}");
    assert!(counts.len() > TURNS + 200, "it did move: {} turns", counts.len());
    assert!(greatest - least > 0.05, "the tool accelerated: {least} N to {greatest} N");
}

#[test]
fn a_poll_of_light_gates_does_not_allocate() {
    let io = IoConfig {
        node: NodeId::MIN,
        identity: Identity { vendor: 0, product: None, revision: None },
        inputs: 2,
        outputs: 0,
        inhibit_time: Duration::from_millis(1),
        event_timer: Duration::from_millis(100),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0,
        error_value: 0,
        configuration: Vec::new(),
    };
    // An object of 80 mm passes every four seconds at 0.2 m/s: fronts and backs at both gates.
    let at = |seconds: f64| Instant::ZERO + Duration::from_secs_f64(seconds);
    let passage = |start: f64| [(at(start), 0), (at(start + 0.4), 0), (at(start + 2.0), 1), (at(start + 2.4), 1)];
    let changes: Vec<_> = (0..50).flat_map(|number| passage(1.0 + 4.0 * f64::from(number))).collect();
    let (mut node, link) = RehearsedIo::new(&io, changes);
    let gate = |input, place| GateLine { input, place };
    let config = LightGatesConfig {
        gates: vec![gate(0, 0.1), gate(1, 0.5)],
        travel: Travel::Forward,
        min_speed: 0.02,
        max_speed: 1.0,
        delay: Duration::from_micros(600),
        wait: Duration::from_micros(400),
        inhibit_time: Duration::from_millis(1),
    };
    let mut gates = LightGates::new(link.inputs, &config).expect("two gates");
    let mut passed = 0;
    for step in 0..10_000_u32 {
        let now = Instant::ZERO + Duration::from_millis(20) * step;
        node.advance(now);
        let before = counting::allocations();
        let reading = gates.poll(now);
        assert_eq!(counting::allocations() - before, 0, "step {step}");
        passed = reading.map_or(0, |(_, reading)| reading.count());
    }
    assert_eq!(passed, 50);
}
