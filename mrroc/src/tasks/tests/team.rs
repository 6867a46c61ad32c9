//! Two emulated arms in tight coordination.

use std::cell::Cell as Shared;
use std::sync::Mutex;

use controller::coordination::{CoordinatorError, LinkError};
use controller::ecp::ReplaceRefused;

use super::*;

/// Raises both tools at 0.1 m/s, after a quarter of a second of acceleration. The memory is the number of the macrostep.
struct Rise {
    macrostep: f64,
    /// What the coordinator does wrong.
    wrong: Option<Wrong>,
}

/// A mistake of a coordinator.
#[derive(Clone, Copy, Debug)]
enum Wrong {
    /// Refuses the motion in its first step.
    Refuses,
    /// Panics in its first step.
    PanicsAtFirst,
    /// Panics in step 40.
    Panics,
}

impl Rise {
    const fn sound() -> Self {
        Self { macrostep: 0.0, wrong: None }
    }
}

/// Height, m, velocity and acceleration.
type Height = [f64; 3];

/// Acceleration, m/s², and its duration, s.
const ACCELERATION: (f64, f64) = (0.4, 0.25);

impl Coordinator<2> for Rise {
    type Order = Height;
    type Answer = ();
    type Sensors = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        match self.wrong {
            Some(Wrong::Refuses) => return Err(GeneratorError::User(7)),
            Some(Wrong::PanicsAtFirst) => panic!("as the test asks"),
            Some(Wrong::Panics) | None => {}
        }
        self.macrostep = macrostep.as_secs_f64();
        Ok(NextOrders::new([[0.0; 3]; 2], 0))
    }

    fn terminal(&self, step: &u32, _: &[Sample<()>; 2], (): &()) -> bool {
        *step == 60
    }

    fn next_step(&self, step: &u32, _: &[Sample<()>; 2], (): &()) -> Result<Orders<Self, 2>, GeneratorError> {
        assert!(*step != 40 || !matches!(self.wrong, Some(Wrong::Panics)), "as the test asks");
        let t = f64::from(step + 1) * self.macrostep;
        let (a, end) = ACCELERATION;
        let order = if t < end { [a * t * t / 2.0, a * t, a] } else { [a * end * (t - end / 2.0), a * end, 0.0] };
        Ok(NextOrders::new([order; 2], step + 1))
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

/// Raises both tools, and keeps the measured heights in every cycle.
async fn rise(cell: &mut Cell, heights: &Heights) -> Outcome {
    let [mut left, mut right] = bent(cell).await?;
    let eyes = [left.observer(), right.observer()];
    let over = Shared::new(false);
    let ended = Shared::new(None);
    let motion = async {
        let executed = cell.team([&mut left, &mut right]).execute(Rise::sound(), [follow(), follow()]).await;
        over.set(true);
        ended.set(Some(executed));
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

#[test]
fn a_team_moves_as_its_coordinator_orders_and_stands_at_the_end() {
    let heights = Heights::default();
    let seen = Arc::clone(&heights);
    let report = in_lockstep(async move |cell: &mut Cell| {
        let heights = if cell.rehearsing() { Heights::default() } else { Arc::clone(&seen) };
        rise(cell, &heights).await
    });
    assert_eq!(report.faults, Vec::new());
    let heights = heights.lock().unwrap().clone();
    let (first, last) = (heights[0], heights[heights.len() - 1]);
    // The motion ends in motion, and is braked.
    assert!((0..2).all(|arm| last[arm] - first[arm] > 0.1), "{first:?} {last:?}");
    assert!(heights.iter().all(|both| (both[0] - both[1]).abs() < 1e-4), "the arms leave each other");
}

/// A sound macrostep other than that of the cell.
struct Quick(Follow);

impl Generator for Quick {
    type First = EffectorImage;
    type Every = A<Height>;
    type Out = Answer<()>;
    type Memory = ();

    fn pace(&self, cell: Pace) -> Pace {
        Pace { periods: cell.periods - 1, read_at: 1 }
    }
    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
        self.0.first_step(e, macrostep)
    }
    fn terminal(&self, (): &(), a0: &A<Height>) -> bool {
        self.0.terminal(&(), a0)
    }
    fn next_step(&self, (): &(), a0: &A<Height>) -> Result<Next<(), Answer<()>>, GeneratorError> {
        self.0.next_step(&(), a0)
    }
}

/// Both robots, bent, from where the tools can rise.
async fn bent(cell: &mut Cell) -> Result<[Robot; 2], TaskError> {
    let [mut left, mut right] = ready(cell).await?;
    let bend = |robot: &Robot| robot.motions().joints(0.3, &[[0.0, -1.5, 0.2, 0.8, 0.0]]);
    let (one, other) = (bend(&left)?, bend(&right)?);
    join(left.execute(one), right.execute(other)).await?;
    Ok([left, right])
}

fn follow() -> Follow {
    Follow(Pose::identity())
}

#[test]
fn a_coordinator_that_refuses_or_panics_leaves_both_arms_at_rest_and_the_team_can_move_again() {
    for wrong in [Wrong::Refuses, Wrong::PanicsAtFirst, Wrong::Panics] {
        accepted(async move |cell: &mut Cell| {
            let [mut left, mut right] = bent(cell).await?;
            let mut team = cell.team([&mut left, &mut right]);
            let coordinator = Rise { wrong: Some(wrong), ..Rise::sound() };
            let failed = team.execute(coordinator, [follow(), follow()]).await.unwrap_err();
            let (step, error) = match wrong {
                Wrong::Refuses => (0, GeneratorError::User(7)),
                Wrong::PanicsAtFirst => (0, GeneratorError::Panicked),
                Wrong::Panics => (41, GeneratorError::Panicked),
            };
            let expected = CoordinatorError::Generator { step, error };
            assert!(matches!(failed, TaskError::Coordinator(found) if found == expected), "{failed}");
            assert_eq!(failed.class(), Class::NonFatal);
            for robot in [&left, &right] {
                let joints = robot.image()?.commanded.joints;
                assert_eq!(joints.velocity, [0.0; 8]);
            }
            cell.team([&mut left, &mut right]).execute(Rise::sound(), [follow(), follow()]).await
        });
    }
}

#[test]
fn members_may_have_generators_of_different_types_but_keep_the_macrostep_of_the_cell() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let quick = Quick(follow());
        let failed = cell.team([&mut left, &mut right]).execute(Rise::sound(), (follow(), quick)).await.unwrap_err();
        let error = GeneratorError::PaceInTeam { cell: 10, periods: 9 };
        let found = failed.instruction().unwrap();
        assert_eq!((found.robot, found.cause), (1, EcpError::Generator { step: 0, error }));
        Ok(())
    });
}

