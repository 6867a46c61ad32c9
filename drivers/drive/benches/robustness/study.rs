//! A motor in full swing whose answers are damaged on the line, and the positions that its host believes.
//!
//! The drive is built from the layouts of the telegrams alone. The drive answers every write with a sample of its
//! motion, which depends on time alone. Requests arrive undamaged, because a host cannot see the effect of a
//! damaged request.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use mrroc_drive::axis_controller::{AxisConfig, AxisControllerGroup, Control, GroupConfig, Protocol};
use mrroc_drive::{AxisCommand, AxisState, DriveGroup, Increments, Scale};
use serial::nfv2::{Answer, Command, Frame, FrameBuilder, START, Status};
use serial::{Line, LineCounters, LineError, hi_moxa};

const PERIOD: Duration = Duration::from_millis(2);
const COUNTS: i32 = 4_000;
/// Plausibility bound, rad/s. The motion reaches four fifths of it.
const MAX_VELOCITY: f64 = 100.0;
/// Cycles of one swing back and forth.
const SWING: f64 = 200.0;

/// Kind of damage to the answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Damage {
    /// Every bit is inverted with this probability.
    BitErrors(f64),
    /// Every seventh answer is truncated, at each length in turn. In every other case, the rest arrives with the next
    /// answer.
    Torn,
    /// Up to 24 random bytes are inserted before, in or behind every fifth answer.
    Surplus,
    /// For up to 20 of 40 cycles, the line repeats one byte.
    Stuck,
    /// For up to 20 of 40 cycles, an answer consists of random bytes.
    Noise,
    /// For up to 20 of 40 cycles, the last answer before them is repeated.
    Repeated,
    /// Every seventh answer arrives together with the next one.
    Late,
}

/// Result of a run.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tally {
    pub(crate) cycles: u64,
    /// Cycles with damage.
    pub(crate) damaged: u64,
    /// Cycles with an accepted answer.
    pub(crate) accepted: u64,
    /// Accepted answers with a position other than the one sent.
    pub(crate) wrong_positions: u64,
    /// Greatest error of an accepted position, increments.
    pub(crate) greatest_error: u32,
    /// Accepted positions that the motor cannot have reached since the last accepted position.
    pub(crate) beyond_reach: u64,
    /// Most undamaged answers after a damaged answer until an answer was found in the byte stream.
    pub(crate) frames_to_find: u32,
    /// Most undamaged answers after a damaged answer until an answer was accepted.
    pub(crate) frames_to_believe: u32,
    /// Number of faults that stopped the axis.
    pub(crate) faults: u64,
}

struct World {
    protocol: Protocol,
    damage: Option<Damage>,
    random: Random,
    cycle: u64,
    outbox: VecDeque<u8>,
    /// Position in the last answer, before any damage.
    position: i32,
    damaged: bool,
    /// Cycles until the end of this burst or the start of the next.
    burst: u32,
    in_burst: bool,
    stuck: u8,
    before: Vec<u8>,
    torn_at: usize,
    rest: Vec<u8>,
    bits_to_error: u64,
}

/// xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, bound: u32) -> u32 {
        (((self.next() >> 32) * u64::from(bound)) >> 32) as u32
    }

    fn byte(&mut self) -> u8 {
        (self.next() >> 56) as u8
    }

    /// Number of bits until the next error.
    fn gap(&mut self, rate: f64) -> u64 {
        let uniform = ((self.next() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        (uniform.ln() / (-rate).ln_1p()) as u64
    }
}

impl World {
    fn motion(&self) -> (i32, i16) {
        let phase = self.cycle as f64 * TAU / SWING;
        let counts = MAX_VELOCITY * 0.8 * f64::from(COUNTS) / TAU * PERIOD.as_secs_f64();
        let swing = counts * SWING / TAU;
        let position = 100_000.0 + swing * phase.sin();
        (position.round() as i32, (phase.cos() * 9_000.0) as i16)
    }

    fn answer(&mut self, request: &[u8]) {
        let (position, current) = self.motion();
        self.position = position;
        let switch = if self.cycle % 64 < 10 { Status::HOME_SWITCH } else { 0 };
        let mut bytes = match self.protocol {
            Protocol::Nfv2 => {
                let start = request.iter().position(|byte| *byte == START).expect("requests arrive undamaged");
                let frame = Frame::parse(&request[start..]).expect("requests arrive undamaged");
                let mut answer = FrameBuilder::new(8);
                for command in frame.commands().flatten() {
                    match command {
                        Command::ReadPosition => _ = answer.answer(Answer::Position(position)),
                        Command::ReadCurrent => _ = answer.answer(Answer::Current(current)),
                        Command::ReadStatus => {
                            answer.answer(Answer::Status(Status(switch | Status::SYNCHRONIZED)));
                        }
                        _ => {}
                    }
                }
                answer.finish().expect("every request asks for a position").to_vec()
            }
            Protocol::HiMoxa => hi_moxa::Answer {
                start: 0x2A,
                flags: hi_moxa::Flags(switch as u8 | hi_moxa::Flags::SYNCHRONIZED),
                current,
                position,
            }
            .encode()
            .to_vec(),
        };
        self.damaged = !self.rest.is_empty();
        self.outbox.extend(self.rest.drain(..));
        if let Some(damage) = self.damage {
            self.damaged |= self.apply(damage, &mut bytes);
        }
        self.outbox.extend(bytes);
    }

    /// Damages `bytes`, and returns whether any byte was affected.
    fn apply(&mut self, damage: Damage, bytes: &mut Vec<u8>) -> bool {
        match damage {
            Damage::BitErrors(rate) => {
                let length = bytes.len() as u64 * 8;
                let mut hit = false;
                while self.bits_to_error < length {
                    let bit = self.bits_to_error;
                    bytes[(bit / 8) as usize] ^= 1 << (bit % 8);
                    self.bits_to_error += 1 + self.random.gap(rate);
                    hit = true;
                }
                self.bits_to_error -= length;
                hit
            }
            Damage::Torn if self.cycle.is_multiple_of(7) => {
                self.torn_at = (self.torn_at + 1) % (2 * bytes.len());
                let rest = bytes.split_off(self.torn_at / 2);
                if self.torn_at % 2 == 1 {
                    self.rest = rest;
                }
                true
            }
            Damage::Late if self.cycle.is_multiple_of(7) => {
                self.rest = std::mem::take(bytes);
                true
            }
            Damage::Surplus if self.cycle.is_multiple_of(5) => {
                let at = self.random.below(bytes.len() as u32 + 1) as usize;
                let count = 1 + self.random.below(24);
                let anything: Vec<u8> = (0..count).map(|_| self.random.byte()).collect();
                bytes.splice(at..at, anything);
                true
            }
            Damage::Torn | Damage::Late | Damage::Surplus => false,
            Damage::Stuck | Damage::Noise | Damage::Repeated => {
                if self.burst == 0 {
                    self.in_burst = !self.in_burst;
                    self.burst = 1 + self.random.below(20);
                    self.stuck = [0x00, 0xFF, 0x23, 0x55, self.random.byte()][self.random.below(5) as usize];
                }
                self.burst -= 1;
                if !self.in_burst {
                    self.before.clone_from(bytes);
                    return false;
                }
                match damage {
                    Damage::Stuck => {
                        // The bytes of 2 ms on a line without gaps, or the length of an answer.
                        let count = if self.stuck == 0x55 { 167 } else { bytes.len() };
                        *bytes = vec![self.stuck; count];
                    }
                    Damage::Noise => bytes.fill_with(|| self.random.byte()),
                    _ => bytes.clone_from(&self.before),
                }
                true
            }
        }
    }
}

struct Channel(Arc<Mutex<World>>);

impl Line for Channel {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut world = self.0.lock().expect("one thread has it");
        world.cycle = now.as_nanos() / PERIOD.as_nanos() as u64;
        world.answer(bytes);
        Ok(bytes.len())
    }

    fn read(&mut self, _now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let mut world = self.0.lock().expect("one thread has it");
        let count = into.len().min(world.outbox.len());
        into.iter_mut().zip(world.outbox.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}

/// Runs one axis for the given number of cycles.
pub(crate) fn run(protocol: Protocol, damage: Damage, cycles: u64, seed: u64) -> Tally {
    let mut random = Random(seed | 1);
    let bits_to_error = match damage {
        Damage::BitErrors(rate) => random.gap(rate),
        _ => 0,
    };
    let world = Arc::new(Mutex::new(World {
        protocol,
        damage: None,
        random,
        cycle: 0,
        outbox: VecDeque::with_capacity(4_096),
        position: 0,
        damaged: false,
        burst: 0,
        in_burst: true,
        stuck: 0,
        before: Vec::new(),
        torn_at: 0,
        rest: Vec::new(),
        bits_to_error,
    }));
    let axis = AxisConfig {
        address: 8,
        scale: Scale::new(COUNTS, 0.0).expect("counts are not zero"),
        torque_constant: 0.105,
        control: Control::Pwm,
        max_current: 15.0,
        max_velocity: MAX_VELOCITY,
        max_acceleration: 10_000.0,
    };
    let config = GroupConfig { tolerated_missing: u32::MAX, ..GroupConfig::new(protocol) };
    let mut group = AxisControllerGroup::new(vec![Channel(Arc::clone(&world))], config, &[axis])
        .expect("the configuration is right");
    let mut now = Instant::ZERO;
    let mut tally = Tally::default();
    let mut up = false;
    let mut last: Option<(Increments, u32)> = None;
    let mut undamaged: u32 = 0;
    let (mut to_find, mut to_believe, mut found_before) = (false, false, 0);
    let mut stray = false;
    while tally.cycles < cycles {
        now += PERIOD;
        if !up {
            world.lock().expect("one thread has it").damage = None;
            match group.bring_up(now) {
                Poll::Pending => {}
                Poll::Ready(result) => {
                    result.expect("nothing is damaged during bring-up");
                    (up, last, stray) = (true, None, true);
                    (to_find, to_believe) = (false, false);
                    world.lock().expect("one thread has it").damage = Some(damage);
                }
            }
            continue;
        }
        let (sent, damaged) = {
            let world = world.lock().expect("one thread has it");
            (world.position, world.damaged)
        };
        let mut states = [AxisState::default()];
        group.read(now, &mut states);
        group.write(now, &[AxisCommand::Stand]);
        group.send(now);
        let [state] = states;
        // The first answers belong to earlier requests.
        if std::mem::take(&mut stray) {
            continue;
        }
        tally.cycles += 1;
        tally.damaged += u64::from(damaged);
        if state.fault.is_some() {
            tally.faults += 1;
            up = false;
            continue;
        }
        if state.age == 0 {
            tally.accepted += 1;
            let error = state.increments.0.wrapping_sub(sent).unsigned_abs();
            tally.wrong_positions += u64::from(error > 0);
            tally.greatest_error = tally.greatest_error.max(error);
            if let Some((before, ages)) = last {
                let moved = f64::from(state.increments.0.wrapping_sub(before.0)).abs();
                let cycles = f64::from(ages) + 1.25;
                let reach = MAX_VELOCITY * f64::from(COUNTS) / TAU * PERIOD.as_secs_f64() * cycles;
                tally.beyond_reach += u64::from(moved > reach + 1.0);
            }
            last = Some((state.increments, 0));
        } else if let Some((_, ages)) = &mut last {
            *ages += 1;
        }
        let counters = group.axis_counters().next().expect("there is one axis");
        let found = counters.accepted + counters.implausible;
        if damaged {
            undamaged = 0;
            (to_find, to_believe) = (true, true);
        } else {
            undamaged += 1;
            if to_find && found > found_before {
                tally.frames_to_find = undamaged.max(tally.frames_to_find);
                to_find = false;
            }
            if to_believe && state.age == 0 {
                tally.frames_to_believe = undamaged.max(tally.frames_to_believe);
                to_believe = false;
            }
        }
        found_before = found;
    }
    tally
}

/// All kinds of damage in the study, and their names.
pub(crate) const DAMAGES: [(&str, Damage); 11] = [
    ("bit errors 1e-6", Damage::BitErrors(1e-6)),
    ("bit errors 1e-5", Damage::BitErrors(1e-5)),
    ("bit errors 1e-4", Damage::BitErrors(1e-4)),
    ("bit errors 1e-3", Damage::BitErrors(1e-3)),
    ("bit errors 1e-2", Damage::BitErrors(1e-2)),
    ("torn", Damage::Torn),
    ("late", Damage::Late),
    ("surplus bytes", Damage::Surplus),
    ("stuck line", Damage::Stuck),
    ("noise", Damage::Noise),
    ("repeated answers", Damage::Repeated),
];
