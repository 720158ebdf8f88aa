//! Drives one parser: keeps the inputs that had a new outcome, and holds every input to the limits.

use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::mutation::mutate;
use crate::tests::trust::allocations;

/// Time for each parser without `LEAFBENCH_FUZZ_SECONDS`.
const DEFAULT_TIME: Duration = Duration::from_millis(700);
/// Longest time of one input, of the processor.
const LONGEST_RUN: Duration = Duration::from_secs(1);
/// An input that is not done after this time by the clock on the wall ends the program.
const HANG: Duration = Duration::from_secs(60);
/// Most memory that one input may hold, bytes.
const MOST_BYTES: i64 = 64 << 20;
/// Most inputs that are kept for their new outcome.
const MOST_KEPT: usize = 1024;

/// A parser under test.
pub struct Parser<'a> {
    /// Name of its folder in the corpus.
    pub name: &'static str,
    /// Inputs to begin with.
    pub seeds: Vec<Vec<u8>>,
    /// Words of its format.
    pub words: &'a [&'a str],
    /// Parses, and returns the kind of outcome.
    pub parse: &'a mut dyn FnMut(&[u8]) -> u64,
}

/// The kind of an outcome in words: numbers and quoted text do not count.
pub fn kind(words: &impl std::fmt::Display) -> u64 {
    let mut hasher = DefaultHasher::new();
    let text = words.to_string();
    for part in text.split(['"', '`', '\'']).step_by(2) {
        part.chars()
            .filter(|c| c.is_ascii_alphabetic())
            .for_each(|c| c.hash(&mut hasher));
    }
    hasher.finish()
}

/// The kind of a result: all good ones are one kind.
pub fn kind_of<T, E: std::fmt::Display>(result: &Result<T, E>) -> u64 {
    result.as_ref().map_or_else(kind, |_| 0)
}

fn processor_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
}

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fuzz/corpus")
        .join(name);
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("listed").path()).collect();
    files.sort();
    files
        .iter()
        .map(|file| std::fs::read(file).expect("readable"))
        .collect()
}

fn setting(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(
        text.parse()
            .unwrap_or_else(|_| panic!("{name}={text} is not a whole number")),
    )
}

/// What one parser did.
#[derive(Debug, Default)]
struct Tally {
    runs: u64,
    kinds: HashSet<u64>,
    slowest: Duration,
    most_bytes: i64,
}

/// Tries one input and keeps the tally; a text if it broke a rule.
fn try_input(parser: &mut Parser, input: &[u8], tally: &mut Tally) -> Result<u64, String> {
    allocations::reset_peak();
    let (held, begun) = (allocations::of_this_thread().live_bytes, processor_time());
    let outcome = catch_unwind(AssertUnwindSafe(|| (parser.parse)(input)));
    let (took, peak) = (
        processor_time() - begun,
        allocations::of_this_thread().peak_bytes - held,
    );
    tally.runs += 1;
    tally.slowest = tally.slowest.max(took);
    tally.most_bytes = tally.most_bytes.max(peak);
    let kind = outcome.map_err(|_| "it panics".to_owned())?;
    tally.kinds.insert(kind);
    if took > LONGEST_RUN {
        return Err(format!("it takes {took:?}"));
    }
    if peak > MOST_BYTES {
        return Err(format!("it holds {peak} bytes"));
    }
    Ok(kind)
}

/// Writes an input that broke a rule; what to say of it.
fn kept(name: &str, input: &[u8], why: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/fuzz");
    let mut hasher = DefaultHasher::new();
    input.hash(&mut hasher);
    let file = folder.join(format!("{name}-{:016x}", hasher.finish()));
    let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&file, input));
    format!("{name}: {why}: {} ({written:?})", file.display())
}

/// What a parser is at.
#[derive(Default)]
struct Progress {
    inputs: u64,
    input: Vec<u8>,
    is_over: bool,
}

/// Ends the program if an input is not done in time: an endless loop cannot be ended otherwise. It stops when it is dropped.
struct Watcher {
    progress: Arc<Mutex<Progress>>,
    thread: JoinHandle<()>,
}

