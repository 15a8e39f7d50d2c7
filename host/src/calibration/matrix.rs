//! The calibration matrix of a shape whose dimensions are known at run time only (eq. 5).

use ftcal_shared::refusal::Refusal;
use nalgebra::DMatrix;

use super::singular::Singular;

/// The least singular value over the greatest, among rows brought to one length, below which rows are dependent.
const LEAST_CONDITION: f64 = 1e-9;

/// C = (Sᵀ)⁺ (m × p) of a shape S (m × p) with independent rows: newton, or newton metre, per count where S has counts
/// per newton.
///
/// Rows may differ by their unit (force, torque): each is brought to length one first, which changes nothing in the
/// answer (C of DS is D⁻¹C for a diagonal D) but its rounding.
///
/// # Errors
///
/// [`Refusal::RankNotReached`] where the rows of S are not independent; [`Refusal::NonFinite`].
pub fn matrix_of_shape(shape: &DMatrix<f64>) -> Result<DMatrix<f64>, Refusal> {
    if !shape.iter().all(|element| element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    let rows = shape.nrows();
    let dependent = |independent: usize| {
        let small = |dimension: usize| u8::try_from(dimension).unwrap_or(u8::MAX);
        Refusal::RankNotReached { have: small(independent), need: small(rows) }
    };
    let lengths: Vec<f64> = shape.row_iter().map(|row| row.norm()).collect();
    let mut unit = shape.clone();
    for (mut row, &length) in unit.row_iter_mut().zip(&lengths) {
        if length > 0.0 {
            row /= length;
        }
    }
    let decomposition = Singular::of(&unit.transpose());
    let independent = decomposition.rank(LEAST_CONDITION);
    if independent < rows {
        return Err(dependent(independent));
    }
    let mut matrix = decomposition.pseudo_inverse(rows);
    for (mut row, &length) in matrix.row_iter_mut().zip(&lengths) {
        row /= length;
    }
    if matrix.iter().all(|element| element.is_finite()) { Ok(matrix) } else { Err(Refusal::NonFinite) }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::refusal::Refusal;
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::matrix_of_shape;

    #[test]
    fn the_matrix_recovers_every_load_and_ignores_what_no_load_causes() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for (dof, gages) in [(2, 2), (2, 4), (3, 3), (3, 8), (6, 6), (6, 12)] {
            let mut shape = DMatrix::from_fn(dof, gages, |_, _| random.random::<f64>() - 0.5);
            // A torque row in a unit of its own, whose rounding is that many times larger, too.
            let unit = 1e6;
            shape.row_mut(dof - 1).scale_mut(unit);
            let matrix = matrix_of_shape(&shape).expect("random rows are independent");
            let identity = &matrix * shape.transpose();
            assert!((identity - DMatrix::identity(dof, dof)).amax() < unit * 1e-12);
            // The pseudo-inverse is the one left inverse whose rows lie in the row space of S.
            let projector = shape.transpose() * &matrix;
            assert!((&projector - projector.transpose()).amax() < 1e-10);
        }
    }

    #[test]
    fn dependent_rows_are_refused() {
        let shape = DMatrix::from_row_slice(3, 4, &[1., 2., 3., 4., 0., 1., 0., 1., 1., 3., 3., 5.]);
        assert_eq!(matrix_of_shape(&shape), Err(Refusal::RankNotReached { have: 2, need: 3 }));
        assert!(matrix_of_shape(&DMatrix::zeros(2, 4)).is_err());
        assert!(matrix_of_shape(&DMatrix::from_element(3, 2, 1.0)).is_err(), "fewer gages than rows");
        assert_eq!(matrix_of_shape(&DMatrix::from_element(2, 3, f64::NAN)), Err(Refusal::NonFinite));
    }
}
