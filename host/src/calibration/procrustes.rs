//! Orthogonal Procrustes: the turn that brings one shape closest to another, in the frame of the other.
//!
//! min over orthogonal R of ‖R A − B‖ has the solution R = UVᵀ with BAᵀ = UΣVᵀ (Schönemann 1966). A trial's own frame may be
//! mirrored, so that both hands are tried, and the margin between them is told.

use nalgebra::{DMatrix, DVector};

use super::singular::Singular;

/// One shape turned onto another.
#[derive(Clone, Debug)]
pub struct Turned {
    /// R (r × r), orthogonal.
    pub orientation: DMatrix<f64>,
    /// R A.
    pub turned: DMatrix<f64>,
    /// ‖R A − B‖ / ‖B‖.
    pub residual: f64,
    /// The same for the best R of the other hand.
    pub other_hand: f64,
}

/// Turns `shape` (r × p) onto `target` (r × p).
pub fn onto(shape: &DMatrix<f64>, target: &DMatrix<f64>) -> Turned {
    let Singular { left, right, .. } = Singular::of(&(target * shape.transpose()));
    let rank = shape.nrows();
    let turned_by = |last: f64| {
        let mut signs = DVector::from_element(rank, 1.0);
        signs[rank - 1] = last;
        let orientation = &left * DMatrix::from_diagonal(&signs) * right.transpose();
        let turned = &orientation * shape;
        let residual = (&turned - target).norm() / target.norm();
        (orientation, turned, residual)
    };
    let (orientation, turned, residual) = turned_by(1.0);
    let (_, _, other_hand) = turned_by(-1.0);
    Turned { orientation, turned, residual, other_hand }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::onto;

    #[test]
    fn a_turned_or_mirrored_shape_is_turned_back() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (rank, gages) in [(2, 2), (2, 4), (3, 3), (3, 8)] {
            for _ in 0..20 {
                let mut number = || random.random::<f64>() - 0.5;
                let target = DMatrix::from_fn(rank, gages, |_, _| number());
                let orthogonal = DMatrix::from_fn(rank, rank, |_, _| number()).qr().q();
                let found = onto(&(orthogonal.transpose() * &target), &target);
                assert!(found.residual < 1e-12 && found.other_hand > found.residual, "{found:?}");
                assert!((found.orientation - orthogonal).norm() < 1e-9);
            }
        }
    }
}
