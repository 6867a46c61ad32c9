//! Bit rate and state of a CAN card, read and set through netlink, as `ip link set can0 type can` does.
//!
//! For set-up only: the functions make system calls and allocate. The kernel answers at once. Read [`set_bitrate`]
//! first; [`change`] is what a person would do with `ip`.

use socketcan::nl::CanState;
use socketcan::{CanInterface, Error, NlError};
use thiserror::Error;

use crate::timing::Bitrate;
use crate::{InterfaceName, OpenError, socketcan::find};

/// What a card says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Card {
    /// Whether the interface is up (IFF_UP). An interface that is up has a bit rate.
    pub up: bool,
    /// Bit rate, bit/s; `None` if it was never set.
    pub bitrate: Option<u32>,
    /// Where in the bit it samples, tenths of a percent.
    pub sample_point: Option<u32>,
    /// What its controller does.
    pub state: CardState,
    /// Delay of the automatic restart after bus-off, ms; 0 disables the restart.
    pub restart_ms: u32,
}

/// What the controller of a card does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CardState {
    /// Error-active, error-warning or error-passive: the controller takes part in the traffic.
    Running,
    /// Nothing, until it is restarted: there were too many errors.
    BusOff,
    /// Nothing: it is down or asleep.
    Stopped,
}

/// Why a card could not be read or set, and what to do about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum CardError {
    #[error(transparent)]
    Interface(#[from] OpenError),
    #[error("{0}: no CAN card: a virtual interface has no bit rate")]
    NotCard(InterfaceName),
    #[error(
        "{interface}: setting the bit rate needs CAP_NET_ADMIN: run as root, or run `ip link set {interface} down` and \
         `ip link set {interface} up type can bitrate {bitrate}` before"
    )]
    Denied { interface: InterfaceName, bitrate: u32 },
    /// The card's clock cannot be divided to this rate.
    #[error("{interface}: the card cannot be set to {bitrate} bit/s")]
    Unreachable { interface: InterfaceName, bitrate: u32 },
    #[error("{0}: the card does not come up: `dmesg` may say why")]
    StaysDown(InterfaceName),
    #[error("{interface}: set to {wanted} bit/s, the card is at {found} bit/s")]
    Otherwise { interface: InterfaceName, wanted: u32, found: u32 },
    #[error(
        "{0}: the kernel refuses, and its reason is lost: CAP_NET_ADMIN is missing, no bit rate was set before the \
         interface came up, or the card cannot reach this rate"
    )]
    Refused(InterfaceName),
    #[error("{interface}: netlink says errno {errno}")]
    Os { interface: InterfaceName, errno: i32 },
}

/// Reads what the card `interface` is set to.
pub fn read(interface: &str) -> Result<Card, CardError> {
    let name = find(interface)?;
    let link = open(name)?;
    read_link(name, &link)
}

/// Sets the card `interface` to `bitrate`, brings it up, and returns what it then says of itself.
///
/// An interface that is up at this rate and takes part in the traffic is left unchanged. An interface at another rate
/// or in bus-off is taken down first, which ends the traffic of its other users. If the kernel refuses the new rate, an
/// interface that was up comes up again at its old rate. If the card settles on another rate, the interface stays up at
/// that rate.
pub fn set_bitrate(interface: &str, bitrate: Bitrate) -> Result<Card, CardError> {
    let name = find(interface)?;
    let wanted = bitrate.kbps() * 1000;
    let link = open(name)?;
    let before = read_link(name, &link)?;
    if before.up && before.bitrate == Some(wanted) && before.state == CardState::Running {
        return Ok(before);
    }
    let to = Change { timing: Some((wanted, None)), up: Some(true), ..Change::default() };
    // `socketcan` does not pass on the kernel's reason. The refused step tells the reason: a process that may take an
    // interface down may do the other steps as well.
    make(&link, &to, before.up).map_err(|(step, error)| match (errno(&error), step) {
        (Some(errno), _) => os(name, errno),
        (None, Step::Down) => CardError::Denied { interface: name, bitrate: wanted },
        (None, Step::Set) => CardError::Unreachable { interface: name, bitrate: wanted },
        (None, Step::Up) => CardError::StaysDown(name),
    })?;
    let after = read_link(name, &link)?;
    match after.bitrate {
        Some(found) if found == wanted => Ok(after),
        found => Err(CardError::Otherwise { interface: name, wanted, found: found.unwrap_or(0) }),
    }
}

