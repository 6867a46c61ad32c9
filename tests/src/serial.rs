//! Runs of the example cells on serial lines.

use ::mrroc::cell::Cell;
use serde_json::Value;

use crate::mrroc::{Output, text};

/// Largest following error in a run of an example cell, rad.
pub const TRACKING: f64 = 0.25;

pub fn completed(run: &Output, name: &str, tracking: f64) -> Value {
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let report = run.json();
    assert_eq!(report["outcome"], "completed", "{report}");
    assert_eq!(report["faults"], Value::Array(Vec::new()));
    let cell = Cell::parse(&text(name)).unwrap();
    let axes = report["axes"].as_array().unwrap();
    assert_eq!(axes.len(), cell.robot[0].axis.len());
    for axis in axes {
        let peak = axis["tracking_peak_rad"].as_f64().unwrap();
        assert!(0.0 < peak && peak < tracking, "{name}: {axis}");
    }
    report
}
