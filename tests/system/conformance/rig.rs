//! A raw client on a virtual bus. Its frames are built byte by byte from the standards, without a master of
//! `drivers/canopen`.

use std::fmt::Write as _;
use std::time::Duration;

use can::timing::Bitrate;
use can::{ExtendedId, Frame, Instant, Port, Received, StandardId, VirtualPort};
use canopen::NodeId;
use hil::plant::{FrictionConfig, PlantConfig, Switch, WutConfig};
use hil::{AxisConfig, DeviceId, Epos4, Epos4Config, Irp6Axis, World};

/// The node-ID of the drive under test.
pub(super) const NODE: u8 = 2;

/// COB-IDs of the drive under test (CiA 301 §7.3.3).
pub(super) const EMCY: u16 = 0x080 + NODE as u16;

pub(super) const SDO_REQUEST: u16 = 0x600 + NODE as u16;

pub(super) const SDO_ANSWER: u16 = 0x580 + NODE as u16;

pub(super) const HEARTBEAT: u16 = 0x700 + NODE as u16;

/// COB-IDs of the first four PDOs of the drive under test.
pub(super) const RPDO: [u16; 4] = [0x202, 0x302, 0x402, 0x502];

pub(super) const TPDO: [u16; 4] = [0x182, 0x282, 0x382, 0x482];

/// Encoder counts of one motor turn.
pub(super) const TURN: i32 = 4000;

/// Motor angle at power-on, rad.
pub(super) const START: f64 = 4.0;

/// Time that a client waits for the answer of an SDO server.
const ANSWER: Duration = Duration::from_millis(100);

/// Lines of the trace that a deviation shows.
const SHOWN: usize = 24;

/// A claim that does not hold: the expected and the actual behaviour.
#[derive(Debug)]
pub(super) struct Deviation(pub(super) String);

/// The result of one check.
pub(super) type Verdict = Result<(), Deviation>;

/// Ends a check with a deviation unless the condition holds.
macro_rules! ensure {
    ($condition:expr, $($text:tt)+) => {
        let holds: bool = $condition;
        if !holds {
            return Err($crate::conformance::rig::Deviation(format!($($text)+)));
        }
    };
}

pub(super) use ensure;

/// A frame of the trace.
#[derive(Clone, Copy)]
struct Line {
    at: Instant,
    sent: bool,
    frame: Frame,
}

/// A frame from the drive.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Heard {
    pub(super) at: Instant,
    pub(super) data: Vec<u8>,
}

/// A place in the trace.
#[derive(Clone, Copy)]
pub(super) struct Mark(usize);

/// One drive alone on a bus of 1 Mbit/s with the client.
pub(super) struct Rig {
    world: World,
    port: VirtualPort,
    device: Option<DeviceId>,
    now: Instant,
    trace: Vec<Line>,
}

/// An axis without friction, weight, brake and switches.
pub(super) fn free_axis() -> AxisConfig {
    let axis = AxisConfig::wut(Irp6Axis::Column);
    AxisConfig {
        plant: PlantConfig::Wut(WutConfig {
            torque_constant: 0.105,
            inertia: 1.5e-4,
            viscous: 1e-7,
            friction: FrictionConfig::NONE,
            resistance: 0.6,
        }),
        counts_per_revolution: TURN as u32,
        index_angle: START + 1.0,
        start_angle: START,
        brake: 0.0,
        home_switch: None,
        negative_limit: None,
        positive_limit: None,
        ..axis
    }
}

/// A free axis with limit switches 10 rad from the start and a home switch from 4 rad to 6 rad below the start.
pub(super) fn switched_axis() -> AxisConfig {
    let switch = |from: f64, to: f64| Some(Switch { from, to, bounce: 0 });
    AxisConfig {
        home_switch: switch(START - 6.0, START - 4.0),
        negative_limit: switch(f64::NEG_INFINITY, START - 10.0),
        positive_limit: switch(START + 10.0, f64::INFINITY),
        ..free_axis()
    }
}

