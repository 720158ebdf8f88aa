//! The design of the mixed model: which columns a quantity needs, and how they are told from each other.
//!
//! Benches, operators and batches are coded so that their effects sum to zero. Columns come in the order of [`DesignTerm`]; one that
//! follows from earlier ones is left out. The columns `Allocation` hold, for each specimen, the mean of its bench columns: they take up
//! what specimens tested on one bench and specimens tested on another differ by, so that the effect of a bench is estimated within
//! specimens alone (Mundlak 1978). Without them a lab that sends its stiff springs to one bench would blame the bench.
//!
//! Specimens and batches of one family are compared within benches: there each group has a bench effect of its own (`BenchOfGroup`) in
//! place of `Bench` and `Allocation`, because the error of a model differs from bench to bench, and from family to family.

use nalgebra::DMatrix;

use super::mixed_model::{Contrast, MixedData, MixedFit, SparseRow};
use super::quantity_data::QuantityData;

/// A column of the design, or an effect that the columns give together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum DesignTerm {
    /// Mean of a group.
    Group(usize),
    /// Effect of a bench.
    Bench(usize),
    /// Effect of a bench in one group: number of the group, number of the bench.
    BenchOfGroup(usize, usize),
    /// Slope per 1000 cycles of age; of one group, or of all.
    Cycles(Option<usize>),
    /// Slope per year.
    Years,
    /// Effect of a batch of a group: number of the group, number of the batch in it.
    Batch(usize, usize),
    /// Effect of an operator.
    Operator(usize),
    /// Mean of a specimen that is set aside as an outlier.
    Outlier(usize),
    /// Mean of a bench column over the runs of a specimen.
    Allocation(usize),
}

/// What the design holds beside groups, benches and batches.
#[derive(Debug, Clone, Default)]
pub(super) struct DesignChoice {
    /// Specimens with a mean of their own.
    pub outliers: Vec<usize>,
    /// One slope with cycles for each group in place of one for all.
    pub slope_of_each_group: bool,
    pub operators: bool,
    /// A bench effect for each group in place of one for all.
    pub bench_of_each_group: bool,
}

/// Columns of a quantity, with the data of the mixed model. The data are in units of the groups: tau and sigma of a group are those of the
/// fit times its unit. Effects are in the unit of the quantity.
pub(super) struct Design<'d, 'r> {
    pub of: &'d QuantityData<'r>,
    terms: Vec<DesignTerm>,
    /// Column of each term; `None` for one that follows from earlier ones.
    columns: Vec<Option<usize>>,
    /// Means of cycles / 1000 and of years, which are subtracted.
    pub mean_age: [f64; 2],
    pub data: MixedData,
}

/// Share of a column that must not follow from earlier ones, squared.
const DEPENDENT: f64 = 1e-9;
/// Shortest time over which a slope per year is asked for, years: a slope over a few days is no slope per year.
const SHORTEST_YEARS: f64 = 0.25;

impl<'d, 'r> Design<'d, 'r> {
    pub(super) fn of(of: &'d QuantityData<'r>, choice: &DesignChoice) -> Design<'d, 'r> {
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / of.rows.len() as f64;
        let mean_age = [
            mean(&mut of.rows.iter().map(|row| row.age_cycles / 1000.0)),
            mean(&mut of.years.iter().copied()),
        ];
        let terms = terms(of, choice);
        let full = rows(of, choice, &terms, mean_age);
        let columns = independent(&full, terms.len());
        let unit = of.unit_of_row();
        let kept = |(row, unit): (&SparseRow, &f64)| {
            let columns = row.iter().filter_map(|&(c, v)| Some((columns[c]?, v / unit)));
            columns.collect()
        };
        let variances = of.known_variance.iter().zip(&unit);
        let data = MixedData {
            y: of.y.iter().zip(&unit).map(|(y, unit)| y / unit).collect(),
            known_variance: variances.map(|(v, unit)| v / (unit * unit)).collect(),
            rows: full.iter().zip(&unit).map(kept).collect(),
            blocks: of.specimens.iter().map(|s| s.rows.clone()).collect(),
            width: columns.iter().flatten().count(),
        };
        Design {
            of,
            terms,
            columns,
            mean_age,
            data,
        }
    }

    /// True if the design has the term and its column does not follow from others.
    pub(super) fn has(&self, term: DesignTerm) -> bool {
        self.column(term).is_some()
    }

    /// True if the term was wanted, but follows from others.
    pub(super) fn is_confounded(&self, term: DesignTerm) -> bool {
        self.terms.contains(&term) && !self.has(term)
    }

    fn column(&self, term: DesignTerm) -> Option<usize> {
        let index = self.terms.iter().position(|t| *t == term)?;
        self.columns[index]
    }

