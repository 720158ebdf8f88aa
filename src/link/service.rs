//! The thread that serves a link's rings, with a runtime of its own so that a busy daemon cannot delay it. Which bytes are
//! sent and received is left to the link (`serial`).

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::runtime::Runtime;

use super::rings::{Outlet, Rings};
use super::wake::{self, Sleep, Wakeup};
use super::{Link, LinkHealth, RING_FRAMES};
use crate::protocol::frame::Frame;

/// The task's ends of a link's rings.
pub(super) struct Ends {
    pub out: Lane,
    pub urgent: Lane,
    pub inlet: Inlet,
}

/// Frames from the control thread.
pub(super) struct Lane {
    ring: rtrb::Consumer<Frame>,
    wakeup: Wakeup,
}

/// Frames to the control thread, and the link's counters.
pub(super) struct Inlet {
    ring: rtrb::Producer<Frame>,
    pub health: Arc<LinkHealth>,
}

/// A runtime for one link's thread.
pub(super) fn runtime() -> io::Result<Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
}

/// The link that `serve` serves on a thread called `name`. The thread ends when `serve` returns: when the [`Link`] is
/// dropped and all is sent, or when the other end is closed.
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
    let open = Open(Arc::clone(&health));
    std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        let _open = open;
        // Where real-time priority is not allowed, the control thread reports it.
        let _ = super::priority::raise_this_thread();
        runtime.block_on(serve(ends));
        drop(runtime);
    })?;
    let rings = Rings {
        out,
        urgent: Some(urgent),
        inbox,
    };
    Ok(Link::over(rings, health))
}

/// The link is open as long as this exists. It is dropped last, so that the port is free once the link is closed, also
/// after a panic.
struct Open(Arc<LinkHealth>);

impl Drop for Open {
    fn drop(&mut self) {
        self.0.open.store(false, Ordering::Relaxed);
    }
}

fn outlet() -> io::Result<(Outlet, rtrb::Consumer<Frame>, Sleep)> {
    let (ring, end) = rtrb::RingBuffer::new(RING_FRAMES);
    let (waker, sleep) = wake::pair()?;
    let outlet = Outlet {
        ring,
        waker: Some(waker),
    };
    Ok((outlet, end, sleep))
}

fn lane(ring: rtrb::Consumer<Frame>, sleep: Sleep) -> io::Result<Lane> {
    Ok(Lane {
        ring,
        wakeup: sleep.wakeup()?,
    })
}

impl Lane {
    /// The next frame; `None` once the link was dropped and all is sent. Safe to cancel.
    pub(super) async fn next(&mut self) -> Option<Frame> {
        loop {
            if let Ok(frame) = self.ring.pop() {
                return Some(frame);
            }
            if self.wakeup.wait().await.is_err() {
                return self.ring.pop().ok();
            }
        }
    }

    /// Drops the waiting frames and returns how many there were. A late frame is worse than a lost one.
    pub(super) fn discard(&mut self) -> u64 {
        let mut discarded = 0;
        while self.ring.pop().is_ok() {
            discarded += 1;
        }
        discarded
    }
}

impl Inlet {
    /// Hands `frame` to the control thread.
    pub(super) fn deliver(&mut self, frame: Frame) {
        if self.ring.push(frame).is_err() {
            self.health.overflows.fetch_add(1, Ordering::Relaxed);
        }
    }
}
