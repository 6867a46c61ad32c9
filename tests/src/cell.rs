//! A robot of an example cell in virtual time: its servo, its drive group, and its emulated drives on a virtual bus or
//! on virtual serial lines.
//!
//! A shorter counterpart of the assembly in the library `mrroc`: one robot on one bus or on one bundle of serial lines.
//! A test selects the axes, and may alter ports, plants and drives.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use ::mrroc::cell::{Axis, Cell, Protocol};
use can::timing::Bitrate;
use can::{Frame, Instant, Port, TraceReader, Tracer, VirtualPort};
use canopen::NodeId;
use controller::ecp::{Ecp, EcpConfig};
use controller::generator::Pace;
use controller::robot::Arm;
use drive::axis_controller::AxisControllerGroup;
use drive::bus::CanBus;
use drive::{DriveGroup, Scale};
use hil::plant::Switch;
use hil::{
    AxisController, AxisControllerConfig, BusId, Cabinet, Device, DriveId, Epos4, Epos4Config, Irp6Axis, LineDevice,
    LineFaults, Mechanism, World,
};
use servo::{EffectorConfig, EffectorLink, Order, Phase, Record, Servo, ServoConfig, ServoFault};

use crate::allocations;
use crate::motion::Motion;

/// Longest time for homing, from the farthest end of the longest travel, in virtual time.
const HOMING: Duration = Duration::from_secs(900);

const LONGEST_PROGRAM: Duration = Duration::from_secs(600);

const MACROSTEPS_AHEAD: u16 = 8;

type Alteration = Box<dyn Fn(usize, &mut hil::AxisConfig)>;

type Wrapping = Box<dyn FnOnce(VirtualPort) -> Box<dyn Port>>;

/// Parts of a robot before bring-up.
pub struct Setup {
    pub cell: Cell,
    /// The axes of the robot that exist. The others are neither in the servo nor on the bus.
    pub axes: Vec<usize>,
    /// Alteration of the plant of an axis.
    pub plant: Alteration,
    /// Port between the drive group and the bus.
    pub port: Wrapping,
}

