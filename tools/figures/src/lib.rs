//! Figures in SVG: shapes of a sheet, and what charts have in common.

pub mod chart;
pub mod svg;
