//! Which runs are wanted: filters, pages, and the place at which a page goes on. The same for HTTP and the command line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};
use jiff::tz::TimeZone;
use serde::{Deserialize, Deserializer};
use utoipa::{IntoParams, ToSchema};

use super::run_index::{CheckLimits, IndexedRun, RunIndex};
use crate::recording::run_file::RunFileError;

/// What a time on the command line or in a request looks like.
const TIME_FORMS: &str = "write a day such as 2026-11-23, or a time such as 2026-11-23T14:30 (UTC)";

/// A file up to this size is read in full within some 50 ms: 2 minutes at 1 kHz.
const QUICK_BYTES: u64 = 6_000_000;

/// How a run ended: the words of `ending`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum WantedEnding {
    /// All segments ran.
    Completed,
    /// An operator stopped it.
    Stopped,
    /// A limit, the link or the daemon ended it.
    Aborted,
    /// It has no end yet.
    Open,
    /// Samples are not on the disk.
    Incomplete,
    /// The file is not what was written.
    Damaged,
    /// The file cannot be opened.
    Unreadable,
}

impl WantedEnding {
    /// The word in `ending`.
    fn word(self) -> &'static str {
        match self {
            WantedEnding::Completed => "completed",
            WantedEnding::Stopped => "stopped",
            WantedEnding::Aborted => "aborted",
            WantedEnding::Open => "open",
            WantedEnding::Incomplete => "incomplete",
            WantedEnding::Damaged => "damaged",
            WantedEnding::Unreadable => "unreadable",
        }
    }
}

/// Which runs are wanted: those that fit everything that is given, newest first.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct RunQuery {
    /// Text in the name of the specimen; upper and lower case are the same.
    pub specimen: Option<String>,
    /// Text in the name of the operator; upper and lower case are the same.
    pub operator: Option<String>,
    /// Text in the name of the profile; upper and lower case are the same.
    pub profile: Option<String>,
    /// Words that all occur somewhere: in the run id, in specimen, operator or profile, or in how and why the run ended.
    pub text: Option<String>,
    /// Start on this day or later, or at this time or later: `2026-11-23`, `2026-11-23T14:30` (UTC).
    #[serde(default, deserialize_with = "moment_since")]
    #[param(value_type = Option<String>)]
    pub since: Option<Timestamp>,
    /// Start on this day or earlier, or at this time or earlier.
    #[serde(default, deserialize_with = "moment_until")]
    #[param(value_type = Option<String>)]
    pub until: Option<Timestamp>,
    /// How the run ended.
    #[param(inline)]
    pub result: Option<WantedEnding>,
    /// Most runs of the answer; all without it.
    pub limit: Option<usize>,
    /// The answer goes on after this place: the header `leafbench-next` of the answer before.
    pub after: Option<String>,
}

/// The start of a day, or a time, in UTC.
pub(crate) fn since(text: &str) -> Result<Timestamp, String> {
    match day(text) {
        Some(day) => in_utc(day.to_datetime(Time::midnight())),
        None => time(text),
    }
}

/// The end of a day, or a time, in UTC.
pub(crate) fn until(text: &str) -> Result<Timestamp, String> {
    match day(text) {
        Some(day) => in_utc(day.to_datetime(Time::MAX)),
        None => time(text),
    }
}

/// A date alone, which is also a time to the parser of times.
fn day(text: &str) -> Option<Date> {
    text.parse().ok().filter(|_| !text.contains(['T', ' ']))
}

fn time(text: &str) -> Result<Timestamp, String> {
    let stamp = text.parse::<Timestamp>();
    stamp.or_else(|_| {
        text.parse::<DateTime>()
            .map_err(|_| TIME_FORMS.to_owned())
            .and_then(in_utc)
    })
}

fn in_utc(time: DateTime) -> Result<Timestamp, String> {
    let zoned = time.to_zoned(TimeZone::UTC).map_err(|_| TIME_FORMS.to_owned())?;
    Ok(zoned.timestamp())
}

fn moment_since<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Timestamp>, D::Error> {
    moment(deserializer, "since", since)
}

fn moment_until<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Timestamp>, D::Error> {
    moment(deserializer, "until", until)
}

fn moment<'de, D: Deserializer<'de>>(
    deserializer: D,
    key: &str,
    parse: fn(&str) -> Result<Timestamp, String>,
) -> Result<Option<Timestamp>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let refused = |why| serde::de::Error::custom(format!("{key}={text} is no time: {why}"));
    parse(&text).map(Some).map_err(refused)
}

