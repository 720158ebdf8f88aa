//! What the pack is made of: leaves, mesh, mounting and options, as a structure table gives them; and the mesh drawn from them.
//!
//! The mesh has a station wherever a leaf ends, so all leaves share their stations and a contact pairs two bodies of one
//! station. `segments` are shared out so that the longest segment is as short as can be: 84 give the 5, 4, 5 a side of
//! the first paper's spring (84 beams + 56 contacts + the two of eye and pusher = its 142 force elements).

use serde::{Deserialize, Serialize};

/// One leaf as it lies on the bench, before assembly. Source of the default: Kadziela et al. (2015), Table 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Leaf {
    /// Length along the arc, mm. A leaf reaches no further than the one above it: it is cut there.
    pub length_mm: f64,
    /// Thickness, mm.
    pub thickness_mm: f64,
    /// Radius of its free arc, mm, concave towards the eyes.
    pub radius_mm: f64,
    /// Width, mm.
    pub width_mm: f64,
}

/// How the eyes are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Mounting {
    /// Both eyes on linear bearings on a guide rail.
    Rail,
    /// One eye pinned to the frame, the other on a shackle.
    Shackle,
}

/// Friction law of all sliding places.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum FrictionChoice {
    /// Rate-independent elastic-plastic.
    Presliding,
    /// The paper's regularised law with `transition_velocity_mm_s`.
    Tanh,
}

/// Normal law of the leaf contacts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum NormalChoice {
    /// Linear: `contact_stiffness_n_per_mm`. A line contact of two faces is close to that.
    Penalty,
    /// Hertz's sphere on a plane of `sphere_radius_mm`, as in the paper.
    Hertz,
}

/// With or without inertia.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Dynamics {
    /// Equilibrium at every step.
    QuasiStatic,
    /// Masses of all bodies and of the clamp.
    Full,
}

/// The structure table of a leaf pack. Missing keys take the first paper's spring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct PackStructure {
    /// Leaves from the one with the eyes down.
    pub leaves: Vec<Leaf>,
    /// Rigid segments of the whole pack, both sides (the nearest number that the stations allow is taken).
    pub segments: usize,
    /// How the eyes are held.
    pub mounting: Mounting,
    /// Friction law.
    pub friction_law: FrictionChoice,
    /// Transition velocity of the tanh law, mm/s.
    pub transition_velocity_mm_s: f64,
    /// Quasi-static or full dynamics.
    pub dynamics: Dynamics,
    /// Solve one side and mirror it, where the mounting is symmetric (rail). Same result, half the work.
    pub mirror: bool,
    /// Pin centre of the eye above the middle of leaf 1, mm.
    pub eye_offset_mm: f64,
    /// Radius of the eye pins, mm.
    pub pin_radius_mm: f64,
    /// Shackle, pin to pin, mm.
    pub shackle_length_mm: f64,
    /// Normal law between leaves.
    pub contact_law: NormalChoice,
    /// Penalty stiffness of a leaf contact, N/mm.
    pub contact_stiffness_n_per_mm: f64,
    /// Sphere radius of the Hertz law, mm.
    pub sphere_radius_mm: f64,
    /// Tangential stiffness before sliding, N/mm. Below 1e5 the loops of dry friction are lost.
    pub tangential_stiffness_n_per_mm: f64,
    /// Torsional stiffness of a pin before sliding, N mm/rad.
    pub pin_stiffness_nmm_per_rad: f64,
    /// Stiffness of pins, rail and pusher, N/mm.
    pub support_stiffness_n_per_mm: f64,
    /// xi of eq. (4), s.
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
            contact_law: NormalChoice::Penalty,
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
    /// Reads and checks a structure table.
    pub(crate) fn from_table(table: &toml::Table) -> Result<Self, String> {
        let structure: PackStructure = table
            .clone()
            .try_into()
            .map_err(|e: toml::de::Error| format!("{}: correct that key", e.message()))?;
        structure.check()?;
        Ok(structure)
    }

    /// What is wrong with it, and what to do.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.leaves.is_empty() || self.leaves.len() > 12 {
            return Err(format!("leaves has {} entries: give 1 to 12", self.leaves.len()));
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
        if self.segments > 100_000 {
            return Err(format!("segments = {}: give at most 100000", self.segments));
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
                "structural_damping_s = {}: give 0 or more",
                self.structural_damping_s
            ));
        }
        if !self.eye_offset_mm.is_finite() {
            return Err("eye_offset_mm is not a number: give one".to_owned());
        }
        Ok(())
    }
}

fn positive(key: &str, value: f64) -> Result<(), String> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(format!("{key} = {value}: give a number above 0"))
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
                    "leaf {} ends within the clamp ({} mm of {} mm): lengthen it or shorten the clamp",
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
            .map(|e| reach.iter().filter(|r| **r > e - 1e-9).count())
            .collect();
        let starts: Vec<f64> = std::iter::once(start_mm).chain(ends.iter().copied()).collect();
        let lengths: Vec<f64> = starts.windows(2).map(|w| w[1] - w[0]).collect();
        let counts = share_out(&lengths, &leaves, segments / 2);
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

/// Segments of each stretch between leaf ends, `budget` in all (a stretch costs its number of leaves).
fn share_out(lengths: &[f64], leaves: &[usize], budget: usize) -> Vec<usize> {
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
    fn the_papers_resolution_comes_out() {
        let mesh = Mesh::new(&HALVES, 50.0, 84).expect("valid");
        assert_eq!(mesh.leaves_at.iter().sum::<usize>(), 42);
        assert_eq!(mesh.leaves_at.iter().map(|n| n - 1).sum::<usize>(), 28);
        let count = |n: usize| mesh.leaves_at.iter().filter(|x| **x == n).count();
        assert_eq!([count(4), count(3), count(2)], [5, 4, 5]);
        assert_eq!(mesh.station_mm.last().copied(), Some(440.0));
    }

    #[test]
    fn any_number_of_segments_is_met_or_undercut_by_less_than_a_column() {
        for segments in [0, 22, 44, 84, 172, 344, 688] {
            let mesh = Mesh::new(&HALVES, 50.0, segments).expect("valid");
            let got = 2 * mesh.leaves_at.iter().sum::<usize>();
            assert!(
                got == segments || (got > segments && segments < 18) || segments - got < 4,
                "{got} of {segments}"
            );
        }
    }

    #[test]
    fn wrong_structures_are_refused_with_advice() {
        assert!(Mesh::new(&HALVES, 220.0, 84).is_err());
        let table: toml::Table = "segmnts = 3".parse().expect("toml");
        assert!(
            PackStructure::from_table(&table)
                .expect_err("unknown key")
                .contains("segmnts")
        );
        let table: toml::Table = "leaves = []".parse().expect("toml");
        assert!(PackStructure::from_table(&table).is_err());
    }
}
