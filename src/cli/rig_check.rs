//! `leafbench rig-check`.

use std::io::{BufRead, IsTerminal, Write};
use std::time::{Duration, Instant};

use clap::Args;
use serde::Serialize;

use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::conformance::{Probe, ProbeClock, Reach, RowReport, RowVerdict, WalkPart, walk};
use crate::link::priority::raise_this_thread;
use crate::link::{self, Side, loopback};

/// Check a rig's firmware against firmware-protocol.md, row by row
#[derive(Debug, Args)]
#[command(
    after_help = "Without --motion nothing moves and the pressure stays off. The rows are in src/conformance; the column after the\n\
                  name is the section of firmware-protocol.md. Exit code 0: all rows passed, 1: a row failed, 2: no rig answers."
)]
pub(super) struct RigCheckArgs {
    #[arg(
        long,
        value_name = "ADDRESS",
        help = format!("Address of the link to the rig: {}; mock: checks the mock rig, in virtual time", link::address_forms())
    )]
    link: String,
    /// Node of the rig on the bus, 1 to 126
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=126))]
    node: u8,
    /// Then switch the pressure on and move by 0.25 mm, some 30 times; asks before it begins
    #[arg(long)]
    motion: bool,
    /// Do not ask before motion; for the mock rig in memory only
    #[arg(long, requires = "motion")]
    yes: bool,
}

/// The result as JSON.
#[derive(Debug, Serialize)]
struct CheckResult {
    link: String,
    node: u8,
    passed: usize,
    failed: usize,
    skipped: usize,
    rows: Vec<RowReport>,
}

/// The word that a person types before the rig moves.
const CONFIRMATION: &str = "MOVE";
/// Pause between two looks at the link.
const LOOK: Duration = Duration::from_micros(500);
/// Session number of this program; the daemon draws its own.
const SESSION: u8 = 201;

impl CliCommand for RigCheckArgs {
    const NAME: &'static str = "rig-check";
    const EXAMPLES: &'static [&'static str] = &[
        "leafbench rig-check --link mock: --motion --yes",
        "leafbench rig-check --link serial:/dev/ttyUSB0",
        "leafbench rig-check --link can:can0 --node 5 --motion --json",
    ];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        if self.yes && !link::is_in_process(&self.link) {
            return Err(CliError::Input(
                "--yes is for the mock rig in memory (--link mock:): leave it out and confirm at the terminal".to_owned(),
            ));
        }
        let mut probe = self.probe()?;
        self.reach(&mut probe)?;
        let show = |row: &RowReport| {
            if !output.json {
                // A closed stdout (`| head`) is not an error.
                let _ = writeln!(std::io::stdout().lock(), "{}", line(row));
            }
        };
        let mut rows = walk(&mut probe, WalkPart::Still, show);
        if self.motion {
            self.confirm(&rows)?;
            probe.catch_up();
            rows.extend(walk(&mut probe, WalkPart::Moving, show));
        } else {
            rows.extend(walk(&mut probe, WalkPart::Skipped, show));
        }
        rows.extend(walk(&mut probe, WalkPart::Whole, show));
        let result = self.result(rows);
        output.result(&result, || {
            format!(
                "{} passed, {} FAILED, {} skipped",
                result.passed, result.failed, result.skipped
            )
        })?;
        Ok(Done::success_if(result.failed == 0))
    }
}

impl RigCheckArgs {
    fn probe(&self) -> Result<Probe, CliError> {
        if link::is_in_process(&self.link) {
            let mut bench = Bench::shipped()?;
            bench.link.node = self.node;
            let mut rig = local::mock_rig(&bench, None)?;
            let (host, mut rig_end) = loopback::pair();
            let step = Box::new(move || rig.tick(&mut rig_end));
            return Ok(Probe::new(host, ProbeClock::Virtual(step), self.node, SESSION));
        }
        let side = Side::Host { rig_node: self.node };
        let link = link::open(&self.link, side)?;
        // Without it a busy computer only makes rows slower: they are repeated where it paused.
        let _ = raise_this_thread();
        let began = Instant::now();
        let wait = Box::new(move || {
            std::thread::sleep(LOOK);
            u64::try_from(began.elapsed().as_millis()).unwrap_or(u64::MAX)
        });
        Ok(Probe::new(link, ProbeClock::Real(wait), self.node, SESSION))
    }

    fn reach(&self, probe: &mut Probe) -> Result<(), CliError> {
        match probe.reach() {
            Reach::Free => Ok(()),
            Reach::Nothing => Err(CliError::Input(format!(
                "no rig answers at {} as node {}: check power, cable, bit rate and node",
                self.link, self.node
            ))),
            Reach::Owned(session) => Err(CliError::Input(format!(
                "session {session} owns the rig at {}: stop that daemon first",
                self.link
            ))),
        }
    }

    /// Asks a person at the terminal, who sees the rows so far.
    fn confirm(&self, rows: &[RowReport]) -> Result<(), CliError> {
        if self.yes {
            return Ok(());
        }
        let failed = rows.iter().filter(|row| row.verdict == RowVerdict::Fail).count();
        eprint!(
            "{failed} rows failed without motion. Next the pump starts, and the rig loads the specimen by 0.25 mm and up to 200 N, \
             some 30 times.\nClear the load frame, keep a hand at the emergency stop, then type {CONFIRMATION} to begin: "
        );
        let mut typed = String::new();
        let stdin = std::io::stdin();
        let read = stdin.is_terminal() && stdin.lock().read_line(&mut typed).is_ok();
        if read && typed.trim() == CONFIRMATION {
            return Ok(());
        }
        Err(CliError::Input(format!(
            "motion was not confirmed, nothing moved: type {CONFIRMATION} at a terminal, or leave --motion out"
        )))
    }

    fn result(&self, rows: Vec<RowReport>) -> CheckResult {
        let count = |verdict| rows.iter().filter(|row| row.verdict == verdict).count();
        CheckResult {
            link: self.link.clone(),
            node: self.node,
            passed: count(RowVerdict::Pass),
            failed: count(RowVerdict::Fail),
            skipped: count(RowVerdict::Skipped),
            rows,
        }
    }
}

/// One line of the table.
fn line(row: &RowReport) -> String {
    let verdict = match row.verdict {
        RowVerdict::Pass => "pass",
        RowVerdict::Fail => "FAIL",
        RowVerdict::Skipped => "skipped",
    };
    format!(
        "{verdict:<8}{:<26}{:<3}{}: {}",
        row.id, row.section, row.title, row.seen
    )
}
