//! What stands where in the text of a profile file, for an editor that shows it as a form and writes each change back into the
//! text, so that comments and layout stay. `file` judges the values; here only the TOML must be right.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::ProfileError;
use super::file::{RawBlock, RawProfile};
use super::keys::RawSegment;
use super::reader::Reader;

/// A profile as a form. All places are in UTF-16 units, as JavaScript counts, from the start of the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct ProfileOutline {
    /// The keys before the first block: `name`, `description`, `control`.
    pub values: Vec<OutlineValue>,
    /// `n` or `mm`: the unit in which the keys of levels end.
    pub unit: String,
    /// The blocks in the order of the text.
    pub blocks: Vec<OutlineBlock>,
    /// The kinds of segment, with the keys of each in the unit of this profile.
    pub kinds: Vec<SegmentKind>,
}

/// A value in the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct OutlineValue {
    /// The key before it.
    pub key: String,
    /// The value as it is written, a text with its quotes.
    pub text: String,
    /// Begin of the value.
    pub from: usize,
    /// End of the value.
    pub to: usize,
}

/// A block in the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct OutlineBlock {
    /// Begin of the block with the comment above it.
    pub from: usize,
    /// End of the block: begin of the next one.
    pub to: usize,
    /// Where a new key of the block can be written, at the end of a line.
    pub keys_at: usize,
    /// The value of `repeat`, if it is written.
    pub repeat: Option<OutlineValue>,
    /// The segments in the order of the text.
    pub segments: Vec<OutlineSegment>,
}

/// A segment in the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct OutlineSegment {
    /// Begin of the segment with the comment above it.
    pub from: usize,
    /// End of the segment: begin of what comes next.
    pub to: usize,
    /// False for a segment within braces: it has no lines of its own that could be moved.
    pub has_lines: bool,
    /// Where a new key can be written, at the end of a line.
    pub keys_at: usize,
    /// The keys that are written, `kind` among them.
    pub values: Vec<OutlineValue>,
}

/// A kind of segment and its keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct SegmentKind {
    /// The value of `kind`.
    pub kind: String,
    /// Its keys in the order of a form.
    pub keys: Vec<SegmentKey>,
    /// The lines of a new segment of this kind. It begins at any level.
    pub template: String,
}

/// A key of a kind of segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct SegmentKey {
    /// The key, with its unit.
    pub key: String,
    /// A key that may stand in its place; empty if there is none.
    pub or: String,
    /// What counts if the key is left out; empty for a key that is needed.
    pub default: String,
}

/// Kind; keys with `@` for the unit, the key that may replace it, the default.
type KindRow = (
    &'static str,
    &'static [(&'static str, &'static str, &'static str)],
);

const KINDS: [KindRow; 5] = [
    ("ramp", &[("to_@", "by_@", ""), ("duration_s", "", "")]),
    ("hold", &[("duration_s", "", "")]),
    ("sine", &cycles_keys("2")),
    ("triangle", &cycles_keys("1")),
    ("table", &[("time_s", "", ""), ("level_@", "level_by_@", "")]),
];

const fn cycles_keys(taper: &'static str) -> [(&'static str, &'static str, &'static str); 6] {
    [
        ("mean_@", "mean_by_@", ""),
        ("amplitude_@", "", ""),
        ("frequency_hz", "", ""),
        ("cycles", "", ""),
        ("taper_cycles", "", taper),
        ("correct", "", "true"),
    ]
}

/// The values of a new segment.
fn template_values(kind: &str) -> &'static [(&'static str, &'static str)] {
    match kind {
        "ramp" => &[("to_@", "0.0"), ("duration_s", "5.0")],
        "hold" => &[("duration_s", "1.0")],
        "table" => &[("time_s", "[0.0, 1.0, 2.0]"), ("level_by_@", "[0.0, 1.0, 0.0]")],
        _ => &[
            ("mean_by_@", "0.0"),
            ("amplitude_@", "1.0"),
            ("frequency_hz", "1.0"),
            ("cycles", "10"),
        ],
    }
}

fn kind_row((kind, keys): &KindRow, unit: &str) -> SegmentKind {
    let with_unit = |key: &str| key.replace('@', unit);
    let lines = template_values(kind)
        .iter()
        .map(|(key, value)| format!("{} = {value}\n", with_unit(key)));
    SegmentKind {
        kind: (*kind).to_owned(),
        keys: keys
            .iter()
            .map(|(key, or, default)| SegmentKey {
                key: with_unit(key),
                or: with_unit(or),
                default: (*default).to_owned(),
            })
            .collect(),
        template: format!(
            "[[block.segment]]\nkind = \"{kind}\"\n{}",
            lines.collect::<String>()
        ),
    }
}

