//! Quadratic functions on the motion, as vectors of unknowns: the products xₐx_b (a ≤ b) first, then the xₐ.
//!
//! There are six products and three linear terms. What belongs to a coordinate beyond the rank is zero, and one on the diagonal of
//! what is to be inverted.

use nalgebra::{RealField, SMatrix, SVector};

use super::coordinates::place;
use super::motion_moments::MotionMoments;
use crate::units::{MAX_RANK, Rank};

/// How many there are.
pub(super) const UNKNOWNS: usize = 9;

/// One number for each unknown.
pub(super) type Coefficients = SVector<f64, UNKNOWNS>;

/// Where xₐx_b stands.
pub(super) const fn product_position(a: usize, b: usize) -> usize {
    place(&[a, b])
}

/// Where xₐ stands.
pub(super) const fn linear_position(a: usize) -> usize {
    MAX_RANK * (MAX_RANK + 1) / 2 + a
}

/// Where the unknowns of a trial of this rank stand.
pub(super) fn positions(rank: Rank) -> impl Iterator<Item = usize> {
    let products = rank.axes().flat_map(move |a| (a..rank.count()).map(move |b| product_position(a, b)));
    products.chain(rank.axes().map(linear_position))
}

/// φ(x): every product and every linear term at one point.
pub(super) fn monomials<Number: RealField + Copy>(
    x: &SVector<Number, MAX_RANK>,
) -> SVector<Number, UNKNOWNS> {
    let mut phi = SVector::<Number, UNKNOWNS>::zeros();
    for a in 0..MAX_RANK {
        for b in a..MAX_RANK {
            phi[product_position(a, b)] = x[a] * x[b];
        }
        phi[linear_position(a)] = x[a];
    }
    phi
}

/// ⟨φφᵀ⟩ from the moments of x.
#[inline(never)]
pub(super) fn normal_matrix(moments: &MotionMoments, rank: Rank) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
    let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::identity();
    for a in rank.axes() {
        for b in a..rank.count() {
            let row = product_position(a, b);
            for c in rank.axes() {
                for d in c..rank.count() {
                    normal[(row, product_position(c, d))] = moments.fourth[[a, b, c, d]];
                }
                let column = linear_position(c);
                normal[(row, column)] = moments.third[[a, b, c]];
                normal[(column, row)] = moments.third[[a, b, c]];
            }
        }
        for b in rank.axes() {
            normal[(linear_position(a), linear_position(b))] = moments.second[(a, b)];
        }
    }
    normal
}
