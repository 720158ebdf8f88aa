//! The rows of one quantity, in a fixed order, with who belongs to whom: runs to specimens, specimens to groups, benches to parts of
//! the lab that are connected.
//!
//! Two benches are connected if a specimen was tested on both, or if both are connected to a third one. Only then can an error of a
//! bench be told from the specimens that it tested. A group is a family within one connected part.

use std::collections::BTreeSet;
use std::ops::Range;

use jiff::Timestamp;

use super::estimate::{EstimateRow, EstimateScale};

/// Seconds of a mean year.
const YEAR_S: f64 = 365.25 * 86_400.0;

/// The rows of one quantity. The order of the rows in the table does not matter.
#[derive(Clone)]
pub(super) struct QuantityData<'r> {
    /// Sorted, so that the rows of a specimen are side by side.
    pub rows: Vec<&'r EstimateRow>,
    /// What is pooled: estimates, or their logarithms.
    pub y: Vec<f64>,
    /// Squared standard errors of `y`, without the form errors.
    pub known_variance: Vec<f64>,
    /// Squared form errors of `y`: what the runs of a group have in common.
    pub form_variance: Vec<f64>,
    /// Time since the first run of the quantity, years.
    pub years: Vec<f64>,
    pub specimens: Vec<PooledSpecimen<'r>>,
    pub groups: Vec<SpecimenGroup<'r>>,
    /// For each group what its scatter is measured in, in the unit of `y`: groups share tau and sigma in these units.
    pub unit_of_group: Vec<f64>,
    /// Most degrees of freedom with which the scatter of each group is known beside that of the fit.
    pub degrees_of_group: Vec<f64>,
    /// Share of the form errors that counts between benches, 0 to 1.
    pub bench_form_share: f64,
    pub benches: Levels<'r>,
    /// Runs without an operator have the level "".
    pub operators: Levels<'r>,
    /// Number of the connected part of each bench, from 0.
    pub part_of_bench: Vec<usize>,
}

/// A specimen with its rows.
#[derive(Clone)]
pub(super) struct PooledSpecimen<'r> {
    pub name: &'r str,
    pub family: &'r str,
    pub batch: &'r str,
    pub group: usize,
    pub rows: Range<usize>,
}

/// A family within one connected part of the lab.
#[derive(Clone)]
pub(super) struct SpecimenGroup<'r> {
    pub family: &'r str,
    pub part: usize,
    /// Names of its batches, sorted.
    pub batches: Vec<&'r str>,
    /// Benches on which it was tested, in the order of their names.
    pub benches: Vec<usize>,
}

/// The levels of a factor, sorted by name, and the level of each row.
#[derive(Clone)]
pub(super) struct Levels<'r> {
    pub names: Vec<&'r str>,
    pub of_row: Vec<usize>,
}

