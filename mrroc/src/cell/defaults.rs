//! Values of keys that a cell file leaves out.

/// The default of a whole number.
pub(super) fn count<const COUNT: u32, T: TryFrom<u32>>() -> T {
    let count = T::try_from(COUNT).ok();
    count.expect("a key has room for its default")
}

/// The default of a key that is true where absent.
pub(super) fn yes() -> bool {
    true
}

/// The default of a number, in hundredths.
pub(super) fn hundredths<const COUNT: u8>() -> f64 {
    f64::from(COUNT) / 100.0
}
