//! Real-time needs of the servo thread, as stated in a cell file.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::config::refusal::{KeyError, Range, conflict, no_effect, within};

/// What the servo thread asks of the host.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Realtime {
    /// Whether a denied request is reported or refuses the start.
    pub policy: Policy,
    /// What schedules the servo thread.
    pub scheduler: Scheduler,
    /// Priority under SCHED_FIFO, 1 to 99; the controller's thread is some below it under either scheduler.
    pub priority: u8,
    /// The CPU to pin the servo thread to; none leaves it to the scheduler. None with `scheduler = "deadline"`.
    pub cpu: Option<usize>,
    // The stack of each later thread is locked as a whole, so such threads need small stacks.
    /// Whether to lock the process's memory.
    pub lock_memory: bool,
    /// How the servo thread waits for its deadlines.
    pub wait: Wait,
    // A learnt margin covers all but about one in 1000 wake-ups. After a late wake-up it grows to at most half a
    // period for some cycles, within the share.
    /// How long before it needs to run a hybrid wait asks to be woken, µs; none learns it from how late the host is.
    #[serde(rename = "margin_us", with = "microseconds")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<u32>"))]
    pub margin: Option<Duration>,
    /// Largest share of a core that a hybrid wait spins in, 0 to 0.5: of each period with `margin_us`, of any second but for a twentieth without.
    /// 0.2 where absent.
    pub spin_share: Option<f64>,
}

/// What happens when the host denies a real-time request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Policy {
    /// The run does not start.
    Require,
    /// The run starts and its report says what was denied.
    BestEffort,
}

/// What schedules the servo thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Scheduler {
    /// SCHED_FIFO: before all threads of a lower priority, for as long as it wants to run.
    Fifo,
    // A thread that has used its budget up stands still until the period is over, which is a late cycle.
    /// SCHED_DEADLINE: before all threads under SCHED_FIFO, for nine tenths of each period at most. Needs CAP_SYS_NICE,
    /// which no limit stands for, and all CPUs.
    Deadline,
}

/// How the servo thread waits for its deadlines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Wait {
    /// It sleeps until the deadline, and is as late as the host wakes it.
    Plain,
    /// It sleeps to a margin before the deadline, then spins: punctual, for some of a core.
    Hybrid,
}

impl Default for Realtime {
    fn default() -> Self {
        Self { wait: Wait::Hybrid, ..Self::PLAIN }
    }
}

impl Realtime {
    /// The default but for a plain wait.
    pub const PLAIN: Self = Self {
        policy: Policy::BestEffort,
        scheduler: Scheduler::Fifo,
        priority: 80,
        cpu: None,
        lock_memory: true,
        wait: Wait::Plain,
        margin: None,
        spin_share: None,
    };

    /// Largest share of a core that a hybrid wait spins in.
    pub fn spin_share(&self) -> f64 {
        self.spin_share.unwrap_or(0.2)
    }

    /// Refuses numbers outside their ranges and keys that contradict each other, for a servo of this period.
    pub fn check(&self, period: Duration) -> Result<(), KeyError> {
        within("priority", f64::from(self.priority), Range::new(1.0, 99.0, ""))?;
        if self.scheduler == Scheduler::Deadline && self.cpu.is_some() {
            return conflict(
                "cpu",
                "must be left out with scheduler = \"deadline\", which the kernel grants only to a thread that may run \
                 on all CPUs",
            );
        }
        // The size of the kernel's sets of CPUs.
        within("cpu", self.cpu.unwrap_or(0) as f64, Range::new(0.0, 1023.0, ""))?;
        if self.wait == Wait::Plain {
            let because = "with wait = \"plain\", which does not spin";
            no_effect("spin_share", self.spin_share.is_some(), because)?;
            no_effect("margin_us", self.margin.is_some(), because)?;
        }
        let share = self.spin_share();
        within("spin_share", share, Range::new(0.0, 0.5, "of a core"))?;
        let microseconds = |time: Duration| time.as_nanos() as f64 / 1e3;
        let margin = microseconds(self.margin.unwrap_or_default());
        within("margin_us", margin, Range::new(0.0, share * microseconds(period), "µs, spin_share of the period"))
    }
}

/// Times in cell files, whole µs.
mod microseconds {
    use super::{Deserialize, Duration, Serialize};
    use serde::{Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(time: &Option<Duration>, to: S) -> Result<S::Ok, S::Error> {
        time.map(|time| time.as_micros() as u32).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
        let time = Option::<u32>::deserialize(from)?;
        Ok(time.map(|time| Duration::from_micros(time.into())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needs_that_no_host_can_meet_are_refused_at_their_key() {
        type Case = (fn(&mut Realtime), Option<&'static str>);
        let cases: [Case; 9] = [
            (|_| {}, None),
            (|it| it.priority = 0, Some("priority")),
            (|it| it.cpu = Some(1024), Some("cpu")),
            (|it| (it.scheduler, it.cpu) = (Scheduler::Deadline, Some(0)), Some("cpu")),
            (|it| it.spin_share = Some(f64::NAN), Some("spin_share")),
            (|it| it.margin = Some(Duration::from_nanos(200_001)), Some("margin_us")),
            (|it| it.margin = Some(Duration::from_micros(200)), None),
            (|it| (it.wait, it.margin) = (Wait::Plain, Some(Duration::ZERO)), Some("margin_us")),
            (|it| (it.wait, it.spin_share) = (Wait::Plain, Some(0.2)), Some("spin_share")),
        ];
        for (number, (change, key)) in cases.into_iter().enumerate() {
            let mut realtime = Realtime::default();
            change(&mut realtime);
            let refused = realtime.check(Duration::from_millis(1)).err();
            assert_eq!(refused.map(|it| it.key), key, "case {number}");
        }
    }
}
