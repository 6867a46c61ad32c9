//! Two emulated arms in tight coordination, and messages between them and their coordinator that fail.

use std::cell::Cell as Shared;
use std::sync::Mutex;

use controller::coordination::Disturbance;
use controller::executor::DisturbedMessage;

use super::*;

/// Raises both tools at 0.1 m/s, after a quarter of a second of acceleration. The memory is the number of the macrostep.
struct Rise {
    macrostep: f64,
}

/// Height, m, velocity and acceleration.
type Height = [f64; 3];

/// Acceleration, m/s², and its duration, s.
const ACCELERATION: (f64, f64) = (0.4, 0.25);

impl Coordinator<2> for Rise {
    type Order = Height;
    type Answer = ();
    type Memory = u32;

    fn first_step(&mut self, macrostep: Duration) -> Result<NextOrders<Height, u32, 2>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(NextOrders { orders: [[0.0; 3]; 2], memory: 0 })
    }

    fn terminal(&self, step: &u32, _: &[Sample<()>; 2]) -> bool {
        *step == 60
    }

    fn next_step(&self, step: &u32, _: &[Sample<()>; 2]) -> Result<NextOrders<Height, u32, 2>, GeneratorError> {
        let t = f64::from(step + 1) * self.macrostep;
        let (a, end) = ACCELERATION;
        let order = if t < end { [a * t * t / 2.0, a * t, a] } else { [a * end * (t - end / 2.0), a * end, 0.0] };
        Ok(NextOrders { orders: [order; 2], memory: step + 1 })
    }
}

/// One arm: follows the ordered height from where it stands.
struct Follow(Pose);

impl Generator for Follow {
    type First = EffectorImage;
    type Every = A<Height>;
    type Out = Answer<()>;
    type Memory = ();

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
        self.0 = e.commanded.pose;
        Ok(Next::remember(()).with(Answer(())))
    }

    fn terminal(&self, (): &(), _: &A<Height>) -> bool {
        false
    }

    fn next_step(&self, (): &(), a0: &A<Height>) -> Result<Next<(), Answer<()>>, GeneratorError> {
        let [height, velocity, acceleration] = *a0.0.younger_than(ms(100))?;
        let up = |value| Pose::translation(0.0, 0.0, value).translation;
        let state = PoseState {
            pose: up(height) * self.0,
            linear: up(velocity).vector,
            linear_acceleration: up(acceleration).vector,
            ..PoseState::default()
        };
        Ok(Next::command(Setpoint::Tool(state), ()).with(Answer(())))
    }
}

/// Measured heights of both tools in one cycle, m.
type Heights = Arc<Mutex<Vec<[f64; 2]>>>;

/// Raises both tools, with one message disturbed, and keeps the measured heights in every cycle.
async fn rise(cell: &mut Cell, message: Option<DisturbedMessage>, heights: &Heights) -> Outcome {
    let [mut left, mut right] = ready(cell).await?;
    let bent = |robot: &Robot| robot.motions().joints(0.3, &[[0.0, -1.5, 0.2, 0.8, 0.0]]);
    let (one, other) = (bent(&left)?, bent(&right)?);
    join(left.execute(one), right.execute(other)).await?;
    let eyes = [left.observer(), right.observer()];
    let over = Shared::new(false);
    let motion = async {
        let mut team = cell.team([&mut left, &mut right]);
        if let Some(message) = message {
            team.disturb(message);
        }
        let executed = team.execute(Rise { macrostep: 0.0 }, [0, 1].map(|_| Follow(Pose::identity()))).await;
        over.set(true);
        Ok::<_, TaskError>(executed)
    };
    let ended = Shared::new(None);
    let motion = async {
        ended.set(Some(motion.await?));
        Outcome::Ok(())
    };
    let watch = async {
        while !over.get() {
            let height = |eye: &Observer| Ok::<_, TaskError>(eye.image()?.measured.pose.translation.z);
            let both = [height(&eyes[0])?, height(&eyes[1])?];
            heights.lock().unwrap().push(both);
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(motion, watch).await?;
    ended.take().expect("the motion has ended")
}

/// Runs the motion, and returns its faults and the measured heights in every cycle.
fn run(message: Option<DisturbedMessage>) -> (Vec<FaultReport>, Vec<[f64; 2]>) {
    let heights = Heights::default();
    let seen = Arc::clone(&heights);
    let report = in_lockstep(async move |cell: &mut Cell| {
        // The rehearsal would refuse the disturbed motion.
        let message = message.filter(|_| !cell.rehearsing());
        let heights = if cell.rehearsing() { Heights::default() } else { Arc::clone(&seen) };
        rise(cell, message, &heights).await
    });
    let heights = heights.lock().unwrap().clone();
    (report.faults, heights)
}

#[test]
fn a_team_moves_as_its_coordinator_orders_and_stands_at_the_end() {
    let (faults, heights) = run(None);
    assert_eq!(faults, Vec::new());
    let (first, last) = (heights[0], heights[heights.len() - 1]);
    // The motion ends in motion, and is braked.
    assert!((0..2).all(|arm| last[arm] - first[arm] > 0.1), "{first:?} {last:?}");
    assert!(heights.iter().all(|both| (both[0] - both[1]).abs() < 1e-4), "the arms leave each other");
}

#[test]
fn a_message_that_is_lost_doubled_or_swapped_stops_both_arms_together() {
    for disturbance in [Disturbance::Lost, Disturbance::Doubled, Disturbance::Swapped] {
        for answer in [false, true] {
            let (faults, heights) = run(Some(DisturbedMessage { member: 1, answer, step: 40, disturbance }));
            let causes: Vec<_> = faults.iter().map(|fault| &fault.what).collect();
            let what = format!("{disturbance:?}, answer {answer}: {causes:?}");
            assert!(!faults.is_empty(), "{what}");
            let (first, last) = (heights[0], heights[heights.len() - 1]);
            assert!((0..2).all(|arm| last[arm] - first[arm] > 0.05), "{what} {first:?} {last:?}");
            // Both arms have equal kinematics and motions. At 0.1 m/s, a stop one cycle later leads 0.2 mm further.
            let apart = heights.iter().map(|both| (both[0] - both[1]).abs()).fold(0.0, f64::max);
            println!("{disturbance:?}, answer {answer}: {:.6} mm apart", 1e3 * apart);
            assert!(apart < 1e-4, "{what}: {apart} m apart");
        }
    }
}
