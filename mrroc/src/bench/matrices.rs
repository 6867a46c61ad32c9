//! The emulated ultrasonic matrices of a cell.

use std::time::Duration;

use hil::{LineDevice, SceneEchoes, UltrasonicConfig, UltrasonicMatrix, View, World};
use serial::VirtualLine;

use crate::bench::emulated_sensors::Unplugged;
use crate::bench::emulation::{Absent, LINE};
use crate::bench::plants::EmulatedCell;
use crate::bench::random::Stream;
use crate::bench::scene::base_of;
use crate::cell::Ultrasonic;

impl EmulatedCell<'_> {
    /// Adds the lines of all ultrasonic matrices, switched on at time zero. The scene is in `world` already.
    /// Returns the host's ends.
    pub fn add_matrices(&self, world: &mut World) -> Vec<VirtualLine> {
        let matrices = self.file.cell.ultrasonic.iter().enumerate();
        let add = |(number, matrix): (usize, &Ultrasonic)| {
            let view = world.scene_mut().map_or(View::EMPTY, |scene| scene.view());
            let line = world.add_line(matrix.settings(), None, self.matrix(number, matrix, view));
            world.host_line(line, LINE)
        };
        matrices.map(add).collect()
    }

    fn matrix(&self, number: usize, matrix: &Ultrasonic, view: View) -> Box<dyn LineDevice> {
        let emulator = matrix.emulator;
        if emulator.absent {
            return Box::new(Absent);
        }
        let robot = self.file.cell.robot.iter().find(|robot| robot.name == matrix.robot);
        let robot = robot.expect("a parsed cell has the robot of a matrix");
        let config = UltrasonicConfig {
            size: emulator.size.unwrap_or(matrix.size),
            pitch: matrix.pitch,
            half_cone: matrix.half_cone,
            slot: Duration::from_micros(matrix.slot_us.into()),
            speed_of_sound: matrix.speed_of_sound,
            noise: emulator.noise.unwrap_or(matrix.deviation),
            drop_out: emulator.lost_echoes,
            seed: Stream::Matrix(number).seed(self.file),
            ..UltrasonicConfig::default()
        };
        let echoes = SceneEchoes::new(view, base_of(robot) * matrix.base_from_matrix(), &config);
        let device = UltrasonicMatrix::new(config, Box::new(echoes)).expect("a parsed cell has sound matrices");
        match emulator.silent_from_s {
            None => Box::new(device),
            Some(at) => Box::new(Unplugged::new(device, at)),
        }
    }
}
