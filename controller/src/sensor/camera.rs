//! A camera as a virtual sensor: centroid, orientation and place of the brightest object in the picture.
//!
//! The object is one bright area on a dark ground ([`blob`]). The ray through its centroid meets a plane that the task
//! declares, for example the upper face of a box of known height. The camera is a pinhole without distortion
//! ([`Pinhole`]).

mod blob;
#[cfg(test)]
mod tests;

use can::Instant;
use drive::camera::{CameraFault, CameraLink, Picture};
use nalgebra::{Point3, Vector3};
use thiserror::Error;

use super::VirtualSensor;
use crate::generator::{GeneratorError, SensorReading};
use crate::robot::Pose;
pub use blob::{Blob, BlobSearch, LEAST_AREA, LEAST_CONTRAST};

/// Least angle between a ray and its plane, as a sine.
const GRAZING: f64 = 0.05;

/// Why a picture gives no place of an object.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SightError {
    /// The camera or its connection has a fault.
    #[error("{0}")]
    Camera(CameraFault),
    /// No picture was exposed since the sensor was made.
    #[error("no picture yet: wait for the next one")]
    NoPicture,
    /// The picture has another size than declared.
    #[error("a picture of {width} × {height} pixels is not that of the camera")]
    Size {
        /// Columns.
        width: u16,
        /// Rows.
        height: u16,
    },
    /// The picture has no bright area on a dark ground.
    #[error(
        "nothing bright is in the picture: its bright pixels exceed the others by {contrast} grey levels, {} are needed",
        LEAST_CONTRAST
    )]
    NoContrast {
        /// Difference between the means of the bright and the dark pixels, grey levels.
        contrast: u8,
    },
    /// The brightest area is too small.
    #[error("the brightest area has {area} pixels, {} are needed", LEAST_AREA)]
    TooSmall {
        /// Pixels of the area.
        area: u32,
    },
    /// A part of the object may be outside the picture.
    #[error("the brightest area is at the edge of the picture: move the object into the view")]
    AtEdge,
    /// The ray through the centroid does not meet the plane.
    #[error("the ray through the object does not meet the plane, or is almost parallel to it")]
    BesidePlane,
}

/// A pinhole camera and its place. The frame of the camera has x to the right, y downward and z along the view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Angle between the left and the right edge of the picture, rad.
    pub field_of_view: f64,
    /// Frame of the camera in the base frame of the robot.
    pub base_from_camera: Pose,
}

/// A plane in the base frame of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewedPlane {
    /// A point of the plane, m.
    pub point: Point3<f64>,
    /// The normal, of any length but zero.
    pub normal: Vector3<f64>,
}

impl Pinhole {
    /// Distance of the picture from the pinhole, pixels.
    pub fn focal_length(&self) -> f64 {
        f64::from(self.width) / 2.0 / (self.field_of_view / 2.0).tan()
    }

    /// The point of `plane` that is seen at `pixel`, m, in the base frame of the robot. `pixel`: distance from the left
    /// and from the upper edge of the picture, pixels; the first pixel has its middle at 0.5. `None` if the ray does not
    /// meet the plane, or meets it at less than about 3°.
    pub fn project(&self, pixel: [f64; 2], plane: &ViewedPlane) -> Option<Point3<f64>> {
        let x = (pixel[0] - f64::from(self.width) / 2.0) / self.focal_length();
        let y = (pixel[1] - f64::from(self.height) / 2.0) / self.focal_length();
        let along = self.base_from_camera.rotation * Vector3::new(x, y, 1.0).normalize();
        let origin = self.base_from_camera * Point3::origin();
        let normal = plane.normal.try_normalize(f64::MIN_POSITIVE)?;
        let sine = along.dot(&normal);
        let distance = (plane.point - origin).dot(&normal) / sine;
        (sine.abs() >= GRAZING && distance > 0.0 && distance.is_finite()).then(|| origin + along * distance)
    }
}

/// Place of the brightest object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlobPlace {
    /// The object in the picture.
    pub blob: Blob,
    /// The point of the plane at the centroid of the object, m, in the base frame of the robot.
    pub position: Point3<f64>,
    /// Direction of the longer axis of the object in the plane, a unit vector in the base frame of the robot. The sign is
    /// not determined, and the direction of a round or square object is not either.
    pub direction: Vector3<f64>,
    /// Sequence number that the camera gave to the picture.
    pub sequence: u32,
}

/// Reading of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlobReading(Result<BlobPlace, SightError>);

impl SensorReading for BlobReading {}

impl BlobReading {
    /// The place of the object.
    pub fn place(&self) -> Result<BlobPlace, GeneratorError> {
        self.0.map_err(GeneratorError::Sight)
    }

    /// The place of the object, or the reason why there is none.
    pub fn result(&self) -> Result<BlobPlace, SightError> {
        self.0
    }
}

/// A camera that finds the brightest object.
///
/// Each picture is evaluated once, in the turn of the agent, without allocation. The time of a reading is the time at
/// which the sensor took the picture from its link: at most one turn after its arrival.
pub struct BlobFinder {
    link: CameraLink,
    pinhole: Pinhole,
    plane: ViewedPlane,
    search: BlobSearch,
    picture: Picture,
    /// Pictures up to this number may have been exposed before the sensor was made.
    before: u64,
    reading: Option<(Instant, BlobReading)>,
}

impl BlobFinder {
    /// A finder of an object whose visible face is in `plane`. A reading needs a picture that was exposed after this call.
    pub fn new(link: CameraLink, pinhole: Pinhole, plane: ViewedPlane) -> Self {
        let pixels = usize::from(pinhole.width) * usize::from(pinhole.height);
        // The next picture may be on its way.
        let before = link.number() + 1;
        let picture = Picture { pixels: Vec::with_capacity(pixels), ..Picture::default() };
        Self { link, pinhole, plane, search: BlobSearch::new(pixels), picture, before, reading: None }
    }

    /// The reading at `now`, and the time of its picture.
    pub fn read(&mut self, now: Instant) -> (Instant, BlobReading) {
        match self.link.take(&mut self.picture) {
            Err(fault) => {
                self.reading = None;
                return (now, BlobReading(Err(SightError::Camera(fault))));
            }
            Ok(true) if self.picture.number > self.before => {
                let place = self.evaluate();
                self.reading = Some((now, BlobReading(place)));
            }
            Ok(_) => {}
        }
        self.reading.unwrap_or((now, BlobReading(Err(SightError::NoPicture))))
    }

    /// The last picture.
    pub fn picture(&self) -> &Picture {
        &self.picture
    }

    fn evaluate(&mut self) -> Result<BlobPlace, SightError> {
        let Picture { width, height, sequence, .. } = self.picture;
        if (width, height) != (self.pinhole.width, self.pinhole.height) {
            return Err(SightError::Size { width, height });
        }
        let blob = self.search.brightest(&self.picture.pixels, usize::from(width))?;
        let seen = |pixel| self.pinhole.project(pixel, &self.plane).ok_or(SightError::BesidePlane);
        let (sine, cosine) = blob.angle.sin_cos();
        let [x, y] = blob.centroid;
        let direction = seen([x + cosine, y + sine])? - seen([x - cosine, y - sine])?;
        Ok(BlobPlace { blob, position: seen(blob.centroid)?, direction: direction.normalize(), sequence })
    }
}

impl VirtualSensor for BlobFinder {
    type Reading = BlobReading;
    type Command = ();

    fn poll(&mut self, now: Instant) -> Option<(Instant, BlobReading)> {
        Some(self.read(now))
    }
}
