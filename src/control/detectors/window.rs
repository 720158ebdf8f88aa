//! Counts events within a time window that slides with them.

/// The newest `N` events: true once they lie within the window.
#[derive(Debug, Clone, Copy)]
pub(super) struct Burst<const N: usize> {
    at_ns: [Option<u64>; N],
    next: usize,
}

impl<const N: usize> Default for Burst<N> {
    fn default() -> Self {
        Burst {
            at_ns: [None; N],
            next: 0,
        }
    }
}

impl<const N: usize> Burst<N> {
    /// Takes an event. True if it is the `N`th within `window_ns`.
    pub(super) fn hit(&mut self, now_ns: u64, window_ns: u64) -> bool {
        if let Some(slot) = self.at_ns.get_mut(self.next) {
            *slot = Some(now_ns);
        }
        self.next = (self.next + 1) % N;
        let recent = |at: &Option<u64>| at.is_some_and(|at| now_ns.saturating_sub(at) < window_ns);
        self.at_ns.iter().all(recent)
    }
}

/// Pieces of a [`Rate`]'s window.
const PIECES: usize = 10;

/// Sums of two counts over a window in ten pieces, the oldest of which drops out as time goes on.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rate {
    pieces: [[u64; 2]; PIECES],
    /// Number of the piece that is being filled, since time 0.
    newest: u64,
}

impl Rate {
    /// Adds to both counts and returns their sums over the last `window_ns`.
    pub(super) fn add(&mut self, counts: [u64; 2], now_ns: u64, window_ns: u64) -> [u64; 2] {
        let piece = now_ns / (window_ns / PIECES as u64).max(1);
        let passed = piece.saturating_sub(self.newest).min(PIECES as u64);
        for old in 0..passed {
            self.pieces[((piece - old) % PIECES as u64) as usize] = [0, 0];
        }
        self.newest = self.newest.max(piece);
        let filled = &mut self.pieces[(self.newest % PIECES as u64) as usize];
        for (sum, count) in filled.iter_mut().zip(counts) {
            *sum = sum.saturating_add(count);
        }
        self.pieces.iter().fold([0, 0], |[a, b], piece| {
            [a.saturating_add(piece[0]), b.saturating_add(piece[1])]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{NS_PER_MS, NS_PER_S};

    #[test]
    fn three_within_the_window_are_a_burst_three_beyond_it_are_none() {
        let mut burst = Burst::<3>::default();
        let mut hit = |ms: u64| burst.hit(ms * NS_PER_MS, 100 * NS_PER_MS);
        assert!(!hit(0) && !hit(60) && !hit(120), "120 ms apart");
        assert!(hit(130), "60, 120 and 130 ms");
    }

    #[test]
    fn the_rate_forgets_what_is_older_than_its_window() {
        let mut rate = Rate::default();
        assert_eq!(rate.add([8, 100], 0, NS_PER_S), [8, 100]);
        assert_eq!(rate.add([3, 0], 900 * NS_PER_MS, NS_PER_S), [11, 100]);
        assert_eq!(rate.add([0, 1], 1000 * NS_PER_MS, NS_PER_S), [3, 1]);
        assert_eq!(rate.add([1, 1], 60 * NS_PER_S, NS_PER_S), [1, 1]);
    }

    #[test]
    fn a_gap_across_the_start_of_a_piece_is_counted_once() {
        let mut rate = Rate::default();
        rate.add([6, 0], 990 * NS_PER_MS, NS_PER_S);
        assert_eq!(
            rate.add([6, 0], 1010 * NS_PER_MS, NS_PER_S),
            [12, 0],
            "20 ms apart"
        );
    }
}
