//! The rig of a case after its recordings were taken: specimen and sensors still stand there and can be asked again.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::sensors::Sensors;
use super::{Case, Programme, TruthSpecimen, path::Path};
use crate::recording::Recording;

/// What is tested and what it is measured with.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TruthRig {
    pub specimen: TruthSpecimen,
    pub sensors: Sensors,
}

impl Case {
    /// Plays one more test, the `number`th from 1, on the case's specimen with its hidden effects and records it with its
    /// sensors; `points` are time in s and displacement in mm. The same case and number give the same noise.
    pub(crate) fn play(&self, points: &[[f64; 2]], number: u32) -> Recording {
        let mut random = ChaCha8Rng::seed_from_u64(self.label.seed);
        // Streams that neither a case nor a seal uses.
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

    /// A test played afterwards is of the same spring: at the same displacement in the same direction it has the same force.
    #[test]
    fn the_specimen_is_the_one_that_was_recorded() {
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
                .expect("gets there");
            r.force_n[k]
        };
        let ratio = loading_n(&again) / loading_n(&case.recordings[0]);
        // A sample of travel, 1/3000 of the way, and noise of 1e-3 of the range at most.
        assert!((ratio - 1.0).abs() < 5e-3, "{ratio}");
    }
}
