//! The cycle does not allocate, whatever the drives report: enabling, following, homing, faults.
#![allow(unsafe_code, reason = "a counting allocator implements an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::TAU;
use std::task::Poll;
use std::time::Duration;

use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received, StandardId};
use canopen::NodeId;
use canopen::pdo::PdoNumber;
use mrroc_drive::axis_controller::{self, AxisControllerGroup, Control, Protocol};
use mrroc_drive::bus::CanBus;
use mrroc_drive::cia401::IoConfig;
use mrroc_drive::cia402::{AxisConfig, CyclicMode, GroupConfig, HomingConfig, Identity};
use mrroc_drive::ultrasonic::{UltrasonicConfig, UltrasonicMatrix};
use mrroc_drive::wrench::{
    Channel, Content, SerialWrenchConfig, SerialWrenchSensor, Trigger, WrenchAxis, WrenchConfig, WrenchField,
    WrenchLink, WrenchNodeConfig, WrenchPdo, ZeroMethod,
};
use mrroc_drive::{AxisCommand, AxisState, DriveGroup, Finite, Homing, Power, Scale, Setpoint};

use crate::{board, scripted};

struct Counting;

thread_local! {
    pub(crate) static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    ALLOCATIONS.with(|count| count.set(count.get() + 1));
}

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const AXES: usize = 6;
/// An I/O node on the bus of the drives.
const IO: u8 = 20;
/// A force/torque sensor on the bus of the drives.
const SENSOR: u8 = 30;
const PERIOD: Duration = Duration::from_millis(2);

/// All drives of the bus: an object store for service requests, and the same statusword from each drive for every
/// SYNC.
struct Drives {
    /// Objects by request identifier, index and sub-index. Identifier 0 holds the initial objects of every drive.
    objects: BTreeMap<(u16, u16, u8), [u8; 4]>,
    statusword: u16,
    emergencies: u16,
    inputs: u8,
    inbox: VecDeque<Received>,
}

impl Drives {
    fn reply(&mut self, id: u16, data: &[u8], at: Instant) {
        let id = StandardId::new(id).unwrap();
        self.inbox.push_back(Received { frame: Frame::new(id, data).unwrap(), at });
    }

    fn hear(&mut self, frame: &Frame, at: Instant) {
        let id = frame.standard_data_id().unwrap().raw();
        match (id, frame.data()) {
            (0, &[0x82, node]) => self.reply(0x700 + u16::from(node), &[0], at),
            (0, &[0x01, node]) => {
                self.reply(0x700 + u16::from(node), &[5], at);
                if node == IO {
                    self.reply(0x180 + u16::from(IO), &[0], at);
                }
            }
            (0x080, _) => {
                let [low, high] = self.statusword.to_le_bytes();
                // An edge of every input in every cycle.
                self.inputs = !self.inputs;
                self.reply(0x180 + u16::from(IO), &[self.inputs], at);
                self.reply(0x180 + u16::from(SENSOR), &[self.inputs & 0x0F, 0, 0, 0, 0, 0], at);
                self.reply(0x280 + u16::from(SENSOR), &[0; 6], at);
                self.reply(0x380 + 1, &[0, 0, 1, 0], at);
                for node in 1..=AXES as u16 {
                    self.reply(0x180 + node, &[low, high, 0xE8, 3, 0, 0, 0, 0], at);
                    // Each EMCY is another error, and there are more of them than the group keeps: lost frames, and after the
                    // fault of the drive any other.
                    self.emergencies = self.emergencies.wrapping_add(1);
                    let [number, vendor] = self.emergencies.to_le_bytes();
                    let [code, class] = if low & 0x08 == 0 { [0x10, 0x81] } else { [number, 0xFF] };
                    self.reply(0x080 + node, &[code, class, 1, vendor, number, 0, 0, 0], at);
                }
            }
            (0x600.., &[specifier, low, high, subindex, a, b, c, d]) => {
                let index = match u16::from_le_bytes([low, high]) {
                    0x6061 => 0x6060,
                    index => index,
                };
                let first = self.objects.get(&(0, index, subindex)).copied().unwrap_or_default();
                let stored = self.objects.entry((id, index, subindex)).or_insert(first);
                let (specifier, [a, b, c, d]) = if specifier == 0x40 {
                    (0x42, *stored)
                } else {
                    *stored = [a, b, c, d];
                    (0x60, [0; 4])
                };
                self.reply(id - 0x80, &[specifier, low, high, subindex, a, b, c, d], at);
            }
            _ => {}
        }
    }
}

