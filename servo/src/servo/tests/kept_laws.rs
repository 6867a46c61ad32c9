//! Cycle laws that keep their displacement from one motion to the next.

use super::laws::{all, with_law};
use super::*;
use crate::{CycleLaw, LawBound, LawFault, LawInput, LawOutput, LawParameters};

/// A law that accelerates all motors to a velocity, rad/s, and keeps its displacement if its first parameter is not zero.
struct Drift {
    most: f64,
    velocity: f64,
}

impl CycleLaw for Drift {
    fn check(&self, _: &LawParameters) -> Result<(), LawFault> {
        Ok(())
    }
    fn keeps(&self, parameters: &LawParameters) -> bool {
        parameters.0[0] != 0.0
    }
    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {
        self.velocity = 0.0;
    }
    fn shift(&mut self, input: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        self.velocity = (self.velocity + 500.0 * DT).min(self.most);
        all(input.axes[0].displacement + self.velocity * DT)
    }
}

/// A rig after a motion of axis 0 to 0.005 rad under a law with the parameter `keeps`.
fn displaced(velocity: f64, keeps: f64) -> Rig {
    let mut rig = Rig::new(1);
    let law = Box::new(Drift { most: velocity, velocity: 0.0 });
    rig.servo.install_law(0, law, &[LawBound { displacement: 5.0, speed: 50.0 }]).unwrap();
    let mut rig = rig.stand();
    rig.order(Order::Move(with_law(macrostep(1, 40, 0.005, 0.0), keeps)));
    rig.run_until(Phase::Moving);
    rig.run_until(Phase::Standing);
    assert_eq!(rig.cause(), None);
    rig
}

/// Commanded position less the displacement, and the displacement, rad.
fn path(rig: &Rig) -> (f64, f64) {
    let snapshot = rig.link.latest.read();
    (snapshot.commanded[0] - snapshot.displacement[0], snapshot.displacement[0])
}

fn continues(macrostep: Macrostep) -> Macrostep {
    Macrostep { continues_law: true, ..macrostep }
}

#[test]
fn a_law_that_keeps_its_displacement_continues_the_path_in_the_next_motion() {
    // The second velocity is braked to a stand beside the end of the path.
    for velocity in [0.5, 5.0] {
        let mut rig = displaced(velocity, 1.0);
        let (end, kept) = path(&rig);
        assert!((end - 0.005).abs() < 1e-12 && kept > velocity * 30.0 * DT, "{velocity}: {end} {kept}");
        rig.run(100);
        assert_eq!(path(&rig), (end, kept), "nothing moves at a stand");
        rig.order(Order::Move(continues(with_law(macrostep(2, 40, 0.015, 0.0), 1.0))));
        rig.run_until(Phase::Moving);
        rig.run_until(Phase::Standing);
        let (end, more) = path(&rig);
        assert_eq!(rig.cause(), None);
        assert!((end - 0.015).abs() < 1e-12 && more > kept, "{velocity}: {end} {more}");
        keeps_limits(&rig.positions(0)).unwrap();
    }
}

#[test]
fn a_motion_that_does_not_continue_the_path_gives_up_the_displacement() {
    for law in [true, false] {
        let mut rig = displaced(0.5, 1.0);
        let at = rig.link.latest.read().commanded[0];
        let next = macrostep(2, 40, at, 0.0);
        rig.order(Order::Move(if law { with_law(next, 1.0) } else { next }));
        rig.run_until(Phase::Moving);
        let moved = rig.link.latest.read().displacement[0];
        assert!(moved <= 0.5 * DT + 1e-12, "{law}: {moved}");
        rig.run_until(Phase::Standing);
        assert_eq!((rig.cause(), (path(&rig).0 - at).abs() < 1e-12), (None, true), "{law}");
        keeps_limits(&rig.positions(0)).unwrap();
    }
}

#[test]
fn a_macrostep_that_continues_a_displacement_which_is_not_kept_is_refused() {
    let next = macrostep(2, 40, 0.015, 0.0);
    let stop: fn(&mut Rig) = |rig| {
        rig.order(Order::Stop);
        rig.run(2);
    };
    let none: fn(&mut Rig) = |_| {};
    let cases = [
        ("without a law", 1.0, none, next),
        ("another law", 1.0, none, with_law(next, 2.0)),
        ("a law that keeps nothing", 0.0, none, with_law(next, 0.0)),
        ("after a stop", 1.0, stop, with_law(next, 1.0)),
    ];
    for (name, keeps, between, next) in cases {
        let mut rig = displaced(0.5, keeps);
        between(&mut rig);
        if name != "without a law" && name != "another law" {
            assert_eq!(rig.link.latest.read().displacement[0], 0.0, "{name}");
        }
        rig.order(Order::Move(continues(next)));
        rig.run(3);
        assert_eq!(rig.cause(), Some(StopCause::Malformed { number: 2 }), "{name}");
    }
}
