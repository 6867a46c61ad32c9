//! An emulated network camera: a small grey picture of a scene, as the bytes of its frames.
//!
//! The picture is that of a pinhole: one ray per pixel to the first surface of the scene. The ray
//! goes through a random point of the pixel, so that the edge of a surface within a pixel is seen in proportion to its area in
//! the mean. The frame of the camera has x to the right, y downward and z along the view. A lamp beside the lens lights the
//! surfaces: the grey level is proportional to the reflectance of the surface, to the cosine between ray and normal, and
//! to the exposure, plus noise. Planes and belts are dark, blocks and bodies are bright. A ray without a surface is
//! black. Not modelled: motion during the exposure, distortion and blur of the lens, shadows, and tools and links of
//! robots. [`serial::camera`] has the frames.

use std::time::Duration;

use can::Instant;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serial::camera::{FrameHeader, FrameKind, MAX_SIDE, checksum};
use thiserror::Error;

use crate::plant::Noise;
use crate::scene::View;

/// Exposure at which a white surface that faces the camera has the greatest grey level.
pub const WHITE: Duration = Duration::from_millis(5);

/// Reflectance of planes and belts.
const DARK: f64 = 0.2;

/// Reflectance of blocks and bodies.
const BRIGHT: f64 = 0.8;

/// Configuration of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraConfig {
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Angle between the left and the right edge of the picture, rad.
    pub field_of_view: f64,
    /// Period of the pictures.
    pub period: Duration,
    /// Duration of an exposure.
    pub exposure: Duration,
    /// Standard deviation of the noise of a pixel, grey levels.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Whether one bit of each frame is wrong.
    pub garbled: bool,
}

/// Reasons why the configuration of a camera is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum CameraError {
    #[error("the camera has {width} × {height} pixels, each side must have 1 to 1024")]
    Size { width: u16, height: u16 },
    #[error("the field of view is {angle} rad, it must be above 0 and below π")]
    FieldOfView { angle: f64 },
    #[error(
        "a picture every {period:?} with {exposure:?} of exposure: the exposure must be above 0 and within the period, the period at most 4 s"
    )]
    Timing { period: Duration, exposure: Duration },
    #[error("the noise is {noise} grey levels, it must be 0 or above, and finite")]
    Noise { noise: f64 },
}

/// A network camera.
#[derive(Debug)]
pub struct Camera {
    config: CameraConfig,
    view: View,
    /// Frame of the camera in the world.
    pose: Isometry3<f64>,
    noise: Noise,
    sequence: u32,
    pixels: Vec<u8>,
}

impl Camera {
    /// A camera at `pose` in the world of `view`.
    pub fn new(config: CameraConfig, view: View, pose: Isometry3<f64>) -> Result<Self, CameraError> {
        let CameraConfig { width, height, field_of_view: angle, period, exposure, noise, seed, .. } = config;
        let sides = 1..=MAX_SIDE;
        if !(sides.contains(&width) && sides.contains(&height)) {
            return Err(CameraError::Size { width, height });
        }
        if !(angle > 0.0 && angle < std::f64::consts::PI) {
            return Err(CameraError::FieldOfView { angle });
        }
        if exposure.is_zero() || exposure > period || period > Duration::from_secs(4) {
            return Err(CameraError::Timing { period, exposure });
        }
        if !(noise >= 0.0 && noise.is_finite()) {
            return Err(CameraError::Noise { noise });
        }
        let pixels = vec![0; usize::from(width) * usize::from(height)];
        Ok(Self { config, view, pose, noise: Noise::new(seed), sequence: 0, pixels })
    }

    /// The configuration.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Appends the greeting to `into`.
    pub fn greet(&self, into: &mut Vec<u8>) {
        self.append(self.header(FrameKind::Greeting, Instant::ZERO), into);
    }

