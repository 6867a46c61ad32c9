//! Tracking errors and counters.

/// Tracking error of one axis during motion of its effector. All values have the unit of the recorded errors: rad for an
/// axis, m for a linear motor.
///
/// The error compares the sample with the command whose effect the drive sampled,
/// [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before. The transport delay is therefore not part of the
/// error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackingError {
    /// Number of cycles counted.
    pub samples: u64,
    sum_of_squares: f64,
    /// The largest absolute value; zero without a sample.
    pub peak: f64,
}

impl TrackingError {
    /// Counts one error.
    pub fn record(&mut self, error: f64) {
        self.samples += 1;
        self.sum_of_squares += error * error;
        self.peak = self.peak.max(error.abs());
    }

    /// Root mean square; zero without a sample.
    pub fn rms(&self) -> f64 {
        if self.samples == 0 { 0.0 } else { (self.sum_of_squares / self.samples as f64).sqrt() }
    }
}

/// Counters of a servo. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Cycles stepped.
    pub cycles: u64,
    /// Deadlines that passed without a cycle.
    pub missed_cycles: u64,
    /// Macrosteps begun.
    pub macrosteps: u64,
    /// Orders refused in the state of the effector, and macrosteps dropped by a stop.
    pub refused_orders: u64,
    /// Reports dropped because the controller did not collect them.
    pub dropped_reports: u64,
    /// Records dropped because the recording was not drained.
    pub dropped_records: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rms_and_peak_are_of_all_samples() {
        let mut error = TrackingError::default();
        assert_eq!(error.rms(), 0.0);
        [3.0, -4.0].into_iter().for_each(|e| error.record(e));
        assert!((error.rms() - 12.5f64.sqrt()).abs() < 1e-12);
        assert_eq!((error.peak, error.samples), (4.0, 2));
    }
}
