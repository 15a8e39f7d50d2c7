//! The singular value decomposition A = U Σ Vᵀ of a small matrix, by one-sided Jacobi rotations.
//!
//! The columns of A are turned in pairs until all are orthogonal (Hestenes); their lengths are then the singular values,
//! the turns are V. Slower than bidiagonalisation and more accurate, also where A has no full rank, which known loads and
//! moment arms bring about all the time: two directions give a 3×3 matrix of rank two. (The decomposition of nalgebra
//! 0.35 fails to reproduce about one in fifty of those, by up to 20 %.)

use nalgebra::{DMatrix, DVector};

/// Columns are orthogonal when the cosine between them is rounding.
const LARGEST_COSINE: f64 = 4.0 * f64::EPSILON;

/// Convergence is quadratic; matrices of a dozen columns take fewer than ten sweeps.
const MOST_SWEEPS: usize = 60;

/// A value below this share of the greatest is zero: its column of U is rounding.
const LEAST_VALUE: f64 = 1e-14;

/// A = U Σ Vᵀ with A of n × k, n ≥ k, or its transpose where A is wide.
#[derive(Clone, Debug)]
pub struct Singular {
    /// U, n × min(n, k), orthonormal columns.
    pub left: DMatrix<f64>,
    /// Σ, descending.
    pub values: DVector<f64>,
    /// V, k × min(n, k), orthonormal columns.
    pub right: DMatrix<f64>,
}

impl Singular {
    /// Decomposes a matrix of finite numbers.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        if matrix.nrows() < matrix.ncols() {
            let Self { left, values, right } = Self::of(&matrix.transpose());
            return Self { left: right, values, right: left };
        }
        let (turned, turns) = orthogonalised(matrix);
        let lengths: Vec<f64> = turned.column_iter().map(|column| column.norm()).collect();
        let mut order: Vec<usize> = (0..lengths.len()).collect();
        order.sort_by(|&a, &b| lengths[b].total_cmp(&lengths[a]));
        let values = DVector::from_iterator(lengths.len(), order.iter().map(|&column| lengths[column]));
        let floor = LEAST_VALUE * values.max();
        let mut left = DMatrix::zeros(matrix.nrows(), values.len());
        for (at, &column) in order.iter().enumerate() {
            let unit = if values[at] > floor {
                turned.column(column) / values[at]
            } else {
                orthogonal_to(&left.columns(0, at).into_owned())
            };
            left.set_column(at, &unit);
        }
        Self { left, values, right: turns.select_columns(&order) }
    }

    /// The least singular value over the greatest; zero of a zero matrix.
    pub fn condition(&self) -> f64 {
        let greatest = self.values.max();
        if greatest > 0.0 { self.values.min() / greatest } else { 0.0 }
    }

    /// The number of values above `share` of the greatest.
    pub fn rank(&self, share: f64) -> usize {
        let floor = share * self.values.max();
        self.values.iter().filter(|&&value| value > floor).count()
    }

    /// The pseudo-inverse of the best approximation of this rank: V Σ⁺ Uᵀ over the first `rank` values.
    pub fn pseudo_inverse(&self, rank: usize) -> DMatrix<f64> {
        let mut inverse = DMatrix::zeros(self.right.nrows(), self.left.nrows());
        for kept in (0..rank.min(self.values.len())).filter(|&kept| self.values[kept] > 0.0) {
            inverse += self.right.column(kept) * self.left.column(kept).transpose() / self.values[kept];
        }
        inverse
    }
}

