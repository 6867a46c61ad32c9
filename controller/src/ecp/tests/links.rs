//! Ends of motions and replacements over the link to the task, and steps that wait for readings.

use super::teams::Cell;
use super::*;
use crate::coordination::{CoordinatorEnd, Late, LinkConfig, link};
use crate::generator::{A, Answer, SensorReading, V};
use crate::sensor::{Shell, VirtualSensor};

const LOOSE: LinkConfig = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };

/// The task's end of a link to the process.
fn followed(ecp: &mut Ecp) -> CoordinatorEnd<(), ()> {
    let (task, member) = link(LOOSE);
    ecp.follow_task(Box::new(member));
    task
}

fn jerk_limited(x: f64) -> JerkLimited {
    JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(x)]).unwrap()
}

/// A motion of joint 0 to 0.5 m that ends at 0.6 m/s.
fn through() -> JerkLimited {
    jerk_limited(0.5).ending_at(axis_0(0.6)).unwrap()
}

fn commanded(bench: &Bench) -> f64 {
    bench.servo.report.snapshot.commanded[0]
}

#[derive(Clone, Copy)]
struct Height;

impl SensorReading for Height {}

/// Never has a reading.
struct Blind;

impl VirtualSensor for Blind {
    type Reading = Height;
    type Command = ();

    fn poll(&mut self, _: Instant) -> Option<(Instant, Height)> {
        None
    }
}

#[derive(Clone, Copy)]
struct Depth;

impl SensorReading for Depth {}

/// Has a reading at once.
struct Prompt;

impl VirtualSensor for Prompt {
    type Reading = Depth;
    type Command = ();

    fn poll(&mut self, now: Instant) -> Option<(Instant, Depth)> {
        Some((now, Depth))
    }
}

/// Stands, and reads a sensor in every next step.
struct Probe;

impl Generator for Probe {
    type First = ();
    type Every = V<Height>;
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, _: &u32, _: &V<Height>) -> bool {
        false
    }
    fn next_step(&self, steps: &u32, _: &V<Height>) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::command(Setpoint::JointsBy(AxesState::default()), steps + 1))
    }
}

/// Begins in motion once its sensor has a reading.
struct Seeing(JerkLimited);

impl Generator for Seeing {
    type First = (EffectorImage, V<Height>);
    type Every = ();
    type Out = ();
    type Memory = <JerkLimited as Generator>::Memory;

    fn begins_in_motion(&self) -> bool {
        true
    }
    fn first_step(&mut self, (e, _): &Self::First, macrostep: Duration) -> Result<Next<Self::Memory>, GeneratorError> {
        self.0.first_step(e, macrostep)
    }
    fn terminal(&self, memory: &Self::Memory, (): &()) -> bool {
        self.0.terminal(memory, &())
    }
    fn next_step(&self, memory: &Self::Memory, (): &()) -> Result<Next<Self::Memory>, GeneratorError> {
        self.0.next_step(memory, &())
    }
}

#[test]
fn an_end_while_a_motion_ends_anyway_does_not_end_the_next_one() {
    type Reached = fn(&Ecp) -> bool;
    let ends: [(&str, Reached); 3] = [
        ("braking", |ecp| matches!(ecp.activity, Activity::Stopping { .. })),
        ("arriving", |ecp| matches!(ecp.activity, Activity::Arriving)),
        ("arriving, nothing outstanding", |ecp| matches!(ecp.activity, Activity::Arriving) && ecp.outstanding() == 0),
    ];
    for (when, reached) in ends {
        let mut bench = Bench::ready();
        let mut task = followed(&mut bench.ecp);
        bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0)).run(to(0.4, 0.0, 0.0))).unwrap();
        let (mut cycles, mut told) = (0, false);
        let events = bench.go_on(|bench| {
            cycles += 1;
            let early = when == "braking" && cycles == 60;
            let now = !told && bench.ecp.instruction == 0 && reached(&bench.ecp);
            told |= now;
            assert!(!(early || now) || task.end_motion(bench.now), "{when}");
        });
        assert_eq!((events, told), (finished(2), true), "{when}");
        assert_eq!(commanded(&bench), 40.0, "{when}");
    }
}

