//! A port on a SocketCAN interface: real cards, `vcan` and `slcan` alike.
//!
//! Each send or receive is one system call. Nothing allocates after opening. The kernel stamps the times. The caller
//! learns of a full queue: the small send buffer of the socket fills before the queue of the interface. A full queue of
//! the interface would make the kernel drop frames silently.
//!
//! [`card`](crate::card) sets bit rates, and `ip link` restarts a card after bus-off. This file belongs to the rim: it makes
//! system calls and reads the clock. Read [`SocketCanPort::open`] first.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod batch;

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use batch::Batch;
use socketcan::{CanAddr, CanFilter, CanSocket, Socket, SocketOptions};
use thiserror::Error;

use crate::error_frame::state_after;
use crate::{ControllerState, Counters, Frame, Instant, InterfaceName, Port, PortError, Received, StandardId, clock};

/// Frames that one system call moves at most. The rest of a longer send is refused.
///
/// 256 frames keep a bus of 1 Mbit/s busy for 28 ms.
pub const BATCH: usize = 256;

/// How a [`SocketCanPort`] is set up.
#[derive(Clone, Debug)]
pub struct SocketCanOptions {
    /// Data frames with these identifiers are received and all others are not; empty accepts every
    /// frame. The kernel takes at most 512. Error frames always come.
    pub accept: Vec<StandardId>,
    /// Frames that the kernel keeps for us. Beyond what `net.core.rmem_max` allows it takes the
    /// capability `CAP_NET_ADMIN`; [`SocketCanPort::receive_queue`] tells what was granted.
    pub receive_queue: usize,
    /// Frames that may wait for the bus at once; at least six, the kernel's minimum.
    ///
    /// Keep it below the length of the interface's own queue (`txqueuelen`, 10 on most cards): then it
    /// fills first, and a frame that was taken is sent.
    pub send_queue: usize,
    /// Whether to ask for the card's own time stamps, for [`SocketCanPort::card_stamps`].
    pub card_stamps: bool,
}

/// Eight set-points and a SYNC may wait for the bus; more than a second of a full bus of 1 Mbit/s for us.
impl Default for SocketCanOptions {
    fn default() -> Self {
        Self { accept: Vec::new(), receive_queue: 10_000, send_queue: 9, card_stamps: false }
    }
}

/// What Linux charges a socket's buffer for each frame, bytes: counted on vcan, Linux 6.1.
const FRAME_CHARGE: usize = 768;

/// Why a port could not be opened, and what to do about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum OpenError {
    #[error("an interface name has 1 to 15 bytes, none of them blank or a slash")]
    BadName,
    #[error("{0}: this kernel has no CAN: load its module `can-raw`, or run inside `mrroc vm uml`")]
    NoCan(InterfaceName),
    #[error(
        "{0}: no such interface: plug the card in and load its driver, or make a virtual one with \
         `ip link add dev {0} type vcan`"
    )]
    Absent(InterfaceName),
    #[error("{0}: not a CAN interface: `ip -d link show type can` lists those that are")]
    NotCan(InterfaceName),
    #[error(
        "{0}: interface is down: `ip link set {0} type can bitrate 1000000` on a card, then \
         `ip link set {0} up`"
    )]
    Down(InterfaceName),
    #[error("{interface}: {given} identifiers to accept, the kernel takes 512")]
    TooManyFilters { interface: InterfaceName, given: usize },
    #[error(
        "{interface}: the queue of the interface holds {length} frames, and a cycle queues up to {needed}: \
         `ip link set {interface} txqueuelen {needed}`"
    )]
    ShortQueue { interface: InterfaceName, length: usize, needed: usize },
    #[error("{interface}: errno {errno}")]
    Os { interface: InterfaceName, errno: i32 },
}

/// A raw socket on one CAN interface.
///
/// Frames sent are received by the other sockets of the interface, and not by this port. An interface that
/// goes down is reported by every send, and once by receive; a removed one by every call.
pub struct SocketCanPort {
    socket: CanSocket,
    receive_queue: usize,
    batch: Box<Batch>,
    counters: Counters,
    state: ControllerState,
    /// The kernel's own count of frames dropped, as last seen; it wraps.
    overflow: u32,
    /// No received frame was stamped earlier than the one before it.
    last_received: Instant,
    /// Of `CLOCK_REALTIME` ahead of `CLOCK_MONOTONIC`, as last seen, ns.
    realtime_offset: u64,
    /// Of the frames that the last receive returned.
    card_stamps: Vec<Option<Instant>>,
    gone: bool,
    /// The kernel filters the received frames by identifier.
    filtered: bool,
    /// Greatest number of frames in flight at which `send` accepts frames.
    most_unsent: usize,
    /// Frames accepted since the bound was set that the kernel has not returned as transmitted.
    unsent: usize,
}

