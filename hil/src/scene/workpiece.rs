//! Workpieces: height fields that the tools of robots cut.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::{Isometry3, Vector3};

use super::surface::Material;

/// Greatest number of cells of the height field of a workpiece.
pub const MOST_CELLS: usize = 4_000_000;

/// Depth of a cut from which the edge of the tool needs its full force, m. The force on the edge is in proportion to the
/// depth below this value.
const FULL_EDGE: f64 = 1e-5;

/// A plate at rest that a tool cuts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkpieceConfig {
    /// The frame of the workpiece in the world: origin at the centre of the upper face, z out of the material.
    pub pose: Isometry3<f64>,
    /// Lengths along x and y, and thickness, m. The lengths are rounded to whole cells.
    pub size: [f64; 3],
    /// Width of a cell of the height field, m.
    pub cell: f64,
    /// Cutting force per area of the cut, N/m².
    pub specific_force: f64,
    /// Cutting force per width of the cut, N/m.
    pub edge_force: f64,
    /// Elasticity and friction under a tool whose spindle does not turn.
    pub material: Material,
}

impl WorkpieceConfig {
    /// Cutting force per area of the cut in fibreboard, N/m² (nominal).
    pub const FIBREBOARD_SPECIFIC_FORCE: f64 = 25e6;
    /// Cutting force per width of the cut in fibreboard, N/m (nominal).
    pub const FIBREBOARD_EDGE_FORCE: f64 = 2e3;

    /// Number of cells along x and along y.
    pub fn cells(&self) -> [usize; 2] {
        [0, 1].map(|axis| (self.size[axis] / self.cell).round().max(0.0) as usize)
    }
}

/// The height field of a workpiece.
///
/// Column `i` and row `j` count from the corner with the least x and y. The centre of their cell is at
/// ((i + 1/2) · width − length / 2) in x, and likewise in y, in the frame of the workpiece.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightField {
    cells: [usize; 2],
    width: f64,
    thickness: f64,
    /// Heights of the rows, one after the other, relative to the upper face, m.
    heights: Vec<f64>,
}

impl HeightField {
    pub(super) fn new(config: &WorkpieceConfig) -> Self {
        let cells = config.cells();
        let heights = vec![0.0; cells[0] * cells[1]];
        Self { cells, width: config.cell, thickness: config.size[2], heights }
    }

    /// Number of columns and of rows.
    pub fn cells(&self) -> [usize; 2] {
        self.cells
    }

    /// Width of a cell, m.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Thickness of the uncut workpiece, m.
    pub fn thickness(&self) -> f64 {
        self.thickness
    }

    /// Height of the material in a cell, relative to the upper face, m: zero where the workpiece is uncut, and minus the
    /// thickness at a hole.
    ///
    /// # Panics
    ///
    /// If there is no such column or row.
    pub fn height(&self, column: usize, row: usize) -> f64 {
        assert!(column < self.cells[0], "the field has {} columns", self.cells[0]);
        self.heights[row * self.cells[0] + column]
    }

    /// Centre of a cell in the frame of the workpiece, m.
    pub fn centre(&self, column: usize, row: usize) -> [f64; 2] {
        let at = |axis: usize, index: usize| (index as f64 + 0.5 - 0.5 * self.cells[axis] as f64) * self.width;
        [at(0, column), at(1, row)]
    }

    /// Volume of the removed material, m³.
    pub fn removed(&self) -> f64 {
        -self.heights.iter().sum::<f64>() * self.width * self.width
    }

    /// Columns or rows whose centres are within `radius` of `at`.
    fn range(&self, axis: usize, at: f64, radius: f64) -> std::ops::Range<usize> {
        let index = |at: f64| (at / self.width + 0.5 * self.cells[axis] as f64 - 0.5).clamp(-1.0, 1e9);
        let first = index(at - radius).ceil().max(0.0) as usize;
        let last = (index(at + radius).floor() + 1.0).max(0.0) as usize;
        first..last.min(self.cells[axis])
    }

    /// Removes the material above the end of a tool, which was at `before` in the last step.
    pub(super) fn cut(&mut self, end: &End, before: &End) -> Removed {
        let mut removed = Removed::default();
        let lowest = end.centre.z - end.radius * end.normal.xy().norm();
        if lowest >= 0.0 {
            return removed;
        }
        let area = self.width * self.width;
        let (mut within, mut from_above) = (0_u32, 0_u32);
        for row in self.range(1, end.centre.y, end.radius) {
            for column in self.range(0, end.centre.x, end.radius) {
                let [x, y] = self.centre(column, row);
                let Some(plane) = end.height(x, y) else {
                    continue;
                };
                within += 1;
                let height = &mut self.heights[row * self.cells[0] + column];
                let floor = plane.max(-self.thickness);
                let depth = *height - floor;
                if depth <= 0.0 {
                    continue;
                }
                // Material under the whole disc was below the end of the tool in the last step.
                if *height > before.plane(x, y) {
                    removed.volume += area * depth;
                    removed.edge += area * (depth / FULL_EDGE).min(1.0);
                } else {
                    from_above += 1;
                }
                *height = floor;
            }
        }
        removed.from_above = f64::from(from_above) / f64::from(within.max(1));
        removed
    }

    /// Greatest height, m, under the end of a tool among the cells that are not higher than `ceiling`, m.
    pub(super) fn support(&self, end: &End, ceiling: f64) -> Option<f64> {
        let mut support = None;
        for row in self.range(1, end.centre.y, end.radius) {
            for column in self.range(0, end.centre.x, end.radius) {
                let [x, y] = self.centre(column, row);
                let height = self.heights[row * self.cells[0] + column];
                if height <= ceiling && height > -self.thickness && end.height(x, y).is_some() {
                    support = Some(support.map_or(height, |support: f64| support.max(height)));
                }
            }
        }
        support
    }
}

/// The flat end of a tool in the frame of a workpiece.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    /// Centre of the end, m.
    pub(super) centre: Vector3<f64>,
    /// Unit vector along the axis, from the end into the tool. Its z component is above zero for a tool that cuts.
    pub(super) normal: Vector3<f64>,
    /// Radius, m.
    pub(super) radius: f64,
}

impl End {
    /// Height of the plane of the end over a point of the workpiece, m.
    fn plane(&self, x: f64, y: f64) -> f64 {
        let slope = self.normal.x * (x - self.centre.x) + self.normal.y * (y - self.centre.y);
        self.centre.z - slope / self.normal.z
    }

    /// Height of the end over a point of the workpiece, m; `None` beside the tool.
    fn height(&self, x: f64, y: f64) -> Option<f64> {
        let plane = self.plane(x, y);
        let away = Vector3::new(x, y, plane) - self.centre;
        (away.norm_squared() <= self.radius * self.radius).then_some(plane)
    }
}

/// Material that a tool has removed in one step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Removed {
    /// Volume that the side of the tool has cut, m³.
    pub(super) volume: f64,
    /// Area, seen from above, over which the side of the tool has cut, m².
    pub(super) edge: f64,
    /// Share of the end of the tool that has cut downward, 0 to 1.
    pub(super) from_above: f64,
}

/// The height field of a workpiece, for pictures and tests. No controller reads this state. Clones read the same
/// workpiece.
#[derive(Clone, Debug)]
pub struct WorkpieceProbe(Arc<Mutex<HeightField>>);

impl WorkpieceProbe {
    pub(super) fn new(field: HeightField) -> Self {
        Self(Arc::new(Mutex::new(field)))
    }

    /// A copy of the present height field.
    pub fn field(&self) -> HeightField {
        self.lock().clone()
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, HeightField> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
