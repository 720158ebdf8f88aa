//! Catalogue of what can be hidden in a case. The forces are calculated in `specimen`, those of the laws in `foreign`.

use rand_chacha::ChaCha8Rng;

use super::world::Law;
use super::{Hidden, TruthSpecimen, World, between, one_of};

/// One kind of physics that can be hidden.
pub(crate) struct Physics {
    /// Code of physics of `docs/formats.md`, or the name of physics that the library does not have.
    pub code: &'static str,
    /// False for physics that the library does not have.
    pub in_library: bool,
    /// Largest size that is plausible for a specimen.
    pub largest: fn(&TruthSpecimen) -> f64,
    /// True if the size may be negative.
    pub signed: bool,
    /// The place, from a uniform random number in [0, 1] and the largest displacement in mm.
    place: fn(random: f64, top_mm: f64) -> f64,
    /// Interval in which it acts, see [`Hidden::interval`].
    interval: fn(&Hidden, top_mm: f64) -> Option<Interval>,
    /// Parameters of the effect with this code that size and place are compared with.
    pub compared: [Option<&'static str>; 2],
    /// True values of the parameters in `compared`; the second argument is the largest force in N.
    truth: fn(&Hidden, top_n: f64) -> [f64; 2],
    /// Names of the laws that it may follow in the worlds other than `own`.
    pub laws: &'static [&'static str],
    /// False for what cannot be hidden in [`World::Own`].
    in_own: bool,
    /// Codes that it is not wrong to name instead or beside.
    pub also: &'static [&'static str],
}

/// Codes of physics that `equivalent` has: a case that hides one of them removes it from the baseline.
pub(super) const REDUCED: [&str; 3] = [
    "load_dependent_friction",
    "presliding",
    "rate_independent_friction",
];