#[test]
fn an_end_while_a_motion_fails_does_not_end_the_next_list() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0))).unwrap();
    let mut cycles = 0;
    let events = bench.go_on(|bench| {
        cycles += 1;
        if cycles == 60 {
            bench.ecp.stop();
        }
        if cycles == 65 {
            assert!(bench.ecp.is_braking() && task.end_motion(bench.now));
        }
    });
    assert_eq!(events, failed(EcpError::Stopped));
    assert_eq!(bench.run(Task::new().run(to(0.4, 0.0, 0.0))), finished(1));
    assert_eq!(commanded(&bench), 40.0);
}

#[test]
fn an_end_without_a_motion_ends_the_next_one_before_it_moves() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    assert!(task.end_motion(bench.now));
    let next = Task::new().enable().run(to(0.5, 0.0, 0.0)).run(to(0.4, 0.0, 0.0));
    assert_eq!(bench.run(next), finished(3));
    let highest = bench.servo.moves().map(|it| it.position[0]).fold(0.0, f64::max);
    assert_eq!((commanded(&bench), highest), (40.0, 40.0));
}

/// Runs a motion to 1 m that is replaced after 0.4 s, with ends before and after that call. Returns the outcomes, whether
/// the first motion was replaced, and the position at the end, rad.
fn replaced(replacement: impl Fn(&mut Ecp), [before, after]: [bool; 2]) -> (usize, bool, f64, bool) {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.execute(Task::new().run(jerk_limited(1.0))).unwrap();
    let mut count = 0;
    let events = bench.go_on(|bench| {
        count += 1;
        if count == 200 {
            assert!(!before || task.end_motion(bench.now));
            replacement(&mut bench.ecp);
            assert!(!after || task.end_motion(bench.now));
        }
    });
    assert!(events.iter().all(|event| event.outcome.is_ok()), "{events:?}");
    let stopped = bench.servo.log.contains(&Order::Stop);
    (events.len(), events[0].replaced, commanded(&bench), stopped)
}

#[test]
fn the_order_of_the_calls_decides_whether_an_end_is_one_of_the_motion_replaced_or_of_the_replacement() {
    let in_motion = |ecp: &mut Ecp| ecp.replace(jerk_limited(0.2)).unwrap();
    // The replacement ends the motion replaced.
    assert_eq!(replaced(in_motion, [true, false]), (2, true, replaced(in_motion, [false; 2]).2, false));
    let (events, of_first, at, stopped) = replaced(in_motion, [false, true]);
    assert!(events == 2 && of_first && stopped && at > 20.0 && at < 100.0, "{at}");

    let from_rest = |ecp: &mut Ecp| ecp.replace(to(0.2, 0.0, 0.0)).unwrap();
    let (_, of_first, at, stopped) = replaced(from_rest, [true, false]);
    assert!(of_first && stopped && at == 20.0, "{at}");
    let (_, of_first, at, stopped) = replaced(from_rest, [false, true]);
    assert!(of_first && stopped && at > 20.0, "{at}");

    // Ends of a replacement that is replaced before it begins.
    let twice = |ecp: &mut Ecp| {
        ecp.replace(jerk_limited(0.9)).unwrap();
        ecp.replace(jerk_limited(0.2)).unwrap();
    };
    assert_eq!(replaced(twice, [true, false]).2, replaced(in_motion, [false; 2]).2);
}

#[test]
fn an_end_between_two_replacements_is_one_of_the_first() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.execute(Task::new().run(jerk_limited(1.0))).unwrap();
    let mut count = 0;
    let events = bench.go_on(|bench| {
        count += 1;
        if count == 200 {
            bench.ecp.replace(jerk_limited(0.9)).unwrap();
            assert!(task.end_motion(bench.now));
            bench.ecp.replace(jerk_limited(0.2)).unwrap();
        }
    });
    assert_eq!(events.len(), 2);
    assert!((commanded(&bench) - 20.0).abs() < 1e-6, "{}", commanded(&bench));
}

