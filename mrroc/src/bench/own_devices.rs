//! The emulated devices of other crates.

use hil::{LineDevice, Surroundings, View, World};
use serial::VirtualLine;

use crate::bench::emulation::{Absent, LINE};
use crate::bench::plants::EmulatedCell;
use crate::bench::random::Stream;
use crate::cell::Device;

impl EmulatedCell<'_> {
    /// Adds the lines of all devices of other crates, switched on at time zero. The scene is in `world` already.
    /// Returns the host's ends.
    pub fn add_devices(&self, world: &mut World) -> Vec<VirtualLine> {
        let devices = self.file.cell.device.iter().enumerate();
        let add = |(number, device): (usize, &Device)| {
            let view = world.scene_mut().map_or(View::EMPTY, |scene| scene.view());
            let line = world.add_line(device.own.line().settings, None, self.own_device(number, device, view));
            world.host_line(line, LINE)
        };
        devices.map(add).collect()
    }

    fn own_device(&self, number: usize, device: &Device, view: View) -> Box<dyn LineDevice> {
        let emulator = device.keys.emulator;
        if emulator.absent {
            return Box::new(Absent);
        }
        let robots = &self.file.cell.robot;
        let carrier = device.keys.robot.as_ref().and_then(|name| robots.iter().position(|robot| robot.name == *name));
        let flanges = self.flanges.borrow();
        let flange = carrier.and_then(|robot| flanges.get(robot)?.clone());
        let (flange, place) = match flange {
            Some((flange, mechanism_from_flange)) => (Some(flange), mechanism_from_flange * device.place()),
            None => (None, device.place()),
        };
        let seed = Stream::Device(number).seed(self.file);
        device.own.emulated(Surroundings::new(view, flange, place, emulator.noise, seed), emulator.silent_from_s)
    }
}
