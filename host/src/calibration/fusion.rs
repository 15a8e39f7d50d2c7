//! Moment-arm fusion: the sensor's true shape from the oriented shapes of several trials (eq. 17, 18, 20).
//!
//! Trial i, whose load hung at arm aᵢ, sees Sᵢ = [I Xᵢᵀ] S̃ (eq. 16, 19). Stacked, the trials are one linear system for
//! S̃, solved by the pseudo-inverse of the stacked squashing matrices. Its torque columns are metres where the others
//! are ones, so they are divided by a characteristic arm length first (design § 7): the answer stays, the condition
//! falls. For a force sensor the squashing matrices are identities and the fusion is the mean of the trials.
//!
//! What the arms must be: two different ones in the plane, three that are not on one line in space; fewer leave part of
//! the torque unseen.

use nalgebra::{DMatrix, DVector};

use ftcal_shared::units::Dof;

use super::CalibrationRefusal;
use super::known_load::squashing_matrix;
use super::singular::Singular;

/// Distances between arms below this share of their own scale are no distances.
const LEAST_SPREAD: f64 = 0.01;

/// The stacked squashing matrices of all trials, and how to scale their torque columns.
#[derive(Clone, Debug)]
pub struct Stack {
    /// [I Xᵢᵀ] of all trials, one above the other (rN × m), torque columns divided by the characteristic length.
    pub squashing: DMatrix<f64>,
    /// Its pseudo-inverse (m × rN).
    pub inverse: DMatrix<f64>,
    /// What each column was divided by (m): one for forces, the characteristic arm length in metre for torques.
    pub lengths: DVector<f64>,
}

/// The shape that several trials agree on best.
#[derive(Clone, Debug)]
pub struct Fused {
    /// S̃ (m × p), counts per newton and per newton metre.
    pub shape: DMatrix<f64>,
    /// The part of the stacked shapes that no S̃ explains, over their whole: ‖stack − [I Xᵀ]S̃‖ / ‖stack‖.
    pub residual: f64,
}

impl Stack {
    /// Stacks the squashing matrices of trials at these arms.
    ///
    /// # Errors
    ///
    /// [`CalibrationRefusal::TooFewArms`], [`CalibrationRefusal::ArmsEqual`], [`CalibrationRefusal::ArmsCollinear`].
    pub fn new(dof: Dof, arms_m: &[&DVector<f64>]) -> Result<Self, CalibrationRefusal> {
        let rank = dof.trial_rank();
        let length = if dof.has_torque() { characteristic_length(rank, arms_m)? } else { 1.0 };
        let lengths = DVector::from_fn(dof.count(), |column, _| if column < rank { 1.0 } else { length });
        let mut squashing = DMatrix::zeros(rank * arms_m.len(), dof.count());
        for (trial, arm) in arms_m.iter().enumerate() {
            let mut block = squashing_matrix(rank, arm);
            for (mut column, &length) in block.column_iter_mut().zip(&lengths) {
                column /= length;
            }
            squashing.rows_mut(rank * trial, rank).copy_from(&block);
        }
        let inverse = Singular::of(&squashing).pseudo_inverse(dof.count());
        Ok(Self { squashing, inverse, lengths })
    }

    /// Fuses the oriented shapes (each r × p, counts per newton) of the trials.
    pub fn fuse(&self, shapes: &[DMatrix<f64>]) -> Fused {
        let stacked = stack(shapes);
        let mut shape = &self.inverse * &stacked;
        let misfit = &stacked - &self.squashing * &shape;
        for (mut row, &length) in shape.row_iter_mut().zip(&self.lengths) {
            row /= length;
        }
        Fused { shape, residual: misfit.norm() / stacked.norm() }
    }
}

/// Matrices of equal width, one above the other.
pub fn stack(matrices: &[DMatrix<f64>]) -> DMatrix<f64> {
    let rows = matrices.iter().map(DMatrix::nrows).sum();
    let columns = matrices.first().map_or(0, DMatrix::ncols);
    let mut stacked = DMatrix::zeros(rows, columns);
    let mut at = 0;
    for matrix in matrices {
        stacked.rows_mut(at, matrix.nrows()).copy_from(matrix);
        at += matrix.nrows();
    }
    stacked
}

