//! Tests of barriers and teams.

mod laws;
mod stops;

use super::*;
use crate::{CellState, ServoFault, Snapshot, TeamState};

/// Effectors of one axis, each on its own group.
struct Cell {
    servo: Servo,
    links: Vec<EffectorLink>,
    worlds: Vec<Arc<Mutex<World>>>,
    now: Instant,
}

impl Cell {
    /// Homed and standing at zero. The acceleration limit of each effector is given.
    fn standing(accelerations: &[f64]) -> Self {
        Self::with(&scripted::config(1), accelerations)
    }

    fn with(like: &ServoConfig, accelerations: &[f64]) -> Self {
        Self::prepared(like, accelerations, |_| {})
    }

    /// The same. `prepare` acts on the servo before the first cycle.
    fn prepared(like: &ServoConfig, accelerations: &[f64], prepare: impl FnOnce(&mut Servo)) -> Self {
        let effector = |(group, acceleration): (usize, &f64)| {
            let mut effector = like.effectors[0].clone();
            (effector.axes[0].group, effector.axes[0].max_acceleration) = (group, *acceleration);
            effector
        };
        let effectors = accelerations.iter().enumerate().map(effector).collect();
        let config = ServoConfig { effectors, ..like.clone() };
        let (groups, worlds): (Vec<_>, Vec<_>) = accelerations.iter().map(|_| scripted::group(1)).unzip();
        for world in &worlds {
            let mut world = world.lock().unwrap();
            world.axes[0].state.homing = Homing::Attained;
            world.log = false;
        }
        let (mut servo, links) = Servo::new(&config, groups).unwrap();
        prepare(&mut servo);
        let mut cell = Self { servo, links, worlds, now: Instant::ZERO };
        cell.order_all(Order::Enable);
        cell.run(20);
        assert!(cell.phases().iter().all(|phase| *phase == Phase::Standing), "{:?}", cell.phases());
        cell
    }

    fn order(&mut self, effector: usize, order: Order) {
        self.links[effector].orders.push(order).unwrap();
    }

    fn order_all(&mut self, order: Order) {
        (0..self.links.len()).for_each(|effector| self.order(effector, order));
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.servo.step(self.now);
            self.now += PERIOD;
        }
    }

    fn phases(&self) -> Vec<Phase> {
        (0..self.links.len()).map(|effector| self.servo.state(effector).unwrap().phase()).collect()
    }

    fn snapshot(&self, effector: usize) -> Snapshot {
        self.links[effector].latest.read()
    }

    fn position(&self, effector: usize) -> f64 {
        self.snapshot(effector).commanded[0]
    }

    fn team_macrosteps(&self) -> Vec<u64> {
        (0..self.links.len()).map(|effector| self.snapshot(effector).team_macrostep).collect()
    }
}

fn partner(effector: u8) -> Option<ServoFault> {
    Some(ServoFault::new(None, StopCause::Partner { effector }))
}

/// `count` macrosteps of 10 periods from zero: 400 rad/s² during four of them, then 16 rad/s, all times `scale`. The
/// sequence ends in motion.
fn motion(scale: f64, count: u64) -> Vec<Macrostep> {
    accelerating(400.0 * scale, 4, count - 4)
}

/// SplitMix64, below a bound.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % bound
    }
}

