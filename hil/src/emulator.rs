//! Emulated devices whose kind another crate adds, and their view of the world.

use std::time::Duration;

use can::Instant;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::plant::Noise;
use crate::scene::{FlangeProbe, View};
use crate::{LineDevice, Mechanism, outbox::Outbox};

/// The emulation of one device on a serial line, as a function of (bytes, now): no thread, no clock, no tty. The
/// emulation is written from the manual of the device, and shares no code with its driver except the layout of
/// telegrams.
///
/// `now` never decreases, and [`advance`](Self::advance) is called at [`next`](Self::next) before any later byte is
/// handed in.
///
/// Methods with a default may be added to this trait; every other change is announced in the change log.
pub trait LineEmulator: Send + 'static {
    /// Takes a byte whose last stop bit ended at `now`.
    fn receive(&mut self, byte: u8, now: Instant, surroundings: &mut Surroundings, answer: &mut Answer<'_>);

    /// Time of the next [`advance`](Self::advance) that the device requests, if any.
    fn next(&self) -> Option<Instant> {
        None
    }

    /// Advances the internal time of the device to `now`. A device that sends by itself sends here.
    fn advance(&mut self, _now: Instant, _surroundings: &mut Surroundings, _answer: &mut Answer<'_>) {}
}

/// The view that an emulated device has of the world. The view is read-only.
///
/// Methods may be added to this type; every other change is announced in the change log.
#[derive(Debug)]
pub struct Surroundings {
    view: View,
    flange: Option<FlangeProbe>,
    place: Isometry3<f64>,
    noise: Noise,
    deviation: f64,
}

impl Surroundings {
    /// A device at `place` in the frame of `flange`, or in the world without a flange. `deviation`: standard deviation
    /// of [`noise`](Self::noise), whose random numbers follow from `seed`.
    pub fn new(view: View, flange: Option<FlangeProbe>, place: Isometry3<f64>, deviation: f64, seed: u64) -> Self {
        Self { view, flange, place, noise: Noise::new(seed), deviation }
    }

    /// Present frame of the device in the frame of the cell.
    pub fn pose(&self) -> Isometry3<f64> {
        self.flange.as_ref().map_or(self.place, |flange| flange.pose() * self.place)
    }

    /// Distance from the origin of the device to the first surface in a direction of its frame, m. The device sees
    /// walls and bodies of the scene, and no tools and links of robots. `None` without a surface, and for a direction
    /// of length zero.
    pub fn distance(&self, direction: [f64; 3]) -> Option<f64> {
        let pose = self.pose();
        let direction = Unit::try_new(pose.rotation * Vector3::from(direction), 1e-12)?;
        self.view.ray(&Point3::from(pose.translation.vector), &direction).map(|hit| hit.distance)
    }

    /// Distance from the origin of the device to the nearest surface in a cone, m. `half_cone`: half the opening angle,
    /// rad. See [`View::nearest_in_cone`].
    pub fn nearest_in_cone(&self, direction: [f64; 3], half_cone: f64) -> Option<f64> {
        let pose = self.pose();
        let axis = Unit::try_new(pose.rotation * Vector3::from(direction), 1e-12)?;
        self.view.nearest_in_cone(&Point3::from(pose.translation.vector), &axis, half_cone)
    }

    /// The walls and bodies of the scene.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// A random number with mean 0 and the standard deviation that the cell gives as `noise` of the emulator.
    pub fn noise(&mut self) -> f64 {
        self.deviation * self.noise.normal()
    }
}

/// The answer of an emulated device.
pub struct Answer<'a> {
    outbox: &'a mut Outbox,
    last: &'a mut Instant,
    now: Instant,
}

impl Answer<'_> {
    /// Sends bytes after a delay. Bytes leave in the order of the calls, and the line takes its time for each. Bytes
    /// beyond 1024 that wait are lost.
    pub fn send(&mut self, after: Duration, bytes: &[u8]) {
        *self.last = (self.now + after).max(*self.last);
        self.outbox.put(*self.last, bytes);
    }
}

/// An emulator at the end of a line.
pub struct EmulatedOnLine<E> {
    emulator: E,
    surroundings: Surroundings,
    outbox: Outbox,
    last: Instant,
}

impl<E: LineEmulator> EmulatedOnLine<E> {
    /// The device `emulator` in its surroundings.
    pub fn new(emulator: E, surroundings: Surroundings) -> Self {
        Self { emulator, surroundings, outbox: Outbox::new(), last: Instant::ZERO }
    }
}

