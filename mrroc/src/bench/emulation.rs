//! The emulated drives, I/O nodes and axis controllers of a cell.

use std::io;
use std::time::Duration;

use can::{Frame, Instant, Port, StandardId, VirtualPort, timing::Bitrate};
use canopen::{NodeId, cia401::blocks};
use drive::camera::{CameraFault, CameraLink};
use drive::cia401::IoConfig;
use hil::scene::WorkpieceProbe;
use hil::{
    AxisController, AxisControllerConfig, BusId, Cabinet, Device, DigitalIo, DigitalIoConfig, DriveContact, DriveId,
    Epos4, Epos4Config, EposSerial, EposSerialConfig, FaultInEffect, Helpers, InputEdge, InputProbe, LineDevice,
    LineId, PlantAxis, World, WorldFault,
    scene::{BeamProbe, Scene, UnsolvedProbe},
};
use serial::{Settings, VirtualLine};

use crate::bench::bridge::{Bridge, BridgedTty};
use crate::bench::cameras::{CameraInMemory, emulated};
use crate::bench::drive_ids::DriveIds;
use crate::bench::emulated_sensors;
use crate::bench::plants::{EmulatedCell, Payloads, homing_problem, plant};
use crate::bench::random::Stream;
use crate::bench::scene::SceneTruth;
use crate::bench::traffic::BusLoad;
use crate::bench::truth::TruthLog;
use crate::cell::{Axis, CellFile, EmulatedGate, EmulatedTouchProbe, IoNode, Protocol};
use crate::scenario::{Scenario, ScenarioProbe, ScenarioRun};

/// Capacity of the host's end of a virtual bus in each direction, frames.
const QUEUE: usize = 256;

/// Frames by which a listener of a virtual bus may lag behind: some seconds of a full bus.
const HEARD: usize = 1 << 15;

/// Capacity of the host's end of a virtual line in each direction, bytes: that of a tty's buffer.
pub(super) const LINE: usize = 4096;

/// Time between two frames of the background traffic: a quarter of the capacity of a 1 Mbit/s bus.
const CHATTER: Duration = Duration::from_micros(500);

/// Identifier of the background traffic. It belongs to no node-ID and has a lower priority than all predefined
/// identifiers of CANopen except LSS.
const CHATTER_ID: u16 = 0x7A0;

/// The emulated cell on virtual buses and lines.
pub struct Emulation {
    world: World,
    buses: Vec<BusId>,
    /// Bridges of the lines whose host end is a tty.
    bridges: Vec<Bridge>,
    payloads: Payloads,
    /// The cameras that are connected in memory.
    cameras: Vec<CameraInMemory>,
    /// The true state of the scene.
    truth: SceneTruth,
    log: Option<TruthLog>,
    ids: DriveIds,
    scenario: Option<ScenarioRun>,
    /// Time up to which the world was advanced.
    passed: Instant,
}

/// The host's ends of an emulated cell.
pub struct HostEnds {
    /// The port of each CAN bus.
    pub ports: Vec<Box<dyn Port>>,
    /// An additional end of each CAN bus for listening.
    pub listeners: Vec<VirtualPort>,
    /// The lines of each bundle, in the order of [`Cell::axes_on`](crate::cell::Cell::axes_on).
    pub lines: Vec<Vec<VirtualLine>>,
    /// The line of each force sensor on a serial line, then of each ultrasonic matrix, then of each device of another
    /// crate.
    pub sensors: Vec<VirtualLine>,
}

impl Emulation {
    /// The world of a cell, switched on at [`Instant::ZERO`].
    pub fn of(file: &CellFile) -> (Self, HostEnds) {
        Self::with(file, false)
    }

