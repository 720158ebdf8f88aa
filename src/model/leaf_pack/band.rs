//! Block-band LU of one side of the pack: 3 x 3 blocks, no pivoting, work linear in the number of bodies.
//!
//! The bodies are numbered station by station, so a body couples to its station and to the next one only.
//! Contact stiffness and slip make the matrix unsymmetric. The beams at the clamp keep its pivots away from zero.

/// A body's (x, y, angle) triple: displacements in mm and rad, or forces in N and N mm.
pub(super) type V3 = [f64; 3];
/// A 3 x 3 block, row by row.
pub(super) type M3 = [f64; 9];

/// The matrix, and after [`BlockBand::factor`] its factors in the same place.
#[derive(Debug, Clone)]
pub(super) struct BlockBand {
    width: usize,
    /// Number of rows below (and of columns right of) each pivot that its elimination changes.
    reach: Vec<usize>,
    /// Diagonal and upper blocks: row `b` holds columns `b ..= b + width`.
    upper: Vec<M3>,
    /// Lower blocks by column: column `b` holds rows `b + 1 ..= b + width`.
    lower: Vec<M3>,
    /// Inverse of the pivots.
    pivot: Vec<M3>,
}

impl BlockBand {
    /// A zero matrix for the given reach per row, which must not shrink by more than one from row to row.
    pub(super) fn new(reach: Vec<usize>) -> Self {
        let width = reach.iter().copied().max().unwrap_or(0);
        let n = reach.len();
        Self {
            width,
            upper: vec![[0.0; 9]; n * (width + 1)],
            lower: vec![[0.0; 9]; n * width],
            pivot: vec![[0.0; 9]; n],
            reach,
        }
    }

    pub(super) fn clear(&mut self) {
        self.upper.fill([0.0; 9]);
        self.lower.fill([0.0; 9]);
    }

    /// Adds a block at (`row`, `column`), which must lie in the band.
    #[inline]
    pub(super) fn add(&mut self, row: usize, column: usize, block: &M3) {
        let target = if column >= row {
            &mut self.upper[row * (self.width + 1) + column - row]
        } else {
            &mut self.lower[column * self.width + row - column - 1]
        };
        for (t, b) in target.iter_mut().zip(block) {
            *t += b;
        }
    }

    /// Factors in place. False if a pivot vanishes.
    pub(super) fn factor(&mut self) -> bool {
        let w = self.width;
        for p in 0..self.reach.len() {
            let r = self.reach[p];
            let (head, tail) = self.upper.split_at_mut((p + 1) * (w + 1));
            let row = &head[p * (w + 1)..];
            let Some(inverse) = invert(&row[0]) else {
                return false;
            };
            self.pivot[p] = inverse;
            for i in 1..=r {
                let l = multiply(&self.lower[p * w + i - 1], &inverse);
                self.lower[p * w + i - 1] = l;
                if l == [0.0; 9] {
                    continue;
                }
                // Row p + i, columns p + 1 ..= p + r: those left of its diagonal live in `lower`.
                for (j, u) in row.iter().enumerate().take(i).skip(1) {
                    subtract_product(&mut self.lower[(p + j) * w + i - j - 1], &l, u);
                }
                let target = &mut tail[(i - 1) * (w + 1)..(i - 1) * (w + 1) + r - i + 1];
                for (t, u) in target.iter_mut().zip(&row[i..=r]) {
                    subtract_product(t, &l, u);
                }
            }
        }
        true
    }

    /// Solves in place with the factors.
    pub(super) fn solve(&self, x: &mut [V3]) {
        let w = self.width;
        for p in 0..self.reach.len() {
            let (head, tail) = x.split_at_mut(p + 1);
            let y = head[p];
            let r = self.reach[p];
            for (l, t) in self.lower[p * w..p * w + r].iter().zip(tail) {
                subtract_image(t, l, &y);
            }
        }
        self.solve_upper(x);
    }

