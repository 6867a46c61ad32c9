//! Service ports of EPOS2 and EPOS4: the client with emulated drives, on a line in virtual time and on
//! pseudo-terminals.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;
use hil::epos4::Epos4Config;
use hil::{AxisConfig, EposSerial, EposSerialConfig, Irp6Axis, LineDevice, LineFaults, LineId, WireFaults, World};
use serial::epos4::Address;
use serial::service::{Client, Config, Dialect, Reply, ServiceError, StartError, TIME_OUT};
use serial::{Line, Settings, VirtualLine};

/// Step of the virtual time.
const TICK: Duration = Duration::from_micros(100);

/// Upper bound for the duration of every request.
const LONGEST: Duration = Duration::from_secs(8);

const DIALECTS: [Dialect; 2] = [Dialect::Epos2, Dialect::Epos4];

/// A drive on its line, and the host's end.
struct Stage {
    world: World,
    line: LineId,
    host: VirtualLine,
    client: Client,
    now: Instant,
    /// Time until which all bytes of the drive are discarded.
    deaf_until: Instant,
}

/// A reply as an owned value.
#[derive(Debug, PartialEq, Eq)]
enum Got {
    Value(u32),
    Object(Vec<u8>),
    Done,
}

impl Stage {
    fn new(dialect: Dialect) -> Self {
        let node = NodeId::new(1).unwrap();
        let axis = AxisConfig::irp6(Irp6Axis::ALL[0]);
        let mut config = EposSerialConfig::new(Epos4Config::new(node, axis));
        config.segment = 3;
        let device: Box<dyn LineDevice> = match dialect {
            Dialect::Epos2 => Box::new(EposSerial::epos2(config)),
            Dialect::Epos4 => Box::new(EposSerial::epos4(config)),
        };
        let mut world = World::new();
        let line = world.add_line(Settings::EPOS, None, device);
        let host = world.host_line(line, 4096);
        // The drive boots.
        let now = Instant::from_nanos(100_000_000);
        world.advance(now);
        Self {
            world,
            line,
            host,
            client: Client::new(Config::new(dialect, Settings::EPOS)),
            now,
            deaf_until: Instant::ZERO,
        }
    }

    /// Result of the request that `start` makes.
    fn ask(&mut self, start: impl FnOnce(&mut Client, Instant) -> Result<(), StartError>) -> Result<Got, ServiceError> {
        let began = self.now;
        start(&mut self.client, self.now).unwrap();
        loop {
            self.client.handle_timeout(self.now);
            let count = self.host.write(self.now, self.client.bytes()).unwrap();
            self.client.consume(count, self.now);
            if let Some(result) = self.client.poll() {
                return result.map(|reply| match reply {
                    Reply::Value(value) => Got::Value(value),
                    Reply::Object(object) => Got::Object(object.to_vec()),
                    Reply::Done => Got::Done,
                });
            }
            assert!(self.now.since(began) < LONGEST, "it does not end");
            self.now += TICK;
            self.world.advance(self.now);
            let mut bytes = [0; 256];
            let count = self.host.read(self.now, &mut bytes).unwrap();
            if self.now >= self.deaf_until {
                self.client.handle(&bytes[..count], self.now);
            }
        }
    }

    fn read(&mut self, index: u16) -> Result<Got, ServiceError> {
        self.ask(|client, now| client.read(object(index), now))
    }

    fn write(&mut self, index: u16, value: u32) -> Result<Got, ServiceError> {
        self.ask(|client, now| client.write(object(index), value, now))
    }
}

const fn object(index: u16) -> Address {
    Address { node: 1, index, subindex: 0 }
}