/// The outline of a text. An error has line and column.
pub(crate) fn outline(text: &str, name_for_messages: &str) -> Result<ProfileOutline, ProfileError> {
    let reader = Reader {
        text,
        name: name_for_messages,
    };
    let raw = reader.raw()?;
    let unit = raw.control.get_ref().unit_suffix();
    let text = Text::new(text);
    // Where each block and each segment begins, with the comment above it.
    let mut begins: Vec<usize> = Vec::new();
    for block in &raw.block {
        begins.push(text.with_comment(block.span().start));
        let segments = block.get_ref().segment.iter();
        begins.extend(segments.map(|segment| text.with_comment(segment.span().start)));
    }
    let next = |from: usize| {
        begins
            .iter()
            .copied()
            .find(|b| *b > from)
            .unwrap_or(text.text.len())
    };
    Ok(ProfileOutline {
        values: text.values(raw.places()),
        unit: unit.to_owned(),
        blocks: raw.block.iter().map(|block| text.block(block, &next)).collect(),
        kinds: KINDS.iter().map(|row| kind_row(row, unit)).collect(),
    })
}

/// A text whose places are told in UTF-16 units.
struct Text<'a> {
    text: &'a str,
    /// UTF-16 units before each byte, and before the end.
    units: Vec<usize>,
}

impl<'a> Text<'a> {
    fn new(text: &'a str) -> Self {
        let mut units = Vec::with_capacity(text.len() + 1);
        let mut count = 0;
        for c in text.chars() {
            units.extend(std::iter::repeat_n(count, c.len_utf8()));
            count += c.len_utf16();
        }
        units.push(count);
        Text { text, units }
    }

    fn unit(&self, byte: usize) -> usize {
        self.units.get(byte).or(self.units.last()).copied().unwrap_or(0)
    }

    /// Begin of the comment lines directly above the line of `byte`; its own place where there are none, or where it does not
    /// begin its line.
    fn with_comment(&self, byte: usize) -> usize {
        let before = self.text.get(..byte).unwrap_or_default();
        let line = before.rfind('\n').map_or(0, |at| at + 1);
        if !before[line..].trim().is_empty() {
            return byte;
        }
        let mut from = line;
        while let Some(above) = self.text[..from].strip_suffix('\n') {
            let begin = above.rfind('\n').map_or(0, |at| at + 1);
            if !above[begin..].trim_start().starts_with('#') {
                break;
            }
            from = begin;
        }
        from
    }

    /// End of the line of `byte`.
    fn line_end(&self, byte: usize) -> usize {
        let rest = self.text.get(byte..).unwrap_or_default();
        rest.find('\n').map_or(self.text.len(), |at| byte + at)
    }

    fn value(&self, key: &str, span: &Range<usize>) -> OutlineValue {
        OutlineValue {
            key: key.to_owned(),
            text: self.text.get(span.clone()).unwrap_or_default().to_owned(),
            from: self.unit(span.start),
            to: self.unit(span.end),
        }
    }

