//! A drive and a force/torque sensor on a scripted bus.

use std::collections::BTreeMap;
use std::task::Poll;

pub(super) use std::time::Duration;

pub(super) use can::{ControllerState, Instant, PortError, StandardId};
pub(super) use canopen::Object;
pub(super) use canopen::pdo::PdoNumber;

pub(super) use crate::bus::{CanBus, Sign};
use crate::cia402::tests::bench::{BusEnd, Received, Store, answer, frame};
pub(super) use crate::cia402::tests::bench::{PERIOD, axis_config, group_config, node, setting};
pub(super) use crate::cia402::{self, Identity};
pub(super) use crate::wrench::*;
pub(super) use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, Fault};

/// Node-ID of the drive.
pub(super) const DRIVE: u8 = 2;
/// Node-ID of the sensor.
pub(super) const SENSOR: u8 = 9;

/// Counts per N, and per N·m.
pub(super) const COUNTS: [f64; 6] = [100.0, 100.0, 100.0, 1_000.0, 1_000.0, 1_000.0];

fn field(subindex: u8, content: Content) -> WrenchField {
    WrenchField { object: Object::new(0x2000, subindex), content }
}

/// Three forces, a counter and a status; three torques and the counter; in counts of 16 bits, at every SYNC.
pub(super) fn sensor_config() -> WrenchNodeConfig {
    let [fx, fy, fz, tx, ty, tz] = WrenchAxis::ALL.map(|axis| field(axis as u8 + 1, Content::I16(axis)));
    let counter = field(7, Content::Counter { bytes: 1 });
    let status = field(8, Content::Status { bytes: 1, errors: 0x0C });
    WrenchNodeConfig {
        node: node(SENSOR),
        identity: Some(Identity { vendor: 0x4711, product: Some(6), revision: None }),
        device_type: Some(0x0002_0194),
        sensor: WrenchConfig {
            channels: COUNTS.map(|counts| Channel { scale: 1.0 / counts, range: 20_000 }),
            tolerated_missing: 2,
            tolerated_saturated: 0,
            zero: ZeroMethod::Host { samples: 4 },
        },
        trigger: Trigger::Sync { every: 1 },
        pdos: vec![
            pdo(PdoNumber::One, 0x189, vec![fx, fy, fz, counter, status]),
            pdo(PdoNumber::Two, 0x289, vec![tx, ty, tz, counter]),
        ],
        configuration: Vec::new(),
    }
}

pub(super) fn pdo(number: PdoNumber, cob_id: u16, fields: Vec<WrenchField>) -> WrenchPdo {
    WrenchPdo { number, cob_id: StandardId::new(cob_id).unwrap(), fields, mapped: true }
}

/// The same sensor without counter and status.
pub(super) fn uncounted() -> WrenchNodeConfig {
    let mut config = sensor_config();
    for field in config.pdos.iter_mut().flat_map(|pdo| &mut pdo.fields) {
        if field.content.axis().is_none() {
            field.content = Content::Ignored { bytes: 1 };
        }
    }
    config
}

/// The same sensor with an event timer of this many milliseconds.
pub(super) fn timed(millis: u64) -> WrenchNodeConfig {
    WrenchNodeConfig { trigger: Trigger::EventTimer(Duration::from_millis(millis)), ..sensor_config() }
}

/// The service side of a sensor of CiA 404 with two TPDOs.
pub(super) fn sensor_store(raw: u8) -> Store {
    let mut objects = BTreeMap::new();
    let mut put = |index, subindex, bytes: &[u8]| objects.insert((index, subindex), bytes.to_vec());
    put(0x1000, 0, &[0x94, 0x01, 0x02, 0x00]);
    put(0x1017, 0, &[0; 2]);
    put(0x1018, 1, &[0x11, 0x47, 0, 0]);
    put(0x1018, 2, &[6, 0, 0, 0]);
    for index in [0x1800, 0x1801] {
        put(index, 1, &[0; 4]);
        put(index, 2, &[254]);
        put(index, 5, &[0; 2]);
    }
    for index in [0x1A00, 0x1A01] {
        put(index, 0, &[3]);
        (1..=5).for_each(|subindex| _ = put(index, subindex, &[0; 4]));
    }
    Store::of(raw, objects)
}

