//! Declaration of the values of a device.

/// Greatest number of numbers in one sample.
pub const MOST_VALUES: usize = 16;

/// A value of a device: one number, or several of the same kind.
///
/// Fields may be added to this type; use [`new`](Self::new). Every other change is announced in the change log.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct DeviceValue {
    /// Name in tasks, recordings, columns and reports.
    pub name: &'static str,
    /// Unit, for example `m`; empty for a pure number.
    pub unit: &'static str,
    /// Number of numbers.
    pub count: usize,
    /// Least and greatest number. A sample beyond the range is no valid answer.
    pub range: [f64; 2],
}

impl DeviceValue {
    /// A value of one number.
    pub const fn new(name: &'static str, unit: &'static str, range: [f64; 2]) -> Self {
        Self { name, unit, count: 1, range }
    }

    /// This value with `count` numbers.
    #[must_use]
    pub const fn times(self, count: usize) -> Self {
        Self { count, ..self }
    }

    /// Whether a sample may have this number: the number lies within the range, or is NaN (not measured).
    pub fn permits(&self, number: f64) -> bool {
        number.is_nan() || (self.range[0]..=self.range[1]).contains(&number)
    }
}

/// Number of numbers in a sample of these values.
pub fn count_of(values: &[DeviceValue]) -> usize {
    values.iter().map(|value| value.count).sum()
}

/// Each number of a sample in order: its name, with an index if the value has several numbers, and its value.
pub fn names_of(values: &'static [DeviceValue]) -> impl Iterator<Item = (String, &'static DeviceValue)> {
    values.iter().flat_map(|value| {
        (0..value.count).map(move |index| match value.count {
            1 => (value.name.to_owned(), value),
            _ => (format!("{}_{index}", value.name), value),
        })
    })
}
