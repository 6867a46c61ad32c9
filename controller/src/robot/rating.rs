//! Nominal ratings of the motors of a robot.

/// What a motor can do. Descriptions of robots compute the velocities and efforts of joints from these numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorRating {
    /// Greatest velocity, rad/s.
    pub velocity: f64,
    /// Greatest torque, N·m.
    pub torque: f64,
}

impl MotorRating {
    pub(super) const fn new(velocity: f64, torque: f64) -> Self {
        Self { velocity, torque }
    }

    /// The six motors of the IRp-6, on its pedestal and on its track. The torques are those of the greatest currents in
    /// public code, 20, 15, 15, 15, 8 and 1 A, at 0.105 N·m/A. Nominal: the velocity.
    pub(super) const IRP6: [Self; 6] = [
        Self::new(250.0, 2.1),
        Self::new(250.0, 1.575),
        Self::new(250.0, 1.575),
        Self::new(250.0, 1.575),
        Self::new(250.0, 0.84),
        Self::new(250.0, 0.105),
    ];
}