/// What the sensor sends.
pub(super) struct Sender {
    pub(super) load: [i16; 6],
    pub(super) counter: u8,
    /// Increase of the counter per sample.
    pub(super) step: u8,
    pub(super) status: u8,
    /// Every n-th SYNC. 0 sends nothing.
    pub(super) every: u32,
    /// Time between samples without SYNC.
    pub(super) timer: Option<Duration>,
    /// The second frame of a sample is left out.
    pub(super) halved: bool,
    /// The second frame of a sample is sent after the next SYNC.
    pub(super) straddling: bool,
    /// The second frame of the last sample.
    held: Option<String>,
    /// The frames of a sample in place of the two PDOs.
    pub(super) frames: Option<Vec<String>>,
    started: bool,
    syncs: u32,
    due: Instant,
}

impl Sender {
    fn sample(&mut self) -> Vec<String> {
        self.counter = self.counter.wrapping_add(self.step);
        if let Some(frames) = &self.frames {
            return frames.clone();
        }
        let hex = |counts: &[i16]| -> String {
            counts.iter().flat_map(|count| count.to_le_bytes()).map(|byte| format!("{byte:02X}")).collect()
        };
        let (forces, torques) = self.load.split_at(3);
        let mut frames = vec![format!("189#{}{:02X}{:02X}", hex(forces), self.counter, self.status)];
        if !self.halved {
            frames.push(format!("289#{}{:02X}", hex(torques), self.counter));
        }
        frames
    }
}

/// A bus with a drive and a sensor, and the service side of both.
pub(super) struct Bench {
    pub(super) bus: CanBus<BusEnd>,
    pub(super) link: WrenchLink,
    pub(super) end: BusEnd,
    pub(super) stores: Vec<Store>,
    pub(super) sender: Sender,
    pub(super) now: Instant,
    pub(super) states: Vec<AxisState>,
    seen: usize,
}

impl Bench {
    pub(super) fn down(config: &WrenchNodeConfig) -> Self {
        Self::of(config, &[axis_config(DRIVE)])
    }

    /// A bus with these drives.
    pub(super) fn of(config: &WrenchNodeConfig, axes: &[cia402::AxisConfig]) -> Self {
        let end = BusEnd::default();
        let (bus, _, mut links) =
            CanBus::with_sensors(end.clone(), group_config(), axes, &[], std::slice::from_ref(config)).unwrap();
        let drives = axes.iter().map(|axis| Store::epos4(axis.node.raw()));
        Self {
            bus,
            link: links.remove(0),
            end,
            stores: [sensor_store(SENSOR)].into_iter().chain(drives).collect(),
            sender: Sender {
                load: [0; 6],
                counter: 250,
                step: 1,
                status: 0,
                every: 1,
                timer: match config.trigger {
                    Trigger::Sync { .. } => None,
                    Trigger::EventTimer(timer) => Some(timer),
                },
                halved: false,
                straddling: false,
                held: None,
                frames: None,
                started: false,
                syncs: 0,
                due: Instant::ZERO,
            },
            now: Instant::ZERO,
            states: vec![AxisState::default(); axes.len()],
            seen: 0,
        }
    }

    pub(super) fn up() -> Self {
        Self::up_with(&sensor_config())
    }

    pub(super) fn up_with(config: &WrenchNodeConfig) -> Self {
        let mut bench = Self::down(config);
        assert_eq!(bench.bring_up(), Ok(()));
        bench
    }

    /// Runs bring-up to its end with one call per period.
    pub(super) fn bring_up(&mut self) -> Result<(), BringUpError> {
        for _ in 0..10_000 {
            if let Poll::Ready(result) = self.bus.bring_up(self.now) {
                self.serve();
                return result;
            }
            self.answer_syncs();
            self.serve();
            self.now += PERIOD;
        }
        panic!("bring-up did not end");
    }

    /// Lets the drives answer the SYNCs sent since the last call of [`serve`](Self::serve), as they do in bring-up.
    fn answer_syncs(&mut self) {
        let mut bus = self.end.0.lock().unwrap();
        let at = self.now + PERIOD / 2;
        let syncs = bus.sent[self.seen..].iter().filter(|sent| sent.to_string() == "080#").count();
        for store in (0..syncs).flat_map(|_| &self.stores[1..]) {
            let frame = frame(&answer(store.raw, 0x0740, 1_000));
            bus.inbox.push_back(Received { frame, at });
        }
    }

