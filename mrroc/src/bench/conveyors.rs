//! The conveyors, objects and light gates of an emulated scene.

use std::time::Duration;

use can::Instant;
use hil::Scene;
use hil::scene::{BeamConfig, BodyConfig, Material, Shape, WallConfig};
use nalgebra::{Isometry3, Vector3};

use super::plants::EmulatedCell;
use super::random::Stream;
use super::scene::SOUND;
use crate::cell::{EmulatedObject, EmulatedScene};

/// Thickness of a conveyor, m.
const THICKNESS: f64 = 0.1;

impl EmulatedCell<'_> {
    /// Adds the conveyors, their objects and the light gates of the cell to a scene in the frame of the cell.
    pub(super) fn add_conveyors(&self, scene: &mut Scene, around: &EmulatedScene) {
        let frames: Vec<_> = around.conveyor.iter().map(|it| it.frame()).collect();
        for (conveyor, frame) in around.conveyor.iter().zip(&frames) {
            let [length, width] = conveyor.size;
            let belt = WallConfig {
                shape: Shape::Box { half: [length / 2.0, width / 2.0, THICKNESS / 2.0] },
                pose: frame * Isometry3::translation(0.0, 0.0, -THICKNESS / 2.0),
                material: Material {
                    stiffness: conveyor.stiffness,
                    damping: conveyor.damping,
                    friction: conveyor.friction,
                },
            };
            let wall = scene.add_wall(&belt).expect(SOUND);
            let velocity = frame.rotation * (Vector3::x() * conveyor.speed);
            let period = Duration::from_secs_f64(conveyor.drift_period_s);
            scene.drift_belt(wall, velocity.into(), conveyor.drift, period);
        }
        for object in &around.object {
            let conveyor = &around.conveyor[object.conveyor];
            let material =
                Material { stiffness: conveyor.stiffness, damping: conveyor.damping, friction: conveyor.friction };
            let at = Instant::ZERO + Duration::from_secs_f64(object.at_s);
            scene.place_body(at, &body(object, &frames[object.conveyor], material)).expect(SOUND);
        }
        for (number, (gate, probe)) in around.gate.iter().zip(&self.beams).enumerate() {
            let config = BeamConfig {
                from: gate.from,
                to: gate.to,
                response: gate.response(),
                jitter: gate.jitter(),
                seed: Stream::Conveyor(number).seed(self.file),
            };
            scene.add_beam(&config, probe.clone()).expect(SOUND);
        }
    }
}

/// An object at rest on a surface with this frame.
fn body(object: &EmulatedObject, frame: &Isometry3<f64>, material: Material) -> BodyConfig {
    let half = object.size.map(|edge| edge / 2.0);
    BodyConfig {
        mass: object.mass,
        half,
        material,
        pose: frame * Isometry3::translation(object.along, object.across, half[2]),
        velocity: [0.0; 3],
        spin: [0.0; 3],
    }
}
