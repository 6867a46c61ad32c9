//! Many frames in one system call, with what the kernel says beside each.

#![expect(
    unsafe_code,
    reason = "batched system calls that no safe wrapper offers"
)]

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
    frames: [RawFrame; BATCH],
    controls: [Control; BATCH],
}

/// `struct can_frame`.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
struct RawFrame {
    id_and_flags: u32,
    len: u8,
    padding: [u8; 3],
    data: [u8; 8],
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
        let taken = unsafe {
            libc::sendmmsg(
                socket.as_raw_fd(),
                headers,
                count as u32,
                libc::MSG_DONTWAIT,
            )
        };
        usize::try_from(taken).map_err(|_| errno())
    }

    pub(super) fn receive(&mut self, socket: &CanSocket, limit: usize) -> Result<usize, i32> {
        let count = limit.min(BATCH);
        for index in 0..count {
            self.slices[index].iov_base = ptr::from_mut(&mut self.frames[index]).cast();
            self.slices[index].iov_len = size_of::<RawFrame>();
            let header = &mut self.headers[index].msg_hdr;
            header.msg_iov = &mut self.slices[index];
            header.msg_iovlen = 1;
            header.msg_control = ptr::from_mut(&mut self.controls[index]).cast();
            header.msg_controllen = size_of::<Control>();
        }
        let headers = self.headers.as_mut_ptr();
        // SAFETY: the first `count` headers point to valid slices, frames and controls of this batch.
        let received = unsafe {
            libc::recvmmsg(
                socket.as_raw_fd(),
                headers,
                count as u32,
                libc::MSG_DONTWAIT,
                ptr::null_mut(),
            )
        };
        usize::try_from(received).map_err(|_| errno())
    }

    pub(super) fn frame(&self, index: usize) -> Option<Frame> {
        let raw = self.frames[index];
        Frame::from_raw(raw.id_and_flags, raw.len, raw.data)
    }

    pub(super) fn ancillary(&self, index: usize) -> Ancillary {
        let mut found = Ancillary::default();
        let control = ptr::from_ref(&self.controls[index]).cast_mut().cast();
        let header = libc::msghdr {
            msg_control: control,
            ..self.headers[index].msg_hdr
        };
        // SAFETY: the kernel filled `msg_controllen` bytes of the control buffer with well-formed
        // messages, which these macros walk; the data is read unaligned, in the type of its kind.
        unsafe {
            let mut message = libc::CMSG_FIRSTHDR(&header);
            while let Some(it) = message.as_ref() {
                let data = libc::CMSG_DATA(message);
                match (it.cmsg_level, it.cmsg_type) {
                    (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS) => {
                        found.realtime_nanos = Some(nanos(data.cast()));
                    }
                    // `struct scm_timestamping`: by software, one of old, by hardware; zero is none.
                    (libc::SOL_SOCKET, libc::SCM_TIMESTAMPING) => {
                        let stamps = data.cast::<libc::timespec>();
                        found.card_nanos = Some(nanos(stamps.add(2))).filter(|&it| it != 0);
                    }
                    (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => {
                        found.overflow = Some(data.cast::<u32>().read_unaligned());
                    }
                    _ => {}
                }
                message = libc::CMSG_NXTHDR(&header, message);
            }
        }
        found
    }
}

fn errno() -> i32 {
    io::Error::last_os_error()
        .raw_os_error()
        .unwrap_or(libc::EIO)
}

/// # Safety
///
/// There is a timespec at `stamp`, aligned or not.
unsafe fn nanos(stamp: *const libc::timespec) -> u64 {
    // SAFETY: the caller's promise.
    let stamp = unsafe { stamp.read_unaligned() };
    stamp.tv_sec as u64 * 1_000_000_000 + stamp.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_stamp_the_cards_and_the_count_of_losses_are_told_apart() {
        let message = |kind: i32, data: &[u8]| {
            let mut bytes = (16 + data.len()).to_ne_bytes().to_vec();
            bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
            bytes.extend(kind.to_ne_bytes());
            bytes.extend(data);
            bytes.resize(bytes.len().next_multiple_of(8), 0);
            bytes
        };
        let times = |nanos: &[i64]| -> Vec<u8> {
            let times = nanos.iter().flat_map(|&nanos| [1, nanos]);
            times.flat_map(i64::to_ne_bytes).collect()
        };
        let kernel = message(libc::SCM_TIMESTAMPNS, &times(&[7]));
        let card = message(libc::SCM_TIMESTAMPING, &times(&[8, 0, 9]));
        let lost = message(libc::SO_RXQ_OVFL, &5_u32.to_ne_bytes());
        let none = message(libc::SCM_TIMESTAMPING, &[0; 48]);
        let (kernel_only, all) = ([&kernel[..], &none].concat(), [kernel, card, lost].concat());
        for (control, expected) in [
            (all, (Some(1_000_000_007), Some(1_000_000_009), Some(5))),
            (kernel_only, (Some(1_000_000_007), None, None)),
        ] {
            let mut batch = Batch::new();
            batch.controls[0].0[..control.len()].copy_from_slice(&control);
            batch.headers[0].msg_hdr.msg_controllen = control.len();
            let found = batch.ancillary(0);
            let found = (found.realtime_nanos, found.card_nanos, found.overflow);
            assert_eq!(found, expected);
        }
    }
}
