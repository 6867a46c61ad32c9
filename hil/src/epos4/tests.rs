//! A host that speaks to one device byte by byte.

mod communication;
mod configuration;
mod data_sheet;
mod emergencies;
mod error_clearing;
mod heartbeats;
mod motion;
mod process_data;
mod scene;
mod standstill;
mod storage;

use std::time::Duration;

use canopen::NodeId;

use super::*;
use crate::{AxisConfig, DeviceId, HomingDeviation, Irp6Axis, World};
use can::timing::Bitrate;
use can::{Port, Received, StandardId, VirtualPort};

/// A host with node 2 as the only device, on a bus of 1 Mbit/s.
struct Bench {
    world: World,
    port: VirtualPort,
    device: DeviceId,
    now: Instant,
}

fn parse(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> =
        (0..data.len() / 2).map(|at| u8::from_str_radix(&data[2 * at..2 * at + 2], 16).unwrap()).collect();
    Frame::new(StandardId::new(u16::from_str_radix(id, 16).unwrap()).unwrap(), &bytes).unwrap()
}

fn config() -> Epos4Config {
    let axis = AxisConfig::wut(Irp6Axis::ALL[0]);
    Epos4Config::new(NodeId::new(2).unwrap(), axis)
}

impl Bench {
    /// A device after power-on, before its boot-up frame.
    fn new(config: Epos4Config) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let device = world.add_device(bus, Box::new(Epos4::new(config)));
        Self { world, port, device, now: Instant::ZERO }
    }

    /// A booted device, with its boot-up frame already read.
    fn booted(config: Epos4Config) -> Self {
        let mut bench = Self::new(config);
        assert_eq!(bench.run(60), ["702#00"]);
        bench
    }

    /// Advances time and returns the frames of the device.
    fn run(&mut self, millis: u64) -> Vec<String> {
        self.run_micros(millis * 1000).into_iter().map(|received| received.frame.to_string()).collect()
    }

    fn run_micros(&mut self, micros: u64) -> Vec<Received> {
        self.now += Duration::from_micros(micros);
        self.world.advance(self.now);
        let mut into = [Received { frame: parse("000#"), at: Instant::ZERO }; 256];
        let count = self.port.receive(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// Sends a frame and returns the device's answers within 5 ms.
    fn say(&mut self, text: &str) -> Vec<String> {
        self.port.send(self.now, &[parse(text)]).unwrap();
        self.run(5)
    }

    /// Sends an SDO request and returns its answer, payloads only.
    fn ask(&mut self, request: &str) -> String {
        let answers = self.say(&format!("602#{request}"));
        let answer = answers.iter().find_map(|answer| answer.strip_prefix("582#"));
        answer.unwrap_or("nothing").to_owned()
    }

    /// Writes an object. Address and bytes are given as on the wire.
    fn write(&mut self, object: &str, value: i64, bytes: usize) {
        let specifier = 0x23 | (4 - bytes as u8) << 2;
        let data: String = value.to_le_bytes()[..4]
            .iter()
            .enumerate()
            .map(|(at, byte)| format!("{:02X}", if at < bytes { *byte } else { 0 }))
            .collect();
        let answer = self.ask(&format!("{specifier:02X}{object}{data}"));
        assert_eq!(answer, format!("60{object}00000000"), "writing {object}");
    }

    fn read(&mut self, object: &str) -> i32 {
        let answer = self.ask(&format!("40{object}00000000"));
        assert!(answer.starts_with('4'), "{object}: {answer}");
        let byte = |at: usize| u8::from_str_radix(&answer[8 + 2 * at..10 + 2 * at], 16).unwrap();
        i32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)])
    }

    /// Writes the factory values, independent of the stored values.
    fn write_factory_values(&mut self) {
        self.say("000#8002");
        self.say("000#8102");
        self.run(60);
        self.write("111001", 0x6461_6F6C, 4);
        self.say("000#8102");
        self.run(60);
    }

    /// The abort code of a refused write, or zero for an accepted write.
    fn refusal(&mut self, object: &str, value: u32, bytes: usize) -> u32 {
        let specifier = 0x23 | (4 - bytes as u8) << 2;
        let data: String = value.to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
        let answer = self.ask(&format!("{specifier:02X}{object}{data}"));
        if answer == format!("60{object}00000000") {
            return 0;
        }
        assert_eq!(answer[..8], format!("80{object}"), "{answer}");
        u32::from_str_radix(&answer[8..], 16).unwrap().swap_bytes()
    }

    fn statusword(&mut self) -> u16 {
        self.read("416000") as u16
    }

    /// Brings the drive to operation enabled in a mode.
    fn enable(&mut self, mode: i8) {
        self.write("606000", i64::from(mode), 1);
        for word in [0x06, 0x07, 0x0F] {
            self.write("406000", word, 2);
        }
        assert_eq!(self.statusword() & 0x6F, 0x27);
    }

    /// Follows `target` in CSP for `cycles` of 2 ms with RPDO3 and SYNC. Returns the answers.
    fn follow(&mut self, cycles: u32, mut target: impl FnMut(u32) -> i32) -> Vec<String> {
        let mut heard = Vec::new();
        for cycle in 0..cycles {
            let bytes: String = target(cycle).to_le_bytes().iter().map(|byte| format!("{byte:02X}")).collect();
            let batch = [parse("080#"), parse(&format!("402#0F00{bytes}"))];
            self.port.send(self.now, &batch).unwrap();
            heard.extend(self.run(2));
        }
        heard
    }

    /// Cyclic exchange by SYNC: RPDO3 {6040, 607A}, TPDO3 {6041, 6064}; operational and enabled.
    fn cyclic(&mut self) {
        self.write("001401", 0x8000_0202, 4);
        self.write("001801", 0xC000_0182, 4);
        self.write("021402", 1, 1);
        self.write("021401", 0x0000_0402, 4);
        self.write("021802", 1, 1);
        self.write("021803", 0, 2);
        self.write("021801", 0x4000_0382, 4);
        self.write("C26001", 2, 1);
        self.enable(8);
        assert_eq!(self.say("000#0102"), [""; 0]);
    }
}