impl Port for Drives {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        frames.iter().for_each(|frame| self.hear(frame, now + PERIOD / 2));
        Ok(frames.len())
    }
    fn receive(&mut self, _now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        let count = into.len().min(self.inbox.len());
        into.iter_mut().zip(self.inbox.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }
    fn counters(&self) -> Counters {
        Counters::default()
    }
    fn state(&self) -> ControllerState {
        ControllerState::Active
    }
}

/// The test keeps a handle to the port and can change the answers of the drives.
struct Shared(std::sync::Arc<std::sync::Mutex<Drives>>);

impl Port for Shared {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        self.0.lock().unwrap().send(now, frames)
    }
    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        self.0.lock().unwrap().receive(now, into)
    }
    fn counters(&self) -> Counters {
        self.0.lock().unwrap().counters()
    }
    fn state(&self) -> ControllerState {
        ControllerState::Active
    }
}

fn axis(raw: u8) -> AxisConfig {
    AxisConfig {
        node: NodeId::new(raw).unwrap(),
        identity: Identity { vendor: 0xFB, product: None, revision: None },
        mode: CyclicMode::Csp,
        scale: Scale::new(2_000, 0.0).unwrap(),
        rated_torque: 0.1,
        homing: HomingConfig {
            method: 37,
            search_speed: TAU,
            zero_speed: TAU,
            acceleration: TAU,
            start_timeout: Duration::from_secs(1),
        },
        plausible_velocity: 100.0 * TAU,
        plausible_acceleration: 100_000.0 * TAU,
        following_error: TAU,
        quick_stop_deceleration: TAU,
        emergency_input: (raw == 1).then_some(16),
        position_range: None,
        configuration: Vec::new(),
    }
}

/// Forces in one TPDO and torques in the other, at every SYNC.
fn sensor() -> WrenchNodeConfig {
    let node = NodeId::new(SENSOR).unwrap();
    let pdo = |number, axes: &[WrenchAxis]| WrenchPdo {
        number,
        cob_id: canopen::cob::tpdo(number, node),
        fields: axes.iter().map(|&axis| field(axis)).collect(),
        mapped: true,
    };
    let (forces, torques) = WrenchAxis::ALL.split_at(3);
    WrenchNodeConfig {
        node,
        identity: None,
        device_type: None,
        sensor: WrenchConfig { channels: [Channel { scale: 0.1, range: 1_000 }; 6], ..WrenchConfig::ATI },
        trigger: Trigger::Sync { every: 1 },
        pdos: vec![pdo(PdoNumber::One, forces), pdo(PdoNumber::Two, torques)],
        configuration: Vec::new(),
    }
}

fn field(axis: WrenchAxis) -> WrenchField {
    WrenchField { object: canopen::Object::new(0x2000, axis as u8 + 1), content: Content::I16(axis) }
}

