//! The calibration matrix of a shape (eq. 5).

use nalgebra::{Cholesky, SMatrix};

use crate::refusal::Refusal;

/// `C = [Sᵀ]⁺ = (SSᵀ)⁻¹S` (m × p) of a shape S (m × p): newton, or newton metre, per count where S has counts per newton.
///
/// Noise of equal variance in every channel is assumed; the pseudo-inverse is then the least-squares estimate of the
/// load (eq. 5).
///
/// # Errors
///
/// [`Refusal::RankNotReached`] where the rows of S are not independent; [`Refusal::NonFinite`].
pub fn calibration_matrix<const DOF: usize, const GAGES: usize>(
    shape: &SMatrix<f64, DOF, GAGES>,
) -> Result<SMatrix<f64, DOF, GAGES>, Refusal> {
    if shape.iter().any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    let gram = shape * shape.transpose();
    #[expect(clippy::cast_possible_truncation, reason = "at most six degrees of freedom")]
    let dependent = Refusal::RankNotReached { have: DOF.saturating_sub(1) as u8, need: DOF as u8 };
    let matrix = Cholesky::new(gram).ok_or(dependent)?.solve(shape);
    if matrix.iter().all(|element| element.is_finite()) { Ok(matrix) } else { Err(dependent) }
}
