//! The friction of the model in a general form: its transition after a reversal follows no particular law.
//!
//! ```text
//! F = F_in + E sum c_i r_i,   r_i: mean of three elements, each limited to [-1, 1]
//! dr = dx / l (E_0 / E)^s - m r dE / E,   l within band i,  E_0 = 1000 N
//! ```
//! E: load that the contacts carry, N. c_i: `ratio_i`, friction divided by load of band i. l: length of an element at E_0, mm.
//! s: `length_exponent`, power of the load with which the lengths grow. m: `force_memory`, 0: where the load changes, the friction
//! follows it at once; 1: an element keeps its force until it slides further. s = m = 1 is an element of constant stiffness with a
//! limit in proportion to the load (Jenkins; bristles of Canudas de Wit). F_in: force of the plant inside, N.
//! Source: elastic-plastic (Jenkins) elements in parallel, a Prandtl-Ishlinskii model; W. D. Iwan (1966).
//! Range: any friction that reverses over 0.01 to 10 mm and closes its nested loops (Masing 1926).
//! It is not missing physics: the friction law is generalised first, so that its shape is not reported as missing physics.
//! The force is linear in the ratios, so that only s and m need several starts.

use std::sync::Arc;

use super::motion::BandedTravel;
use super::power::Power;
use super::{Effect, LookAlike, Stage, Wrap, everywhere, pressing_n, wrapped};
use crate::model::{Motion, Parameter, Plant};

/// Edges of the length bands, mm. No usual sampling resolves the first band; the others grow by about 1.5.
const BANDS_MM: [f64; BANDS + 1] = [
    0.004, 0.02, 0.035, 0.055, 0.08, 0.12, 0.18, 0.26, 0.38, 0.56, 0.82, 1.2, 1.8, 2.6, 3.8, 5.6, 8.0,
];
/// Number of length bands.
const BANDS: usize = 16;
/// Load at which the lengths are those of the bands, N.
const REFERENCE_N: f64 = 1000.0;
/// Below this load the contacts are open, N.
const OPEN_N: f64 = 1.0;
/// Number of elements in a band.
const ELEMENTS_PER_BAND: usize = 3;

const fn ratio(name: &'static str) -> Parameter {
    Parameter {
        name,
        unit: "",
        start: 0.0,
        bounds: [0.0, 0.9],
        belief: [0.0, 0.2],
        what: "friction divided by load of the elements in this length band; band 0 is the shortest",
    }
}

/// One of [`super::FORMS`].
pub(crate) const FORM: Effect = Effect {
    code: "friction_form",
    stage: Stage::Interleaf,
    follows_path: true,
    only_rival: false,
    parameters: &[
        ratio("ratio_0"),
        ratio("ratio_1"),
        ratio("ratio_2"),
        ratio("ratio_3"),
        ratio("ratio_4"),
        ratio("ratio_5"),
        ratio("ratio_6"),
        ratio("ratio_7"),
        ratio("ratio_8"),
        ratio("ratio_9"),
        ratio("ratio_10"),
        ratio("ratio_11"),
        ratio("ratio_12"),
        ratio("ratio_13"),
        ratio("ratio_14"),
        ratio("ratio_15"),
        Parameter {
            name: "length_exponent",
            unit: "",
            start: 0.0,
            bounds: [0.0, 1.0],
            belief: [0.0, 1.0],
            what: "power of the load with which the lengths grow: 0 for the same travel at every load, 1 for a constant stiffness",
        },
        Parameter {
            name: "force_memory",
            unit: "",
            start: 0.0,
            bounds: [0.0, 1.0],
            belief: [0.0, 1.0],
            what: "share of the friction force that an element keeps where the load changes",
        },
    ],
    neutral: &[0.0; BANDS + 2],
    amplitudes: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
    kinks: &[],
    shapes: &[],
    starts: |_| {
        let start = |bent: [f64; 2]| {
            let mut start = vec![0.002; BANDS];
            start.extend(bent);
            start
        };
        vec![start([0.0, 0.0]), start([0.0, 1.0]), start([1.0, 1.0])]
    },
    statement: |v| {
        format!(
            "The friction of the model reverses in another form: {:.1} % of the load, over travels of 0.01 to 10 mm.",
            100.0 * v[..BANDS].iter().sum::<f64>()
        )
    },
    attach: |v, inside| wrapped(FrictionForm::new(v), inside),
    if_known: |effect, knows| {
        let known = knows("load_dependent_friction") && knows("presliding");
        known.then(|| effect.parameters.to_vec())
    },
    place: everywhere,
    plausible: super::always,
    confusable_with: &[
        LookAlike {
            code: "presliding",
            why: "the friction of the specimen reverses over another travel than the friction of the baseline",
            test: "nested reversals of 0.2 to 2 mm: backlash ends at a fixed travel, presliding needs a travel that depends on the friction force",
        },
        LookAlike {
            code: "backlash",
            why: "both reduce the force change just after each reversal",
            test: "nested reversals of 0.2 to 2 mm: backlash ends at a fixed travel, presliding needs a travel that depends on the friction force",
        },
    ],
};