#[test]
fn members_begin_100_000_macrosteps_in_the_same_cycles_however_late_their_queues_are() {
    const COUNT: u64 = 100_000;
    let mut random = Random(1);
    let mut cell = Cell::standing(&[1000.0; 2]);
    cell.order_all(Order::Tie { members: 0b11 });
    // Macrosteps of 1 to 3 periods that end at rest.
    let next = |number: u64| macrostep(number, 1 + (number % 3) as u16, 1e-4 * (number % 2) as f64, 0.0);
    let (mut sent, mut pauses) = ([0; 2], [0; 2]);
    let mut waited = 0;
    while cell.team_macrosteps() != [COUNT; 2] {
        for (effector, (sent, pause)) in sent.iter_mut().zip(&mut pauses).enumerate() {
            if *pause > 0 {
                *pause -= 1;
                continue;
            }
            let room = cell.links[effector].orders.slots() as u64;
            for _ in 0..random.below(6).min(room).min(COUNT - *sent) {
                // The numbers of the members differ, and both count on by one.
                cell.order(effector, Order::Move(next(*sent + 6 * (1 + effector as u64))));
                *sent += 1;
            }
            let longest = if random.below(20) == 0 { 80 } else { 12 };
            *pause = random.below(longest);
        }
        cell.run(1);
        let [one, other] = [0, 1].map(|effector| cell.snapshot(effector));
        assert_eq!(one.team_macrostep, other.team_macrostep, "cycle {}", one.cycle);
        assert_eq!(one.commanded[0], other.commanded[0], "cycle {}", one.cycle);
        assert_eq!(one.phase, other.phase, "cycle {}", one.cycle);
        let team = [0, 1].map(|effector| cell.servo.team_state(effector).unwrap());
        assert!(team[0] == team[1] && team[0].is_tied(), "cycle {}: {team:?}", one.cycle);
        waited += u64::from(one.waiting != other.waiting);
        assert!(one.cycle < 20 * COUNT, "{:?}", cell.team_macrosteps());
    }
    assert!(waited > COUNT / 100, "{waited}");
    assert_eq!(cell.servo.counters().macrosteps, 2 * COUNT);
}

#[test]
fn a_team_moves_only_after_every_member_has_its_first_macrostep() {
    for late in [0, 1] {
        let mut cell = Cell::standing(&[1000.0; 2]);
        cell.order_all(Order::Tie { members: 0b11 });
        let step = Order::Move(macrostep(1, 10, 0.01, 0.0));
        cell.order(1 - late, step);
        cell.run(500);
        assert_eq!(cell.phases(), [Phase::Standing; 2]);
        assert_eq!((cell.snapshot(late).waiting, cell.snapshot(1 - late).waiting), (false, true));
        cell.order(late, step);
        cell.run(1);
        assert_eq!((cell.phases(), cell.team_macrosteps()), (vec![Phase::Moving; 2], vec![1; 2]));
        cell.run(20);
        assert_eq!(cell.phases(), [Phase::Standing; 2]);
    }
}

#[test]
fn a_team_stays_in_step_under_refused_batches_and_a_speed_override() {
    let mut random = Random(2);
    let mut cell = Cell::standing(&[1000.0, 600.0]);
    let sequences = [1.0, -0.5].map(|scale| motion(scale, 40));
    for (effector, sequence) in sequences.into_iter().enumerate() {
        cell.order(effector, Order::Tie { members: 0b11 });
        sequence.into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
    }
    let mut refused = 0;
    while cell.phases() != [Phase::Stopping; 2] {
        if random.below(10) == 0 {
            cell.worlds[random.below(2) as usize].lock().unwrap().refuses = 1 + random.below(3) as u32;
            refused += 1;
        }
        if random.below(50) == 0 {
            cell.servo.speed_override().set(0.1 * (1 + random.below(10)) as f64).unwrap();
        }
        cell.run(1);
        let (one, other) = (cell.position(0), cell.position(1));
        assert!((other + 0.5 * one).abs() < 1e-9, "{one} {other}");
        assert!(cell.now < Instant::ZERO + PERIOD * 20_000, "{:?}", cell.phases());
    }
    assert!(refused > 20, "{refused}");
    assert_eq!(cell.team_macrosteps(), [40; 2]);
    // Both queues ended in the same cycle.
    for effector in 0..2 {
        assert_eq!(cell.servo.fault(effector).unwrap().cause, StopCause::Starved { last: 40 });
    }
}

