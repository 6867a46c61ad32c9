//! A host that speaks to one module byte by byte.

mod dictionary;
mod inputs;
mod outputs;
mod process_data;

use std::time::Duration;

use can::timing::Bitrate;
use can::{Port, Received, StandardId, VirtualPort};
use canopen::NodeId;

use super::*;
use crate::{BusId, DeviceId, World};

/// A host with node 5 on a bus of 1 Mbit/s.
struct Bench {
    world: World,
    bus: BusId,
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

fn config() -> DigitalIoConfig {
    DigitalIoConfig::new(NodeId::new(5).unwrap())
}

impl Bench {
    /// A module after power-on, before its boot-up frame.
    fn new(config: DigitalIoConfig) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let device = world.add_device(bus, Box::new(DigitalIo::new(config).unwrap()));
        Self { world, bus, port, device, now: Instant::ZERO }
    }

    /// A booted module, with its boot-up frame already read.
    fn booted(config: DigitalIoConfig) -> Self {
        let mut bench = Self::new(config);
        assert_eq!(bench.run(60), ["705#00"]);
        bench
    }

    /// An operational module, with its first TPDO already read.
    fn operational(config: DigitalIoConfig) -> Self {
        let mut bench = Self::booted(config);
        assert_eq!(bench.say("000#0105"), ["185#00"]);
        bench
    }

    /// Advances time and returns the frames of the module.
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

    fn send(&mut self, text: &str) {
        self.port.send(self.now, &[parse(text)]).unwrap();
    }

    /// Sends a frame and returns the answers within 5 ms.
    fn say(&mut self, text: &str) -> Vec<String> {
        self.send(text);
        self.run(5)
    }

    /// Sends an SDO request to a node and returns its answer, payload only.
    fn ask_node(&mut self, node: u8, request: &str) -> String {
        let answers = self.say(&format!("{:03X}#{request}", 0x600 + u16::from(node)));
        let id = format!("{:03X}#", 0x580 + u16::from(node));
        let answer = answers.iter().find_map(|answer| answer.strip_prefix(&id));
        answer.unwrap_or("nothing").to_owned()
    }

    fn ask(&mut self, request: &str) -> String {
        self.ask_node(5, request)
    }

    /// Writes an object of a node. Address and bytes are given as on the wire.
    fn write_node(&mut self, node: u8, object: &str, value: u32, bytes: usize) {
        let answer = self.ask_node(node, &download(object, value, bytes));
        assert_eq!(answer, format!("60{object}00000000"), "writing {object}");
    }

    fn write(&mut self, object: &str, value: u32, bytes: usize) {
        self.write_node(5, object, value, bytes);
    }

    fn read(&mut self, object: &str) -> u32 {
        let answer = self.ask(&format!("40{object}00000000"));
        assert!(answer.starts_with('4'), "{object}: {answer}");
        u32::from_str_radix(&answer[8..], 16).unwrap().swap_bytes()
    }

    /// Sets parameters of the first TPDO: transmission type, inhibit time in units of 100 µs, event timer in ms.
    fn configure_tpdo(&mut self, kind: u32, inhibit: u32, timer: u32) {
        self.write("001801", 0xC000_0185, 4);
        self.write("001802", kind, 1);
        self.write("001803", inhibit, 2);
        self.write("001805", timer, 2);
        self.write("001801", 0x4000_0185, 4);
    }

    /// Schedules an edge of an input `micros` from now.
    fn edge(&mut self, micros: u64, index: u8, level: bool) {
        let at = self.now + Duration::from_micros(micros);
        let set = |module: &mut DigitalIo| module.set_input(at, index, level);
        self.world.change(self.device, self.now, set).unwrap().unwrap();
    }

    fn module(&self) -> &DigitalIo {
        self.world.device(self.device).unwrap()
    }

    fn outputs(&self) -> u64 {
        self.module().outputs()
    }
}

/// An expedited download.
fn download(object: &str, value: u32, bytes: usize) -> String {
    let specifier = 0x23 | (4 - bytes as u8) << 2;
    let data: String = value.to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    format!("{specifier:02X}{object}{data}")
}