impl SocketCanPort {
    /// Opens `interface`, which must exist and be up. What came before is not received.
    pub fn open(interface: &str, options: &SocketCanOptions) -> Result<Self, OpenError> {
        let interface = InterfaceName::new(interface).ok_or(OpenError::BadName)?;
        if options.accept.len() > 512 {
            let given = options.accept.len();
            return Err(OpenError::TooManyFilters { interface, given });
        }
        let socket = CanSocket::open(interface.as_str()).map_err(|error| why_not_opened(interface, &error))?;
        set_up(&socket, options).map_err(|error| os(interface, &error))?;
        // A socket may be bound to an interface that is down; the kernel then leaves this word.
        match socket.as_raw_socket().take_error() {
            Ok(Some(error)) if error.raw_os_error() == Some(libc::ENETDOWN) => {
                return Err(OpenError::Down(interface));
            }
            Ok(Some(error)) | Err(error) => return Err(os(interface, &error)),
            Ok(None) => {}
        }
        check_queue(interface, options.send_queue, queue_length(interface))?;
        let receive_buffer =
            socket.get_socket_option_int(libc::SOL_SOCKET, libc::SO_RCVBUF).map_err(|error| os(interface, &error))?;
        // Between binding and set-up any frame came in. A full bus takes a second to fill this many.
        let mut batch = Batch::new();
        for _ in 0..32 {
            if !matches!(batch.receive(&socket, BATCH), Ok(1..)) {
                break;
            }
        }
        Ok(Self {
            socket,
            receive_queue: usize::try_from(receive_buffer).unwrap_or(0) / FRAME_CHARGE,
            batch,
            counters: Counters::default(),
            state: ControllerState::Active,
            overflow: 0,
            last_received: Instant::ZERO,
            // Each pair of readings that nothing comes between bounds it closer.
            realtime_offset: (0..16).fold(0, |known, _| clock::realtime_offset(known)),
            card_stamps: Vec::with_capacity(BATCH),
            gone: false,
            filtered: !options.accept.is_empty(),
            most_unsent: usize::MAX,
            unsent: 0,
        })
    }

    /// Frames that the kernel keeps for us before it drops any: what was asked for, or less if the
    /// system's limit is lower.
    pub fn receive_queue(&self) -> usize {
        self.receive_queue
    }

    /// When the card saw each frame that the last receive returned, by its own clock; `None` where it said nothing, as
    /// cards and drivers without such a clock do, or was not asked. The clock's origin and rate are the card's.
    pub fn card_stamps(&self) -> &[Option<Instant>] {
        &self.card_stamps
    }

    /// Waits until there is something to receive or `CLOCK_MONOTONIC` shows `until`, and says which.
    ///
    /// `true` also when there is an error to receive. Wakes some 50 µs late on an ordinary thread.
    pub fn wait_readable(&self, until: Instant) -> Result<bool, PortError> {
        if self.gone {
            return Err(PortError::Gone);
        }
        clock::wait_readable(self.socket.as_fd(), until).map_err(PortError::Os)
    }

    fn failed(&mut self, errno: i32) -> PortError {
        match errno {
            libc::ENETDOWN => {
                // A controller comes up active, and no error frame says so. The kernel has discarded waiting frames.
                self.state = ControllerState::Active;
                self.unsent = 0;
                PortError::Down
            }
            libc::ENODEV | libc::ENXIO => {
                self.gone = true;
                PortError::Gone
            }
            other => PortError::Os(other),
        }
    }

    /// Sorts the first `count` messages of the batch into `into` and the counters.
    fn sort(&mut self, count: usize, into: &mut [Received]) -> usize {
        let read_at = clock::now();
        self.realtime_offset = clock::realtime_offset(self.realtime_offset);
        let mut kept = 0;
        self.card_stamps.clear();
        for index in 0..count {
            let ancillary = self.batch.ancillary(index);
            if let Some(overflow) = ancillary.overflow {
                let lost = overflow.wrapping_sub(self.overflow);
                self.counters.dropped += u64::from(lost);
                self.overflow = overflow;
                // Returned frames may be among the lost ones.
                self.unsent = self.unsent.saturating_sub(lost as usize);
            }
            let Some(frame) = self.batch.frame(index) else {
                self.counters.dropped += 1;
                continue;
            };
            if let Some(state) = state_after(&frame, self.state) {
                self.counters.errors += 1;
                self.counters.count_state(self.state, state);
                self.state = state;
                if state == ControllerState::BusOff {
                    // The driver has discarded the waiting frames.
                    self.unsent = 0;
                }
                continue;
            }
            if self.batch.is_own(index) {
                self.unsent = self.unsent.saturating_sub(1);
                continue;
            }
            // The stamp is of CLOCK_REALTIME, which may have been set since it was taken.
            let at = ancillary.realtime_nanos.map_or(read_at, |nanos| {
                Instant::from_nanos(nanos.saturating_sub(self.realtime_offset)).clamp(self.last_received, read_at)
            });
            self.last_received = at;
            into[kept] = Received { frame, at };
            // Within the capacity: a batch holds no more.
            let card = ancillary.card_nanos.map(Instant::from_nanos);
            self.card_stamps.push(card);
            kept += 1;
        }
        self.counters.count_received(&into[..kept]);
        kept
    }
}

