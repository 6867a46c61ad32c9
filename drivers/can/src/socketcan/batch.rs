//! Many frames in one system call, with what the kernel says beside each.

#![expect(unsafe_code, reason = "batched system calls that no safe wrapper offers")]

use std::io;
use std::mem;
use std::os::fd::AsRawFd;
use std::ptr;

use socketcan::CanSocket;

use super::BATCH;
use crate::Frame;

/// What `sendmmsg` and `recvmmsg` read and write.
pub(super) struct Batch {
    headers: [libc::mmsghdr; BATCH],
    slices: [libc::iovec; BATCH],
    frames: [libc::can_frame; BATCH],
    controls: [Control; BATCH],
}

/// Room for the kernel's time stamp (32 bytes with its header), the card's (64 bytes) and a count of dropped frames
/// (24 bytes).
#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct Control([u8; 128]);

/// What the kernel says beside a frame.
#[derive(Default)]
pub(super) struct Ancillary {
    pub(super) realtime_nanos: Option<u64>,
    pub(super) card_nanos: Option<u64>,
    pub(super) overflow: Option<u32>,
}

// SAFETY: the pointers in headers and slices are set before each system call and not used after it.
unsafe impl Send for Batch {}

impl Batch {
    pub(super) fn new() -> Box<Self> {
        // SAFETY: plain integers and pointers, for all of which zero is a value.
        Box::new(unsafe { mem::zeroed() })
    }

    pub(super) fn send(&mut self, socket: &CanSocket, frames: &[Frame]) -> Result<usize, i32> {
        const { assert!(size_of::<Frame>() == size_of::<libc::can_frame>()) };
        let count = frames.len().min(BATCH);
        for (index, frame) in frames[..count].iter().enumerate() {
            // The kernel only reads what a sent slice points to.
            self.slices[index].iov_base = ptr::from_ref(frame).cast_mut().cast();
            self.slices[index].iov_len = size_of::<Frame>();
            let header = &mut self.headers[index].msg_hdr;
            header.msg_iov = &mut self.slices[index];
            header.msg_iovlen = 1;
            header.msg_control = ptr::null_mut();
            header.msg_controllen = 0;
        }
        let headers = self.headers.as_mut_ptr();
        // SAFETY: the first `count` headers point to valid slices, those to frames that outlive the call.
        let taken = unsafe { libc::sendmmsg(socket.as_raw_fd(), headers, count as u32, libc::MSG_DONTWAIT) };
        usize::try_from(taken).map_err(|_| errno())
    }

    pub(super) fn receive(&mut self, socket: &CanSocket, limit: usize) -> Result<usize, i32> {
        let count = limit.min(BATCH);
        for index in 0..count {
            self.slices[index].iov_base = ptr::from_mut(&mut self.frames[index]).cast();
            self.slices[index].iov_len = size_of::<libc::can_frame>();
            let header = &mut self.headers[index].msg_hdr;
            header.msg_iov = &mut self.slices[index];
            header.msg_iovlen = 1;
            header.msg_control = ptr::from_mut(&mut self.controls[index]).cast();
            header.msg_controllen = size_of::<Control>();
        }
        let headers = self.headers.as_mut_ptr();
        // SAFETY: the first `count` headers point to valid slices, frames and controls of this batch.
        let received =
            unsafe { libc::recvmmsg(socket.as_raw_fd(), headers, count as u32, libc::MSG_DONTWAIT, ptr::null_mut()) };
        usize::try_from(received).map_err(|_| errno())
    }

    /// `None` for what is no frame of classical CAN.
    pub(super) fn frame(&self, index: usize) -> Option<Frame> {
        if self.headers[index].msg_len as usize != size_of::<libc::can_frame>() {
            return None;
        }
        let raw = self.frames[index];
        Frame::from_raw(raw.can_id, raw.can_dlc, raw.data)
    }

    /// Whether this socket has sent the frame: the kernel returned it after its transmission.
    pub(super) fn is_own(&self, index: usize) -> bool {
        self.headers[index].msg_hdr.msg_flags & libc::MSG_CONFIRM != 0
    }

