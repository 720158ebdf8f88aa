//! Changes of an input: bits and bytes, numbers, lines, pieces of other inputs, words of the format.

use rand::{Rng, RngExt};

/// Values at which numbers go wrong.
const BYTES: [u8; 9] = [0, 1, 0x7F, 0x80, 0xFF, b'\n', b'"', b',', b'-'];
/// The same as text.
const NUMBERS: [&str; 18] = [
    "0",
    "-0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e-320",
    "1e999",
    "nan",
    "inf",
    "-inf",
    "255",
    "65536",
    "4294967296",
    "9223372036854775808",
    "-9223372036854775809",
    "0.1",
    "1_000",
];
/// Longest input in bytes.
pub const LONGEST: usize = 16 * 1024;

/// Where `len` bytes can be cut or entered.
fn place(rng: &mut impl Rng, len: usize) -> usize {
    rng.random_range(0..=len)
}

/// A range within `len`, mostly a short one.
fn piece(rng: &mut impl Rng, len: usize) -> std::ops::Range<usize> {
    let from = place(rng, len);
    let most = if rng.random_ratio(1, 8) { len } else { 16 };
    from..(from + rng.random_range(0..=most)).min(len)
}

/// The run of digits, or the line, around a random place.
fn around(rng: &mut impl Rng, input: &[u8], belongs: impl Fn(u8) -> bool) -> Option<std::ops::Range<usize>> {
    if input.is_empty() {
        return None;
    }
    let at = rng.random_range(0..input.len());
    let from = (at..input.len()).find(|i| belongs(input[*i]))?;
    let first = (0..from).rev().find(|i| !belongs(input[*i])).map_or(0, |i| i + 1);
    let end = (from..input.len())
        .find(|i| !belongs(input[*i]))
        .unwrap_or(input.len());
    Some(first..end)
}

/// Drops a line, writes it twice, or moves it.
fn change_line(rng: &mut impl Rng, input: &mut Vec<u8>) {
    let Some(line) = around(rng, input, |byte| byte != b'\n') else {
        return;
    };
    let text = input[line.clone()].to_vec();
    match rng.random_range(0..3) {
        0 => drop(input.drain(line)),
        1 => drop(input.splice(line.end..line.end, [b"\n".to_vec(), text].concat())),
        _ => {
            input.drain(line);
            let at = place(rng, input.len());
            input.splice(at..at, text);
        }
    }
}

/// Changes `input` once. `other` is another input of the corpus, `words` are words of the format.
fn change(rng: &mut impl Rng, input: &mut Vec<u8>, other: &[u8], words: &[&str]) {
    let is_number = |byte: u8| byte.is_ascii_digit() || b".+-eE".contains(&byte);
    match rng.random_range(0..12) {
        0 if !input.is_empty() => {
            let at = rng.random_range(0..input.len());
            input[at] ^= 1 << rng.random_range(0..8);
        }
        1 if !input.is_empty() => {
            let at = rng.random_range(0..input.len());
            input[at] = rng.random();
        }
        2 if !input.is_empty() => {
            let at = rng.random_range(0..input.len());
            input[at] = BYTES[rng.random_range(0..BYTES.len())];
        }
        3 => {
            let cut = piece(rng, input.len());
            input.drain(cut);
        }
        4 => {
            let copied = input[piece(rng, input.len())].to_vec();
            let at = place(rng, input.len());
            input.splice(at..at, copied);
        }
        5 => {
            let taken = other[piece(rng, other.len())].to_vec();
            let at = place(rng, input.len());
            input.splice(at..at, taken);
        }
        6 => {
            // The head of one and the tail of another.
            let at = place(rng, input.len().min(other.len()));
            input.truncate(at);
            input.extend_from_slice(&other[at..]);
        }
        7 | 8 => {
            if let Some(number) = around(rng, input, is_number) {
                input.splice(number, NUMBERS[rng.random_range(0..NUMBERS.len())].bytes());
            }
        }
        9 => change_line(rng, input),
        _ if !words.is_empty() => {
            let word = words[rng.random_range(0..words.len())];
            let at = place(rng, input.len());
            // Now and then many of it: deep nesting, long runs.
            let times = if rng.random_ratio(1, 32) { 1000 } else { 1 };
            input.splice(at..at, word.repeat(times).into_bytes());
        }
        _ => input.truncate(place(rng, input.len())),
    }
}

/// A new input from `base`.
pub fn mutate(rng: &mut impl Rng, base: &[u8], other: &[u8], words: &[&str]) -> Vec<u8> {
    let mut input = base.to_vec();
    // Mostly one change, so that what is checked first does not refuse everything.
    let changes = 1 + rng.random_range(0..2_u32) * rng.random_range(0..6_u32);
    for _ in 0..changes {
        change(rng, &mut input, other, words);
    }
    input.truncate(LONGEST);
    input
}
