//! One hidden effect of a case. `catalogue` lists what can be hidden, `specimen` calculates the forces.

use super::world::Law;

/// One hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Hidden {
    /// Code of physics of `docs/formats.md`, or the name of physics that the library does not have.
    pub code: &'static str,
    /// Size of the effect, in the unit that the catalogue gives for the code.
    pub size: f64,
    /// Displacement in mm, speed in mm/s, time in s or number of cycles around which it acts, see the catalogue; 0 for an
    /// effect that acts everywhere.
    pub place: f64,
    /// Width in mm of a local effect.
    pub width: f64,
    /// Its law in a world other than `own`; `None` for an effect with one formula.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<Law>,
}

impl Hidden {
    /// Force in N at which a saturated channel clips; `top_n` is the largest force.
    pub(crate) fn limit_n(&self, top_n: f64) -> f64 {
        (1.0 - self.size) * top_n
    }
}
