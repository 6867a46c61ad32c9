//! Tests of the transducer and of both sensors, and wrench sources in place of a scene.

mod can_node;
mod line;
mod transducer;

use can::Instant;

use super::WrenchProbe;

/// A wrench as a function of time.
struct Course<F>(F);

impl<F: FnMut(Instant) -> [f64; 6] + Send> WrenchProbe for Course<F> {
    fn wrench(&mut self, now: Instant) -> [f64; 6] {
        (self.0)(now)
    }
}

fn course(course: impl FnMut(Instant) -> [f64; 6] + Send + 'static) -> Box<dyn WrenchProbe> {
    Box::new(Course(course))
}

fn constant(wrench: [f64; 6]) -> Box<dyn WrenchProbe> {
    course(move |_| wrench)
}