#[test]
fn both_drives_are_asked_and_told_over_their_service_port() {
    for dialect in DIALECTS {
        let mut stage = Stage::new(dialect);
        assert_eq!(stage.read(0x1000), Ok(Got::Value(0x0002_0192)), "{dialect:?}");
        assert_eq!(stage.write(0x6083, 4321), Ok(Got::Done));
        assert_eq!(stage.read(0x6083), Ok(Got::Value(4321)));
        let read_only = Err(ServiceError::Refused(0x0601_0002));
        assert_eq!(stage.write(0x6041, 0), read_only);
        let missing = Err(ServiceError::Refused(0x0602_0000));
        assert_eq!(stage.read(0x5FFF), missing);
        // In the state stopped, the drive refuses the request. The start command restores access.
        let told = stage.ask(|client, now| client.nmt(1, 0x02, now));
        assert_eq!(told, Ok(Got::Done));
        let refused = stage.read(0x6083);
        assert_eq!(refused, Err(ServiceError::Refused(0x0F00_FFC0)), "{dialect:?}");
        let told = stage.ask(|client, now| client.nmt(0, 0x01, now));
        assert_eq!(told, Ok(Got::Done));
        assert_eq!(stage.read(0x6083), Ok(Got::Value(4321)));
        assert!(stage.now < Instant::from_nanos(200_000_000), "no time-out");
    }
}

#[test]
fn a_name_comes_in_segments() {
    let mut stage = Stage::new(Dialect::Epos4);
    assert_eq!(stage.read(0x1008), Err(ServiceError::Refused(0x0607_0010)));
    let read = stage.ask(|client, now| client.read_segmented(object(0x1008), now));
    let Ok(Got::Object(name)) = read else {
        panic!("{read:?}");
    };
    assert_eq!(name, b"EPOS4");
    let write = stage.ask(|client, now| client.write_segmented(object(0x1008), b"other", now));
    assert_eq!(write, Err(ServiceError::Refused(0x0601_0002)));
    let value = 250_u32.to_le_bytes();
    let write = stage.ask(|client, now| client.write_segmented(object(0x6083), &value, now));
    assert_eq!(write, Ok(Got::Done));
    assert_eq!(stage.read(0x6083), Ok(Got::Value(250)));
}

#[test]
fn a_deaf_moment_costs_one_time_out_and_silence_two() {
    for dialect in DIALECTS {
        let mut stage = Stage::new(dialect);
        let began = stage.now;
        stage.deaf_until = began + Duration::from_millis(100);
        assert_eq!(stage.read(0x1000), Ok(Got::Value(0x0002_0192)), "{dialect:?}");
        let took = stage.now.since(began);
        assert!(took > TIME_OUT && took < 2 * TIME_OUT, "{took:?}");
        stage.deaf_until = Instant::FAR_FUTURE;
        let silent = stage.read(0x1000);
        assert!(matches!(silent, Err(ServiceError::TimedOut { .. })), "{silent:?}");
        stage.deaf_until = Instant::ZERO;
        assert_eq!(stage.read(0x1000), Ok(Got::Value(0x0002_0192)));
    }
}

#[test]
fn a_bad_line_costs_time_and_gives_no_wrong_value() {
    let bad = [
        WireFaults { bit_error_rate: 2e-4, ..WireFaults::default() },
        WireFaults { tear: 0.005, ..WireFaults::default() },
        WireFaults { duplicate: 0.01, ..WireFaults::default() },
    ];
    for dialect in DIALECTS {
        for (number, faults) in bad.into_iter().enumerate() {
            let mut stage = Stage::new(dialect);
            let line = LineFaults { seed: 7, to_device: faults, to_host: faults, ..LineFaults::default() };
            stage.world.line_mut(stage.line).set_faults(&line);
            let mut right = 0;
            // A write whose confirmation was lost may have been performed.
            let mut possible = vec![10_000];
            for value in 1000..1100 {
                if stage.write(0x6083, value) == Ok(Got::Done) {
                    possible.clear();
                }
                possible.push(value);
                match stage.read(0x6083) {
                    Ok(Got::Value(found)) => {
                        assert!(possible.contains(&found), "{found} of {possible:?}");
                        possible = vec![found];
                        right += 1;
                    }
                    Ok(other) => panic!("{other:?}"),
                    Err(_) => {}
                }
            }
            let statistics = stage.world.line(stage.line).statistics();
            let spoilt = statistics.corrupted + statistics.lost + statistics.duplicated;
            let case = format!("{dialect:?}, {number}: {right} of 100, {spoilt} spoilt");
            assert!(right >= 90 && spoilt > 5, "{case}");
        }
    }
}
