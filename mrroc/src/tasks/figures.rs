//! Figures that a task reports, such as the accuracy of its motions.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Figures by name. Clones share the figures.
#[derive(Clone, Debug, Default)]
pub struct Figures(Arc<Mutex<BTreeMap<String, f64>>>);

impl Figures {
    /// Sets the figure called `name`.
    pub(super) fn set(&self, name: &str, value: f64) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned(), value);
    }

    /// All figures.
    pub(crate) fn all(&self) -> BTreeMap<String, f64> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
