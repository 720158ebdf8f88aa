//! A leaf pack: leaves as cantilevers whose tips touch the leaf above, with friction from the force of each contact.
//!
//! ```text
//! w_i(a) = sum_b P_b a^2 (3 b - a) / (6 EI_i), a <= b          gap_i = g_i + w_i(l_i) - w_(i-1)(l_i) >= 0,  N_i >= 0
//! F = E (1 + s (x / l_0)^2) + sum_i mu N_i r_i du_i/dx         u_i = h / 2 (w'_(i-1)(l_i) + w'_i(l_i))
//! ```
//! w_i: deflection of leaf i in mm under the forces P_b at the distances b from the clamp, mm. l_i: half length of leaf i, mm.
//! N_i: force between leaf i - 1 and the tip of leaf i, N; either it or the gap is zero. E: force at the eye, N. r_i: drag of the
//! contact, -1 to 1, from the slip u_i in mm. h: thickness, mm. s: stiffening of large deflections.
//! For each set of closed contacts the forces are linear in x, so all sets are solved once.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::truth::{TruthSpecimen, between};

/// Largest number of contacts between leaves.
const CONTACTS: usize = 4;
/// Number of patches of a contact that stick over different slips.
const PATCHES: usize = 6;
/// Half length of the main leaf, mm.
const LENGTH_MM: f64 = 550.0;
/// Thickness of a leaf, mm.
const THICKNESS_MM: f64 = 7.0;
/// Stiffening of large deflections.
const STIFFENING: f64 = 0.6;

/// Constant and slope over the displacement.
type Affine = [f64; 2];

/// Forces and slips of one set of closed contacts, as lines over the displacement of the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ContactSet {
    eye: Affine,
    /// Force of a closed contact, or gap of an open one.
    state: [Affine; CONTACTS],
    closed: [bool; CONTACTS],
    slip: [Affine; CONTACTS],
}

/// The leaves of one specimen.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LeafStack {
    /// Half lengths in mm and bending stiffnesses of the leaves, without scale.
    leaves: Vec<[f64; 2]>,
    /// Gaps at the tips in mm, negative for leaves that press on each other when free.
    gaps_mm: Vec<f64>,
    sets: Vec<ContactSet>,
    /// Force in N for a force without scale.
    scale: f64,
    /// Displacement in mm of the eye at the zero of the recordings.
    start_mm: f64,
    /// Friction coefficient of the contacts.
    friction: f64,
    /// Slip in mm over which each patch reverses.
    patches_mm: [[f64; PATCHES]; CONTACTS],
}

fn at(line: Affine, x: f64) -> f64 {
    line[0] + line[1] * x
}

/// Deflection at `a` of a cantilever under a unit force at `b`.
fn deflection(a: f64, b: f64) -> f64 {
    let (near, far) = (a.min(b), a.max(b));
    near * near * (3.0 * far - near) / 6.0
}

/// Slope at `a` of a cantilever under a unit force at `b`.
fn slope(a: f64, b: f64) -> f64 {
    if a < b {
        a * (2.0 * b - a) / 2.0
    } else {
        b * b / 2.0
    }
}

impl LeafStack {
    /// The leaves of a specimen. Their rate, preload, friction and travel are those of the specimen.
    pub(super) fn of(specimen: &TruthSpecimen) -> LeafStack {
        let mut random = ChaCha8Rng::seed_from_u64((specimen.build * 2f64.powi(50)) as u64);
        let count = 3 + (between(&mut random, 0.0, 2.999) as usize);
        let top_mm = specimen.top_mm();
        let mut length = LENGTH_MM;
        let mut leaves = Vec::new();
        let mut gaps_mm = Vec::new();
        for leaf in 0..count {
            leaves.push([length, between(&mut random, 0.8, 1.3) * 1e6]);
            if leaf > 0 {
                let share = between(&mut random, -0.08, 0.2);
                gaps_mm.push(share * top_mm * (length / LENGTH_MM).powi(2));
            }
            length *= between(&mut random, 0.75, 0.9);
        }
        let mut stack = LeafStack {
            leaves,
            gaps_mm,
            sets: Vec::new(),
            scale: 1.0,
            start_mm: 0.0,
            friction: 1.0,
            patches_mm: [[1.0; PATCHES]; CONTACTS],
        };
        let contacts = stack.gaps_mm.len();
        stack.sets = (0..1usize << contacts).map(|set| stack.solved(set)).collect();
        stack.fit_to(specimen);
        stack
    }

