//! A CiA 401 module on the bus of the drives, on the emulated bench by the clock.

use std::sync::Arc;

use ::mrroc::bench::clockwork;
use kit::touch_cell::TouchCell;
use kit::{PERIOD, by_the_clock};
use servo::Servo;

#[test]
fn scheduled_edges_are_seen_on_the_emulated_bench_by_the_clock() {
    by_the_clock(0.25, PERIOD, || {
        const LONGEST: u64 = 10_000;
        let TouchCell { file, emulation, mut servo, _links, probe } = TouchCell::with_edges(&[0.0, 4.0, 4.1]);
        let mut emulation = Some(emulation);
        let since = clockwork::bring_up(&mut servo, &mut emulation).unwrap();
        let reader = probe.clone();
        let until = move |servo: &Servo| {
            let input = reader.inputs.read().input(0);
            input.is_none_or(|input| input.edges == 2) || servo.counters().cycles > LONGEST
        };
        let running = clockwork::start(servo, emulation, since, file.cell.realtime, Arc::default(), || {}, until);
        let finished = running.unwrap().join();
        let image = probe.inputs.read();
        assert_eq!((image.fault, finished.panicked), (None, None));
        assert_eq!(image.input(0).map(|input| (input.level, input.edges)), Some((false, 2)));
    });
}
