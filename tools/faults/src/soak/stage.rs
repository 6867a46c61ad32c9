//! The emulated cell of a soak, and the successive controllers on this cell.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use can::{Instant, Port, TraceReader, Tracer};
use controller::ecp::StepRecords;
use controller::executor::{Ended, Executor, Turns};
use hil::{DeviceFault, DriveId, PlantAxis, WorldFault};
use mrroc::bench::emulation::{Emulation, HostEnds};
use mrroc::cell::CellFile;
use mrroc::tasks::{Cell, Equipment, Figures, Program, TaskError};
use mrroc::{run, setup};
use serial::Line;
use servo::{Latest, MAX_AXES, Record, Servo, ServoFault, lockstep};

use super::work::{Counts, work};

/// Capacity of the queues of records, of events of steps and of frames. All are emptied in each cycle.
const QUEUE: usize = 1 << 12;
/// Longest time in which a controller switches the cell off.
const SWITCH_OFF: Duration = Duration::from_secs(10);
/// Time for which a drive is without power when a person switches the cabinet off and on.
const WITHOUT_POWER: Duration = Duration::from_secs(1);
/// Greatest current of a motor without power, A. The current decays within milliseconds.
const CURRENT: f64 = 0.05;
/// Time in which drives boot.
const BOOT: Duration = Duration::from_secs(2);

/// Entries that no reader got.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lost {
    pub(super) records: u64,
    pub(super) steps: u64,
    pub(super) frames: u64,
}

/// An emulated cell.
pub(super) struct Stage {
    pub(super) file: Arc<CellFile>,
    pub(super) emulation: Emulation,
    ends: Option<HostEnds>,
    pub(super) now: Instant,
    /// Drives of the axes, robot after robot.
    drives: Vec<Vec<DriveId>>,
    pub(super) counts: Arc<[Counts]>,
    pub(super) lost: Lost,
    /// Cycles of all controllers.
    pub(super) cycles: u64,
}

/// A controller that is up.
pub(super) struct Controller {
    servo: Servo,
    executor: Executor<TaskError>,
    latest: Vec<Latest>,
    records: rtrb::Consumer<Record>,
    steps: Vec<StepRecords>,
    traces: Vec<TraceReader>,
    /// The next cycle whose records are expected.
    recorded: u64,
}

impl Stage {
    pub(super) fn new(file: &CellFile) -> anyhow::Result<Self> {
        if file.cell.has_sensor_lines() || !file.cell.camera.is_empty() {
            bail!(
                "a soak connects the controller again, which the emulated sensors on lines and cameras do not permit"
            );
        }
        let (emulation, ends) = Emulation::of(file);
        let ids = emulation.ids().clone();
        let robots = file.cell.robot.iter().enumerate();
        let drives = robots.map(|(robot, given)| {
            let axis = |axis| ids.drives.get(&(robot, axis)).copied().context("an axis without a drive");
            (0..given.axis.len()).map(axis).collect::<anyhow::Result<_>>()
        });
        Ok(Self {
            drives: drives.collect::<anyhow::Result<_>>()?,
            counts: file.cell.robot.iter().map(|_| Counts::default()).collect(),
            file: Arc::new(file.clone()),
            emulation,
            ends: Some(ends),
            now: Instant::ZERO,
            lost: Lost::default(),
            cycles: 0,
        })
    }

    /// Starts a controller: brings the drives up, and begins the task.
    pub(super) fn start(&mut self) -> anyhow::Result<Controller> {
        let file = &*self.file;
        let ends = self.ends.take().unwrap_or_else(|| self.emulation.reconnect(file));
        let boxed = |line| Box::new(line) as Box<dyn Line>;
        let lines = ends.lines.into_iter().map(|bundle| bundle.into_iter().map(boxed).collect()).collect();
        let traced = |port| {
            let (port, trace) = Tracer::new(port, QUEUE);
            (Box::new(port) as Box<dyn Port>, trace)
        };
        let (ports, traces) = ends.ports.into_iter().map(traced).unzip();
        let devices = setup::devices(file, ports, lines, Vec::new(), None)?;
        let (mut servo, links) = Servo::new(&setup::servo_config(file), devices.groups)?;
        let sensors = setup::force_sensors(file, &devices.sensors, &links);
        setup::install_laws(file, &mut servo, &sensors)?;
        let latest = links.iter().map(|link| link.latest.clone()).collect();
        let mut subcontrollers = setup::subcontrollers(file, links);
        let steps = subcontrollers.keep_steps(QUEUE);
        let records = servo.record(QUEUE);
        let equipment = Equipment {
            subcontrollers,
            io: devices.io,
            sensors,
            matrices: devices.matrices,
            own: devices.own,
            cameras: Vec::new(),
            speed: servo.speed_override(),
            figures: Figures::default(),
        };
        let mut reached = self.now;
        let emulation = &mut self.emulation;
        let up = lockstep::bring_up(&mut servo, self.now, |next| {
            emulation.advance(next);
            reached = next;
        });
        self.now = reached;
        up.map_err(|why| run::diagnosed(file, &servo, why)).context("bring-up")?;
        let counts = self.counts.clone();
        let program = Program::of(async move |cell: &mut Cell| work(cell, &counts).await);
        let mut executor = program.begin(&self.file, equipment, false, Turns::default());
        (0..self.drives.len()).for_each(|robot| executor.hold(robot, false));
        Ok(Controller { servo, executor, latest, records, steps, traces, recorded: 0 })
    }