    /// The same. With `referenced`, the axis controllers on serial lines had power before: they have their reference if
    /// they start at home.
    pub fn with(file: &CellFile, referenced: bool) -> (Self, HostEnds) {
        let mut world = World::new();
        let emulated = EmulatedCell::of(file);
        emulated.referenced.set(referenced);
        let buses: Vec<_> = (0..file.cell.bus.len()).map(|index| emulated.add_bus(&mut world, index)).collect();
        let mut ends = |queue| -> Vec<_> { buses.iter().map(|&bus| world.host_port(bus, queue)).collect() };
        let ports = ends(QUEUE).into_iter().map(|port| Box::new(port) as _).collect();
        let listeners = ends(HEARD);
        let lines = (0..file.cell.serial.len()).map(|bundle| {
            let cabinet = Cabinet::default();
            let axes = file.cell.axes_on(file.cell.bus.len() + bundle);
            axes.map(|axis| emulated.add_line(&mut world, bundle, axis, &cabinet)).collect()
        });
        let lines = lines.collect();
        let (mut sensors, truth) = emulated.add_sensors(&mut world, &buses);
        sensors.extend(emulated.add_matrices(&mut world));
        sensors.extend(emulated.add_devices(&mut world));
        let ends = HostEnds { lines, sensors, ports, listeners };
        let emulation = Self {
            world,
            buses,
            bridges: Vec::new(),
            cameras: Vec::new(),
            payloads: Payloads::of(&emulated, Instant::ZERO),
            truth,
            log: None,
            ids: emulated.ids(),
            scenario: None,
            passed: Instant::ZERO,
        };
        (emulation, ends)
    }

    /// New ends of the host in place of the old ends, for a controller that starts again. Sensors and devices on lines
    /// of their own get no new ends.
    pub fn reconnect(&mut self, file: &CellFile) -> HostEnds {
        let Self { world, buses, ids, .. } = self;
        let ports = buses.iter().map(|&bus| Box::new(world.replace_port(bus, QUEUE)) as _).collect();
        let lines = (0..file.cell.serial.len()).map(|bundle| {
            let axes = file.cell.axes_on(file.cell.bus.len() + bundle);
            let lines = axes.filter_map(|axis| match ids.drives.get(&axis) {
                Some(DriveId::Line(line)) => Some(*line),
                _ => None,
            });
            lines.map(|line| world.host_line(line, LINE)).collect()
        });
        let lines = lines.collect();
        HostEnds { ports, listeners: Vec::new(), lines, sensors: Vec::new() }
    }

    /// The count of unsolved parts of steps of the scene, if there is one.
    pub fn unsolved(&self) -> Option<UnsolvedProbe> {
        self.world.scene().map(Scene::watch_unsolved)
    }

    /// Connects the host and its end of a line by a pseudo-terminal, and returns the tty.
    pub fn on_tty(&mut self, line: VirtualLine, settings: Settings) -> anyhow::Result<BridgedTty> {
        let (bridge, tty) = Bridge::new(line, settings)?;
        self.bridges.push(bridge);
        Ok(tty)
    }

    /// Adds camera `number`, connected in memory, before the world is advanced. Returns the link of its receiver, or the
    /// reason why the camera is refused.
    pub(super) fn add_camera(&mut self, file: &CellFile, number: usize) -> Result<CameraLink, CameraFault> {
        let camera = emulated(file, number, &mut self.world);
        let (camera, link) = CameraInMemory::connect(&file.cell.camera[number], camera)?;
        self.cameras.push(camera);
        Ok(link)
    }

    /// Starts `count` threads that share the work of each advance with the calling thread.
    pub fn add_helpers(&mut self, count: usize) -> io::Result<()> {
        self.world.set_helpers(Helpers::of_this_thread(count)?);
        Ok(())
    }

    /// The world, for devices on other connections.
    pub(super) fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// Adds background traffic to every bus: a node that sends frames of the lowest priority.
    pub fn add_traffic(&mut self) {
        for &bus in &self.buses {
            self.world.add_device(bus, Box::new(Chatter { next: Instant::ZERO, due: false }));
        }
    }

