//! The CAN card of a bus before a run: sets its bit rate on request, and otherwise compares it with the cell's.

use anyhow::bail;
use can::card::{self, Card, CardError, CardState};

use crate::bench::bus_port::bitrate;
use crate::bench::interfaces::Interface;
use crate::cell::Bus;

/// Ensures that the card of `bus` has the cell's bit rate: sets the bit rate, or refuses a different one.
///
/// An slcan adapter is set whenever it is opened, and a virtual interface has no bit rate to compare.
pub(super) fn prepare(interface: &Interface, bus: &Bus, set: bool) -> anyhow::Result<()> {
    let Interface::SocketCan(name) = interface else {
        return Ok(());
    };
    let kbps = bus.bitrate_kbps;
    if set {
        let card = card::set_bitrate(name, bitrate(kbps)?)?;
        let described = described(&card);
        crate::streams::warn(format_args!("bus {}: {name} {described}", bus.name));
        return Ok(());
    }
    let card = match card::read(name) {
        Err(CardError::NotCard(_)) => return Ok(()),
        card => card?,
    };
    match card.bitrate {
        Some(found) if u64::from(found) != u64::from(kbps) * 1000 => bail!(
            "{name}: the card is at {} kbit/s, the cell's bus at {kbps} kbit/s: --set-bitrate sets it",
            f64::from(found) / 1000.0
        ),
        _ if card.state == CardState::BusOff => bail!(
            "{name}: the card is off the bus after too many errors: mend the bus, then \
             `ip link set {name} type can restart`"
        ),
        _ => Ok(()),
    }
}

/// Description of the settings that were read back.
fn described(card: &Card) -> String {
    let state = match card.state {
        CardState::Running => "running",
        CardState::BusOff => "bus-off",
        CardState::Stopped => "stopped",
    };
    format!(
        "is {state} at {} kbit/s, sample point {} %",
        f64::from(card.bitrate.unwrap_or(0)) / 1000.0,
        f64::from(card.sample_point.unwrap_or(0)) / 10.0
    )
}