    pub(super) fn ancillary(&self, index: usize) -> Ancillary {
        let mut found = Ancillary::default();
        let control = ptr::from_ref(&self.controls[index]).cast_mut().cast();
        let header = libc::msghdr {
            msg_control: control,
            msg_controllen: self.headers[index].msg_hdr.msg_controllen.min(size_of::<Control>()),
            ..self.headers[index].msg_hdr
        };
        // SAFETY: `msg_controllen` bytes of the control buffer are there, and these macros walk the messages in them.
        let mut message = unsafe { libc::CMSG_FIRSTHDR(&header) };
        // SAFETY: the macros return null, or a message whose header lies within the buffer.
        while let Some(it) = unsafe { message.as_ref() } {
            // SAFETY: as above.
            let data = unsafe { payload(&header, message) };
            match (it.cmsg_level, it.cmsg_type) {
                (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS) => {
                    found.realtime_nanos = data.first_chunk().and_then(nanos);
                }
                // `struct scm_timestamping`: by software, one of old, by hardware; zero is none.
                (libc::SOL_SOCKET, libc::SCM_TIMESTAMPING) => {
                    let stamp = data.get(2 * STAMP..).and_then(<[u8]>::first_chunk);
                    found.card_nanos = stamp.and_then(nanos).filter(|&it| it != 0);
                }
                (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => {
                    found.overflow = data.first_chunk().map(|&bytes| u32::from_ne_bytes(bytes));
                }
                _ => {}
            }
            // SAFETY: `message` is one of the messages of `header`.
            message = unsafe { libc::CMSG_NXTHDR(&header, message) };
        }
        found
    }
}

/// The data of a control message: as much as its own length says and its buffer holds. The kernel cuts a message short
/// for which the buffer had no room.
///
/// # Safety
///
/// `message` is what the macros found in the control buffer of `header`, and that buffer outlives the result.
unsafe fn payload<'a>(header: &libc::msghdr, message: *const libc::cmsghdr) -> &'a [u8] {
    // SAFETY: the caller's promise: header and data begin within the buffer, or just behind it.
    unsafe {
        let data = libc::CMSG_DATA(message);
        let before = data.offset_from_unsigned(message.cast());
        let told = (*message).cmsg_len.saturating_sub(before);
        let end = header.msg_control.cast::<u8>().add(header.msg_controllen);
        let there = (end as usize).saturating_sub(data as usize);
        std::slice::from_raw_parts(data, told.min(there))
    }
}

fn errno() -> i32 {
    io::Error::last_os_error().raw_os_error().unwrap_or(libc::EIO)
}

/// Bytes of a `struct timespec`.
const STAMP: usize = size_of::<libc::timespec>();

/// A `struct timespec` in nanoseconds; `None` for one that is none or that no [`Instant`](crate::Instant) holds.
fn nanos(stamp: &[u8; STAMP]) -> Option<u64> {
    let (seconds, nanos) = stamp.split_at(STAMP / 2);
    let seconds = libc::time_t::from_ne_bytes(*seconds.first_chunk()?);
    let nanos = libc::c_long::from_ne_bytes(*nanos.first_chunk()?);
    let (seconds, nanos) = (u64::try_from(seconds).ok()?, u64::try_from(nanos).ok()?);
    let nanos = Some(nanos).filter(|nanos| *nanos < 1_000_000_000)?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Found = (Option<u64>, Option<u64>, Option<u32>);

    /// A control message as the kernel lays it out, with its padding.
    fn message(kind: i32, data: &[u8]) -> Vec<u8> {
        let mut bytes = (16 + data.len()).to_ne_bytes().to_vec();
        bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    /// Times of one second and these nanoseconds.
    fn times(nanos: &[i64]) -> Vec<u8> {
        let times = nanos.iter().flat_map(|&nanos| [1, nanos]);
        times.flat_map(i64::to_ne_bytes).collect()
    }

    fn read(control: &[u8]) -> Found {
        read_from(control, control.len())
    }

    /// What is found in a buffer that begins with `bytes`, of which the kernel filled `length`.
    fn read_from(bytes: &[u8], length: usize) -> Found {
        let mut batch = Batch::new();
        batch.controls[0].0[..bytes.len()].copy_from_slice(bytes);
        batch.headers[0].msg_hdr.msg_controllen = length;
        let found = batch.ancillary(0);
        (found.realtime_nanos, found.card_nanos, found.overflow)
    }

    #[test]
    fn the_kernels_stamp_the_cards_and_the_count_of_losses_are_told_apart() {
        let kernel = message(libc::SCM_TIMESTAMPNS, &times(&[7]));
        let card = message(libc::SCM_TIMESTAMPING, &times(&[8, 0, 9]));
        let lost = message(libc::SO_RXQ_OVFL, &5_u32.to_ne_bytes());
        let none = message(libc::SCM_TIMESTAMPING, &[0; 48]);
        let (kernel_only, all) = ([&kernel[..], &none].concat(), [kernel, card, lost].concat());
        for (control, expected) in [
            (all, (Some(1_000_000_007), Some(1_000_000_009), Some(5))),
            (kernel_only, (Some(1_000_000_007), None, None)),
        ] {
            assert_eq!(read(&control), expected);
        }
    }

    #[test]
    fn a_message_shorter_than_its_kind_is_not_read() {
        let stamp = times(&[7]);
        for (kind, whole) in [
            (libc::SCM_TIMESTAMPNS, &stamp[..]),
            (libc::SCM_TIMESTAMPING, &times(&[8, 0, 9])),
            (libc::SO_RXQ_OVFL, &5_u32.to_ne_bytes()),
        ] {
            // What lies behind a message in its buffer is of another one, or of a receive before.
            let behind = [0xFF; 64];
            for length in 0..whole.len() {
                let short = message(kind, &whole[..length]);
                let found = read_from(&[&short[..], &behind].concat(), short.len());
                assert_eq!(found, (None, None, None), "{kind}: {length} bytes");
            }
        }
        // The next one is found all the same.
        let short = message(libc::SCM_TIMESTAMPNS, &stamp[..8]);
        let lost = message(libc::SO_RXQ_OVFL, &5_u32.to_ne_bytes());
        assert_eq!(read(&[short, lost].concat()), (None, None, Some(5)));
    }

    #[test]
    fn a_stamp_before_1970_or_beyond_64_bits_is_none() {
        for [seconds, nanos] in [[-1_i64, 0], [i64::MAX, 0], [0, -1], [0, 1_000_000_000]] {
            let stamp = [seconds.to_ne_bytes(), nanos.to_ne_bytes()].concat();
            let control = message(libc::SCM_TIMESTAMPNS, &stamp);
            assert_eq!(read(&control), (None, None, None), "{seconds} {nanos}");
        }
    }

    #[test]
    fn a_datagram_of_another_length_than_a_frame_is_none() {
        let mut batch = Batch::new();
        batch.frames[0].can_dlc = 8;
        for (length, is_frame) in [(0, false), (15, false), (16, true), (72, false)] {
            batch.headers[0].msg_len = length;
            assert_eq!(batch.frame(0).is_some(), is_frame, "{length} bytes");
        }
    }
}
