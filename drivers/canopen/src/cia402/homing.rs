//! Homing: methods and status (CiA 402-2 §11).

use super::Statusword;

/// Object 0x6098: the method by which a drive searches its reference (CiA 402-2 §11.3). The position grows in the
/// positive direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct HomingMethod(pub i8);

/// The references that a homing method searches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct References {
    /// The limit switch at the negative end.
    pub negative_limit: bool,
    /// The limit switch at the positive end.
    pub positive_limit: bool,
    /// The home switch.
    pub home_switch: bool,
    /// The encoder's index.
    pub index: bool,
    /// A mechanical stop, detected by the motor current.
    pub stop: bool,
}

impl HomingMethod {
    /// maxon: stop at the negative end, detected by the current.
    pub const CURRENT_NEGATIVE: Self = Self(-4);
    /// maxon: stop at the positive end, detected by the current.
    pub const CURRENT_POSITIVE: Self = Self(-3);
    /// maxon: as [`Self::CURRENT_NEGATIVE`], then the index.
    pub const CURRENT_NEGATIVE_INDEX: Self = Self(-2);
    /// maxon: as [`Self::CURRENT_POSITIVE`], then the index.
    pub const CURRENT_POSITIVE_INDEX: Self = Self(-1);
    /// Negative limit switch, back to the first index.
    pub const NEGATIVE_LIMIT_INDEX: Self = Self(1);
    /// Positive limit switch, back to the first index.
    pub const POSITIVE_LIMIT_INDEX: Self = Self(2);
    /// Home switch searched in the positive direction, turning at the positive limit switch, then
    /// the index.
    pub const HOME_POSITIVE_INDEX: Self = Self(7);
    /// Home switch searched in the negative direction, turning at the negative limit switch, then
    /// the index.
    pub const HOME_NEGATIVE_INDEX: Self = Self(11);
    /// Negative limit switch.
    pub const NEGATIVE_LIMIT: Self = Self(17);
    /// Positive limit switch.
    pub const POSITIVE_LIMIT: Self = Self(18);
    /// Home switch searched in the positive direction, turning at the positive limit switch.
    pub const HOME_POSITIVE: Self = Self(23);
    /// Home switch searched in the negative direction, turning at the negative limit switch.
    pub const HOME_NEGATIVE: Self = Self(27);
    /// The next index in the negative direction.
    pub const INDEX_NEGATIVE: Self = Self(33);
    /// The next index in the positive direction.
    pub const INDEX_POSITIVE: Self = Self(34);
    /// Where the axis stands; EPOS2 and older drives (CiA 402-2 §11.3.10).
    pub const ACTUAL_POSITION_OLD: Self = Self(35);
    /// Where the axis stands; EPOS4.
    pub const ACTUAL_POSITION: Self = Self(37);

    /// The methods of EPOS4, in the order of its object 0x60E3.
    pub const EPOS4: [Self; 15] = [
        Self::ACTUAL_POSITION,
        Self::INDEX_POSITIVE,
        Self::INDEX_NEGATIVE,
        Self::HOME_NEGATIVE,
        Self::HOME_POSITIVE,
        Self::POSITIVE_LIMIT,
        Self::NEGATIVE_LIMIT,
        Self::HOME_NEGATIVE_INDEX,
        Self::HOME_POSITIVE_INDEX,
        Self::POSITIVE_LIMIT_INDEX,
        Self::NEGATIVE_LIMIT_INDEX,
        Self::CURRENT_POSITIVE_INDEX,
        Self::CURRENT_NEGATIVE_INDEX,
        Self::CURRENT_POSITIVE,
        Self::CURRENT_NEGATIVE,
    ];