/// Ends the present motion in cycle `at`, and returns the events and the number of cycles from then to the last event.
fn ended_at(bench: &mut Bench, task: &mut CoordinatorEnd<(), ()>, at: u64) -> (Vec<EcpEvent>, u64) {
    let mut cycles = 0;
    let events = bench.go_on(|bench| {
        cycles += 1;
        assert!(cycles != at || task.end_motion(bench.now));
    });
    (events, cycles.saturating_sub(at))
}

/// Longest time from an end to the end of the instruction: the poll of the next cycle, and the settling time of the stop.
const SETTLED: u64 = 24;

#[test]
fn an_end_acts_in_a_pause() {
    let motions: [fn() -> Task; 3] = [
        || Task::new().run(Push { until: 10.0 }),
        || Task::new().run(to(0.5, 0.0, 0.0)),
        || Task::new().run(through()).run(jerk_limited(0.9)),
    ];
    for (number, motion) in motions.into_iter().enumerate() {
        let mut bench = Bench::ready();
        let mut task = followed(&mut bench.ecp);
        bench.ecp.execute(motion()).unwrap();
        let mut cycles = 0;
        let mut settled = 0;
        let events = bench.go_on(|bench| {
            cycles += 1;
            bench.servo.paused = cycles >= 60 && bench.ecp.instruction == 0;
            if cycles == 100 {
                assert!(task.end_motion(bench.now));
            }
            settled += u64::from(cycles > 100 && bench.ecp.instruction == 0);
        });
        assert!(settled <= SETTLED, "motion {number}: {settled} cycles");
        assert_eq!(events, finished(events.len()), "motion {number}");
    }
}

#[test]
fn an_end_acts_in_a_pause_in_the_last_periods_of_a_motion() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0)).run(to(0.4, 0.0, 0.0))).unwrap();
    let (mut told, mut settled) = (false, 0);
    let events = bench.go_on(|bench| {
        let arrives = matches!(bench.ecp.activity, Activity::Arriving) && bench.ecp.outstanding() == 0;
        if told || bench.ecp.instruction > 0 {
            settled += u64::from(bench.ecp.instruction == 0);
        } else if bench.servo.paused {
            told = true;
            assert!(task.end_motion(bench.now));
        }
        bench.servo.paused = bench.ecp.instruction == 0 && (bench.servo.paused || arrives);
    });
    assert_eq!((events, told), (finished(2), true));
    assert!(settled <= SETTLED, "{settled} cycles");
}

#[test]
fn a_sensor_without_a_reading_does_not_hide_the_end_of_a_motion() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.sensors().install(Blind, Shell::Interactive, 1).unwrap();
    bench.ecp.execute(Task::new().run(Probe)).unwrap();
    let (events, settled) = ended_at(&mut bench, &mut task, 100);
    assert_eq!(events, finished(1));
    assert!(settled <= SETTLED, "{settled}");
}

#[test]
fn a_step_at_rest_waits_for_its_reading_as_long_as_a_plan_may_take() {
    let mut bench = Bench::ready();
    bench.ecp.sensors().install(Blind, Shell::Interactive, 1).unwrap();
    let events = bench.run(Task::new().run(Probe));
    let [EcpEvent { outcome: Err(EcpError::Unread { step: 0, waited }), .. }] = events[..] else {
        panic!("{events:?}");
    };
    assert!(waited > CONFIG.planning && waited <= CONFIG.planning + 2 * PERIOD, "{waited:?}");
}

#[test]
fn a_motion_in_a_chain_that_ends_before_its_first_step_brakes_the_effector() {
    let mut bench = Bench::ready();
    let mut task = followed(&mut bench.ecp);
    bench.ecp.sensors().install(Blind, Shell::Interactive, 1).unwrap();
    let chain = Task::new().run(through()).run(Seeing(jerk_limited(1.0))).run(jerk_limited(0.9));
    bench.ecp.execute(chain).unwrap();
    let (mut told, mut stopped_at) = (false, None);
    let events = bench.go_on(|bench| {
        let awaits = matches!(bench.ecp.activity, Activity::Awaiting { .. }) && bench.ecp.in_motion;
        if awaits && !told {
            told = true;
            assert!(bench.ecp.outstanding() > 1 && task.end_motion(bench.now));
        }
        let stopped = bench.servo.log.last() == Some(&Order::Stop);
        if stopped {
            stopped_at.get_or_insert(bench.ecp.instruction);
        }
    });
    // The last motion begins at rest.
    assert_eq!((events, stopped_at), (finished(3), Some(1)));
    assert!((commanded(&bench) - 90.0).abs() < 1e-6);
}