impl Setup {
    /// All axes of `cells/{name}.toml`.
    pub fn of(name: &str) -> Self {
        let path = format!("{}/../cells/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(&path).expect("the example cells are there");
        let cell = Cell::parse(&text).expect("the example cells are sound");
        Self {
            axes: (0..cell.robot[0].axis.len()).collect(),
            cell,
            plant: Box::new(|_, _| {}),
            port: Box::new(|port| Box::new(port)),
        }
    }

    /// One axis of a robot of `cells/{name}.toml`, on its bus or its serial lines.
    pub fn axis_of(name: &str, robot: &str, axis: usize) -> Self {
        let mut setup = Self::of(name);
        let cell = &mut setup.cell;
        cell.robot.retain(|given| given.name == robot);
        let bus = cell.robot[0].axis[axis].bus.clone();
        cell.bus.retain(|given| given.name == bus);
        cell.serial.retain(|given| given.name == bus);
        setup.axes = vec![axis];
        setup
    }

    /// One axis of the IRb-6.
    pub fn one_axis(axis: usize) -> Self {
        Self { axes: vec![axis], ..Self::of("irb6") }
    }

    /// Alters the plants of the axes.
    pub fn with_plant(self, plant: impl Fn(usize, &mut hil::AxisConfig) + 'static) -> Self {
        Self { plant: Box::new(plant), ..self }
    }

    /// The servo period.
    pub fn period(&self) -> Duration {
        Duration::from_micros(u64::from(self.cell.period_us))
    }

    fn axis(&self, number: usize) -> &Axis {
        &self.cell.robot[0].axis[number]
    }

    fn servo_config(&self, arm: &Arm) -> ServoConfig {
        let axis = |(index_in_group, &number): (usize, &usize)| {
            let limits = arm.robot().motor_limits()[number];
            self.cell.robot[0].servo_config(number, 0, index_in_group, limits)
        };
        ServoConfig {
            period: self.period(),
            max_missed_in_row: self.cell.max_missed_in_row,
            effectors: vec![EffectorConfig {
                name: self.cell.name.clone(),
                axes: self.axes.iter().enumerate().map(axis).collect(),
                queue: usize::from(MACROSTEPS_AHEAD) + 8,
                enabling_timeout: ::mrroc::cell::ENABLING,
                homing_timeout: HOMING,
            }],
        }
    }

    /// Motor, load, sensors and switches of an axis.
    pub fn plant(&self, arm: &Arm, number: usize) -> hil::AxisConfig {
        let axis = self.axis(number);
        let home = arm.robot().home()[number];
        let limits = arm.robot().motor_limits()[number];
        let switch = |from, to| Some(Switch { from, to, bounce: 0 });
        let mut plant = hil::AxisConfig {
            counts_per_revolution: axis.counts_per_revolution(),
            index_angle: home,
            start_angle: axis.emulator.start.unwrap_or(home + 20.0),
            home_switch: switch(home - 20.0, home - 2.0),
            negative_limit: switch(f64::NEG_INFINITY, limits.low),
            positive_limit: switch(limits.high, f64::INFINITY),
            ..hil::AxisConfig::irp6(Irp6Axis::ALL[number % 6])
        };
        (self.plant)(number, &mut plant);
        plant
    }

    /// Mechanism behind the axes of the robot; `None` for gripper and conveyor.
    fn mechanism(&self) -> Option<Mechanism> {
        let robot = &self.cell.robot[0];
        let parameters = robot.numbers();
        parameters.mechanism().map(Mechanism::new)
    }

    fn seed(&self, number: usize) -> u64 {
        self.cell.seed * 1000 + number as u64
    }

    fn device(&self, arm: &Arm, mechanism: Option<&Mechanism>, number: usize) -> Socket {
        let plant = self.plant(arm, number);
        Socket {
            drive: Epos4::new(Epos4Config {
                seed: self.seed(number),
                mount: mechanism.and_then(|it| it.mount(number, arm.robot().home()[number])),
                rated_torque: Some(self.axis(number).cia402().rated_torque),
                ..Epos4Config::new(node(self.axis(number).node), plant)
            }),
            unplugged: Arc::default(),
        }
    }

    /// Drive of an axis on a serial line.
    fn line_device(
        &self,
        arm: &Arm,
        mechanism: Option<&Mechanism>,
        number: usize,
        cabinet: &Cabinet,
    ) -> Box<dyn LineDevice> {
        let plant = self.plant(arm, number);
        let config = AxisControllerConfig {
            seed: self.seed(number),
            cabinet: cabinet.clone(),
            mount: mechanism.and_then(|it| it.mount(number, arm.robot().home()[number])),
            ..AxisControllerConfig::new(plant)
        };
        match self.cell.serial[0].protocol {
            Protocol::Nfv2 => Box::new(AxisController::nfv2(self.axis(number).node, &config)),
            Protocol::HiMoxa => Box::new(AxisController::hi_moxa(&config)),
        }
    }

    /// Switches the drives on and brings the group up. No axis is enabled yet.
    pub fn bring_up(self) -> Rig {
        let arm = self.cell.robot[0].arm().expect("parameters are sound");
        let servo_config = self.servo_config(&arm);
        let period = self.period();
        let scale = |&axis: &usize| self.axis(axis).scale(arm.robot().home()[axis]);
        let scales = self.axes.iter().map(scale).collect();
        let mut world = World::new();
        let (group, drives, plugs, cell) =
            if self.cell.bus.is_empty() { self.lines(&arm, &mut world) } else { self.bus(&arm, &mut world) };
        let delay = group.delay();
        let (mut servo, mut links) =
            Servo::new(&servo_config, vec![group]).expect("the servo's configuration is sound");
        let records = servo.record(4);
        let now = servo::lockstep::bring_up(&mut servo, Instant::ZERO, |next| world.advance(next))
            .expect("emulated drives come up");
        Rig {
            servo,
            link: links.pop(),
            world,
            now,
            period,
            scales,
            delay,
            last: Record::default(),
            records,
            drives,
            plugs,
            cell,
            after_cycle: Box::new(|_| {}),
            arm,
        }
    }

    /// The drives on a CAN bus, and their drive group.
    fn bus(self, arm: &Arm, world: &mut World) -> Made {
        let bus = &self.cell.bus[0];
        let id = world.add_bus(Bitrate::from_kbps(bus.bitrate_kbps).expect("a possible bit rate"));
        let port = world.host_port(id, 256);
        let mechanism = self.mechanism();
        let mut plugs = Vec::new();
        let mut drives = Vec::new();
        for &axis in &self.axes {
            let device = self.device(arm, mechanism.as_ref(), axis);
            plugs.push(device.unplugged.clone());
            drives.push(DriveId::Node(world.add_device(id, Box::new(device))));
        }
        let config = |&axis: &usize| self.axis(axis).drive_config(arm.robot().home()[axis]);
        let configs: Vec<_> = self.axes.iter().map(config).collect();
        let group = CanBus::new((self.port)(port), self.cell.group_config(0), &configs);
        let group = Box::new(group.expect("the group's configuration is sound"));
        (group, drives, plugs, self.cell)
    }

    /// The drives on serial lines, and their drive group.
    fn lines(self, arm: &Arm, world: &mut World) -> Made {
        let bundle = &self.cell.serial[0];
        let latency = bundle.emulated_latency_ms;
        let latency = latency.map(|latency| Duration::from_millis(latency.into()));
        let cabinet = Cabinet::default();
        let mechanism = self.mechanism();
        let line = |&axis: &usize| {
            let device = self.line_device(arm, mechanism.as_ref(), axis, &cabinet);
            let line = world.add_line(bundle.settings(), latency, device);
            (world.host_line(line, 4096), DriveId::Line(line))
        };
        let (lines, drives): (Vec<_>, Vec<_>) = self.axes.iter().map(line).unzip();
        let config = |&axis: &usize| self.axis(axis).controller_config(arm.robot().home()[axis]);
        let configs: Vec<_> = self.axes.iter().map(config).collect();
        let config = bundle.group_config(self.period());
        let group = AxisControllerGroup::new(lines, config, &configs);
        let group = Box::new(group.expect("the group's configuration is sound"));
        (group, drives, Vec::new(), self.cell)
    }
}

/// A drive group, its drives, their cables, and the cell.
type Made = (Box<dyn DriveGroup>, Vec<DriveId>, Vec<Arc<AtomicBool>>, Cell);

/// A drive on a cable that can be unplugged.
struct Socket {
    drive: Epos4,
    unplugged: Arc<AtomicBool>,
}

impl Device for Socket {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        if !self.unplugged.load(Ordering::Relaxed) {
            self.drive.handle(frame, now);
        }
    }
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        while self.unplugged.load(Ordering::Relaxed) {
            self.drive.poll_transmit(now)?;
        }
        self.drive.poll_transmit(now)
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.drive.poll_timeout()
    }
    fn handle_timeout(&mut self, now: Instant) {
        self.drive.handle_timeout(now);
    }
    fn plant_mut(&mut self) -> Option<&mut hil::PlantAxis> {
        self.drive.plant_mut()
    }
}

