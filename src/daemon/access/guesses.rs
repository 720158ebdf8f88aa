//! Counts wrong secrets of each peer.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// Wrong secrets that a peer may send within [`WINDOW`]; after them it is answered 429. A person who pastes an old token needs
/// one or two.
pub(crate) const MOST_WRONG: u32 = 5;
/// Time over which wrong secrets are counted.
pub(crate) const WINDOW: Duration = Duration::from_secs(10);
/// Peers that are remembered; beyond that the old ones are forgotten.
const MOST_PEERS: usize = 4096;

/// The wrong secrets of the last seconds.
#[derive(Debug, Default)]
pub(super) struct Guesses {
    peers: HashMap<IpAddr, (Instant, u32)>,
}

impl Guesses {
    /// Notes a wrong secret. Returns how many the peer has sent in its window, this one included.
    pub(super) fn note(&mut self, peer: IpAddr, now: Instant) -> u32 {
        if self.peers.len() >= MOST_PEERS {
            self.peers.retain(|_, (since, _)| is_fresh(*since, now));
            if self.peers.len() >= MOST_PEERS {
                self.peers.clear();
            }
        }
        let entry = self.peers.entry(peer).or_insert((now, 0));
        if !is_fresh(entry.0, now) {
            *entry = (now, 0);
        }
        entry.1 = entry.1.saturating_add(1);
        entry.1
    }
}

fn is_fresh(since: Instant, now: Instant) -> bool {
    now.saturating_duration_since(since) < WINDOW
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_secrets_are_counted_for_each_peer_and_forgotten_after_a_while() {
        let mut guesses = Guesses::default();
        let begun = Instant::now();
        let (a, b) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let counts: Vec<u32> = (0..7).map(|_| guesses.note(a, begun)).collect();
        assert_eq!(counts, [1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(guesses.note(b, begun), 1);
        assert_eq!(guesses.note(a, begun + WINDOW), 1);
        for i in 0..=MOST_PEERS as u32 {
            guesses.note(IpAddr::from(i.to_be_bytes()), begun);
        }
        assert!(guesses.peers.len() <= MOST_PEERS);
    }
}
