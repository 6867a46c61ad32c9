//! A camera of a cell, as a task sees it.

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use controller::executor::Agents;
use controller::sensor::{BlobFinder, BlobPlace, Pinhole, SightError, ViewedPlane};
use drive::camera::{CameraFault, CameraLink, Picture};

use super::TaskError;
use crate::cell;

/// Periods of the camera in which a picture arrives that was exposed after the call, beside the tolerated missing ones.
const PATIENCE: u32 = 4;

/// A camera.
#[derive(Clone)]
pub struct Camera {
    name: Box<str>,
    link: CameraLink,
    pinhole: Pinhole,
    agents: Agents,
    servo_period: Duration,
    longest: Duration,
}

impl Camera {
    pub(super) fn new(given: &cell::Camera, link: CameraLink, agents: Agents, servo_period: Duration) -> Self {
        let longest = given.period() * (given.tolerated_missing + PATIENCE);
        Self { name: given.name.as_str().into(), link, pinhole: given.pinhole(), agents, servo_period, longest }
    }

    /// Name of the camera in the cell file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The pinhole of the camera and its place.
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// The virtual sensor of the brightest object, whose visible face is in `plane`, for
    /// [`Robot::sense`](super::Robot::sense).
    pub fn sensor(&self, plane: ViewedPlane) -> BlobFinder {
        BlobFinder::new(self.link.clone(), self.pinhole, plane)
    }

    /// Waits for a picture that is exposed after the call, and locates the brightest object, whose visible face is in
    /// `plane`. Fails if the camera has a fault, if no picture arrives within the tolerated missing pictures and four
    /// periods, or if the picture has no object.
    pub async fn locate(&self, plane: ViewedPlane) -> Result<BlobPlace, TaskError> {
        let mut sensor = self.sensor(plane);
        let mut waited = Duration::ZERO;
        loop {
            match sensor.read(self.now().await).1.result() {
                Ok(place) => return Ok(place),
                Err(SightError::NoPicture) if waited < self.longest => {}
                Err(error) => return Err(TaskError::Camera { name: self.name.clone(), error }),
            }
            self.agents.sleep(self.servo_period).await;
            waited += self.servo_period;
        }
    }

    /// Copies the last picture into `picture`, unless `picture` has it already. Returns whether a picture was copied.
    pub fn take(&self, picture: &mut Picture) -> Result<bool, TaskError> {
        let taken = self.link.take(picture);
        taken.map_err(|fault| TaskError::Camera { name: self.name.clone(), error: SightError::Camera(fault) })
    }

    /// The present fault of the camera. The next valid picture ends the fault.
    pub fn fault(&self) -> Option<CameraFault> {
        self.link.fault()
    }

    /// Time of the last servo cycle.
    async fn now(&self) -> Instant {
        self.agents.until(|now, _| Poll::Ready(now)).await
    }
}
