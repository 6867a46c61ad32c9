//! Processes that meet and that move as a team, on the real servo with ideal drives.

#[path = "../../../tests/ideal.rs"]
pub(crate) mod ideal;

use drive::{DriveGroup, Fault};
use ideal::{FirstFault, Ideal, Sent};
use servo::{EffectorConfig, PositionLoop, Servo, ServoAxisConfig, ServoConfig};

use super::*;

const AXES: usize = 3;
const BOTH: u32 = 0b11;
const FAULT: Fault = Fault::Drive { node: 1, code: 0x2310 };

/// Two robots, their processes and their servo. Meeting 0 is between both.
pub(super) struct Cell {
    servo: Servo,
    pub(super) ecps: [Ecp; 2],
    meetings: Meetings,
    faults: [FirstFault; 2],
    pub(super) now: Instant,
    pub(super) outcomes: [Vec<Result<(), EcpError>>; 2],
    /// Cycles in which each robot began to move.
    began: [Vec<u32>; 2],
    cycle: u32,
    /// Whether the process of the second robot is polled in every third cycle only.
    lags: bool,
}

impl Cell {
    /// Both robots stand.
    pub(super) fn standing() -> Self {
        let faults: [FirstFault; 2] = Default::default();
        let group = |fault: &_| -> Box<dyn DriveGroup> { Box::new(Ideal::new([0.0; AXES], &Sent::default(), fault)) };
        let config = ServoConfig { period: PERIOD, max_missed_in_row: 1, effectors: (0..2).map(effector).collect() };
        let (servo, links) = Servo::new(&config, faults.iter().map(group).collect()).unwrap();
        let ecp = |link| Ecp::new(Arm::new(Arc::new(Gantry), Pose::identity()), link, CONFIG);
        let ecps: Vec<Ecp> = links.into_iter().map(ecp).collect();
        let Ok(ecps): Result<[Ecp; 2], _> = ecps.try_into() else { unreachable!("there are two robots") };
        let mut cell = Self {
            servo,
            ecps,
            meetings: Meetings::new([vec![0, 1]]),
            faults,
            now: Instant::ZERO,
            outcomes: Default::default(),
            began: Default::default(),
            cycle: 0,
            lags: false,
        };
        assert_eq!(cell.run([Task::new().enable(), Task::new().enable()]), [vec![Ok(())], vec![Ok(())]]);
        cell
    }

    pub(super) fn execute(&mut self, tasks: [Task; 2]) {
        for (ecp, task) in self.ecps.iter_mut().zip(tasks) {
            ecp.execute(task).unwrap();
        }
        self.outcomes = Default::default();
        self.began = Default::default();
    }

    /// Executes both tasks and returns their outcomes.
    fn run(&mut self, tasks: [Task; 2]) -> [Vec<Result<(), EcpError>>; 2] {
        self.execute(tasks);
        self.until(|cell| cell.ecps.iter().all(|ecp| ecp.status().instruction.is_none()));
        self.outcomes.clone()
    }

    pub(super) fn until(&mut self, reached: impl Fn(&Self) -> bool) {
        for _ in 0..100_000 {
            if reached(self) {
                return;
            }
            self.cycle();
        }
        panic!("{:?}", self.phases());
    }

    pub(super) fn cycle(&mut self) {
        let before = self.phases();
        self.servo.step(self.now);
        for (robot, (phase, before)) in self.phases().into_iter().zip(before).enumerate() {
            if phase == Phase::Moving && before != phase {
                self.began[robot].push(self.cycle);
            }
            if robot == 1 && self.lags && !self.cycle.is_multiple_of(3) {
                continue;
            }
            while let Some(event) = self.ecps[robot].poll(self.now) {
                self.outcomes[robot].push(event.outcome);
            }
        }
        self.meetings.poll(&mut self.ecps);
        self.now += PERIOD;
        self.cycle += 1;
    }

    fn phases(&self) -> [Phase; 2] {
        [0, 1].map(|robot| self.servo.state(robot).unwrap().phase())
    }

    fn team_macrosteps(&self) -> [u64; 2] {
        [0, 1].map(|robot| self.ecps[robot].latest().team_macrostep)
    }
}