    /// The back substitution alone, for a right-hand side that is zero except in the last body's row.
    pub(super) fn solve_upper(&self, x: &mut [V3]) {
        let w = self.width;
        for p in (0..self.reach.len()).rev() {
            let (head, tail) = x.split_at_mut(p + 1);
            let mut y = head[p];
            let row = &self.upper[p * (w + 1) + 1..p * (w + 1) + 1 + self.reach[p]];
            for (u, t) in row.iter().zip(tail.iter()) {
                subtract_image(&mut y, u, t);
            }
            head[p] = image(&self.pivot[p], &y);
        }
    }
}

#[inline]
pub(super) fn image(m: &M3, v: &V3) -> V3 {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
        m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
    ]
}

#[inline]
fn subtract_image(t: &mut V3, m: &M3, v: &V3) {
    let i = image(m, v);
    t[0] -= i[0];
    t[1] -= i[1];
    t[2] -= i[2];
}

#[inline]
fn multiply(a: &M3, b: &M3) -> M3 {
    let mut c = [0.0; 9];
    for i in 0..3 {
        for j in 0..3 {
            c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
        }
    }
    c
}

#[inline]
fn subtract_product(t: &mut M3, a: &M3, b: &M3) {
    for i in 0..3 {
        for j in 0..3 {
            t[3 * i + j] -= a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
        }
    }
}

fn invert(m: &M3) -> Option<M3> {
    let c0 = m[4] * m[8] - m[5] * m[7];
    let c1 = m[5] * m[6] - m[3] * m[8];
    let c2 = m[3] * m[7] - m[4] * m[6];
    let det = m[0] * c0 + m[1] * c1 + m[2] * c2;
    if !det.is_normal() {
        return None;
    }
    let d = 1.0 / det;
    Some([
        c0 * d,
        (m[2] * m[7] - m[1] * m[8]) * d,
        (m[1] * m[5] - m[2] * m[4]) * d,
        c1 * d,
        (m[0] * m[8] - m[2] * m[6]) * d,
        (m[2] * m[3] - m[0] * m[5]) * d,
        c2 * d,
        (m[1] * m[6] - m[0] * m[7]) * d,
        (m[0] * m[4] - m[1] * m[3]) * d,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_a_known_system() {
        let reach = vec![3, 3, 3, 2, 2, 1, 0];
        let n = reach.len();
        let mut band = BlockBand::new(reach.clone());
        let mut dense = vec![vec![0.0; 3 * n]; 3 * n];
        let mut seed = 1u64;
        let mut random = || {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for row in 0..n {
            for column in 0..n {
                let near = row.min(column);
                if row.max(column) - near > reach[near] {
                    continue;
                }
                let mut block: M3 = std::array::from_fn(|_| random());
                if row == column {
                    for d in 0..3 {
                        block[4 * d] += 8.0;
                    }
                }
                band.add(row, column, &block);
                for i in 0..3 {
                    for j in 0..3 {
                        dense[3 * row + i][3 * column + j] += block[3 * i + j];
                    }
                }
            }
        }
        let wanted: Vec<V3> = (0..n).map(|_| std::array::from_fn(|_| random())).collect();
        let flat: Vec<f64> = wanted.iter().flatten().copied().collect();
        let mut x: Vec<V3> = (0..n)
            .map(|b| std::array::from_fn(|i| dense[3 * b + i].iter().zip(&flat).map(|(a, w)| a * w).sum()))
            .collect();
        assert!(band.factor());
        band.solve(&mut x);
        for (a, b) in x.iter().flatten().zip(&flat) {
            // Well conditioned by its dominant diagonal: some rounding errors per operation.
            assert!((a - b).abs() < 1e-13, "{a} against {b}");
        }
    }

    #[test]
    fn a_singular_matrix_is_refused() {
        assert!(!BlockBand::new(vec![0]).factor());
    }
}