/// A robot after bring-up. Axes are numbered among the existing ones.
pub struct Rig {
    pub servo: Servo,
    /// `None` while a program runs.
    pub link: Option<EffectorLink>,
    /// Time of the next cycle.
    pub now: Instant,
    pub period: Duration,
    pub scales: Vec<Scale>,
    /// Delay stated by the drive group, in cycles.
    pub delay: usize,
    /// Record of the last cycle.
    pub last: Record,
    pub cell: Cell,
    /// Called after each cycle, before the world advances.
    pub after_cycle: Box<dyn FnMut(&Record)>,
    pub world: World,
    records: rtrb::Consumer<Record>,
    pub drives: Vec<DriveId>,
    /// Cables of drives on a CAN bus.
    plugs: Vec<Arc<AtomicBool>>,
    arm: Arm,
}

impl Rig {
    /// Runs one cycle of the servo, and advances the world until the next cycle.
    #[track_caller]
    pub fn cycle(&mut self) {
        self.servo_cycle();
        self.pass();
    }

    /// Runs one cycle of the servo alone. Asserts that the cycle does not use the heap.
    #[track_caller]
    pub fn servo_cycle(&mut self) {
        let before = allocations::count();
        self.servo.prepare(self.now);
        self.servo.send(self.now);
        let used = allocations::count() - before;
        assert_eq!(used, 0, "uses of the heap, {:?}", self.servo.state(0));
        if let Ok(record) = self.records.pop() {
            self.last = record;
        }
        (self.after_cycle)(&self.last);
    }

    /// Lets one period pass without a servo cycle.
    pub fn pass(&mut self) {
        self.now += self.period;
        self.world.advance(self.now);
    }

    /// Runs cycles until `done` returns true. Panics after `limit`.
    #[track_caller]
    pub fn until(&mut self, limit: Duration, what: &str, done: impl Fn(&Self) -> bool) {
        let end = self.now + limit;
        while !done(self) {
            assert!(self.now < end, "{what}: not within {limit:?}, {:?}, {:?}", self.phase(), self.servo.fault(0));
            self.cycle();
        }
    }

    /// Queues an order. Panics if the queue is full.
    pub fn order(&mut self, order: Order) {
        let link = self.link.as_mut().expect("no program runs");
        link.orders.push(order).expect("there is room");
    }

    /// Gives an order that ends in standstill, and waits for the standstill.
    #[track_caller]
    pub fn stand_by(&mut self, order: Order) {
        self.order(order);
        self.cycle();
        self.until(HOMING, "standing", |rig| rig.phase() == Phase::Standing || rig.servo.fault(0).is_some());
        assert_eq!(self.servo.fault(0), None, "{order:?}");
    }

