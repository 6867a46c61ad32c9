//! An I/O node of a rehearsal: no bus, no frames, no faults.

use std::collections::VecDeque;

use can::Instant;

use super::config::{IoConfig, mask};
use super::edges::Edge;
use super::image::{ImagePublisher, InputImage, IoLink, OutputCommand, SentOutputs};

/// An I/O node without a wire, beside the ideal drives of a rehearsal. Only for rehearsals: a reader cannot tell the
/// node from a real one.
///
/// The terminals of the inputs are low until their scheduled changes. The outputs take every command at once.
pub struct RehearsedIo {
    image: InputImage,
    publisher: ImagePublisher,
    commanded: OutputCommand,
    outputs: u64,
    /// Times of the changes of an input that are to come, in ascending order.
    changes: VecDeque<(Instant, u8)>,
}

impl RehearsedIo {
    /// A node and the controller's end of it. Each of the `changes` inverts the level of an input at a time.
    pub fn new(config: &IoConfig, changes: impl IntoIterator<Item = (Instant, u8)>) -> (Self, IoLink) {
        let mut changes: Vec<_> = changes.into_iter().filter(|(_, input)| *input < config.inputs).collect();
        changes.sort_by_key(|(at, _)| *at);
        let mut image = InputImage::not_started(config.node, config.inputs);
        image.fault = None;
        image.levels = config.inverted_inputs;
        let (publisher, link) = IoLink::new(config.node, &image, config.error_value);
        let commanded = link.outputs.clone();
        let (outputs, changes) = (mask(config.outputs), changes.into());
        (Self { image, publisher, commanded, outputs, changes }, link)
    }

    /// Advances the node by one cycle, to `now`.
    pub fn advance(&mut self, now: Instant) {
        let image = &mut self.image;
        while let Some((at, input)) = self.changes.front().copied().filter(|(at, _)| *at <= now) {
            self.changes.pop_front();
            let index = usize::from(input);
            image.levels ^= 1 << input;
            image.edges[index] += 1;
            image.last_edge[index] = at;
            let level = image.levels >> input & 1 == 1;
            image.history.push(Edge { input, level, at, previous: image.received });
        }
        let levels = self.commanded.levels() & self.outputs;
        if self.outputs != 0 && image.sent.is_none_or(|sent| sent.levels != levels) {
            image.sent = Some(SentOutputs { levels, cycle: image.cycle, at: now });
        }
        (image.at, image.heard, image.received) = (now, now, now);
        self.publisher.publish(&image.words());
        image.cycle += 1;
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use canopen::NodeId;

    use super::*;
    use crate::cia401::Input;
    use crate::cia402::Identity;

    #[test]
    fn a_rehearsed_node_follows_its_schedule_and_takes_outputs_at_once() {
        let config = IoConfig {
            node: NodeId::MIN,
            identity: Identity { vendor: 0, product: None, revision: None },
            inputs: 3,
            outputs: 2,
            inhibit_time: Duration::from_millis(1),
            event_timer: Duration::from_millis(100),
            inverted_inputs: 0b100,
            emergency_inputs: 0,
            filtered_inputs: 0,
            inverted_outputs: 0b10,
            error_mode: 0b11,
            error_value: 0b10,
            configuration: Vec::new(),
        };
        let at = |millis| Instant::ZERO + Duration::from_millis(millis);
        let (mut io, link) = RehearsedIo::new(&config, [(at(7), 1), (at(3), 1), (at(5), 2), (at(1), 3)]);
        let input = |number| link.inputs.read().input(number);
        assert_eq!(input(2), Some(Input { level: true, edges: 0, last_edge: None }));
        assert_eq!(link.outputs.levels(), 0b10);
        for (now, levels, edges) in [(2, 0b100, [0, 0]), (4, 0b110, [1, 0]), (8, 0b000, [2, 1])] {
            io.advance(at(now));
            let image = link.inputs.read();
            let levels_read = (0..3).fold(0, |bits, number| bits | u8::from(input(number).unwrap().level) << number);
            assert_eq!((levels_read, image.at, image.fault), (levels, at(now), None));
            assert_eq!([1, 2].map(|number| input(number).unwrap().edges), edges);
        }
        assert_eq!(input(1).unwrap().last_edge, Some(at(7)));
        assert_eq!(link.inputs.read().sent, Some(SentOutputs { levels: 0b10, cycle: 0, at: at(2) }));
        link.outputs.set_all(0b101);
        io.advance(at(10));
        assert_eq!(link.inputs.read().sent, Some(SentOutputs { levels: 0b01, cycle: 3, at: at(10) }));
    }
}
