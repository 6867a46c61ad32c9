//! Homing by the servo, for drives whose only homing function is an index latch.

use super::*;
use crate::{Direction, FrozenWatch, HomingFailure, HomingLeg, HostHoming};

const HOMING: HostHoming = HostHoming {
    direction: Direction::Negative,
    search: HomingLeg { velocity: 15.0, distance: 20.0, timeout: Duration::from_secs(3) },
    zero: HomingLeg { velocity: 3.5, distance: 8.0, timeout: Duration::from_secs(4) },
    acceleration: 300.0,
    pause: Duration::from_millis(50),
    debounce: 3,
    reverse_at_limit: true,
};

/// Axes under each law.
fn configs(axes: usize) -> [ServoConfig; 2] {
    host_loops::laws(axes).map(|mut config| {
        config.effectors[0].homing_timeout = Duration::from_secs(20);
        for axis in &mut config.effectors[0].axes {
            axis.homing = Some(HOMING);
            axis.homing_order = 0;
        }
        config
    })
}

/// An axis 10 rad above the edge of the home switch. The index is 2 rad above the edge, and the limit switch 5 rad
/// below.
fn rig(config: &ServoConfig) -> Rig {
    let mut rig = Rig::with(config);
    for drive in &mut rig.world().axes {
        drive.state.position = 10.0;
        drive.home_below = Some(0.0);
        drive.index = 2.0;
        drive.limit_below = Some(-5.0);
    }
    rig.order(Order::Enable);
    rig.run(20);
    assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.servo.fault(0));
    rig.world().sent.clear();
    rig
}

/// Homes to the end. Returns the greatest change of torque between two cycles, if torque is sent, and the true
/// positions of axis 0 since power-on.
fn home(rig: &mut Rig) -> (f64, Vec<f64>) {
    rig.order(Order::Home);
    let mut way = Vec::new();
    let mut set = 0.0;
    for _ in 0..20_000 {
        let before = rig.world().axes[0].state;
        rig.run(1);
        let drive = rig.world().axes[0].clone();
        if before.homing != drive.state.homing && drive.state.homing == Homing::Attained {
            set = drive.index;
        }
        way.push(drive.state.position + set);
        if rig.phase() != Phase::Homing {
            break;
        }
    }
    let torque = |batch: &Vec<AxisCommand>| match batch[0] {
        AxisCommand::Follow(Setpoint::Torque(torque)) | AxisCommand::Seek(Setpoint::Torque(torque)) => torque.get(),
        _ => 0.0,
    };
    let torques: Vec<f64> = rig.world().sent.iter().map(torque).collect();
    let jump = |two: &[f64]| (two[1] - two[0]).abs();
    (torques.windows(2).map(jump).fold(0.0, f64::max), way)
}

impl Rig {
    fn run_until_off(&mut self) {
        for _ in 0..5000 {
            self.run(1);
            if self.phase() == Phase::Off {
                return;
            }
        }
        panic!("never off, but {:?}", self.servo.state(0));
    }
}

fn offset(rig: &Rig) -> Option<i64> {
    rig.servo.homing_offsets(0).next().unwrap()
}

#[test]
fn the_servo_finds_switch_and_index_without_a_kick() {
    for config in configs(2) {
        let mut rig = rig(&config);
        let (kick, way) = home(&mut rig);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        // The torque of the acceleration, 0.15 N·m, starts and ends in one step; the counter jumped by 2 rad.
        assert!(kick < 0.25, "{kick} N·m in one cycle");
        let steepest = |two: &[f64]| (two[1] - two[0]) / DT;
        let fastest = way.windows(2).map(steepest).fold(0.0, f64::max);
        assert!((3.4..4.5).contains(&fastest), "{fastest} rad/s back");
        let slowest = way.windows(2).map(steepest).fold(0.0, f64::min);
        assert!((-17.0..-14.9).contains(&slowest), "{slowest} rad/s there");
        // The counter showed 2 rad at the reference, at 1000 increments per radian.
        let offset = offset(&rig).unwrap();
        assert!((1995..=2005).contains(&offset), "{offset}");
        let world = rig.world();
        assert!(world.sent.iter().any(|batch| matches!(batch[0], AxisCommand::Seek(_))));
        assert!(matches!(world.sent.last().unwrap()[0], AxisCommand::Follow(_)));
        let rests = world.axes[0].state.position;
        assert!((0.0..0.2).contains(&rests), "at {rests} rad from the reference");
        drop(world);
        rig.order(Order::Move(macrostep(1, 100, 1.0, 0.0)));
        rig.run(150);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
    }
}

