//! Computing time of a cycle over the real drive group, with and without the emulated robot.
//!
//! `lockstep` counts cycles of servo, bus and emulated drives together. The result divided by the 500 cycles per second
//! is the speed of a lockstep run in multiples of real time. `servo cycle` is the servo and the group alone. Its port
//! answers every SYNC from a table and makes no system call.
//!
//! `laboratory` runs all robots of `cells/lab.toml` with their programs, without their rehearsal. The runs with contacts
//! have a scene: a force sensor on each of the four arms, and three planes around the tip of one arm. One thread or two
//! threads advance the emulated robots. Each run prints its speed in multiples of real time.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::report::RunOutcome;
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::CarriedTask;
use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received, StandardId, VirtualPort};
use criterion::{Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use servo::Phase;

/// Number of cycles in one iteration of the lockstep benchmark: one second.
const SECOND: u64 = 500;

/// A motion to and fro without end.
struct ToAndFro {
    motion: Motion,
    distance: f64,
}

impl ToAndFro {
    fn new(rig: &Rig) -> Self {
        let distance = 30.0;
        Self { motion: Motion::new(rig, distance), distance }
    }

    fn feed(&mut self, rig: &mut Rig) {
        if self.motion.is_sent() && rig.phase() == Phase::Standing {
            self.distance = -self.distance;
            self.motion = Motion::new(rig, self.distance);
        }
        rig.feed(&mut self.motion);
    }
}

fn lockstep(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("lockstep");
    group.throughput(Throughput::Elements(SECOND));
    for name in ["irb6", "irp6"] {
        let mut rig = Setup::of(name).bring_up();
        rig.home();
        let mut motion = ToAndFro::new(&rig);
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for _ in 0..SECOND {
                    motion.feed(&mut rig);
                    rig.cycle();
                }
            });
        });
        assert_eq!(rig.servo.fault(0), None);
    }
}

/// The port of a robot at rest. It is a real port at first; after it is cut off, each SYNC is answered with the last
/// answers.
struct Echo {
    port: VirtualPort,
    cut: Arc<AtomicBool>,
    answers: Vec<Received>,
    synchronised: Option<Instant>,
}

impl Echo {
    fn is_cut(&self) -> bool {
        self.cut.load(Ordering::Relaxed)
    }
}

impl Port for Echo {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        if !self.is_cut() {
            return self.port.send(now, frames);
        }
        self.synchronised = Some(now);
        Ok(frames.len())
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        if !self.is_cut() {
            let count = self.port.receive(now, into)?;
            let is_answer = |received: &&Received| {
                let id = received.frame.standard_data_id();
                id.is_some_and(|id| (0x181..=0x1FF).contains(&id.raw()))
            };
            if into[..count].iter().any(|received| is_answer(&received)) {
                self.answers.clear();
                self.answers.extend(into[..count].iter().filter(is_answer));
            }
            return Ok(count);
        }
        let Some(at) = self.synchronised.take() else {
            return Ok(0);
        };
        for (place, answer) in into.iter_mut().zip(&self.answers) {
            *place = Received { at: at + Duration::from_micros(500), ..*answer };
        }
        // All heartbeats in each cycle, which is more than real drives send.
        let mut count = self.answers.len();
        for (place, node) in into[count..].iter_mut().zip(1..=self.answers.len() as u16) {
            let id = StandardId::new(0x700 + node).expect("a heartbeat's identifier");
            let frame = Frame::new(id, &[5]).expect("a byte");
            *place = Received { frame, at };
            count += 1;
        }
        Ok(count)
    }

    fn counters(&self) -> Counters {
        self.port.counters()
    }

    fn state(&self) -> ControllerState {
        self.port.state()
    }
}

