//! Sums over the rows of a specimen that the restricted likelihood and its derivatives need.
//!
//! With W = V^-1 every product X'W...WX of a specimen follows from weighted sums of its rows, because V is a diagonal plus a constant.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use super::MixedData;

/// The rows of a specimen without the columns that are 0 in all of them.
pub(super) struct DenseBlock {
    /// Numbers of the columns; the last one is y.
    pub columns: Vec<usize>,
    /// Values in these columns, row after row.
    values: Vec<f64>,
    pub known_variance: Vec<f64>,
}

impl DenseBlock {
    pub(super) fn of(data: &MixedData, block: &Range<usize>) -> DenseBlock {
        let rows = &data.rows[block.clone()];
        let used = rows.iter().flatten().map(|(c, _)| *c);
        let mut columns: Vec<usize> = used.chain([data.width]).collect();
        columns.sort_unstable();
        columns.dedup();
        let mut values = vec![0.0; columns.len() * rows.len()];
        let dense = values.chunks_exact_mut(columns.len());
        for ((dense, row), y) in dense.zip(rows).zip(&data.y[block.clone()]) {
            for &(column, value) in row {
                dense[columns.partition_point(|c| *c < column)] += value;
            }
            dense[columns.len() - 1] = *y;
        }
        DenseBlock {
            columns,
            values,
            known_variance: data.known_variance[block.clone()].to_vec(),
        }
    }
}

/// Weighted sums over blocks. `V0` is dV/dtau^2 and `V1` is dV/dsigma^2.
pub(super) struct Sums {
    /// Over X'WX with W = V^-1, V^-1 V0 V^-1, V^-1 V1 V^-1, and V^-1 Vi V^-1 Vj V^-1 for ij = 00, 01, 11.
    pub products: [DMatrix<f64>; 6],
    pub log_determinant: f64,
    /// Traces of V^-1 Vi.
    pub first: Vector2<f64>,
    /// Traces of V^-1 Vi V^-1 Vj.
    pub second: Matrix2<f64>,
}

impl Sums {
    pub(super) fn zeros(size: usize) -> Sums {
        Sums {
            products: std::array::from_fn(|_| DMatrix::zeros(size, size)),
            log_determinant: 0.0,
            first: Vector2::zeros(),
            second: Matrix2::zeros(),
        }
    }

    /// Adds a specimen with weights d = 1 / (sigma^2 + s^2) of its rows.
    pub(super) fn add(&mut self, tau2: f64, d: &[f64], block: &DenseBlock) {
        let power = |n: i32| d.iter().map(|d| d.powi(n)).sum::<f64>();
        let (w, w2, w3) = (power(1), power(2), power(3));
        let g = 1.0 / (1.0 + tau2 * w);
        let k = tau2 * g;
        self.log_determinant -= d.iter().map(|d| d.ln()).sum::<f64>() + g.ln();
        self.first += Vector2::new(w * g, w - k * w2);
        let mixed = g * g * w2;
        self.second += Matrix2::new(
            (w * g).powi(2),
            mixed,
            mixed,
            w2 - 2.0 * k * w3 + (k * w2).powi(2),
        );
        // V^-1 = D - k d d' and V^-1 1 = g d, so each product is a sum over rows and products of m = X'D1, q = X'D^2 1, r = X'D^3 1.
        let terms = [
            BlockTerms {
                row: 1,
                mm: -k,
                ..BlockTerms::NONE
            },
            BlockTerms {
                mm: g * g,
                ..BlockTerms::NONE
            },
            BlockTerms {
                row: 2,
                mm: k * k * w2,
                mq: -k,
                ..BlockTerms::NONE
            },
            BlockTerms {
                mm: g.powi(3) * w,
                ..BlockTerms::NONE
            },
            BlockTerms {
                mm: -g * g * k * w2,
                mq: 0.5 * g * g,
                ..BlockTerms::NONE
            },
            BlockTerms {
                row: 3,
                mm: k * k * w3 - k.powi(3) * w2 * w2,
                mq: k * k * w2,
                mr: -k,
            },
        ];
        BlockSums::of(d, block).add_to(&mut self.products, &terms, &block.columns);
    }
}

/// Weights of the terms of one product of a block.
#[derive(Clone, Copy)]
struct BlockTerms {
    /// Power of d in the sum over rows; 0 for no such sum.
    row: usize,
    /// Of m m'.
    mm: f64,
    /// Of m q' + q m'.
    mq: f64,
    /// Of m r' + r m' + q q'.
    mr: f64,
}

impl BlockTerms {
    const NONE: BlockTerms = BlockTerms {
        row: 0,
        mm: 0.0,
        mq: 0.0,
        mr: 0.0,
    };
}

/// Weighted sums over the rows of a block.
struct BlockSums {
    /// X' D^n X for n = 1, 2, 3, of which the lower triangle is filled in.
    squares: [DMatrix<f64>; 3],
    /// X' D^n 1 for n = 1, 2, 3: m, q and r.
    sums: [DVector<f64>; 3],
}

impl BlockSums {
    fn of(d: &[f64], block: &DenseBlock) -> BlockSums {
        let size = block.columns.len();
        let mut squares: [DMatrix<f64>; 3] = std::array::from_fn(|_| DMatrix::zeros(size, size));
        let mut sums: [DVector<f64>; 3] = std::array::from_fn(|_| DVector::zeros(size));
        for (row, &d) in block.values.chunks_exact(size).zip(d) {
            let mut weight = 1.0;
            for (square, sum) in squares.iter_mut().zip(&mut sums) {
                weight *= d;
                for (j, (square, &x)) in square.as_mut_slice().chunks_exact_mut(size).zip(row).enumerate() {
                    let weighted = weight * x;
                    sum[j] += weighted;
                    for (square, z) in square[j..].iter_mut().zip(&row[j..]) {
                        *square += weighted * z;
                    }
                }
            }
        }
        BlockSums { squares, sums }
    }

    /// Adds the terms of each product to its lower triangle.
    fn add_to(&self, products: &mut [DMatrix<f64>; 6], terms: &[BlockTerms; 6], columns: &[usize]) {
        let [m, q, r] = &self.sums;
        for (j, &column) in columns.iter().enumerate() {
            for (i, &row) in columns.iter().enumerate().skip(j) {
                let [d1, d2, d3] = self.squares.each_ref().map(|square| square[(i, j)]);
                let over_rows = [0.0, d1, d2, d3];
                let mm = m[i] * m[j];
                let mq = m[i] * q[j] + q[i] * m[j];
                let mr = m[i] * r[j] + r[i] * m[j] + q[i] * q[j];
                for (product, terms) in products.iter_mut().zip(terms) {
                    product[(row, column)] +=
                        over_rows[terms.row] + terms.mm * mm + terms.mq * mq + terms.mr * mr;
                }
            }
        }
    }
}