/// Axis as in `docs/formats.md`, lower end, upper end.
type Interval = (&'static str, f64, f64);

/// An unsigned effect of the library that acts everywhere, with nothing to compare.
const fn physics(code: &'static str, largest: fn(&TruthSpecimen) -> f64) -> Physics {
    Physics {
        code,
        in_library: true,
        largest,
        signed: false,
        place: |_, _| 0.0,
        interval: |_, _| None,
        compared: [None, None],
        truth: |h, _| [h.size, h.place],
        laws: &[],
        in_own: true,
        also: &[],
    }
}

/// An effect that the library does not have and that only the worlds other than `own` have.
const fn foreign(code: &'static str, largest: fn(&TruthSpecimen) -> f64) -> Physics {
    Physics {
        in_library: false,
        in_own: false,
        ..physics(code, largest)
    }
}

/// Everything that can be hidden. The library comes first; both parts are sorted by code.
pub(crate) static PHYSICS: &[Physics] = &[
    // Size: gap, mm.
    Physics {
        compared: [Some("gap_mm"), None],
        interval: |h, _| Some(("distance_from_reversal_mm", 0.0, h.size)),
        laws: &[
            "pins with different wear",
            "rubber on both sides",
            "a wedge, worn more under load",
            "rubber on one side",
        ],
        ..physics("backlash", |_| 2.0)
    },
    // Size: delay of the force, ms.
    Physics {
        signed: true,
        compared: [Some("delay_ms"), None],
        laws: &[
            "pure delay",
            "first-order filter",
            "second-order filter",
            "fourth-order filter",
        ],
        ..physics("channel_delay", |_| 30.0)
    },
    // Size: friction, N.
    Physics {
        compared: [Some("friction_n"), None],
        laws: &[
            "one elastic-plastic stop",
            "sliders of lengths over two decades",
            "a short and a long slider",
            "friction that rises over 2 mm of sliding",
        ],
        ..physics("coulomb_friction", |s| 0.15 * s.top_n())
    },
    // Size: change of the rate with the displacement, N/mm2.
    Physics {
        signed: true,
        laws: &[
            "exponential",
            "tangent of a link",
            "arc of a camber",
            "logarithmic",
        ],
        ..physics("geometric_stiffness", |s| 0.6 * s.rate_n_per_mm / s.top_mm())
    },
    // Size: mass, kg.
    Physics {
        compared: [Some("mass_kg"), None],
        laws: &[
            "on a fixture that resonates",
            "on a lever",
            "in part on a fixture that resonates",
            "in part loose and late",
        ],
        ..physics("inertia", |_| 150.0)
    },
    // Size: displacement of the first contact, mm.
    Physics {
        compared: [Some("contact_mm"), None],
        interval: |h, _| Some(("displacement_mm", 0.0, h.size)),
        laws: &["soft corner", "elastic pad", "tilted board", "four uneven points"],
        ..physics("lift_off", |s| 0.3 * s.top_mm())
    },
    // Size: friction divided by load.
    Physics {
        laws: &[
            "load to the power of 0.8",
            "load to the power of 0.9",
            "load to the power of 1.1",
            "load to the power of 1.25",
        ],
        ..physics("load_dependent_friction", |_| 0.3)
    },
    // Size: travel over which the friction reverses, mm.
    physics("presliding", |_| 3.0),
    // Size: added rate, N/mm. Place: knee, mm.
    Physics {
        place: |u, top_mm| top_mm * (0.4 + 0.35 * u),
        compared: [Some("extra_rate_n_per_mm"), Some("knee_mm")],
        interval: |h, top_mm| Some(("displacement_mm", h.place, top_mm)),
        laws: &[
            "knee of a width",
            "branch with a power of 1.5 to 3",
            "two helpers",
            "helper that beds in",
        ],
        ..physics("progressive_stiffness", |s| s.rate_n_per_mm)
    },
    // Size: friction divided by load. Place: speed of the smoothing in the baseline, mm/s.
    Physics {
        place: |u, _| 3.0 + 12.0 * u,
        ..physics("rate_independent_friction", |_| 0.3)
    },
    // Size: rate of the spring that relaxes, N/mm. Place: time constant, s.
    Physics {
        place: |u, _| 1.0 + 15.0 * u,
        compared: [Some("arm_rate_n_per_mm"), Some("time_constant_s")],
        laws: &["two arms", "four arms", "power-law creep", "logarithmic creep"],
        ..physics("relaxation", |s| 0.4 * s.rate_n_per_mm)
    },
    // Size: change of friction divided by load. Place: number of cycles.
    Physics {
        place: |u, _| 1.5 + 3.0 * u,
        signed: true,
        laws: &[
            "power of the cycles",
            "exponential in the travel",
            "exponential in the work",
            "late, as a sigmoid",
        ],
        ..physics("run_in", |s| 0.6 * s.friction_ratio)
    },
    // Size: drift of the zero, N/min.
    Physics {
        signed: true,
        compared: [Some("drift_n_per_min"), None],
        laws: &["exponential", "wandering", "slow sine", "square root of time"],
        ..physics("sensor_drift", |s| 0.2 * s.top_n())
    },
    // Size: share of the largest force that is cut off. No interval: no recorded force is above the limit.
    Physics {
        compared: [Some("limit_n"), None],
        truth: |h, top_n| [h.limit_n(top_n), 0.0],
        laws: &["soft corner", "algebraic", "compression", "parabolic corner"],
        ..physics("sensor_saturation", |_| 0.25)
    },
    // Size: compliance, mm/kN.
    Physics {
        compared: [Some("compliance_mm_per_kn"), None],
        laws: &[
            "stiffening",
            "power of the force",
            "joint that closes",
            "two rates",
        ],
        ..physics("series_compliance", |s| 400.0 / s.rate_n_per_mm)
    },
    // Size: added friction divided by load at rest. Place: speed at which 37 % of it is left, mm/s.
    Physics {
        place: |u, _| 2.0 + 15.0 * u,
        laws: &["hyperbolic", "Lorentzian", "logarithmic", "linear"],
        ..physics("stribeck", |s| s.friction_ratio)
    },
    // Size: damping, N s/mm.
    Physics {
        compared: [Some("damping_n_s_per_mm"), None],
        laws: &[
            "power of 0.5 to 0.8",
            "power of 1.3 to 2",
            "seal, power of 0.3",
            "with a limit",
        ],
        ..physics("viscous_damping", |s| 0.002 * s.top_n())
    },
    // Size: a quarter of the rate of the rubber at the top, N/mm. Place: displacement at which it is touched, mm.
    Physics {
        place: |u, top_mm| top_mm * (0.55 + 0.25 * u),
        also: &["progressive_stiffness"],
        ..foreign("bump_stop", |s| 3.0 * s.rate_n_per_mm)
    },
    // Size: added friction divided by load. Place: middle of the interval, mm.
    Physics {
        in_library: false,
        place: |u, top_mm| top_mm * (0.3 + 0.3 * u),
        interval: |h, _| {
            Some((
                "displacement_mm",
                h.place - 0.5 * h.width,
                h.place + 0.5 * h.width,
            ))
        },
        ..physics("local_friction", |_| 0.3)
    },
    // Size: pull when it lets go, divided by the largest force. Place: middle of the magnet, mm.
    Physics {
        place: |u, top_mm| top_mm * (0.25 + 0.3 * u),
        ..foreign("magnetic_catch", |_| 0.2)
    },
    // Size: share of the friction that is missing in the middle of a stroke.
    foreign("pinching", |_| 0.95),
    // Size: amplitude, N. Place: wave length, mm.
    Physics {
        in_library: false,
        place: |u, _| 1.5 + 2.0 * u,
        ..physics("ripple", |s| 0.05 * s.top_n())
    },
    // Size: largest error of the LVDT divided by the largest displacement.
    Physics {
        signed: true,
        laws: &[
            "half a sine",
            "two straight lines",
            "logarithm",
            "power of 1.3 to 1.7",
        ],
        ..foreign("sensor_curvature", |_| 0.02)
    },
    // Size: share of the load that is lost. Place: number of cycles after which it is lost.
    Physics {
        in_library: false,
        place: |u, _| 1.5 + 2.0 * u,
        ..physics("strength_loss", |_| 0.4)
    },
    // Size: share of the friction that a hot contact loses. Place: time constant of the cooling, s.
    Physics {
        place: |u, _| 20.0 + 60.0 * u,
        ..foreign("warming", |_| 0.9)
    },
];

/// The entry of a code.
pub(crate) fn find(code: &str) -> Option<&'static Physics> {
    PHYSICS.iter().find(|p| p.code == code)
}