/// Follows, and refuses its twentieth step.
struct Refusing(Follow);

impl Generator for Refusing {
    type First = EffectorImage;
    type Every = A<Height>;
    type Out = Answer<()>;
    type Memory = u32;

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32, Answer<()>>, GeneratorError> {
        self.0.first_step(e, macrostep).map(|_| Next::remember(0).with(Answer(())))
    }
    fn terminal(&self, _: &u32, _: &A<Height>) -> bool {
        false
    }
    fn next_step(&self, step: &u32, a0: &A<Height>) -> Result<Next<u32, Answer<()>>, GeneratorError> {
        if *step == 19 {
            return Err(GeneratorError::User(3));
        }
        let Next { effector, .. } = self.0.next_step(&(), a0)?;
        Ok(Next::command(effector.expect("it follows"), step + 1).with(Answer(())))
    }
}

/// Commands in its first step already.
struct Hasty;

impl Generator for Hasty {
    type First = EffectorImage;
    type Every = A<Height>;
    type Out = Answer<()>;
    type Memory = ();

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
        Ok(Next::command(Setpoint::Joints(e.commanded.joints), ()).with(Answer(())))
    }
    fn terminal(&self, (): &(), _: &A<Height>) -> bool {
        false
    }
    fn next_step(&self, (): &(), _: &A<Height>) -> Result<Next<(), Answer<()>>, GeneratorError> {
        Ok(Next::remember(()).with(Answer(())))
    }
}

