//! Digest of a generator's memory, for comparison of runs.

use std::fmt::{self, Debug, Write as _};

/// Hash of the `Debug` text of a value: 64-bit FNV-1a. Nothing is allocated.
pub(crate) fn of(value: &impl Debug) -> u64 {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    // A hash takes every text.
    let _ = write!(hash, "{value:?}");
    hash.0
}

struct Fnv(u64);

impl fmt::Write for Fnv {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        Ok(())
    }
}
