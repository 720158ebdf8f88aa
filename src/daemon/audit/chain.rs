//! The lines of the audit log. Each one has the hash of the line before: a line that was changed, removed or moved shows.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::super::access::secret::hex;

/// What stands in place of the hash of the line before the first one.
pub(crate) const FIRST: &str = "first";

/// What was done, as the daemon notes it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct Deed {
    /// Name of the token, `owner` for the owner's, `daemon` for what the daemon did by itself, `nobody` without a token.
    pub who: String,
    /// Role of the token; empty without one.
    pub role: String,
    /// Address of the other computer, or loopback; empty for the daemon itself.
    pub from: String,
    /// The client in its own words, such as the page of an operator; nobody checks it.
    pub client: String,
    /// Method and path of the request, or what the daemon did.
    pub what: String,
    /// Profile, reason, override, or why it was refused.
    pub detail: String,
    /// HTTP status of the answer; 0 for the daemon itself.
    pub status: u16,
}

/// One line of the log, without its own hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(crate) struct AuditEntry {
    /// Number of the line, from 1.
    pub n: u64,
    /// When it was done, UTC, RFC 3339.
    pub time_utc: String,
    #[serde(flatten)]
    pub deed: Deed,
    /// How often it was done without anything between, within a second of each other.
    pub times: u64,
    /// Hash of the line before.
    pub previous: String,
}

/// The end of the log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ChainEnd {
    /// Number of lines.
    pub n: u64,
    /// Hash of the last one; `first` if there is none.
    pub hash: String,
}

impl Default for ChainEnd {
    fn default() -> Self {
        ChainEnd {
            n: 0,
            hash: FIRST.to_owned(),
        }
    }
}

/// What stands between an entry and its hash.
const HASH_MARK: &str = ",\"hash\":\"";

/// The line of an entry, and its hash.
pub(super) fn line(entry: &AuditEntry) -> serde_json::Result<(String, String)> {
    let body = serde_json::to_string(entry)?;
    let hash = hex(&Sha256::digest(&body));
    let open = body.strip_suffix('}').unwrap_or(&body);
    Ok((format!("{open}{HASH_MARK}{hash}\"}}"), hash))
}

/// The entry of a line, and its hash. `None` if the line is not as it was written.
pub(super) fn read_line(line: &str) -> Option<(AuditEntry, String)> {
    let (open, rest) = line.rsplit_once(HASH_MARK)?;
    let hash = rest.strip_suffix("\"}")?;
    let body = format!("{open}}}");
    if hex(&Sha256::digest(&body)) != hash {
        return None;
    }
    Some((serde_json::from_str(&body).ok()?, hash.to_owned()))
}

/// What a check of the log found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct AuditCheck {
    /// Number of lines.
    pub lines: u64,
    /// Hash of the last line that is as it was written: keep it elsewhere, and a later check proves all lines up to it.
    pub hash: String,
    /// What is wrong, one sentence for each place; empty if the log is whole.
    pub problems: Vec<String>,
}

/// Checks the text of a log. `end` is what the daemon wrote down about its end; a daemon that was killed may have added lines
/// after it.
pub(crate) fn check(text: &str, end: &ChainEnd) -> AuditCheck {
    let mut problems = Vec::new();
    let mut last = ChainEnd::default();
    let mut has_end = *end == last;
    let mut lines = 0;
    for line in text.lines() {
        lines += 1;
        let Some((entry, hash)) = read_line(line) else {
            problems.push(format!(
                "line {lines} was changed, or was cut off when the power failed"
            ));
            continue;
        };
        if entry.n != last.n + 1 || entry.previous != last.hash {
            problems.push(format!(
                "line {lines} is entry {} and does not follow entry {}: lines were changed, removed, added or moved here",
                entry.n, last.n
            ));
        }
        last = ChainEnd { n: entry.n, hash };
        has_end |= last == *end;
    }
    if !has_end {
        problems.push(format!(
            "the log ends with entry {}, and entry {} is not in it as it was written: lines were changed or removed at the end",
            last.n, end.n
        ));
    }
    AuditCheck {
        lines,
        hash: last.hash,
        problems,
    }
}