impl AsFd for SocketCanPort {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Port for SocketCanPort {
    /// Takes at most [`BATCH`] frames at once. `now` is not looked at: the kernel sends at once.
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        if frames.is_empty() {
            return Ok(0);
        }
        let result = if self.gone {
            Err(PortError::Gone)
        } else if self.unsent > self.most_unsent {
            Ok(0)
        } else {
            match self.batch.send(&self.socket, frames) {
                Ok(taken) => Ok(taken),
                Err(libc::EAGAIN | libc::ENOBUFS | libc::EINTR) => Ok(0),
                Err(errno) => Err(self.failed(errno)),
            }
        };
        let taken = result.unwrap_or(0);
        self.counters.count_sent(&frames[..taken]);
        if self.most_unsent < usize::MAX {
            self.unsent += taken;
        }
        self.counters.refused += (frames.len() - taken) as u64;
        result
    }

    /// Takes at most [`BATCH`] frames at once. `now` is not looked at: the frames are stamped by the
    /// kernel, and those that came since `now` was read are among them.
    fn receive(&mut self, _now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        if self.gone {
            return Err(PortError::Gone);
        }
        if into.is_empty() {
            return Ok(0);
        }
        match self.batch.receive(&self.socket, into.len()) {
            Ok(count) => Ok(self.sort(count, into)),
            Err(libc::EAGAIN | libc::EINTR) => Ok(0),
            Err(errno) => Err(self.failed(errno)),
        }
    }

    /// The kernel returns the port's own frames after their transmission, and so the port counts those in flight. A
    /// driver without echo returns a frame as soon as it takes the frame. A port with identifiers to accept ignores the
    /// bound, because the kernel filters the returned frames too.
    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        let bounded = most < usize::MAX && !self.filtered;
        (self.most_unsent, self.unsent) = (usize::MAX, 0);
        let set = self.socket.set_recv_own_msgs(bounded);
        set.map_err(|error| PortError::Os(error.raw_os_error().unwrap_or(libc::EIO)))?;
        self.most_unsent = if bounded { most } else { usize::MAX };
        Ok(())
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn state(&self) -> ControllerState {
        self.state
    }
}

/// The CAN interface called `interface`, up or down.
pub(crate) fn find(interface: &str) -> Result<InterfaceName, OpenError> {
    let name = InterfaceName::new(interface).ok_or(OpenError::BadName)?;
    CanSocket::open(interface).map(|_| name).map_err(|error| why_not_opened(name, &error))
}

fn set_up(socket: &CanSocket, options: &SocketCanOptions) -> io::Result<()> {
    const EXACT: u32 = libc::CAN_SFF_MASK | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG;
    const ON: libc::c_int = 1;
    socket.as_raw_socket().set_cloexec(true)?;
    socket.set_nonblocking(true)?;
    socket.set_error_filter_accept_all()?;
    if !options.accept.is_empty() {
        let filters: Vec<_> = options.accept.iter().map(|id| CanFilter::new(u32::from(id.raw()), EXACT)).collect();
        socket.set_filters(&filters)?;
    }
    // The kernel doubles what it is asked for.
    let size = |frames: usize| {
        let bytes = frames.saturating_mul(FRAME_CHARGE / 2);
        libc::c_int::try_from(bytes).unwrap_or(libc::c_int::MAX / 2)
    };
    let set = |name, value| socket.set_socket_option_int(libc::SOL_SOCKET, name, value);
    set(libc::SO_RXQ_OVFL, ON)?;
    set(libc::SO_TIMESTAMPNS, ON)?;
    if options.card_stamps {
        let raw = libc::SOF_TIMESTAMPING_RX_HARDWARE | libc::SOF_TIMESTAMPING_RAW_HARDWARE;
        set(libc::SO_TIMESTAMPING, raw as libc::c_int)?;
    }
    set(libc::SO_SNDBUF, size(options.send_queue))?;
    // Beyond the system's limit if we may, up to it if not.
    let receive_buffer = size(options.receive_queue);
    set(libc::SO_RCVBUFFORCE, receive_buffer).or_else(|_| set(libc::SO_RCVBUF, receive_buffer))
}