#[test]
fn no_cycle_allocates() {
    let config = GroupConfig {
        period: PERIOD,
        tolerated_missing: 2,
        heartbeat_period: Duration::from_secs(20),
        host_node: NodeId::MAX,
        sdo_timeout: Duration::from_millis(100),
        sdo_retries: 1,
        boot_timeout: Duration::from_secs(1),
        transition_timeout: Duration::from_millis(200),
    };
    let axes: Vec<AxisConfig> = (1..=AXES as u8).map(axis).collect();
    let objects = BTreeMap::from([
        ((0, 0x1000, 0), [0x92, 1, 2, 0]),
        ((0x600 + u16::from(IO), 0x1000, 0), [0x91, 1, 3, 0]),
        ((0, 0x6000, 0), [1, 0, 0, 0]),
        ((0, 0x6200, 0), [1, 0, 0, 0]),
        ((0, 0x1018, 1), [0xFB, 0, 0, 0]),
        ((0, 0x6502, 0), [0xA5, 3, 0, 0]),
        ((0, 0x60FD, 0), [0, 0, 1, 0]),
        ((0, 0x6060, 0), [0; 4]),
        ((0, 0x603F, 0), [0x10, 0x23, 0, 0]),
        ((0, 0x3000, 5), 2_000_u32.to_le_bytes()),
        ((0, 0x6076, 0), 100_000_u32.to_le_bytes()),
        ((0, 0x608F, 1), 2_000_u32.to_le_bytes()),
        ((0, 0x608F, 2), 1_u32.to_le_bytes()),
        ((0, 0x6091, 1), 1_u32.to_le_bytes()),
        ((0, 0x6091, 2), 1_u32.to_le_bytes()),
        ((0, 0x6092, 1), 2_000_u32.to_le_bytes()),
        ((0, 0x6092, 2), 1_u32.to_le_bytes()),
    ]);
    let inbox = VecDeque::with_capacity(1_024);
    let drives = Drives { objects, statusword: 0x0740, emergencies: 0, inputs: 0, inbox };
    let drives = std::sync::Arc::new(std::sync::Mutex::new(drives));
    let io = IoConfig {
        node: NodeId::new(IO).unwrap(),
        identity: Identity { vendor: 0xFB, product: None, revision: None },
        inputs: 8,
        outputs: 8,
        inhibit_time: PERIOD,
        event_timer: Duration::from_millis(100),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0xFF,
        error_value: 0,
        configuration: Vec::new(),
    };
    let (mut group, links, sensors) =
        CanBus::with_sensors(Shared(drives.clone()), config, &axes, &[io], &[sensor()]).unwrap();
    let (io, wrench) = (&links[0], &sensors[0]);

    let mut now = Instant::ZERO;
    loop {
        match group.bring_up(now) {
            Poll::Pending => now += PERIOD,
            Poll::Ready(result) => break assert_eq!(result, Ok(())),
        }
    }
    let mut states = [AxisState::default(); AXES];
    let follow = AxisCommand::Follow(Setpoint::Position(Finite::new(TAU / 2.0).unwrap()));
    let wrong = AxisCommand::Follow(Setpoint::Torque(Finite::ZERO));
    let (mut followed, mut homed, mut faulted, mut zeroed) = (false, false, false, false);
    let first_zero = wrench.zero();
    let mut cycles = 0;
    let acts = [
        (0x0740, AxisCommand::Off),
        (0x0740, AxisCommand::Stand),
        (0x0721, AxisCommand::Stand),
        (0x0723, AxisCommand::Stand),
        (0x0737, AxisCommand::Stand),
        (0x0737, follow),
        (0x0737, AxisCommand::Home),
        (0x0237, AxisCommand::Home),
        (0x9637, AxisCommand::Home),
        (0x9737, AxisCommand::Stand),
        (0x0737, wrong),
        (0x0208, AxisCommand::Stand),
        (0x0208, AxisCommand::ResetFault),
        (0x0240, AxisCommand::ResetFault),
        (0x0240, AxisCommand::Off),
    ];
    for (statusword, command) in acts {
        drives.lock().unwrap().statusword = statusword;
        for _ in 0..30 {
            now += PERIOD;
            let before = ALLOCATIONS.get();
            group.read(now, &mut states);
            group.write(now, &[command; AXES]);
            io.outputs.set_all(!io.outputs.levels());
            group.send(now);
            if cycles % 20 == 0 {
                wrench.zero();
                wrench.reset_fault();
            }
            zeroed |= wrench.read().zeroing.is_done(first_zero);
            let edges = io.inputs.read().input(0).map(|input| input.edges);
            assert_eq!(ALLOCATIONS.get() - before, 0, "{statusword:#06x} {command:?}");
            // One edge in each cycle but the first, which no SYNC preceded.
            assert_eq!(edges, Some(cycles));
            cycles += 1;
            followed |= states[0].following && command == follow;
            homed |= states[0].homing == Homing::Attained;
            faulted |= states[0].fault.is_some();
        }
    }
    assert!(followed && homed && faulted && zeroed);
    assert_eq!(group.emergency_stop(), None);
    assert_eq!((wrench.read().fault, wrench.read().age), (None, 0));
    assert_eq!(io.inputs.read().sent.map(|sent| sent.cycle), Some(cycles - 2));
    // The I/O node boots, and is brought back by a reset.
    drives.lock().unwrap().reply(0x700 + u16::from(IO), &[0], now);
    for cycle in 0..500 {
        now += PERIOD;
        let before = ALLOCATIONS.get();
        group.read(now, &mut states);
        group.write(now, &[AxisCommand::Off; AXES]);
        group.send(now);
        assert_eq!(ALLOCATIONS.get() - before, 0, "cycle {cycle} of a reset");
        if cycle == 10 {
            assert!(io.inputs.read().fault.is_some());
            io.reset_fault();
        }
    }
    assert_eq!(io.inputs.read().fault, None);
    assert_eq!((states[0].power, states[0].fault), (Power::Off, None));
    // A drive boots, and is brought back by a reset.
    drives.lock().unwrap().reply(0x700 + 1, &[0], now);
    let mut recovered = false;
    for cycle in 0..500 {
        now += PERIOD;
        let command = if cycle < 10 { AxisCommand::Off } else { AxisCommand::ResetFault };
        let before = ALLOCATIONS.get();
        group.read(now, &mut states);
        group.write(now, &[command; AXES]);
        group.send(now);
        assert_eq!(ALLOCATIONS.get() - before, 0, "cycle {cycle} of a recovery");
        recovered |= states[0].recovering;
    }
    assert!(recovered && states[0].fault.is_none());
    // The allocation counter itself works.
    let before = ALLOCATIONS.get();
    drop(Box::new(1));
    assert_eq!(ALLOCATIONS.get() - before, 2);
}

