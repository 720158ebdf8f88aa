//! Further recordings of a case with its specimen and its sensors.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{Case, Programme, path::Path};
use crate::recording::Recording;

impl Case {
    /// Takes one more recording with the specimen, the hidden effects and the sensors of the case. `points` are time in s and
    /// displacement in mm; `number` counts these recordings from 1. The same case and number give the same noise.
    pub(crate) fn play(&self, points: &[[f64; 2]], number: u32) -> Recording {
        let mut random = ChaCha8Rng::seed_from_u64(self.label.seed);
        // Random streams that neither the cases nor the sealed labels use.
        random.set_stream(self.label.number | u64::from(number) << 40);
        let name = format!("case-{:04}-next-{number}.csv", self.label.number);
        let motion = Programme::Path(Path::new(points));
        self.rig.sensors.record(
            &mut random,
            &self.rig.specimen,
            &self.label.hidden,
            &motion,
            &name,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A later recording is of the same spring: it has the same force at the same displacement on the same branch.
    #[test]
    fn a_later_recording_is_of_the_same_specimen() {
        let case = Case::single("progressive_stiffness", 3, 10.0).expect("visible");
        let top = case.label.top[0];
        let points = [[0.0, 0.0], [40.0, top], [80.0, 0.0]];
        let again = case.play(&points, 1);
        assert_eq!(again, case.play(&points, 1));
        assert_ne!(again.force_n, case.play(&points, 2).force_n);
        let loading_n = |r: &Recording| {
            let k = r
                .displacement_mm
                .iter()
                .position(|x| *x > 0.8 * top)
                .expect("the ramp passes 80 % of its top");
            r.force_n[k]
        };
        let ratio = loading_n(&again) / loading_n(&case.recordings[0]);
        // Tolerance: travel of one sample (1/3000 of the ramp), and noise of at most 1e-3 of the range.
        assert!((ratio - 1.0).abs() < 5e-3, "{ratio}");
    }
}
