//! A synthetic lab. Its random laws are not those of the fit: specimens follow a skewed law, runs scatter with heavy tails, standard
//! errors differ from run to run, and springs are sent to benches by family, not by chance.

use jiff::{SignedDuration, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Exp1, StandardNormal, StudentT};

use crate::fleet::estimate::{EstimateRow, EstimateScale};

/// What is true in a lab. The default has nothing to find.
#[derive(Debug, Clone)]
pub(in crate::fleet) struct SyntheticLab {
    pub families: usize,
    pub specimens: usize,
    pub runs: usize,
    /// Fraction by which the force of each bench reads high.
    pub force_gain: Vec<f64>,
    /// Fraction by which the displacement of each bench reads high.
    pub displacement_gain: Vec<f64>,
    /// Delay of the force of each bench, ms.
    pub delay_ms: Vec<f64>,
    /// Series compliance of the specimens of batch `m2` of family `F2`, in its one-step amplitude.
    pub batch_compliance: f64,
    /// Standard deviation of the rate between specimens of a family, a logarithm.
    pub rate_scatter: f64,
    /// Specimens with a rate of their own: number, and logarithm of the ratio to what it would be.
    pub outliers: Vec<(usize, f64)>,
    /// Growth of the friction ratio, fraction per 1000 cycles.
    pub friction_growth: f64,
    /// Series compliance that each bench adds, in its one-step amplitude.
    pub bench_compliance: Vec<f64>,
    /// Of five specimens so many are tested on a second bench, too.
    pub of_five_on_two_benches: usize,
    /// True: two operators take turns.
    pub operators: bool,
    /// True: specimens and runs follow the normal law, as the fit assumes.
    pub normal: bool,
}

impl Default for SyntheticLab {
    fn default() -> SyntheticLab {
        SyntheticLab {
            families: 4,
            specimens: 40,
            runs: 400,
            force_gain: vec![0.0; 3],
            displacement_gain: vec![0.0; 3],
            delay_ms: vec![0.0; 3],
            batch_compliance: 0.0,
            rate_scatter: QUANTITIES[0].4,
            outliers: Vec::new(),
            friction_growth: 0.0,
            bench_compliance: vec![0.0; 3],
            of_five_on_two_benches: 2,
            operators: true,
            normal: false,
        }
    }
}

/// Name, unit, scale, mean, standard deviation between specimens, from run to run, and mean standard error. Those of a relative quantity
/// are fractions.
type QuantityLaw = (&'static str, &'static str, EstimateScale, f64, f64, f64, f64);

const QUANTITIES: [QuantityLaw; 6] = [
    (
        "rate_n_per_mm",
        "N/mm",
        EstimateScale::Relative,
        80.0,
        0.012,
        0.003,
        0.002,
    ),
    (
        "preload_n",
        "N",
        EstimateScale::Relative,
        300.0,
        0.010,
        0.004,
        0.003,
    ),
    (
        "friction_ratio",
        "1",
        EstimateScale::Relative,
        0.14,
        0.04,
        0.015,
        0.01,
    ),
    (
        "presliding_mm",
        "mm",
        EstimateScale::Relative,
        0.4,
        0.05,
        0.02,
        0.02,
    ),
    (
        "series_compliance",
        "um/N",
        EstimateScale::Absolute,
        0.0,
        0.0,
        0.10,
        0.25,
    ),
    (
        "channel_delay",
        "ms",
        EstimateScale::Absolute,
        0.0,
        0.0,
        0.10,
        0.20,
    ),
];

/// A specimen of the lab.
struct SyntheticSpecimen {
    name: String,
    family: usize,
    batch: &'static str,
    benches: Vec<usize>,
    /// Day of its first run.
    first_day: f64,
    cycles_between_runs: f64,
    /// Deviation in each quantity.
    own: [f64; 6],
}

impl SyntheticLab {
    /// A small lab in which the second bench reads 1 % high and specimens scatter by 2 %. The rate of one is off; `ln_ratio`: logarithm
    /// of its ratio to what it would be.
    pub(in crate::fleet) fn with_stiff_specimen(specimen: usize, ln_ratio: f64) -> SyntheticLab {
        SyntheticLab {
            specimens: 24,
            runs: 144,
            rate_scatter: 0.02,
            force_gain: vec![0.0, 0.01, 0.0],
            outliers: vec![(specimen, ln_ratio)],
            ..SyntheticLab::default()
        }
    }

    /// The lab with everything that the report should find.
    pub(super) fn with_everything() -> SyntheticLab {
        SyntheticLab {
            force_gain: vec![0.0, 0.01, 0.0],
            delay_ms: vec![0.0, 0.0, 1.5],
            batch_compliance: 0.16,
            outliers: vec![(7, 0.18), (25, -0.17)],
            friction_growth: 0.002,
            ..SyntheticLab::default()
        }
    }

