//! Places of drawn objects.

use std::time::Duration;

use drive::camera::{CameraConfig, CameraReceiver, FrameHeader, FrameKind, checksum};

use super::*;

const WIDTH: u16 = 160;
const HEIGHT: u16 = 120;

/// A picture with a bright bar of 40 × 16 pixels on a dark ground with noise. Each pixel shows one random point of its
/// square, so that a pixel at an edge is bright with the probability of its covered share.
fn bar(centre: [f64; 2], angle: f64) -> Vec<u8> {
    let (sine, cosine) = angle.sin_cos();
    let mut random = crate::random::Random(0x5EED);
    let pixel = |number: u32| {
        let x = f64::from(number % u32::from(WIDTH)) + random.within(0.0, 1.0) - centre[0];
        let y = f64::from(number / u32::from(WIDTH)) + random.within(0.0, 1.0) - centre[1];
        let (along, across) = (x * cosine + y * sine, y * cosine - x * sine);
        let grey = if along.abs() <= 20.0 && across.abs() <= 8.0 { 180.0 } else { 50.0 };
        (grey + random.within(-12.0, 12.0)) as u8
    };
    (0..u32::from(WIDTH) * u32::from(HEIGHT)).map(pixel).collect()
}

fn search(pixels: &[u8]) -> Result<Blob, SightError> {
    BlobSearch::new(pixels.len()).brightest(pixels, WIDTH.into())
}

/// A camera 0.5 m above the origin, with x of the picture along x, and y of the picture along -y.
fn pinhole() -> Pinhole {
    let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let base_from_camera = Pose::from_parts(Point3::new(0.0, 0.0, 0.5).into(), down);
    Pinhole { width: WIDTH, height: HEIGHT, field_of_view: 2.0 * 0.5_f64.atan(), base_from_camera }
}

const FLOOR: ViewedPlane = ViewedPlane { point: Point3::new(0.0, 0.0, 0.0), normal: Vector3::new(0.0, 0.0, 2.0) };

#[test]
fn centroid_and_angle_of_a_bar_are_within_a_fifth_of_a_pixel_and_a_degree() {
    for (number, angle) in [-1.5, -0.8, -0.1, 0.0, 0.4, 1.2].into_iter().enumerate() {
        let centre = [70.3 + number as f64, 55.8];
        let blob = search(&bar(centre, angle)).unwrap();
        let error = (blob.centroid[0] - centre[0]).hypot(blob.centroid[1] - centre[1]);
        let turn = (blob.angle - angle).sin().abs().to_degrees();
        assert!(error < 0.2 && turn < 1.0, "{angle} rad: {error} pixels, {turn}°");
        assert!((blob.elongation - 2.5).abs() < 0.1 && blob.area.abs_diff(640) < 30, "{blob:?}");
    }
}

#[test]
fn brightest_of_several_areas_is_found() {
    let mut pixels = bar([100.0, 60.0], 0.0);
    for row in 10..15 {
        pixels[row * 160 + 10..row * 160 + 20].fill(255);
    }
    let blob = search(&pixels).unwrap();
    assert!((blob.centroid[0] - 100.0).abs() < 0.2, "{blob:?}");
}

#[test]
fn pictures_without_an_object_are_typed_errors() {
    let dark = bar([-100.0, -100.0], 0.0);
    assert!(matches!(search(&dark), Err(SightError::NoContrast { contrast: 0..30 })));
    assert_eq!(search(&[0; 19_200]), Err(SightError::NoContrast { contrast: 0 }));
    assert_eq!(search(&bar([10.0, 60.0], 0.0)), Err(SightError::AtEdge));
    let mut dot = vec![0; 19_200];
    dot[1700..1704].fill(255);
    assert_eq!(search(&dot), Err(SightError::TooSmall { area: 4 }));
}

#[test]
fn pixel_is_projected_onto_the_plane() {
    let camera = pinhole();
    assert!((camera.focal_length() - 160.0).abs() < 1e-9);
    // A pixel is 0.5 m / 160 wide on the floor.
    for (pixel, expected) in [([80.0, 60.0], [0.0, 0.0]), ([112.0, 60.0], [0.1, 0.0]), ([80.0, 28.0], [0.0, 0.1])] {
        let point = camera.project(pixel, &FLOOR).unwrap();
        assert!((point - Point3::new(expected[0], expected[1], 0.0)).norm() < 1e-9, "{pixel:?}: {point}");
    }
    let behind = ViewedPlane { point: Point3::new(0.0, 0.0, 1.0), ..FLOOR };
    let along = ViewedPlane { normal: Vector3::x(), ..FLOOR };
    let none = ViewedPlane { normal: Vector3::zeros(), ..FLOOR };
    for plane in [behind, along, none] {
        assert_eq!(camera.project([80.0, 60.0], &plane), None, "{plane:?}");
    }
}

#[test]
fn finder_waits_for_a_picture_exposed_after_its_making_and_reports_the_fault() {
    let period = Duration::from_millis(100);
    let config = CameraConfig { width: WIDTH, height: HEIGHT, period, tolerated_missing: 1 };
    let (mut receiver, link) = CameraReceiver::new(config);
    let mut finder = BlobFinder::new(link, pinhole(), FLOOR);
    let pixels = bar([112.0, 60.0], 0.0);
    let send = |receiver: &mut CameraReceiver, sequence: u32, now: Instant| {
        let header = FrameHeader {
            kind: FrameKind::Picture,
            sequence,
            width: WIDTH,
            height: HEIGHT,
            exposed_ns: 0,
            exposure_ns: 1,
            period_ns: 100_000_000,
            pixels_crc: checksum(&pixels),
        };
        receiver.receive(&header.encode(), now);
        receiver.receive(&pixels, now);
    };
    let at = |millis| Instant::ZERO + Duration::from_millis(millis);
    assert_eq!(finder.read(at(0)).1.result(), Err(SightError::NoPicture));
    send(&mut receiver, 0, at(100));
    assert_eq!(finder.read(at(100)).1.result(), Err(SightError::NoPicture));
    send(&mut receiver, 1, at(200));
    let (time, reading) = finder.read(at(202));
    let place = reading.place().unwrap();
    assert!((time, place.sequence) == (at(202), 1));
    assert!((place.position - Point3::new(0.1, 0.0, 0.0)).norm() < 1e-3, "{place:?}");
    assert!(place.direction.x.abs() > 0.999, "{place:?}");
    assert_eq!(finder.read(at(250)), (time, reading));
    receiver.tick(at(500));
    let fault = CameraFault::Silent { age: Duration::from_millis(300) };
    assert_eq!(finder.poll(at(502)).unwrap().1.place(), Err(GeneratorError::Sight(SightError::Camera(fault))));
}