    /// A sum of effects, each with its weight; `None` if one of them cannot be told. Effects of benches, operators and batches are
    /// those about their mean.
    pub(super) fn contrast(&self, fit: &MixedFit, weights: &[(DesignTerm, f64)]) -> Option<Contrast> {
        let mut columns = Vec::new();
        for &(term, weight) in weights {
            for (term, share) in self.coded(term) {
                columns.push((self.column(term)?, weight * share));
            }
        }
        Some(fit.contrast(&columns))
    }

    /// The effects that belong to a specimen alone: where it was tested so far, and its mean if it is set aside.
    pub(super) fn effects_of_specimen(&self, specimen: usize) -> Vec<(DesignTerm, f64)> {
        let shares = allocation(self.of).swap_remove(specimen).into_iter();
        let shares = shares.map(|(bench, share)| (DesignTerm::Allocation(bench), share));
        shares.chain([(DesignTerm::Outlier(specimen), 1.0)]).collect()
    }

    /// Columns of a row with these effects, each with its value. An effect that the columns cannot tell is left out: what it is belongs to
    /// the others then.
    pub(super) fn entries(&self, weights: &[(DesignTerm, f64)]) -> SparseRow {
        let coded = weights.iter().flat_map(|&(term, weight)| {
            let shares = self.coded(term).into_iter();
            shares.map(move |(term, share)| (term, weight * share))
        });
        coded
            .filter_map(|(term, value)| Some((self.column(term)?, value)))
            .collect()
    }

    /// The columns that an effect is the sum of.
    fn coded(&self, term: DesignTerm) -> Vec<(DesignTerm, f64)> {
        coded(self.of, term)
    }
}

/// The columns that an effect is the sum of: itself, or for the last level of a factor, minus all other levels.
fn coded(of: &QuantityData, term: DesignTerm) -> Vec<(DesignTerm, f64)> {
    let levels = match term {
        DesignTerm::Bench(b) => of
            .benches_of_part(of.part_of_bench[b])
            .into_iter()
            .map(DesignTerm::Bench)
            .collect(),
        DesignTerm::BenchOfGroup(g, _) => (of.groups[g].benches.iter())
            .map(|b| DesignTerm::BenchOfGroup(g, *b))
            .collect(),
        DesignTerm::Operator(_) => (0..of.operators.names.len()).map(DesignTerm::Operator).collect(),
        DesignTerm::Batch(g, _) => (0..of.groups[g].batches.len())
            .map(|b| DesignTerm::Batch(g, b))
            .collect(),
        _ => vec![term],
    };
    match levels.split_last() {
        Some((last, others)) if *last == term && !is_single(term) => {
            others.iter().map(|t| (*t, -1.0)).collect()
        }
        _ => vec![(term, 1.0)],
    }
}

/// True for a term that is no level of a factor.
fn is_single(term: DesignTerm) -> bool {
    !matches!(
        term,
        DesignTerm::Bench(_) | DesignTerm::BenchOfGroup(..) | DesignTerm::Operator(_) | DesignTerm::Batch(..)
    )
}

/// All wanted columns, in the order in which they are kept.
fn terms(of: &QuantityData, choice: &DesignChoice) -> Vec<DesignTerm> {
    let mut benches = Vec::new();
    for part in (0..of.parts()).filter(|_| !choice.bench_of_each_group) {
        let levels = of.benches_of_part(part);
        benches.extend_from_slice(levels.split_last().map_or(&[][..], |(_, others)| others));
    }
    let of_groups = of
        .groups
        .iter()
        .enumerate()
        .filter(|_| choice.bench_of_each_group);
    let of_groups = of_groups.flat_map(|(g, group)| {
        let others = group.benches.split_last().map_or(&[][..], |(_, others)| others);
        others.iter().map(move |b| DesignTerm::BenchOfGroup(g, *b))
    });
    let batches = of.groups.iter().enumerate().flat_map(|(g, group)| {
        (0..group.batches.len().saturating_sub(1)).map(move |b| DesignTerm::Batch(g, b))
    });
    let operators = if choice.operators {
        of.operators.names.len().saturating_sub(1)
    } else {
        0
    };
    let slopes: Vec<Option<usize>> = match choice.slope_of_each_group {
        true => (0..of.groups.len()).map(Some).collect(),
        false => vec![None],
    };
    let has_cycles = varies(of.rows.iter().map(|row| row.age_cycles)) > 0.0;
    let has_years = varies(of.years.iter().copied()) >= SHORTEST_YEARS;
    let groups = (0..of.groups.len()).map(DesignTerm::Group);
    groups
        .chain(benches.iter().copied().map(DesignTerm::Bench))
        .chain(of_groups)
        .chain(slopes.into_iter().filter(|_| has_cycles).map(DesignTerm::Cycles))
        .chain(has_years.then_some(DesignTerm::Years))
        .chain(batches)
        .chain((0..operators).map(DesignTerm::Operator))
        .chain(choice.outliers.iter().copied().map(DesignTerm::Outlier))
        .chain(benches.iter().copied().map(DesignTerm::Allocation))
        .collect()
}