    /// Sets scale, start, friction and patches.
    fn fit_to(&mut self, specimen: &TruthSpecimen) {
        let top_mm = specimen.top_mm();
        let bare = |stack: &LeafStack, x: f64| stack.eye(x) * (1.0 + STIFFENING * (x / LENGTH_MM).powi(2));
        let wanted = specimen.preload_n / specimen.range_n;
        let (mut low, mut high) = (-top_mm, 4.0 * top_mm);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            // A negative force at the top counts as too low as well.
            let end = bare(self, middle + top_mm).max(1e-9);
            if bare(self, middle) / end < wanted {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.start_mm = low;
        self.scale = specimen.range_n / bare(self, low + top_mm);
        let top = self.contacts_at(top_mm);
        let sliding: f64 = top.iter().map(|c| c[0] * c[2].abs()).sum();
        self.friction = specimen.range_n / sliding.max(1e-9);
        for (patches, contact) in self.patches_mm.iter_mut().zip(top) {
            for (k, patch) in patches.iter_mut().enumerate() {
                let share = 2.0 * (k as f64 + 0.5) / PATCHES as f64 - 1.0;
                let travel_mm = specimen.presliding_mm * specimen.power.powf(share);
                *patch = (contact[2].abs() * travel_mm).max(1e-6);
            }
        }
    }

    /// Solves one set of closed contacts; its bits are the contacts.
    fn solved(&self, set: usize) -> ContactSet {
        let m = self.gaps_mm.len();
        let leaf = |i: usize| self.leaves[i];
        let [l0, stiff0] = leaf(0);
        // Deflection of leaf i at a under a unit force at b; that of the main leaf with its eye held.
        let flex = |i: usize, a: f64, b: f64| {
            let free = deflection(a, b) / leaf(i)[1];
            let eye = if i == 0 {
                deflection(a, l0) * deflection(b, l0) / deflection(l0, l0) / stiff0
            } else {
                0.0
            };
            free - eye
        };
        // Penetration of contact i: w_(i-1) - w_i - g, as a function of x and of the contact forces.
        let mut matrix = vec![vec![0.0; m]; m];
        let mut given = vec![[0.0; 2]; m];
        for i in 0..m {
            let own = leaf(i + 1)[0];
            matrix[i][i] = flex(i, own, own) + flex(i + 1, own, own);
            if i + 1 < m {
                matrix[i][i + 1] = -flex(i + 1, own, leaf(i + 2)[0]);
                matrix[i + 1][i] = matrix[i][i + 1];
            }
            let carried = if i == 0 {
                deflection(own, l0) / deflection(l0, l0)
            } else {
                0.0
            };
            given[i] = [-self.gaps_mm[i], carried];
        }
        let closed: [bool; CONTACTS] = std::array::from_fn(|i| i < m && (set >> i) & 1 == 1);
        let forces = solve(&matrix, &given, &closed);
        let mut state = [[0.0; 2]; CONTACTS];
        for i in 0..m {
            state[i] = if closed[i] {
                forces[i]
            } else {
                let pressed = |part: usize| {
                    let pushed: f64 = (0..m).map(|j| matrix[i][j] * forces[j][part]).sum();
                    pushed - given[i][part]
                };
                [pressed(0), pressed(1)]
            };
        }
        let (eye, slip) = self.eye_and_slip(&forces);
        ContactSet {
            eye,
            state,
            closed,
            slip,
        }
    }

    /// Force at the eye, and slip of each contact, from the forces of the contacts.
    fn eye_and_slip(&self, forces: &[Affine; CONTACTS]) -> (Affine, [Affine; CONTACTS]) {
        let m = self.gaps_mm.len();
        let [l0, stiff0] = self.leaves[0];
        let mut eye = [0.0, stiff0 / deflection(l0, l0)];
        for part in 0..2 {
            eye[part] += forces[0][part] * deflection(self.leaves[1][0], l0) / deflection(l0, l0);
        }
        let mut slip = [[0.0; 2]; CONTACTS];
        for (i, line) in slip.iter_mut().enumerate().take(m) {
            let place = self.leaves[i + 1][0];
            for part in 0..2 {
                let mut turned = 0.0;
                // The leaf above, loaded at its end and unloaded at the contact; the leaf below, loaded at its tip.
                for leaf in [i, i + 1] {
                    let [length, stiff] = self.leaves[leaf];
                    let loaded = if leaf == 0 {
                        eye[part]
                    } else {
                        forces[leaf - 1][part]
                    };
                    turned += loaded * slope(place, length) / stiff;
                    if leaf < m {
                        turned -= forces[leaf][part] * slope(place, self.leaves[leaf + 1][0]) / stiff;
                    }
                }
                line[part] = 0.5 * THICKNESS_MM * turned;
            }
        }
        (eye, slip)
    }

    /// The set whose contacts neither pull nor penetrate at a displacement of the eye in mm.
    fn set_at(&self, eye_mm: f64) -> &ContactSet {
        let worst = |set: &ContactSet| {
            let states = set.state.iter().zip(set.closed).take(self.gaps_mm.len());
            // Gaps in mm and forces without scale are of a similar size.
            states.map(|(s, _)| at(*s, eye_mm)).fold(f64::INFINITY, f64::min)
        };
        let better = |a: &&ContactSet, b: &&ContactSet| worst(a).total_cmp(&worst(b));
        self.sets.iter().max_by(better).unwrap_or(&self.sets[0])
    }

    fn eye(&self, eye_mm: f64) -> f64 {
        at(self.set_at(eye_mm).eye, eye_mm)
    }

    /// Elastic force in N at a displacement.
    pub(super) fn load_n(&self, x_mm: f64) -> f64 {
        let eye_mm = self.start_mm + x_mm;
        self.scale * self.eye(eye_mm) * (1.0 + STIFFENING * (eye_mm / LENGTH_MM).powi(2))
    }

    /// Force in N, slip in mm, and slip per displacement, of each contact.
    fn contacts_at(&self, x_mm: f64) -> [[f64; 3]; CONTACTS] {
        let eye_mm = self.start_mm + x_mm;
        let set = self.set_at(eye_mm);
        std::array::from_fn(|i| {
            let force = if set.closed[i] {
                at(set.state[i], eye_mm).max(0.0)
            } else {
                0.0
            };
            [self.scale * force, at(set.slip[i], eye_mm), set.slip[i][1]]
        })
    }
}

/// Solves the rows and columns of the closed contacts by elimination; the forces of the open ones are zero.
fn solve(matrix: &[Vec<f64>], given: &[Affine], closed: &[bool; CONTACTS]) -> [Affine; CONTACTS] {
    let rows: Vec<usize> = (0..given.len()).filter(|&i| closed[i]).collect();
    let mut a: Vec<Vec<f64>> = rows
        .iter()
        .map(|&i| {
            let row = rows.iter().map(|&j| matrix[i][j]);
            row.chain(given[i]).collect()
        })
        .collect();
    let n = rows.len();
    // The matrix is symmetric and positive, so no pivots are needed.
    for k in 0..n {
        let pivot = a[k].clone();
        for (i, row) in a.iter_mut().enumerate() {
            if i != k {
                let factor = row[k] / pivot[k];
                row.iter_mut().zip(&pivot).for_each(|(v, p)| *v -= factor * p);
            }
        }
    }
    let mut forces = [[0.0; 2]; CONTACTS];
    for (k, &i) in rows.iter().enumerate() {
        forces[i] = [a[k][n] / a[k][k], a[k][n + 1] / a[k][k]];
    }
    forces
}

/// Friction of all contacts between the leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Interfaces {
    slip_mm: [f64; CONTACTS],
    /// Drag of each patch, -1 to 1.
    drags: [[f64; PATCHES]; CONTACTS],
    /// Friction at the eye for a friction ratio of 1, N.
    friction_n: f64,
}