fn effector(group: usize) -> EffectorConfig {
    let axis = |index_in_group| ServoAxisConfig {
        group,
        index_in_group,
        min_position: -1e3,
        max_position: 1e3,
        max_velocity: 500.0,
        max_acceleration: 2000.0,
        planned_jerk: 10_000.0,
        following_error: 10.0,
        homing_order: 1,
        increments_per_radian: 1000.0,
        position_loop: PositionLoop::Drive,
        torque_offset: None,
        homing: None,
        frozen: servo::FrozenWatch::Always,
        brake_watch: true,
    };
    EffectorConfig {
        name: format!("robot {group}"),
        axes: (0..AXES).map(axis).collect(),
        queue: 16,
        enabling_timeout: Duration::from_secs(1),
        homing_timeout: Duration::from_secs(1),
    }
}

fn stopped_by(effector: u8) -> Result<(), EcpError> {
    Err(EcpError::Servo(ServoFault::new(None, StopCause::Partner { effector })))
}

#[test]
fn robots_meet_any_number_of_times_and_always_begin_in_the_same_cycle() {
    let mut cell = Cell::standing();
    let mut tasks = [Task::new(), Task::new()];
    for turn in 1..=10 {
        let [one, other] = tasks.map(|task| task.meet(0));
        let x = 0.1 * f64::from(turn % 2);
        tasks = [one.run(to(x, 0.0, 0.0)), other.run(to(0.0, 0.0, 3.0 * x))];
    }
    assert_eq!(cell.run(tasks), [vec![Ok(()); 20], vec![Ok(()); 20]]);
    assert_eq!(cell.began[0].len(), 10);
    assert_eq!(cell.began[0], cell.began[1]);
}

#[test]
fn a_robot_that_is_switched_off_after_a_meeting_has_passed_it_before() {
    for robot in [0, 1] {
        let mut cell = Cell::standing();
        let mut tasks = [Task::new().meet(0).disable(), Task::new().meet(0).run(to(0.1, 0.0, 0.0))];
        tasks.rotate_left(robot);
        assert_eq!(cell.run(tasks), [vec![Ok(()); 2], vec![Ok(()); 2]]);
    }
}

#[test]
fn the_members_of_a_team_begin_every_macrostep_together_until_they_untie() {
    let mut cell = Cell::standing();
    let motions = |axis: usize| {
        let at = |value: f64| if axis == 0 { to(value, 0.0, 0.0) } else { to(0.0, 0.0, value) };
        // Each enabling delays the second robot by a poll.
        let late = (0..40 * axis).fold(Task::new(), |task, _| task.enable());
        late.tie(BOTH).run(at(0.2)).run(at(0.1)).untie()
    };
    let tasks = [motions(0).run(to(0.5, 0.0, 0.0)), motions(1).run(to(0.0, 0.0, 0.2))];
    cell.execute(tasks);
    let ready = |cell: &Cell| cell.ecps.iter().all(|ecp| ecp.status().instruction.is_none());
    while !ready(&cell) {
        cell.cycle();
        let [one, other] = cell.team_macrosteps();
        assert_eq!(one, other, "cycle {}", cell.cycle);
        assert!(cell.cycle < 10_000);
    }
    assert_eq!(cell.outcomes, [vec![Ok(()); 5], vec![Ok(()); 45]]);
    assert_eq!(cell.began[0][..2], cell.began[1][..2]);
    assert!(cell.team_macrosteps()[0] > 20, "{:?}", cell.team_macrosteps());
}

#[test]
fn a_fault_of_one_member_ends_the_instruction_of_its_partner_which_stands_and_moves_again() {
    let mut cell = Cell::standing();
    cell.execute([Task::new().tie(BOTH).run(to(2.0, 0.0, 0.0)), Task::new().tie(BOTH).run(to(0.0, 0.0, 2.0))]);
    cell.until(|cell| cell.team_macrosteps() == [20; 2]);
    *cell.faults[1].lock().unwrap() = Some(FAULT);
    cell.until(|cell| cell.ecps.iter().all(|ecp| ecp.status().instruction.is_none()));
    let fault = EcpError::Servo(ServoFault::new(Some(0), StopCause::Drive(FAULT)));
    assert_eq!(cell.outcomes, [vec![Ok(()), stopped_by(1)], vec![Ok(()), Err(fault)]]);
    assert_eq!(stopped_by(1).unwrap_err().class(), Class::NonFatal);
    cell.until(|cell| cell.phases()[1] == Phase::Faulted);
    assert_eq!((cell.phases()[0], cell.servo.fault(0)), (Phase::Standing, None));
    let outcomes = cell.run([Task::new().run(to(0.0, 0.0, 0.0)), Task::new()]);
    assert_eq!(outcomes, [vec![Ok(())], vec![]]);
}

