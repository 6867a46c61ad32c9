//! A guardian whose process a service manager starts, so that nothing that ends the controller's service ends the
//! guardian.
//!
//! `mrroc guard SOCKET` waits at a Unix socket. A controller with `--guardian SOCKET` connects, and sends one message: the
//! numbers of its descriptors, and the descriptors. The waiting process then becomes the guardian of this controller, and
//! serves no other. The connection tells each process of the end of the other one.

use std::convert::Infallible;
use std::fs;
use std::io::{self, ErrorKind, IoSlice, IoSliceMut, Read};
use std::os::fd::{AsRawFd, IntoRawFd, RawFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, bail};
use can::clock;
use nix::sys::socket::sockopt::PeerCredentials;
use nix::sys::socket::{ControlMessage, ControlMessageOwned, MsgFlags, getsockopt, recvmsg, sendmsg};

use super::shared::Orders;
use super::{LOOK, NAME, READY, VARIABLE, process};

/// Descriptors of one message of a Unix socket (SCM_MAX_FD of Linux).
pub(super) const MOST_DESCRIPTORS: usize = 253;

/// Longest time until a controller that has connected has sent its message.
const PATIENCE: Duration = Duration::from_secs(5);

/// Waits at `socket` for a controller, and becomes its guardian. Returns only with an error.
pub fn guard(socket: &Path) -> anyhow::Result<Infallible> {
    let place = || format!("guardian at {}", socket.display());
    let listener = listen(socket).with_context(place)?;
    let (connection, _) = listener.accept().with_context(place)?;
    drop(listener);
    // One guardian serves one controller.
    fs::remove_file(socket).with_context(place)?;
    let descriptors = receive(connection).with_context(place)?;
    let mut command = Command::new("/proc/self/exe");
    command.arg0(NAME).env(VARIABLE, descriptors[0].to_string()).current_dir("/");
    process::inherit(&mut command, descriptors);
    Err(command.exec()).with_context(place)
}

/// A listener at `socket`, also if an earlier process left its socket there.
fn listen(socket: &Path) -> anyhow::Result<UnixListener> {
    match UnixListener::bind(socket) {
        Err(error) if error.kind() == ErrorKind::AddrInUse => {
            match UnixStream::connect(socket) {
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(socket)?,
                _ => bail!(
                    "another guardian waits there, or the file is no socket: end that process, or name another file"
                ),
            }
            Ok(UnixListener::bind(socket)?)
        }
        bound => Ok(bound?),
    }
}

/// Receives the descriptors of a controller, and gives the orders the numbers that the descriptors have in this process.
/// Returns all descriptors of the guardian, the memory file first.
fn receive(connection: UnixStream) -> anyhow::Result<Vec<RawFd>> {
    connection.set_read_timeout(Some(PATIENCE))?;
    let mut numbers = [0; 4 * MOST_DESCRIPTORS];
    let mut space = nix::cmsg_space!([RawFd; MOST_DESCRIPTORS]);
    let mut parts = [IoSliceMut::new(&mut numbers)];
    let message = recvmsg::<()>(connection.as_raw_fd(), &mut parts, Some(&mut space), MsgFlags::MSG_CMSG_CLOEXEC)
        .context("no message of a controller")?;
    let received: Vec<RawFd> = message
        .cmsgs()?
        .flat_map(|it| if let ControlMessageOwned::ScmRights(rights) = it { rights } else { Vec::new() })
        .collect();
    let length = message.bytes;
    let sent: Vec<RawFd> = numbers[..length].as_chunks().0.iter().map(|number| RawFd::from_le_bytes(*number)).collect();
    let Some((&memory, _)) = received.split_first().filter(|_| received.len() == sent.len()) else {
        bail!("what has connected is no controller of this version: {length} bytes, {} descriptors", received.len());
    };
    let here = |number: RawFd| sent.iter().position(|it| *it == number).map(|index| received[index]);
    let connection = connection.into_raw_fd();
    Orders::renumber(memory, connection, here).context("the orders are not of this version")?;
    Ok(received.into_iter().chain([connection]).collect())
}

/// The end of a controller: a connection to its guardian.
#[derive(Debug)]
pub(super) struct Connection {
    stream: UnixStream,
    pub(super) pid: u32,
}

impl Connection {
    /// Connects to the process that waits at `socket`, and sends `descriptors`, the memory file first. A service that has
    /// just been started may not wait yet.
    pub(super) fn open(socket: &Path, descriptors: &[RawFd]) -> io::Result<Self> {
        let end = clock::now() + READY;
        let stream = loop {
            match UnixStream::connect(socket) {
                Err(error)
                    if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::ConnectionRefused)
                        && clock::now() < end =>
                {
                    clock::sleep_until(clock::now() + LOOK);
                }
                connected => break connected?,
            }
        };
        let numbers: Vec<u8> = descriptors.iter().flat_map(|number| number.to_le_bytes()).collect();
        let rights = [ControlMessage::ScmRights(descriptors)];
        sendmsg::<()>(stream.as_raw_fd(), &[IoSlice::new(&numbers)], &rights, MsgFlags::MSG_NOSIGNAL, None)?;
        stream.set_nonblocking(true)?;
        let pid = getsockopt(&stream, PeerCredentials)?.pid().unsigned_abs();
        Ok(Self { stream, pid })
    }

    /// Whether the guardian has closed its end: its process has ended, or it will write no more telegrams.
    pub(super) fn is_closed(&self) -> bool {
        let read = (&self.stream).read_exact(&mut [0]);
        !matches!(read, Err(error) if error.kind() == ErrorKind::WouldBlock)
    }
}
