//! What the real links share: the rings' far ends and the thread that serves them, with a runtime of its own so that a
//! busy daemon cannot delay it. What bytes go out is up to `can` and `serial`.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::runtime::Runtime;

use super::rings::{Outlet, Rings};
use super::wake::{self, Sleep, Wakeup};
use super::{Arrival, Link, LinkHealth, RING_FRAMES, Wire, now_ns};
use crate::protocol::frame::Frame;

/// The task's ends of a link's rings.
pub(super) struct Ends {
    pub out: Lane,
    pub urgent: Lane,
    pub inlet: Inlet,
}

/// Frames from the control thread.
pub(super) struct Lane {
    ring: rtrb::Consumer<Arrival>,
    wakeup: Wakeup,
}

/// Frames to the control thread, and the link's counters.
pub(super) struct Inlet {
    ring: rtrb::Producer<Arrival>,
    pub health: Arc<LinkHealth>,
}

/// A runtime for one link's thread.
pub(super) fn runtime() -> io::Result<Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
}

/// The link that `serve` serves, on a thread called `name`, until it returns.
pub(super) fn start<S>(
    name: &str,
    runtime: Runtime,
    serve: impl FnOnce(Ends) -> S + Send + 'static,
) -> io::Result<Link>
where
    S: Future<Output = ()>,
{
    let health = Arc::new(LinkHealth::opened());
    let (inbox_end, inbox) = rtrb::RingBuffer::new(RING_FRAMES);
    let inlet = Inlet {
        ring: inbox_end,
        health: Arc::clone(&health),
    };
    let (out, out_ring, out_sleep) = outlet()?;
    let (urgent, urgent_ring, urgent_sleep) = outlet()?;
    let ends = {
        let _inside = runtime.enter();
        Ends {
            out: lane(out_ring, out_sleep)?,
            urgent: lane(urgent_ring, urgent_sleep)?,
            inlet,
        }
    };
    let service = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        // Frames must not wait behind ordinary programs. Where it is not allowed control says so for itself.
        let _ = super::priority::raise_this_thread();
        runtime.block_on(serve(ends));
    })?;
    let urgent = Some(urgent);
    Ok(Link {
        health,
        wire: Wire::Rings(Rings {
            out,
            urgent,
            inbox,
            clock: None,
            service: Some(service),
        }),
    })
}

fn outlet() -> io::Result<(Outlet, rtrb::Consumer<Arrival>, Sleep)> {
    let (ring, end) = rtrb::RingBuffer::new(RING_FRAMES);
    let (waker, sleep) = wake::pair()?;
    Ok((
        Outlet {
            ring,
            waker: Some(waker),
        },
        end,
        sleep,
    ))
}

fn lane(ring: rtrb::Consumer<Arrival>, sleep: Sleep) -> io::Result<Lane> {
    Ok(Lane {
        ring,
        wakeup: sleep.wakeup()?,
    })
}

impl Lane {
    /// The next frame; none once the link was dropped and all is sent. Safe to cancel.
    pub(super) async fn next(&mut self) -> Option<Frame> {
        loop {
            if let Ok(arrival) = self.ring.pop() {
                return Some(arrival.frame);
            }
            if self.wakeup.wait().await.is_err() {
                return self.ring.pop().ok().map(|arrival| arrival.frame);
            }
        }
    }

    /// Throws away what waits, and returns how many frames that were: a late frame is worse than a lost one.
    pub(super) fn discard(&mut self) -> u64 {
        let mut discarded = 0;
        while self.ring.pop().is_ok() {
            discarded += 1;
        }
        discarded
    }
}

impl Inlet {
    /// Hands `frame` to the control thread, stamped now.
    pub(super) fn deliver(&mut self, frame: Frame) {
        if self
            .ring
            .push(Arrival {
                frame,
                at_ns: now_ns(),
            })
            .is_err()
        {
            self.health.overflows.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for Inlet {
    fn drop(&mut self) {
        self.health.open.store(false, Ordering::Relaxed);
    }
}