#[test]
fn a_motion_ends_while_its_first_step_is_planned() {
    // At rest, and in motion.
    for chain in [false, true] {
        let mut bench = Bench::ready();
        let mut task = followed(&mut bench.ecp);
        let held = planning::Held::on(&mut bench);
        let list = if chain { Task::new().run(through()) } else { Task::new() };
        bench.ecp.execute(list.run(jerk_limited(1.0)).run(jerk_limited(0.4))).unwrap();
        let (planned, mut told, mut after) = (u32::from(chain), false, 0);
        let events = bench.go_on(|bench| {
            let plans = matches!(bench.ecp.activity, Activity::Planning { .. });
            if bench.ecp.instruction as u32 != planned {
                held.compute_all();
            } else if plans && !told {
                told = true;
                assert!(task.end_motion(bench.now));
            } else if told {
                after += 1;
            }
        });
        assert_eq!(events, finished(2 + planned as usize), "chain {chain}");
        assert!(after <= if chain { SETTLED } else { 1 }, "chain {chain}: {after}");
        assert!((commanded(&bench) - 40.0).abs() < 1e-6);
    }
}

#[test]
fn a_plan_in_motion_is_not_late_in_a_pause() {
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    // Two periods are left after the last report.
    let passing = endings::Ramp { distance: 0.02, last: 0.02 };
    bench.ecp.execute(Task::new().run(passing).run(jerk_limited(0.9))).unwrap();
    let mut paused = 0;
    let events = bench.go_on(|bench| {
        let waits = bench.ecp.in_motion && bench.ecp.outstanding() == 0;
        if bench.ecp.instruction == 0 || paused == 300 {
            held.compute_all();
        }
        bench.servo.paused = waits && paused < 300;
        paused += u32::from(bench.servo.paused);
    });
    assert_eq!((events, paused), (finished(2), 300));
    assert!(!bench.servo.log.contains(&Order::Stop));
}

#[test]
fn an_end_at_a_barrier_lets_the_partner_pass() {
    for robot in [0, 1] {
        let mut cell = Cell::standing();
        let mut task = followed(&mut cell.ecps[robot]);
        let held = planning::Held::default();
        cell.ecps[1 - robot].plan_with(Box::new(held.clone()));
        let motion = || Task::new().meet(0).run(to(0.5, 0.0, 0.0));
        cell.execute([motion(), motion()]);
        cell.until(|cell| cell.ecps[robot].latest().waiting);
        assert!(task.end_motion(cell.now));
        (0..20).for_each(|_| cell.cycle());
        held.compute_all();
        cell.until(|cell| cell.ecps.iter().all(|ecp| ecp.status().instruction.is_none()));
        assert_eq!(cell.outcomes, [vec![Ok(()); 2], vec![Ok(()); 2]]);
        let at = [0, 1].map(|robot| cell.ecps[robot].latest().commanded[0]);
        assert!(at[robot] < 25.0 && (at[1 - robot] - 50.0).abs() < 1e-6, "{at:?}");
    }
}

/// A member of a team that moves joint 0 by 1 mm in every macrostep, and answers.
struct Creep;

impl Generator for Creep {
    type First = ();
    type Every = (EffectorImage, A<()>);
    type Out = Answer<()>;
    type Memory = ();

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
        Ok(Next::remember(()).with(Answer(())))
    }
    fn terminal(&self, (): &(), _: &Self::Every) -> bool {
        false
    }
    fn next_step(&self, (): &(), _: &Self::Every) -> Result<Next<(), Answer<()>>, GeneratorError> {
        let by = AxesState::new(axis_0(0.001), axis_0(0.05));
        Ok(Next::command(Setpoint::JointsBy(by), ()).with(Answer(())))
    }
}

