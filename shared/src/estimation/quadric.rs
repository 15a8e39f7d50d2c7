//! Quadratic functions on the motion, as vectors of unknowns: the products xₐx_b (a ≤ b) first, then the xₐ.
//!
//! At rank 3 there are six products and three linear terms; at rank 2 three and two, and the rest of every system is the
//! identity, so that one size serves both.

use nalgebra::{RealField, SMatrix, SVector};

use super::motion_moments::MotionMoments;

/// Unknowns at rank 3.
pub(super) const UNKNOWNS: usize = 9;

/// One number for each unknown.
pub(super) type Coefficients = SVector<f64, UNKNOWNS>;

/// Where xₐx_b stands.
pub(super) const fn product_position<const RANK: usize>(a: usize, b: usize) -> usize {
    let (row, column) = if a <= b { (a, b) } else { (b, a) };
    row * RANK - row * (row + 1) / 2 + column
}

/// Where xₐ stands.
pub(super) const fn linear_position<const RANK: usize>(a: usize) -> usize {
    RANK * (RANK + 1) / 2 + a
}

/// φ(x): every product and every linear term at one point.
pub(super) fn monomials<Number: RealField + Copy, const RANK: usize>(
    x: &SVector<Number, RANK>,
) -> SVector<Number, UNKNOWNS> {
    let mut phi = SVector::<Number, UNKNOWNS>::zeros();
    for a in 0..RANK {
        for b in a..RANK {
            phi[product_position::<RANK>(a, b)] = x[a] * x[b];
        }
        phi[linear_position::<RANK>(a)] = x[a];
    }
    phi
}

/// ⟨φφᵀ⟩ from the moments of x.
pub(super) fn normal_matrix<const RANK: usize>(
    moments: &MotionMoments<RANK>,
) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
    let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::identity();
    for a in 0..RANK {
        for b in a..RANK {
            let row = product_position::<RANK>(a, b);
            for c in 0..RANK {
                for d in c..RANK {
                    normal[(row, product_position::<RANK>(c, d))] = moments.fourth[a][b][c][d];
                }
                let column = linear_position::<RANK>(c);
                normal[(row, column)] = moments.third[a][b][c];
                normal[(column, row)] = moments.third[a][b][c];
            }
        }
        for b in 0..RANK {
            normal[(linear_position::<RANK>(a), linear_position::<RANK>(b))] = moments.second[a][b];
        }
    }
    normal
}
