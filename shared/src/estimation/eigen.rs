//! Symmetric eigenproblems of every size that occurs here (p × p and r × r), by Jacobi's cyclic method (Golub & Van Loan,
//! *Matrix Computations*, § 8.5).
//!
//! Each rotation makes one element off the diagonal zero, and a sweep goes through all of them. Why this and not the faster
//! QR iteration on a tridiagonal matrix:
//!
//! * **Size.** It is a page of machine code, and one copy of it serves all sizes.
//! * **Small eigenvalues.** The noise stands 10⁻⁶ … 10⁻⁸ below the signal. Where a positive definite matrix is a well-conditioned one
//!   whose rows and columns are scaled, however unequally, Jacobi's method finds even the least eigenvalue to a few roundings
//!   *of itself*; anything that makes the matrix tridiagonal first, to a rounding of the largest (Demmel & Veselić 1992).
//! * **No failure.** Every rotation takes the square of an element off the diagonal away from the sum of all those squares, so
//!   that nothing can go wrong but that it takes longer. In the end, convergence is quadratic: matrices of size 12 take about six
//!   sweeps, graded ones up to eleven.

use nalgebra::{SMatrix, SVector};

use super::square::{Leading, leading};
use crate::refusal::Refusal;

/// Twice as many sweeps as any matrix was seen to take; what is left then is rounding.
const MOST_SWEEPS: usize = 24;

/// Eigenvalues in descending order, and the matching unit eigenvectors as columns.
#[derive(Clone, Debug)]
pub(crate) struct Eigen<const N: usize> {
    pub(crate) values: SVector<f64, N>,
    pub(crate) vectors: SMatrix<f64, N, N>,
}

/// Decomposes the upper left `size` rows and columns of a symmetric matrix, of which the lower triangle is read; eigenvalues and
/// elements of eigenvectors beyond are zero. Each eigenvector's largest element is positive, so that the answer is the same from
/// one platform to the next.
///
/// # Errors
///
/// [`Refusal::NonFinite`] where an element is not finite, or so large that a sum of two is not.
pub(crate) fn symmetric_eigen<const N: usize>(
    matrix: &SMatrix<f64, N, N>,
    size: usize,
) -> Result<Eigen<N>, Refusal> {
    let size = size.min(N);
    let (mut diagonal, mut vectors) = (*matrix, SMatrix::zeros());
    decompose(leading(&mut diagonal, size), leading(&mut vectors, size))?;
    let values = SVector::from_fn(|k, _| if k < size { diagonal[(k, k)] } else { 0.0 });
    Ok(Eigen { values, vectors })
}

/// Brings the eigenvalues onto the matrix's diagonal and the eigenvectors into the columns of `vectors`, in descending order.
#[inline(never)]
fn decompose(mut matrix: Leading<'_>, mut vectors: Leading<'_>) -> Result<(), Refusal> {
    let size = matrix.nrows();
    for row in 0..size {
        for column in 0..row {
            matrix[(column, row)] = matrix[(row, column)];
        }
        vectors[(row, row)] = 1.0;
    }
    if matrix.iter().any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    for _ in 0..MOST_SWEEPS {
        if !sweep(&mut matrix, &mut vectors) {
            break;
        }
    }
    if matrix.iter().any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    for place in 0..size {
        let larger = |best, other| if matrix[(other, other)] > matrix[(best, best)] { other } else { best };
        let next = (place + 1..size).fold(place, larger);
        matrix.swap((place, place), (next, next));
        vectors.swap_columns(place, next);
        let mut vector = vectors.column_mut(place);
        if vector[vector.iamax()] < 0.0 {
            vector.neg_mut();
        }
    }
    Ok(())
}

/// One rotation for each element off the diagonal that is more than rounding; whether there was any.
fn sweep(matrix: &mut Leading<'_>, vectors: &mut Leading<'_>) -> bool {
    let mut rotated = false;
    for q in 1..matrix.nrows() {
        for p in 0..q {
            let (element, of_p, of_q) = (matrix[(q, p)], matrix[(p, p)], matrix[(q, q)]);
            // Relative to both diagonal elements, and not to the largest of all: small eigenvalues live by it.
            if element.abs() <= f64::EPSILON * libm::sqrt(of_p.abs()) * libm::sqrt(of_q.abs()) {
                continue;
            }
            rotated = true;
            // The smaller of the two angles that make the element zero has the tangent t, t² + 2θt = 1.
            let theta = (of_q - of_p) / (2.0 * element);
            let tangent = theta.signum() / (theta.abs() + libm::sqrt(theta * theta + 1.0));
            let cosine = 1.0 / libm::sqrt(tangent * tangent + 1.0);
            let sine = tangent * cosine;
            for k in 0..matrix.nrows() {
                if k != p && k != q {
                    rotate(matrix, k, (p, q), (cosine, sine));
                    matrix[(p, k)] = matrix[(k, p)];
                    matrix[(q, k)] = matrix[(k, q)];
                }
                rotate(vectors, k, (p, q), (cosine, sine));
            }
            matrix[(p, p)] = of_p - tangent * element;
            matrix[(q, q)] = of_q + tangent * element;
            matrix[(p, q)] = 0.0;
            matrix[(q, p)] = 0.0;
        }
    }
    rotated
}

/// Rotates two elements of a row.
fn rotate(matrix: &mut Leading<'_>, row: usize, (p, q): (usize, usize), (cosine, sine): (f64, f64)) {
    let (left, right) = (matrix[(row, p)], matrix[(row, q)]);
    matrix[(row, p)] = cosine * left - sine * right;
    matrix[(row, q)] = sine * left + cosine * right;
}

#[cfg(test)]
mod tests;
