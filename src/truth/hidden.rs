//! What can be hidden in a truth: a code, its size in its own unit and where it acts. The forces are in `specimen`.

use rand_chacha::ChaCha8Rng;

use super::{TruthSpecimen, between, one_of};

/// One hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Hidden {
    /// Code of contracts.md, or the name of an outsider.
    pub code: &'static str,
    /// Size in the unit that [`Physics::size`] names.
    pub size: f64,
    /// Displacement, speed, time or cycles that it acts around, see [`Physics::place`].
    pub place: f64,
    /// Width in mm, for what is local.
    pub width: f64,
}

/// One thing that can be hidden.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Physics {
    /// Code of contracts.md, or the name of an outsider.
    pub code: &'static str,
    /// False for what no library has.
    pub in_library: bool,
    /// What its size means.
    pub size: &'static str,
    /// What its place means; empty where it has none.
    pub place: &'static str,
    /// Largest size that is still believable.
    pub largest: fn(&TruthSpecimen) -> f64,
    /// May the size be negative?
    pub signed: bool,
    /// Names in contracts' result that the size and the place can be compared with.
    pub compared: [Option<&'static str>; 2],
}

const fn physics(code: &'static str, size: &'static str, largest: fn(&TruthSpecimen) -> f64) -> Physics {
    Physics {
        code,
        in_library: true,
        size,
        place: "",
        largest,
        signed: false,
        compared: [None, None],
    }
}

/// All that can be hidden; sorted within the library and within the outsiders.
pub(crate) static PHYSICS: &[Physics] = &[
    Physics {
        compared: [Some("gap_mm"), None],
        ..physics("backlash", "gap, mm", |_| 2.0)
    },
    Physics {
        signed: true,
        compared: [Some("delay_ms"), None],
        ..physics("channel_delay", "lag of the force, ms", |_| 30.0)
    },
    Physics {
        compared: [Some("friction_n"), None],
        ..physics("coulomb_friction", "friction, N", |s| 0.15 * s.top_n())
    },
    Physics {
        signed: true,
        ..physics("geometric_stiffness", "change of rate, N/mm a mm", |s| {
            0.6 * s.rate_n_per_mm / s.top_mm()
        })
    },
    Physics {
        compared: [Some("mass_kg"), None],
        ..physics("inertia", "mass, kg", |_| 150.0)
    },
    Physics {
        compared: [Some("contact_mm"), None],
        ..physics("lift_off", "displacement of first touch, mm", |s| {
            0.3 * s.top_mm()
        })
    },
    physics("load_dependent_friction", "friction over load", |_| 0.3),
    physics("presliding", "travel, mm", |_| 3.0),
    Physics {
        place: "knee, mm",
        compared: [Some("extra_n_per_mm"), Some("knee_mm")],
        ..physics("progressive_stiffness", "extra rate, N/mm", |s| s.rate_n_per_mm)
    },
    Physics {
        place: "speed of the fading, mm/s",
        ..physics("rate_independent_friction", "friction over load", |_| 0.3)
    },
    Physics {
        place: "time constant, s",
        compared: [Some("arm_n_per_mm"), Some("time_constant_s")],
        ..physics("relaxation", "rate of the arm, N/mm", |s| 0.4 * s.rate_n_per_mm)
    },
    Physics {
        place: "cycles",
        signed: true,
        ..physics("run_in", "change of friction over load", |s| {
            0.6 * s.friction_ratio
        })
    },
    Physics {
        signed: true,
        compared: [Some("drift_n_per_min"), None],
        ..physics("sensor_drift", "drift, N a minute", |s| 0.2 * s.top_n())
    },
    physics("sensor_saturation", "share of the top force cut off", |_| 0.25),
    Physics {
        compared: [Some("compliance_mm_per_kn"), None],
        ..physics("series_compliance", "compliance, mm/kN", |s| {
            400.0 / s.rate_n_per_mm
        })
    },
    Physics {
        place: "speed of the fading, mm/s",
        ..physics("stribeck", "extra friction over load at rest", |s| {
            s.friction_ratio
        })
    },
    Physics {
        compared: [Some("damping_n_s_per_mm"), None],
        ..physics("viscous_damping", "damping, N s/mm", |s| 0.002 * s.top_n())
    },
    Physics {
        in_library: false,
        place: "middle, mm",
        ..physics("local_friction", "extra friction over load", |_| 0.3)
    },
    Physics {
        in_library: false,
        place: "wave length, mm",
        ..physics("ripple", "amplitude, N", |s| 0.05 * s.top_n())
    },
    Physics {
        in_library: false,
        place: "cycle",
        ..physics("strength_loss", "share of the load", |_| 0.4)
    },
];

/// The entry of a code.
pub(crate) fn find(code: &str) -> Option<&'static Physics> {
    PHYSICS.iter().find(|p| p.code == code)
}

impl Physics {
    /// Draws sign, place and width; the size is a unit for `limit` to scale.
    pub(crate) fn draw(&self, random: &mut ChaCha8Rng, specimen: &TruthSpecimen) -> Hidden {
        let top = specimen.top_mm();
        let u = between(random, 0.0, 1.0);
        let place = match self.code {
            "progressive_stiffness" => top * (0.4 + 0.35 * u),
            "rate_independent_friction" => 3.0 + 12.0 * u,
            "relaxation" => 1.0 + 15.0 * u,
            "run_in" => 1.5 + 3.0 * u,
            "stribeck" => 2.0 + 15.0 * u,
            "local_friction" => top * (0.3 + 0.3 * u),
            "ripple" => 1.5 + 2.0 * u,
            "strength_loss" => 1.5 + 2.0 * u,
            _ => 0.0,
        };
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
    /// Axis of contracts.md and interval in which it acts, where it is local; `top_mm` is the largest displacement.
    /// A channel that clips is not local here: no recorded force lies above its rail.
    pub(crate) fn interval(&self, top_mm: f64) -> Option<(&'static str, f64, f64)> {
        match self.code {
            "backlash" => Some(("distance_from_reversal_mm", 0.0, self.size)),
            "lift_off" => Some(("displacement_mm", 0.0, self.size)),
            "local_friction" => Some((
                "displacement_mm",
                self.place - 0.5 * self.width,
                self.place + 0.5 * self.width,
            )),
            "progressive_stiffness" => Some(("displacement_mm", self.place, top_mm)),
            _ => None,
        }
    }

    /// Force at which a saturated channel stops.
    pub(crate) fn limit_n(&self, top_n: f64) -> f64 {
        (1.0 - self.size) * top_n
    }

    /// Names and true values that an answer can be compared with.
    pub(crate) fn parameters(&self, top_n: f64) -> Vec<(&'static str, f64)> {
        if self.code == "sensor_saturation" {
            return vec![("limit_n", self.limit_n(top_n))];
        }
        let Some(physics) = find(self.code) else {
            return Vec::new();
        };
        physics
            .compared
            .iter()
            .zip([self.size, self.place])
            .filter_map(|(name, value)| name.map(|n| (n, value)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_outsiders_stand_last() {
        let mut codes: Vec<_> = PHYSICS.iter().map(|p| p.code).collect();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), PHYSICS.len());
        assert!(PHYSICS.windows(2).all(|w| w[0].in_library || !w[1].in_library));
    }

    #[test]
    fn what_an_answer_is_compared_with() {
        let knee = Hidden {
            code: "progressive_stiffness",
            size: 12.0,
            place: 9.0,
            width: 0.0,
        };
        assert_eq!(
            knee.parameters(2000.0),
            [("extra_n_per_mm", 12.0), ("knee_mm", 9.0)]
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