/// A drive with node-ID 2 and a free axis.
pub(super) fn unit() -> Epos4Config {
    let node = NodeId::new(NODE).expect("2 is a node-ID");
    Epos4Config::new(node, free_axis())
}

/// Devices on the bus beside the client.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Bench {
    Drive,
    /// No device, so every claim must fail.
    Empty,
}

impl Rig {
    /// The drive of [`unit`], past its boot-up.
    pub(super) fn new(bench: Bench) -> Self {
        let mut rig = Self::powered(bench, unit());
        rig.pass(60);
        rig
    }

    /// A drive that has just been switched on.
    fn powered(bench: Bench, config: Epos4Config) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let device = match bench {
            Bench::Drive => Some(world.add_device(bus, Box::new(Epos4::new(config)))),
            Bench::Empty => None,
        };
        Self { world, port, device, now: Instant::ZERO, trace: Vec::new() }
    }

    /// Replaces the drive by another one that is switched on now. Time and trace start again.
    pub(super) fn power_on(&mut self, config: Epos4Config) {
        let bench = match self.device {
            Some(_) => Bench::Drive,
            None => Bench::Empty,
        };
        *self = Self::powered(bench, config);
    }

    /// Replaces the drive by another one after its boot-up.
    pub(super) fn boot(&mut self, config: Epos4Config) {
        self.power_on(config);
        self.pass(60);
    }

    /// Replaces the drive by a drive on `axis` after its boot-up.
    pub(super) fn boot_on(&mut self, axis: AxisConfig) {
        self.boot(Epos4Config { axis, ..unit() });
    }

    /// Motor angle of the plant, rad, which no frame carries.
    pub(super) fn angle(&self) -> f64 {
        let device = self.device.and_then(|device| self.world.device(device));
        device.map_or(START, |device: &Epos4| device.axis().angle())
    }

    pub(super) fn now(&self) -> Instant {
        self.now
    }

    /// Lets milliseconds pass.
    pub(super) fn pass(&mut self, millis: u64) {
        for _ in 0..millis {
            self.pass_micros(1_000);
        }
    }

    /// Lets microseconds pass, at most 1000.
    pub(super) fn pass_micros(&mut self, micros: u64) {
        self.now += Duration::from_micros(micros);
        self.world.advance(self.now);
        let filler = Frame::new(StandardId::MAX, &[]).expect("an empty frame");
        let mut into = [Received { frame: filler, at: Instant::ZERO }; 64];
        loop {
            let count = self.port.receive(self.now, &mut into).expect("a virtual port receives");
            for Received { frame, at } in &into[..count] {
                self.trace.push(Line { at: *at, sent: false, frame: *frame });
            }
            if count < into.len() {
                break;
            }
        }
    }

    /// Sends a data frame.
    pub(super) fn send(&mut self, id: u16, data: &[u8]) {
        let id = StandardId::new(id).expect("11 bits");
        self.put(Frame::new(id, data).expect("at most 8 bytes"));
    }

    /// Sends a data frame with a 29-bit identifier.
    pub(super) fn send_extended(&mut self, id: u32, data: &[u8]) {
        let id = ExtendedId::new(id).expect("29 bits");
        self.put(Frame::new(id, data).expect("at most 8 bytes"));
    }

    /// Sends a remote frame.
    pub(super) fn send_remote(&mut self, id: u16, len: u8) {
        let id = StandardId::new(id).expect("11 bits");
        self.put(Frame::remote(id, len).expect("at most 8 bytes"));
    }

    fn put(&mut self, frame: Frame) {
        let taken = self.port.send(self.now, &[frame]);
        assert_eq!(taken, Ok(1), "the virtual port has room");
        self.trace.push(Line { at: self.now, sent: true, frame });
    }

    /// Present end of the trace.
    pub(super) fn mark(&self) -> Mark {
        Mark(self.trace.len())
    }

    /// Frames that the drive sent under an identifier after `mark`.
    pub(super) fn heard(&self, mark: Mark, id: u16) -> Vec<Heard> {
        self.lines_after(mark)
            .filter(|line| line.frame.standard_data_id().map(StandardId::raw) == Some(id))
            .map(|line| Heard { at: line.at, data: line.frame.data().to_vec() })
            .collect()
    }

    /// All frames that the drive sent after `mark`, in the notation of candump.
    pub(super) fn all_heard(&self, mark: Mark) -> Vec<String> {
        self.lines_after(mark).map(|line| line.frame.to_string()).collect()
    }

    fn lines_after(&self, mark: Mark) -> impl Iterator<Item = &Line> {
        self.trace[mark.0..].iter().filter(|line| !line.sent)
    }

    /// The last frames of the trace, one per line: `>` to the drive, `<` from the drive.
    pub(super) fn tail(&self) -> String {
        let from = self.trace.len().saturating_sub(SHOWN);
        self.trace[from..].iter().fold(String::new(), |mut text, line| {
            let arrow = if line.sent { '>' } else { '<' };
            let _ = writeln!(text, "    {} {arrow} {}", line.at, line.frame);
            text
        })
    }

    /// Sends an NMT command to the drive and waits 5 ms.
    pub(super) fn nmt(&mut self, command: u8) {
        self.send(0x000, &[command, NODE]);
        self.pass(5);
    }

    /// Sends an NMT reset and waits for the restart.
    pub(super) fn reset(&mut self, command: u8) {
        self.send(0x000, &[command, NODE]);
        self.pass(80);
    }

    /// NMT state according to heartbeats of 10 ms, which the check has enabled before.
    pub(super) fn nmt_state(&mut self) -> Result<u8, Deviation> {
        let mark = self.mark();
        self.pass(25);
        let heartbeats = self.heard(mark, HEARTBEAT);
        let last = heartbeats.last().and_then(|heartbeat| heartbeat.data.first());
        last.copied().ok_or_else(|| Deviation("no heartbeat within 25 ms at a producer time of 10 ms".to_owned()))
    }

    /// Sends one SDO request. Returns the answer, if any.
    pub(super) fn ask(&mut self, request: [u8; 8]) -> Option<[u8; 8]> {
        let mark = self.mark();
        self.send(SDO_REQUEST, &request);
        self.answer_after(mark)
    }

    /// Waits for the next SDO answer after `mark`.
    pub(super) fn answer_after(&mut self, mark: Mark) -> Option<[u8; 8]> {
        let deadline = self.now + ANSWER;
        while self.now < deadline {
            self.pass_micros(250);
            if let Some(answer) = self.heard(mark, SDO_ANSWER).first() {
                return answer.data.clone().try_into().ok();
            }
        }
        None
    }

    /// Sends one SDO request and returns its answer of eight bytes.
    pub(super) fn transfer(&mut self, request: [u8; 8]) -> Result<[u8; 8], Deviation> {
        self.ask(request).ok_or_else(|| Deviation(format!("no SDO answer to {}", hex(&request))))
    }

    /// Makes an expedited upload and returns the bytes of the value.
    pub(super) fn upload(&mut self, index: u16, subindex: u8) -> Result<Vec<u8>, Deviation> {
        let answer = self.transfer(request(0x40, index, subindex, [0; 4]))?;
        ensure!(
            answer[0] & 0xE3 == 0x43 && answer[1..4] == multiplexer(index, subindex),
            "upload of {index:#06x}:{subindex:02x}: {}",
            hex(&answer)
        );
        let unused = usize::from(answer[0] >> 2 & 3);
        Ok(answer[4..8 - unused].to_vec())
    }

    /// Reads an unsigned value by expedited upload.
    pub(super) fn read(&mut self, index: u16, subindex: u8) -> Result<u32, Deviation> {
        let mut bytes = [0; 4];
        let value = self.upload(index, subindex)?;
        bytes[..value.len()].copy_from_slice(&value);
        Ok(u32::from_le_bytes(bytes))
    }

    /// Reads a signed value by expedited upload.
    pub(super) fn read_signed(&mut self, index: u16, subindex: u8) -> Result<i32, Deviation> {
        let value = self.upload(index, subindex)?;
        let negative = value.last().is_some_and(|byte| byte & 0x80 != 0);
        let mut bytes = [if negative { 0xFF } else { 0 }; 4];
        bytes[..value.len()].copy_from_slice(&value);
        Ok(i32::from_le_bytes(bytes))
    }

    /// Expects the value of an object.
    pub(super) fn expect(&mut self, index: u16, subindex: u8, value: u32) -> Verdict {
        let found = self.read(index, subindex)?;
        ensure!(found == value, "{index:#06x}:{subindex:02x} is {found:#x}, expected {value:#x}");
        Ok(())
    }

    /// Makes an expedited download of 1 to 4 bytes and returns the answer.
    pub(super) fn download(
        &mut self,
        index: u16,
        subindex: u8,
        value: i64,
        bytes: usize,
    ) -> Result<[u8; 8], Deviation> {
        self.transfer(download_request(index, subindex, value, bytes))
    }

    /// Makes an expedited download that must be accepted.
    pub(super) fn write(&mut self, index: u16, subindex: u8, value: i64, bytes: usize) -> Verdict {
        let answer = self.download(index, subindex, value, bytes)?;
        ensure!(
            answer == request(0x60, index, subindex, [0; 4]),
            "download of {value:#x} to {index:#06x}:{subindex:02x}: {}",
            hex(&answer)
        );
        Ok(())
    }

    /// Makes an expedited download that must be refused with one of these abort codes.
    pub(super) fn refuse(&mut self, (index, subindex): (u16, u8), value: i64, bytes: usize, codes: &[u32]) -> Verdict {
        let answer = self.download(index, subindex, value, bytes)?;
        let what = format!("download of {value:#x} to {index:#06x}:{subindex:02x}");
        aborted(&answer, (index, subindex), codes, &what)
    }
}

