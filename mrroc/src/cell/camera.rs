//! The keys of network cameras.

use std::time::Duration;

use controller::robot::Pose;
use controller::sensor::Pinhole;
use drive::camera::CameraConfig;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::defaults;

/// A camera that sends grey pictures over TCP. The camera listens, and the controller connects.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Name of the camera in tasks and reports, unlike that of any bus, bundle of lines, sensor or axis.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// The robot in whose base frame the place of the camera and its readings are given.
    pub robot: String,
    /// IP address and TCP port of the camera, such as `192.168.1.20:5600`; unused on the benches lockstep and emulated.
    pub address: String,
    /// Columns of a picture, 16 to 1024.
    #[serde(default = "defaults::count::<160, u16>")]
    pub width: u16,
    /// Rows of a picture, 16 to 1024.
    #[serde(default = "defaults::count::<120, u16>")]
    pub height: u16,
    /// Angle between the left and the right edge of the picture, rad.
    pub field_of_view: f64,
    /// Period of the pictures, ms, from 10 to 4000.
    #[serde(default = "defaults::count::<100, u16>")]
    pub period_ms: u16,
    /// Position of the pinhole in the base frame of the robot, m.
    pub position: [f64; 3],
    /// Orientation of the camera in the base frame of the robot as w, x, y, z: x to the right of the picture, y downward,
    /// z along the view.
    pub quaternion: [f64; 4],
    /// Pictures in a row that may be missing; one more is a fault of the camera.
    #[serde(default = "defaults::count::<3, u32>")]
    pub tolerated_missing: u32,
    /// Settings of the emulated camera, on the benches without hardware.
    #[serde(default)]
    pub emulator: CameraEmulator,
}

/// What stands in for a camera on the benches without hardware.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CameraEmulator {
    /// Whether the camera is absent from its address.
    pub absent: bool,
    /// Time from which the emulated camera sends nothing, s since the emulated devices were switched on; never where
    /// absent.
    pub silent_from_s: Option<f64>,
    /// Whether one bit of each frame is wrong.
    pub garbled: bool,
    /// Columns of the emulated camera; those of the cell where absent.
    pub width: Option<u16>,
    /// Period of the emulated camera, ms; that of the cell where absent.
    pub period_ms: Option<u16>,
    /// Exposure, ms, at most the period. At 5 ms, a white surface that faces the camera has the greatest grey level.
    pub exposure_ms: f64,
    /// Standard deviation of the noise of a pixel, grey levels.
    pub noise: f64,
}

impl Default for CameraEmulator {
    fn default() -> Self {
        Self {
            absent: false,
            silent_from_s: None,
            garbled: false,
            width: None,
            period_ms: None,
            exposure_ms: 5.0,
            noise: 3.0,
        }
    }
}

impl Camera {
    /// Period of the pictures.
    pub fn period(&self) -> Duration {
        Duration::from_millis(self.period_ms.into())
    }

    /// Configuration of the receiver.
    pub fn config(&self) -> CameraConfig {
        let Self { width, height, tolerated_missing, .. } = *self;
        CameraConfig { width, height, period: self.period(), tolerated_missing }
    }

    /// Configuration of the virtual sensor.
    pub fn pinhole(&self) -> Pinhole {
        let Self { width, height, field_of_view, .. } = *self;
        Pinhole { width, height, field_of_view, base_from_camera: self.base_from_camera() }
    }

    /// Frame of the camera in the base frame of its robot.
    pub fn base_from_camera(&self) -> Pose {
        let [w, x, y, z] = self.quaternion;
        let [px, py, pz] = self.position;
        Pose::from_parts(Translation3::new(px, py, pz), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }

    /// Configuration of the emulated camera.
    pub(crate) fn emulated(&self, seed: u64) -> hil::camera::CameraConfig {
        let CameraEmulator { width, period_ms, exposure_ms, noise, garbled, .. } = self.emulator;
        hil::camera::CameraConfig {
            width: width.unwrap_or(self.width),
            height: self.height,
            field_of_view: self.field_of_view,
            period: Duration::from_millis(period_ms.unwrap_or(self.period_ms).into()),
            exposure: Duration::from_secs_f64(1e-3 * exposure_ms),
            noise,
            seed,
            garbled,
        }
    }
}