/// Length of the interface's own queue (`txqueuelen`), frames; `None` where the kernel does not show the length.
fn queue_length(interface: InterfaceName) -> Option<usize> {
    let text = std::fs::read_to_string(format!("/sys/class/net/{interface}/tx_queue_len"));
    text.ok()?.trim().parse().ok()
}

/// Refuses a queue that fills before the send buffer of the socket: the kernel would drop frames that it accepted. An
/// interface without a queue has the length zero.
fn check_queue(interface: InterfaceName, needed: usize, length: Option<usize>) -> Result<(), OpenError> {
    match length {
        Some(length) if length > 0 && length < needed => Err(OpenError::ShortQueue { interface, length, needed }),
        Some(_) | None => Ok(()),
    }
}

fn why_not_opened(interface: InterfaceName, error: &io::Error) -> OpenError {
    // The kernel answers ENODEV for an absent interface and for an interface of another kind. The interface is looked
    // up before the protocol, so an absent interface hides a kernel without CAN.
    let kernel_lacks_can = || {
        let any = CanSocket::open_iface(0);
        any.is_err_and(|error| error.raw_os_error() == Some(libc::EAFNOSUPPORT))
    };
    match error.raw_os_error() {
        Some(libc::EAFNOSUPPORT) => OpenError::NoCan(interface),
        Some(libc::ENODEV) if kernel_lacks_can() => OpenError::NoCan(interface),
        Some(libc::ENODEV) if CanAddr::from_iface(interface.as_str()).is_ok() => OpenError::NotCan(interface),
        Some(libc::ENODEV) => OpenError::Absent(interface),
        _ => os(interface, error),
    }
}

fn os(interface: InterfaceName, error: &io::Error) -> OpenError {
    let errno = error.raw_os_error().unwrap_or(libc::EIO);
    OpenError::Os { interface, errno }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(interface: &str, options: &SocketCanOptions) -> OpenError {
        SocketCanPort::open(interface, options).err().expect("a refusal")
    }

    #[test]
    fn impossible_names_are_refused_before_the_kernel_is_asked() {
        for name in ["", "sixteen-letters-", "can 0", "can/0", "can\0"] {
            assert_eq!(refusal(name, &SocketCanOptions::default()), OpenError::BadName);
        }
    }

    #[test]
    fn more_filters_than_the_kernel_has_are_refused() {
        let options = SocketCanOptions { accept: vec![StandardId::MAX; 513], ..SocketCanOptions::default() };
        let interface = InterfaceName::new("can0").unwrap();
        let expected = OpenError::TooManyFilters { interface, given: 513 };
        assert_eq!(refusal("can0", &options), expected);
    }

    #[test]
    fn an_interface_that_goes_down_ends_bus_off() {
        let other = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut port = SocketCanPort {
            socket: CanSocket::from(std::os::fd::OwnedFd::from(other)),
            receive_queue: 0,
            batch: Batch::new(),
            counters: Counters::default(),
            state: ControllerState::BusOff,
            overflow: 0,
            last_received: Instant::ZERO,
            realtime_offset: 0,
            card_stamps: Vec::new(),
            gone: false,
            filtered: false,
            most_unsent: 3,
            unsent: 9,
        };
        assert_eq!(port.failed(libc::EIO), PortError::Os(libc::EIO));
        assert_eq!(port.state(), ControllerState::BusOff);
        assert_eq!(port.failed(libc::ENETDOWN), PortError::Down);
        assert_eq!((port.state(), port.unsent), (ControllerState::Active, 0));
        // Frames in flight cannot be counted on this socket.
        assert!(matches!(port.bound_unsent(3), Err(PortError::Os(_))));
        assert_eq!(port.most_unsent, usize::MAX);
    }

    #[test]
    fn an_interface_with_a_shorter_queue_than_a_cycle_is_refused() {
        let interface = InterfaceName::new("can0").unwrap();
        for (length, refused) in [(Some(3), true), (Some(8), true), (Some(9), false), (Some(0), false), (None, false)] {
            let checked = check_queue(interface, 9, length);
            assert_eq!(checked.is_err(), refused, "{length:?}");
        }
        let text = check_queue(interface, 9, Some(3)).unwrap_err().to_string();
        assert!(text.contains("holds 3 frames") && text.contains("ip link set can0 txqueuelen 9"), "{text}");
    }

    #[test]
    fn an_open_error_says_what_to_do() {
        let name = InterfaceName::new("can7").unwrap();
        for (error, advice) in [
            (OpenError::NoCan(name), "mrroc vm uml"),
            (OpenError::Absent(name), "ip link add dev can7 type vcan"),
            (OpenError::NotCan(name), "ip -d link show type can"),
            (OpenError::Down(name), "ip link set can7 up"),
        ] {
            let text = error.to_string();
            assert!(text.starts_with("can7: ") && text.contains(advice), "{text}");
        }
    }
}
