use nalgebra::{SMatrix, SVector, SymmetricEigen};
use proptest::prelude::{ProptestConfig, Strategy, prop_assert, prop_assert_eq, proptest};

use super::{Eigen, symmetric_eigen};
use crate::refusal::Refusal;

/// The largest size that occurs.
const N: usize = 12;

type Matrix = SMatrix<f64, N, N>;

/// Rounding, of a sum of twelve products and as many rotations of each element a sweep.
const ROUNDING: f64 = 1e-13;

/// A symmetric matrix with elements between −1 and 1.
fn symmetric() -> impl Strategy<Value = Matrix> {
    proptest::collection::vec(-1.0..1.0, N * N).prop_map(|elements| {
        let matrix = Matrix::from_column_slice(&elements);
        (matrix + matrix.transpose()) / 2.0
    })
}

/// Scales from 10⁻⁹ to 1, in any order.
fn scales() -> impl Strategy<Value = SVector<f64, N>> {
    proptest::collection::vec(-9.0..0.0, N)
        .prop_map(|exponents| SVector::from_fn(|k, _| libm::pow(10.0, exponents[k])))
}

fn spectral(matrix: &Matrix) -> Eigen<N> {
    symmetric_eigen(matrix, N).expect("all elements are finite")
}

/// The largest element of VᵀV − I.
fn distance_from_orthogonal(vectors: &Matrix) -> f64 {
    (vectors.transpose() * vectors - Matrix::identity()).amax()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn values_and_vectors_make_up_the_matrix(matrix in symmetric()) {
        let Eigen { values, vectors } = spectral(&matrix);
        let composed = vectors * Matrix::from_diagonal(&values) * vectors.transpose();
        prop_assert!((composed - matrix).amax() < ROUNDING);
        prop_assert!(distance_from_orthogonal(&vectors) < ROUNDING);
        prop_assert!(values.as_slice().is_sorted_by(|left, right| left >= right));
        for vector in vectors.column_iter() {
            prop_assert!(vector[vector.iamax()] > 0.0);
        }
    }

    /// By Weyl's inequality, eigenvalues are off by no more than the matrix is.
    #[test]
    fn the_values_are_those_of_another_method(matrix in symmetric()) {
        let mut others = SymmetricEigen::new(matrix).eigenvalues;
        others.as_mut_slice().sort_by(|left, right| right.total_cmp(left));
        prop_assert!((spectral(&matrix).values - others).amax() < ROUNDING);
    }

    /// DBD, with D diagonal and graded and B well-conditioned: the trace of the inverse is all but the inverse of the least eigenvalue
    /// where D falls fast, and the product is the determinant. Both are known to a rounding of themselves.
    #[test]
    fn small_values_are_as_exact_as_large_ones(matrix in symmetric(), scales in scales()) {
        let even = Matrix::identity() + matrix / (2.0 * N as f64);
        let scaling = Matrix::from_diagonal(&scales);
        let Eigen { values, vectors } = spectral(&(scaling * even * scaling));
        prop_assert!(distance_from_orthogonal(&vectors) < ROUNDING);

        let inverse = even.try_inverse().expect("diagonally dominant");
        let trace: f64 = (0..N).map(|k| inverse[(k, k)] / (scales[k] * scales[k])).sum();
        let found: f64 = values.iter().map(|value| 1.0 / value).sum();
        prop_assert!((found / trace - 1.0).abs() < ROUNDING, "{found} {trace}");

        let determinant = scales.iter().fold(even.determinant(), |product, scale| product * scale * scale);
        prop_assert!((values.product() / determinant - 1.0).abs() < ROUNDING);
    }

    /// The eigenvectors of what has nothing in common belong to one of its parts each.
    #[test]
    fn what_lies_beyond_the_size_is_not_read(matrix in symmetric(), size in 1..=N) {
        let mut cut = matrix;
        let mut disturbed = matrix;
        for row in 0..N {
            for column in 0..N {
                if row >= size || column >= size {
                    cut[(row, column)] = 0.0;
                    disturbed[(row, column)] = f64::NAN;
                }
            }
        }
        let Eigen { values, vectors } = symmetric_eigen(&disturbed, size).expect("finite up to the size");
        let composed = vectors * Matrix::from_diagonal(&values) * vectors.transpose();
        prop_assert!((composed - cut).amax() < ROUNDING);
        prop_assert_eq!(values.iter().skip(size).filter(|value| **value != 0.0).count(), 0);
    }

    /// Fewer directions than dimensions, as a motion without noise has: what is left is rounding of the largest.
    #[test]
    fn missing_directions_have_no_value(matrix in symmetric(), rank in 1..N) {
        let mut columns = Matrix::zeros();
        columns.columns_mut(0, rank).copy_from(&matrix.columns(0, rank));
        let spanned = columns * columns.transpose();
        let Eigen { values, vectors } = spectral(&spanned);
        prop_assert!(values.iter().skip(rank).all(|value| value.abs() < ROUNDING * values[0]));
        prop_assert!(distance_from_orthogonal(&vectors) < ROUNDING);
    }
}

#[test]
fn extremes_are_decomposed() {
    let zero = spectral(&Matrix::zeros());
    assert_eq!((zero.values, zero.vectors), (SVector::zeros(), Matrix::identity()));
    let equal = spectral(&Matrix::repeat(1.0));
    assert!((equal.values[0] - 12.0).abs() < ROUNDING && equal.values.rows(1, 11).amax() < ROUNDING);
    for scale in [1e-150, 1e150] {
        let scaled = symmetric_eigen(&(SMatrix::<f64, 2, 2>::new(2.0, 1.0, 1.0, 2.0) * scale), 2);
        let values = scaled.expect("all elements are finite").values / scale;
        assert!((values - SVector::from([3.0, 1.0])).amax() < ROUNDING);
    }
}

#[test]
fn what_is_not_finite_is_refused() {
    for element in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for place in [(0, 0), (2, 1)] {
            let mut matrix = SMatrix::<f64, 3, 3>::identity();
            matrix[place] = element;
            assert_eq!(symmetric_eigen(&matrix, 3).err(), Some(Refusal::NonFinite));
        }
    }
}
