//! Secrets of 256 random bits, and their SHA-256, which is all that is stored of them.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Length of a secret, bytes. Nobody guesses 256 random bits, so a hash without salt and without delay is enough.
const SECRET_BYTES: usize = 32;

/// A token, a key, a cookie or the secret of a link: 64 hexadecimal digits.
#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Secret(String);

impl Secret {
    /// A new one from the random numbers of the system.
    pub(crate) fn new() -> io::Result<Secret> {
        let mut bytes = [0; SECRET_BYTES];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(Secret(hex(&bytes)))
    }

    /// A secret from a file; `None` if the text is none.
    pub(crate) fn read(text: &str) -> Option<Secret> {
        let text = text.trim();
        let is_secret = text.len() == 2 * SECRET_BYTES && text.bytes().all(|b| b.is_ascii_hexdigit());
        is_secret.then(|| Secret(text.to_owned()))
    }

    /// The digits, for the one who may know them.
    pub(crate) fn reveal(&self) -> &str {
        &self.0
    }

    /// What is stored of it.
    pub(crate) fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.0)
    }
}

impl fmt::Debug for Secret {
    /// A secret stays out of every log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// SHA-256 of a secret, as 64 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Fingerprint(String);

impl Fingerprint {
    /// That of the text of a request, whatever it is.
    pub(crate) fn of(text: &str) -> Fingerprint {
        Fingerprint(hex(&Sha256::digest(text)))
    }

    /// Compares in a time that does not depend on how much is equal.
    pub(crate) fn is(&self, other: &Fingerprint) -> bool {
        let (a, b) = (self.0.as_bytes(), other.0.as_bytes());
        let difference = a.iter().zip(b).fold(0, |sum, (a, b)| sum | (a ^ b));
        a.len() == b.len() && std::hint::black_box(difference) == 0
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Lower-case hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_differ_and_only_the_same_one_has_its_fingerprint() {
        let (a, b) = (Secret::new().expect("random"), Secret::new().expect("random"));
        assert_ne!(a, b);
        assert!(a.fingerprint().is(&Fingerprint::of(a.reveal())));
        assert!(!a.fingerprint().is(&b.fingerprint()));
        let shorter = &a.reveal()[..63];
        assert!(!a.fingerprint().is(&Fingerprint::of(shorter)));
        assert_eq!(Secret::read(shorter), None);
        assert_eq!(Secret::read(&format!("{}\n", a.reveal())), Some(a));
    }
}