#[test]
fn a_stop_while_a_process_is_idle_ends_its_next_motion_unless_faults_were_reset() {
    for reset in [false, true] {
        let mut cell = Cell::standing();
        let outcomes = cell.run([Task::new().tie(BOTH), Task::new().tie(BOTH).disable()]);
        assert_eq!(outcomes, [vec![Ok(())], vec![Ok(()); 2]]);
        let motion = || Task::new().run(to(0.1, 0.0, 0.0));
        if reset {
            let outcomes = cell.run([Task::new().reset_fault().run(to(0.1, 0.0, 0.0)), Task::new()]);
            assert_eq!(outcomes[0], [Ok(()); 2]);
        } else {
            assert_eq!(cell.run([motion(), Task::new()])[0], [stopped_by(1)]);
            assert_eq!(cell.run([motion(), Task::new()])[0], [Ok(())]);
        }
    }
}

#[test]
fn a_partner_without_a_macrostep_is_waited_for_no_longer_than_at_a_meeting() {
    let mut cell = Cell::standing();
    let longest = Duration::from_secs(3);
    cell.ecps.iter_mut().for_each(|ecp| ecp.config.meeting = longest);
    let outcomes = cell.run([Task::new().tie(BOTH).run(to(0.1, 0.0, 0.0)), Task::new().tie(BOTH)]);
    let [Ok(()), Err(EcpError::Unmet { waited })] = outcomes[0][..] else { panic!("{outcomes:?}") };
    assert!(waited > longest && waited < longest + 2 * PERIOD, "{waited:?}");
    assert_eq!((cell.phases(), cell.began), ([Phase::Standing; 2], Default::default()));
}

#[test]
fn a_tie_without_its_own_robot_or_with_one_that_does_not_exist_is_refused() {
    for members in [0b10, 0b101, 0] {
        let mut cell = Cell::standing();
        assert_eq!(cell.run([Task::new().tie(members), Task::new()])[0], [Ok(())]);
        cell.until(|cell| cell.phases()[0] == Phase::Faulted);
        let refused = ServoFault::new(None, StopCause::NotAMember { members });
        assert_eq!(cell.servo.fault(0), Some(refused));
    }
}

#[test]
fn members_whose_generators_end_in_motion_brake_without_an_error_whichever_stop_comes_first() {
    for lags in [false, true] {
        let mut cell = Cell::standing();
        cell.lags = lags;
        let passing = || JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.3)]).unwrap().ending_at(axis_0(0.3));
        let task = || Task::new().tie(BOTH).run(passing().unwrap()).untie().run(to(0.0, 0.0, 0.0));
        assert_eq!(cell.run([task(), task()]), [vec![Ok(()); 4], vec![Ok(()); 4]], "lags: {lags}");
        assert_eq!((cell.phases(), cell.team_macrosteps()[0]), ([Phase::Standing; 2], cell.team_macrosteps()[1]));
    }
}

#[test]
fn a_fault_of_the_partner_is_an_error_of_a_member_whose_last_macrosteps_are_cut_off() {
    let mut cell = Cell::standing();
    let passing = JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.3)]).unwrap().ending_at(axis_0(0.3)).unwrap();
    let longer = JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(2.0)]).unwrap();
    cell.execute([Task::new().tie(BOTH).run(passing).run(to(1.0, 0.0, 0.0)), Task::new().tie(BOTH).run(longer)]);
    cell.until(|cell| matches!(cell.ecps[0].activity, Activity::RunningOut));
    assert!(cell.ecps[0].outstanding() > 1);
    *cell.faults[1].lock().unwrap() = Some(FAULT);
    cell.until(|cell| cell.ecps.iter().all(|ecp| ecp.status().instruction.is_none()));
    assert_eq!(cell.outcomes[0], [Ok(()), stopped_by(1)]);
}
