//! Places of boxes from computed echoes with noise, losses and outliers.

use nalgebra::{Isometry2, Point2, Vector2};

use super::*;
use crate::random::Random;

const SIZE: [f64; 3] = [0.08, 0.06, 0.05];
const DISTANCE: f64 = 0.3;

fn config() -> MatrixConfig {
    MatrixConfig {
        size: 12,
        scan: ScanKind::Rows,
        pitch: 0.02,
        half_cone: 8.0_f64.to_radians(),
        speed_of_sound: 343.0,
        deviation: 1e-3,
        base_from_matrix: Pose::identity(),
    }
}

/// Random numbers of a test. Box-Muller gives the noise.
struct Dice(Random);

impl Dice {
    fn of(seed: u64) -> Self {
        Self(Random(seed))
    }

    fn share(&mut self) -> f64 {
        self.0.within(0.0, 1.0)
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.share().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.share()).cos()
    }
}

/// A situation in front of the matrix.
#[derive(Clone, Copy)]
struct Case {
    x: f64,
    y: f64,
    yaw: f64,
    scans: usize,
    noise: f64,
    lost: f64,
    /// Share of the echoes with a wrong time.
    wrong: f64,
}

/// Echoes of a box.
fn echoes(case: &Case, dice: &mut Dice) -> Echoes {
    let config = config();
    let pose = Isometry2::new(Vector2::new(case.x, case.y), case.yaw);
    let mut echoes = Echoes::default();
    for row in 0..12 {
        for column in 0..12 {
            let place = [column, row].map(|number| (f64::from(number) - 5.5) * config.pitch);
            let local = pose.inverse_transform_point(&Point2::from(place)).coords.abs();
            let beyond = (local - Vector2::new(SIZE[0], SIZE[1]) / 2.0).map(|part| part.max(0.0)).norm();
            let seen = beyond <= DISTANCE * config.half_cone.tan();
            let truth = if seen { DISTANCE.hypot(beyond) } else { DISTANCE + SIZE[2] };
            let mut distances = Vec::new();
            for _ in 0..case.scans {
                let distance = truth + case.noise * dice.normal();
                if dice.share() < case.lost {
                    continue;
                }
                let wrong = dice.share() < case.wrong;
                let micros = (2.0 * if wrong { 0.1 + 0.4 * dice.share() } else { distance } / 343.0 * 1e6).round();
                distances.push(micros * 1e-6 * 343.0 / 2.0);
            }
            echoes.add(place, distances.into_iter(), SPREAD);
        }
    }
    echoes
}

const USUAL: Case = Case { x: 0.0, y: 0.0, yaw: 0.0, scans: 10, noise: 1e-3, lost: 0.1, wrong: 0.0 };

fn place(case: &Case, dice: &mut Dice) -> Result<fit::Fitted, EchoError> {
    fit::locate(&echoes(case, dice), &config(), SIZE, None)
}

#[test]
fn box_is_found_within_3_mm_with_one_echo_in_ten_lost() {
    let seed = 0x5EED_0001;
    let mut dice = Dice::of(seed);
    let (mut worst, mut squares) = (0.0_f64, 0.0);
    let cases = 300;
    for number in 0..cases {
        let mut within = |half: f64| half * (2.0 * dice.share() - 1.0);
        let case = Case { x: within(0.05), y: within(0.05), yaw: within(1.5), ..USUAL };
        let found = place(&case, &mut dice).unwrap_or_else(|error| panic!("seed {seed:#x}, case {number}: {error}"));
        let error = (found.x - case.x).hypot(found.y - case.y);
        squares += error * error;
        worst = worst.max(error);
        assert!((found.distance - DISTANCE).abs() < 1e-3, "case {number}: {} m", found.distance);
        assert!(found.residual < 1e-3, "case {number}: {} m", found.residual);
    }
    println!("rms {:.2} mm, worst {:.2} mm", 1e3 * (squares / f64::from(cases)).sqrt(), 1e3 * worst);
    assert!(worst < 3e-3, "seed {seed:#x}: {worst} m");
}

#[test]
fn a_box_is_found_from_its_last_place_also_after_it_was_moved() {
    let mut dice = Dice::of(0x5EED_0005);
    let (mut last, mut worst) = (None, 0.0_f64);
    for number in 0..200 {
        // The box moves every fifth time.
        let place = Dice::of(1 + number / 5).0.within(-0.05, 0.05);
        let case = Case { x: place, y: -0.5 * place, yaw: 30.0 * place, ..USUAL };
        let found = fit::locate(&echoes(&case, &mut dice), &config(), SIZE, last.as_ref()).unwrap();
        worst = worst.max((found.x - case.x).hypot(found.y - case.y));
        last = Some(found);
    }
    assert!(worst < 3e-3, "{worst} m");
}

#[test]
fn wrong_echoes_are_excluded_as_outliers() {
    let mut dice = Dice::of(0x5EED_0002);
    for number in 0..50 {
        let case = Case { x: 0.013, y: -0.027, yaw: 0.4, wrong: 0.02, ..USUAL };
        let echoes = echoes(&case, &mut dice);
        assert!(echoes.outliers > 0);
        let found = fit::locate(&echoes, &config(), SIZE, None).unwrap();
        let error = (found.x - case.x).hypot(found.y - case.y);
        assert!(error < 3e-3, "case {number}: {error} m");
    }
}

