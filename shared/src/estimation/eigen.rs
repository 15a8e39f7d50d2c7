//! Symmetric eigenproblems of every size that occurs here, behind one function.
//!
//! `nalgebra` states what sizes it can decompose by bounds on its allocator, which would spread over every signature of
//! the estimator and of the firmware. They stop here: the size is a constant, so that of the match below one arm remains
//! in the machine code.

use nalgebra::allocator::Allocator;
use nalgebra::{
    DefaultAllocator, DimDiff, DimName, DimSub, OMatrix, SMatrix, SVector, SymmetricEigen, U1, U2, U3, U4,
    U5, U6, U7, U8, U9, U10, U11, U12,
};

use crate::refusal::Refusal;

/// Iterations after which the decomposition is given up; it converges within about 3 a dimension.
const MAX_ITERATIONS: usize = 500;

/// Eigenvalues in descending order, and the matching unit eigenvectors as columns.
#[derive(Clone, Debug)]
pub(crate) struct Eigen<const N: usize> {
    pub(crate) values: SVector<f64, N>,
    pub(crate) vectors: SMatrix<f64, N, N>,
}

/// Decomposes a symmetric matrix of size 2 to 12. Each eigenvector's largest element is positive, so that the answer is
/// the same from one platform to the next.
///
/// # Errors
///
/// [`Refusal::NonFinite`] where an element is not finite or the iteration does not settle;
/// [`Refusal::UnsupportedDimensions`] for another size.
pub(crate) fn symmetric_eigen<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Result<Eigen<N>, Refusal> {
    // The iteration answers NaN with NaN, so look first.
    if matrix.iter().any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    match N {
        2 => decompose::<N, U2>(matrix),
        3 => decompose::<N, U3>(matrix),
        4 => decompose::<N, U4>(matrix),
        5 => decompose::<N, U5>(matrix),
        6 => decompose::<N, U6>(matrix),
        7 => decompose::<N, U7>(matrix),
        8 => decompose::<N, U8>(matrix),
        9 => decompose::<N, U9>(matrix),
        10 => decompose::<N, U10>(matrix),
        11 => decompose::<N, U11>(matrix),
        12 => decompose::<N, U12>(matrix),
        #[expect(clippy::cast_possible_truncation, reason = "a report")]
        _ => return Err(Refusal::UnsupportedDimensions { gages: N as u8, rank: 0 }),
    }
    .map(|(values, vectors)| Eigen { values: values.into(), vectors: vectors.into() })
    .ok_or(Refusal::NonFinite)
}

/// Eigenvalues in descending order and eigenvectors, one array each; `Size` is `N`, spelled as `nalgebra` needs it.
fn decompose<const N: usize, Size>(matrix: &SMatrix<f64, N, N>) -> Option<([f64; N], [[f64; N]; N])>
where
    Size: DimName + DimSub<U1>,
    DefaultAllocator: Allocator<Size, Size> + Allocator<Size> + Allocator<DimDiff<Size, U1>>,
{
    let matrix = OMatrix::<f64, Size, Size>::from_fn(|row, column| matrix[(row, column)]);
    let eigen = SymmetricEigen::try_new(matrix, f64::EPSILON, MAX_ITERATIONS)?;
    let mut order: [usize; N] = core::array::from_fn(|position| position);
    order.sort_unstable_by(|&left, &right| eigen.eigenvalues[right].total_cmp(&eigen.eigenvalues[left]));
    let values = order.map(|k| eigen.eigenvalues[k]);
    let vectors = order.map(|k| {
        let vector = eigen.eigenvectors.column(k);
        let sign = if vector[vector.iamax()] < 0.0 { -1.0 } else { 1.0 };
        core::array::from_fn(|row| sign * vector[row])
    });
    Some((values, vectors))
}
