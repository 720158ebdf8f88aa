//! Real-time priority for the threads between rig and control. If one of them waits behind ordinary programs, all of
//! them do.

use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Above ordinary programs, below the kernel's own interrupt threads (50).
const FIFO_PRIORITY: u8 = 40;

/// Puts the calling thread under SCHED_FIFO. Where the system does not allow it, the thread stays as it is and the
/// reason is returned.
pub(crate) fn raise_this_thread() -> Result<(), String> {
    let priority = ThreadPriorityValue::try_from(FIFO_PRIORITY).map_err(|e| format!("{e:?}"))?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|e| format!("{e:?}"))
}
