//! A camera finds a bright box at a wall, and the arm turns towards the box.
//!
//! The camera sends grey pictures over the network. The ray through the centroid of the box meets the plane of its visible
//! face, whose place is known. A rehearsal has no surroundings, and ends where the place is needed.
//!
//! ```sh
//! cargo run --release --example look -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Joints beside the camera, the tool pointing down, rad.
const ASIDE: [f64; 5] = [0.0, -1.571, 0.0, 1.3, 0.0];

/// Place of the visible face along y of the base, m.
const FACE: f64 = 0.45;

/// Homes the robot, locates the box and turns the column towards it.
pub(crate) async fn look(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let camera = cell.camera("eye")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(irb6.motions().joints(0.3, &[ASIDE])?).await?;
    if !cell.has_surroundings() {
        cell.end_rehearsal("the place of the box is measured")?;
    }
    let face = ViewedPlane { point: [0.0, FACE, 0.0].into(), normal: [0.0, -1.0, 0.0].into() };
    let seen = camera.locate(face).await?;
    cell.figure("box_x_m", seen.position.x);
    cell.figure("box_z_m", seen.position.z);
    // The sign of the direction is not determined.
    cell.figure("box_turn_rad", (seen.direction.z / seen.direction.x).atan());
    cell.figure("centroid_column", seen.blob.centroid[0]);
    cell.figure("centroid_row", seen.blob.centroid[1]);
    cell.figure("area_pixels", seen.blob.area.into());
    cell.figure("elongation", seen.blob.elongation);
    let mut towards = ASIDE;
    towards[0] = seen.position.y.atan2(seen.position.x);
    irb6.execute(irb6.motions().joints(0.3, &[towards])?).await?;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-camera.toml", look)
}
