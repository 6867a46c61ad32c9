//! Tests of the layouts by their public interface, in one executable.

mod arbitrary_frames;
mod data_sheets;
mod sheets;