#[test]
fn no_cycle_of_serial_lines_allocates() {
    use serial::nfv2::Status;
    type Act = fn(&mut scripted::Drive);
    for protocol in [Protocol::Nfv2, Protocol::HiMoxa] {
        let config = axis_controller::AxisConfig {
            address: 8,
            scale: Scale::new(4_000, 0.0).unwrap(),
            torque_constant: 0.1,
            control: Control::Pwm,
            max_current: 15.0,
            max_velocity: 100.0,
            max_acceleration: 10_000.0,
        };
        let drives = |_| scripted::Drive::new(protocol, 8).shared();
        let lines: Vec<scripted::Shared> = (0..AXES).map(drives).collect();
        let group = axis_controller::GroupConfig::new(protocol);
        let mut group = AxisControllerGroup::new(lines.clone(), group, &[config; AXES]).unwrap();
        let mut now = Instant::ZERO;
        while group.bring_up(now).map(Result::unwrap).is_pending() {
            now += PERIOD;
        }
        let duty = Setpoint::Duty(Finite::new(0.3).unwrap());
        let (follow, seek) = (AxisCommand::Follow(duty), AxisCommand::Seek(duty));
        let wrong = AxisCommand::Follow(Setpoint::Torque(Finite::ZERO));
        let nothing: Act = |_| ();
        let acts: [(Act, AxisCommand); 14] = [
            (nothing, AxisCommand::Off),
            (|drive| drive.velocity = 1, AxisCommand::Stand),
            (nothing, follow),
            (|drive| (drive.velocity, drive.index) = (9, Some(1_200)), seek),
            (|drive| drive.outbox.extend([0x23, 0x12, 0xED, 8]), follow),
            (|drive| drive.mute = 2, follow),
            (nothing, wrong),
            (nothing, AxisCommand::ResetFault),
            (|drive| drive.position = 90_000, AxisCommand::Stand),
            (nothing, AxisCommand::ResetFault),
            (|drive| drive.status = Status::OVERCURRENT, AxisCommand::Stand),
            (|drive| drive.full = true, AxisCommand::Stand),
            (|drive| (drive.full, drive.mute) = (false, 5), AxisCommand::Off),
            (|drive| drive.status = 0, AxisCommand::ResetFault),
        ];
        let mut states = [AxisState::default(); AXES];
        let (mut homed, mut faulted, mut silent) = (false, false, false);
        for (act, command) in acts {
            for line in &lines {
                line.drive().keep_heard = false;
                act(&mut line.drive());
            }
            for _ in 0..50 {
                now += PERIOD;
                let before = ALLOCATIONS.get();
                group.read(now, &mut states);
                group.write(now, &[command; AXES]);
                group.send(now);
                assert_eq!(ALLOCATIONS.get() - before, 0, "{protocol:?} {command:?}");
                homed |= states[0].homing == Homing::Attained;
                faulted |= states[0].fault.is_some();
                silent |= states[0].age > 0;
            }
        }
        assert!(homed && faulted && silent, "{homed} {faulted} {silent}");
        assert_eq!((states[0].power, states[0].fault), (Power::Off, None));
    }
}

/// One cycle, which must not allocate.
fn sensor_cycle(sensor: &mut SerialWrenchSensor<board::SharedBoard>, link: &WrenchLink, now: Instant, act: &str) {
    let before = ALLOCATIONS.get();
    sensor.read(now, &mut []);
    sensor.write(now, &[]);
    sensor.send(now);
    link.read();
    assert_eq!(ALLOCATIONS.get() - before, 0, "{act}");
}

