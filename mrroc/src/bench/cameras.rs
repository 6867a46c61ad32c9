//! The emulated cameras of a cell, and their connections in memory.

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use drive::camera::{CameraConfig, CameraFault, CameraLink, CameraReceiver};
use hil::{Camera, View, World};

use crate::bench::random::Stream;
use crate::bench::scene::base_of;
use crate::cell::{self, CellFile};

/// Longest wait for the greeting of a camera, if a picture of the camera may not take longer.
const GREETING: Duration = Duration::from_secs(1);

/// Time from the end of an exposure to the arrival of the picture in memory.
const TRANSFER: Duration = Duration::from_millis(4);

/// Longest wait for the greeting of a camera. Silence until then is a fault.
pub(super) fn patience(config: &CameraConfig) -> Duration {
    GREETING.max(config.deadline() + Duration::from_millis(1))
}

/// The emulated camera `number`. `world` has its scene already.
pub(super) fn emulated(file: &CellFile, number: usize, world: &mut World) -> Camera {
    let given = &file.cell.camera[number];
    let robot = file.cell.robot.iter().find(|robot| robot.name == given.robot);
    let robot = robot.expect("a parsed cell has the robot of a camera");
    let view = world.scene_mut().map_or(View::EMPTY, |scene| scene.view());
    let seed = Stream::Camera(number).seed(file);
    let pose = base_of(robot) * given.base_from_camera();
    Camera::new(given.emulated(seed), view, pose).expect("a parsed cell has sound cameras")
}

/// An emulated camera whose bytes go to its receiver in memory, in the time of the world.
pub(super) struct CameraInMemory {
    camera: Camera,
    receiver: CameraReceiver,
    /// Middle of the next exposure.
    next: Instant,
    silent_from: Option<Instant>,
    /// Frames on their way, with the times of their arrival.
    coming: VecDeque<(Instant, Vec<u8>)>,
}

impl CameraInMemory {
    /// The connection to `camera`, switched on at [`Instant::ZERO`]. Waits for the greeting in virtual time.
    pub(super) fn connect(given: &cell::Camera, camera: Camera) -> Result<(Self, CameraLink), CameraFault> {
        let config = given.config();
        let (mut receiver, link) = CameraReceiver::new(config);
        if given.emulator.absent {
            return Err(CameraFault::Absent { waited: GREETING });
        }
        receiver.connected(Instant::ZERO);
        let silent_from = given.emulator.silent_from_s.map(|at| Instant::ZERO + Duration::from_secs_f64(at));
        if silent_from != Some(Instant::ZERO) {
            let mut bytes = Vec::new();
            camera.greet(&mut bytes);
            receiver.receive(&bytes, Instant::ZERO);
        }
        if !receiver.is_greeted() {
            receiver.tick(Instant::ZERO + patience(&config));
        }
        if let Some(fault) = link.fault() {
            return Err(fault);
        }
        let next = Instant::ZERO + camera.config().exposure / 2;
        Ok((Self { camera, receiver, next, silent_from, coming: VecDeque::new() }, link))
    }

    /// Middle of the next exposure.
    pub(super) fn next(&self) -> Instant {
        self.next
    }

    /// Takes the picture that is due at `now`, the present time of the world.
    pub(super) fn expose(&mut self, now: Instant) {
        if now < self.next {
            return;
        }
        let (period, exposure) = (self.camera.config().period, self.camera.config().exposure);
        self.next += period;
        if self.silent_from.is_none_or(|silent| now < silent) {
            let mut bytes = Vec::new();
            self.camera.expose(now, &mut bytes);
            self.coming.push_back((now + exposure / 2 + TRANSFER, bytes));
        }
    }

    /// Passes the frames that arrive by `until` to the receiver.
    pub(super) fn deliver(&mut self, until: Instant) {
        while self.coming.front().is_some_and(|(arrival, _)| *arrival <= until) {
            if let Some((arrival, bytes)) = self.coming.pop_front() {
                self.receiver.receive(&bytes, arrival);
            }
        }
        self.receiver.tick(until);
    }
}
