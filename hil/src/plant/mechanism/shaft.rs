//! A motor shaft that a scene and a drive share.

use std::sync::atomic::{AtomicU64, Ordering};

/// Angle and velocity of a motor, and the torque that the forces on the robot cause at the motor. The thread that
/// advances the drives of a robot also advances the robot in the scene, so relaxed atomics suffice.
#[derive(Debug, Default)]
pub(in super::super) struct Shaft {
    angle: AtomicU64,
    velocity: AtomicU64,
    torque: AtomicU64,
}

impl Shaft {
    /// Records angle, rad, and velocity, rad/s.
    pub(in super::super) fn set(&self, angle: f64, velocity: f64) {
        store(&self.angle, angle);
        store(&self.velocity, velocity);
    }

    /// Records a velocity, rad/s, that another motor has changed.
    pub(super) fn set_velocity(&self, velocity: f64) {
        store(&self.velocity, velocity);
    }

    /// Torque that the forces on the robot cause at the motor, N·m.
    pub(in super::super) fn torque(&self) -> f64 {
        load(&self.torque)
    }

    pub(super) fn set_torque(&self, torque: f64) {
        store(&self.torque, torque);
    }

    pub(super) fn angle(&self) -> f64 {
        load(&self.angle)
    }

    pub(super) fn velocity(&self) -> f64 {
        load(&self.velocity)
    }
}

fn load(bits: &AtomicU64) -> f64 {
    f64::from_bits(bits.load(Ordering::Relaxed))
}

fn store(bits: &AtomicU64, value: f64) {
    bits.store(value.to_bits(), Ordering::Relaxed);
}
