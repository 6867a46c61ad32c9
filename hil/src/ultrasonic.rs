//! An emulated ultrasonic matrix at a serial line: N × N transducers that look along one axis and measure echo times.
//!
//! [`serial::ultrasonic`] has the protocol. The reply begins [`UltrasonicConfig::answer_delay`] after the last firing slot.
//!
//! The echo of a pair is a model: the wave is reflected by a surface parallel to the matrix, halfway between emitter
//! and receiver. The distance of this surface is the larger of the distances of the two elements, since no nearer
//! surface is in both cones. The point of reflection must be in the cones of emitter and receiver. Not modelled:
//! crosstalk, the dead time after an emission, and the loss of amplitude with distance and with the inclination of the
//! surface.

mod frames;
mod probe;
#[cfg(test)]
mod tests;

use std::time::Duration;

use can::Instant;
use serial::Settings;
pub use serial::ultrasonic::{GAP, MAX_SIZE, NO_ECHO};
use thiserror::Error;

use crate::plant::Noise;
use crate::{LineDevice, outbox::Outbox};
use frames::Receiver;
pub use probe::SceneEchoes;

/// Source of the distances in front of a matrix, for the emulated device.
pub trait EchoProbe: Send {
    /// Distance from an element (row, column) to the nearest surface in its cone at `now`, m; `None` if there is no
    /// surface in the cone. `now` never decreases.
    fn distance(&mut self, element: (usize, usize), now: Instant) -> Option<f64>;
}

/// Configuration of a matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct UltrasonicConfig {
    /// Elements per row and column, 1 to [`MAX_SIZE`].
    pub size: u8,
    /// Distance between neighbouring elements, m, at most 6.5 m.
    pub pitch: f64,
    /// Half the opening angle of an element's cone, rad.
    pub half_cone: f64,
    /// Firing slot: duration of one emission with its echoes, 1 to 65 534 µs. An echo after the slot is not received.
    pub slot: Duration,
    /// Speed of sound, m/s.
    pub speed_of_sound: f64,
    /// Standard deviation of the noise of a measured distance, m.
    pub noise: f64,
    /// Share of echoes that are lost, 0 to 1.
    pub drop_out: f64,
    /// Seed of noise and lost echoes.
    pub seed: u64,
    /// Delay from the end of a measurement to the first byte of its reply.
    pub answer_delay: Duration,
}

impl Default for UltrasonicConfig {
    /// 12 × 12 elements with a pitch of 20 mm, cones with a half-angle of 8°, slots of 3.5 ms, noise of 1 mm, and no
    /// lost echo.
    fn default() -> Self {
        Self {
            size: 12,
            pitch: 0.02,
            half_cone: 8.0_f64.to_radians(),
            slot: Duration::from_micros(3500),
            speed_of_sound: 343.0,
            noise: 0.001,
            drop_out: 0.0,
            seed: 0,
            answer_delay: Duration::from_micros(100),
        }
    }
}

/// Reasons why the configuration of a matrix is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum UltrasonicError {
    #[error("{size} elements per row, 1 to 64 are possible")]
    Size { size: u8 },
    #[error("the pitch is {pitch} m, it must be above 0 and at most 6.5 m")]
    Pitch { pitch: f64 },
    #[error("half the cone is {half_cone} rad, it must be 0 or above, and below π/2")]
    Cone { half_cone: f64 },
    #[error("a firing slot takes {slot:?}, 1 to 65534 µs are possible")]
    Slot { slot: Duration },
    #[error("the speed of sound is {speed} m/s, it must be above 0 and finite")]
    SpeedOfSound { speed: f64 },
    #[error("the noise is {noise} m, it must be 0 or above, and finite")]
    Noise { noise: f64 },
    #[error("the share of lost echoes is {share}, it must be 0 to 1")]
    DropOut { share: f64 },
}

impl UltrasonicConfig {
    /// Position of an element (row, column) in the plane of the matrix, m. The first coordinate grows with the column
    /// number, the second with the row number. The origin is the centre of the matrix.
    pub fn position(&self, element: (usize, usize)) -> [f64; 2] {
        let middle = (f64::from(self.size) - 1.0) / 2.0;
        [element.1, element.0].map(|number| (number as f64 - middle) * self.pitch)
    }

    fn check(&self) -> Result<(), UltrasonicError> {
        let Self { size, pitch, half_cone, slot, speed_of_sound: speed, noise, drop_out: share, .. } = *self;
        // The reply to `identify` has 16 bits for the pitch in 0.1 mm.
        let checks = [
            ((1..=MAX_SIZE).contains(&size), UltrasonicError::Size { size }),
            (pitch > 0.0 && pitch <= 6.5, UltrasonicError::Pitch { pitch }),
            ((0.0..std::f64::consts::FRAC_PI_2).contains(&half_cone), UltrasonicError::Cone { half_cone }),
            ((1..=65_534).contains(&slot.as_micros()), UltrasonicError::Slot { slot }),
            (speed > 0.0 && speed.is_finite(), UltrasonicError::SpeedOfSound { speed }),
            (noise >= 0.0 && noise.is_finite(), UltrasonicError::Noise { noise }),
            ((0.0..=1.0).contains(&share), UltrasonicError::DropOut { share }),
        ];
        checks.into_iter().find_map(|(passed, error)| (!passed).then_some(error)).map_or(Ok(()), Err)
    }
}

/// A measurement in progress.
#[derive(Clone, Copy, Debug)]
struct Measurement {
    query: Query,
    /// Time of the next emission, or of the end of the measurement.
    next_at: Instant,
    /// Number of emissions done.
    fired: u8,
}