    /// The references that the method searches: none if the method takes the actual position. `None` for a method without
    /// a name here.
    pub fn references(self) -> Option<References> {
        let mut needs = References::default();
        match self {
            Self::ACTUAL_POSITION | Self::ACTUAL_POSITION_OLD => {}
            Self::INDEX_NEGATIVE | Self::INDEX_POSITIVE => needs.index = true,
            Self::CURRENT_NEGATIVE | Self::CURRENT_POSITIVE => needs.stop = true,
            Self::CURRENT_NEGATIVE_INDEX | Self::CURRENT_POSITIVE_INDEX => {
                needs.stop = true;
                needs.index = true;
            }
            Self::NEGATIVE_LIMIT => needs.negative_limit = true,
            Self::POSITIVE_LIMIT => needs.positive_limit = true,
            Self::NEGATIVE_LIMIT_INDEX => {
                needs.negative_limit = true;
                needs.index = true;
            }
            Self::POSITIVE_LIMIT_INDEX => {
                needs.positive_limit = true;
                needs.index = true;
            }
            Self::HOME_POSITIVE | Self::HOME_POSITIVE_INDEX => {
                needs.home_switch = true;
                needs.positive_limit = true;
                needs.index = self.0 == Self::HOME_POSITIVE_INDEX.0;
            }
            Self::HOME_NEGATIVE | Self::HOME_NEGATIVE_INDEX => {
                needs.home_switch = true;
                needs.negative_limit = true;
                needs.index = self.0 == Self::HOME_NEGATIVE_INDEX.0;
            }
            _ => return None,
        }
        Some(needs)
    }
}

/// State of homing by the statusword in homing mode (bits 10, 12 and 13).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HomingStatus {
    /// Searching.
    InProgress,
    /// Interrupted, or not started; also the answer of a drive that has not seen the start yet.
    Interrupted,
    /// Reference found, target not yet reached.
    Attained,
    /// Reference found, and the axis stands at its target.
    Done,
    /// Failed, still moving.
    ErrorMoving,
    /// Failed, standing.
    ErrorStanding,
    /// Attained and error at once, which CiA 402 does not define.
    Reserved,
}

impl HomingStatus {
    /// Of a statusword in homing mode.
    pub const fn of(word: Statusword) -> Self {
        let error = word.has(Statusword::MODE_SPECIFIC_13);
        let attained = word.has(Statusword::MODE_SPECIFIC_12);
        let reached = word.has(Statusword::TARGET_REACHED);
        match (error, attained, reached) {
            (false, false, false) => Self::InProgress,
            (false, false, true) => Self::Interrupted,
            (false, true, false) => Self::Attained,
            (false, true, true) => Self::Done,
            (true, false, false) => Self::ErrorMoving,
            (true, false, true) => Self::ErrorStanding,
            (true, true, _) => Self::Reserved,
        }
    }

    /// Bits 10, 12 and 13 of the statusword.
    pub const fn bits(self) -> u16 {
        const ERROR: u16 = Statusword::MODE_SPECIFIC_13;
        const ATTAINED: u16 = Statusword::MODE_SPECIFIC_12;
        const REACHED: u16 = Statusword::TARGET_REACHED;
        match self {
            Self::InProgress => 0,
            Self::Interrupted => REACHED,
            Self::Attained => ATTAINED,
            Self::Done => ATTAINED | REACHED,
            Self::ErrorMoving => ERROR,
            Self::ErrorStanding => ERROR | REACHED,
            Self::Reserved => ERROR | ATTAINED,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn homing_status_is_bits_10_12_and_13() {
        use HomingStatus::*;
        let table = [
            (0x0237, InProgress),
            (0x0637, Interrupted),
            (0x1237, Attained),
            (0x1637, Done),
            (0x9637, Done),
            (0x2237, ErrorMoving),
            (0x2637, ErrorStanding),
            (0x3237, Reserved),
            (0x3637, Reserved),
        ];
        for (raw, status) in table {
            let word = Statusword(raw);
            assert_eq!(HomingStatus::of(word), status, "{raw:#06x}");
            assert_eq!(HomingStatus::of(Statusword(status.bits())), status);
        }
    }

    #[test]
    fn methods_say_which_references_they_need() {
        let none = References::default();
        let table = [
            (37, none),
            (35, none),
            (33, References { index: true, ..none }),
            (17, References { negative_limit: true, ..none }),
            (1, References { negative_limit: true, index: true, ..none }),
            (2, References { positive_limit: true, index: true, ..none }),
            (23, References { positive_limit: true, home_switch: true, ..none }),
            (7, References { positive_limit: true, home_switch: true, index: true, ..none }),
            (11, References { negative_limit: true, home_switch: true, index: true, ..none }),
            (27, References { negative_limit: true, home_switch: true, ..none }),
            (-1, References { stop: true, index: true, ..none }),
            (-4, References { stop: true, ..none }),
        ];
        for (raw, needs) in table {
            assert_eq!(HomingMethod(raw).references(), Some(needs), "method {raw}");
        }
        assert_eq!(HomingMethod(0).references(), None);
        assert!(HomingMethod::EPOS4.iter().all(|method| method.references().is_some()));
    }
}
