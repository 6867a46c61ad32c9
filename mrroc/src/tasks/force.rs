//! A force/torque sensor of a cell, as a task sees it.

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use controller::executor::Agents;
use controller::force::Wrench;
use controller::generator::GeneratorError;
use controller::robot::Pose;
use controller::sensor::{ForceError, ForceReading, ForceTorque};
use drive::wrench::{WrenchFault, ZeroFailure, Zeroing};

use super::{Outcome, TaskError};

/// Servo periods that a zeroing may take beyond its samples.
const SPARE: u32 = 100;

/// Longest time in which a zeroing whose samples differ is repeated.
const SETTLING: Duration = Duration::from_secs(1);

/// Time over which the reading before a zeroing is averaged, and compared with `max_offset`. An arm at rest vibrates by single
/// counts of its encoders, and a heavy tool then reads several newtons in single samples.
const CALM: Duration = Duration::from_millis(200);

/// A force/torque sensor at the flange of a robot.
#[derive(Clone)]
pub struct ForceSensor {
    name: Box<str>,
    sensor: ForceTorque,
    agents: Agents,
    period: Duration,
    /// Longest duration of a zeroing of a tool at rest.
    patience: Duration,
}

impl ForceSensor {
    pub(super) fn new(name: &str, sensor: ForceTorque, agents: Agents, period: Duration, samples: u16) -> Self {
        let patience = period * (u32::from(samples) + SPARE) + SETTLING;
        Self { name: name.into(), sensor, agents, period, patience }
    }

    /// Name of the sensor in the cell file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The virtual sensor, for [`Robot::sense`](super::Robot::sense).
    pub fn sensor(&self) -> ForceTorque {
        self.sensor.clone()
    }

    /// The last reading and the time of its sample.
    pub fn read(&self) -> Result<(Instant, ForceReading), TaskError> {
        let (at, reading) = self.sensor.read().ok_or_else(|| self.failed(ForceError::Busy))?;
        match reading.in_sensor() {
            Err(GeneratorError::Force(error)) => Err(self.failed(error)),
            Err(error) => Err(error.into()),
            Ok(_) => Ok((at, reading)),
        }
    }

    /// The contact wrench on the tool in the frame of the tool, by the last sample.
    pub fn in_tool(&self) -> Result<Wrench, TaskError> {
        Ok(self.read()?.1.in_tool()?)
    }

    /// The contact wrench on the tool in the frame of the robot's base, by the last sample.
    pub fn in_base(&self) -> Result<Wrench, TaskError> {
        Ok(self.read()?.1.in_base()?)
    }

    /// The contact wrench on the tool in a frame at rest, given in the frame of the robot's base, by the last sample.
    pub fn in_frame(&self, base_from_frame: &Pose) -> Result<Wrench, TaskError> {
        Ok(self.read()?.1.in_frame(base_from_frame)?)
    }

