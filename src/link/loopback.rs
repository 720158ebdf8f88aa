//! A link in memory: a frame that one end sends is in the other end's inbox at once. It has no thread and no clock, so
//! whole benches run in virtual time. Urgent frames use the same ring, because no frame waits before them.

use std::sync::Arc;

use super::rings::{Outlet, Rings};
use super::{Access, Backend, Link, LinkHealth, RING_FRAMES};

/// The mock rig in this process.
pub(super) const BACKEND: Backend = Backend {
    scheme: "mock",
    place: "",
    what: "mock rig in this process: mock:",
    access: Access::InProcess,
};

/// Host end and rig end.
pub(crate) fn pair() -> (Link, Link) {
    let (host_out, rig_in) = rtrb::RingBuffer::new(RING_FRAMES);
    let (rig_out, host_in) = rtrb::RingBuffer::new(RING_FRAMES);
    let end = |ring, inbox| {
        let rings = Rings {
            out: Outlet { ring, waker: None },
            urgent: None,
            inbox,
        };
        Link::over(rings, Arc::new(LinkHealth::opened()))
    };
    (end(host_out, host_in), end(rig_out, rig_in))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::protocol::frame::Frame;

    #[test]
    fn frames_arrive_in_order_in_both_directions() {
        let (mut host, mut rig) = pair();
        assert!(host.send(Frame::new(0x205, &[1])));
        assert!(host.send_urgent(Frame::new(0x000, &[2, 0])));
        assert_eq!(rig.receive(), Some(Frame::new(0x205, &[1])));
        assert_eq!(rig.receive(), Some(Frame::new(0x000, &[2, 0])));
        assert_eq!(rig.receive(), None);
        assert!(rig.send(Frame::new(0x185, &[3])));
        assert_eq!(host.receive(), Some(Frame::new(0x185, &[3])));
    }

    #[test]
    fn a_full_ring_refuses_and_counts() {
        let (mut host, _rig) = pair();
        for _ in 0..RING_FRAMES {
            assert!(host.send(Frame::new(0x205, &[])));
        }
        assert!(!host.send(Frame::new(0x205, &[])));
        assert_eq!(host.health.send_failures.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn the_loss_of_the_far_end_closes_the_link() {
        let (mut host, mut rig) = pair();
        assert!(rig.send(Frame::new(0x185, &[])));
        drop(rig);
        // A frame sent before still arrives.
        assert!(host.receive().is_some());
        assert!(host.receive().is_none());
        assert!(!host.health.is_open());
        assert!(!host.send(Frame::new(0x205, &[])));
    }
}