#[test]
fn a_member_of_a_team_is_not_replaced_and_its_coordinator_ends_it() {
    let mut bench = Bench::ready();
    let (mut coordinator, member) =
        link::<(), ()>(LinkConfig { blocking: true, deadline: 5 * PERIOD, late: Late::Stop });
    bench.ecp.follow_team(Some(Box::new(member)));
    assert!(coordinator.order(bench.now, ()));
    bench.ecp.execute(Task::new().run(Creep).run(to(0.4, 0.0, 0.0))).unwrap();
    let mut answers = 0;
    let events = bench.go_on(|bench| {
        if bench.ecp.instruction > 0 {
            bench.ecp.follow_team(None);
            return;
        }
        if let Ok(Some(_)) = coordinator.answer() {
            answers += 1;
            assert_eq!(bench.ecp.replace(Creep), Err(ReplaceRefused::InTeam));
            let sent = if answers < 20 { coordinator.order(bench.now, ()) } else { coordinator.end_motion(bench.now) };
            assert!(sent);
        }
    });
    assert_eq!((events, answers), (finished(2), 20));
}

#[test]
fn a_sensor_without_a_reading_does_not_hide_the_end_by_the_coordinator() {
    /// A member of a team that waits for a reading.
    struct Watch;
    impl Generator for Watch {
        type First = ();
        type Every = (V<Height>, A<()>);
        type Out = Answer<()>;
        type Memory = ();

        fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
            Ok(Next::remember(()).with(Answer(())))
        }
        fn terminal(&self, (): &(), _: &Self::Every) -> bool {
            false
        }
        fn next_step(&self, (): &(), _: &Self::Every) -> Result<Next<(), Answer<()>>, GeneratorError> {
            Err(GeneratorError::User(1))
        }
    }
    let mut bench = Bench::ready();
    bench.ecp.sensors().install(Blind, Shell::Interactive, 1).unwrap();
    let deadline = Duration::from_secs(1);
    let (mut coordinator, member) = link::<(), ()>(LinkConfig { blocking: true, deadline, late: Late::Stop });
    bench.ecp.follow_team(Some(Box::new(member)));
    assert!(coordinator.order(bench.now, ()));
    bench.ecp.execute(Task::new().run(Watch)).unwrap();
    let (events, settled) = ended_at(&mut bench, &mut coordinator, 100);
    assert_eq!(events, finished(1));
    assert!(settled <= SETTLED, "{settled}");
}

#[test]
fn a_sensor_that_the_generator_does_not_declare_holds_up_no_step() {
    /// Reads a prompt sensor in every step.
    struct Sees;
    impl Generator for Sees {
        type First = V<Depth>;
        type Every = V<Depth>;
        type Out = ();
        type Memory = u32;

        fn first_step(&mut self, _: &V<Depth>, _: Duration) -> Result<Next<u32>, GeneratorError> {
            Ok(Next::remember(0))
        }
        fn terminal(&self, steps: &u32, _: &V<Depth>) -> bool {
            *steps == 5
        }
        fn next_step(&self, steps: &u32, _: &V<Depth>) -> Result<Next<u32>, GeneratorError> {
            Ok(Next::remember(steps + 1))
        }
    }
    let mut bench = Bench::ready();
    bench.ecp.sensors().install(Prompt, Shell::Interactive, 1).unwrap();
    bench.ecp.sensors().install(Blind, Shell::Interactive, 1).unwrap();
    assert_eq!(bench.run(Task::new().run(Sees)), finished(1));
    assert!(bench.now.since(Instant::ZERO) < Duration::from_secs(1));
}

#[test]
fn only_a_generator_that_commands_the_effector_has_moved_it() {
    let mut bench = Bench::ready();
    for (task, commands) in [
        (Task::new().run(Wait { duration: Duration::from_millis(50) }), false),
        (Task::new().run(to(0.1, 0.0, 0.0)), true),
        (Task::new().run(to(0.2, 0.0, 0.0)).enable(), false),
    ] {
        bench.run(task);
        assert_eq!(bench.ecp.has_commanded(), commands);
    }
}
