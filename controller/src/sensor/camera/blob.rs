//! The brightest area of a picture.
//!
//! Otsu's threshold separates bright pixels from dark ones: the grey level at which the variance between the two classes
//! is greatest (N. Otsu, IEEE Trans. SMC 9, 1979). Bright pixels that share an edge form an area. The brightest area is
//! the one with the greatest sum of grey levels. Its moments give centroid and longer axis.

use super::SightError;

/// Least difference between the mean grey levels of bright and dark pixels.
pub const LEAST_CONTRAST: u8 = 30;

/// Least number of pixels of the brightest area.
pub const LEAST_AREA: u32 = 20;

/// The brightest area of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blob {
    /// Centroid: distance from the left and from the upper edge of the picture, pixels.
    pub centroid: [f64; 2],
    /// Angle from the rows to the longer axis, rad, within a half turn; positive clockwise, from right to down.
    pub angle: f64,
    /// Ratio of the standard deviations along the longer and the shorter axis, 1 or above.
    pub elongation: f64,
    /// Number of pixels.
    pub area: u32,
}

/// Sums over the pixels of an area.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    grey: u64,
    count: u64,
    x: u64,
    y: u64,
    xx: u64,
    yy: u64,
    xy: u64,
    at_edge: bool,
}

/// A search for the brightest area, with its memory. A search does not allocate.
#[derive(Debug)]
pub struct BlobSearch {
    /// Whether each pixel belongs to an area that was counted.
    counted: Vec<bool>,
    /// Pixels of the present area whose neighbours are to be examined.
    open: Vec<u32>,
}

impl BlobSearch {
    /// A search in pictures of up to `pixels` pixels.
    pub fn new(pixels: usize) -> Self {
        Self { counted: vec![false; pixels], open: Vec::with_capacity(pixels) }
    }

    /// The brightest area of a picture with `width` columns.
    pub fn brightest(&mut self, pixels: &[u8], width: usize) -> Result<Blob, SightError> {
        let threshold = threshold(pixels)?;
        self.counted.clear();
        self.counted.extend(pixels.iter().map(|grey| *grey < threshold));
        let mut best = Moments::default();
        for first in 0..pixels.len() {
            if !self.counted[first] {
                let area = self.area(pixels, width, first);
                if area.grey > best.grey {
                    best = area;
                }
            }
        }
        let area = best.count as u32;
        if area < LEAST_AREA {
            return Err(SightError::TooSmall { area });
        }
        if best.at_edge {
            return Err(SightError::AtEdge);
        }
        Ok(best.blob())
    }

    /// The area around pixel `first`.
    fn area(&mut self, pixels: &[u8], width: usize, first: usize) -> Moments {
        let mut sums = Moments::default();
        self.counted[first] = true;
        self.open.clear();
        self.open.push(first as u32);
        while let Some(pixel) = self.open.pop() {
            let pixel = pixel as usize;
            let (column, row) = (pixel % width, pixel / width);
            let (right, below) = (column + 1 < width, pixel + width < pixels.len());
            let (x, y) = (column as u64, row as u64);
            sums.grey += u64::from(pixels[pixel]);
            sums.count += 1;
            (sums.x, sums.y) = (sums.x + x, sums.y + y);
            (sums.xx, sums.yy, sums.xy) = (sums.xx + x * x, sums.yy + y * y, sums.xy + x * y);
            sums.at_edge |= column == 0 || row == 0 || !right || !below;
            let neighbours = [
                (column > 0).then(|| pixel - 1),
                right.then(|| pixel + 1),
                (row > 0).then(|| pixel - width),
                below.then(|| pixel + width),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                if !self.counted[neighbour] {
                    self.counted[neighbour] = true;
                    self.open.push(neighbour as u32);
                }
            }
        }
        sums
    }
}

impl Moments {
    fn blob(&self) -> Blob {
        let mean = |sum: u64| sum as f64 / self.count as f64;
        let (x, y) = (mean(self.x), mean(self.y));
        let (xx, yy, xy) = (mean(self.xx) - x * x, mean(self.yy) - y * y, mean(self.xy) - x * y);
        // Eigenvalues of the covariance; a pixel has the variance 1/12 of its own.
        let (middle, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let pixel = 1.0 / 12.0;
        let elongation = ((middle + half + pixel) / (middle - half + pixel).max(pixel)).sqrt();
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        Blob { centroid: [x + 0.5, y + 0.5], angle, elongation, area: self.count as u32 }
    }
}

/// Otsu's threshold: the least grey level of a bright pixel.
fn threshold(pixels: &[u8]) -> Result<u8, SightError> {
    let mut histogram = [0_u64; 256];
    pixels.iter().for_each(|grey| histogram[usize::from(*grey)] += 1);
    let total = pixels.len() as f64;
    let sum: f64 = histogram.iter().enumerate().map(|(grey, count)| grey as f64 * *count as f64).sum();
    let (mut below, mut sum_below) = (0.0, 0.0);
    let (mut best, mut found, mut contrast) = (0.0, 0, 0.0);
    for level in 1..256 {
        let count = histogram[level - 1] as f64;
        below += count;
        sum_below += count * (level - 1) as f64;
        let above = total - below;
        if below == 0.0 || above == 0.0 {
            continue;
        }
        let difference = (sum - sum_below) / above - sum_below / below;
        let between = below * above * difference * difference;
        if between > best {
            (best, found, contrast) = (between, level, difference);
        }
    }
    if contrast < f64::from(LEAST_CONTRAST) {
        return Err(SightError::NoContrast { contrast: contrast as u8 });
    }
    Ok(found as u8)
}
