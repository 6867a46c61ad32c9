//! Laws of the position loops that the servo closes, without I/O: the inputs are errors, and the result is one output.
//!
//! An output is a velocity, rad/s, a torque, N·m, or a duty, depending on the gains. The output is limited, and finite
//! for any input. A positive output moves the motor towards higher positions. Read [`Incremental`] for the law of the
//! original IRp-6, [`CascadeConfig`] for position over velocity, and [`Proportional`] for position over the velocity
//! loop of a drive. [`HostLoop`](crate::HostLoop) computes the errors from samples and set-points.

mod incremental;
mod proportional;

pub use incremental::{IRP6, IRP6_DUTY, Incremental, IncrementalConfig};
pub use proportional::{CascadeConfig, Proportional, ProportionalConfig};

/// How much of `asked` there is in `held`.
fn share(held: f64, asked: f64) -> f64 {
    if asked > 0.0 {
        held.clamp(0.0, asked)
    } else if asked < 0.0 {
        held.clamp(asked, 0.0)
    } else {
        0.0
    }
}