#[test]
fn no_cycle_of_a_serial_force_sensor_allocates() {
    type Act = fn(&mut board::Board);
    for zero in [ZeroMethod::Host { samples: 10 }, ZeroMethod::Device] {
        let mut config = SerialWrenchConfig::new(PERIOD);
        config.sensor.zero = zero;
        let line = board::Board { keep_heard: false, ..board::Board::new() }.shared();
        let (mut sensor, link) = SerialWrenchSensor::new(line.clone(), config).unwrap();
        let mut now = Instant::ZERO;
        while sensor.bring_up(now).map(Result::unwrap).is_pending() {
            now += PERIOD;
        }
        let acts: [(&str, Act); 9] = [
            ("samples", |board| board.load = [100; 6]),
            ("a missing answer", |board| board.mute = 1),
            ("silence", |board| board.deaf = true),
            ("garbage", |board| board.outbox.extend([1; 100])),
            ("answers of another length", |board| (board.deaf, board.surplus) = (false, 1)),
            ("saturation", |board| (board.load[3], board.surplus) = (-30_000, 0)),
            ("a full line", |board| board.full = true),
            ("a line that is gone", |board| (board.gone, board.full) = (true, false)),
            ("a line that is back", |board| *board = board::Board { keep_heard: false, ..board::Board::new() }),
        ];
        let mut faults = Vec::with_capacity(acts.len());
        for (name, act) in acts {
            act(&mut line.board());
            link.reset_fault();
            if name != "saturation" {
                // The bias command would hide the load.
                link.zero();
            }
            for _ in 0..50 {
                now += PERIOD;
                sensor_cycle(&mut sensor, &link, now, name);
            }
            faults.extend(link.read().fault);
        }
        assert_eq!(faults.len(), 6, "{faults:?}");
        assert_eq!(link.read().fault, None);
    }
}

/// The line of a matrix of 3 × 3 elements that answers in the next reading.
#[derive(Clone, Copy, Default)]
struct MatrixLine {
    /// Frame to read and its length.
    frame: [u8; 16],
    length: usize,
    deaf: bool,
    broken: bool,
    gone: bool,
}

impl serial::Line for MatrixLine {
    fn read(&mut self, _now: Instant, buffer: &mut [u8]) -> Result<usize, serial::LineError> {
        if self.gone {
            return Err(serial::LineError::Gone);
        }
        let length = std::mem::take(&mut self.length);
        buffer[..length].copy_from_slice(&self.frame[..length]);
        Ok(length)
    }

    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, serial::LineError> {
        let body: &[u8] = match bytes[2] {
            serial::ultrasonic::IDENTIFY => &[1, 3, 0, 200, 0x0D, 0xAC],
            _ => &[3, bytes[3], 7, 0, 7, 1, 0xFF, 0xFF],
        };
        if !self.deaf {
            self.length = serial::ultrasonic::encode(body, &mut self.frame).unwrap();
            self.frame[self.length - 1] ^= u8::from(self.broken);
        }
        Ok(bytes.len())
    }

    fn discard_unsent(&mut self) {}

    fn counters(&self) -> serial::LineCounters {
        serial::LineCounters::default()
    }
}

/// A line that a test changes between two cycles.
#[derive(Clone, Default)]
struct SharedLine(std::sync::Arc<std::sync::Mutex<MatrixLine>>);

impl serial::Line for SharedLine {
    fn read(&mut self, now: Instant, buffer: &mut [u8]) -> Result<usize, serial::LineError> {
        self.0.lock().unwrap().read(now, buffer)
    }

    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, serial::LineError> {
        self.0.lock().unwrap().write(now, bytes)
    }

    fn discard_unsent(&mut self) {}

    fn counters(&self) -> serial::LineCounters {
        serial::LineCounters::default()
    }
}

#[test]
fn no_cycle_of_an_ultrasonic_matrix_allocates() {
    let line = SharedLine::default();
    let config = UltrasonicConfig { size: 3, ..UltrasonicConfig::new(PERIOD) };
    let (mut matrix, link) = UltrasonicMatrix::new(line.clone(), config).unwrap();
    let mut now = Instant::ZERO;
    while matrix.bring_up(now).map(Result::unwrap).is_pending() {
        now += PERIOD;
    }
    let mut faults = Vec::with_capacity(5);
    for (deaf, broken, gone) in
        [(false, false, false), (true, false, false), (false, true, false), (false, false, true), (false, false, false)]
    {
        *line.0.lock().unwrap() = MatrixLine { deaf, broken, gone, ..MatrixLine::default() };
        link.reset_fault();
        for _ in 0..400 {
            now += PERIOD;
            let before = ALLOCATIONS.get();
            matrix.read(now, &mut []);
            matrix.write(now, &[]);
            matrix.send(now);
            link.read();
            assert_eq!(ALLOCATIONS.get() - before, 0, "deaf {deaf}, broken {broken}, gone {gone}");
        }
        faults.extend(link.read().fault);
    }
    assert_eq!(faults.len(), 3, "{faults:?}");
    assert!(link.read().measured().is_some());
}