#[derive(Clone, Copy, Debug)]
enum Query {
    Pair { emitter: (u8, u8), receiver: (u8, u8) },
    Row(u8),
}

/// An ultrasonic matrix at a serial line.
pub struct UltrasonicMatrix {
    config: UltrasonicConfig,
    probe: Box<dyn EchoProbe>,
    noise: Noise,
    receiver: Receiver,
    measurement: Option<Measurement>,
    /// Echo times of the measurement in progress, µs.
    times: Vec<u16>,
    outbox: Outbox,
    /// Whether a byte is on the wire.
    sending: bool,
}

impl UltrasonicMatrix {
    /// Settings of the line: 115200 8N1.
    pub const SETTINGS: Settings = serial::ultrasonic::SETTINGS;

    /// A matrix at rest.
    pub fn new(config: UltrasonicConfig, probe: Box<dyn EchoProbe>) -> Result<Self, UltrasonicError> {
        config.check()?;
        Ok(Self {
            noise: Noise::new(config.seed),
            times: Vec::with_capacity(config.size.into()),
            config,
            probe,
            receiver: Receiver::default(),
            measurement: None,
            outbox: Outbox::new(),
            sending: false,
        })
    }

    fn execute(&mut self, body: &[u8], now: Instant) {
        let Some((&command, data)) = body.split_first() else {
            return;
        };
        let query = match (command, data) {
            (frames::IDENTIFY, []) => {
                let pitch = ((self.config.pitch * 1e4).round() as u16).to_be_bytes();
                // The check of the configuration limits the slot to 16 bits.
                let slot = (self.config.slot.as_micros() as u16).to_be_bytes();
                let body = [command, self.config.size, pitch[0], pitch[1], slot[0], slot[1]];
                return self.send(&body, now);
            }
            (frames::PAIR, &[row, column, to_row, to_column]) => {
                Query::Pair { emitter: (row, column), receiver: (to_row, to_column) }
            }
            (frames::ROW, &[row]) => Query::Row(row),
            (frames::IDENTIFY | frames::PAIR | frames::ROW, _) => {
                return self.send(&[frames::REFUSAL, command, frames::WRONG_LENGTH], now);
            }
            _ => return self.send(&[frames::REFUSAL, command, frames::UNKNOWN_COMMAND], now),
        };
        if data.iter().any(|number| *number >= self.config.size) {
            return self.send(&[frames::REFUSAL, command, frames::NO_ELEMENT], now);
        }
        self.times.clear();
        self.measurement = Some(Measurement { query, next_at: now, fired: 0 });
        self.measure(now);
    }

    fn send(&mut self, body: &[u8], now: Instant) {
        self.outbox.put(now + self.config.answer_delay, &frames::encode(body));
    }

    /// Carries out the emission that is due at `now`, or ends the measurement.
    fn measure(&mut self, now: Instant) {
        let Some(mut measurement) = self.measurement.filter(|measurement| measurement.next_at <= now) else {
            return;
        };
        let wide = |(row, column): (u8, u8)| (usize::from(row), usize::from(column));
        let (emitter, receiver, shots) = match measurement.query {
            Query::Pair { emitter, receiver } => (wide(emitter), wide(receiver), 1),
            Query::Row(row) => (wide((row, measurement.fired)), wide((row, measurement.fired)), self.config.size),
        };
        if measurement.fired < shots {
            let time = self.echo(emitter, receiver, now);
            self.times.push(time);
            measurement.fired += 1;
            measurement.next_at += self.config.slot;
            self.measurement = Some(measurement);
            return;
        }
        self.measurement = None;
        let mut body = match measurement.query {
            Query::Pair { emitter, receiver } => vec![frames::PAIR, emitter.0, emitter.1, receiver.0, receiver.1],
            Query::Row(row) => vec![frames::ROW, row],
        };
        body.extend(self.times.iter().flat_map(|time| time.to_be_bytes()));
        self.send(&body, now);
    }

    /// Echo time of a pair, µs, with noise and lost echoes.
    fn echo(&mut self, emitter: (usize, usize), receiver: (usize, usize), now: Instant) -> u16 {
        // Each emission draws the same number of random numbers, with or without a surface.
        let noise = self.config.noise * self.noise.normal();
        let lost = 0.5 * (self.noise.symmetric() + 1.0) < self.config.drop_out;
        let from = self.probe.distance(emitter, now);
        let to = if receiver == emitter { from } else { self.probe.distance(receiver, now) };
        let (Some(from), Some(to)) = (from, to) else {
            return NO_ECHO;
        };
        let [a, b] = [emitter, receiver].map(|element| self.config.position(element));
        let half_base = (a[0] - b[0]).hypot(a[1] - b[1]) / 2.0;
        let distance = from.max(to);
        let seen = half_base.atan2(distance) <= self.config.half_cone;
        let path = 2.0 * half_base.hypot((distance + noise).max(0.0));
        let micros = (path / self.config.speed_of_sound * 1e6).round();
        let in_slot = micros < self.config.slot.as_micros() as f64;
        if lost || !seen || !in_slot { NO_ECHO } else { micros as u16 }
    }
}

impl LineDevice for UltrasonicMatrix {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.outbox.run(now);
        let busy = self.measurement.is_some() || self.sending || !self.outbox.is_empty();
        if !busy && let Some((body, length)) = self.receiver.receive(byte, now) {
            self.execute(&body[..length], now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let byte = self.outbox.poll_transmit(now);
        // The line calls this function again when the last bit of a byte was sent.
        self.sending = byte.is_some();
        byte
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let measurement = self.measurement.map(|measurement| measurement.next_at);
        measurement.into_iter().chain(self.outbox.poll_timeout()).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.outbox.run(now);
        self.measure(now);
    }
}