    /// Place and motion of object `number` of the scene, counted from 0, in the frame of the cell.
    /// `None` before the object is placed.
    pub fn object(&self, number: usize) -> Option<hil::scene::BodyState> {
        let scene = self.world.scene()?;
        Some(scene.body(scene.placed(number)?))
    }

    /// Advances the world to `until`. The host then has all frames and bytes that arrived by that time.
    pub fn advance(&mut self, until: Instant) {
        self.advance_beside(until, || {});
    }

    /// Advances the world as [`advance`](Self::advance). The helpers of [`add_helpers`](Self::add_helpers) advance while
    /// this thread does `work`. `work` neither reads the wires nor writes to them.
    pub fn advance_beside(&mut self, until: Instant, work: impl FnOnce()) {
        let mut work = Some(work);
        // `work` may read pictures of cameras, so the pictures of this advance must arrive after `work`.
        if !self.cameras.is_empty() {
            work.take().into_iter().for_each(|work| work());
        }
        for bridge in &mut self.bridges {
            bridge.take(self.passed);
        }
        self.payloads.take_over(self.passed);
        let next = |cameras: &[CameraInMemory]| cameras.iter().map(CameraInMemory::next).min();
        while let Some(at) = next(&self.cameras).filter(|at| *at <= until) {
            self.advance_world(at, || {});
            self.cameras.iter_mut().for_each(|camera| camera.expose(at));
        }
        self.advance_world(until, || work.into_iter().for_each(|work| work()));
        self.cameras.iter_mut().for_each(|camera| camera.deliver(until));
        for bridge in &mut self.bridges {
            bridge.deliver(until);
        }
        self.passed = until;
        if let Some(log) = &mut self.log {
            log.write(until, &self.truth);
        }
    }

    /// Advances the world to `until`, with the faults of the scenario up to then.
    fn advance_world(&mut self, until: Instant, work: impl FnOnce()) {
        if let Some(scenario) = &mut self.scenario {
            scenario.advance(&mut self.world, until);
        }
        self.world.advance_beside(until, work);
        if let Some(scenario) = &self.scenario {
            scenario.note(&self.world);
        }
    }

    /// The buses and drives in the world.
    pub fn ids(&self) -> &DriveIds {
        &self.ids
    }

    /// Applies the faults of a scenario from now on. The result tells which of them have acted.
    pub fn play(&mut self, scenario: &Scenario, file: &CellFile) -> anyhow::Result<ScenarioProbe> {
        let run = ScenarioRun::new(scenario, file, &self.ids)?;
        let probe = run.watch();
        self.scenario = Some(run);
        Ok(probe)
    }

    /// Begins a fault at the present time of the world.
    pub fn begin_fault(&mut self, fault: &WorldFault) -> FaultInEffect {
        self.world.begin_fault(fault, self.passed)
    }

    /// Ends a fault at the present time of the world.
    pub fn end_fault(&mut self, fault: &FaultInEffect) {
        self.world.end_fault(fault, self.passed);
    }

    /// Sets the terminal of input `input` of I/O node `node`, by their numbers in the cell, at the present time of the
    /// world. Returns whether there is such an input.
    pub fn set_input(&mut self, node: usize, input: u8, level: bool) -> bool {
        let now = self.passed;
        let module = self.ids.modules.get(&node);
        let set = |module: &mut DigitalIo| module.set_input(now, input, level).is_ok();
        module.and_then(|&module| self.world.change(module, now, set)).unwrap_or(false)
    }

    /// The motor of a drive with its true state, which no controller reads.
    pub fn plant(&self, drive: DriveId) -> Option<&PlantAxis> {
        self.world.plant(drive)
    }

    /// Writes the truth of the scene to `log` after each advance from now on.
    pub fn log_truth(&mut self, log: TruthLog) {
        self.log = Some(log);
    }