#[test]
fn a_member_that_unties_in_motion_goes_on_alone_and_the_last_member_is_free() {
    let mut cell = Cell::standing(&[1000.0; 3]);
    cell.order_all(Order::Tie { members: 0b111 });
    for (effector, tied) in [5, 8, 20].into_iter().enumerate() {
        for (number, step) in (1..).zip(motion(1.0, 20)) {
            cell.order(effector, Order::Move(step));
            if number == tied {
                cell.order(effector, Order::Untie);
            }
        }
    }
    cell.run(60);
    assert_eq!((cell.team_macrosteps(), cell.phases()), (vec![5, 6, 6], vec![Phase::Moving; 3]));
    let states = |cell: &Cell| [0, 1, 2].map(|effector| cell.servo.team_state(effector).unwrap());
    assert_eq!(states(&cell), [TeamState::Apart, TeamState::Moving, TeamState::Moving]);
    cell.order(0, Order::Stop);
    cell.run(1);
    assert_eq!(cell.phases(), [Phase::Stopping, Phase::Moving, Phase::Moving]);
    cell.run(40);
    // With the second member gone, the third one is no team.
    assert_eq!((cell.team_macrosteps(), cell.phases()[2]), (vec![5, 8, 8], Phase::Moving));
    assert_eq!(states(&cell), [TeamState::Apart; 3]);
    cell.order(1, Order::Stop);
    cell.run(1);
    assert_eq!(cell.phases()[1..], [Phase::Stopping, Phase::Moving]);
    cell.run(200);
    assert_eq!([0, 1].map(|effector| cell.servo.fault(effector)), [None; 2]);
    assert_eq!(cell.servo.fault(2).unwrap().cause, StopCause::Starved { last: 20 });
}

#[test]
fn a_member_that_unties_behind_a_meeting_frees_its_partner_in_the_same_cycle() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    cell.order_all(Order::Tie { members: 0b11 });
    cell.order_all(Order::Meet { members: 0b11 });
    cell.order(0, Order::Untie);
    cell.order(1, Order::Move(macrostep(1, 10, 0.01, 0.0)));
    cell.run(1);
    assert_eq!(cell.phases(), [Phase::Standing, Phase::Moving]);
}

#[test]
fn two_teams_side_by_side_begin_and_stop_independently() {
    let mut cell = Cell::standing(&[1000.0; 5]);
    let teams = [0b00101, 0b11010, 0b00101, 0b11010, 0b11010];
    for (effector, members) in teams.into_iter().enumerate() {
        cell.order(effector, Order::Tie { members });
        let count = if members == 0b00101 { 30 } else { 40 };
        let scale = [1.0, 0.3, -0.7, 0.9, -1.0][effector];
        if effector == 4 {
            cell.run(33);
            let moving = [0, 2].map(|effector| cell.phases()[effector]);
            assert_eq!(moving, [Phase::Moving; 2]);
            assert_eq!(cell.phases()[1], Phase::Standing);
        }
        motion(scale, count).into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
    }
    cell.run(1);
    assert_eq!(cell.team_macrosteps()[1], 1);
    cell.run(100);
    cell.order(2, Order::Stop);
    cell.run(1);
    let (stopping, moving) = (Phase::Stopping, Phase::Moving);
    assert_eq!(cell.phases(), [stopping, moving, stopping, moving, moving]);
    cell.run(100);
    assert_eq!(cell.servo.fault(0), partner(2));
    let steps = cell.team_macrosteps();
    assert_eq!((steps[1], steps[3], steps[4]), (21, 21, 21));
    for effector in [1, 3, 4] {
        assert_eq!((cell.phases()[effector], cell.servo.fault(effector)), (Phase::Moving, None));
    }
}

#[test]
fn effectors_meet_any_number_of_times_and_go_on_in_the_same_cycle() {
    let mut cell = Cell::standing(&[1000.0; 3]);
    let lengths = [10, 30, 17];
    for (effector, length) in lengths.into_iter().enumerate() {
        for number in 1..=20 {
            cell.order(effector, Order::Meet { members: 0b111 });
            cell.order(effector, Order::Move(macrostep(number, length, 0.001 * (number % 2) as f64, 0.0)));
        }
    }
    let mut before = cell.phases();
    let mut began = vec![Vec::new(); 3];
    for cycle in 0..1000 {
        cell.run(1);
        for (effector, phase) in cell.phases().into_iter().enumerate() {
            if phase == Phase::Moving && before[effector] != phase {
                began[effector].push(cycle);
            }
        }
        before = cell.phases();
    }
    assert_eq!(began[0].len(), 20);
    assert!(began.iter().all(|it| *it == began[0]), "{began:?}");
    assert_eq!(cell.servo.counters().refused_orders, 0);
}

