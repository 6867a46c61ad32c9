//! Descriptions of robots and drives: kinematics, URDF, data sheets with figures, EDS of emulated drives.

pub mod cell_reference;
pub mod datasheet;
pub mod eds;
pub mod kinematics;
pub mod new;
mod robots;
pub mod urdf;
