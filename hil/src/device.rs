//! The contracts of emulated devices: on a bus, and on a serial line.

use std::any::Any;

use can::{Frame, Instant};

use crate::{Cabinet, Mechanism, PlantAxis};

/// A fault of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceFault {
    /// The device is cut off its bus or line, and goes on by itself.
    Unplugged,
    /// The device resets itself once, as its own watchdog does. A drive loses power and reference.
    Reset,
    /// The device has no supply. It restarts at the end of the fault.
    PowerOff,
    /// The device executes requests, and repeats its last answer. Only axis controllers on serial lines have this fault.
    AnswersFrozen,
    /// Every second answer is the answer before it again. Only axis controllers on serial lines have this fault and the next
    /// two.
    AnswersOld,
    /// An answer waits for the next one, and is sent after it.
    AnswersReversed,
    /// The answers are whole and have wrong contents, with a right checksum if the telegram has one.
    AnswersGarbled,
}

/// A device on a bus, as a function of (state, input, now): no thread, no clock, no socket.
///
/// The caller, which is the virtual bus or a socket loop, guarantees two things: `now` never decreases, and
/// [`handle_timeout`](Device::handle_timeout) is called before any later frame is handed in.
pub trait Device: Any + Send {
    /// Whether [`handle`](Device::handle) would do anything with a frame. A bus leaves out a device that ignores the frame.
    fn hears(&self, _frame: &Frame) -> bool {
        true
    }

    /// Takes a frame that ended on the bus at `now`.
    fn handle(&mut self, frame: &Frame, now: Instant);

    /// The next frame to send, in the device's own queue order. Called until the result is `None`.
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame>;

    /// Time of the next [`handle_timeout`](Device::handle_timeout) that the device requests, if any.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Advances the device's internal time to `now`.
    fn handle_timeout(&mut self, now: Instant);

    /// Advances the motors of this device that drive robots or belts of the scene to `now`. The world calls this
    /// function before each step of the scene. Returns whether the device may have something to send. A device without
    /// such motors does nothing.
    fn advance_mechanics(&mut self, _now: Instant) -> bool {
        false
    }

    /// Reads what the scene computed for this device in its step at `now`. The world calls this function after each step
    /// of the scene. Returns whether the device may have something to send or requests another time-out. A device that
    /// does not measure the scene does nothing.
    fn sense(&mut self, _now: Instant) -> bool {
        false
    }

    /// Begins or ends a fault at `now`. Returns whether the device has this fault.
    fn set_fault(&mut self, _fault: DeviceFault, _on: bool, _now: Instant) -> bool {
        false
    }

    /// The motor of the device with its load, if it has one. The motor has the state of its last sub-step.
    fn plant(&self) -> Option<&PlantAxis> {
        None
    }

    /// The same, to change its faults.
    fn plant_mut(&mut self) -> Option<&mut PlantAxis> {
        None
    }

    /// The robot whose motor the device drives, or whose forces it measures. A [`World`](crate::World) with a scene
    /// advances the devices of a robot together, in single steps.
    fn mechanism(&self) -> Option<&Mechanism> {
        self.plant().and_then(PlantAxis::mechanism)
    }
}

/// A device on a serial line, as a function of (bytes, now): no thread, no clock, no tty.
///
/// The line guarantees two things: `now` never decreases, and [`handle_timeout`](LineDevice::handle_timeout) is
/// called before any later byte is handed in.
pub trait LineDevice: Any + Send {
    /// Takes a byte whose last stop bit ended at `now`.
    fn receive(&mut self, byte: u8, now: Instant);

    /// The next byte to send. The line asks whenever its direction towards the host becomes free. After `None`, the
    /// line asks again when the device has received a byte or a time-out.
    fn poll_transmit(&mut self, now: Instant) -> Option<u8>;

    /// Time of the next [`handle_timeout`](LineDevice::handle_timeout) that the device requests, if any.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Advances the device's internal time to `now`.
    fn handle_timeout(&mut self, now: Instant);

    /// Advances the motors of this device that drive robots or belts of the scene to `now`. The world calls this
    /// function before each step of the scene. Returns whether the device may have something to send. A device without
    /// such motors does nothing.
    fn advance_mechanics(&mut self, _now: Instant) -> bool {
        false
    }

    /// Begins or ends a fault at `now`. Returns whether the device has this fault.
    fn set_fault(&mut self, _fault: DeviceFault, _on: bool, _now: Instant) -> bool {
        false
    }

    /// The motor of the device with its load, if it has one. The motor has the state of its last sub-step.
    fn plant(&self) -> Option<&PlantAxis> {
        None
    }

    /// The same, to change its faults.
    fn plant_mut(&mut self) -> Option<&mut PlantAxis> {
        None
    }

    /// The robot whose motor the device drives, or whose forces it measures. A [`World`](crate::World) with a scene
    /// advances the devices of a robot together, in single steps.
    fn mechanism(&self) -> Option<&Mechanism> {
        self.plant().and_then(PlantAxis::mechanism)
    }

    /// The cabinet whose emergency stop the device opens. A [`World`](crate::World) with a scene advances the devices
    /// of a cabinet together, in single steps.
    fn cabinet(&self) -> Option<&Cabinet> {
        None
    }
}