/// The runs of one answer.
#[derive(Debug)]
pub(crate) struct RunPage {
    /// The runs of the page, newest first.
    pub runs: Vec<Arc<IndexedRun>>,
    /// Number of runs that fit, on all pages.
    pub total: usize,
    /// Where the next page goes on; `None` on the last one.
    pub next: Option<String>,
    /// Number of runs that were judged without reading their file in full, for lack of time.
    pub unread: usize,
}

/// The runs of a folder that are wanted. Files are read in full for about the time `within`, and no large ones; without it
/// until the answer is certain.
pub(crate) fn search(
    index: &RunIndex,
    query: &RunQuery,
    within: Option<Duration>,
) -> Result<RunPage, RunFileError> {
    let all = index.look()?;
    let limits = CheckLimits {
        until: within.map(|within| Instant::now() + within),
        file_bytes: within.map(|_| QUICK_BYTES),
    };
    let filter = RunFilter::of(query);
    let mut fitting: Vec<_> = all
        .iter()
        .rev()
        .filter(|run| filter.fits(run))
        .map(Arc::clone)
        .collect();
    let mut unread = 0;
    if let Some(result) = query.result {
        // Damage decides about the result, so every one of these files has to be read.
        unread = index.check(&fitting, limits);
        fitting = index.renewed(&fitting);
        fitting.retain(|run| run.summary.ending == result.word());
    }
    let total = fitting.len();
    let after = query.after.as_deref().map(place_of);
    let begin = after.map_or(0, |place| fitting.partition_point(|run| place_text(run) >= place));
    let end = query
        .limit
        .map_or(total, |limit| total.min(begin.saturating_add(limit)));
    let mut runs = fitting[begin..end.max(begin)].to_vec();
    if query.result.is_none() {
        unread = index.check(&runs, limits);
        runs = index.renewed(&runs);
    }
    let last = fitting[..end].last().filter(|_| end < total && end > begin);
    Ok(RunPage {
        next: last.map(|run| hex(&place_text(run))),
        runs,
        total,
        unread,
    })
}

/// The filters of a query in lower case.
struct RunFilter {
    specimen: String,
    operator: String,
    profile: String,
    words: Vec<String>,
    since: Option<Timestamp>,
    until: Option<Timestamp>,
}

impl RunFilter {
    fn of(query: &RunQuery) -> RunFilter {
        let lower = |text: &Option<String>| text.as_deref().unwrap_or_default().trim().to_lowercase();
        let words = lower(&query.text);
        RunFilter {
            specimen: lower(&query.specimen),
            operator: lower(&query.operator),
            profile: lower(&query.profile),
            words: words.split_whitespace().map(str::to_owned).collect(),
            since: query.since,
            until: query.until,
        }
    }

    /// The run fits everything but the result, which is not known yet.
    fn fits(&self, run: &IndexedRun) -> bool {
        let run = &run.summary;
        let has = |name: &str, text: &str| text.is_empty() || name.to_lowercase().contains(text);
        has(&run.specimen, &self.specimen)
            && has(&run.operator, &self.operator)
            && has(&run.profile, &self.profile)
            && self.has_words(&[
                &run.run_id,
                &run.specimen,
                &run.operator,
                &run.profile,
                &run.ending,
                &run.cause,
            ])
            && self.is_in_time(&run.started_utc)
    }

    fn has_words(&self, fields: &[&str]) -> bool {
        if self.words.is_empty() {
            return true;
        }
        // A word does not go over the border of two fields.
        let text = fields.join("\n").to_lowercase();
        self.words.iter().all(|word| text.contains(word))
    }

    fn is_in_time(&self, started_utc: &str) -> bool {
        if self.since.is_none() && self.until.is_none() {
            return true;
        }
        // A file that cannot be read has no start.
        started_utc.parse::<Timestamp>().is_ok_and(|at| {
            self.since.is_none_or(|since| at >= since) && self.until.is_none_or(|until| at <= until)
        })
    }
}

/// The place of a run in the list. It stays where it is when runs come and go.
fn place_text(run: &IndexedRun) -> String {
    let (started_utc, run_id, file) = run.order();
    format!("{started_utc}\n{run_id}\n{}", file.to_string_lossy())
}

/// Header fields are ASCII, and names of files need not be.
fn hex(text: &str) -> String {
    text.bytes().map(|byte| format!("{byte:02x}")).collect()
}

/// The place in a request; an empty one, after which nothing follows, if it is not one of ours.
fn place_of(hex: &str) -> String {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    let bytes: Option<Vec<u8>> = hex.as_bytes().chunks(2).map(byte).collect();
    bytes
        .and_then(|bytes| String::from_utf8(bytes).ok())
        .unwrap_or_default()
}
