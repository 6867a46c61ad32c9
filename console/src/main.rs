//! The `mrroc` command.

fn main() {}
