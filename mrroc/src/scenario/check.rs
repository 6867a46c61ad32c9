//! Checks of a fault of a scenario: ranges, keys that exclude each other, and keys without effect.

use can::StandardId;

use super::{FaultKind, FaultPlace, FaultText, Problem};

impl FaultText {
    /// Checks all that needs no cell.
    pub(super) fn check(&self) -> Result<(), Problem> {
        if self.at.is_none() && self.when.is_none() && self.cycle.is_none() {
            return Err(("at", "is missing: at, cycle or when gives the beginning of the fault".to_owned()));
        }
        if self.cycle.is_some() && (self.at.is_some() || self.when.is_some()) {
            return Err(("cycle", "stands alone: at or when is given beside it".to_owned()));
        }
        self.check_uses()?;
        self.check_ranges()?;
        if self.axis.is_some() && (self.bus.is_some() || self.node.is_some()) {
            return Err(("axis", "stands for its bus and node, which are not given beside it".to_owned()));
        }
        if self.axis.is_none() && self.bus.is_none() {
            return Err(("kind", "has no place: name an axis or a bus".to_owned()));
        }
        if self.node.is_some() && self.frame.is_some() {
            return Err(("frame", "selects the frames, and node does too: give one of them".to_owned()));
        }
        if self.frame.is_some_and(|id| StandardId::new(id).is_none()) {
            return Err(("frame", "is a COB-ID of 11 bits, 0 to 0x7FF".to_owned()));
        }
        if self.node.is_some_and(|node| !(1..=127).contains(&node)) {
            return Err(("node", "is a node-ID, 1 to 127".to_owned()));
        }
        Ok(())
    }

    /// Refuses keys that the kind does not use.
    fn check_uses(&self) -> Result<(), Problem> {
        let given = [
            ("node", self.node.is_some()),
            ("frame", self.frame.is_some()),
            ("duration", self.duration.is_some()),
            ("count", self.count.is_some()),
            ("probability", self.probability.is_some()),
            ("seed", self.seed.is_some()),
            ("late_ms", self.late_ms.is_some()),
            ("increments", self.increments.is_some()),
            ("share", self.share.is_some()),
            ("distance", self.distance.is_some()),
            ("stiffness", self.stiffness.is_some()),
            ("code", self.code.is_some()),
        ];
        match given.into_iter().find(|&(key, given)| given && !self.kind.uses(key)) {
            Some((key, _)) => Err((key, format!("is no parameter of {}", self.kind.name()))),
            None => Ok(()),
        }
    }

    /// Refuses values that are out of range or without effect.
    fn check_ranges(&self) -> Result<(), Problem> {
        let not_negative = |value: f64| (0.0..=1e6).contains(&value);
        let positive = |value: f64| value > 0.0 && value <= 1e6;
        let probability = |value: f64| value > 0.0 && value <= 1.0;
        let share = |value: f64| (0.0..1.0).contains(&value);
        let checks = [
            ("at", self.at, not_negative as fn(f64) -> bool, "must be 0 to 1000000 s"),
            ("duration", self.duration, positive, "must be above 0, at most 1000000 s"),
            ("probability", self.probability, probability, "must be above 0, at most 1"),
            ("late_ms", self.late_ms, positive, "must be above 0, at most 1000000 ms"),
            ("share", self.share, share, "must be 0 to less than 1"),
            ("distance", self.distance, not_negative, "must be 0 to 1000000 rad"),
            ("stiffness", self.stiffness, positive, "must be above 0, at most 1000000 N·m/rad"),
        ];
        for (key, value, sound, problem) in checks {
            if value.is_some_and(|value| !sound(value)) {
                return Err((key, problem.to_owned()));
            }
        }
        if self.count == Some(0) {
            return Err(("count", "must be at least 1: 0 has no effect".to_owned()));
        }
        if self.increments == Some(0) {
            return Err(("increments", "must not be 0: 0 has no effect".to_owned()));
        }
        Ok(())
    }

    /// Refuses keys that the kind uses on a CAN bus only.
    pub(super) fn check_at(&self, place: &FaultPlace) -> Result<(), Problem> {
        let on_line = matches!(place, FaultPlace::Line { .. });
        let whole = self.kind == FaultKind::Late && self.probability.is_some();
        let unused = [("frame", self.frame.is_some()), ("probability", whole)];
        match unused.into_iter().find(|(_, given)| on_line && *given) {
            Some((key, _)) => Err((key, format!("is no parameter of {} on a serial line", self.kind.name()))),
            None => Ok(()),
        }
    }

    /// The beginning in words.
    pub(super) fn beginning(&self) -> String {
        let event = self.when.and_then(|event| serde_json::to_value(event).ok());
        let event = event.as_ref().and_then(|event| event.as_str());
        match (self.at, event, self.cycle) {
            (Some(at), None, _) => format!("at {at} s"),
            (Some(at), Some(event), _) => format!("when {event} from {at} s on"),
            (None, Some(event), _) => format!("when {event}"),
            (None, None, cycle) => format!("at cycle {}", cycle.unwrap_or(0)),
        }
    }
}
