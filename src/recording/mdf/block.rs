//! The blocks of an MDF 4.1 file: each has a head of 24 bytes, links to other blocks, and data. A link is the address of a block
//! in the file; blocks begin at multiples of 8 bytes.

use std::io::{self, Write};

/// Bytes of the head of a block: `##`, kind, 4 reserved bytes, length, number of links.
pub(super) const HEAD_BYTES: u64 = 24;
/// Bytes of the identification at the start of the file.
const IDENTIFICATION_BYTES: u64 = 64;
/// Version of the format: 4.10.
const VERSION: u16 = 410;
/// The name space of all comments.
const NAME_SPACE: &str = "http://www.asam.net/mdf/v4";

/// A block of the file that is being built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MdfBlockId(usize);

struct MdfBlock {
    kind: &'static str,
    links: Vec<Option<MdfBlockId>>,
    data: Vec<u8>,
}

impl MdfBlock {
    fn bytes(&self) -> u64 {
        HEAD_BYTES + 8 * self.links.len() as u64 + self.data.len() as u64
    }
}

/// The blocks of a file in the order of their addresses.
#[derive(Default)]
pub(super) struct MdfBlocks {
    blocks: Vec<MdfBlock>,
}

impl MdfBlocks {
    /// Adds a block of a kind such as `CN`; a link is `None` if there is no such block.
    pub(super) fn add(
        &mut self,
        kind: &'static str,
        links: Vec<Option<MdfBlockId>>,
        data: Vec<u8>,
    ) -> MdfBlockId {
        self.blocks.push(MdfBlock { kind, links, data });
        MdfBlockId(self.blocks.len() - 1)
    }

    /// Replaces a link of a block: for chains and circles, where the target is added later.
    pub(super) fn link(&mut self, from: MdfBlockId, place: usize, to: MdfBlockId) {
        let links = self.blocks.get_mut(from.0).map(|block| &mut block.links);
        if let Some(link) = links.and_then(|links| links.get_mut(place)) {
            *link = Some(to);
        }
    }

    /// A block with plain text.
    pub(super) fn text(&mut self, text: &str) -> MdfBlockId {
        self.add("TX", Vec::new(), terminated(text))
    }

    /// A block with a comment: `root` is the element that the format wants here, `content` its XML.
    pub(super) fn xml(&mut self, root: &str, content: &str) -> MdfBlockId {
        let xml = format!("<{root} xmlns=\"{NAME_SPACE}\">{content}</{root}>");
        self.add("MD", Vec::new(), terminated(&xml))
    }

    /// Addresses of all blocks.
    fn addresses(&self) -> Vec<u64> {
        let mut next = IDENTIFICATION_BYTES;
        let place = |block: &MdfBlock| {
            let address = next;
            next = (address + block.bytes()).next_multiple_of(8);
            address
        };
        self.blocks.iter().map(place).collect()
    }

    /// Address of one block.
    pub(super) fn address(&self, of: MdfBlockId) -> u64 {
        self.addresses().get(of.0).copied().unwrap_or(0)
    }

    /// Writes the identification and all blocks. Nothing follows the last block, so that its data can be continued.
    pub(super) fn write(&self, sink: &mut impl Write) -> io::Result<()> {
        let addresses = self.addresses();
        sink.write_all(&identification())?;
        let mut at = IDENTIFICATION_BYTES;
        for (block, &address) in self.blocks.iter().zip(&addresses) {
            let gap = [0; 8];
            sink.write_all(gap.get(..(address - at) as usize).unwrap_or_default())?;
            sink.write_all(b"##")?;
            sink.write_all(block.kind.as_bytes())?;
            sink.write_all(&[0; 4])?;
            sink.write_all(&block.bytes().to_le_bytes())?;
            sink.write_all(&(block.links.len() as u64).to_le_bytes())?;
            for link in &block.links {
                let target = link.and_then(|id| addresses.get(id.0)).copied();
                sink.write_all(&target.unwrap_or(0).to_le_bytes())?;
            }
            sink.write_all(&block.data)?;
            at = address + block.bytes();
        }
        Ok(())
    }
}

/// The first 64 bytes: file, version and program in text, version as a number, no sign of an unfinished file.
fn identification() -> [u8; IDENTIFICATION_BYTES as usize] {
    let mut bytes = [0; IDENTIFICATION_BYTES as usize];
    bytes[..24].copy_from_slice(b"MDF     4.10    leafbnch");
    bytes[28..30].copy_from_slice(&VERSION.to_le_bytes());
    bytes
}

/// UTF-8 with a zero at its end, filled with zeros to a multiple of 8 bytes.
fn terminated(text: &str) -> Vec<u8> {
    let mut bytes: Vec<u8> = text.bytes().filter(|&byte| byte != 0).collect();
    bytes.resize((bytes.len() + 1).next_multiple_of(8), 0);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_laid_out_as_by_hand() {
        let mut blocks = MdfBlocks::default();
        let head = blocks.add("HD", vec![None, None], vec![7; 3]);
        let text = blocks.text("N\u{b7}m");
        blocks.link(head, 1, text);
        let mut file = Vec::new();
        blocks.write(&mut file).unwrap();
        let mut wanted = b"MDF     4.10    leafbnch\0\0\0\0\x9a\x01".to_vec();
        wanted.resize(64, 0);
        // HD: 24 + 2 * 8 + 3 = 43 bytes from address 64, then 5 bytes to the next multiple of 8: TX is at 112 = 0x70.
        wanted.extend(b"##HD\0\0\0\0\x2b\0\0\0\0\0\0\0\x02\0\0\0\0\0\0\0");
        wanted.extend(b"\0\0\0\0\0\0\0\0\x70\0\0\0\0\0\0\0\x07\x07\x07\0\0\0\0\0");
        // TX: 24 + 8 bytes; the text has 4 bytes and a zero, and is filled to 8.
        wanted.extend(b"##TX\0\0\0\0\x20\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0N\xc2\xb7m\0\0\0\0");
        assert_eq!(file, wanted);
        assert_eq!((blocks.address(head), blocks.address(text)), (64, 112));
    }

    #[test]
    fn a_text_ends_with_a_zero_and_has_none_inside() {
        assert_eq!(terminated("12345678").len(), 16);
        assert_eq!(terminated("1234567"), b"1234567\0");
        assert_eq!(terminated("a\0b"), b"ab\0\0\0\0\0\0");
    }
}
