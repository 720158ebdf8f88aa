//! How long a stream of frames has been silent, by what this computer's own polls can tell.

use crate::units::NS_PER_MS;

/// Longest time that one pause between two polls adds to the silence, ns.
const PAUSE_MAX_NS: u64 = 5 * NS_PER_MS;

/// Silence of one kind of frame. If this process was stopped, it could not receive; so a pause between two polls counts as
/// [`PAUSE_MAX_NS`] at most. The firmware's lease covers longer pauses.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Silence {
    /// Time that polls without a frame have covered; `None` before the first frame.
    silent_ns: Option<u64>,
    /// A frame came since the last poll ended.
    heard: bool,
}

impl Silence {
    /// A frame came.
    pub(super) fn hear(&mut self) {
        self.heard = true;
    }

    /// Forgets the stream: it counts as silent only after its next frame.
    pub(super) fn forget(&mut self) {
        *self = Silence::default();
    }

    /// Ends a poll that came `pause_ns` after the one before. The pause before a frame is no silence.
    pub(super) fn end_poll(&mut self, pause_ns: u64) {
        if std::mem::take(&mut self.heard) {
            self.silent_ns = Some(0);
        } else if let Some(silent_ns) = &mut self.silent_ns {
            *silent_ns += pause_ns.min(PAUSE_MAX_NS);
        }
    }

    /// Milliseconds of silence, if they exceed `limit_ms`.
    pub(super) fn beyond_ms(&self, limit_ms: u64) -> Option<u64> {
        let silent_ns = self.silent_ns.filter(|ns| *ns > limit_ms * NS_PER_MS)?;
        Some(silent_ns / NS_PER_MS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pause_before_a_frame_is_no_silence() {
        let mut silence = Silence::default();
        silence.hear();
        silence.end_poll(5 * NS_PER_MS);
        for _ in 0..20 {
            silence.end_poll(NS_PER_MS);
            assert_eq!(silence.beyond_ms(20), None);
        }
        silence.end_poll(NS_PER_MS);
        assert_eq!(silence.beyond_ms(20), Some(21), "not a millisecond early");
    }

    #[test]
    fn nothing_is_silent_before_its_first_frame() {
        let mut silence = Silence::default();
        (0..1000).for_each(|_| silence.end_poll(NS_PER_MS));
        assert_eq!(silence.beyond_ms(20), None);
    }

    #[test]
    fn a_pause_of_the_host_itself_is_no_silence() {
        let mut silence = Silence::default();
        silence.hear();
        silence.end_poll(0);
        silence.end_poll(500 * NS_PER_MS);
        assert_eq!(silence.beyond_ms(20), None);
    }
}
