//! Cycle laws in teams.

use super::*;
use crate::servo::tests::laws::{Scripted, all, with_law};
use crate::{LawBound, LawOutput};

/// A team of two, of which the first has a law.
fn tied(output: fn(u32, f64) -> LawOutput, steps: &[Macrostep]) -> Cell {
    let bound = LawBound { displacement: 5.0, speed: 50.0 };
    let mut cell = Cell::prepared(&scripted::config(1), &[MAX_ACCELERATION, 800.0], |servo| {
        servo.install_law(0, Scripted::law(output), &[bound]).unwrap();
    });
    cell.order_all(Order::Tie { members: 0b11 });
    for step in steps {
        cell.order(0, Order::Move(with_law(*step, 0.0)));
        cell.order(1, Order::Move(*step));
    }
    cell
}

#[test]
fn a_touch_or_a_fault_of_a_law_stops_all_members_in_its_cycle() {
    type Case = (fn(u32, f64) -> LawOutput, [Phase; 2], StopCause);
    let cases: [Case; 2] = [
        (|call, _| if call < 57 { all(0.0) } else { LawOutput::Touched }, [Phase::Standing; 2], StopCause::Touched),
        (
            |call, _| if call < 57 { all(0.0) } else { all(f64::NAN) },
            [Phase::Faulted, Phase::Standing],
            StopCause::NotFinite,
        ),
    ];
    for (output, ends, cause) in cases {
        let mut cell = tied(output, &motion(1.0, 10));
        cell.run(56);
        assert_eq!(cell.phases(), [Phase::Moving; 2]);
        let step = cell.position(1);
        cell.run(1);
        assert_eq!(cell.phases(), [Phase::Stopping; 2], "{cause:?}");
        // 16 rad/s at 800 rad/s²: 20 periods, the first of which is in this cycle.
        assert!((cell.position(1) - step - 0.016 * (19.0 / 20.0)).abs() < 1e-9);
        while cell.phases() == [Phase::Stopping; 2] {
            assert!((cell.position(0) - cell.position(1)).abs() < 1e-9, "in proportion");
            cell.run(1);
        }
        cell.run(100);
        assert_eq!(cell.phases(), ends);
        assert_eq!(cell.servo.fault(0).map(|fault| fault.cause), Some(cause));
        assert_eq!(cell.servo.fault(1), partner(0));
    }
}

#[test]
fn a_law_that_still_moves_at_the_end_does_not_dissolve_the_team() {
    // 20 rad/s at the end of the motion.
    let fast = |call: u32, _: f64| all(0.5 * 500.0 * (f64::from(call.min(40)) * DT).powi(2));
    let rest: Vec<_> = (1..=4).map(|number| macrostep(number, 10, 0.0, 0.0)).collect();
    let mut cell = tied(fast, &rest);
    cell.run(41);
    assert_eq!(cell.phases(), [Phase::Stopping, Phase::Standing]);
    assert_eq!([0, 1].map(|member| cell.servo.team_state(member)), [Some(TeamState::Settling); 2]);
    cell.run(30);
    assert_eq!([0, 1].map(|member| cell.servo.team_state(member)), [Some(TeamState::Tied); 2]);
    assert_eq!(cell.phases(), [Phase::Standing; 2]);
    assert_eq!((cell.servo.fault(0), cell.servo.fault(1)), (None, None));
    let at = cell.position(0);
    cell.order(0, Order::Move(macrostep(5, 10, at, 0.0)));
    cell.order(1, Order::Move(macrostep(5, 10, 0.0, 0.0)));
    cell.run(2);
    assert_eq!(cell.phases(), [Phase::Moving; 2]);
    assert_eq!(cell.team_macrosteps(), [5, 5], "the team is still tied");
}