/// A·V with orthogonal columns, and V.
fn orthogonalised(matrix: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let columns = matrix.ncols();
    // Lengths near one keep the squares below from overflowing and from vanishing.
    let scale = matrix.amax();
    let mut turned = if scale > 0.0 { matrix / scale } else { matrix.clone() };
    let mut turns = DMatrix::identity(columns, columns);
    for _ in 0..MOST_SWEEPS {
        let mut orthogonal = true;
        for a in 0..columns {
            for b in a + 1..columns {
                let (length_a, length_b) = (turned.column(a).norm_squared(), turned.column(b).norm_squared());
                let product = turned.column(a).dot(&turned.column(b));
                if product.abs() <= LARGEST_COSINE * (length_a * length_b).sqrt() {
                    continue;
                }
                orthogonal = false;
                // The smaller of the two turns that make the columns orthogonal.
                let half_difference = (length_b - length_a) / (2.0 * product);
                let tangent = half_difference.signum() / (half_difference.abs() + half_difference.hypot(1.0));
                let cosine = 1.0 / tangent.hypot(1.0);
                turn_columns(&mut turned, (a, b), cosine, cosine * tangent);
                turn_columns(&mut turns, (a, b), cosine, cosine * tangent);
            }
        }
        if orthogonal {
            break;
        }
    }
    (turned * if scale > 0.0 { scale } else { 1.0 }, turns)
}

fn turn_columns(matrix: &mut DMatrix<f64>, (a, b): (usize, usize), cosine: f64, sine: f64) {
    for row in 0..matrix.nrows() {
        let (x, y) = (matrix[(row, a)], matrix[(row, b)]);
        matrix[(row, a)] = cosine * x - sine * y;
        matrix[(row, b)] = sine * x + cosine * y;
    }
}

/// A unit vector orthogonal to these orthonormal columns, fewer than they are long.
fn orthogonal_to(columns: &DMatrix<f64>) -> DVector<f64> {
    let rows = columns.nrows();
    let complement = DMatrix::identity(rows, rows) - columns * columns.transpose();
    let longest = complement.column_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()));
    longest.map_or_else(|| DVector::zeros(rows), |longest| longest.normalize())
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::Singular;

    fn assert_decomposes(matrix: &DMatrix<f64>) {
        let Singular { left, values, right } = Singular::of(matrix);
        let size = values.len();
        assert_eq!(size, matrix.nrows().min(matrix.ncols()));
        assert!(values.iter().all(|&value| value >= 0.0) && values.as_slice().is_sorted_by(|a, b| a >= b));
        let again = &left * DMatrix::from_diagonal(&values) * right.transpose();
        assert!((again - matrix).norm() <= 1e-13 * matrix.norm(), "{matrix}");
        for factor in [left, right] {
            assert!((factor.transpose() * factor - DMatrix::identity(size, size)).norm() < 1e-12, "{matrix}");
        }
    }

    #[test]
    fn every_matrix_is_put_together_again_from_orthogonal_factors() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (rows, columns) in [(1, 1), (2, 2), (3, 3), (9, 6), (4, 12), (3, 1)] {
            for rank in 0..=rows.min(columns) {
                for _ in 0..300 {
                    let scale = 10_f64.powi(random.random_range(-150..150));
                    let mut number = || random.random::<f64>() - 0.5;
                    let left = DMatrix::from_fn(rows, rank, |_, _| number());
                    let right = DMatrix::from_fn(rank, columns, |_, _| number());
                    assert_decomposes(&(left * right * scale));
                }
            }
        }
        assert_decomposes(&DMatrix::identity(3, 3));
        assert_decomposes(&DMatrix::from_element(3, 3, 1.0));
        assert_decomposes(&DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 1e-9, 1e9])));
    }

    #[test]
    fn the_pseudo_inverse_has_the_four_properties_of_penrose() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for (rows, columns, rank) in [(6, 3, 3), (3, 6, 2), (4, 4, 4), (5, 5, 1)] {
            let left = DMatrix::from_fn(rows, rank, |_, _| random.random::<f64>() - 0.5);
            let right = DMatrix::from_fn(rank, columns, |_, _| random.random::<f64>() - 0.5);
            let matrix = left * right;
            let singular = Singular::of(&matrix);
            assert_eq!(singular.rank(1e-9), rank);
            let inverse = singular.pseudo_inverse(rank);
            let close = |a: &DMatrix<f64>, b: &DMatrix<f64>| (a - b).norm() <= 1e-9 * (1.0 + a.norm());
            let (there, back) = (&matrix * &inverse, &inverse * &matrix);
            assert!(close(&(&there * &matrix), &matrix) && close(&(&back * &inverse), &inverse));
            assert!(close(&there, &there.transpose()) && close(&back, &back.transpose()));
        }
    }
}
