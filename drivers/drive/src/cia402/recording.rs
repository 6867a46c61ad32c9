//! Replay of a recorded bus through a drive group.

use std::task::Poll;
use std::time::Duration;

use can::timing::bits_on_wire;
use can::{Frame, Instant, Received, VirtualPeer, VirtualPort, virtual_port};
use canopen::heartbeat::Heartbeat;
use canopen::{NodeId, cob};

use crate::{BringUpError, DriveGroup};

/// The traffic of one bus during one run, played back through a group of the same configuration.
///
/// The frames of the drives are delivered in their order. The frames of the host tell when the group was called:
/// - Bring-up is called at every frame. The run called bring-up once a period at least. In the replay, each request is
///   therefore made before the recorded answer to it arrives.
/// - A cycle is read, written and sent at the time of its SYNC. The run read shortly before its SYNC. Only a frame
///   that arrived between the reading and the sending is therefore read a cycle early. A cycle whose SYNC the port
///   refused is not in the recording.
///
/// ```text
/// (port, sent) = recording.port()
/// group = CanBus::new(port, config, axes)
/// recording.bring_up(group)
/// for now in recording.syncs(): group.read(now, states); group.write(now, commands); group.send(now)
/// ```
#[derive(Clone, Debug)]
pub struct Recording {
    /// Frames from the host's first frame on, each at a time of its own.
    frames: Vec<Received>,
    host_node: NodeId,
}

impl Recording {
    /// Takes the frames of one bus in the order of the bus. Frames before the host's first frame are skipped, because
    /// the host was not listening yet.
    pub fn new(frames: impl IntoIterator<Item = Received>, host_node: NodeId) -> Self {
        let from_host = |received: &Received| is_from_host(&received.frame, host_node);
        let frames = frames.into_iter().skip_while(|received| !from_host(received));
        // The times of a recording are rounded, and only the order is reliable.
        let next = |last: &mut Instant, Received { frame, at }| {
            *last = at.max(*last + Duration::from_nanos(1));
            Some(Received { frame, at: *last })
        };
        Self { frames: frames.scan(Instant::ZERO, next).collect(), host_node }
    }

    /// A port that delivers the frames of the drives at their times, and its other end, at which the frames of the
    /// group arrive. The port has room for twice the frames of the recording and
    /// refuses further ones. Keep the other end: without it, the port is gone.
    pub fn port(&self) -> (VirtualPort, VirtualPeer) {
        let (port, mut peer) = virtual_port(2 * self.frames.len());
        let drives = |received: &&Received| !is_from_host(&received.frame, self.host_node);
        for received in self.frames.iter().filter(drives) {
            peer.deliver(*received, bits_on_wire(&received.frame));
        }
        (port, peer)
    }

    /// The frames of the host.
    pub fn from_host(&self) -> impl Iterator<Item = Received> {
        let host = |received: &Received| is_from_host(&received.frame, self.host_node);
        self.frames.iter().copied().filter(host)
    }

    /// The time of the SYNC of each cycle.
    pub fn syncs(&self) -> impl Iterator<Item = Instant> {
        let sync = |received: &Received| is_sync(&received.frame).then_some(received.at);
        self.frames[self.first_cycle()..].iter().filter_map(sync)
    }

    /// Index of the SYNC of the first cycle, which the first set-points follow. The SYNCs before it are of bring-up.
    fn first_cycle(&self) -> usize {
        let is_set_point = |received: &Received| is_set_point(&received.frame);
        let end = self.frames.iter().position(is_set_point).unwrap_or(self.frames.len());
        self.frames[..end].iter().rposition(|received| is_sync(&received.frame)).unwrap_or(end)
    }

    /// Brings up a group on [`Self::port`]. `Pending` means that the first cycle came before the end of bring-up.
    pub fn bring_up(&self, group: &mut dyn DriveGroup) -> Poll<Result<(), BringUpError>> {
        let before = self.frames[..self.first_cycle()].iter();
        // The run listened long enough before its first frame.
        if let Poll::Ready(ended) = group.bring_up(Instant::ZERO) {
            return Poll::Ready(ended);
        }
        before.map(|received| group.bring_up(received.at)).find(Poll::is_ready).unwrap_or(Poll::Pending)
    }
}

fn is_sync(frame: &Frame) -> bool {
    frame.standard_data_id() == Some(cob::SYNC)
}

fn is_set_point(frame: &Frame) -> bool {
    matches!(frame.standard_data_id().and_then(cob::Function::of), Some(cob::Function::Rpdo(..)))
}

fn is_from_host(frame: &Frame, host_node: NodeId) -> bool {
    use cob::Function;
    match frame.standard_data_id().and_then(Function::of) {
        Some(Function::Nmt | Function::Sync | Function::Time) => true,
        Some(Function::Rpdo(..) | Function::SdoRequest(_)) => true,
        Some(Function::Heartbeat(_)) => Heartbeat::decode(frame).is_some_and(|heartbeat| heartbeat.node == host_node),
        Some(Function::Tpdo(..) | Function::SdoResponse(_) | Function::Emcy(_)) | None => false,
    }
}

#[cfg(test)]
mod tests {
    use can::StandardId;

    use super::*;

    fn recorded(frames: &[(u64, u16)]) -> Recording {
        let received = |&(nanos, id): &(u64, u16)| Received {
            frame: Frame::new(StandardId::new(id).unwrap(), &[5]).unwrap(),
            at: Instant::from_nanos(nanos),
        };
        Recording::new(frames.iter().map(received), NodeId::new(127).unwrap())
    }

    fn ids(frames: impl Iterator<Item = Received>) -> Vec<(u64, u16)> {
        let plain = |received: Received| {
            let id = received.frame.standard_data_id().unwrap().raw();
            (received.at.as_nanos(), id)
        };
        frames.map(plain).collect()
    }

    #[test]
    fn the_two_sides_are_told_apart_and_the_order_is_kept() {
        let recording = recorded(&[
            (1, 0x701), // before the host came
            (5, 0x000),
            (5, 0x701),
            (5, 0x601),
            (5, 0x581),
            (5, 0x080), // of bring-up
            (4, 0x080),
            (20, 0x201),
            (20, 0x77F),
            (30, 0x081),
            (30, 0x181),
        ]);
        let host = [(5, 0x000), (7, 0x601), (9, 0x080), (10, 0x080), (20, 0x201), (21, 0x77F)];
        assert_eq!(ids(recording.from_host()), host);
        assert_eq!(recording.syncs().collect::<Vec<_>>(), [Instant::from_nanos(10)]);
        let mut into = [recording.frames[0]; 8];
        let (mut port, _peer) = recording.port();
        let count = can::Port::receive(&mut port, Instant::from_nanos(100), &mut into).unwrap();
        let drives = [(6, 0x701), (8, 0x581), (30, 0x081), (31, 0x181)];
        assert_eq!(ids(into[..count].iter().copied()), drives);
    }
}
