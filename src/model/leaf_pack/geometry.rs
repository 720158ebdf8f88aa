//! Structure table of a leaf pack: leaves, mesh, mounting and options; and the mesh that follows from them.
//!
//! The mesh has a station wherever a leaf ends, so all leaves share their stations and a contact pairs two bodies of one
//! station. `segments` are split such that the longest segment is as short as possible: 84 give the 5, 4, 5 per side of the
//! first paper's spring (84 beams + 56 contacts + eye and pusher = its 142 force elements).

use serde::{Deserialize, Serialize};

use super::slip_law::SlipLaw;

/// One leaf as it lies on the bench, before assembly. Source of the default: Kadziela et al. (2015), Table 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Leaf {
    /// Length along the arc, mm. A leaf that is longer than the one above it is cut to that length.
    pub length_mm: f64,
    pub thickness_mm: f64,
    /// Radius of its free arc, mm, concave towards the eyes.
    pub radius_mm: f64,
    pub width_mm: f64,
}

/// How the eyes are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mounting {
    /// Both eyes on linear bearings on a guide rail.
    Rail,
    /// One eye on a pin in the load frame, the other on a shackle.
    Shackle,
}

/// Friction law of all sliding places, as the structure key `friction_law` names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum FrictionChoice {
    /// Elastic-plastic, independent of the rate.
    Presliding,
    /// The paper's law, regularised with `transition_velocity_mm_s`.
    Tanh,
}

/// Normal law of the leaf contacts, as the structure key `contact_law` names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum ContactChoice {
    /// Linear with `contact_stiffness_n_per_mm`. A line contact of two faces is nearly linear.
    Penalty,
    /// Hertz's sphere on a plane of `sphere_radius_mm`, as in the paper.
    Hertz,
}

/// Steps with or without inertia.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Dynamics {
    /// Static equilibrium at every step.
    QuasiStatic,
    /// Masses of all bodies and of the clamp.
    Full,
}

/// Most segments that a pack may have. A finer mesh does not change the force any more, but each step takes longer.
const MOST_SEGMENTS: usize = 2000;

/// The structure table of a leaf pack. The defaults are the first paper's spring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct PackStructure {
    /// Leaves, first the one with the eyes.
    pub leaves: Vec<Leaf>,
    /// Rigid segments of the whole pack, both sides. The mesh takes the nearest number that its stations allow.
    pub segments: usize,
    /// How the eyes are held.
    pub mounting: Mounting,
    pub friction_law: FrictionChoice,
    /// Transition velocity of the tanh law, mm/s.
    pub transition_velocity_mm_s: f64,
    /// Quasi-static or full dynamics.
    pub dynamics: Dynamics,
    /// Solves one side and mirrors it where the mounting is symmetric (rail). Same result, half the work.
    pub mirror: bool,
    /// Pin centre of the eye above the middle of leaf 1, mm.
    pub eye_offset_mm: f64,
    /// Radius of the eye pins, mm.
    pub pin_radius_mm: f64,
    /// Length of the shackle from pin to pin, mm.
    pub shackle_length_mm: f64,
    /// Normal law between leaves.
    pub contact_law: ContactChoice,
    /// Penalty stiffness of a leaf contact, N/mm.
    pub contact_stiffness_n_per_mm: f64,
    /// Sphere radius of the Hertz law, mm.
    pub sphere_radius_mm: f64,
    /// Tangential stiffness before sliding, N/mm. Below 1e5 the friction loops become too small.
    pub tangential_stiffness_n_per_mm: f64,
    /// Torsional stiffness of a pin before sliding, N mm/rad.
    pub pin_stiffness_nmm_per_rad: f64,
    /// Stiffness of pins, rail and pusher, N/mm.
    pub support_stiffness_n_per_mm: f64,
    /// Damping time xi of eq. (4), s.
    pub structural_damping_s: f64,
    /// Density of the leaves, kg/m3.
    pub density_kg_m3: f64,
    /// Mass of clamp and board, kg.
    pub clamp_mass_kg: f64,
}