/// Number of elements of all bands.
const ELEMENTS: usize = BANDS * ELEMENTS_PER_BAND;

struct FrictionForm {
    travel: BandedTravel,
    elements: Arc<ActiveElements>,
    /// Drag of each element, -1 to 1.
    drags: [f64; ELEMENTS],
    length_exponent: Power,
    force_memory: Power,
    /// Load at the last step, N, and the factor of the travel there.
    last: Option<[f64; 2]>,
}

/// ActiveElements of the bands whose ratio is not zero: most bands of a fitted law are, and their elements need no steps.
#[derive(Default)]
struct ActiveElements {
    per_mm: Vec<f64>,
    ratio: Vec<f64>,
}

impl Clone for FrictionForm {
    fn clone(&self) -> Self {
        FrictionForm {
            elements: Arc::clone(&self.elements),
            ..*self
        }
    }

    /// The solution of a compliance copies the contact at every trial, nearly always between two of the same law.
    fn clone_from(&mut self, source: &Self) {
        if !Arc::ptr_eq(&self.elements, &source.elements) {
            *self = source.clone();
            return;
        }
        let active = self.elements.per_mm.len();
        self.drags[..active].copy_from_slice(&source.drags[..active]);
        (self.travel, self.last) = (source.travel, source.last);
    }
}

impl FrictionForm {
    fn new(ratios: &[f64]) -> FrictionForm {
        let mut elements = ActiveElements::default();
        for (ratio, ends) in ratios.iter().zip(BANDS_MM.windows(2)) {
            if *ratio == 0.0 {
                continue;
            }
            for k in 0..ELEMENTS_PER_BAND {
                let within = (k as f64 + 0.5) / ELEMENTS_PER_BAND as f64;
                let length_mm = ends[0] * (ends[1] / ends[0]).powf(within);
                elements.per_mm.push(1.0 / length_mm);
                elements.ratio.push(ratio / ELEMENTS_PER_BAND as f64);
            }
        }
        FrictionForm {
            travel: BandedTravel::default(),
            elements: Arc::new(elements),
            drags: [0.0; ELEMENTS],
            length_exponent: Power::new(ratios[BANDS]),
            force_memory: Power::new(ratios[BANDS + 1]),
            last: None,
        }
    }

    /// Factors of the drags and of the travel at a load in N.
    fn factors(&mut self, load_n: f64) -> [f64; 2] {
        let [before_n, lengths] = self.last.unwrap_or([0.0; 2]);
        if load_n < OPEN_N {
            self.last = None;
            return [1.0, 1.0];
        }
        if self.last.is_none() {
            let lengths = self.length_exponent.of(REFERENCE_N / load_n);
            self.last = Some([load_n, lengths]);
            return [1.0, lengths];
        }
        // Both powers are of the ratio of two loads that follow each other, which is close to one: see `Power`.
        let falls = before_n / load_n;
        let lengths = lengths * self.length_exponent.of(falls);
        self.last = Some([load_n, lengths]);
        [self.force_memory.of(falls), lengths]
    }
}

impl Wrap for FrictionForm {
    fn reset(&mut self) {
        self.travel = BandedTravel::default();
        self.last = None;
        self.drags = [0.0; ELEMENTS];
    }

