//! Objects that a drive is asked for. In NFv2 they name the request to which an answer belongs.

/// Objects of a request and of its answer. The position is always among them.
///
/// The requests of successive cycles ask for different objects, in a cycle of three. Each object is read in two
/// requests of three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Objects {
    /// Position, current and status.
    #[default]
    All,
    /// Position and current.
    Current,
    /// Position and status.
    Status,
}

impl Objects {
    /// Objects of the next request.
    pub(super) fn next(self) -> Self {
        match self {
            Self::All => Self::Current,
            Self::Current => Self::Status,
            Self::Status => Self::All,
        }
    }

    /// Number of requests after the one with these objects, up to the last one, which asked for `last`, modulo 3.
    pub(super) fn requests_before(self, last: Self) -> u32 {
        match last {
            _ if self == last => 0,
            _ if self.next() == last => 1,
            _ => 2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_objects_of_an_answer_name_its_request_modulo_three() {
        for first in [Objects::All, Objects::Current, Objects::Status] {
            let mut last = first;
            for requests in 0..9 {
                assert_eq!(first.requests_before(last), requests % 3, "{first:?} {last:?}");
                last = last.next();
            }
        }
    }
}