impl Default for PackStructure {
    fn default() -> Self {
        let leaf = |length_mm, radius_mm| Leaf {
            length_mm,
            thickness_mm: 6.15,
            radius_mm,
            width_mm: 50.0,
        };
        Self {
            leaves: vec![
                leaf(880.0, 1168.0),
                leaf(920.0, 1035.0),
                leaf(660.0, 835.0),
                leaf(400.0, 790.0),
            ],
            segments: 84,
            mounting: Mounting::Rail,
            friction_law: FrictionChoice::Presliding,
            transition_velocity_mm_s: 1.0,
            dynamics: Dynamics::QuasiStatic,
            mirror: true,
            eye_offset_mm: 0.0,
            pin_radius_mm: 8.0,
            shackle_length_mm: 85.0,
            contact_law: ContactChoice::Penalty,
            contact_stiffness_n_per_mm: 2e5,
            sphere_radius_mm: 25.0,
            tangential_stiffness_n_per_mm: 2e5,
            pin_stiffness_nmm_per_rad: 1e8,
            support_stiffness_n_per_mm: 1e6,
            structural_damping_s: 0.0,
            density_kg_m3: 7850.0,
            clamp_mass_kg: 3.0,
        }
    }
}

impl PackStructure {
    /// The chosen friction law with its constant: a stiffness before sliding (N/mm, or N mm/rad at a pin), or a transition
    /// velocity (mm/s, or rad/s at a pin).
    pub(super) fn slip_law(&self, stiffness: f64, velocity: f64) -> SlipLaw {
        match self.friction_law {
            FrictionChoice::Presliding => SlipLaw::Presliding(stiffness),
            FrictionChoice::Tanh => SlipLaw::Tanh(velocity),
        }
    }

    /// The friction law between leaves, on the rail and on the board.
    pub(super) fn slide_law(&self) -> SlipLaw {
        self.slip_law(self.tangential_stiffness_n_per_mm, self.transition_velocity_mm_s)
    }

    /// Reads and checks a structure table.
    pub(crate) fn from_table(table: &toml::Table) -> Result<Self, String> {
        let structure: PackStructure = table
            .clone()
            .try_into()
            .map_err(|e: toml::de::Error| format!("{}: correct that key", e.message()))?;
        structure.check()?;
        Ok(structure)
    }

    /// Refuses values that no pack can have; the error says what to enter.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.leaves.is_empty() || self.leaves.len() > 12 {
            return Err(format!(
                "leaves has {} entries: enter 1 to 12 leaves",
                self.leaves.len()
            ));
        }
        for (i, leaf) in self.leaves.iter().enumerate() {
            for (key, value) in [
                ("length_mm", leaf.length_mm),
                ("thickness_mm", leaf.thickness_mm),
                ("radius_mm", leaf.radius_mm),
                ("width_mm", leaf.width_mm),
            ] {
                positive(&format!("leaves[{i}].{key}"), value)?;
            }
        }
        if self.segments > MOST_SEGMENTS {
            return Err(format!(
                "segments = {} is too large: enter at most {MOST_SEGMENTS}",
                self.segments
            ));
        }
        for (key, value) in [
            ("transition_velocity_mm_s", self.transition_velocity_mm_s),
            ("pin_radius_mm", self.pin_radius_mm),
            ("shackle_length_mm", self.shackle_length_mm),
            ("contact_stiffness_n_per_mm", self.contact_stiffness_n_per_mm),
            ("sphere_radius_mm", self.sphere_radius_mm),
            (
                "tangential_stiffness_n_per_mm",
                self.tangential_stiffness_n_per_mm,
            ),
            ("pin_stiffness_nmm_per_rad", self.pin_stiffness_nmm_per_rad),
            ("support_stiffness_n_per_mm", self.support_stiffness_n_per_mm),
            ("density_kg_m3", self.density_kg_m3),
            ("clamp_mass_kg", self.clamp_mass_kg),
        ] {
            positive(key, value)?;
        }
        if !(self.structural_damping_s >= 0.0 && self.structural_damping_s.is_finite()) {
            return Err(format!(
                "structural_damping_s = {} is not allowed: enter 0 or more",
                self.structural_damping_s
            ));
        }
        if !self.eye_offset_mm.is_finite() {
            return Err("eye_offset_mm is not a finite number: enter a finite number".to_owned());
        }
        Ok(())
    }
}

fn positive(key: &str, value: f64) -> Result<(), String> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(format!(
            "{key} = {value} is not allowed: enter a finite number above 0"
        ))
    }
}

/// Stations of one side: distance along the arc from the middle of the pack, and how many leaves reach them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mesh {
    pub station_mm: Vec<f64>,
    pub leaves_at: Vec<usize>,
}