impl Physics {
    /// True if this can be hidden in a world. The pack cannot be without the friction of its leaves.
    pub(crate) fn is_in(&self, world: World) -> bool {
        match world {
            World::Own => self.in_own,
            World::Pack => !REDUCED.contains(&self.code),
            _ => true,
        }
    }

    /// Draws sign, place, width and law. The size is 1 or -1; `limit` scales it.
    pub(crate) fn draw(&self, random: &mut ChaCha8Rng, specimen: &TruthSpecimen) -> Hidden {
        let place = (self.place)(between(random, 0.0, 1.0), specimen.top_mm());
        let size = if self.signed {
            one_of(random, &[-1.0, 1.0])
        } else {
            1.0
        };
        let width = between(random, 2.0, 4.0);
        let law = (specimen.world != World::Own && !self.laws.is_empty()).then(|| {
            let numbers: Vec<usize> = (0..self.laws.len()).collect();
            let number = one_of(random, &numbers);
            Law {
                number,
                name: self.laws[number],
                shape: between(random, 0.0, 1.0),
            }
        });
        Hidden {
            code: self.code,
            size,
            place,
            width,
            law,
        }
    }
}

impl Hidden {
    /// Axis of `docs/formats.md` and interval in which a local effect acts; `top_mm` is the largest displacement.
    pub(crate) fn interval(&self, top_mm: f64) -> Option<Interval> {
        find(self.code).and_then(|p| (p.interval)(self, top_mm))
    }

    /// Codes of the library that it is not wrong to name instead.
    pub(crate) fn also(&self) -> &'static [&'static str] {
        find(self.code).map_or(&[], |p| p.also)
    }

    /// Names and true values of the parameters that a diagnosis is compared with; `top_n` is the largest force in N.
    pub(crate) fn parameters(&self, top_n: f64) -> Vec<(&'static str, f64)> {
        let Some(physics) = find(self.code) else {
            return Vec::new();
        };
        let names = physics.compared.iter();
        names
            .zip((physics.truth)(self, top_n))
            .filter_map(|(name, value)| name.map(|n| (n, value)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_the_library_comes_first() {
        let mut codes: Vec<_> = PHYSICS.iter().map(|p| p.code).collect();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), PHYSICS.len());
        assert!(PHYSICS.windows(2).all(|w| w[0].in_library || !w[1].in_library));
    }

    #[test]
    fn every_effect_of_the_library_has_four_laws_or_is_the_friction_of_the_world() {
        for physics in PHYSICS.iter().filter(|p| p.in_library) {
            let of_world = ["presliding", "rate_independent_friction"].contains(&physics.code);
            assert_eq!(
                physics.laws.len(),
                if of_world { 0 } else { 4 },
                "{}",
                physics.code
            );
        }
    }

    #[test]
    fn parameters_and_intervals_by_hand() {
        let knee = Hidden {
            code: "progressive_stiffness",
            size: 12.0,
            place: 9.0,
            width: 0.0,
            law: None,
        };
        assert_eq!(
            knee.parameters(2000.0),
            [("extra_rate_n_per_mm", 12.0), ("knee_mm", 9.0)]
        );
        assert_eq!(knee.interval(25.0), Some(("displacement_mm", 9.0, 25.0)));
        let clip = Hidden {
            code: "sensor_saturation",
            size: 0.1,
            place: 0.0,
            width: 0.0,
            law: None,
        };
        assert_eq!(clip.parameters(2000.0), [("limit_n", 1800.0)]);
    }
}