#[test]
fn a_member_that_commands_in_its_first_step_is_refused_and_nothing_moves() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let before = left.image()?.commanded.joints.position;
        let failed = cell.team([&mut left, &mut right]).execute(Rise::sound(), (follow(), Hasty)).await.unwrap_err();
        let error = GeneratorError::CommandsAtFirst;
        assert_eq!(failed.instruction().expect("of a member").cause, EcpError::Generator { step: 0, error });
        assert_eq!(left.image()?.commanded.joints.position, before);
        Ok(())
    });
}

#[test]
fn the_task_receives_the_cause_of_the_member_that_failed() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let members = (follow(), Refusing(follow()));
        let failed = cell.team([&mut left, &mut right]).execute(Rise::sound(), members).await.unwrap_err();
        let found = failed.instruction().expect("an error of a member");
        let cause = EcpError::Generator { step: 19, error: GeneratorError::User(3) };
        assert_eq!((found.robot, found.cause, failed.class()), (1, cause, Class::NonFatal));
        Ok(())
    });
}

#[test]
fn a_link_to_the_task_rests_during_a_motion_of_a_team_and_then_goes_on() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let mut link = left.coordinated::<Height, ()>();
        let low = left.image()?.commanded.pose.translation.z;
        cell.team([&mut left, &mut right]).execute(Rise::sound(), [follow(), follow()]).await?;
        let high = left.image()?.commanded.pose.translation.z;
        assert!(high > low + 0.1, "{low} {high}");
        // The order lets the tool stay, and the end of the motion ends it.
        let orders = async {
            link.order([0.0; 3])?;
            cell.sleep(ms(60)).await;
            let answered = link.answer()?.expect("every step answers");
            assert!(answered.age <= ms(40), "{answered:?}");
            Ok(link.end_motion()?)
        };
        join(orders, left.execute(follow())).await?;
        let still = left.image()?.commanded.pose.translation.z;
        assert!((still - high).abs() < 1e-9, "{high} {still}");
        Ok(())
    });
}

#[test]
fn a_member_of_a_team_is_neither_replaced_nor_ended_over_its_link_to_the_task() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let (replacer, mut link) = (left.replacer(), left.coordinated::<Height, ()>());
        let low = left.image()?.commanded.pose.translation.z;
        let change = async {
            cell.sleep(ms(600)).await;
            assert_eq!(replacer.replace(follow()), Err(ReplaceRefused::InTeam));
            assert_eq!(link.end_motion(), Err(LinkError::InTeam));
            Ok(())
        };
        let motion = async { cell.team([&mut left, &mut right]).execute(Rise::sound(), [follow(), follow()]).await };
        join(motion, change).await?;
        let high = left.image()?.commanded.pose.translation.z;
        assert!(high > low + 0.1, "{low} {high}");
        // Nothing is left of the refused calls.
        left.execute(turn(&left, 0.1)).await?;
        assert!((column(&left).0 - 0.1).abs() < 1e-6);
        Ok(())
    });
}

/// Raises the left tool, and lets the right arm stand.
struct Lopsided(Rise);

impl Coordinator<2> for Lopsided {
    type Order = Height;
    type Answer = ();
    type Sensors = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        let NextOrders { orders, memory, .. } = self.0.first_step(&(), macrostep)?;
        Ok(NextOrders::new(orders, memory))
    }

    fn terminal(&self, step: &u32, answers: &[Sample<()>; 2], (): &()) -> bool {
        self.0.terminal(step, answers, &())
    }

    fn next_step(&self, step: &u32, answers: &[Sample<()>; 2], (): &()) -> Result<Orders<Self, 2>, GeneratorError> {
        let NextOrders { orders: [left, _], memory, .. } = self.0.next_step(step, answers, &())?;
        Ok(NextOrders::new([left, [0.0; 3]], memory))
    }
}

#[test]
fn a_member_that_stands_at_the_end_of_the_motion_ends_with_its_partner_that_brakes() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = bent(cell).await?;
        let before = right.image()?.commanded.joints.position;
        let mut team = cell.team([&mut left, &mut right]);
        team.execute(Lopsided(Rise::sound()), [follow(), follow()]).await?;
        let apart = right.image()?.commanded.joints.position.into_iter().zip(before).map(|(one, other)| one - other);
        assert!(apart.into_iter().all(|apart| apart.abs() < 1e-9));
        assert_eq!(left.image()?.commanded.joints.velocity, [0.0; 8]);
        Ok(())
    });
}
