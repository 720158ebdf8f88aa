//! Names of the objects: `TABLE/specimen=S/month=M/FILE`, the layout of Hive, which Spark, DuckDB and Polars read as two columns.

use sha2::{Digest, Sha256};

use crate::recording::Header;

/// The tables, each a folder of the archive.
pub(super) const SAMPLES: &str = "samples";
/// One row for each run.
pub(super) const RUNS: &str = "runs";
/// One row for each counted cycle.
pub(super) const CYCLES: &str = "cycles";
/// One row for each quantity that a diagnosis of a run estimated.
pub(super) const DIAGNOSES: &str = "diagnoses";
/// The tables that have each run.
pub(super) const RUN_TABLES: [&str; 3] = [SAMPLES, RUNS, CYCLES];
/// All tables of an archive.
pub(super) const TABLES: [&str; 4] = [SAMPLES, RUNS, CYCLES, DIAGNOSES];

/// Longest name of a specimen in a path, in characters.
const LONGEST: usize = 60;

/// The folder of a run within each table.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Partition {
    specimen: String,
    month: String,
}

impl Partition {
    /// Partition of a run: its specimen and the month in which it began.
    pub(super) fn of(header: &Header) -> Partition {
        let month = header.started_utc.get(..7).filter(|m| is_month(m));
        Partition {
            specimen: folder_name(&header.specimen),
            month: month.unwrap_or("unknown").to_owned(),
        }
    }

    /// Path of a file of this partition.
    pub(super) fn file(&self, table: &str, name: &str) -> String {
        let (specimen, month, name) = (&self.specimen, &self.month, folder_name(name));
        format!("{table}/specimen={specimen}/month={month}/{name}.parquet")
    }
}

fn is_month(text: &str) -> bool {
    let digits = |part: &str| part.bytes().all(|b| b.is_ascii_digit());
    matches!(text.split_once('-'), Some((year, month)) if year.len() == 4 && digits(year) && digits(month))
}

/// A name that every file system, object store and reader takes as it is. A name with other characters gets a part of its hash, so
/// that two specimens never share a folder.
pub(super) fn folder_name(specimen: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_' || c == '.';
    let kept: String = specimen
        .chars()
        .take(LONGEST)
        .map(|c| if plain(c) { c } else { '_' })
        .collect();
    // Spark and others skip files whose name begins with a dot or an underscore.
    let begins_well = kept.starts_with(|c: char| c.is_ascii_alphanumeric());
    match kept == specimen && begins_well {
        true => kept,
        false => format!("x{kept}_{}", &hash(specimen.as_bytes())[..6]),
    }
}

/// SHA-256 in hex.
pub(super) fn hash(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::run_file::test_support::header;

    #[test]
    fn each_specimen_has_its_own_folder_that_every_system_takes() {
        assert_eq!(folder_name("pack-07"), "pack-07");
        let odd = ["pack 07", "pack/07", "pack_07", "../07", "", ".", "ä", "ö"];
        let mut names: Vec<String> = odd.iter().map(|name| folder_name(name)).collect();
        for name in &names {
            assert!(
                name.bytes()
                    .all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b)),
                "{name}"
            );
            assert!(name.starts_with(|c: char| c.is_ascii_alphanumeric()), "{name}");
        }
        names.sort();
        names.dedup();
        assert_eq!(names.len(), odd.len());
        assert!(folder_name(&"x".repeat(300)).len() < 70);
    }

    #[test]
    fn a_run_lies_in_the_month_in_which_it_began() {
        let mut run = header();
        run.specimen = "pack-07".into();
        let file = |run: &Header| Partition::of(run).file(RUNS, "a");
        assert_eq!(file(&run), "runs/specimen=pack-07/month=2026-11/a.parquet");
        let file_of = |name| Partition::of(&run).file(RUNS, name);
        let foreign = file_of("../../a");
        assert_eq!(
            foreign.split('/').count(),
            4,
            "a run id of a foreign file leads nowhere else: {foreign}"
        );
        run.started_utc = "yesterday".into();
        assert_eq!(file(&run), "runs/specimen=pack-07/month=unknown/a.parquet");
    }
}