    fn told(&mut self, _motion: &Motion) {
        self.travel.tell();
    }

    fn step(&mut self, inside: &mut Box<dyn Plant>, displacement_mm: f64, dt_s: f64) -> f64 {
        let travel_mm = self.travel.advance(displacement_mm);
        let force_n = inside.step(displacement_mm, dt_s);
        let load_n = pressing_n(&**inside, force_n);
        let [kept, lengths] = self.factors(load_n);
        let elements = &*self.elements;
        let drags = &mut self.drags[..elements.per_mm.len()];
        let moved = lengths * travel_mm;
        for (drag, per_mm) in drags.iter_mut().zip(&elements.per_mm) {
            *drag = (kept * *drag + moved * per_mm).clamp(-1.0, 1.0);
        }
        // Three sums beside each other: one sum would wait for each of its additions.
        let mut sums = [0.0; ELEMENTS_PER_BAND];
        let bands = drags.chunks_exact(ELEMENTS_PER_BAND);
        for (drags, ratios) in bands.zip(elements.ratio.chunks_exact(ELEMENTS_PER_BAND)) {
            for k in 0..ELEMENTS_PER_BAND {
                sums[k] += ratios[k] * drags[k];
            }
        }
        force_n + load_n * sums.iter().sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::*;
    use super::*;

    #[test]
    fn neutral_values_change_nothing() {
        neutral_changes_nothing(&FORM);
    }

    #[test]
    fn force_by_hand() {
        // Full sliding upwards, then 1 mm back: the first band has reversed; in the last band (5.6 to 8 mm) each element moved by 1 mm.
        let mut ratios = [0.0; BANDS + 2];
        (ratios[0], ratios[15]) = (0.02, 0.04);
        let mut plant = (FORM.attach)(&ratios, spring());
        plant.step(50.0, 0.1);
        let lengths = [0.5, 1.5, 2.5].map(|k: f64| 5.6 * (8.0f64 / 5.6).powf(k / 3.0));
        let last = lengths.iter().map(|l| 1.0 - 1.0 / l).sum::<f64>() / 3.0;
        let expected = (100.0 + 80.0 * 49.0) * (1.0 - 0.02 + 0.04 * last);
        assert!((plant.step(49.0, 0.1) - expected).abs() < 1e-6);
    }

    /// Constant stiffness: an element that sticks keeps its force where the load rises, and adds c E_0 / l for each mm.
    #[test]
    fn with_both_exponents_an_element_has_a_constant_stiffness() {
        let mut values = [0.0; BANDS + 2];
        (values[15], values[16], values[17]) = (0.1, 1.0, 1.0);
        let mut plant = (FORM.attach)(&values, spring());
        let friction = |plant: &mut Box<dyn Plant>, x: f64| plant.step(x, 0.1) - (100.0 + 80.0 * x);
        let steps: Vec<f64> = (1..=4)
            .map(|i| friction(&mut plant, 0.1 * f64::from(i)))
            .collect();
        let per_mm = [0.5, 1.5, 2.5].map(|k: f64| 1.0 / (5.6 * (8.0f64 / 5.6).powf(k / 3.0)));
        let each_n = 0.1 * 1000.0 * 0.1 * per_mm.iter().sum::<f64>() / 3.0;
        for pair in steps.windows(2) {
            assert!((pair[1] - pair[0] - each_n).abs() < 1e-9, "{steps:?}, {each_n}");
        }
    }

    #[test]
    fn the_force_is_linear_in_the_ratios() {
        let force = |ratios: &[f64]| drive(&mut (FORM.attach)(ratios, spring()));
        let (mut a, mut b, mut both) = ([0.0; BANDS + 2], [0.0; BANDS + 2], [0.0; BANDS + 2]);
        (a[4], b[9]) = (0.01, 0.03);
        (both[4], both[9]) = (0.01, 0.03);
        let (a, b, both, none) = (force(&a), force(&b), force(&both), force(FORM.neutral));
        assert!(a != none && b != none);
        for k in 0..none.len() {
            assert!((both[k] + none[k] - a[k] - b[k]).abs() < 1e-9);
        }
    }
}