impl Watcher {
    fn start(name: &'static str, seed: u64) -> Watcher {
        let progress = Arc::<Mutex<Progress>>::default();
        let watched = Arc::clone(&progress);
        let thread = std::thread::spawn(move || {
            let (mut seen, mut since) = (0, Instant::now());
            loop {
                std::thread::park_timeout(Duration::from_secs(1));
                let now = watched.lock().unwrap_or_else(PoisonError::into_inner);
                if now.is_over {
                    return;
                }
                if now.inputs != seen {
                    (seen, since) = (now.inputs, Instant::now());
                } else if since.elapsed() > HANG {
                    let why = format!("input {seen} of seed {seed} hangs");
                    eprintln!("{}", kept(name, &now.input, &why));
                    std::process::abort();
                }
            }
        });
        Watcher { progress, thread }
    }

    /// The parser begins this input.
    fn begins(&self, input: &[u8]) {
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.inputs += 1;
        progress.input.clear();
        progress.input.extend_from_slice(input);
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.progress
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_over = true;
        self.thread.thread().unpark();
    }
}

/// Feeds the corpus, then mutations of it, until the time is over. Prints what it did.
pub fn fuzz(mut parser: Parser) {
    let seed = setting("LEAFBENCH_FUZZ_SEED").unwrap_or(1);
    let time = setting("LEAFBENCH_FUZZ_SECONDS").map_or(DEFAULT_TIME, Duration::from_secs);
    let mut inputs = corpus(parser.name);
    let of_corpus = inputs.len();
    inputs.append(&mut parser.seeds);
    assert!(!inputs.is_empty(), "{} has no input to begin with", parser.name);
    let watcher = Watcher::start(parser.name, seed);
    let mut tally = Tally::default();
    for input in &inputs {
        watcher.begins(input);
        if let Err(why) = try_input(&mut parser, input, &mut tally) {
            panic!("{}", kept(parser.name, input, &why));
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let begun = Instant::now();
    while begun.elapsed() < time {
        // The clock is looked at now and then only: some parsers need less time than that.
        for _ in 0..16 {
            let [base, other] = [(); 2].map(|()| rng.random_range(0..inputs.len()));
            let input = mutate(&mut rng, &inputs[base], &inputs[other], parser.words);
            let kinds = tally.kinds.len();
            watcher.begins(&input);
            if let Err(why) = try_input(&mut parser, &input, &mut tally) {
                let why = format!("input {} of seed {seed}: {why}", tally.runs);
                panic!("{}", kept(parser.name, &input, &why));
            }
            if tally.kinds.len() > kinds && inputs.len() < MOST_KEPT {
                inputs.push(input);
            }
        }
    }
    eprintln!(
        "fuzz {:<16} {:>10} inputs in {:>5.1} s, {:>9.0} a second; {} kinds of outcome, slowest {:.1} ms, most {} KiB; {of_corpus} of the corpus, seed {seed}",
        parser.name,
        tally.runs,
        begun.elapsed().as_secs_f64(),
        tally.runs as f64 / begun.elapsed().as_secs_f64(),
        tally.kinds.len(),
        tally.slowest.as_secs_f64() * 1e3,
        tally.most_bytes / 1024,
    );
}

#[test]
fn an_input_that_panics_lasts_or_holds_too_much_is_found() {
    let breaks = |parse: &mut dyn FnMut(&[u8]) -> u64| {
        let mut parser = Parser {
            name: "none",
            seeds: Vec::new(),
            words: &[],
            parse,
        };
        try_input(&mut parser, b"x", &mut Tally::default()).expect_err("it breaks a rule")
    };
    assert_eq!(breaks(&mut |input| u64::from(input[1])), "it panics");
    let large = breaks(&mut |_| std::hint::black_box(vec![1_u8; 65 << 20]).len() as u64);
    assert!(large.starts_with("it holds"), "{large}");
    let slow = breaks(&mut |_| {
        let begun = processor_time();
        while processor_time() - begun < Duration::from_millis(1010) {}
        0
    });
    assert!(slow.starts_with("it takes"), "{slow}");
}