impl Interfaces {
    /// Contacts at rest at the zero of the recordings.
    pub(super) fn at_rest(stack: &LeafStack) -> Interfaces {
        Interfaces {
            slip_mm: stack.contacts_at(0.0).map(|c| c[1]),
            drags: [[0.0; PATCHES]; CONTACTS],
            friction_n: 0.0,
        }
    }

    /// The contacts at another displacement in mm.
    pub(super) fn moved(mut self, stack: &LeafStack, x_mm: f64) -> Interfaces {
        self.friction_n = 0.0;
        for (i, [force_n, slip_mm, lever]) in stack.contacts_at(x_mm).into_iter().enumerate() {
            let slid = slip_mm - self.slip_mm[i];
            self.slip_mm[i] = slip_mm;
            for (drag, length_mm) in self.drags[i].iter_mut().zip(stack.patches_mm[i]) {
                *drag = (*drag + 2.0 * slid / length_mm).clamp(-1.0, 1.0);
                if force_n <= 0.0 {
                    *drag = 0.0;
                }
            }
            let mean = self.drags[i].iter().sum::<f64>() / PATCHES as f64;
            self.friction_n += stack.friction * force_n * lever * mean;
        }
        self
    }

    /// Friction force in N at the eye, for a friction ratio at the largest load.
    pub(super) fn force_n(&self, ratio: f64) -> f64 {
        ratio * self.friction_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::World;
    use crate::truth::specimen::tests::plain;

    fn pack(build: f64) -> (TruthSpecimen, LeafStack) {
        let specimen = TruthSpecimen {
            world: World::Pack,
            power: 3.0,
            build,
            ..plain()
        };
        let stack = LeafStack::of(&specimen);
        (specimen, stack)
    }

    #[test]
    fn one_leaf_is_the_cantilever_of_the_textbook() {
        // 3 EI / l^3 at the tip, l^2 / (2 EI) for the slope.
        assert_eq!(deflection(2.0, 2.0), 8.0 / 3.0);
        assert_eq!(slope(2.0, 2.0), 2.0);
        assert_eq!(deflection(1.0, 2.0), deflection(2.0, 1.0));
    }

    #[test]
    fn a_pack_has_the_preload_and_the_range_of_its_specimen_and_rises() {
        for k in 0..20 {
            let (specimen, stack) = pack(0.013 + 0.049 * f64::from(k));
            let top = specimen.top_mm();
            assert!((stack.load_n(0.0) - specimen.preload_n).abs() < 1e-3, "{k}");
            assert!((stack.load_n(top) - specimen.range_n).abs() < 1e-6, "{k}");
            let loads: Vec<f64> = (0..=200)
                .map(|i| stack.load_n(top * f64::from(i) / 200.0))
                .collect();
            assert!(loads.windows(2).all(|w| w[1] > w[0]), "{k}");
        }
    }

    #[test]
    fn no_contact_pulls_and_none_penetrates() {
        for k in 0..20 {
            let (specimen, stack) = pack(0.013 + 0.049 * f64::from(k));
            for i in 0..=50 {
                let eye_mm = stack.start_mm + specimen.top_mm() * f64::from(i) / 50.0;
                let set = stack.set_at(eye_mm);
                let states = set.state.iter().take(stack.gaps_mm.len());
                // At a contact that just closes both are zero.
                assert!(states.clone().all(|s| at(*s, eye_mm) > -1e-6), "{k} {i}: {set:?}");
            }
        }
    }

    #[test]
    fn the_friction_far_along_a_branch_is_the_ratio_at_the_top() {
        let (specimen, stack) = pack(0.3);
        let top = specimen.top_mm();
        let up = (1..=2000).fold(Interfaces::at_rest(&stack), |i, k| {
            i.moved(&stack, top * f64::from(k) / 2000.0)
        });
        let ratio = up.force_n(0.1) / specimen.range_n;
        assert!((ratio - 0.1).abs() < 1e-6, "{ratio}");
        let down = up.moved(&stack, 0.6 * top);
        assert!(down.force_n(0.1) < -0.02 * specimen.range_n);
    }
}