/// Greatest minus least value.
fn varies(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    high - low
}

/// The rows over all wanted columns.
fn rows(
    of: &QuantityData,
    choice: &DesignChoice,
    terms: &[DesignTerm],
    mean_age: [f64; 2],
) -> Vec<SparseRow> {
    let column = |term: DesignTerm| terms.iter().position(|t| *t == term);
    let allocation = allocation(of);
    let mut all = Vec::with_capacity(of.rows.len());
    for (number, specimen) in of.specimens.iter().enumerate() {
        let group = specimen.group;
        let batch = of.groups[group].batches.partition_point(|b| *b < specimen.batch);
        for index in specimen.rows.clone() {
            let row = of.rows[index];
            let mut entries: SparseRow = Vec::new();
            let mut add = |term: DesignTerm, value: f64| {
                let coded = coded(of, term).into_iter();
                entries.extend(coded.filter_map(|(t, share)| Some((column(t)?, value * share))));
            };
            add(DesignTerm::Group(group), 1.0);
            add(DesignTerm::Bench(of.benches.of_row[index]), 1.0);
            add(DesignTerm::BenchOfGroup(group, of.benches.of_row[index]), 1.0);
            let slope = choice.slope_of_each_group.then_some(group);
            add(DesignTerm::Cycles(slope), row.age_cycles / 1000.0 - mean_age[0]);
            add(DesignTerm::Years, of.years[index] - mean_age[1]);
            add(DesignTerm::Batch(group, batch), 1.0);
            add(DesignTerm::Operator(of.operators.of_row[index]), 1.0);
            add(DesignTerm::Outlier(number), 1.0);
            for &(bench, share) in &allocation[number] {
                add(DesignTerm::Allocation(bench), share);
            }
            entries.retain(|(_, value)| *value != 0.0);
            all.push(entries);
        }
    }
    all
}

/// For each specimen the mean of its bench columns, less the mean over its group.
fn allocation(of: &QuantityData) -> Vec<Vec<(usize, f64)>> {
    let benches = of.benches.names.len();
    let share_of = |specimen: usize| {
        let rows = of.specimens[specimen].rows.clone();
        let mut shares = vec![0.0; benches];
        for index in rows.clone() {
            for (term, share) in coded(of, DesignTerm::Bench(of.benches.of_row[index])) {
                if let DesignTerm::Bench(b) = term {
                    shares[b] += share / rows.len() as f64;
                }
            }
        }
        shares
    };
    let shares: Vec<Vec<f64>> = (0..of.specimens.len()).map(share_of).collect();
    let mut means = vec![vec![0.0; benches]; of.groups.len()];
    let mut counts = vec![0.0; of.groups.len()];
    for (specimen, shares) in of.specimens.iter().zip(&shares) {
        counts[specimen.group] += 1.0;
        means[specimen.group]
            .iter_mut()
            .zip(shares)
            .for_each(|(m, s)| *m += s);
    }
    let about_mean = |(specimen, shares): (usize, &Vec<f64>)| {
        let group = of.specimens[specimen].group;
        let entries = shares.iter().zip(&means[group]).enumerate();
        entries.map(|(b, (s, m))| (b, s - m / counts[group])).collect()
    };
    shares.iter().enumerate().map(about_mean).collect()
}

/// The number of each column among those that do not follow from earlier ones (Cholesky of X'X, column by column).
fn independent(rows: &[SparseRow], width: usize) -> Vec<Option<usize>> {
    let mut normal = DMatrix::<f64>::zeros(width, width);
    for row in rows {
        for &(i, x) in row {
            for &(j, z) in row {
                normal[(i, j)] += x * z;
            }
        }
    }
    let mut factor = DMatrix::<f64>::zeros(width, width);
    let mut numbers: Vec<Option<usize>> = Vec::new();
    let mut kept: Vec<usize> = Vec::new();
    for j in 0..width {
        for (n, &k) in kept.iter().enumerate() {
            let before: f64 = (0..n).map(|l| factor[(j, l)] * factor[(k, l)]).sum();
            factor[(j, n)] = (normal[(j, k)] - before) / factor[(k, n)];
        }
        let rest = normal[(j, j)] - (0..kept.len()).map(|n| factor[(j, n)].powi(2)).sum::<f64>();
        let stands_alone = rest > DEPENDENT * normal[(j, j)];
        numbers.push(stands_alone.then_some(kept.len()));
        if stands_alone {
            let n = kept.len();
            factor[(j, n)] = rest.sqrt();
            kept.push(j);
        }
    }
    numbers
}