#[test]
fn no_order_of_counter_and_word_kicks_the_motor_nor_do_missing_answers() {
    use scripted::AtIndex::{CounterLate, Mute, WordLate};
    for config in configs(1) {
        for at_index in [WordLate, CounterLate, Mute] {
            let mut rig = rig(&config);
            rig.world().axes[0].at_index = at_index;
            let (kick, _) = home(&mut rig);
            assert_eq!(rig.phase(), Phase::Standing, "{at_index:?}: {:?}", rig.cause());
            assert!(kick < 0.25, "{at_index:?}: {kick} N·m in one cycle");
            let offset = offset(&rig).unwrap();
            assert!((1980..=2020).contains(&offset), "{at_index:?}: {offset}");
        }
    }
}

#[test]
fn a_switch_closed_at_the_start_is_left_and_entered_from_its_side() {
    for config in configs(1) {
        let mut rig = rig(&config);
        // Deep inside the switch, the next index pulse would be another one.
        rig.world().axes[0].home_below = Some(19.0);
        rig.world().axes[0].index = 20.0;
        rig.run(5);
        let (_, way) = home(&mut rig);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        let highest = way.iter().copied().fold(f64::MIN, f64::max);
        assert!((19.0..21.0).contains(&highest), "{highest}");
        let offset = offset(&rig).unwrap();
        assert!((19_995..=20_005).contains(&offset), "{offset}");
    }
}

/// An axis that was slow when the switch closed comes to rest nearer to the edge of the switch than a fast one.
#[test]
fn an_index_pulse_on_the_switch_is_passed_wherever_the_axis_rested_there() {
    for config in configs(1) {
        for start in [0.05, 0.2, 10.0] {
            let mut rig = rig(&config);
            rig.order(Order::Disable);
            rig.run(200);
            {
                let drive = &mut rig.world().axes[0];
                drive.state.position = start;
                drive.index = -0.2;
            }
            rig.order(Order::Enable);
            rig.run(20);
            rig.order(Order::Home);
            rig.run(10_000);
            let cause = rig.cause();
            assert!(
                matches!(cause, Some(StopCause::NoReference(HomingFailure::NoIndex { .. }))),
                "from {start}: {cause:?}, offset {:?}",
                offset(&rig)
            );
        }
    }
}

#[test]
fn a_limit_switch_turns_the_search_round_once_or_ends_it() {
    for config in configs(1) {
        // The axis stands between limit switch and home switch.
        let mut reversing = rig(&config);
        reversing.order(Order::Disable);
        reversing.run(200);
        {
            let drive = &mut reversing.world().axes[0];
            drive.state.position = -4.0;
            drive.home_below = None;
            drive.limit_below = Some(-6.0);
            drive.home_between = Some((-1.0, 1.0));
        }
        reversing.order(Order::Enable);
        reversing.run(20);
        let (_, way) = home(&mut reversing);
        assert_eq!(reversing.phase(), Phase::Standing, "{:?}", reversing.cause());
        let lowest = way.iter().copied().fold(f64::MAX, f64::min);
        assert!((-6.25..-6.0).contains(&lowest), "{lowest}");
        let offset = offset(&reversing).unwrap();
        assert!((1995..=2005).contains(&offset), "{offset}");

        let mut refusing = config.clone();
        refusing.effectors[0].axes[0].homing = Some(HostHoming { reverse_at_limit: false, ..HOMING });
        let mut rig = rig(&refusing);
        rig.world().axes[0].home_below = None;
        rig.order(Order::Home);
        rig.run(2000);
        let cause = StopCause::NoReference(HomingFailure::LimitSwitch { upper: false });
        assert_eq!(rig.cause(), Some(cause));
        let position = rig.world().axes[0].state.position;
        assert!((-6.0..-5.0).contains(&position), "stopped at {position}");
    }
}

