//! Figures in SVG: basic shapes, and common parts of charts.

pub mod chart;
pub mod svg;