/// The length by which the arms differ from each other: their root mean square distance from their mean, metre.
fn characteristic_length(rank: usize, arms_m: &[&DVector<f64>]) -> Result<f64, CalibrationRefusal> {
    let (have, need) = (arms_m.len(), rank);
    if have < need {
        return Err(CalibrationRefusal::TooFewArms { have, need });
    }
    let mean = arms_m.iter().copied().sum::<DVector<f64>>() / have as f64;
    let offsets = DMatrix::from_fn(rank, have, |axis, arm| arms_m[arm][axis] - mean[axis]);
    let longest = arms_m.iter().map(|arm| arm.norm()).fold(0.0, f64::max);
    let spreads = Singular::of(&offsets).values / (have as f64).sqrt();
    let (widest, across) = (spreads[0], spreads[1]);
    let differ = widest > LEAST_SPREAD * longest;
    if !differ {
        return Err(CalibrationRefusal::ArmsEqual { arms: have, spread_m: widest });
    }
    if rank == 3 && across <= LEAST_SPREAD * widest {
        return Err(CalibrationRefusal::ArmsCollinear { arms: have });
    }
    Ok(spreads.norm())
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::Stack;
    use crate::calibration::CalibrationRefusal;
    use crate::calibration::known_load::squashing_matrix;

    fn arms(rows: &[&[f64]]) -> Vec<DVector<f64>> {
        rows.iter().map(|row| DVector::from_column_slice(row)).collect()
    }

    fn stack(dof: Dof, arms: &[DVector<f64>]) -> Result<Stack, CalibrationRefusal> {
        Stack::new(dof, &arms.iter().collect::<Vec<_>>())
    }

    #[test]
    fn fusing_what_the_arms_squash_gives_the_true_shape() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let cases = [
            (Dof::PlanarForce, arms(&[&[]])),
            (Dof::SpatialForce, arms(&[&[], &[]])),
            (Dof::PlanarForceTorque, arms(&[&[0.1, 0.0], &[-0.02, 0.05]])),
            (Dof::SpatialForceTorque, arms(&[&[0.1, 0.0, 0.1], &[0.0, 0.1, 0.1], &[0.0, -0.1, 0.2]])),
            (
                Dof::SpatialForceTorque,
                arms(&[&[1e-3, 0.0, 0.0], &[0.0, 1e-3, 0.0], &[0.0, 0.0, 0.0], &[0.0, 0.0, 1e-3]]),
            ),
        ];
        for (dof, arms) in cases {
            let truth = DMatrix::from_fn(dof.count(), 8, |_, _| random.random::<f64>() - 0.5);
            let shapes: Vec<DMatrix<f64>> =
                arms.iter().map(|arm| squashing_matrix(dof.trial_rank(), arm) * &truth).collect();
            let fused = stack(dof, &arms).expect("the arms suffice").fuse(&shapes);
            assert!((&fused.shape - &truth).norm() < 1e-9, "{dof:?}");
            assert!(fused.residual < 1e-12, "{dof:?}");
        }
    }

    #[test]
    fn arms_are_judged_by_their_differences_in_any_unit() {
        let dof = Dof::SpatialForceTorque;
        for unit in [1e-3, 1.0, 50.0] {
            let scaled = |rows: [[f64; 3]; 3]| {
                let arms: Vec<DVector<f64>> =
                    rows.iter().map(|row| DVector::from_column_slice(row) * unit).collect();
                stack(dof, &arms)
            };
            assert!(scaled([[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]).is_ok());
            let collinear = scaled([[1., 0., 0.], [0., 1., 0.], [3., -2., 0.]]);
            assert!(matches!(collinear, Err(CalibrationRefusal::ArmsCollinear { arms: 3 })), "{unit}");
            let equal = scaled([[1., 1., 0.], [1., 1., 0.], [1., 1., 1e-3]]);
            assert!(matches!(equal, Err(CalibrationRefusal::ArmsEqual { arms: 3, .. })), "{unit}");
            let at_the_origin = scaled([[0.0; 3]; 3]);
            assert!(matches!(at_the_origin, Err(CalibrationRefusal::ArmsEqual { .. })), "{unit}");
        }
        let one = stack(Dof::PlanarForceTorque, &arms(&[&[0.1, 0.0]]));
        assert!(matches!(one, Err(CalibrationRefusal::TooFewArms { have: 1, need: 2 })));
    }
}