/// Whether `interface`, a card or a virtual one, is up.
pub fn is_up(interface: &str) -> Result<bool, CardError> {
    let name = find(interface)?;
    let details = open(name)?.details();
    Ok(details.map_err(|error| unread(name, &error))?.is_up)
}

/// What is to be changed of an interface; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Change {
    /// Bit rate, bit/s, and sample point, tenths of a percent; the kernel chooses
    /// the sample point if there is none or if the value is 1000 or more.
    pub timing: Option<(u32, Option<u32>)>,
    /// Time from bus-off to the restart, ms; zero for never.
    pub restart_ms: Option<u32>,
    /// Whether it is up afterwards.
    pub up: Option<bool>,
}

/// Changes `interface`, a card or, for `up` alone, a virtual one.
///
/// The interface is down while its timing or restart time changes, and its users lose the bus for that time.
pub fn change(interface: &str, change: &Change) -> Result<(), CardError> {
    let name = find(interface)?;
    let link = open(name)?;
    if let Some((bitrate, _)) = change.timing
        && !(1..=1_000_000).contains(&bitrate)
    {
        return Err(CardError::Unreachable { interface: name, bitrate });
    }
    let was_up = link.details().map_err(|error| unread(name, &error))?.is_up;
    let on_card = change.timing.is_some() || change.restart_ms.is_some();
    if on_card {
        read_link(name, &link)?;
    }
    make(&link, change, was_up)
        .map_err(|(_, error)| errno(&error).map_or(CardError::Refused(name), |errno| os(name, errno)))
}

#[derive(Clone, Copy)]
enum Step {
    Down,
    Set,
    Up,
}

/// Does each step of `change`, and says which one failed. What was up comes up again whatever failed.
fn make(link: &CanInterface, change: &Change, was_up: bool) -> Result<(), (Step, Error)> {
    let steps = || {
        let on_card = change.timing.is_some() || change.restart_ms.is_some();
        if on_card || change.up == Some(false) {
            link.bring_down().map_err(|error| (Step::Down, error))?;
        }
        if let Some((bitrate, sample_point)) = change.timing {
            link.set_bitrate(bitrate, sample_point.filter(|&point| point < 1000))
                .map_err(|error| (Step::Set, error))?;
        }
        if let Some(restart_ms) = change.restart_ms {
            link.set_restart_ms(restart_ms).map_err(|error| (Step::Set, error))?;
        }
        Ok(())
    };
    let made = steps();
    let up = match (change.up, &made) {
        (Some(true), Ok(())) => true,
        (Some(false), _) => false,
        _ => was_up,
    };
    if up {
        let up = link.bring_up().map_err(|error| (Step::Up, error));
        return made.and(up);
    }
    made
}

fn open(interface: InterfaceName) -> Result<CanInterface, CardError> {
    CanInterface::open(interface.as_str()).map_err(|error| unread(interface, &error))
}

fn unread(interface: InterfaceName, error: &Error) -> CardError {
    os(interface, errno(error).unwrap_or(libc::EIO))
}

fn read_link(interface: InterfaceName, link: &CanInterface) -> Result<Card, CardError> {
    let details = link.details().map_err(|error| unread(interface, &error))?;
    let timing = details.can.bit_timing.filter(|timing| timing.bitrate > 0);
    Ok(Card {
        up: details.is_up,
        bitrate: timing.map(|timing| timing.bitrate),
        sample_point: timing.map(|timing| timing.sample_point),
        // Every card's driver says it, and no virtual interface does.
        state: match details.can.state.ok_or(CardError::NotCard(interface))? {
            CanState::ErrorActive | CanState::ErrorWarning | CanState::ErrorPassive => CardState::Running,
            CanState::BusOff => CardState::BusOff,
            CanState::Stopped | CanState::Sleeping => CardState::Stopped,
        },
        restart_ms: details.can.restart_ms.unwrap_or(0),
    })
}

/// What the operating system said, if that came through.
fn errno(error: &Error) -> Option<i32> {
    match error {
        Error::Io(error) => error.raw_os_error(),
        Error::Nl(NlError::Netlink { errno }) => Some(*errno),
        _ => None,
    }
}

fn os(interface: InterfaceName, errno: i32) -> CardError {
    CardError::Os { interface, errno }
}
