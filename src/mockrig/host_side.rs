//! What the firmware knows of the host: its session, the lease, the last request, and the counters of its frames. `requests`
//! handles the messages.

use crate::protocol::message::{RequestMessage, RequestResult};
use crate::protocol::protection::CounterCheck;
use crate::protocol::tick::ticks_in_ms;

/// State of the connection to the host.
#[derive(Debug, Clone, Default)]
pub(crate) struct HostSide {
    /// Session that owns the rig; 0 = none.
    pub session: u8,
    /// Counter of the newest request and its result.
    pub ack: Option<(u8, RequestResult)>,
    pub last_request: Option<RequestMessage>,
    pub renewed_at: u64,
    pub control_tick: Option<u16>,
    pub leases: CounterCheck,
    pub commands: CounterCheck,
    pub corrupt: FrameBurst<3>,
    pub foreign: FrameBurst<6>,
    pub dropped: Dropped,
}

/// Frames that were not used since boot, as the host reads them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Dropped {
    /// Wrong CRC-8, reserved bit, unknown value, wrong sequence.
    pub refused: u32,
    /// Commands that were late, too far ahead, or came in a wrong state.
    pub commands: u32,
    /// LEASE and COMMAND of another session.
    pub foreign: u32,
}

/// Detects `N` events within [`BURST_TICKS`].
#[derive(Debug, Clone)]
pub(super) struct FrameBurst<const N: usize> {
    at: [Option<u64>; N],
    next: usize,
}

/// Window of the frame fault counters: 100 ms.
const BURST_TICKS: u64 = ticks_in_ms(100);

impl<const N: usize> Default for FrameBurst<N> {
    fn default() -> Self {
        FrameBurst {
            at: [None; N],
            next: 0,
        }
    }
}

impl<const N: usize> FrameBurst<N> {
    /// Takes an event. Returns true if it is the `N`th within the window.
    pub(super) fn hit(&mut self, tick: u64) -> bool {
        if let Some(slot) = self.at.get_mut(self.next) {
            *slot = Some(tick);
        }
        self.next = (self.next + 1) % N;
        self.at
            .iter()
            .all(|at| at.is_some_and(|at| tick - at < BURST_TICKS))
    }
}
