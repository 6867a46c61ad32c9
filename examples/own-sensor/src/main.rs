//! A program with every command of `mrroc` for a range finder of its own: a time-of-flight sensor at the flange of an
//! IRb-6, on a serial line. The task measures the height of the flange in two poses. The protocol is invented.
//!
//! | telegram | bytes |
//! |---|---|
//! | query | `R`, number |
//! | answer | `r`, number of the query, distance in mm (16 bits, big-endian; 0xFFFF without a target), strength, sum |

use std::{f64::consts::FRAC_PI_2, process::ExitCode};

use mrroc::Extension;
use mrroc::devices::{
    Answer, DeviceValue, LineConfig, LineDriver, LineEmulator, MOST_QUERY, OwnDevice, Reception, Settings, StopBits,
    Surroundings,
};
use mrroc::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Distance in an answer without a target, mm.
const NO_TARGET: u16 = u16::MAX;

/// Keys of a range finder in the cell file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct TofRange {
    /// Greatest distance of a target, m.
    reach: f64,
    /// Bits per second of the line.
    baud: u32,
}

impl Default for TofRange {
    fn default() -> Self {
        Self { reach: 4.0, baud: 115_200 }
    }
}

impl OwnDevice for TofRange {
    const KIND: &'static str = "tof-range";
    const VALUES: &'static [DeviceValue] =
        &[DeviceValue::new("distance", "m", [0.0, 20.0]), DeviceValue::new("strength", "", [0.0, 1.0])];
    type Driver = Driver;
    type Emulator = Sensor;

    fn line(&self) -> LineConfig {
        let settings = Settings { baud: self.baud, stop_bits: StopBits::One };
        let line = LineConfig::polled(settings, 2, 6).numbered();
        line.every(Duration::from_millis(20)).answering_within(Duration::from_millis(5))
    }

    fn check(&self) -> Result<(), String> {
        let sound = self.reach > 0.0 && self.reach <= 20.0;
        sound.then_some(()).ok_or_else(|| format!("has a reach of {} m, must be above 0 and at most 20 m", self.reach))
    }

    fn driver(&self) -> Driver {
        Driver::default()
    }

    fn emulator(&self) -> Sensor {
        Sensor { reach: self.reach, has_begun: false }
    }
}

/// The host's end.
#[derive(Default)]
struct Driver {
    number: u8,
    answer: [u8; 6],
    count: usize,
}

impl LineDriver for Driver {
    fn query(&mut self, _now: Instant, query: &mut [u8; MOST_QUERY]) -> usize {
        self.number = self.number.wrapping_add(1);
        [query[0], query[1]] = [b'R', self.number];
        2
    }

    fn receive(&mut self, byte: u8, _now: Instant, values: &mut [f64]) -> Reception {
        if self.count == 0 && byte != b'r' {
            return Reception::Skipped;
        }
        self.answer[self.count] = byte;
        self.count += 1;
        if self.count < self.answer.len() {
            return Reception::Pending;
        }
        self.count = 0;
        let [_, number, high, low, strength, sum] = self.answer;
        if number != self.number || sum != checksum(&self.answer[..5]) {
            return Reception::Skipped;
        }
        let distance = u16::from_be_bytes([high, low]);
        values[0] = if distance == NO_TARGET { f64::NAN } else { f64::from(distance) / 1e3 };
        values[1] = f64::from(strength) / 255.0;
        Reception::Sample
    }

    fn restart(&mut self) {
        self.count = 0;
    }
}

/// The device's end.
struct Sensor {
    reach: f64,
    /// Whether a query has begun.
    has_begun: bool,
}

impl LineEmulator for Sensor {
    fn receive(&mut self, byte: u8, _now: Instant, around: &mut Surroundings, answer: &mut Answer<'_>) {
        if !std::mem::take(&mut self.has_begun) {
            self.has_begun = byte == b'R';
            return;
        }
        let noise = around.noise();
        let distance = around.distance([0.0, 0.0, 1.0]).filter(|distance| *distance <= self.reach);
        let on_wire = distance.map_or(NO_TARGET, |distance| (1e3 * (distance + noise)).round() as u16);
        let strength = distance.map_or(0.0, |distance| 255.0 * (1.0 - distance / self.reach));
        let [high, low] = on_wire.to_be_bytes();
        let bytes = [b'r', byte, high, low, strength as u8];
        answer.send(Duration::from_millis(2), &bytes);
        answer.send(Duration::from_millis(2), &[checksum(&bytes)]);
    }
}

fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// Measures the height of the flange above the floor in two poses with the tool down.
async fn measure(cell: &mut Cell) -> Outcome {
    let (mut irb6, range) = (cell.robot("irb6")?, cell.device("range")?);
    irb6.enable().await?;
    irb6.home().await?;
    for (name, lower_arm) in [("error_above_mm", -1.571), ("error_below_mm", -1.3)] {
        let down = [0.0, lower_arm, 0.0, FRAC_PI_2, 0.0];
        irb6.execute(irb6.motions().joints(0.5, &[down])?).await?;
        let distance = range.read().await?.value("distance")?;
        let height = irb6.image()?.commanded.pose.translation.z;
        cell.figure(name, 1e3 * (distance - height));
    }
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc_console::main(&Extension::new().device::<TofRange>().task("measure", measure))
}
