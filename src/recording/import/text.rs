//! The bytes of a foreign file as text, with line ends of one kind.

use super::error::ImportError;

/// How the bytes of a file were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(crate) enum TextEncoding {
    #[serde(rename = "UTF-8")]
    Utf8,
    #[serde(rename = "UTF-16")]
    Utf16,
    /// Latin-1 with the letters that Windows adds to it.
    #[serde(rename = "Windows-1252")]
    Windows1252,
}

impl TextEncoding {
    /// The common name of the encoding.
    pub(crate) fn name(self) -> &'static str {
        match self {
            TextEncoding::Utf8 => "UTF-8",
            TextEncoding::Utf16 => "UTF-16",
            TextEncoding::Windows1252 => "Windows-1252",
        }
    }
}

/// Windows-1252 from 0x80 to 0x9F; all other bytes are those of Latin-1, whose numbers are those of Unicode.
const WINDOWS_1252: [char; 32] = [
    '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}', '\u{90}',
    '‘', '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
];

/// The text of a file without its byte order mark. Bytes that are no UTF-8 are Windows-1252.
pub(super) fn decode(name: &str, bytes: &[u8]) -> Result<(String, TextEncoding), ImportError> {
    let (text, encoding) = match bytes {
        [0xff, 0xfe, rest @ ..] => (utf_16(rest, u16::from_le_bytes), TextEncoding::Utf16),
        [0xfe, 0xff, rest @ ..] => (utf_16(rest, u16::from_be_bytes), TextEncoding::Utf16),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => (text.trim_start_matches('\u{feff}').to_owned(), TextEncoding::Utf8),
            Err(_) => (
                bytes.iter().map(|&byte| windows_1252(byte)).collect(),
                TextEncoding::Windows1252,
            ),
        },
    };
    if let Some(at) = text.find('\0') {
        let row = 1 + text.bytes().take(at).filter(|&byte| byte == b'\n').count();
        return Err(ImportError::Binary {
            name: name.to_owned(),
            row,
        });
    }
    // Programs of old end a line with \r alone.
    match text.contains('\n') {
        true => Ok((text, encoding)),
        false => Ok((text.replace('\r', "\n"), encoding)),
    }
}

fn utf_16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let (pairs, _) = bytes.as_chunks::<2>();
    let units = pairs.iter().map(|&pair| unit(pair));
    char::decode_utf16(units)
        .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
        .collect()
}

fn windows_1252(byte: u8) -> char {
    match byte {
        0x80..=0x9f => WINDOWS_1252[usize::from(byte - 0x80)],
        byte => char::from(byte),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_common_encoding_gives_the_same_text() {
        let wanted = "Länge µm";
        let utf_16: Vec<u8> = [0xfeff_u16]
            .into_iter()
            .chain(wanted.encode_utf16())
            .flat_map(u16::to_le_bytes)
            .collect();
        let big_end: Vec<u8> = [0xfeff_u16]
            .into_iter()
            .chain(wanted.encode_utf16())
            .flat_map(u16::to_be_bytes)
            .collect();
        let with_mark = format!("\u{feff}{wanted}");
        for (bytes, encoding) in [
            (wanted.as_bytes(), TextEncoding::Utf8),
            (with_mark.as_bytes(), TextEncoding::Utf8),
            (b"L\xe4nge \xb5m", TextEncoding::Windows1252),
            (&utf_16, TextEncoding::Utf16),
            (&big_end, TextEncoding::Utf16),
        ] {
            assert_eq!(
                decode("f", bytes).expect("text"),
                (wanted.to_owned(), encoding),
                "{bytes:?}"
            );
        }
        assert_eq!(decode("f", b"\x80 a\rb").expect("text").0, "€ a\nb");
    }

    #[test]
    fn a_binary_file_is_refused_with_its_row() {
        let error = decode("f.xls", b"PK\n\0\x01").expect_err("binary");
        assert!(error.to_string().starts_with("f.xls, row 2: "), "{error}");
    }
}