    /// Lets both nodes answer the frames sent since the last call, half a period after them.
    fn serve(&mut self) {
        let mut bus = self.end.0.lock().unwrap();
        let at = self.now + PERIOD / 2;
        for i in self.seen..bus.sent.len() {
            let sent = bus.sent[i];
            let replies = self.stores.iter_mut().filter_map(|store| store.handle(&sent));
            bus.inbox.extend(replies.map(|frame| Received { frame, at }));
            match sent.to_string().as_str() {
                "000#0109" => (self.sender.started, self.sender.due) = (true, at),
                "080#" if self.sender.started && self.sender.timer.is_none() && self.sender.every > 0 => {
                    self.sender.syncs += 1;
                    if self.sender.syncs.is_multiple_of(self.sender.every) {
                        let mut frames: Vec<_> = self.sender.held.take().into_iter().collect();
                        frames.extend(self.sender.sample());
                        if self.sender.straddling {
                            self.sender.held = frames.pop();
                        }
                        bus.inbox.extend(frames.iter().map(|text| Received { frame: frame(text), at }));
                    }
                }
                _ => {}
            }
        }
        while let Some(timer) = self.sender.timer.filter(|_| self.sender.started)
            && self.sender.due < self.now + PERIOD
        {
            let due = self.sender.due;
            let frames = self.sender.sample();
            let received = |(text, i): (&String, u32)| Received { frame: frame(text), at: due + i * FRAME };
            bus.inbox.extend(frames.iter().zip(0..).map(received));
            self.sender.due += timer;
        }
        self.seen = bus.sent.len();
    }

    /// One cycle, in which the drive has answered. Returns the state of the sensor.
    pub(super) fn cycle(&mut self) -> WrenchState {
        self.cycle_with(&[])
    }

    /// One cycle in which the bus also receives these frames, beside the frames of drive and sensor.
    pub(super) fn cycle_with(&mut self, frames: &[&str]) -> WrenchState {
        self.now += PERIOD;
        let at = self.now - PERIOD / 2;
        let drive = (!self.states.is_empty()).then(|| answer(DRIVE, 0x0740, 1_000));
        let frames = drive.as_deref().into_iter().chain(frames.iter().copied());
        self.end.0.lock().unwrap().inbox.extend(frames.map(|text| Received { frame: frame(text), at }));
        self.bus.read(self.now, &mut self.states);
        self.bus.write(self.now, &vec![AxisCommand::Off; self.states.len()]);
        self.bus.send(self.now);
        self.serve();
        let state = self.link.read();
        assert!(state.wrench.iter().all(|component| component.is_finite()));
        assert_eq!(state.at, self.now);
        state
    }

    pub(super) fn run(&mut self, cycles: usize) -> WrenchState {
        (0..cycles).map(|_| self.cycle()).last().unwrap_or_else(|| self.link.read())
    }

    /// The sensor sends nothing any more.
    pub(super) fn mute(&mut self) {
        (self.sender.every, self.sender.timer) = (0, None);
    }

    /// Runs until a cycle has a new sample.
    pub(super) fn run_to_sample(&mut self) {
        assert!((0..100).any(|_| self.cycle().age == 0), "no sample within 100 cycles");
    }

    /// Number of cycles until a fault, and the fault.
    pub(super) fn until_fault(&mut self) -> (usize, WrenchFault) {
        (1..5_000).find_map(|cycle| self.cycle().fault.map(|fault| (cycle, fault))).expect("a fault within 5000 cycles")
    }

    /// Time of the newest sample that a sensor with an event timer sent before `at`.
    pub(super) fn sender_time_before(&self, at: Instant) -> Instant {
        let timer = self.sender.timer.unwrap();
        let times = std::iter::successors(Some(self.sender.due), |time| Some(*time - timer));
        times.into_iter().find(|time| *time < at).unwrap()
    }

    pub(super) fn sent(&self) -> Vec<String> {
        self.end.0.lock().unwrap().sent.iter().map(ToString::to_string).collect()
    }
}

/// Time between two frames of the sensor.
pub(super) const FRAME: Duration = Duration::from_micros(130);

/// The components in N and N·m.
pub(super) fn scaled(load: [i16; 6]) -> [f64; 6] {
    std::array::from_fn(|axis| f64::from(load[axis]) / COUNTS[axis])
}

pub(super) fn close(found: [f64; 6], expected: [f64; 6]) -> bool {
    found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-9)
}
