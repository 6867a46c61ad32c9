//! A socket that only sends, for a process that stops the nodes of a bus whose controller is silent.

use std::io;
use std::os::fd::{FromRawFd, IntoRawFd, OwnedFd};

use socketcan::{CanSocket, Socket, SocketOptions};

use crate::{Frame, InterfaceName};

/// Bytes of a classic frame that a CAN socket takes by one write (`struct can_frame`).
const MESSAGE: usize = 16;

/// Opens a socket on `interface` that receives nothing. Writing does not block.
#[expect(unsafe_code, reason = "the socket library gives its descriptor away as a number only")]
pub fn send_only(interface: InterfaceName) -> io::Result<OwnedFd> {
    let socket = CanSocket::open(interface.as_str())?;
    socket.set_filter_drop_all()?;
    socket.set_nonblocking(true)?;
    // SAFETY: the descriptor is open, and the socket has given up its ownership.
    Ok(unsafe { OwnedFd::from_raw_fd(socket.into_raw_fd()) })
}

/// The bytes that a CAN socket takes for a data frame with a standard identifier; `None` for other frames.
pub fn message(frame: &Frame) -> Option<[u8; MESSAGE]> {
    let id = frame.standard_data_id()?;
    let data = frame.data();
    let mut bytes = [0; MESSAGE];
    bytes[..4].copy_from_slice(&u32::from(id.raw()).to_ne_bytes());
    bytes[4] = data.len() as u8;
    bytes[8..][..data.len()].copy_from_slice(data);
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StandardId;

    #[test]
    fn a_message_is_a_can_frame_of_linux() {
        let frame = Frame::new(StandardId::new(0x205).unwrap(), &[1, 2]).unwrap();
        let bytes = message(&frame).unwrap();
        assert_eq!(u32::from_ne_bytes(bytes[..4].try_into().unwrap()), 0x205);
        assert_eq!(bytes[4..], [2, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0]);
    }
}