fn servo_cycle(criterion: &mut Criterion) {
    let cut = Arc::default();
    let mut setup = Setup::of("irp6");
    // The drives keep their position while the commands go to and fro.
    for axis in &mut setup.cell.robot[0].axis {
        axis.following_error = 100.0;
    }
    let switch = Arc::clone(&cut);
    setup.port = Box::new(move |port| {
        Box::new(Echo {
            port,
            cut: switch,
            // Capacity for six axes. Growth in the cycle would count as heap use of the servo.
            answers: Vec::with_capacity(6),
            synchronised: None,
        })
    });
    let mut rig = setup.bring_up();
    rig.home();
    cut.store(true, Ordering::Relaxed);
    let mut motion = ToAndFro::new(&rig);
    criterion.bench_function("servo cycle, six moving axes", |bencher| {
        bencher.iter(|| {
            motion.feed(&mut rig);
            rig.servo_cycle();
            rig.now += rig.period;
        });
    });
    assert_eq!(rig.servo.fault(0), None);
}

/// The arms of the laboratory, which have force sensors in its scene.
const ARMS: [&str; 4] = ["irb6", "irp6-track", "rnt", "polycrank"];

/// Planes around the tip of the IRb-6: a table, and two walls.
const PLANES: &str = r#"
[scene]
robot = "irb6"
tip_radius = 0.005

[[scene.plane]]
height = 1.0
stiffness = 1e3
damping = 10.0
friction = 0.3

[[scene.plane]]
normal = [-1.0, 0.0, 0.0]
height = -1.5
stiffness = 1e5
damping = 100.0
friction = 0.3

[[scene.plane]]
normal = [0.0, 1.0, 0.0]
height = -1.5
stiffness = 1e5
damping = 100.0
friction = 0.3
"#;

/// The laboratory with its scene, as the text of a cell file.
fn with_contacts(laboratory: &str) -> String {
    let sensor = |(number, robot): (usize, &str)| {
        let range = "force_range = [2000.0, 2000.0, 2000.0]\ntorque_range = [100.0, 100.0, 100.0]";
        let tool = "tool = { mass = 0.5, centre = [0.0, 0.0, 0.1] }";
        let line = format!("/dev/ttyF{number}");
        format!(
            "\n[[force_sensor]]\nname = \"wrist-{robot}\"\nrobot = \"{robot}\"\nline = \"{line}\"\n{range}\n{tool}\n"
        )
    };
    let sensors: String = ARMS.into_iter().enumerate().map(sensor).collect();
    format!("{laboratory}{sensors}{PLANES}")
}

fn laboratory(criterion: &mut Criterion) {
    let cells = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
    let plain = std::fs::read_to_string(cells.join("lab.toml")).expect("the example cells are there");
    let mut group = criterion.benchmark_group("laboratory");
    group.sample_size(10).sampling_mode(SamplingMode::Flat).warm_up_time(Duration::from_millis(1));
    let contacts = with_contacts(&plain);
    let cases = [
        ("alone", &plain, 1),
        ("alone, two threads", &plain, 2),
        ("with contacts", &contacts, 1),
        ("with contacts, two threads", &contacts, 2),
    ];
    for (name, text, threads) in cases {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("laboratory.toml");
        std::fs::write(&path, text).expect("the directory of the target is writable");
        let file = CellFile::read(&path).expect("the cell is sound");
        // The time of one run, without its rehearsal, and its speed in multiples of real time.
        let run = || {
            let options = RunOptions { threads: Some(threads), ..RunOptions::on(BenchKind::Lockstep) };
            let program = CarriedTask::Programs.program();
            let run = ::mrroc::run::run(&file, &options, &Requests::default(), &program, &mut |_| {});
            let report = run.expect("the cell can run");
            assert_eq!(report.outcome, RunOutcome::Completed, "{report}");
            let real_time = report.cycle.cycles as f64 / SECOND as f64;
            (Duration::from_secs_f64(real_time / report.realtime_factor), report.realtime_factor)
        };
        let mut factors = Vec::new();
        group.bench_function(name, |bencher| {
            bencher.iter_custom(|times| {
                let runs = (0..times).map(|_| {
                    let (wall, factor) = run();
                    factors.push(factor);
                    wall
                });
                runs.sum()
            });
        });
        factors.sort_by(f64::total_cmp);
        if let (Some(least), Some(most)) = (factors.first(), factors.last()) {
            let median = factors[factors.len() / 2];
            println!("laboratory {name}: {median:.1} times real time ({least:.1} to {most:.1})");
        }
    }
}

criterion_group!(benches, servo_cycle, lockstep, laboratory);
criterion_main!(benches);