impl<'r> Levels<'r> {
    fn of(rows: &[&'r EstimateRow], name: fn(&EstimateRow) -> &str) -> Levels<'r> {
        let names: BTreeSet<&str> = rows.iter().map(|row| name(row)).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let of_row = rows
            .iter()
            .map(|row| names.partition_point(|n| *n < name(row)))
            .collect();
        Levels { names, of_row }
    }
}

impl<'r> QuantityData<'r> {
    /// Sorts the rows of one quantity, which all have the same unit and scale, at least one.
    pub(super) fn of(mut rows: Vec<&'r EstimateRow>) -> QuantityData<'r> {
        rows.sort_by(|a, b| {
            let key = |r: &'r EstimateRow| {
                (
                    &r.family,
                    &r.specimen,
                    &r.bench,
                    r.started_utc,
                    &r.run_id,
                    &r.operator,
                )
            };
            let numbers = |r: &EstimateRow| [r.age_cycles, r.estimate, r.std_error].map(f64::to_bits);
            key(a).cmp(&key(b)).then_with(|| numbers(a).cmp(&numbers(b)))
        });
        let scale = |row: &EstimateRow| match row.scale {
            EstimateScale::Relative => (row.estimate.ln(), row.estimate),
            EstimateScale::Absolute => (row.estimate, 1.0),
        };
        let (y, unit): (Vec<f64>, Vec<f64>) = rows.iter().map(|row| scale(row)).unzip();
        let squares = |error: fn(&EstimateRow) -> f64| -> Vec<f64> {
            let relative = rows.iter().zip(&unit).map(|(row, unit)| error(row) / unit);
            relative.map(|e| e * e).collect()
        };
        let form_variance = squares(|row| row.form_error);
        let all = squares(|row| row.std_error).into_iter();
        let known_variance = all.zip(&form_variance).map(|(all, form)| (all - form).max(0.0));
        let first = rows.iter().map(|row| row.started_utc).min();
        let years = rows.iter().map(|row| years_since(first, row.started_utc));
        let benches = Levels::of(&rows, |row| &row.bench);
        let mut specimens = specimens_of(&rows);
        let part_of_bench = connected_parts(&benches, &specimens);
        let groups = groups_of(&mut specimens, &benches, &part_of_bench);
        QuantityData {
            years: years.collect(),
            known_variance: known_variance.collect(),
            form_variance,
            bench_form_share: 1.0,
            operators: Levels::of(&rows, |row| &row.operator),
            y,
            specimens,
            unit_of_group: vec![1.0; groups.len()],
            degrees_of_group: vec![f64::INFINITY; groups.len()],
            groups,
            benches,
            part_of_bench,
            rows,
        }
    }

    /// Years from the first run of the quantity to a time.
    pub(super) fn years_at(&self, time: Timestamp) -> f64 {
        years_since(self.rows.iter().map(|row| row.started_utc).min(), time)
    }

    /// Group of each row.
    pub(super) fn group_of_row(&self) -> Vec<usize> {
        let of_specimen = |s: &PooledSpecimen| vec![s.group; s.rows.len()];
        self.specimens.iter().flat_map(of_specimen).collect()
    }

    /// Unit of the group of each row.
    pub(super) fn unit_of_row(&self) -> Vec<f64> {
        let groups = self.group_of_row().into_iter();
        groups.map(|g| self.unit_of_group[g]).collect()
    }

    /// True if a specimen was tested on more than one bench.
    pub(super) fn travels(&self, specimen: usize) -> bool {
        let used = &self.benches.of_row[self.specimens[specimen].rows.clone()];
        used.iter().any(|bench| *bench != used[0])
    }

    /// Mean squared form error of some rows: the variance that their mean keeps, however many there are.
    pub(super) fn form_variance_of(&self, rows: &[usize]) -> f64 {
        rows.iter().map(|i| self.form_variance[*i]).sum::<f64>() / rows.len().max(1) as f64
    }

    /// Benches of a connected part, in the order of their names.
    pub(super) fn benches_of_part(&self, part: usize) -> Vec<usize> {
        let of_part = |bench: &usize| self.part_of_bench[*bench] == part;
        (0..self.benches.names.len()).filter(of_part).collect()
    }

    /// Number of connected parts.
    pub(super) fn parts(&self) -> usize {
        self.part_of_bench.iter().max().map_or(0, |most| most + 1)
    }

    /// Rows of a group, or of one of its batches.
    pub(super) fn rows_of_group(&self, group: usize, batch: Option<&str>) -> Vec<usize> {
        let of_group = |s: &&PooledSpecimen| s.group == group && batch.is_none_or(|b| s.batch == b);
        let specimens = self.specimens.iter().filter(of_group);
        specimens.flat_map(|s| s.rows.clone()).collect()
    }
}

fn years_since(first: Option<Timestamp>, time: Timestamp) -> f64 {
    first.map_or(0.0, |first| time.duration_since(first).as_secs_f64()) / YEAR_S
}

fn specimens_of<'r>(rows: &[&'r EstimateRow]) -> Vec<PooledSpecimen<'r>> {
    let mut specimens: Vec<PooledSpecimen> = Vec::new();
    for (index, row) in rows.iter().enumerate() {
        match specimens.last_mut() {
            Some(last) if last.name == row.specimen && last.family == row.family => last.rows.end = index + 1,
            _ => specimens.push(PooledSpecimen {
                name: &row.specimen,
                family: &row.family,
                batch: &row.batch,
                group: 0,
                rows: index..index + 1,
            }),
        }
    }
    specimens
}

/// Part of each bench; parts are numbered in the order of their first bench.
fn connected_parts(benches: &Levels, specimens: &[PooledSpecimen]) -> Vec<usize> {
    let mut part: Vec<usize> = (0..benches.names.len()).collect();
    for specimen in specimens {
        let used = &benches.of_row[specimen.rows.clone()];
        for pair in used.windows(2) {
            let (a, b) = (part[pair[0]].min(part[pair[1]]), part[pair[0]].max(part[pair[1]]));
            part.iter_mut().filter(|p| **p == b).for_each(|p| *p = a);
        }
    }
    let numbers: BTreeSet<usize> = part.iter().copied().collect();
    let numbers: Vec<usize> = numbers.into_iter().collect();
    part.iter().map(|p| numbers.partition_point(|n| n < p)).collect()
}

/// The groups, and in each specimen the number of its group.
fn groups_of<'r>(
    specimens: &mut [PooledSpecimen<'r>],
    benches: &Levels,
    part_of_bench: &[usize],
) -> Vec<SpecimenGroup<'r>> {
    let part = |s: &PooledSpecimen| part_of_bench[benches.of_row[s.rows.start]];
    let keys: BTreeSet<(&str, usize)> = specimens.iter().map(|s| (s.family, part(s))).collect();
    let keys: Vec<(&str, usize)> = keys.into_iter().collect();
    for specimen in specimens.iter_mut() {
        let key = (specimen.family, part(specimen));
        specimen.group = keys.partition_point(|k| *k < key);
    }
    let group = |(number, &(family, part)): (usize, &(&'r str, usize))| {
        let of_group = specimens.iter().filter(|s| s.group == number);
        let batches: BTreeSet<&str> = of_group.clone().map(|s| s.batch).collect();
        let used: BTreeSet<usize> = of_group
            .flat_map(|s| benches.of_row[s.rows.clone()].iter().copied())
            .collect();
        SpecimenGroup {
            family,
            part,
            batches: batches.into_iter().collect(),
            benches: used.into_iter().collect(),
        }
    };
    keys.iter().enumerate().map(group).collect()
}