    /// The height fields of the workpieces, in the order of the cell file.
    pub fn workpieces(&self) -> &[WorkpieceProbe] {
        &self.truth.workpieces
    }
}

/// A node that sends a frame of eight bytes every [`CHATTER`] and ignores received frames.
struct Chatter {
    next: Instant,
    due: bool,
}

impl Device for Chatter {
    fn handle(&mut self, _frame: &Frame, _now: Instant) {}

    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        let id = StandardId::new(CHATTER_ID)?;
        let due = std::mem::take(&mut self.due);
        Frame::new(id, &[0x55; 8]).filter(|_| due)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }

    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.next {
            self.due = true;
            self.next = now + CHATTER;
        }
    }
}

/// Functions that the cell needs and its emulation lacks. Real robots may have them.
pub fn problems(file: &CellFile) -> impl Iterator<Item = anyhow::Error> {
    let axes = (0..file.cell.bus.len()).flat_map(|bus| file.cell.axes_on(bus));
    let homing = axes.filter_map(|axis| homing_problem(file, axis)).map(|(key, problem)| file.refuse(&key, problem));
    homing.chain(emulated_sensors::problems(file))
}

impl EmulatedCell<'_> {
    /// Adds bus `bus` with its drives and modules, switched on at [`Instant::ZERO`].
    pub fn add_bus(&self, world: &mut World, bus: usize) -> BusId {
        let id = world.add_bus(bitrate(self.file, bus));
        let mut ids = self.ids.borrow_mut();
        ids.buses.push(id);
        let (mut axes, mut modules) = (axes_present(self.file, bus), self.file.cell.io_on(bus));
        for device in self.devices(bus, Instant::ZERO) {
            let device = world.add_device(id, device);
            // The drives come before the modules.
            match axes.next() {
                Some(axis) => _ = ids.drives.insert(axis, DriveId::Node(device)),
                None => ids.modules.extend(modules.next().map(|module| (module, device))),
            }
        }
        let share = self.file.cell.bus[bus].emulated_load;
        if share > 0.0 {
            let seed = Stream::Traffic(bus).seed(self.file);
            world.add_device(id, Box::new(BusLoad::new(bitrate(self.file, bus), share, seed)));
        }
        id
    }

    /// The drives and modules on bus `bus`, switched on at `power_on`. [`add_sensors`](Self::add_sensors) adds its force
    /// sensors.
    pub fn devices(&self, bus: usize, power_on: Instant) -> Vec<Box<dyn Device>> {
        let device = |(robot, number): (usize, usize)| {
            let config = config(self.file, robot, number, power_on);
            Box::new(Epos4::new(Epos4Config { mount: self.mount(robot, number), ..config })) as Box<dyn Device>
        };
        let drives = axes_present(self.file, bus).map(device);
        let cell = &self.file.cell;
        let modules = cell.io_on(bus).map(|node| Box::new(self.module(node, power_on)) as Box<dyn Device>);
        drives.chain(modules).collect()
    }

    /// The light gates at the inputs of I/O node `node`, with the numbers of the inputs.
    fn beams_at(&self, node: usize) -> Vec<(u8, BeamProbe)> {
        let cell = &self.file.cell;
        let gates = cell.scene.iter().flat_map(|scene| &scene.gate).zip(&self.beams);
        let beam = |(gate, probe): (&EmulatedGate, &BeamProbe)| {
            let place = cell.input_line(&gate.input).filter(|place| place.node == node)?;
            Some((place.line, probe.clone()))
        };
        gates.filter_map(beam).collect()
    }

    /// The switches of the touch probes at the inputs of I/O node `node`, with the numbers of the inputs.
    fn touches_at(&self, node: usize) -> Vec<(u8, InputProbe)> {
        let cell = &self.file.cell;
        let probes = cell.scene.iter().flat_map(|scene| &scene.touch_probe).zip(&self.touches);
        let at_node = |(probe, touch): (&EmulatedTouchProbe, &InputProbe)| {
            let place = cell.input_line(&probe.input).filter(|place| place.node == node)?;
            Some((place.line, touch.clone()))
        };
        probes.filter_map(at_node).collect()
    }

    /// Adds the line of an axis of bundle `bundle`, with its axis controller in `cabinet`, switched on at
    /// [`Instant::ZERO`]. Returns the host's end.
    pub fn add_line(&self, world: &mut World, bundle: usize, axis: (usize, usize), cabinet: &Cabinet) -> VirtualLine {
        let line = self.add_axis_controller(world, bundle, axis, cabinet);
        world.host_line(line, LINE)
    }

    /// As [`add_line`](Self::add_line), without an end for a host.
    pub fn add_axis_controller(
        &self,
        world: &mut World,
        bundle: usize,
        axis: (usize, usize),
        cabinet: &Cabinet,
    ) -> LineId {
        let bundle = &self.file.cell.serial[bundle];
        let latency = bundle.emulated_latency_ms.map(|latency| Duration::from_millis(u64::from(latency)));
        let device = self.axis_controller(bundle.protocol, axis, cabinet);
        let line = world.add_line(bundle.settings(), latency, device);
        self.ids.borrow_mut().drives.insert(axis, DriveId::Line(line));
        line
    }

    /// The emulated module of I/O node `node`, with light gates and touch probes at its inputs, and with the valves of the
    /// grippers and the spindles at its outputs.
    fn module(&self, node: usize, power_on: Instant) -> DigitalIo {
        let cell = &self.file.cell;
        let mut module = module(&cell.io[node], self.beams_at(node), self.touches_at(node), power_on);
        let grippers = cell.scene.iter().flat_map(|scene| &scene.gripper);
        let valves = grippers.map(|gripper| Some(&gripper.output)).zip(&self.valves);
        let cutters = cell.scene.iter().flat_map(|scene| &scene.cutter);
        let spindles = cutters.map(|cutter| cutter.spindle.as_ref()).zip(&self.spindles);
        for (output, terminal) in valves.chain(spindles) {
            let place = output.and_then(|output| cell.output_line(output));
            if let Some(place) = place.filter(|place| place.node == node) {
                module.connect(place.line, terminal);
            }
        }
        module
    }

    fn axis_controller(
        &self,
        protocol: Protocol,
        (robot, number): (usize, usize),
        cabinet: &Cabinet,
    ) -> Box<dyn LineDevice> {
        let axis = &self.file.cell.robot[robot].axis[number];
        if axis.emulator.absent {
            return Box::new(Absent);
        }
        let config = AxisControllerConfig {
            seed: Stream::Axis { robot, number }.seed(self.file),
            cabinet: cabinet.clone(),
            mount: self.mount(robot, number),
            synchronized: self.referenced.get(),
            ..AxisControllerConfig::new(plant(self.file, robot, number))
        };
        match axis.emulator.protocol.unwrap_or(protocol) {
            Protocol::Nfv2 => Box::new(AxisController::nfv2(axis.emulator.address.unwrap_or(axis.node), &config)),
            Protocol::HiMoxa => Box::new(AxisController::hi_moxa(&config)),
        }
    }
}

