//! A link in memory: a frame that one end sends is in the other end's inbox at once. It has no thread and no clock, so
//! whole benches run in virtual time. Urgent frames use the same ring, because no frame waits before them.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::{Access, Backend, Link, LinkHealth, Port};
use crate::protocol::frame::Frame;
use crate::ring;

/// The mock rig in this process.
pub(super) const BACKEND: Backend = Backend {
    scheme: "mock",
    place: "",
    what: "mock rig in this process: mock:",
    access: Access::InProcess,
};

/// Frames that a ring holds: more than 7 s of one direction.
const RING_FRAMES: usize = 8192;

/// Host end and rig end.
pub(crate) fn pair() -> (Link, Link) {
    let [(host_out, rig_in), (rig_out, host_in)] =
        [(); 2].map(|()| ring::touched(RING_FRAMES, || Frame::new(0, &[])));
    let end = |out, inbox| Link::over(Rings { out, inbox }, Arc::new(LinkHealth::opened()));
    (end(host_out, host_in), end(rig_out, rig_in))
}

/// Host end of a rig that does not run by itself: `tick` is its next tick on its end of the link, and whoever polls the host
/// end calls [`Link::step_far_end`]. So a busy computer stops rig and host together, and neither looks broken to the other.
pub(crate) fn stepped(mut tick: impl FnMut(&mut Link) + Send + 'static) -> Link {
    let (mut host, mut rig) = pair();
    host.far_end = Some(Box::new(move || tick(&mut rig)));
    host
}

/// The rings of one end.
struct Rings {
    /// To the far end, in order.
    out: rtrb::Producer<Frame>,
    /// From the far end.
    inbox: rtrb::Consumer<Frame>,
}

impl Port for Rings {
    fn send(&mut self, frame: Frame, _urgent: bool, health: &LinkHealth) -> bool {
        let sent = !self.out.is_abandoned() && self.out.push(frame).is_ok();
        if !sent {
            health.send_failures.fetch_add(1, Ordering::Relaxed);
        }
        sent
    }

    fn receive(&mut self, health: &LinkHealth) -> Option<Frame> {
        // Read before the pop, so that frames sent before the far end closed are still delivered.
        let abandoned = self.inbox.is_abandoned();
        let frame = self.inbox.pop().ok();
        if frame.is_none() && abandoned {
            health.open.store(false, Ordering::Relaxed);
        }
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_stepped_far_end_answers_when_it_is_stepped() {
        let mut ticks = 0;
        let mut host = stepped(move |rig| {
            ticks += 1;
            rig.send(Frame::new(0x185, &[ticks]));
        });
        assert!(host.is_stepped() && !pair().0.is_stepped());
        assert_eq!(host.receive(), None);
        host.step_far_end();
        host.step_far_end();
        assert_eq!(host.receive(), Some(Frame::new(0x185, &[1])));
        assert_eq!(host.receive(), Some(Frame::new(0x185, &[2])));
        assert_eq!(host.receive(), None);
    }
}