    /// Makes the present reading the zero: the offset of the sensor, and any contact. The robot must stand still, homed and
    /// without contact, until the zeroing is done. Fails if the sensor has a fault or gives no samples, if the robot moves,
    /// and if the reading still changes by a tenth of the range after a second. Also fails if the reading before the zeroing,
    /// without the weight of the tool and averaged over 0.2 s, exceeds `max_offset` of the cell file for a second
    /// ([`ForceError::Offset`]): a contact, or another tool. A smaller constant contact force is not detected.
    pub async fn zero(&self) -> Outcome {
        // A sensor with a fault, or at a robot that is not homed, is refused before the request.
        self.read()?;
        self.stands_still()?;
        let mut last = Readings::over(CALM, self.period);
        let mut waited = Duration::ZERO;
        loop {
            last.push(self.read()?.1.in_sensor()?);
            self.agents.sleep(self.period).await;
            waited += self.period;
            self.stands_still()?;
            let Some(contact) = last.mean() else { continue };
            match self.sensor.can_be_zeroed(&contact) {
                Ok(()) => break,
                // The arm may still oscillate after its last motion.
                Err(ForceError::Offset { .. }) if waited < SETTLING => {}
                Err(error) => return Err(self.failed(error)),
            }
        }
        let mut request = self.sensor.link().zero();
        let mut waited = Duration::ZERO;
        loop {
            let zeroing = self.sensor.link().read().zeroing;
            self.stands_still()?;
            if zeroing.is_done(request) {
                // The reading notes the weight of the tool in this orientation.
                return self.read().map(|_| ());
            }
            let unsteady = matches!(zeroing, Zeroing::Failed { cause: ZeroFailure::Unsteady { .. }, .. });
            if zeroing.has_failed(request) && unsteady && waited < SETTLING {
                // The arm still oscillates after its last motion.
                request = self.sensor.link().zero();
            } else if zeroing.has_failed(request) || waited > self.patience {
                self.read()?;
                return Err(self.failed(match zeroing {
                    Zeroing::Failed { cause: ZeroFailure::Unsteady { axis }, .. } => ForceError::Unsteady { axis },
                    Zeroing::Failed { cause: ZeroFailure::NotBiased { axis }, .. } => ForceError::NotBiased { axis },
                    _ => ForceError::NotZeroed { waited },
                }));
            }
            self.agents.sleep(self.period).await;
            waited += self.period;
        }
    }

    /// Changes the part that the tool carries beside the `tool` of the cell file, for example after a gripper has closed or
    /// opened: a point mass, kg, with its centre in the frame of the sensor, m. A mass of 0 is no part. Weight and inertia of
    /// the part are compensated in readings from now on, and by the force law from its next motion on. The zero of the sensor
    /// stays valid.
    ///
    /// Fails while the robot moves, if a number is not finite, if the mass is negative, and if the weight of tool and part can
    /// saturate the sensor.
    ///
    /// ```
    /// # use mrroc::prelude::*;
    /// # async fn pick(cell: &mut Cell) -> Outcome {
    /// let wrist = cell.force_sensor("wrist")?;
    /// // A part of 0.8 kg, 120 mm in front of the sensor.
    /// wrist.set_payload(0.8, [0.0, 0.0, 0.12])?;
    /// # Ok(())
    /// # }
    /// ```
    pub fn set_payload(&self, mass: f64, centre: [f64; 3]) -> Outcome {
        self.sensor.set_payload(mass, centre.into()).map_err(|error| self.failed(error))
    }

    /// The fault of the sensor in the last servo cycle.
    pub fn fault(&self) -> Option<WrenchFault> {
        self.sensor.link().read().fault
    }

    /// Requests a reset of the fault of the sensor, and does not wait. A fault that persists is latched again.
    pub fn reset_fault(&self) {
        self.sensor.link().reset_fault();
    }

    fn stands_still(&self) -> Outcome {
        self.sensor.stands_still().map_err(|error| self.failed(error))
    }

    fn failed(&self, error: ForceError) -> TaskError {
        TaskError::ForceSensor { name: self.name.clone(), error }
    }
}

/// The wrenches of the last readings.
struct Readings {
    wrenches: VecDeque<Wrench>,
    /// Number of readings.
    whole: usize,
}

impl Readings {
    /// Readings of `time`, one per `period`.
    fn over(time: Duration, period: Duration) -> Self {
        let whole = time.as_nanos().div_ceil(period.as_nanos().max(1)).max(1) as usize;
        Self { wrenches: VecDeque::with_capacity(whole), whole }
    }

    fn push(&mut self, wrench: Wrench) {
        if self.wrenches.len() == self.whole {
            self.wrenches.pop_front();
        }
        self.wrenches.push_back(wrench);
    }

    /// The mean, once the readings are complete.
    fn mean(&self) -> Option<Wrench> {
        let sum = self.wrenches.iter().fold(Wrench::default(), |sum, wrench| sum + *wrench);
        let mean = Wrench::from_components(sum.components().map(|sum| sum / self.whole as f64));
        (self.wrenches.len() == self.whole).then_some(mean)
    }
}
