//! One frame: an 11-bit identifier and up to 8 bytes, the same over CAN and serial.

use super::cob;

/// A classic CAN data frame, or the same frame in a serial packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Frame {
    /// Identifier (COB-ID), 11 bit.
    pub id: u16,
    /// Bytes used, 0 to 8.
    pub len: u8,
    /// The bytes; those past `len` are zero.
    pub data: [u8; 8],
}

impl Frame {
    /// A frame of `bytes` (at most 8; more are cut off, which the encoders never do).
    pub(crate) fn new(id: u16, bytes: &[u8]) -> Self {
        let len = bytes.len().min(8);
        let mut data = [0; 8];
        data[..len].copy_from_slice(&bytes[..len]);
        Frame {
            id: id & cob::ID_MAX,
            len: len as u8,
            data,
        }
    }

    /// The bytes used.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.len.min(8))]
    }
}
