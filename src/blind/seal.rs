//! Sealed labels: the hash of each label is printed before the diagnosis and checked after it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use crate::truth::Label;

/// Hash of a label, so that the label cannot be changed after the diagnosis.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub(crate) struct SealedLabel {
    /// Number of the case.
    pub number: u64,
    /// SHA-256 of nonce and label, in hexadecimal. With the nonce, equal labels have different hashes.
    pub sha256: String,
    #[serde(skip)]
    nonce: [u8; 16],
}

impl SealedLabel {
    /// Seals a label. The nonce is from a random stream of the seed that no case uses.
    pub(crate) fn new(label: &Label, seed: u64) -> SealedLabel {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(u64::MAX - label.number);
        let nonce: [u8; 16] = random.random();
        SealedLabel {
            number: label.number,
            sha256: hash(&nonce, label),
            nonce,
        }
    }

    /// True if this is the label that was sealed.
    pub(crate) fn matches(&self, label: &Label) -> bool {
        hash(&self.nonce, label) == self.sha256
    }
}

/// SHA-256 over the hashes of all labels, in hexadecimal.
pub(crate) fn hash_of_all(seals: &[SealedLabel]) -> String {
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
    use crate::truth::{Case, World};

    #[test]
    fn a_sealed_label_matches_that_label_only() {
        let label = Case::draw(World::Own, 9, 0, Some(5.0)).label;
        let seal = SealedLabel::new(&label, 9);
        assert!(seal.matches(&label));
        let mut other = label.clone();
        other.strength += 1e-9;
        assert!(!seal.matches(&other));
        assert_ne!(
            seal.sha256,
            SealedLabel::new(&label, 10).sha256,
            "the nonce depends on the seed"
        );
        assert_eq!(hash_of_all(std::slice::from_ref(&seal)).len(), 64);
    }
}