impl Mesh {
    /// Stations outside a clamp of half length `start_mm` for leaves of these half lengths.
    pub(super) fn new(half_lengths_mm: &[f64], start_mm: f64, segments: usize) -> Result<Self, String> {
        let mut reach = Vec::with_capacity(half_lengths_mm.len());
        let mut shortest = f64::INFINITY;
        for (i, &half) in half_lengths_mm.iter().enumerate() {
            shortest = shortest.min(half);
            if shortest <= start_mm {
                return Err(format!(
                    "leaf {} ends within the clamp (the leaf is {} mm long, clamp_length_mm = {}): enter a longer leaf or a shorter clamp",
                    i + 1,
                    2.0 * shortest,
                    2.0 * start_mm
                ));
            }
            reach.push(shortest);
        }
        let mut ends = reach.clone();
        ends.reverse();
        ends.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let leaves: Vec<usize> = ends
            .iter()
            .map(|e| reach.iter().filter(|r| **r >= e - 1e-9).count())
            .collect();
        let starts: Vec<f64> = std::iter::once(start_mm).chain(ends.iter().copied()).collect();
        let lengths: Vec<f64> = starts.windows(2).map(|w| w[1] - w[0]).collect();
        let counts = split_segments(&lengths, &leaves, segments / 2);
        let (mut station_mm, mut leaves_at) = (Vec::new(), Vec::new());
        for (i, &n) in counts.iter().enumerate() {
            for k in 1..=n {
                station_mm.push(starts[i] + lengths[i] * k as f64 / n as f64);
                leaves_at.push(leaves[i]);
            }
        }
        Ok(Self {
            station_mm,
            leaves_at,
        })
    }
}

/// Segments of each interval between leaf ends. One segment of an interval counts once per leaf; `budget` is the most in all.
fn split_segments(lengths: &[f64], leaves: &[usize], budget: usize) -> Vec<usize> {
    let mut counts = vec![1; lengths.len()];
    let mut used: usize = leaves.iter().sum();
    loop {
        let next = (0..lengths.len())
            .filter(|&i| used + leaves[i] <= budget)
            .max_by(|&a, &b| (lengths[a] / counts[a] as f64).total_cmp(&(lengths[b] / counts[b] as f64)));
        match next {
            Some(i) => {
                counts[i] += 1;
                used += leaves[i];
            }
            None => return counts,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALVES: [f64; 4] = [440.0, 460.0, 330.0, 200.0];

    #[test]
    fn the_default_mesh_is_that_of_the_paper() {
        let mesh = Mesh::new(&HALVES, 50.0, 84).expect("valid");
        assert_eq!(mesh.leaves_at.iter().sum::<usize>(), 42);
        assert_eq!(mesh.leaves_at.iter().map(|n| n - 1).sum::<usize>(), 28);
        let count = |n: usize| mesh.leaves_at.iter().filter(|x| **x == n).count();
        assert_eq!([count(4), count(3), count(2)], [5, 4, 5]);
        assert_eq!(mesh.station_mm.last().copied(), Some(440.0));
    }

    #[test]
    fn the_mesh_has_the_wanted_segments_or_up_to_3_fewer() {
        for segments in [0, 22, 44, 84, 172, 344, 688] {
            let mesh = Mesh::new(&HALVES, 50.0, segments).expect("valid");
            let got = 2 * mesh.leaves_at.iter().sum::<usize>();
            assert!(
                got == segments || (got > segments && segments < 18) || segments - got < 4,
                "{got} of {segments}"
            );
        }
    }

    /// With very large lengths, the tolerance of 1e-9 mm is lost in rounding. Once no leaf was counted for such an interval, and the
    /// loop that adds segments never ended.
    #[test]
    fn a_mesh_of_absurd_lengths_ends() {
        let mesh = Mesh::new(&[1e200, 1e17, 3.0], 2.0, 84).expect("valid");
        assert!(mesh.leaves_at.iter().all(|leaves| *leaves > 0));
    }

    #[test]
    fn wrong_structures_are_refused() {
        assert!(Mesh::new(&HALVES, 220.0, 84).is_err());
        let table: toml::Table = "segmnts = 3".parse().expect("toml");
        assert!(
            PackStructure::from_table(&table)
                .expect_err("unknown key")
                .contains("segmnts")
        );
        for text in ["leaves = []", "segments = 2001"] {
            let table: toml::Table = text.parse().expect("toml");
            assert!(PackStructure::from_table(&table).is_err(), "{text}");
        }
    }
}