/// Expects an SDO abort for this object with one of these codes. An empty list accepts any code.
pub(super) fn aborted(answer: &[u8; 8], (index, subindex): (u16, u8), codes: &[u32], what: &str) -> Verdict {
    let code = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]);
    ensure!(
        answer[0] == 0x80 && answer[1..4] == multiplexer(index, subindex),
        "{what}: {}, expected an abort of the object",
        hex(answer)
    );
    ensure!(
        codes.is_empty() || codes.contains(&code),
        "{what}: abort {code:#010x}, expected {}",
        codes.iter().map(|code| format!("{code:#010x}")).collect::<Vec<_>>().join(" or ")
    );
    Ok(())
}

/// Index and sub-index in the byte order of a frame.
pub(super) fn multiplexer(index: u16, subindex: u8) -> [u8; 3] {
    let [low, high] = index.to_le_bytes();
    [low, high, subindex]
}

/// An SDO frame with a multiplexer.
pub(super) fn request(command: u8, index: u16, subindex: u8, data: [u8; 4]) -> [u8; 8] {
    let [low, high, sub] = multiplexer(index, subindex);
    let [a, b, c, d] = data;
    [command, low, high, sub, a, b, c, d]
}

/// The request of an expedited download with its size (CiA 301 §7.2.4.3.3).
pub(super) fn download_request(index: u16, subindex: u8, value: i64, bytes: usize) -> [u8; 8] {
    let all = value.to_le_bytes();
    let mut data = [0; 4];
    data[..bytes].copy_from_slice(&all[..bytes]);
    let command = 0x23 | (4 - bytes as u8) << 2;
    request(command, index, subindex, data)
}

/// Bytes in hexadecimal.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02X}");
        text
    })
}
