//! The claim of one process to a part that only one process may play on an interface, the controller of a bus for instance.
//!
//! A claim is a socket with an abstract name (unix(7)) that holds the interface's index and the part. The kernel gives a
//! name to one socket at a time and frees the name when the process ends, however the process ends. No file is made,
//! so that none is left behind and no link is followed. Abstract names belong to a network namespace, as interfaces do.
//!
//! A claim does not keep other programs off the interface, and another computer on the same bus does not see it. Any user
//! of this computer can take such a name; the part is then refused to every other process, and nothing else follows.
//! Read [`Claim::take`] first.

use std::fs;
use std::io;
use std::net::Shutdown;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use socketcan::CanAddr;
use thiserror::Error;

use crate::{InterfaceName, OpenError, socketcan::find};

/// A part on an interface that this process plays until the claim is dropped.
#[derive(Debug)]
pub struct Claim {
    _part: UnixDatagram,
    /// A second name that ends in our process ID, for the error of a later process.
    _holder: Option<UnixDatagram>,
}

/// Why a part could not be claimed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ClaimError {
    #[error(transparent)]
    Interface(#[from] OpenError),
    /// `holder` is the process ID in the holder's own namespace; `None` if the holder has ended or hides it.
    #[error("{interface}: in use by {}", Holder(*.holder))]
    Taken { interface: InterfaceName, holder: Option<u32> },
    #[error("{interface}: cannot be claimed: errno {errno}")]
    Os { interface: InterfaceName, errno: i32 },
}

/// A process that plays a part; without its ID where the process hides it or ended meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Holder(Option<u32>);

impl Holder {
    /// The process ID in the holder's own namespace; `None` if the holder has ended or hides it.
    pub fn process(self) -> Option<u32> {
        self.0
    }
}

/// As `process 4711`, or `another process`.
impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(process) => write!(f, "process {process}"),
            None => f.write_str("another process"),
        }
    }
}

impl Claim {
    /// Claims `part` of `interface`, which may be up or down, by any of its names.
    pub fn take(interface: &str, part: &str) -> Result<Self, ClaimError> {
        let (name, part) = full_name(interface, part)?;
        let claimed = bind(&part).map_err(|error| match error.raw_os_error() {
            Some(libc::EADDRINUSE) => ClaimError::Taken { interface: name, holder: holder(&part) },
            errno => ClaimError::Os { interface: name, errno: errno.unwrap_or(libc::EIO) },
        })?;
        Ok(Self { _part: claimed, _holder: bind(&format!("{part}/{}", std::process::id())).ok() })
    }

    /// Who plays `part` of `interface` at this moment; `None` if no process does. Nothing is claimed.
    pub fn player(interface: &str, part: &str) -> Result<Option<Holder>, ClaimError> {
        let (name, part) = full_name(interface, part)?;
        let played = || {
            let address = SocketAddr::from_abstract_name(&part)?;
            UnixDatagram::unbound()?.connect_addr(&address)
        };
        match played() {
            Ok(()) => Ok(Some(Holder(holder(&part)))),
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(None),
            Err(error) => Err(ClaimError::Os { interface: name, errno: error.raw_os_error().unwrap_or(libc::EIO) }),
        }
    }
}

/// The interface, and the abstract name of the socket that stands for `part` of it.
fn full_name(interface: &str, part: &str) -> Result<(InterfaceName, String), ClaimError> {
    let name = InterfaceName::new(interface).ok_or(OpenError::BadName)?;
    let index = match CanAddr::from_iface(interface) {
        Ok(address) => address.as_ref().can_ifindex,
        Err(_) => {
            find(interface)?;
            return Err(OpenError::Absent(name).into());
        }
    };
    Ok((name, format!("mrroc/can/{index}/{part}")))
}

/// A socket of this abstract name that takes no message.
fn bind(name: &str) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(name)?)?;
    // Messages would fill a queue that has no reader.
    let _ = socket.shutdown(Shutdown::Both);
    Ok(socket)
}

/// The process that plays `part`, by the list of sockets of this network namespace.
fn holder(part: &str) -> Option<u32> {
    let sockets = fs::read_to_string("/proc/self/net/unix").ok()?;
    sockets.lines().find_map(|line| {
        // Behind numbers alone; `@` stands for the zero that begins an abstract name.
        let (_, name) = line.split_once('@')?;
        name.strip_prefix(part)?.strip_prefix('/')?.parse().ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every host has this interface, and no port is opened on it here.
    const INTERFACE: &str = "lo";

    /// A part that no other test process claims.
    fn part(name: &str) -> String {
        format!("test {} {name}", std::process::id())
    }

    #[test]
    fn a_part_is_played_once_and_the_second_is_told_by_whom() {
        let part = part("controller");
        let first = Claim::take(INTERFACE, &part).unwrap();
        let refusal = Claim::take(INTERFACE, &part).unwrap_err();
        let process = std::process::id();
        let expected = ClaimError::Taken { interface: InterfaceName::new(INTERFACE).unwrap(), holder: Some(process) };
        assert_eq!(refusal, expected);
        assert_eq!(refusal.to_string(), format!("lo: in use by process {process}"));
        drop(first);
        assert!(Claim::take(INTERFACE, &part).is_ok());
    }

    #[test]
    fn a_player_is_known_without_a_claim() {
        let part = part("known");
        assert_eq!(Claim::player(INTERFACE, &part), Ok(None));
        let claim = Claim::take(INTERFACE, &part).unwrap();
        let player = Claim::player(INTERFACE, &part).unwrap().unwrap();
        assert_eq!(player.to_string(), format!("process {}", std::process::id()));
        drop(claim);
        assert_eq!(Claim::player(INTERFACE, &part), Ok(None));
        assert!(Claim::player("nosuch0", &part).is_err());
    }

    #[test]
    fn parts_of_one_interface_do_not_exclude_one_another() {
        let first = Claim::take(INTERFACE, &part("node 1"));
        let second = Claim::take(INTERFACE, &part("node 11"));
        assert!(first.is_ok() && second.is_ok());
    }

    #[test]
    fn a_holder_without_an_id_is_another_process() {
        let part = part("stranger");
        let index = CanAddr::from_iface(INTERFACE).unwrap().as_ref().can_ifindex;
        let _stranger = bind(&format!("mrroc/can/{index}/{part}")).unwrap();
        let refusal = Claim::take(INTERFACE, &part).unwrap_err();
        assert_eq!(refusal.to_string(), "lo: in use by another process");
    }

    #[test]
    fn a_claim_takes_no_messages() {
        let part = part("deaf");
        let _claim = Claim::take(INTERFACE, &part).unwrap();
        let index = CanAddr::from_iface(INTERFACE).unwrap().as_ref().can_ifindex;
        let name = format!("mrroc/can/{index}/{part}");
        let socket = UnixDatagram::unbound().unwrap();
        let address = SocketAddr::from_abstract_name(name).unwrap();
        assert!(socket.send_to_addr(b"message", &address).is_err());
    }

    #[test]
    fn an_interface_that_is_not_there_cannot_be_claimed() {
        for name in ["nosuch0", "", "can/0"] {
            let refusal = Claim::take(name, "controller").unwrap_err();
            assert!(matches!(refusal, ClaimError::Interface(_)), "{refusal}");
        }
    }
}
