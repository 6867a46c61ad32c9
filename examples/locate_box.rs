//! An ultrasonic matrix finds a box at a wall, and the arm turns towards the box.
//!
//! The matrix faces the wall. The cell file has the position, the cones and the noise of the matrix. The place of the
//! box follows from the means of several scans. A rehearsal has no surroundings, and ends where the place is needed.
//!
//! ```sh
//! cargo run --release --example locate_box -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Edges of the box, m: two along the wall, and the depth.
const BOX: [f64; 3] = [0.08, 0.06, 0.05];

/// Scans in one place of the box.
const SCANS: usize = 10;

/// Joints beside the matrix, the tool pointing down, rad.
const ASIDE: [f64; 5] = [0.0, -1.571, 0.0, 1.3, 0.0];

/// Greatest standard deviation of the place with which the arm moves, m.
const DEVIATION: f64 = 0.003;

/// Homes the robot, locates the box and turns the column towards it.
pub(crate) async fn locate(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let matrix = cell.ultrasonic("matrix")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(irb6.motions().joints(0.3, &[ASIDE])?).await?;
    if !cell.has_surroundings() {
        cell.end_rehearsal("the place of the box is measured")?;
    }
    let place = matrix.locate(BOX, SCANS).await?;
    cell.figure("box_x_m", place.position.x);
    cell.figure("box_z_m", place.position.z);
    cell.figure("face_y_m", place.position.y);
    cell.figure("deviation_x_mm", 1e3 * place.deviation[0]);
    cell.figure("deviation_z_mm", 1e3 * place.deviation[1]);
    cell.figure("residual_mm", 1e3 * place.residual);
    cell.figure("elements_without_echo", place.missing.into());
    if place.deviation[0].max(place.deviation[1]) > DEVIATION {
        return Err(TaskError::Refused(mrroc::Error::msg("the place of the box is too uncertain for a motion")));
    }
    let mut towards = ASIDE;
    towards[0] = place.position.y.atan2(place.position.x);
    irb6.execute(irb6.motions().joints(0.3, &[towards])?).await?;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-sonar.toml", locate)
}