#[test]
fn stated_deviation_is_that_of_the_errors() {
    let mut dice = Dice::of(0x5EED_0003);
    let (mut sum, mut stated, cases) = (0.0, 0.0, 200);
    for _ in 0..cases {
        let case = Case { x: 0.01 * dice.share(), y: 0.01 * dice.share(), yaw: dice.share(), ..USUAL };
        let found = place(&case, &mut dice).unwrap();
        sum += ((found.x - case.x).powi(2) + (found.y - case.y).powi(2)) / f64::from(cases);
        stated += (found.deviation[0].powi(2) + found.deviation[1].powi(2)) / f64::from(cases);
    }
    let ratio = (sum / stated).sqrt();
    println!("{:.2} mm rms, {ratio:.2} of the stated deviation", 1e3 * sum.sqrt());
    assert!((0.3..2.0).contains(&ratio), "{ratio}");
}

#[test]
fn readings_without_a_place_are_typed_errors() {
    let mut dice = Dice::of(0x5EED_0004);
    let lost = place(&Case { lost: 0.97, scans: 1, ..USUAL }, &mut dice).unwrap_err();
    assert!(matches!(lost, EchoError::TooFewEchoes { found: ..72, elements: 144, needed: 72 }), "{lost}");
    let away = place(&Case { x: 0.5, ..USUAL }, &mut dice).unwrap_err();
    assert!(matches!(away, EchoError::NothingFound { .. }), "{away}");
    let lower = fit::locate(&echoes(&USUAL, &mut dice), &config(), [0.08, 0.06, 0.1], None).unwrap_err();
    assert!(matches!(lower, EchoError::NothingFound { height: 0.1, .. }), "{lower}");
    let longer = fit::locate(&echoes(&USUAL, &mut dice), &config(), [0.2, 0.02, 0.05], None).unwrap_err();
    assert!(matches!(longer, EchoError::Unlike { .. } | EchoError::Uncertain { .. }), "{longer}");
    assert_eq!(EchoError::NoScan { found: 1, needed: 10 }.to_string(), "1 of 10 scans: wait for the next scan");
}

#[test]
fn locator_waits_for_its_scans_and_reports_the_fault_of_the_matrix() {
    let scan_time = Duration::from_millis(100);
    let (mut matrix, link) = drive::ultrasonic::RehearsedUltrasonic::new(scan_time);
    let mut locator = BoxLocator::new(link, config(), SIZE, 3);
    let mut now = Instant::ZERO;
    let mut read = |locator: &mut BoxLocator, matrix: &mut drive::ultrasonic::RehearsedUltrasonic| {
        now += scan_time;
        matrix.advance(now);
        locator.read().1.result()
    };
    for found in 1..3 {
        assert_eq!(read(&mut locator, &mut matrix), Err(EchoError::NoScan { found, needed: 3 }));
    }
    // A rehearsed matrix receives no echo.
    let empty = EchoError::TooFewEchoes { found: 0, elements: 144, needed: 72 };
    assert_eq!(read(&mut locator, &mut matrix), Err(empty));
    assert_eq!(locator.poll(Instant::ZERO).unwrap().1.place(), Err(GeneratorError::Echo(empty)));
}

#[test]
fn a_box_is_found_from_the_echoes_that_each_element_receives_of_its_own_emission() {
    let scan_time = Duration::from_millis(100);
    // One row and one column of 4 × 4 elements, 40 mm apart, receive the echo of the floor.
    let centre = [0.03, -0.02];
    let own = |row: usize, column: usize| {
        let place = [column, row].map(|number| 0.04 * (number as f64 - 1.5));
        let [x, y] = [0, 1].map(|axis| ((place[axis] - centre[axis]).abs() - SIZE[axis] / 2.0).max(0.0));
        let beyond = x.hypot(y);
        let is_seen = beyond <= DISTANCE * config().half_cone.tan();
        let distance = if is_seen { DISTANCE.hypot(beyond) } else { DISTANCE + SIZE[2] };
        Duration::from_secs_f64(2.0 * distance / 343.0)
    };
    let [by_rows, by_pairs] = [ScanKind::Rows, ScanKind::Pairs].map(|scan| {
        let (mut matrix, link) = drive::ultrasonic::RehearsedUltrasonic::new(scan_time);
        let config = MatrixConfig { size: 4, pitch: 0.04, scan, deviation: 2e-4, ..config() };
        let mut locator = BoxLocator::new(link, config, SIZE, 1);
        matrix.scan(Instant::ZERO + scan_time, |shot, number| match scan {
            ScanKind::Rows => (shot < 4 && number < 4).then(|| own(shot, number)),
            ScanKind::Pairs if shot == number => Some(own(shot / 4, shot % 4)),
            // An echo between two elements.
            ScanKind::Pairs => Some(Duration::from_millis(1)),
        });
        locator.read().1.result()
    });
    let place = by_rows.unwrap();
    assert!((place.position - Point3::new(centre[0], centre[1], DISTANCE)).norm() < 3e-3, "{place:?}");
    assert_eq!((place.used, by_pairs), (16, by_rows));
}
