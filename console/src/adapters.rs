//! The emulated buses of a cell behind slcan adapters.

use can::Instant;
use hil::{DeviceId, SlcanConfig, SlcanDevice, World};

use crate::cell_file::CellFile;
use crate::emulation;
use crate::lines::Lines;

/// Buses with the devices of a cell, each reached by the adapter that is one of them: line `n` is that of
/// the `n`-th bus added.
#[derive(Default)]
pub(crate) struct Adapters {
    world: World,
    adapters: Vec<DeviceId>,
    /// Up to when time has passed.
    passed: Instant,
}

impl Adapters {
    /// Adds bus `index` of a cell, its devices switched on at [`Instant::ZERO`].
    pub(crate) fn add(&mut self, file: &CellFile, index: usize) {
        let bus = emulation::add_bus(&mut self.world, file, index);
        let config = SlcanConfig::new(emulation::bitrate(file, index));
        let adapter = Box::new(SlcanDevice::new(config));
        self.adapters.push(self.world.add_device(bus, adapter));
    }

    fn adapter(&mut self, line: usize, now: Instant, change: impl FnOnce(&mut SlcanDevice)) {
        let id = self.adapters[line];
        let adapter = self.world.change(id, now, change);
        adapter.expect("it was added as an adapter");
    }
}

impl Lines for Adapters {
    fn handle_bytes(&mut self, line: usize, bytes: &[u8], now: Instant) {
        self.passed = now;
        self.adapter(line, now, |adapter| adapter.handle_bytes(bytes, now));
    }

    fn bytes(&self, line: usize) -> &[u8] {
        let adapter = self.world.device::<SlcanDevice>(self.adapters[line]);
        adapter.expect("it was added as an adapter").bytes()
    }

    fn consume(&mut self, line: usize, count: usize) {
        self.adapter(line, self.passed, |adapter| adapter.consume(count));
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.world.next_event()
    }

    fn advance(&mut self, now: Instant) {
        self.passed = now;
        self.world.advance(now);
    }
}
