//! The message of the samples of devices of other crates. A recording of a cell without such a device lacks this
//! message.

use drive::device;

use super::schema::messages;

messages! {
    /// A valid sample of a device of another crate, in the cycle that read the sample; without numbers, the end of the
    /// validity of the last sample. The channel has the names and units of the numbers.
    DeviceSample {
        /// Number of the sample, from 1.
        number = 1: [uint64] u64,
        /// Earliest time of the measurement, ns.
        not_before_ns = 2: [uint64] u64,
        /// The numbers; NaN where not measured.
        values = 3: [double, repeated] Vec<f64>,
    }
}

impl DeviceSample {
    /// A sample with `count` numbers.
    pub(super) fn of(sample: Option<&device::DeviceSample>, count: usize) -> Self {
        sample.map_or_else(Self::default, |sample| Self {
            number: sample.number,
            not_before_ns: sample.not_before.as_nanos(),
            values: sample.values.iter().take(count).copied().collect(),
        })
    }
}
