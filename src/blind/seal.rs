//! A label locked by its hash: printed before the diagnosis, checked when it is opened.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use crate::truth::Label;

/// Commitment to a label.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Seal {
    /// Number of the case.
    pub number: u64,
    /// Hex SHA-256 of nonce and label; says nothing about the label.
    pub sha256: String,
    #[serde(skip)]
    nonce: [u8; 16],
}

impl Seal {
    /// Locks a label. The nonce comes from a stream of the seed that no case uses.
    pub(crate) fn of(label: &Label, seed: u64) -> Seal {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(u64::MAX - label.number);
        let nonce: [u8; 16] = random.random();
        Seal {
            number: label.number,
            sha256: hash(&nonce, label),
            nonce,
        }
    }

    /// Is this the label that was sealed?
    pub(crate) fn open(&self, label: &Label) -> bool {
        hash(&self.nonce, label) == self.sha256
    }
}

/// One hash over all seals, to be kept with the result.
pub(crate) fn of_all(seals: &[Seal]) -> String {
    let text: Vec<&str> = seals.iter().map(|s| s.sha256.as_str()).collect();
    hex(&Sha256::digest(text.join("\n")))
}

fn hash(nonce: &[u8], label: &Label) -> String {
    let mut hasher = Sha256::new();
    hasher.update(nonce);
    hasher.update(serde_json::to_vec(label).expect("a label is plain data"));
    hex(&hasher.finalize())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::Case;

    #[test]
    fn a_seal_opens_for_its_own_label_only() {
        let label = Case::draw(9, 0, Some(5.0)).label;
        let seal = Seal::of(&label, 9);
        assert!(seal.open(&label));
        let mut other = label.clone();
        other.strength += 1e-9;
        assert!(!seal.open(&other));
        assert_ne!(
            seal.sha256,
            Seal::of(&label, 10).sha256,
            "the nonce depends on the seed"
        );
        assert_eq!(of_all(std::slice::from_ref(&seal)).len(), 64);
    }
}