#[test]
fn a_barrier_waits_for_an_equal_barrier_of_every_member_and_for_its_bus() {
    let others =
        [Order::Meet { members: 0b111 }, Order::Tie { members: 0b11 }, Order::Move(macrostep(1, 9, 0.001, 0.0))];
    for other in others {
        let mut cell = Cell::standing(&[1000.0; 3]);
        cell.order(0, Order::Meet { members: 0b11 });
        cell.order(0, Order::Move(macrostep(1, 10, 0.01, 0.0)));
        cell.order(1, other);
        cell.run(100);
        assert_eq!((cell.phases()[0], cell.snapshot(0).waiting), (Phase::Standing, true), "{other:?}");
        cell.worlds[1].lock().unwrap().refuses = 6;
        cell.run(1);
        cell.order(1, Order::Stop);
        cell.order(1, Order::Meet { members: 0b11 });
        cell.run(5);
        assert_eq!((cell.phases()[0], cell.snapshot(0).waiting), (Phase::Standing, true), "{other:?}");
        cell.run(2);
        assert_eq!((cell.phases()[0], cell.snapshot(0).waiting), (Phase::Moving, false), "{other:?}");
    }
}

#[test]
fn a_stop_drops_what_waits_at_a_barrier() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    for order in [Order::Meet { members: 0b11 }, Order::Move(macrostep(1, 10, 0.01, 0.0))] {
        cell.order(0, order);
    }
    cell.run(20);
    cell.order(0, Order::Disable);
    cell.run(1);
    cell.order(1, Order::Meet { members: 0b11 });
    cell.run(200);
    assert_eq!(cell.phases(), [Phase::Off, Phase::Standing]);
    assert!(cell.snapshot(1).waiting);
    assert_eq!(cell.servo.counters().refused_orders, 2);
}

#[test]
fn a_barrier_without_its_effector_or_with_one_that_does_not_exist_is_a_fault() {
    for members in [0, 0b10, 0b101] {
        for barrier in [Order::Meet { members }, Order::Tie { members }] {
            let mut cell = Cell::standing(&[1000.0; 2]);
            cell.order(0, barrier);
            cell.run(5);
            let cause = StopCause::NotAMember { members };
            assert_eq!(cell.servo.fault(0), Some(ServoFault::new(None, cause)));
            assert_eq!(cell.phases(), [Phase::Faulted, Phase::Standing]);
        }
    }
}

#[test]
fn a_cell_is_not_held_while_another_effector_brakes() {
    let mut cell = Cell::standing(&[1000.0, 100.0]);
    accelerating(50.0, 30, 20).into_iter().for_each(|step| cell.order(1, Order::Move(step)));
    cell.run(310);
    assert_eq!(cell.phases(), [Phase::Standing, Phase::Moving]);
    cell.servo.stop_request().request();
    cell.run(20);
    cell.worlds[0].lock().unwrap().axes[0].state.position += 0.6;
    cell.run(20);
    assert_eq!(cell.phases(), [Phase::Standing, Phase::Stopping]);
    assert_eq!(cell.servo.cell_state(), CellState::Stopping);
    cell.run(300);
    assert_eq!(cell.phases(), [Phase::Standing, Phase::Off]);
    assert_eq!(cell.servo.cell_state(), CellState::Held);
}

#[test]
fn a_member_whose_homing_fails_ends_its_team() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    cell.order_all(Order::Tie { members: 0b11 });
    cell.run(3);
    {
        let drive = &mut cell.worlds[0].lock().unwrap().axes[0];
        (drive.state.homing, drive.homing_fails) = (Homing::NotHomed, true);
    }
    cell.run(3);
    cell.order(0, Order::Home);
    cell.run(400);
    assert_eq!(cell.phases(), [Phase::Faulted, Phase::Standing]);
    assert_eq!([0, 1].map(|member| cell.servo.team_state(member).unwrap()), [TeamState::Apart; 2]);
    assert_eq!(cell.servo.fault(1), partner(0));
}

#[test]
fn a_record_names_its_effector_and_its_fault() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    let mut records = cell.servo.record(100);
    cell.run(5);
    cell.worlds[1].lock().unwrap().axes[0].state.fault = Some(FAULT);
    cell.run(10);
    let kept: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
    let seen = |record: &crate::Record| (record.effector, record.faulted);
    let found: Vec<_> = kept.iter().map(seen).collect();
    assert_eq!((&found[..2], &found[28..]), (&[(0, false), (1, false)][..], &[(0, false), (1, true)][..]));
}