/// The bit rate of bus `bus`.
pub fn bitrate(file: &CellFile, bus: usize) -> Bitrate {
    Bitrate::from_kbps(file.cell.bus[bus].bitrate_kbps).expect("a parsed cell has possible bit rates")
}

/// Adds the service port of a drive like the drive of a CAN axis, switched on at [`Instant::ZERO`]. This drive is on
/// no bus. Returns the host's end.
pub fn add_service_port(world: &mut World, file: &CellFile, (robot, number): (usize, usize)) -> VirtualLine {
    let config = EposSerialConfig::new(config(file, robot, number, Instant::ZERO));
    let line = world.add_line(Settings::EPOS, None, Box::new(EposSerial::epos4(config)));
    world.host_line(line, LINE)
}

/// The end of a line without a device.
pub(super) struct Absent;

impl LineDevice for Absent {
    fn receive(&mut self, _byte: u8, _now: Instant) {}
    fn poll_transmit(&mut self, _now: Instant) -> Option<u8> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
    fn handle_timeout(&mut self, _now: Instant) {}
}

/// The emulated module of an I/O node, with the scheduled edges, light gates and touch probes of its inputs.
fn module(io: &IoNode, beams: Vec<(u8, BeamProbe)>, probes: Vec<(u8, InputProbe)>, power_on: Instant) -> DigitalIo {
    // The time between two cycles does not matter here.
    let IoConfig { node, inputs, outputs, .. } = io.config(Duration::ZERO);
    let usual = DigitalIoConfig::new(node);
    let edge = |(at, index, level): (Duration, u8, bool)| InputEdge { at: power_on + at, index, level };
    let config = DigitalIoConfig {
        vendor: io.vendor,
        product: io.product.unwrap_or(usual.product),
        revision: io.revision.unwrap_or(usual.revision),
        input_bytes: blocks(inputs),
        output_bytes: blocks(outputs),
        power_on,
        edges: io.emulated_edges().map(edge).collect(),
        beams,
        probes,
        ..usual
    };
    DigitalIo::new(config).expect("a parsed cell has up to 64 lines of a kind, and edges of its inputs")
}

