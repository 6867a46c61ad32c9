//! Nothing allocates while a team moves: neither the steps of coordinator and members, nor the executor and the task.

use std::sync::Arc;
use std::time::Duration;

use can::Instant;
use mrroc_controller::coordination::{Coordinator, Late, LinkConfig, NextOrders, Orders};
use mrroc_controller::ecp::{Ecp, EcpConfig, Meetings, Subcontrollers, Task};
use mrroc_controller::executor::{Agents, Ended, Executor, Team, Turns};
use mrroc_controller::generator::{
    AxesState, EffectorImage, GeneratorError, Pace, Pose, Sample, Setpoint, Transparent,
};
use mrroc_controller::robot::{Arm, Irb6, Irb6Parameters, Robot};

use crate::counting;
use crate::ideal::{PERIOD, Sent, team};

const AXES: usize = 5;
/// Macrosteps of the motion, and the amplitude of the columns, rad.
const STEPS: u32 = 200;
const AMPLITUDE: f64 = 0.02;
/// Turns of the executor until all steps have begun.
const BEGUN: usize = 100;

/// Swings the columns of both members, in opposite directions.
struct Swing;

impl Coordinator<2> for Swing {
    type Order = Option<Setpoint>;
    type Answer = EffectorImage;
    type Sensors = ();
    type Out = ();
    /// Number of macrosteps done.
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        Ok(NextOrders::new([None; 2], 0))
    }

    fn terminal(&self, done: &u32, _: &[Sample<EffectorImage>; 2], (): &()) -> bool {
        *done == STEPS
    }

    fn next_step(
        &self,
        done: &u32,
        answers: &[Sample<EffectorImage>; 2],
        (): &(),
    ) -> Result<Orders<Self, 2>, GeneratorError> {
        let place = |done: u32| AMPLITUDE * (1.0 - (std::f64::consts::TAU * f64::from(done) / f64::from(STEPS)).cos());
        let by = place(done + 1) - place(*done);
        let mut side = 1.0;
        let orders = answers.map(|answer| {
            let mut position = answer.value.commanded.joints.position;
            position[0] += side * by;
            side = -side;
            Some(Setpoint::Joints(AxesState::at_rest(position)))
        });
        Ok(NextOrders::new(orders, done + 1))
    }
}

#[test]
fn no_turn_of_a_team_in_motion_allocates() {
    let robot = Irb6::new(&Irb6Parameters::irb6()).expect("its parameters are consistent");
    let home: [f64; AXES] = std::array::from_fn(|axis| robot.home().padded()[axis]);
    let arm = Arm::new(Arc::new(robot), Pose::identity());
    let sent = [Sent::<AXES>::default(), Sent::default()];
    let (mut servo, links) = team(home, 250.0, 1500.0, &sent);
    let config = EcpConfig {
        period: PERIOD,
        pace: Pace { periods: 10, read_at: 8 },
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
    let task = async move {
        for member in &mut members {
            member.perform(Task::new().enable()).await.map_err(|error| error.to_string())?;
        }
        let link = LinkConfig { blocking: true, deadline: Duration::from_secs(1), late: Late::Stop };
        let [left, right] = &mut members;
        let mut team = Team::new([left, right], link);
        team.execute(Swing, [Transparent; 2]).await.map_err(|error| error.to_string())
    };
    let mut executor = Executor::new(agents, task, Turns::default());
    let mut now = Instant::ZERO;
    let mut counts = Vec::with_capacity(10_000);
    let in_motion = |counts: &[u64]| counts.len() > BEGUN && counts.len() < BEGUN + 9 * STEPS as usize;
    loop {
        let before = counting::allocations();
        let goes_on = executor.poll(now, |_, _| {});
        counts.push(counting::allocations() - before);
        if !goes_on {
            break;
        }
        assert!(!in_motion(&counts) || counts.last() == Some(&0), "turn {}: {:?}", counts.len(), counts.last());
        servo.step(now);
        now += PERIOD;
    }
    let (ended, errors) = executor.finish();
    assert!(matches!(ended, Some(Ended::Task(Ok(())))) && errors.is_empty(), "{ended:?} {errors:?}");
    assert!(counts.len() > 10 * STEPS as usize, "it did move: {} turns", counts.len());
}
