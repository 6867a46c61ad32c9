/// Bytes of a cyclic NFv2 request: a set-point and three reads.
pub(super) const NFV2_REQUEST: usize = 15;

/// Bytes of the only NFv2 answer we ask for: position, current and status.
pub(super) const NFV2_ANSWER: usize = 19;