    /// The table of the lab.
    pub(in crate::fleet) fn table(&self, seed: u64) -> Vec<EstimateRow> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let specimens = self.draw_specimens(&mut random);
        let family_means = self.draw_family_means(&mut random);
        let start: Timestamp = "2024-01-08T08:00:00Z".parse().expect("a time");
        let mut rows = Vec::new();
        for run in 0..self.runs {
            let specimen = &specimens[run % self.specimens];
            let turn = run / self.specimens;
            let bench = specimen.benches[turn % specimen.benches.len()];
            let hours = 24.0 * (specimen.first_day + 15.0 * turn as f64 + 10.0 * random.random::<f64>());
            let age_cycles = (specimen.cycles_between_runs * turn as f64).round();
            let operator = random.random_range(1..=2);
            for (q, law) in QUANTITIES.iter().enumerate() {
                let shift =
                    self.shift(q, bench, age_cycles) + family_means[specimen.family][q] + specimen.own[q];
                let (estimate, std_error) = measured(law, shift, self.normal, &mut random);
                rows.push(EstimateRow {
                    run_id: format!("r{run:05}"),
                    specimen: specimen.name.clone(),
                    family: format!("F{}", specimen.family + 1),
                    batch: specimen.batch.to_owned(),
                    bench: format!("B{}", bench + 1),
                    operator: if self.operators {
                        format!("O{operator}")
                    } else {
                        String::new()
                    },
                    started_utc: start + SignedDuration::from_hours(hours as i64),
                    age_cycles,
                    quantity: law.0.to_owned(),
                    unit: law.1.to_owned(),
                    estimate,
                    std_error,
                    form_error: 0.0,
                    scale: law.2,
                });
            }
        }
        rows
    }

    /// Deviation of each specimen's rate from its family, a logarithm, as in the table of this seed.
    pub(in crate::fleet) fn rate_deviations(&self, seed: u64) -> Vec<(String, f64)> {
        let specimens = self.draw_specimens(&mut ChaCha8Rng::seed_from_u64(seed));
        specimens.into_iter().map(|s| (s.name, s.own[0])).collect()
    }

    /// Rate that each family scatters about in N/mm, as in the table of this seed.
    pub(in crate::fleet) fn family_rates(&self, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        self.draw_specimens(&mut random);
        let means = self.draw_family_means(&mut random);
        means.iter().map(|mean| QUANTITIES[0].3 * mean[0].exp()).collect()
    }

    /// Logarithms of the ratio of each family to the means of all.
    fn draw_family_means(&self, random: &mut ChaCha8Rng) -> Vec<[f64; 6]> {
        let mean = |_| std::array::from_fn(|q| if q < 4 { 0.1 * normal(random) } else { 0.0 });
        (0..self.families).map(mean).collect()
    }

    fn draw_specimens(&self, random: &mut ChaCha8Rng) -> Vec<SyntheticSpecimen> {
        (0..self.specimens).map(|s| self.specimen(s, random)).collect()
    }

    fn specimen(&self, number: usize, random: &mut ChaCha8Rng) -> SyntheticSpecimen {
        let (family, benches) = (number % self.families, self.force_gain.len());
        let place = number / self.families;
        let batch = if place.is_multiple_of(4) { "m1" } else { "m2" };
        let home = family % benches;
        let mut own = QUANTITIES.map(|law| {
            law.4
                * match self.normal {
                    true => normal(random),
                    false => skewed(random),
                }
        });
        own[0] *= self.rate_scatter / QUANTITIES[0].4;
        own[0] += self
            .outliers
            .iter()
            .filter(|(s, _)| *s == number)
            .map(|(_, shift)| shift)
            .sum::<f64>();
        own[4] += if family == 1 && batch == "m2" {
            self.batch_compliance
        } else {
            0.0
        };
        SyntheticSpecimen {
            name: format!("S{number:03}"),
            family,
            batch,
            benches: match place % 5 < self.of_five_on_two_benches {
                true => vec![home, (home + 1 + place % 2) % benches],
                false => vec![home],
            },
            first_day: 400.0 * random.random::<f64>(),
            cycles_between_runs: 1000.0 + 5000.0 * random.random::<f64>(),
            own,
        }
    }

    /// What bench and age add to a quantity.
    fn shift(&self, quantity: usize, bench: usize, age_cycles: f64) -> f64 {
        let [force, displacement] = [&self.force_gain, &self.displacement_gain].map(|g| g[bench].ln_1p());
        match quantity {
            0 => force - displacement,
            1 => force,
            2 => self.friction_growth.ln_1p() * age_cycles / 1000.0,
            3 => displacement,
            4 => self.bench_compliance[bench],
            5 => self.delay_ms[bench],
            _ => 0.0,
        }
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    random.sample(StandardNormal)
}

/// Skewed, with mean 0 and variance 1: half of a normal and an exponential law.
fn skewed(random: &mut ChaCha8Rng) -> f64 {
    let exponential: f64 = random.sample(Exp1);
    (normal(random) + exponential - 1.0) / f64::sqrt(2.0)
}

/// Estimate and standard error of one run.
fn measured(law: &QuantityLaw, shift: f64, is_normal: bool, random: &mut ChaCha8Rng) -> (f64, f64) {
    let (_, _, scale, mean, _, run_to_run, error) = *law;
    // Student's t with 5 degrees of freedom has the variance 5 / 3.
    let scatter = match is_normal {
        true => normal(random),
        false => random.sample(StudentT::new(5.0).expect("a law")) / f64::sqrt(5.0 / 3.0),
    };
    let error = error * (0.3 * normal(random)).exp();
    let value = shift + run_to_run * scatter + error * normal(random);
    match scale {
        EstimateScale::Relative => (mean * value.exp(), error * mean * value.exp()),
        EstimateScale::Absolute => (mean + value, error),
    }
}
