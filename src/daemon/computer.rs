//! What happens to the computer of the daemon: memory that grows without end, and a wall clock that is set. Nothing that moves the
//! rig depends on either; both are told, and a set clock is written into the run under way.

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use super::orders;
use super::state::DaemonState;
use crate::control::realtime::Request;

/// Time between two looks.
const LOOK_PERIOD: Duration = Duration::from_secs(5);
/// Memory in use is compared with that after this time: until then caches fill (fault D5).
const SETTLED_AFTER: Duration = Duration::from_secs(60);
/// More than this many times the memory at the start is told.
const MEMORY_FACTOR: u64 = 2;
/// Less growth than this is no leak, bytes: a list of runs or a page of a diagnosis takes as much for a while.
const MEMORY_LEAST_BYTES: u64 = 200 << 20;
/// The wall clock was set if it went otherwise than the monotonic clock by more than this, s (fault O2). NTP slews by less than
/// 0.01 s in a period.
const STEP_S: f64 = 0.5;

/// Finds memory in use that has doubled.
#[derive(Debug, Default)]
struct MemoryWatch {
    start_bytes: Option<u64>,
    told: bool,
}

impl MemoryWatch {
    /// Takes the memory in use. Returns the alarm, once.
    fn take(&mut self, bytes: u64, since_start: Duration) -> Option<String> {
        if since_start < SETTLED_AFTER {
            return None;
        }
        let start = *self.start_bytes.get_or_insert(bytes);
        let limit = (MEMORY_FACTOR * start).max(start + MEMORY_LEAST_BYTES);
        if self.told || bytes <= limit {
            return None;
        }
        self.told = true;
        Some(format!(
            "the daemon uses {} MB of memory, {} MB after its start: restart it between two tests, and report this as a defect",
            bytes >> 20,
            start >> 20
        ))
    }
}

/// Finds steps of the wall clock.
#[derive(Debug, Default)]
struct ClockWatch {
    /// Wall clock minus monotonic clock at the last look, s.
    offset_s: Option<f64>,
}

impl ClockWatch {
    /// Takes the time of both clocks in s. Returns the event if the wall clock was set since the last look.
    fn take(&mut self, wall_s: f64, monotonic_s: f64) -> Option<String> {
        let offset_s = wall_s - monotonic_s;
        let step_s = offset_s - self.offset_s.replace(offset_s)?;
        (step_s.abs() > STEP_S).then(|| {
            format!(
                "the clock of this computer was set by {step_s:+.1} s: times in the recording are those of the rig and do not change"
            )
        })
    }
}

/// Memory of this process in bytes; `None` where the system does not say.
fn memory_bytes() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

/// Looks at memory and clock until the daemon ends.
pub(super) async fn watch(state: Arc<DaemonState>) {
    let start = Instant::now();
    let (mut memory, mut clock) = (MemoryWatch::default(), ClockWatch::default());
    loop {
        let since_start = start.elapsed();
        if let Some(text) = memory_bytes().and_then(|bytes| memory.take(bytes, since_start)) {
            tracing::warn!("{text}");
            note(&state, text).await;
        }
        let wall_s = SystemTime::UNIX_EPOCH
            .elapsed()
            .map_or(0.0, |since| since.as_secs_f64());
        if let Some(text) = clock.take(wall_s, start.elapsed().as_secs_f64()) {
            tracing::warn!("{text}");
            note(&state, text).await;
        }
        tokio::time::sleep(LOOK_PERIOD).await;
    }
}

/// Writes an event into the run under way, if there is one.
async fn note(state: &DaemonState, text: String) {
    if let Err(error) = orders::insist(&state.control, || Request::Note(text.clone())).await {
        tracing::warn!("control did not take a note: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn d5_memory_that_doubles_is_told_once() {
        const MB: u64 = 1 << 20;
        let mut watch = MemoryWatch::default();
        let mut take = |mb: u64, s: u64| watch.take(mb * MB, Duration::from_secs(s));
        assert_eq!(take(900, 1), None, "before it has settled");
        assert_eq!(take(150, 61), None);
        assert_eq!(take(340, 100), None, "twice as much, but not much");
        let told = take(360, 105).expect("350 MB are the limit");
        assert!(
            told.contains("360 MB") && told.contains("150 MB after its start"),
            "{told}"
        );
        assert_eq!(take(5000, 110), None, "once");
        assert!(
            memory_bytes().is_some_and(|bytes| bytes > MB),
            "the system says it"
        );
    }

    #[test]
    fn o2_a_clock_that_is_set_is_told_with_its_step() {
        let mut watch = ClockWatch::default();
        assert_eq!(watch.take(1000.0, 0.0), None);
        assert_eq!(watch.take(1005.01, 5.0), None, "slewed");
        let told = watch.take(4610.0, 10.0).expect("an hour");
        assert!(told.contains("+3600.0 s"), "{told}");
        assert!(
            watch
                .take(1015.0, 15.0)
                .is_some_and(|told| told.contains("-3600.0 s"))
        );
        assert_eq!(watch.take(1020.0, 20.0), None, "each step once");
    }
}