    /// Enables and homes every axis.
    pub fn home(&mut self) {
        self.stand_by(Order::Enable);
        self.stand_by(Order::Home);
    }

    /// Phase that the servo reports.
    pub fn phase(&self) -> Phase {
        self.servo.state(0).expect("there is one effector").phase()
    }

    /// Whether every axis has its reference.
    pub fn is_homed(&self) -> bool {
        self.link.as_ref().expect("no program runs").latest.read().homed
    }

    /// The true angle of a motor, rad.
    pub fn angle(&self, axis: usize) -> f64 {
        let world = &self.world;
        match self.drives[axis] {
            DriveId::Node(id) => {
                let socket: Option<&Socket> = world.device(id);
                socket.map(|socket| socket.drive.axis())
            }
            DriveId::Line(id) => world.line(id).device().map(AxisController::axis),
        }
        .expect("a drive")
        .angle()
    }

    /// Sets the faults of an axis's line from now on.
    pub fn set_line_faults(&mut self, axis: usize, faults: &LineFaults) {
        match self.drives[axis] {
            DriveId::Node(_) => panic!("axis {axis} is on no serial line"),
            DriveId::Line(line) => self.world.line_mut(line).set_faults(faults),
        }
    }

    /// Disconnects the line of an axis permanently, as an unplugged adapter does.
    pub fn hang_up(&mut self, axis: usize) {
        match self.drives[axis] {
            DriveId::Node(_) => panic!("axis {axis} is on no serial line"),
            DriveId::Line(line) => self.world.line_mut(line).hang_up(),
        }
    }

    /// The true angles of all motors, rad.
    pub fn angles(&self) -> Vec<f64> {
        (0..self.drives.len()).map(|axis| self.angle(axis)).collect()
    }

    /// Runs cycles with `motion` until a fault is latched within `limit` and all axes are at rest. Asserts that no
    /// motor moved farther than `bound`, rad, after the fault.
    pub fn fault_within(&mut self, limit: Duration, motion: &mut Motion, bound: f64) -> ServoFault {
        let end = self.now + limit;
        while self.servo.fault(0).is_none() {
            assert!(self.now < end, "no fault");
            self.feed(motion);
            self.cycle();
        }
        let latched_at = self.angles();
        self.until(Motion::LONGEST, "stopped", |rig| rig.phase() == Phase::Faulted);
        self.at_rest(&latched_at, bound);
        self.servo.fault(0).expect("it is latched")
    }

    /// Waits until the last drive has braked. Asserts that nothing moves, and that no motor is farther than `bound`
    /// from `start`, rad.
    pub fn at_rest(&mut self, start: &[f64], bound: f64) {
        for _ in 0..250 {
            self.cycle();
        }
        let rest = self.angles();
        for (axis, (start, rest)) in start.iter().zip(&rest).enumerate() {
            let way = (rest - start).abs();
            assert!(way < bound, "axis {axis} went on for {way:.2} rad");
        }
        for _ in 0..250 {
            self.cycle();
        }
        for (axis, (before, after)) in rest.iter().zip(self.angles()).enumerate() {
            assert!((after - before).abs() < 0.01, "axis {axis} still moves");
        }
    }

    /// Number of answers that the drive group has missed.
    pub fn missed_answers(&self) -> u64 {
        let groups = self.servo.group_counters();
        groups.map(|group| group.missed_answers).sum()
    }

    /// Period of the heartbeats of all nodes on the bus.
    pub fn heartbeat(&self) -> Duration {
        Duration::from_millis(u64::from(self.cell.bus[0].heartbeat_ms))
    }

    /// The bus of the first axis.
    pub fn bus(&self) -> BusId {
        match self.drives[0] {
            DriveId::Node(first) => first.bus(),
            DriveId::Line(_) => panic!("the robot is on serial lines"),
        }
    }

    /// Attaches a device to the bus of the first axis.
    pub fn attach(&mut self, device: Box<dyn Device>) {
        self.world.add_device(self.bus(), device);
    }

    /// Another controller for the same drives, on a port of its own.
    pub fn another_controller(&mut self) -> CanBus<VirtualPort> {
        let port = self.world.host_port(self.bus(), 256);
        let home = self.arm.robot().home();
        let axes = self.cell.robot[0].axis.iter().zip(home.iter().copied());
        let configs: Vec<_> = axes.map(|(axis, home)| axis.drive_config(home)).collect();
        CanBus::new(port, self.cell.group_config(0), &configs).expect("the group's configuration is sound")
    }

