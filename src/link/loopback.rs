//! Two ends in memory: what one end sends stands in the other's inbox at once. No task, no thread, no clock of its own,
//! so whole benches run in virtual time. `urgent` frames take the same ring: nothing can be queued before them.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use super::rings::{Outlet, Rings};
use super::{Arrival, Link, RING_FRAMES, Wire};

/// Host end and rig end. All arrival times are 0: time is the rig's tick.
pub(crate) fn pair() -> (Link, Link) {
    pair_with_clock(Arc::new(AtomicU64::new(0)))
}

/// Host end and rig end. Frames carry the time that `clock` (ns, moved by whoever steps the bench) shows as they are
/// sent: in memory that is the time of arrival too.
pub(crate) fn pair_with_clock(clock: Arc<AtomicU64>) -> (Link, Link) {
    let (host_out, rig_in) = rtrb::RingBuffer::<Arrival>::new(RING_FRAMES);
    let (rig_out, host_in) = rtrb::RingBuffer::<Arrival>::new(RING_FRAMES);
    let end = |ring, inbox| {
        let out = Outlet { ring, waker: None };
        let clock = Some(Arc::clone(&clock));
        Link::over(Wire::Rings(Rings {
            out,
            urgent: None,
            inbox,
            clock,
            service: None,
        }))
    };
    (end(host_out, host_in), end(rig_out, rig_in))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::protocol::frame::Frame;

    #[test]
    fn frames_arrive_in_order_with_the_time_of_the_clock() {
        let clock = Arc::new(AtomicU64::new(7));
        let (mut host, mut rig) = pair_with_clock(Arc::clone(&clock));
        assert!(host.send(Frame::new(0x205, &[1])));
        clock.store(9, Ordering::Relaxed);
        assert!(host.send_urgent(Frame::new(0x000, &[2, 0])));
        assert_eq!(
            rig.receive(),
            Some(Arrival {
                frame: Frame::new(0x205, &[1]),
                at_ns: 7
            })
        );
        assert_eq!(
            rig.receive(),
            Some(Arrival {
                frame: Frame::new(0x000, &[2, 0]),
                at_ns: 9
            })
        );
        assert_eq!(rig.receive(), None);
        assert!(rig.send(Frame::new(0x185, &[3])));
        assert_eq!(host.receive().map(|arrival| arrival.frame.id), Some(0x185));
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
    fn the_loss_of_the_far_end_shows() {
        let (mut host, mut rig) = pair();
        assert!(rig.send(Frame::new(0x185, &[])));
        drop(rig);
        // What was on its way still arrives.
        assert!(host.receive().is_some());
        assert!(host.receive().is_none());
        assert!(!host.health.is_open());
        assert!(!host.send(Frame::new(0x205, &[])));
    }
}