#[test]
fn what_is_not_found_is_named_in_every_leg() {
    type Case = (fn(&mut scripted::Drive), fn(&HomingFailure) -> bool);
    let cases: [Case; 4] = [
        (
            |drive| {
                drive.home_below = None;
                drive.limit_below = None;
            },
            |failure| matches!(failure, HomingFailure::NoSwitch { distance } if *distance < 20.1),
        ),
        (
            |drive| drive.home_below = Some(1e3),
            |failure| matches!(failure, HomingFailure::SwitchNotLeft { distance } if *distance < 20.1),
        ),
        (
            |drive| drive.index = 1e3,
            |failure| matches!(failure, HomingFailure::NoIndex { distance } if *distance < 8.1),
        ),
        (
            |drive| {
                drive.home_below = None;
                drive.home_between = Some((-0.1, 0.1));
            },
            |failure| *failure == HomingFailure::SwitchPassed,
        ),
    ];
    for config in configs(1) {
        for (number, (spoil, expected)) in cases.iter().enumerate() {
            let mut rig = rig(&config);
            spoil(&mut rig.world().axes[0]);
            rig.run(5);
            rig.order(Order::Home);
            let mut last = 0.0;
            for _ in 0..10_000 {
                rig.run(1);
                let spin = rig.world().axes[0].spin;
                let acceleration = (spin - std::mem::replace(&mut last, spin)) / DT;
                assert!(acceleration.abs() < 1000.0, "case {number}: {acceleration}");
                if rig.phase() == Phase::Faulted {
                    break;
                }
            }
            let Some(StopCause::NoReference(failure)) = rig.cause() else {
                panic!("case {number}: {:?} {:?}", rig.phase(), rig.cause());
            };
            assert!(expected(&failure), "case {number}: {failure}");
        }
        for (leg, limit) in [(0, 300), (1, 200)] {
            let timeout = Duration::from_millis(limit);
            let mut config = config.clone();
            let homing = config.effectors[0].axes[0].homing.as_mut().unwrap();
            if leg == 0 {
                homing.search.timeout = timeout;
            } else {
                homing.zero.timeout = timeout;
            }
            let mut rig = rig(&config);
            rig.order(Order::Home);
            for _ in 0..10_000 {
                rig.run(1);
                if rig.phase() == Phase::Faulted {
                    break;
                }
            }
            let Some(StopCause::NoReference(HomingFailure::TimedOut { waited })) = rig.cause() else {
                panic!("leg {leg}: {:?}", rig.cause());
            };
            assert_eq!(waited, timeout + PERIOD);
        }
    }
}

#[test]
fn a_bouncing_switch_counts_once_it_is_quiet() {
    for config in configs(1) {
        let mut rig = rig(&config);
        rig.world().axes[0].chatter = 30;
        let (_, way) = home(&mut rig);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        // 30 ms of chatter at 15 rad/s, then three samples and the braking distance.
        let lowest = way.iter().copied().fold(f64::MAX, f64::min);
        assert!((-1.2..-0.7).contains(&lowest), "{lowest}");
    }
}

#[test]
fn axes_of_one_order_search_together_and_orders_one_after_the_other() {
    for config in configs(3) {
        let mut config = config;
        config.effectors[0].axes[0].homing_order = 1;
        let mut rig = rig(&config);
        rig.order(Order::Disable);
        rig.run(200);
        rig.world().axes[2].state.position = 6.0;
        rig.order(Order::Enable);
        rig.run(20);
        rig.order(Order::Home);
        let mut waited = true;
        for _ in 0..20_000 {
            rig.run(1);
            let world = rig.world();
            let homed: Vec<bool> = world.axes.iter().map(|axis| axis.state.homing == Homing::Attained).collect();
            waited &= homed[1] && homed[2] || (world.axes[0].state.position - 10.0).abs() < 0.05;
            drop(world);
            if rig.phase() != Phase::Homing {
                break;
            }
        }
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        assert!(waited, "axis 0 moved before its turn");
        let all: Vec<_> = rig.servo.homing_offsets(0).map(Option::unwrap).collect();
        assert!(all.iter().all(|offset| (1995..=2005).contains(offset)), "{all:?}");
    }
}

