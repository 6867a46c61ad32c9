//! A force/torque sensor of a rehearsal: no wire, no noise, no faults.

use can::Instant;

use super::state::{Requests, StatePublisher, WrenchLink, WrenchState, ZeroFailure, ZeroRequest, Zeroing};

/// A sensor without a wire, for the ideal drives of a rehearsal. Only for rehearsals: through its link, a reader cannot
/// distinguish the sensor from a real sensor.
pub struct RehearsedWrench {
    state: WrenchState,
    publisher: StatePublisher,
    requests: Requests,
    /// The last request for a zero that was carried out.
    zeroed: Option<ZeroRequest>,
    offset: [f64; 6],
}

impl RehearsedWrench {
    /// A sensor in operation, and the controller's end of it.
    pub fn new() -> (Self, WrenchLink) {
        let (mut publisher, requests, link) = WrenchLink::new();
        let state = WrenchState { fault: None, ..WrenchState::NOT_STARTED };
        publisher.publish(&state.words());
        (Self { state, publisher, requests, zeroed: None, offset: [0.0; 6] }, link)
    }

    /// Advances the sensor by one cycle, to `now`. `load`: forces, N, and torques, N·m, which must be finite. A
    /// requested zero takes effect in this cycle.
    pub fn advance(&mut self, now: Instant, load: [f64; 6]) {
        let requested = self.requests.zero();
        if let Some(request) = requested.filter(|_| requested > self.zeroed) {
            (self.zeroed, self.offset) = (requested, load);
            self.state.zeroing = Zeroing::Done { request, samples: 1 };
            self.state.zeroed = Some(request);
        }
        let components = self.state.wrench.iter_mut().zip(load.iter().zip(self.offset));
        components.for_each(|(component, (load, offset))| *component = load - offset);
        (self.state.at, self.state.sampled) = (now, now);
        self.state.samples += 1;
        self.publisher.publish(&self.state.words());
        self.state.cycle += 1;
    }
}

impl RehearsedWrench {
    /// Ends the zero, like a new bring-up. A zeroing that is requested and not carried out fails.
    pub fn restart(&mut self) {
        let requested = self.requests.zero();
        let failed = |request| Zeroing::Failed { request, cause: ZeroFailure::Interrupted };
        self.state.zeroing = requested.filter(|_| requested > self.zeroed).map_or(Zeroing::None, failed);
        (self.zeroed, self.state.zeroed, self.offset) = (requested, None, [0.0; 6]);
        self.publisher.publish(&self.state.words());
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_rehearsed_sensor_reads_its_load_and_is_zeroed_at_once() {
        let (mut sensor, link) = RehearsedWrench::new();
        assert_eq!((link.read().fault, link.read().wrench), (None, [0.0; 6]));
        let at = |cycle: u32| Instant::ZERO + cycle * Duration::from_millis(2);
        let load = [1.0, -2.0, 3.0, 0.5, 0.0, -0.25];
        sensor.advance(at(1), load);
        let state = link.read();
        assert_eq!((state.measured(), state.sampled, state.cycle, state.age), (Some(load), at(1), 0, 0));
        let request = link.zero();
        sensor.advance(at(2), load);
        assert_eq!((link.read().wrench, link.read().zeroing.is_done(request)), ([0.0; 6], true));
        sensor.advance(at(3), [2.0, -2.0, 3.0, 0.5, 0.0, -0.25]);
        let state = link.read();
        assert_eq!((state.wrench[0], state.samples, state.cycle), (1.0, 3, 2));
    }
}
