//! Polynomial motions: closed forms of their durations, limits and ends.

use super::*;

#[test]
fn polynomials_take_the_closed_form_time_keep_their_limits_and_end_exactly() {
    for seed in 0..5_000 {
        let mut random = Random(seed);
        let axes = 1 + random.below(6);
        let limits = random_limits(&mut random);
        let (start, target) = (random.axes(-2.0, 2.0), random.axes(-2.0, 2.0));
        let cubic = seed % 2 == 0;
        let mut time: f64 = 0.0;
        for axis in 0..axes {
            let d = (target[axis] - start[axis]).abs();
            let (v, a, j) = (limits.max_velocity[axis], limits.max_acceleration[axis], limits.max_jerk[axis]);
            let times = if cubic {
                [1.5 * d / v, (6.0 * d / a).sqrt(), (12.0 * d / j).cbrt()]
            } else {
                [1.875 * d / v, (5.773_502_691_896_258 * d / a).sqrt(), (60.0 * d / j).cbrt()]
            };
            time = times.into_iter().fold(time, f64::max);
        }
        let made = if cubic { Polynomial::cubic } else { Polynomial::quintic };
        let states = walk(made(Space::Joint, axes, limits, target).unwrap(), &Standing::at(start)).unwrap();
        assert_eq!(states.len() - 1, (time / MC - 1e-9).ceil() as usize, "seed {seed}");
        let end = states.last().unwrap();
        assert_eq!((&end.position[..axes], end.velocity), (&target[..axes], Axes::default()), "seed {seed}");
        let macrosteps = states.windows(2).len();
        for (number, pair) in states.windows(2).enumerate() {
            let inner = number > 0 && number + 1 < macrosteps;
            for axis in 0..axes {
                let (speed, push) = peaks(knot(&pair[0], axis), knot(&pair[1], axis));
                assert!(speed <= limits.max_velocity[axis] * (1.0 + 1e-9), "seed {seed}: {speed}");
                // The servo smooths the jumps of a cubic's acceleration over the first and the last macrostep.
                let room = if cubic && !inner { 1.5 } else { 1.0 + 1e-9 };
                assert!(push <= limits.max_acceleration[axis] * room, "seed {seed}: {push}");
            }
        }
    }
}

#[test]
fn a_polynomial_that_is_too_short_or_not_finite_is_refused() {
    let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
    let motion = Polynomial::quintic(Space::Joint, 1, limits, [1.0; 8]).unwrap();
    let lasting = |seconds| walk(motion.clone().lasting(Duration::from_secs_f64(seconds)), &Standing::at([0.0; 8]));
    assert!(matches!(lasting(1.8), Err(GeneratorError::TooShort { given: 1.8, .. })));
    assert_eq!(lasting(3.0).unwrap().len() - 1, 150);
    let wrong = Polynomial::cubic(Space::Joint, 1, limits, [f64::NAN; 8]).unwrap_err();
    assert_eq!(wrong, GeneratorError::NotFinite { pose: 0, axis: 0 });
    assert!(Polynomial::cubic(Space::Joint, 0, limits, [0.0; 8]).is_err());
}
