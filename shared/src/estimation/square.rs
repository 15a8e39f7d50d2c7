//! Square matrices of a size that is known at run time, so that one copy of the machine code serves all sizes.

use nalgebra::{DMatrixViewMut, Dyn, SMatrix, U1};

/// The upper left part of a matrix.
pub(super) type Leading<'a> = DMatrixViewMut<'a, f64, U1, Dyn>;

/// The upper left `size` rows and columns.
pub(super) fn leading<const N: usize>(matrix: &mut SMatrix<f64, N, N>, size: usize) -> Leading<'_> {
    DMatrixViewMut::from_slice_with_strides_generic(matrix.as_mut_slice(), Dyn(size), Dyn(size), U1, Dyn(N))
}

/// A symmetric matrix was not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotPositiveDefinite;

/// Replaces a symmetric matrix by its inverse. What it holds where there is none means nothing.
///
/// # Errors
///
/// [`NotPositiveDefinite`], as Cholesky's decomposition would find; so is what is not finite.
pub(super) fn invert<const N: usize>(matrix: &mut SMatrix<f64, N, N>) -> Result<(), NotPositiveDefinite> {
    invert_leading(leading(matrix, N))
}

/// By Gauss and Jordan, without pivoting: the pivots are those of Cholesky's decomposition, squared, and positive definite
/// matrices need no other order (Higham, *Accuracy and Stability of Numerical Algorithms*, § 14.4).
#[inline(never)]
fn invert_leading(mut matrix: Leading<'_>) -> Result<(), NotPositiveDefinite> {
    let size = matrix.nrows();
    for k in 0..size {
        let pivot = matrix[(k, k)];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(NotPositiveDefinite);
        }
        let reciprocal = 1.0 / pivot;
        matrix[(k, k)] = 1.0;
        for column in 0..size {
            matrix[(k, column)] *= reciprocal;
        }
        for row in (0..size).filter(|row| *row != k) {
            let factor = matrix[(row, k)];
            matrix[(row, k)] = 0.0;
            for column in 0..size {
                matrix[(row, column)] -= factor * matrix[(k, column)];
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;
    use proptest::prelude::{ProptestConfig, prop_assert, proptest};

    use super::{NotPositiveDefinite, invert};

    const N: usize = 9;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

        /// Both methods are off by a few roundings times the condition of the matrix.
        #[test]
        fn the_inverse_is_that_of_another_method(
            elements in proptest::collection::vec(-1.0..1.0, N * N),
            exponent in -6.0..0.0,
        ) {
            let factor = SMatrix::<f64, N, N>::from_column_slice(&elements);
            let matrix = factor * factor.transpose() + SMatrix::identity() * libm::pow(10.0, exponent);
            let other = matrix.cholesky().expect("positive definite").inverse();
            let mut inverse = matrix;
            prop_assert!(invert(&mut inverse).is_ok());
            let allowed = 1e-14 * matrix.norm() * other.norm();
            prop_assert!((inverse - other).norm() <= allowed * other.norm(), "{}", (inverse - other).norm());
            prop_assert!((inverse - inverse.transpose()).norm() <= allowed * other.norm());
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_none() {
        let indefinite = SMatrix::<f64, 2, 2>::new(1.0, 2.0, 2.0, 1.0);
        let semidefinite = SMatrix::<f64, 2, 2>::new(1.0, 1.0, 1.0, 1.0);
        let undefined = SMatrix::<f64, 2, 2>::new(1.0, f64::NAN, f64::NAN, 1.0);
        for mut matrix in [indefinite, semidefinite, undefined, -indefinite, undefined * f64::INFINITY] {
            assert_eq!(invert(&mut matrix), Err(NotPositiveDefinite));
        }
    }
}