/// The entries of lines that are as they were written.
pub(crate) fn entries<'t>(lines: impl Iterator<Item = &'t str>) -> Vec<AuditEntry> {
    lines.filter_map(|line| Some(read_line(line)?.0)).collect()
}

/// Whether a hash that was kept elsewhere is that of a line of the log.
pub(crate) fn has_hash(text: &str, hash: &str) -> bool {
    text.lines()
        .any(|line| read_line(line).is_some_and(|(_, found)| found == hash))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A log of some lines, and its end.
    fn log(count: u64) -> (Vec<String>, ChainEnd) {
        let mut end = ChainEnd::default();
        let lines = (1..=count).map(|n| {
            let entry = AuditEntry {
                n,
                time_utc: format!("2026-01-01T00:00:0{n}Z"),
                deed: Deed {
                    who: "owner".to_owned(),
                    what: "POST /api/run".to_owned(),
                    detail: "a \"quoted\" word, \u{fc}".to_owned(),
                    status: 202,
                    ..Deed::default()
                },
                times: 1,
                previous: end.hash.clone(),
            };
            let (line, hash) = line(&entry).expect("written");
            end = ChainEnd { n, hash };
            line
        });
        (lines.collect(), end)
    }

    fn is_whole(lines: &[String], end: &ChainEnd) -> bool {
        check(&lines.join("\n"), end).problems.is_empty()
    }

    #[test]
    fn every_byte_of_every_line_counts() {
        let (lines, end) = log(5);
        assert!(is_whole(&lines, &end));
        for at in 0..lines.len() {
            for byte in 0..lines[at].len() {
                let mut changed = lines
                    .clone()
                    .into_iter()
                    .map(String::into_bytes)
                    .collect::<Vec<_>>();
                changed[at][byte] ^= 1;
                let text = String::from_utf8_lossy(&changed.join(&b'\n')).into_owned();
                assert!(!check(&text, &end).problems.is_empty(), "line {at}, byte {byte}");
            }
        }
    }

    #[test]
    fn a_removed_moved_doubled_or_added_line_shows_at_every_place() {
        let (lines, end) = log(5);
        for at in 0..lines.len() {
            let mut removed = lines.clone();
            removed.remove(at);
            assert!(!is_whole(&removed, &end), "line {at} removed");
            let mut doubled = lines.clone();
            doubled.insert(at, lines[at].clone());
            assert!(!is_whole(&doubled, &end), "line {at} doubled");
            for other in 0..at {
                let mut moved = lines.clone();
                moved.swap(at, other);
                assert!(!is_whole(&moved, &end), "lines {at} and {other} swapped");
            }
        }
        let mut foreign = lines.clone();
        foreign.push(log(7).0[6].clone());
        assert!(!is_whole(&foreign, &end), "a line added");
        assert!(!is_whole(&[], &end), "all lines removed");
        assert!(has_hash(&lines.join("\n"), &end.hash));
        assert!(!has_hash(&lines[..4].join("\n"), &end.hash));
    }

    /// A person who knows the format can write the whole rest again. Only a hash that was kept elsewhere shows it.
    #[test]
    fn a_log_that_was_written_again_shows_by_a_hash_that_was_kept() {
        let (lines, end) = log(5);
        let (mut entry, _) = read_line(&lines[4]).expect("whole");
        entry.deed.who = "somebody else".to_owned();
        let (forged, hash) = line(&entry).expect("written");
        let mut again = lines.clone();
        again[4] = forged;
        assert!(is_whole(&again, &ChainEnd { n: 5, hash }));
        assert!(!has_hash(&again.join("\n"), &end.hash));
    }
}
