//! The recordings of a lab: each run in the equations of its specimen, with the errors of its bench and instruments.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::lab::{Lab, MOUNTING_SPREAD};
use super::lab_test::LabTest;
use super::nuisance::Nuisance;
use super::{between, normal};
use crate::recording::Recording;

/// Noise of the load cell in N and of the LVDT in mm.
const NOISE: [f64; 2] = [0.6, 1e-3];
/// Standard deviation of the zeros that a tare leaves, N and mm.
const ZERO: [f64; 2] = [1.0, 5e-3];
/// Share of the runs with an imperfect instrument.
const IMPERFECT: f64 = 0.1;

impl Lab {
    /// Takes the recording of run `number`, from 0, with the test of its family. The same number gives the same bits.
    pub(crate) fn record(&self, number: usize, test: &LabTest) -> Recording {
        self.record_and_tell(number, test).0
    }

    /// The same, and true if an instrument was imperfect.
    pub(crate) fn record_and_tell(&self, number: usize, test: &LabTest) -> (Recording, bool) {
        let run = &self.runs[number];
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(number as u64);
        let mounting = MOUNTING_SPREAD.map(|spread| 1.0 + spread * normal(&mut random));
        let specimen = self.mounted(run, mounting);
        let hidden = self.specimens[run.specimen].hidden.as_slice();
        let bench = &self.benches[run.bench];
        let motion = test.motion();
        let count = (test.duration_s() * bench.sample_rate_hz) as usize;
        let time_s: Vec<f64> = (0..count).map(|k| k as f64 / bench.sample_rate_hz).collect();
        let late_s: Vec<f64> = time_s.iter().map(|t| t - bench.force_lag_s).collect();
        let zero = ZERO.map(|sigma| sigma * normal(&mut random));
        let force_n = specimen.forces(hidden, &motion, &late_s);
        let displacement_mm = specimen.seen_mm(hidden, &motion, &time_s);
        let mut noisy =
            |value: f64, channel: usize| value + zero[channel] + NOISE[channel] * normal(&mut random);
        let mut recording = Recording {
            force_n: force_n
                .into_iter()
                .map(|f| noisy(bench.force_gain * f, 0))
                .collect(),
            displacement_mm: displacement_mm.into_iter().map(|x| noisy(x, 1)).collect(),
            time_s,
            ..Recording::default()
        };
        let is_imperfect = between(&mut random, 0.0, 1.0) < IMPERFECT;
        if is_imperfect {
            Nuisance::mild(&mut random).spoil(&mut random, &mut recording, NOISE[0], true);
        }
        (recording, is_imperfect)
    }
}

#[cfg(test)]
mod tests {
    use super::super::lab::LabRequest;
    use super::super::lab_test::LabCommand;
    use super::*;

    #[test]
    fn the_bench_that_reads_high_reads_one_percent_more() {
        let lab = Lab::draw(&LabRequest {
            seed: 2,
            specimens: 8,
            runs: 40,
            nothing: false,
        });
        let number = lab
            .runs
            .iter()
            .position(|r| r.bench == 1)
            .expect("20 runs of 40 are of travelling specimens");
        let mut right = lab.clone();
        right.benches[1].force_gain = 1.0;
        let command = |k: u32| LabCommand {
            displacement_mm: 10.0 - 10.0 * (f64::from(k) * 0.003).cos(),
            cycle: 0,
            segment: 1,
        };
        let test = LabTest {
            commands: (1..5000).map(command).collect(),
        };
        let top = |lab: &Lab| {
            let recording = lab.record(number, &test);
            recording.force_n.iter().copied().fold(0.0, f64::max)
        };
        // Both have the same noise, which is not multiplied: it is 0.1 % of the force at most.
        assert!((top(&lab) / top(&right) - 1.01).abs() < 1e-4);
        assert_eq!(lab.record(number, &test), lab.record(number, &test));
    }
}