    /// Unplugs the cable of a drive, or plugs it in again.
    pub fn unplug(&self, axis: usize, unplugged: bool) {
        self.plugs[axis].store(unplugged, Ordering::Relaxed);
    }

    /// Queues macrosteps of a motion until the queue of the servo is full.
    pub fn feed(&mut self, motion: &mut Motion) {
        let link = self.link.as_mut().expect("no program runs");
        while !motion.is_sent() && link.orders.slots() > 2 {
            let next = motion.next(self.period);
            link.orders.push(Order::Move(next)).expect("there is room");
        }
        while link.reports.pop().is_ok() {}
    }

    /// Runs a motion until `done` returns true. Panics at the end of the motion.
    #[track_caller]
    pub fn follow(&mut self, motion: &mut Motion, done: impl Fn(&Self) -> bool) {
        let end = self.now + Motion::LONGEST;
        while !done(self) {
            assert_eq!(self.servo.fault(0), None);
            assert!(self.now < end, "{:?} after the motion", self.phase());
            self.feed(motion);
            self.cycle();
        }
    }

    /// Starts to move every axis by 60 rad at 50 rad/s, and runs until full speed.
    pub fn in_motion(&mut self) -> Motion {
        let mut motion = Motion::new(self, 60.0);
        let half_a_second = self.now + Duration::from_millis(500);
        self.follow(&mut motion, |rig| rig.now >= half_a_second);
        assert_eq!(self.phase(), Phase::Moving);
        assert!((self.last.axis[0].velocity - Motion::VELOCITY).abs() < 5.0);
        motion
    }

    /// Enables, homes, and runs the program of the robot to its end. Returns the result of the run.
    pub fn run_program(&mut self) -> Result<(), String> {
        self.run_program_with(|_| {})
    }

    /// As [`Rig::run_program`]; `each` is called after each cycle.
    pub fn run_program_with(&mut self, mut each: impl FnMut(&Self)) -> Result<(), String> {
        self.run_program_until(|rig| each(rig))
    }

    /// As [`Rig::run_program`]; `each` is called after each cycle and may intervene.
    pub fn run_program_until(&mut self, mut each: impl FnMut(&mut Self)) -> Result<(), String> {
        let task = self.cell.task(0, &self.arm).expect("the program is sound");
        let link = self.link.take().expect("no program runs yet");
        let config = EcpConfig {
            period: self.period,
            pace: Pace { periods: self.cell.macrostep, read_at: self.cell.macrostep - 2 },
            macrosteps_ahead: MACROSTEPS_AHEAD,
            silence: Duration::from_millis(500),
            switching: Duration::from_secs(5),
            planning: Duration::from_secs(60),
            homing: HOMING,
            meeting: Duration::from_secs(600),
        };
        let mut ecp = Ecp::new(self.arm.clone(), link, config);
        ecp.execute(task).expect("a new process is idle");
        let end = self.now + LONGEST_PROGRAM;
        while self.now < end {
            self.cycle();
            each(self);
            while let Some(event) = ecp.poll(self.now) {
                event.outcome.map_err(|error| error.to_string())?;
            }
            if ecp.status().instruction.is_none() && self.servo.is_off() {
                return Ok(());
            }
        }
        Err(format!("not done within {LONGEST_PROGRAM:?}"))
    }
}

/// The drive group of a robot on CAN, its world and its period, without a servo.
pub fn ends(setup: Setup) -> (Box<dyn DriveGroup>, World, Duration) {
    let (group, world, period, _) = ends_on_bus(setup);
    (group, world, period)
}

/// As [`ends`], with the bus.
pub fn ends_on_bus(setup: Setup) -> (Box<dyn DriveGroup>, World, Duration, BusId) {
    let arm = setup.cell.robot[0].arm().expect("parameters are sound");
    let period = setup.period();
    let mut world = World::new();
    let (group, drives, ..) = setup.bus(&arm, &mut world);
    let DriveId::Node(first) = drives[0] else { panic!("the robot is on serial lines") };
    (group, world, period, first.bus())
}

/// Brings a robot up behind a port that records every frame.
pub fn traced(setup: Setup) -> (Rig, TraceReader) {
    let (sender, receiver) = mpsc::channel();
    let port = Box::new(move |port| {
        let (port, trace) = Tracer::new(port, 1 << 16);
        sender.send(trace).expect("the test waits for it");
        Box::new(port) as Box<dyn Port>
    });
    let rig = Setup { port, ..setup }.bring_up();
    (rig, receiver.recv().expect("bring-up made the port"))
}

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).expect("a parsed cell has valid node-IDs")
}
