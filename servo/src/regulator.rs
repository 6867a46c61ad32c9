//! The laws of the position loops that the servo closes, as pure objects: errors in, output out.
//!
//! An output is a velocity, rad/s, a torque, N·m, or a duty, whichever the gains are for; it is limited, finite
//! whatever comes in, and positive towards higher motor positions. Read [`Incremental`] for the IRp-6's own law,
//! [`CascadeConfig`] for position over velocity, [`Proportional`] for position over a drive's velocity loop. How samples and
//! set-points become errors is [`HostLoop`](crate::HostLoop)'s to say.

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