/// The node-IDs of the emulated devices on bus `bus`.
pub fn nodes_present(file: &CellFile, bus: usize) -> impl Iterator<Item = u8> {
    let drives = axes_present(file, bus).map(move |(robot, axis)| file.cell.robot[robot].axis[axis].node);
    let modules = file.cell.io_on(bus).map(move |node| file.cell.io[node].node);
    let sensors = file.cell.sensors_on(bus).filter(|&sensor| !file.cell.force_sensor[sensor].emulator.absent);
    drives.chain(modules).chain(sensors.filter_map(|sensor| file.cell.node_of_sensor(sensor)))
}

/// The axes on bus `bus` that have a drive, as pairs of robot and axis number.
pub fn axes_present(file: &CellFile, bus: usize) -> impl Iterator<Item = (usize, usize)> {
    file.cell.axes_on(bus).filter(|&(robot, axis)| !file.cell.robot[robot].axis[axis].emulator.absent)
}

/// The configuration of the emulated drive of an axis, with its motor on no mechanism.
pub fn config(file: &CellFile, robot: usize, number: usize, power_on: Instant) -> Epos4Config {
    let axis = &file.cell.robot[robot].axis[number];
    let node = NodeId::new(axis.node).expect("a parsed cell has valid node-IDs");
    let identity = file.identity(robot, number);
    let usual = Epos4Config::new(node, plant(file, robot, number));
    Epos4Config {
        vendor: axis.emulator.vendor.unwrap_or(identity.vendor),
        product: identity.product.unwrap_or(usual.product),
        revision: axis.emulator.revision.or(identity.revision).unwrap_or(usual.revision),
        main_sensor_resolution: axis.emulator.counts_per_revolution,
        rated_torque: axis.emulator.rated_torque.or(Some(axis.cia402().rated_torque)),
        seed: Stream::Axis { robot, number }.seed(file),
        trips_at: axis.emulator.trips_at_s.map(|at| power_on + Duration::from_secs_f64(at)),
        contact: contact(axis, power_on),
        power_on,
        ..usual
    }
}

/// The emulated contact of the emergency stop at a drive.
fn contact(axis: &Axis, power_on: Instant) -> Option<DriveContact> {
    let contact = axis.cia402().emergency_stop.as_ref()?;
    let edges = contact.emulated_edges_s.iter().map(|&at| power_on + Duration::from_secs_f64(at)).collect();
    Some(DriveContact { bit: contact.input, edges })
}
