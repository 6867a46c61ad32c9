//! Numbers from the command line.

use anyhow::{anyhow, ensure};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// Tolerance of the norm of a quaternion.
const NORM: f64 = 0.01;

/// Parses a list of finite numbers, separated by commas.
pub(super) fn list(option: &str, text: &str) -> anyhow::Result<Vec<f64>> {
    let number = |part: &str| {
        let value: f64 = part.trim().parse().map_err(|_| {
            anyhow!("{option}: {part:?} is not a number, as in a list separated by commas")
        })?;
        ensure!(value.is_finite(), "{option}: {part:?} is not finite");
        Ok(value)
    };
    text.split(',').map(number).collect()
}

fn exactly<const N: usize>(option: &str, text: &str, form: &str) -> anyhow::Result<[f64; N]> {
    let numbers = list(option, text)?;
    let count = numbers.len();
    numbers
        .try_into()
        .map_err(|_| anyhow!("{option}: {count} numbers, not the {N} of {form}"))
}

/// Parses a pose from its position and its quaternion.
pub(super) fn pose(position: &str, quaternion: &str) -> anyhow::Result<Isometry3<f64>> {
    let position = exactly::<3>("--position", position, "x,y,z")?;
    let [w, x, y, z] = exactly("--quaternion", quaternion, "w,x,y,z")?;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    ensure!(
        (norm - 1.0).abs() <= NORM,
        "--quaternion: its norm is {norm:.6}, and that of a rotation is 1"
    );
    Ok(Isometry3::from_parts(
        Translation3::from(position),
        UnitQuaternion::from_quaternion(quaternion),
    ))
}
