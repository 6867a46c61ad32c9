//! Network cameras: the receiver of their frames, and the link to the controller.
//!
//! A camera is no drive group, and the servo has no part in it. A thread of the rim reads the connection and passes the
//! bytes to a [`CameraReceiver`], with the time of their arrival. The receiver is a function of (state, bytes, time).
//! A [`CameraLink`] has the latest picture and the present [`CameraFault`]. The next valid picture ends a fault.
//! [`serial::camera`] has the layout of the frames. Read [`CameraReceiver`] first.

mod receiver;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use can::counted_as;
use thiserror::Error;

pub use receiver::CameraReceiver;
pub use serial::camera::{FrameHeader, FrameKind, HEADER, checksum};

/// What a cell declares of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraConfig {
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Period of the pictures.
    pub period: Duration,
    /// Pictures in a row that may be missing; one more is a fault.
    pub tolerated_missing: u32,
}

impl CameraConfig {
    /// Greatest age of the last valid picture: the tolerated pictures, one more, and half a period for its transfer.
    pub fn deadline(&self) -> Duration {
        self.period * self.tolerated_missing.saturating_add(1) + self.period / 2
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        usize::from(self.width) * usize::from(self.height)
    }
}

/// Reasons why a camera gives no pictures. `age` is the time since the last valid picture, or since the connection was
/// opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum CameraFault {
    /// No connection was made.
    #[error("no connection, waited {waited:.1?}: check address, power and cable")]
    Absent {
        /// Duration of the attempt.
        waited: Duration,
    },
    /// No bytes arrive.
    #[error("no picture for {age:.1?}, and no bytes: check the camera")]
    Silent {
        /// Time since the last valid picture.
        age: Duration,
    },
    /// The connection ended.
    #[error("the connection ended, and the last picture is {age:.1?} old")]
    Closed {
        /// Time since the last valid picture.
        age: Duration,
    },
    /// Bytes arrive that are no valid frames.
    #[error(
        "no valid picture for {age:.1?}: {} no frame, or had a wrong CRC",
        counted_as(*.discarded, "byte was", "bytes were")
    )]
    Garbled {
        /// Time since the last valid picture.
        age: Duration,
        /// Bytes discarded since the last valid picture.
        discarded: u64,
    },
    /// The camera has another number of pixels.
    #[error("the camera has {found_width} × {found_height} pixels, declared were {width} × {height}")]
    Size {
        /// Columns of the camera.
        found_width: u16,
        /// Rows of the camera.
        found_height: u16,
        /// Declared columns.
        width: u16,
        /// Declared rows.
        height: u16,
    },
    /// The camera has another rate.
    #[error("the camera sends a picture every {found:.1?}, declared was {declared:.1?}")]
    Rate {
        /// Period of the camera.
        found: Duration,
        /// Declared period.
        declared: Duration,
    },
}

/// A grey picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Number of the valid picture since the link was made, from 1; 0 if there is none.
    pub number: u64,
    /// Sequence number that the camera gave to the picture.
    pub sequence: u32,
    /// Middle of the exposure since the camera was switched on, by the clock of the camera.
    pub exposed: Duration,
    /// Duration of the exposure.
    pub exposure: Duration,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Grey levels, rows from the top, each row from the left.
    pub pixels: Vec<u8>,
}

impl Picture {
    /// An empty picture with room for the pixels of a camera.
    pub fn with_room(config: &CameraConfig) -> Self {
        Self { pixels: Vec::with_capacity(config.pixels()), ..Self::default() }
    }

    /// Copies a picture. Does not allocate if there is room for its pixels.
    fn copy_from(&mut self, other: &Self) {
        self.pixels.clear();
        self.pixels.extend_from_slice(&other.pixels);
        let Self { number, sequence, exposed, exposure, width, height, .. } = *other;
        let pixels = std::mem::take(&mut self.pixels);
        *self = Self { number, sequence, exposed, exposure, width, height, pixels };
    }
}

/// What receiver and links share.
#[derive(Debug, Default)]
struct Slot {
    picture: Picture,
    fault: Option<CameraFault>,
    /// Pictures that the camera sent and the receiver did not receive, by their sequence numbers.
    lost: u64,
}

/// The controller's end of a camera. Clones read the same camera.
///
/// The receiver holds the lock while it exchanges two buffers. [`take`](Self::take) does not wait for the lock.
#[derive(Clone, Debug)]
pub struct CameraLink(Arc<Mutex<Slot>>);

impl CameraLink {
    fn new() -> Self {
        Self(Arc::default())
    }

    /// The link to a camera of a rehearsal, which gives no picture and has no fault.
    pub fn rehearsed() -> Self {
        Self::new()
    }

    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The present fault.
    pub fn fault(&self) -> Option<CameraFault> {
        self.slot().fault
    }

    /// Number of the last valid picture, from 1; 0 if there is none.
    pub fn number(&self) -> u64 {
        self.slot().picture.number
    }

    /// Pictures that the camera sent and the receiver did not receive, by their sequence numbers.
    pub fn lost(&self) -> u64 {
        self.slot().lost
    }

    /// Copies the last picture if it is another one than `picture`. Returns whether a picture was copied. A present
    /// fault is the error. The function does not wait: while the receiver exchanges its buffers, nothing is copied. The
    /// function does not allocate if `picture` has room.
    pub fn take(&self, picture: &mut Picture) -> Result<bool, CameraFault> {
        let slot = match self.0.try_lock() {
            Ok(slot) => slot,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return Ok(false),
        };
        if let Some(fault) = slot.fault {
            return Err(fault);
        }
        let other = slot.picture.number != picture.number;
        if other {
            picture.copy_from(&slot.picture);
        }
        Ok(other)
    }
}
