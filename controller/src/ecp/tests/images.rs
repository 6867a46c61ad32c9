//! Images of the effector: what they show, and of which time.

use std::sync::mpsc::{Sender, channel};

use super::*;

/// Sends the image of its first step, and the image of each next step until the third.
pub(super) struct Look(pub(super) Sender<EffectorImage>);

impl Generator for Look {
    type First = EffectorImage;
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<u32>, GeneratorError> {
        self.0.send(*e).unwrap();
        Ok(Next::remember(0))
    }

    fn terminal(&self, steps: &u32, _: &EffectorImage) -> bool {
        *steps == 3
    }

    fn next_step(&self, steps: &u32, e: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        self.0.send(*e).unwrap();
        Ok(Next::command(Setpoint::JointsBy(AxesState::default()), steps + 1))
    }
}

#[test]
fn a_first_step_sees_the_last_cycle_and_no_old_report() {
    let mut bench = Bench::ready();
    let (sender, images) = channel();
    // The effector stands, so the servo reports nothing.
    for _ in 0..1_000 {
        bench.servo.period(bench.now);
        bench.servo.publish();
        bench.now += PERIOD;
    }
    bench.servo.latest_measured(0.25);
    let last = bench.now - PERIOD;
    assert_eq!(bench.run(Task::new().run(Look(sender))), finished(1));
    let seen: Vec<_> = images.iter().collect();
    assert_eq!((seen[0].read_at, seen[0].at), (last, last - PERIOD));
    assert_eq!(seen[0].measured.motors.position[0], 0.25);
    assert_eq!(
        seen[0].age,
        [PERIOD, PERIOD, PERIOD, Duration::ZERO, Duration::ZERO, Duration::ZERO, Duration::ZERO, Duration::ZERO]
    );
    assert_eq!(seen.len(), 4);
    // The images of each macrostep are read after 8 of 10 periods.
    for pair in seen[2..].windows(2) {
        assert_eq!(pair[1].macrostep, pair[0].macrostep + 1);
        assert_eq!(pair[1].read_at.since(pair[0].read_at), 10 * PERIOD);
        assert_eq!(pair[1].read_at.since(pair[1].at), PERIOD);
    }
}

#[test]
fn a_position_can_be_read_at_any_time_also_with_the_drives_off() {
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().disable()), finished(1));
    // Without set-points, the command of the past says nothing.
    bench.servo.report.snapshot.commanded = [77.0; MAX_AXES];
    for joint in [0.0, 0.5, -1.0] {
        bench.now += PERIOD;
        bench.servo.report.snapshot.at = bench.now;
        bench.servo.latest_measured(100.0 * joint);
        let image = bench.ecp.image().unwrap();
        assert_eq!((image.read_at, image.commanded), (bench.now, image.measured));
        assert!((image.measured.joints.position[0] - joint).abs() < 1e-12);
        assert!((image.measured.pose.translation.x - joint).abs() < 1e-12);
    }
}

#[test]
fn the_time_of_an_image_is_that_of_its_oldest_sample() {
    let mut bench = Bench::ready();
    bench.servo.report.snapshot.at = bench.now + 10 * PERIOD;
    bench.servo.report.snapshot.sampled = [bench.now + 9 * PERIOD; MAX_AXES];
    let snapshot = &mut bench.servo.report.snapshot;
    snapshot.sampled[1] = snapshot.at - 3 * PERIOD;
    snapshot.age[1] = 2;
    snapshot.torque[1] = 0.5;
    snapshot.switches[2].home = true;
    let (at, now) = (snapshot.sampled[1], snapshot.at);
    bench.servo.latest_measured(0.0);
    let image = bench.ecp.image().unwrap();
    assert_eq!((image.at, image.read_at), (at, now));
    assert_eq!(image.age[..3], [PERIOD, 3 * PERIOD, PERIOD]);
    assert_eq!((image.torque[1], image.switches[2].home), (0.5, true));
}