    fn values(&self, mut places: Vec<(&'static str, Range<usize>)>) -> Vec<OutlineValue> {
        places.sort_by_key(|(_, span)| span.start);
        places.iter().map(|(key, span)| self.value(key, span)).collect()
    }

    fn block(&self, block: &toml::Spanned<RawBlock>, next: &impl Fn(usize) -> usize) -> OutlineBlock {
        let start = block.span().start;
        let raw = block.get_ref();
        // A repeat that is not written has the empty place 0..0.
        let repeat = Some(raw.repeat.span()).filter(|span| !span.is_empty());
        let segments: Vec<OutlineSegment> = raw.segment.iter().map(|s| self.segment(s, next)).collect();
        let head_end = self.line_end(repeat.as_ref().map_or(start, |span| span.end));
        let own_end = next(self.with_comment(start));
        OutlineBlock {
            from: self.unit(self.with_comment(start)),
            to: segments.last().map_or(self.unit(own_end), |segment| segment.to),
            keys_at: self.unit(head_end),
            repeat: repeat.map(|span| self.value("repeat", &span)),
            segments,
        }
    }

    fn segment(&self, segment: &toml::Spanned<RawSegment>, next: &impl Fn(usize) -> usize) -> OutlineSegment {
        let start = segment.span().start;
        let from = self.with_comment(start);
        let places = segment.get_ref().places();
        let last = places.iter().map(|(_, span)| span.end).max().unwrap_or(start);
        OutlineSegment {
            from: self.unit(from),
            to: self.unit(next(from)),
            has_lines: self.text.get(start..).is_some_and(|rest| rest.starts_with("[[")),
            keys_at: self.unit(self.line_end(last)),
            values: self.values(places),
        }
    }
}

impl RawProfile {
    /// The keys before the first block, with the places of their values.
    fn places(&self) -> Vec<(&'static str, Range<usize>)> {
        let description = self.description.as_ref().map(|d| ("description", d.span()));
        let needed = [("name", self.name.span()), ("control", self.control.span())];
        needed.into_iter().chain(description).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Profile;
    use super::*;

    const TEXT: &str = "# A \u{fc}bung \u{1f600}.\nname = \"a\"\ncontrol = \"force\"\n\n[[block]]\n\n# First.\n[[block.segment]]\n\
                        kind = \"ramp\"\nto_n = 100 # up\nduration_s = 2\n\n# Stay\n# here.\n[[block.segment]]\nkind = \"hold\"\n\
                        duration_s = 0\n\n[[block]]\nrepeat = 2\n[[block.segment]]\nkind = \"sine\"\nmean_by_n = 0\n\
                        amplitude_n = 5\nfrequency_hz = 1\ncycles = 3\n";

    /// The text between two places that count as JavaScript does.
    fn slice(text: &str, from: usize, to: usize) -> String {
        let units: Vec<u16> = text.encode_utf16().collect();
        String::from_utf16(&units[from..to]).expect("whole characters")
    }

    #[test]
    fn values_are_found_where_they_stand_also_after_wide_characters() {
        let found = outline(TEXT, "a").expect("TOML is right, although a duration is 0");
        let shown = |values: &[OutlineValue]| {
            for value in values {
                assert_eq!(slice(TEXT, value.from, value.to), value.text);
            }
            let named = values.iter().map(|v| format!("{}={}", v.key, v.text));
            named.collect::<Vec<_>>().join(" ")
        };
        assert_eq!(shown(&found.values), "name=\"a\" control=\"force\"");
        let ramp = &found.blocks[0].segments[0];
        assert_eq!(shown(&ramp.values), "kind=\"ramp\" to_n=100 duration_s=2");
        assert_eq!(
            slice(TEXT, ramp.from, ramp.to),
            "# First.\n[[block.segment]]\nkind = \"ramp\"\nto_n = 100 # up\nduration_s = 2\n\n"
        );
        let hold = &found.blocks[0].segments[1];
        assert!(slice(TEXT, hold.from, hold.to).starts_with("# Stay\n# here.\n[[block.segment]]"));
        assert!(found.blocks[0].repeat.is_none());
        let repeat = found.blocks[1].repeat.as_ref().expect("written");
        assert_eq!((repeat.text.as_str(), found.blocks[1].segments.len()), ("2", 1));
        assert_eq!(hold.to, found.blocks[1].from);
        assert_eq!(found.blocks[1].to, TEXT.encode_utf16().count());
    }

    #[test]
    fn a_new_key_goes_behind_the_last_one() {
        let found = outline(TEXT, "a").expect("right");
        let sine = &found.blocks[1].segments[0];
        let mut text = TEXT.to_owned();
        // Behind wide characters a place is not a byte.
        let byte = slice(TEXT, 0, sine.keys_at).len();
        text.insert_str(byte, "\ntaper_cycles = 3");
        let text = text.replace("duration_s = 0", "duration_s = 1");
        assert!(Profile::from_toml(&text, "a").is_ok(), "{text}");
    }

    #[test]
    fn inline_segments_have_values_and_no_lines() {
        let text = "name = \"a\"\ncontrol = \"displacement\"\n[[block]]\nsegment = [\n  { kind = \"ramp\", to_mm = 5.0, duration_s = 2.0 },\n]\n";
        let found = outline(text, "a").expect("right");
        let segment = &found.blocks[0].segments[0];
        assert!(!segment.has_lines);
        let to = segment.values.iter().find(|v| v.key == "to_mm").expect("there");
        assert_eq!(slice(text, to.from, to.to), "5.0");
    }

    #[test]
    fn every_template_is_a_segment_and_every_kind_takes_the_keys_it_names() {
        for control in ["force", "displacement"] {
            let head = format!("name = \"a\"\ncontrol = \"{control}\"\n[[block]]\n");
            let kinds = outline(&head, "a").expect("right").kinds;
            for kind in &kinds {
                let text = format!("{head}{}", kind.template);
                let read = Profile::from_toml(&text, "a");
                assert!(read.is_ok(), "{text}: {read:?}");
                // A key with a value of the wrong type says so, and a key that the kind does not take would be refused as such.
                for key in &kind.keys {
                    let line = kind
                        .template
                        .lines()
                        .find(|l| l.starts_with(&format!("{} =", key.key)));
                    if line.is_none() && key.or.is_empty() {
                        let text = format!("{text}{} = {}\n", key.key, key.default);
                        assert!(Profile::from_toml(&text, "a").is_ok(), "{text}");
                    }
                }
            }
            assert_eq!(kinds.len(), 5);
        }
    }

    #[test]
    fn toml_that_is_wrong_has_a_place() {
        let error = outline("name = \"a\"\ncontrol = \"force\"\nspeed = 3\n", "a").expect_err("unknown key");
        assert_eq!(error.place(), Some((3, 1)), "{error}");
    }
}
