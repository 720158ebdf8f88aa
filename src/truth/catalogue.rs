//! Catalogue of what can be hidden in a case. The forces are calculated in `specimen`.

use rand_chacha::ChaCha8Rng;

use super::{Hidden, TruthSpecimen, between, one_of};

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
}

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
    }
}

/// Everything that can be hidden. The library comes first; both parts are sorted by code.
pub(crate) static PHYSICS: &[Physics] = &[
    // Size: gap, mm.
    Physics {
        compared: [Some("gap_mm"), None],
        interval: |h, _| Some(("distance_from_reversal_mm", 0.0, h.size)),
        ..physics("backlash", |_| 2.0)
    },
    // Size: delay of the force, ms.
    Physics {
        signed: true,
        compared: [Some("delay_ms"), None],
        ..physics("channel_delay", |_| 30.0)
    },
    // Size: friction, N.
    Physics {
        compared: [Some("friction_n"), None],
        ..physics("coulomb_friction", |s| 0.15 * s.top_n())
    },
    // Size: change of the rate with the displacement, N/mm2.
    Physics {
        signed: true,
        ..physics("geometric_stiffness", |s| 0.6 * s.rate_n_per_mm / s.top_mm())
    },
    // Size: mass, kg.
    Physics {
        compared: [Some("mass_kg"), None],
        ..physics("inertia", |_| 150.0)
    },
    // Size: displacement of the first contact, mm.
    Physics {
        compared: [Some("contact_mm"), None],
        interval: |h, _| Some(("displacement_mm", 0.0, h.size)),
        ..physics("lift_off", |s| 0.3 * s.top_mm())
    },
    // Size: friction divided by load.
    physics("load_dependent_friction", |_| 0.3),
    // Size: travel over which the friction reverses, mm.
    physics("presliding", |_| 3.0),
    // Size: added rate, N/mm. Place: knee, mm.
    Physics {
        place: |u, top_mm| top_mm * (0.4 + 0.35 * u),
        compared: [Some("extra_rate_n_per_mm"), Some("knee_mm")],
        interval: |h, top_mm| Some(("displacement_mm", h.place, top_mm)),
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
        ..physics("relaxation", |s| 0.4 * s.rate_n_per_mm)
    },
    // Size: change of friction divided by load. Place: number of cycles.
    Physics {
        place: |u, _| 1.5 + 3.0 * u,
        signed: true,
        ..physics("run_in", |s| 0.6 * s.friction_ratio)
    },
    // Size: drift of the zero, N/min.
    Physics {
        signed: true,
        compared: [Some("drift_n_per_min"), None],
        ..physics("sensor_drift", |s| 0.2 * s.top_n())
    },
    // Size: share of the largest force that is cut off. No interval: no recorded force is above the limit.
    Physics {
        compared: [Some("limit_n"), None],
        truth: |h, top_n| [h.limit_n(top_n), 0.0],
        ..physics("sensor_saturation", |_| 0.25)
    },
    // Size: compliance, mm/kN.
    Physics {
        compared: [Some("compliance_mm_per_kn"), None],
        ..physics("series_compliance", |s| 400.0 / s.rate_n_per_mm)
    },
    // Size: added friction divided by load at rest. Place: speed at which 37 % of it is left, mm/s.
    Physics {
        place: |u, _| 2.0 + 15.0 * u,
        ..physics("stribeck", |s| s.friction_ratio)
    },
    // Size: damping, N s/mm.
    Physics {
        compared: [Some("damping_n_s_per_mm"), None],
        ..physics("viscous_damping", |s| 0.002 * s.top_n())
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
    // Size: amplitude, N. Place: wave length, mm.
    Physics {
        in_library: false,
        place: |u, _| 1.5 + 2.0 * u,
        ..physics("ripple", |s| 0.05 * s.top_n())
    },
    // Size: share of the load that is lost. Place: number of cycles after which it is lost.
    Physics {
        in_library: false,
        place: |u, _| 1.5 + 2.0 * u,
        ..physics("strength_loss", |_| 0.4)
    },
];

/// The entry of a code.
pub(crate) fn find(code: &str) -> Option<&'static Physics> {
    PHYSICS.iter().find(|p| p.code == code)
}

impl Physics {
    /// Draws sign, place and width. The size is 1 or -1; `limit` scales it.
    pub(crate) fn draw(&self, random: &mut ChaCha8Rng, specimen: &TruthSpecimen) -> Hidden {
        let place = (self.place)(between(random, 0.0, 1.0), specimen.top_mm());
        let size = if self.signed {
            one_of(random, &[-1.0, 1.0])
        } else {
            1.0
        };
        Hidden {
            code: self.code,
            size,
            place,
            width: between(random, 2.0, 4.0),
        }
    }
}

impl Hidden {
    /// Axis of `docs/formats.md` and interval in which a local effect acts; `top_mm` is the largest displacement.
    pub(crate) fn interval(&self, top_mm: f64) -> Option<Interval> {
        find(self.code).and_then(|p| (p.interval)(self, top_mm))
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
    fn parameters_and_intervals_by_hand() {
        let knee = Hidden {
            code: "progressive_stiffness",
            size: 12.0,
            place: 9.0,
            width: 0.0,
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
        };
        assert_eq!(clip.parameters(2000.0), [("limit_n", 1800.0)]);
    }
}
