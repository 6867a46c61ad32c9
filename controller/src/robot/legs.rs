//! Kinematics of the three parallel legs of the RNT.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Maximum number of steps of the forward solution.
const MOST_STEPS: u32 = 20;

/// A step of the forward solution below this, m or rad, is the last step. The remaining error is the square of that
/// step.
const LAST_STEP: f64 = 1e-8;

/// Maximum tilt in the forward solution, rad. Beyond a right angle the platform would hang upside down, where a
/// second solution exists.
pub(super) const STEEPEST: f64 = 1.5;

/// Three legs of variable length between a base and a platform, which is carried by a passive central leg.
///
/// The central leg hangs in a universal joint in the middle of the base. The leg leans by alpha about the x axis of
/// the base, then by beta about its own y axis. The leg cannot turn about its own axis. The platform is perpendicular
/// to the end of the central leg, rho from the universal joint. The three legs begin on a circle around the universal
/// joint and end on a circle around the middle of the platform. Both circles have the legs at 0°, 120° and 240° from
/// the x axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Legs {
    base: [Vector3<f64>; 3],
    platform: [Vector3<f64>; 3],
}

/// Pose of the platform: alpha and beta, rad, and rho, m.
pub(super) type Posture = [f64; 3];

impl Legs {
    pub(super) fn new(base_radius: f64, platform_radius: f64) -> Self {
        let circle = |radius: f64| {
            [0.0, 120.0_f64, 240.0].map(|degrees| {
                let (sin, cos) = degrees.to_radians().sin_cos();
                Vector3::new(radius * cos, radius * sin, 0.0)
            })
        };
        Self { base: circle(base_radius), platform: circle(platform_radius) }
    }

    /// End points of each leg on the base and on the platform.
    pub(super) fn ends(&self) -> [[Vector3<f64>; 2]; 3] {
        std::array::from_fn(|leg| [self.base[leg], self.platform[leg]])
    }

    /// Length of each leg, m.
    pub(super) fn lengths(&self, posture: &Posture) -> [f64; 3] {
        let platform_at = platform(posture);
        std::array::from_fn(|leg| (platform_at.joint(&self.platform[leg]) - self.base[leg]).norm())
    }

    /// The derivatives of the leg lengths, and the lengths. Row i: leg i by alpha and beta, m/rad, and by rho.
    pub(super) fn jacobian(&self, posture: &Posture) -> (Matrix3<f64>, Vector3<f64>) {
        let at = platform(posture);
        let mut jacobian = Matrix3::zeros();
        let mut lengths = Vector3::zeros();
        let tilts = [Vector3::x(), at.beta_axis];
        for leg in 0..3 {
            let end = at.joint(&self.platform[leg]);
            let along = end - self.base[leg];
            lengths[leg] = along.norm();
            let unit = along / lengths[leg];
            for (column, axis) in tilts.iter().enumerate() {
                jacobian[(leg, column)] = unit.dot(&axis.cross(&end));
            }
            jacobian[(leg, 2)] = unit.dot(&at.central);
        }
        (jacobian, lengths)
    }

    /// The posture with these leg lengths, by Newton's method from `near`, and the number of steps taken. If the legs
    /// cannot close, fails with the leg of the largest error in the closest posture found, and that error, m.
    pub(super) fn close(&self, lengths: &[f64; 3], near: &Posture) -> Result<(Posture, u32), (u8, f64)> {
        let wanted = Vector3::from(*lengths);
        let mut posture = *near;
        let mut closest = (f64::INFINITY, 0, wanted.amax());
        for steps in 1..=MOST_STEPS {
            let (jacobian, found) = self.jacobian(&posture);
            let missing = wanted - found;
            let leg = missing.iamax();
            if missing[leg].abs() < closest.0 {
                closest = (missing[leg].abs(), leg, missing[leg]);
            }
            let Some(step) = jacobian.try_inverse().map(|inverse| inverse * missing) else {
                break;
            };
            for (value, change) in posture.iter_mut().zip(&step) {
                *value += change;
            }
            for tilt in &mut posture[..2] {
                *tilt = tilt.clamp(-STEEPEST, STEEPEST);
            }
            posture[2] = posture[2].max(0.0);
            if step.amax() < LAST_STEP {
                return Ok((posture, steps));
            }
        }
        let (_, leg, residual) = closest;
        Err((leg as u8, residual))
    }
}

/// `base_from_central`: the frame of the central leg, with z along the leg.
pub(super) fn central(alpha: f64, beta: f64) -> Rotation3<f64> {
    let ((sa, ca), (sb, cb)) = (alpha.sin_cos(), beta.sin_cos());
    Rotation3::from_matrix_unchecked(Matrix3::new(
        cb,
        0.0,
        sb, //
        sa * sb,
        ca,
        -sa * cb, //
        -ca * sb,
        sa,
        ca * cb,
    ))
}

struct Platform {
    base_from_central: Rotation3<f64>,
    /// Rotation axis of beta.
    beta_axis: Vector3<f64>,
    /// Direction of the central leg.
    central: Vector3<f64>,
    middle: Vector3<f64>,
}

fn platform(&[alpha, beta, rho]: &Posture) -> Platform {
    let base_from_central = central(alpha, beta);
    let central = base_from_central * Vector3::z();
    Platform { base_from_central, beta_axis: base_from_central * Vector3::y(), central, middle: central * rho }
}

impl Platform {
    fn joint(&self, on_platform: &Vector3<f64>) -> Vector3<f64> {
        self.middle + self.base_from_central * on_platform
    }
}