impl<E: LineEmulator> LineDevice for EmulatedOnLine<E> {
    fn receive(&mut self, byte: u8, now: Instant) {
        let Self { emulator, surroundings, outbox, last } = self;
        outbox.run(now);
        emulator.receive(byte, now, surroundings, &mut Answer { outbox, last, now });
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.outbox.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.emulator.next().into_iter().chain(self.outbox.poll_timeout()).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        let Self { emulator, surroundings, outbox, last } = self;
        outbox.run(now);
        if emulator.next().is_some_and(|next| next <= now) {
            emulator.advance(now, surroundings, &mut Answer { outbox, last, now });
        }
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.surroundings.flange.as_ref().map(FlangeProbe::mechanism)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::MechanismConfig;
    use crate::scene::{Material, Scene, Shape, WallConfig};

    /// Answers each byte with the distance along its z axis, cm, and sends 0 every 10 ms.
    struct Range {
        next: Instant,
    }

    impl LineEmulator for Range {
        fn receive(&mut self, byte: u8, _now: Instant, surroundings: &mut Surroundings, answer: &mut Answer<'_>) {
            let distance = surroundings.distance([0.0, 0.0, 1.0]).map_or(255, |distance| (100.0 * distance) as u8);
            answer.send(Duration::from_millis(1), &[byte, distance]);
        }

        fn next(&self) -> Option<Instant> {
            Some(self.next)
        }

        fn advance(&mut self, now: Instant, _surroundings: &mut Surroundings, answer: &mut Answer<'_>) {
            answer.send(Duration::ZERO, &[0]);
            self.next = now + Duration::from_millis(10);
        }
    }

    fn floor() -> Scene {
        let mut scene = Scene::new();
        let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.3 };
        scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material }).unwrap();
        scene
    }

    #[test]
    fn a_device_answers_after_its_delay_and_sends_by_itself_at_its_times() {
        // Half a turn about x: the device looks downwards.
        let place = Isometry3::new(Vector3::new(0.0, 0.0, 0.5), Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let surroundings = Surroundings::new(floor().view(), None, place, 0.0, 1);
        let mut device = EmulatedOnLine::new(Range { next: Instant::ZERO + Duration::from_millis(10) }, surroundings);
        let at = |millis| Instant::ZERO + Duration::from_millis(millis);
        device.receive(7, at(2));
        assert_eq!((device.poll_transmit(at(2)), device.poll_timeout()), (None, Some(at(3))));
        device.handle_timeout(at(3));
        assert_eq!([0, 1, 2].map(|_| device.poll_transmit(at(3))), [Some(7), Some(50), None]);
        assert_eq!(device.poll_timeout(), Some(at(10)));
        device.handle_timeout(at(10));
        assert_eq!((device.poll_transmit(at(10)), device.poll_timeout()), (Some(0), Some(at(20))));
    }

    #[test]
    fn a_device_on_a_flange_moves_with_the_robot() {
        let mut scene = floor();
        let mechanism = Mechanism::new(MechanismConfig::Irb6);
        let robot = scene.add_robot(&mechanism, &Isometry3::translation(0.0, 0.0, 1.0)).unwrap();
        let flange = scene.watch_flange(robot);
        assert!((flange.pose().translation.vector - scene.flange(robot).translation.vector).norm() < 1e-12);
        let place = Isometry3::translation(0.0, 0.0, 0.1);
        let surroundings = Surroundings::new(scene.view(), Some(flange.clone()), place, 0.0, 1);
        let expected = flange.pose() * place;
        assert!((surroundings.pose().translation.vector - expected.translation.vector).norm() < 1e-12);
        let device = EmulatedOnLine::new(Range { next: Instant::ZERO }, surroundings);
        assert!(device.mechanism().is_some_and(|it| it.is(&mechanism)));
    }

    #[test]
    fn noise_follows_from_seed_and_deviation() {
        let drawn = |deviation, seed| {
            let mut it = Surroundings::new(View::EMPTY, None, Isometry3::identity(), deviation, seed);
            [0; 8].map(|_| it.noise())
        };
        assert_eq!(drawn(0.0, 1), [0.0; 8]);
        assert_eq!(drawn(0.1, 1), drawn(0.1, 1));
        assert_ne!(drawn(0.1, 1), drawn(0.1, 2));
    }
}
