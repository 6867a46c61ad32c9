//! What a run runs on: the ports to the drives, and the emulated world behind them where there is one.

use anyhow::{Context, bail};
use can::{Port, SocketCanOptions, TraceReader, Tracer};
use clap::ValueEnum;
use drive::cia402;

use crate::bus_port::BusPort;
use crate::cell_file::CellFile;
use crate::emulation::Emulation;
use crate::interfaces::{self, Interface};

/// Frames that a trace may lag behind the bus: some seconds of a full one.
const TRACE: usize = 1 << 16;

/// The benches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BenchKind {
    /// Emulated drives on a virtual bus, in virtual time.
    Lockstep,
    /// Emulated drives on a virtual bus, by the wall clock.
    Emulated,
    /// SocketCAN on a virtual interface; `mrroc emulate` at its other end.
    Vcan,
    /// SocketCAN on a card. Moves hardware.
    Card,
}

impl BenchKind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Lockstep => "lockstep",
            Self::Emulated => "emulated",
            Self::Vcan => "vcan",
            Self::Card => "card",
        }
    }
}

/// An opened bench.
pub(crate) struct Bench {
    /// One per bus of the cell.
    pub(crate) ports: Vec<Box<dyn Port>>,
    /// What each of them is on: the cell's interface, or the one given in its place.
    pub(crate) interfaces: Vec<Interface>,
    /// What passed each port, if a trace was asked for.
    pub(crate) traces: Vec<TraceReader>,
    /// The emulated cell, on the benches without hardware.
    pub(crate) emulation: Option<Emulation>,
}

impl Bench {
    /// Opens the bench `kind` for a cell.
    pub(crate) fn open(
        file: &CellFile,
        kind: BenchKind,
        can: &[String],
        trace: bool,
    ) -> anyhow::Result<Self> {
        let interfaces = interfaces::resolve(&file.cell, can)?;
        let (ports, emulation): (Vec<Box<dyn Port>>, _) = match kind {
            BenchKind::Lockstep | BenchKind::Emulated => {
                if !can.is_empty() {
                    bail!("--can needs --bench vcan or --bench card");
                }
                let (emulation, ports) = Emulation::of(file);
                (
                    ports.into_iter().map(|port| Box::new(port) as _).collect(),
                    Some(emulation),
                )
            }
            BenchKind::Vcan | BenchKind::Card => {
                let open = |(index, interface): (usize, &Interface)| {
                    let bus = &file.cell.bus[index];
                    let setpoints = file.cell.axes_on(index).count();
                    let options = SocketCanOptions {
                        send_queue: setpoints + cia402::BESIDE_SETPOINTS,
                        ..SocketCanOptions::default()
                    };
                    let port = BusPort::with_options(interface, bus.bitrate_kbps, &options);
                    Ok(Box::new(port.with_context(|| format!("bus {}", bus.name))?) as _)
                };
                (
                    interfaces
                        .iter()
                        .enumerate()
                        .map(open)
                        .collect::<anyhow::Result<_>>()?,
                    None,
                )
            }
        };
        if !trace {
            return Ok(Self {
                ports,
                interfaces,
                traces: Vec::new(),
                emulation,
            });
        }
        let traced = ports.into_iter().map(|port| {
            let (port, reader) = Tracer::new(port, TRACE);
            (Box::new(port) as _, reader)
        });
        let (ports, traces) = traced.unzip();
        Ok(Self {
            ports,
            interfaces,
            traces,
            emulation,
        })
    }
}
