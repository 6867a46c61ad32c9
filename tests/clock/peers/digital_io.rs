//! python-canopen as the master of an emulated module of digital inputs and outputs.

use can::{Frame, Instant, clock};
use canopen::NodeId;
use hil::{Device, DigitalIo, DigitalIoConfig};
use kit::adapter::Adapter;
use kit::processors;

use super::{Bus, judged, python};

/// A module whose outputs are wired to the inputs of the same numbers.
struct Wired {
    module: DigitalIo,
    /// Levels of the wires.
    levels: u64,
}

impl Wired {
    fn follow(&mut self, now: Instant) {
        let levels = self.module.outputs();
        let changed = std::mem::replace(&mut self.levels, levels) ^ levels;
        for index in (0..64).filter(|index| changed >> index & 1 == 1) {
            self.module.set_input(now, index, levels >> index & 1 == 1).expect("the module has 64 inputs");
        }
    }
}

impl Device for Wired {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.module.handle(frame, now);
        self.follow(now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.module.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.module.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.module.handle_timeout(now);
        self.follow(now);
    }
}

#[test]
fn python_canopen_finds_an_emulated_io_module_right() {
    let test = "peers::digital_io::python_canopen_finds_an_emulated_io_module_right";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.6);
    let node = NodeId::new(1).unwrap();
    let config =
        DigitalIoConfig { input_bytes: 8, output_bytes: 8, power_on: clock::now(), ..DigitalIoConfig::new(node) };
    let wired = Wired { module: DigitalIo::new(config).unwrap(), levels: 0 };
    Adapter::new(Some(Box::new(wired))).served(|tty| {
        judged(&mut Bus::slcan(tty).script_with(&python, "digital_io.py", "cia401-emulated.eds"));
    });
}