#[test]
fn an_axis_that_kept_its_reference_is_not_searched_again() {
    for config in configs(2) {
        let mut rig = rig(&config);
        rig.world().axes[0].state.homing = Homing::Attained;
        rig.run(5);
        let (_, way) = home(&mut rig);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        assert!(way.iter().all(|at| (at - 10.0).abs() < 0.01), "it moved");
        let offsets: Vec<_> = rig.servo.homing_offsets(0).collect();
        assert_eq!(offsets[0], None);
        assert!(offsets[1].is_some());
    }
}

#[test]
fn a_stop_anywhere_in_the_search_is_a_ramp() {
    for config in configs(1) {
        for after in [100, 700, 850, 900, 1000, 1300] {
            let mut rig = rig(&config);
            rig.order(Order::Home);
            let mut way = Vec::new();
            let mut set = 0.0;
            for cycle in 0..3000 {
                if cycle == after {
                    rig.order(Order::Stop);
                }
                let before = rig.world().axes[0].state.homing;
                rig.run(1);
                let drive = rig.world().axes[0].clone();
                if before != drive.state.homing && drive.state.homing == Homing::Attained {
                    set = drive.index;
                }
                way.push(drive.state.position + set);
            }
            assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
            for three in way.windows(3) {
                let acceleration = (three[2] - 2.0 * three[1] + three[0]) / (DT * DT);
                assert!(acceleration.abs() < 1000.0, "{acceleration} rad/s² after {after}");
            }
            let rest = &way[2000..];
            assert!(rest.iter().all(|at| (at - rest[0]).abs() < 0.01));
            // Afterwards the axis homes, if it has no reference.
            home(&mut rig);
            assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
            assert_eq!(rig.world().axes[0].state.homing, Homing::Attained);
        }
    }
}

#[test]
fn power_stays_on_while_a_search_brakes_however_slowly() {
    for mut config in configs(1) {
        config.effectors[0].axes[0].homing = Some(HostHoming { acceleration: 10.0, ..HOMING });
        let mut rig = rig(&config);
        rig.order(Order::Home);
        rig.run(1000);
        rig.order(Order::Disable);
        rig.run_until_off();
        assert_eq!(rig.cause(), None);
        let drive = rig.world().axes[0].clone();
        assert!(drive.state.velocity.abs() < 1.0, "{} rad/s", drive.state.velocity);
    }
}

#[test]
fn a_drive_fault_ends_the_search_of_every_axis() {
    for config in configs(2) {
        let mut rig = rig(&config);
        rig.order(Order::Home);
        rig.run(300);
        rig.world().axes[1].state.fault = Some(FAULT);
        rig.run_until(Phase::Stopping);
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::Drive(FAULT)));
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
    }
}

#[test]
fn an_encoder_that_fails_in_a_search_may_be_watched_in_motion_alone() {
    for mut config in configs(2) {
        config.effectors[0].axes[1].frozen = FrozenWatch::Following;
        let mut rig = rig(&config);
        rig.order(Order::Home);
        rig.run(300);
        rig.world().axes[1].runs_at = Some(0.0);
        rig.run(8);
        assert_eq!((rig.phase(), rig.cause()), (Phase::Homing, None));
    }
}

#[test]
fn an_encoder_that_fails_in_a_search_takes_the_power_of_its_axis_alone() {
    for config in configs(2) {
        let mut rig = rig(&config);
        rig.order(Order::Home);
        rig.run(300);
        assert_eq!(rig.phase(), Phase::Homing, "{:?}", rig.cause());
        rig.world().axes[1].runs_at = Some(0.0);
        rig.run(8);
        assert_eq!(rig.phase(), Phase::Stopping);
        assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), "{:?}", rig.cause());
        assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
        let sent = rig.last_sent();
        assert_eq!(sent[1], AxisCommand::Off);
        assert!(matches!(sent[0], AxisCommand::Follow(_)), "the other axis brakes: {sent:?}");
        rig.run_until(Phase::Faulted);
    }
}