    /// One cycle. Returns whether the task goes on.
    pub(super) fn cycle(&mut self, controller: &mut Controller) -> bool {
        controller.servo.step(self.now);
        let going = controller.executor.poll(self.now, |_, _| {});
        self.now += controller.servo.period();
        self.emulation.advance(self.now);
        self.cycles += 1;
        controller.drain(&mut self.lost);
        going
    }

    /// Lets the cell go on without a controller.
    pub(super) fn wait(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            self.now += self.file.cell.period();
            self.emulation.advance(self.now);
        }
    }

    /// Ends a controller: it switches the cell off. Returns the error of its task, and whether the cell is off.
    pub(super) fn end(&mut self, mut controller: Controller) -> (Option<String>, bool) {
        controller.servo.stop_request().request();
        let end = self.now + SWITCH_OFF;
        while !controller.servo.is_off() && self.now < end {
            self.cycle(&mut controller);
        }
        let off = controller.servo.is_off();
        let (ended, _) = controller.executor.finish();
        let error = match ended {
            Some(Ended::Task(Err(error))) => Some(error.to_string()),
            Some(Ended::System(error)) => Some(error.to_string()),
            Some(Ended::Task(Ok(()))) | None => None,
        };
        (error, off)
    }

    /// Switches the supply of all drives off and on, as a person at the cabinet does.
    pub(super) fn switch_power(&mut self) {
        let faults =
            self.drives.iter().flatten().map(|&drive| WorldFault::Device { drive, fault: DeviceFault::PowerOff });
        let faults: Vec<_> = faults.collect();
        let off: Vec<_> = faults.iter().map(|fault| self.emulation.begin_fault(fault)).collect();
        self.wait(WITHOUT_POWER);
        off.iter().for_each(|fault| self.emulation.end_fault(fault));
        self.wait(BOOT);
    }

    /// Whether any motor has a current.
    pub(super) fn has_current(&self) -> bool {
        let plants = self.drives.iter().flatten().filter_map(|drive| self.emulation.plant(*drive));
        plants.map(|plant| plant.feedback().current).any(|current| current.abs() > CURRENT)
    }

    /// True positions of the motors of a robot, rad.
    pub(super) fn truth(&self, robot: usize) -> [f64; MAX_AXES] {
        let drives = &self.drives[robot];
        let plant = |axis: usize| self.emulation.plant(*drives.get(axis)?).map(PlantAxis::angle);
        std::array::from_fn(|axis| plant(axis).unwrap_or_default())
    }
}

impl Controller {
    pub(super) fn fault(&self, robot: usize) -> Option<ServoFault> {
        self.servo.fault(robot)
    }

    pub(super) fn is_homed(&self, robot: usize) -> bool {
        self.latest[robot].read().homed
    }

    /// Measured positions of the motors of a robot, rad.
    pub(super) fn measured(&self, robot: usize) -> [f64; MAX_AXES] {
        self.latest[robot].read().measured
    }

    /// Empties all queues, and counts what is missing.
    fn drain(&mut self, lost: &mut Lost) {
        let robots = self.latest.len() as u64;
        let mut records = 0;
        while let Ok(record) = self.records.pop() {
            records += 1;
            lost.records += record.cycle.saturating_sub(self.recorded);
            self.recorded = record.cycle;
        }
        lost.records += robots.saturating_sub(records);
        self.recorded += 1;
        for steps in &mut self.steps {
            while steps.queue.pop().is_ok() {}
        }
        for trace in &mut self.traces {
            while trace.read_entry().is_some() {}
        }
    }

    /// Adds what was lost in queues that count by themselves.
    pub(super) fn add_lost(&self, lost: &mut Lost) {
        lost.steps += self.steps.iter().map(StepRecords::lost).sum::<u64>();
        lost.frames += self.traces.iter().map(TraceReader::lost).sum::<u64>();
    }
}
