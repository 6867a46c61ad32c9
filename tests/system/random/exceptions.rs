//! Altered keys for which `mrroc check` accepts a cell that a run then refuses, or that ends in a fault.
//!
//! A check reads files only and rehearses programs on ideal drives. The answers of a drive, the behaviour of a loop
//! with its motor, and the delays of a bus are known in a run only. An exception covers no panic, no hang, no memory
//! growth and no refusal by the check alone.

use super::mutations::Mutations;
use super::verdict::{Disagreement, Kind};

/// A permitted disagreement.
struct Exception {
    /// A key. A trailing dot stands for every key of the table.
    key: &'static str,
    kind: Kind,
    /// Texts of which one must occur in the refusal or in the fault of the run.
    words: &'static [&'static str],
    /// Reason why a check cannot know.
    why: &'static str,
}

const fn refused(key: &'static str, words: &'static [&'static str], why: &'static str) -> Exception {
    let kind = Kind::RefusedByRun;
    Exception { key, kind, words, why }
}

const fn faulted(key: &'static str, words: &'static [&'static str], why: &'static str) -> Exception {
    let kind = Kind::Faulted;
    Exception { key, kind, words, why }
}

const OTHER_DRIVE: &str = "the emulated drive is another one than the cell expects, as the run finds out";

const NO_LOOP: &str = "the rehearsal closes no loop";

/// Faults of a badly tuned loop.
const OF_A_LOOP: &[&str] = &[
    "following error",
    "overcurrent protection acted",
    "motor runs away",
    "measured position stands still",
    "blocked or overloaded",
    "unstable loop",
];

const EXCEPTIONS: &[Exception] = &[
    refused("robot.axis.emulator.vendor", &["identity 0x1018:01"], OTHER_DRIVE),
    refused("robot.axis.emulator.revision", &["identity 0x1018:03"], OTHER_DRIVE),
    refused("robot.axis.emulator.rated_torque", &["of rated torque, the cell says"], OTHER_DRIVE),
    refused(
        "robot.axis.emulator.counts_per_revolution",
        &["quadrature counts per revolution, the cell says"],
        OTHER_DRIVE,
    ),
    refused("robot.axis.emulator.address", &["answers as address", "no answer"], OTHER_DRIVE),
    refused("ultrasonic.size", &["elements, declared were"], OTHER_DRIVE),
    refused("ultrasonic.emulator.size", &["elements, declared were"], OTHER_DRIVE),
    refused("ultrasonic.emulator.absent", &["no answer, waited"], OTHER_DRIVE),
    refused("ultrasonic.emulator.silent_from_s", &["no answer, waited"], OTHER_DRIVE),
    faulted(
        "force_sensor.tolerated_missing",
        &["went beyond its range"],
        "a sample that is saturated in an impact is missing, and impacts are known in a run only",
    ),
    faulted("force_sensor.can.event_timer_ms", &["a sample every"], "the sensor's own rate is known in a run only"),
    refused("scene.tip_radius", &["is saturated"], "the force of a body at the tip is known in a run only"),
    refused("robot.parameters.", &["is saturated"], "the weight of the tool at the sensor is known in a run only"),
    faulted(
        "ultrasonic.emulator.silent_from_s",
        &["no reply to"],
        "the emulated matrix is silent as the cell tells it",
    ),
    refused("force_sensor.can.", &["of the emulated sensor", "the emulated sensor has"], OTHER_DRIVE),
    refused(
        "force_sensor.can.parameter.",
        &["does not exist", "does not match"],
        "the objects of a sensor are in the sensor",
    ),
    faulted("force_sensor.position", &["is saturated"], "the torque of the tool at the sensor is known in a run only"),
    faulted(
        "scene.",
        &["following error", "blocked or overloaded"],
        "the rehearsal has no surroundings in which the arm is blocked",
    ),
    refused("camera.width", &["pixels, declared were"], OTHER_DRIVE),
    refused("camera.period_ms", &["a picture every"], OTHER_DRIVE),
    refused(
        "camera.emulator.",
        &["pixels, declared were", "a picture every", "no connection", "no valid picture", "no picture for"],
        OTHER_DRIVE,
    ),
    faulted("robot.axis.emulator.trips_at_s", &["drive fault 0x2310"], "the emulated drive trips as the cell tells it"),
    refused("robot.axis.emulator.absent", &["never booted", "no answer"], OTHER_DRIVE),
    refused("robot.axis.drive.vendor", &["identity 0x1018:01"], OTHER_DRIVE),
    refused("robot.axis.drive.product", &["identity 0x1018:02"], OTHER_DRIVE),
    refused("robot.axis.drive.revision", &["identity 0x1018:03"], OTHER_DRIVE),
    refused("robot.axis.node", &["answers as address"], OTHER_DRIVE),
    refused("robot.axis.drive.rated_torque", &["of rated torque, the cell says"], OTHER_DRIVE),
    faulted(
        "robot.axis.drive.max_torque",
        &["blocked or overloaded", "following error", "measured position stands still"],
        "an overload by nominal masses is a warning, and the emulated drive keeps the limit",
    ),
    refused(
        "robot.axis.drive.counts_per_revolution",
        &["quadrature counts per revolution, the cell says"],
        OTHER_DRIVE,
    ),
    refused(
        "robot.axis.drive.parameter.",
        &["object does not exist", "sub-index does not exist"],
        "the object dictionary of a drive is in the drive",
    ),
    refused(
        "io.parameter.",
        &["does not exist", "does not match", "data too"],
        "the object dictionary of a node is in the node",
    ),
    faulted("robot.axis.drive.loop.", OF_A_LOOP, NO_LOOP),
    faulted(
        "robot.axis.controller.torque_constant",
        OF_A_LOOP,
        "the emulated motor keeps a torque constant of its own",
    ),
    faulted("period_us", OF_A_LOOP, NO_LOOP),
    faulted(
        "robot.parameters.",
        &["following error", "blocked or overloaded"],
        "the weight that is fed forward has the geometry of the cell, and the emulated mechanism that of the model",
    ),
    faulted("robot.axis.controller.loop.", OF_A_LOOP, NO_LOOP),
    faulted("robot.axis.controller.control", OF_A_LOOP, NO_LOOP),
];

impl Exception {
    fn names(&self, key: &str) -> bool {
        match self.key.strip_suffix('.') {
            Some(table) => key
                .trim_matches(['[', ']'])
                .strip_prefix(table)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('.')),
            None => key == self.key,
        }
    }

    fn covers(&self, key: &str, disagreement: &Disagreement) -> bool {
        let said = |word: &&str| disagreement.said.contains(*word);
        self.names(key) && self.kind == disagreement.kind && self.words.iter().any(said)
    }
}

/// Reason why a disagreement about a cell with altered `key` is permitted; `None` if it is not permitted.
pub(super) fn reason(key: &str, disagreement: &Disagreement) -> Option<&'static str> {
    let covers = |it: &&Exception| it.covers(key, disagreement);
    EXCEPTIONS.iter().find(covers).map(|it| it.why)
}

#[test]
fn every_exception_names_a_key_that_is_altered() {
    let mutations = Mutations::of(1);
    let keys: Vec<_> = (0..mutations.keys() as u64).collect();
    for exception in EXCEPTIONS {
        let named = |&case: &u64| exception.names(mutations.key(case));
        assert!(keys.iter().any(named), "{}", exception.key);
    }
}