    /// Takes a picture of the present places, and appends its frame to `into`. `now`: the middle of the exposure, since
    /// the camera was switched on.
    pub fn expose(&mut self, now: Instant, into: &mut Vec<u8>) {
        self.render();
        let header = FrameHeader {
            sequence: self.sequence,
            pixels_crc: checksum(&self.pixels),
            ..self.header(FrameKind::Picture, now)
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.append(header, into);
        into.extend_from_slice(&self.pixels);
    }

    fn append(&self, header: FrameHeader, into: &mut Vec<u8>) {
        let mut bytes = header.encode();
        bytes[0] ^= u8::from(self.config.garbled);
        into.extend_from_slice(&bytes);
    }

    fn header(&self, kind: FrameKind, now: Instant) -> FrameHeader {
        let CameraConfig { width, height, period, exposure, .. } = self.config;
        // The check of the configuration limits both to 32 bits.
        let [exposure_ns, period_ns] = [exposure, period].map(|time| time.as_nanos() as u32);
        let pixels_crc = checksum(&[]);
        FrameHeader { kind, sequence: 0, width, height, exposed_ns: now.as_nanos(), exposure_ns, period_ns, pixels_crc }
    }

    fn render(&mut self) {
        let CameraConfig { width, height, field_of_view, exposure, noise, .. } = self.config;
        let centre = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        let focal_length = centre[0] / (field_of_view / 2.0).tan();
        let origin = self.pose * Point3::origin();
        let white = 255.0 * exposure.as_secs_f64() / WHITE.as_secs_f64();
        let places = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        for (pixel, (column, row)) in self.pixels.iter_mut().zip(places) {
            let [right, down] = [(); 2].map(|()| 0.5 + 0.5 * self.noise.symmetric());
            let x = (f64::from(column) + right - centre[0]) / focal_length;
            let y = (f64::from(row) + down - centre[1]) / focal_length;
            let along = Unit::new_normalize(self.pose.rotation * Vector3::new(x, y, 1.0));
            let grey = self.view.ray(&origin, &along).map_or(0.0, |hit| {
                let reflectance = if self.view.is_ground(hit.surface) { DARK } else { BRIGHT };
                white * reflectance * hit.normal.dot(&-along.into_inner()).max(0.0)
            });
            *pixel = (grey + noise * self.noise.normal()).round().clamp(0.0, 255.0) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use serial::camera::HEADER;

    use super::*;
    use crate::Scene;
    use crate::scene::{Material, Shape, WallConfig};

    const CONFIG: CameraConfig = CameraConfig {
        width: 40,
        height: 30,
        field_of_view: 1.0,
        period: Duration::from_millis(100),
        exposure: WHITE,
        noise: 0.0,
        seed: 1,
        garbled: false,
    };

    /// A floor at z = 0 and a block of 0.1 × 0.2 × 0.1 m on it, 0.05 m along x and 0.1 m along -y.
    fn view() -> View {
        let mut scene = Scene::new();
        let material = Material::NOMINAL;
        let floor = WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material };
        let block = WallConfig {
            shape: Shape::Box { half: [0.05, 0.1, 0.05] },
            pose: Isometry3::translation(0.05, -0.1, 0.05),
            material,
        };
        scene.add_wall(&floor).unwrap();
        scene.add_wall(&block).unwrap();
        scene.view()
    }

    /// One metre above the floor, x of the picture along x, and y of the picture along -y.
    fn above() -> Isometry3<f64> {
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        Isometry3::from_parts(Point3::new(0.0, 0.0, 1.0).into(), down)
    }

    fn picture(config: CameraConfig, view: View) -> Vec<u8> {
        let mut bytes = Vec::new();
        Camera::new(config, view, above()).unwrap().expose(Instant::from_nanos(7), &mut bytes);
        let header = FrameHeader::decode(bytes[..HEADER].try_into().unwrap()).unwrap();
        assert_eq!((header.kind, header.exposed_ns, header.pixels()), (FrameKind::Picture, 7, 1200));
        assert_eq!(header.pixels_crc, checksum(&bytes[HEADER..]));
        bytes[HEADER..].to_vec()
    }

    #[test]
    fn block_is_bright_where_the_pinhole_has_it() {
        let pixels = picture(CONFIG, view());
        let focal_length = 20.0 / 0.5_f64.tan();
        for (number, grey) in pixels.iter().enumerate() {
            let x = ((number % 40) as f64 + 0.5 - 20.0) / focal_length;
            let y = ((number / 40) as f64 + 0.5 - 15.0) / focal_length;
            // The upper face is 0.9 m from the pinhole, to the right and below. A ray may be half a pixel from the middle.
            let within = |place: f64, end: f64| {
                let beyond = (0.9 * place - end / 2.0).abs() - end / 2.0;
                let half = 0.9 * 0.5 / focal_length;
                if beyond > half {
                    Some(false)
                } else if beyond < -half {
                    Some(true)
                } else {
                    None
                }
            };
            let on_face = match (within(x, 0.1), within(y, 0.2)) {
                (Some(true), Some(true)) => true,
                (Some(false), _) | (_, Some(false)) => false,
                _ => continue,
            };
            let cosine = 1.0 / (1.0 + x * x + y * y).sqrt();
            let expected = 255.0 * cosine * if on_face { BRIGHT } else { DARK };
            // The camera sees no side of the block.
            assert!((f64::from(*grey) - expected).abs() < 3.0, "pixel {number}: {grey}, not {expected}");
        }
        assert!(pixels.iter().filter(|grey| **grey > 128).count() > 20);
    }

    #[test]
    fn grey_level_grows_with_the_exposure_up_to_white_and_is_repeatable() {
        let at = |exposure, noise| picture(CameraConfig { exposure, noise, ..CONFIG }, view());
        let (half, full, bright) = (at(WHITE / 2, 0.0), at(WHITE, 0.0), at(WHITE * 4, 0.0));
        let brightest = |pixels: &[u8]| pixels.iter().copied().max().unwrap();
        assert!(brightest(&full).abs_diff(2 * brightest(&half)) <= 2, "the same rays");
        assert_eq!(brightest(&bright), 255);
        assert_eq!(at(WHITE, 3.0), at(WHITE, 3.0));
        assert_ne!(at(WHITE, 3.0), full);
        assert!(picture(CONFIG, View::EMPTY).iter().all(|grey| *grey == 0));
    }

    #[test]
    fn impossible_cameras_are_refused() {
        let refused = |config| Camera::new(config, View::EMPTY, above()).unwrap_err();
        assert_eq!(refused(CameraConfig { width: 0, ..CONFIG }), CameraError::Size { width: 0, height: 30 });
        assert_eq!(refused(CameraConfig { field_of_view: 4.0, ..CONFIG }), CameraError::FieldOfView { angle: 4.0 });
        assert_eq!(refused(CameraConfig { noise: -1.0, ..CONFIG }), CameraError::Noise { noise: -1.0 });
        let period = Duration::from_millis(1);
        assert_eq!(refused(CameraConfig { period, ..CONFIG }), CameraError::Timing { period, exposure: WHITE });
    }
}
