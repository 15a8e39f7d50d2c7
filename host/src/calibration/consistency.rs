//! How well oriented trials agree with each other, measured against what their uncertainties allow.
//!
//! The fusion residual alone says how large a misfit is, not how large it may be. Here each trial's shape may still turn
//! as a whole (known loads are known to a fraction of a degree), be scaled (the mass) and have its arm moved; each such
//! change has a standard deviation. The misfit is what is left when all of them are chosen for the best:
//!
//! ```text
//! min over θ   ‖ W (d + Σ θₖ σₖ Dₖ) ‖² + ‖θ‖²
//! ```
//!
//! with d the part of the stacked shapes that no S̃ explains (eq. 20), Dₖ what change k adds to it, and W the inverse
//! standard deviations of the trials' coefficients. For trials that belong together it is about the number of degrees
//! of freedom, (rN − m)·p; a wrong mass, arm or mirror image makes it far larger. The same changes, carried through the
//! pseudo-inverses instead, predict the error of a wrench.

use nalgebra::{DMatrix, DVector};

use super::alignment::MODEL_ERROR;
use super::fusion::{Stack, stack};
use super::known_load::squashing_matrix;
use super::matrix::matrix_of_shape;

/// Standard deviation of an arm's components where the session states none: a fixture made and measured with care, metre.
pub const ARM_ACCURACY_M: f64 = 2e-4;

/// Standard deviation of a mass, relative, where the session states none: a kitchen balance.
pub const MASS_ACCURACY: f64 = 1e-3;

/// One trial, oriented in one of the ways its known loads allow.
#[derive(Clone, Debug)]
pub struct OrientedTrial {
    /// S (r × p) in the sensor frame, counts per newton.
    pub shape: DMatrix<f64>,
    /// The moment arm, metre.
    pub arm_m: DVector<f64>,
    /// Covariance of the small turn that the orientation may be off by, radian².
    pub covariance: DMatrix<f64>,
    /// Relative standard deviation of the trial's gains.
    pub gain_uncertainty: f64,
    /// Standard deviation of the arm's components, metre.
    pub arm_accuracy_m: f64,
    /// Relative standard deviation of the mass.
    pub mass_accuracy: f64,
}

/// What the comparison of trials finds.
#[derive(Clone, Copy, Debug)]
pub struct Consistency {
    /// The misfit in units of its variance.
    pub misfit: f64,
    /// The degrees of freedom: the misfit to be expected.
    pub freedom: usize,
    /// Predicted error of a wrench, relative, torques scaled by the characteristic arm length.
    pub wrench_error: f64,
}

/// Compares trials with each other.
pub fn consistency(trials: &[OrientedTrial], arms: &Stack) -> Consistency {
    let deviations: Vec<f64> = trials.iter().map(OrientedTrial::coefficient_deviation).collect();
    let shapes: Vec<DMatrix<f64>> = trials.iter().map(|trial| trial.shape.clone()).collect();
    let stacked = stack(&shapes);
    let fused = &arms.inverse * &stacked;

    let weigh = |matrix: &DMatrix<f64>| {
        let mut weighted = matrix.clone();
        for (row, mut values) in weighted.row_iter_mut().enumerate() {
            values /= deviations[row * trials.len() / matrix.nrows()];
        }
        weighted
    };
    let explained = weigh(&arms.squashing).qr().q();
    let unexplained = |change: &DMatrix<f64>| {
        let weighted = weigh(change);
        &weighted - &explained * (explained.transpose() * &weighted)
    };

    let changes = changes(trials, &arms.lengths, &fused);
    let misfit = unexplained(&stacked);
    let directions: Vec<DMatrix<f64>> = changes.iter().map(unexplained).collect();
    let normal = DMatrix::from_fn(changes.len(), changes.len(), |a, b| {
        directions[a].dot(&directions[b]) + if a == b { 1.0 } else { 0.0 }
    });
    let right =
        DVector::from_iterator(changes.len(), directions.iter().map(|direction| -direction.dot(&misfit)));
    // One plus a Gram matrix is positive definite.
    let chosen =
        normal.cholesky().map_or_else(|| DVector::zeros(changes.len()), |factor| factor.solve(&right));
    let left: DMatrix<f64> =
        directions.iter().zip(&chosen).fold(misfit, |left, (direction, &by)| left + direction * by);

    Consistency {
        misfit: left.norm_squared() + chosen.norm_squared(),
        freedom: (stacked.nrows() - fused.nrows().min(stacked.nrows())) * stacked.ncols(),
        wrench_error: wrench_error(&fused, &changes, &deviations, arms),
    }
}

/// The predicted error of a wrench, relative: the root mean square of CδS̃ᵀ over the wrenches of length one, torques
/// divided by the characteristic arm length. Infinite where the shape cannot be inverted.
fn wrench_error(fused: &DMatrix<f64>, changes: &[DMatrix<f64>], deviations: &[f64], arms: &Stack) -> f64 {
    let Ok(matrix) = matrix_of_shape(fused) else { return f64::INFINITY };
    let rows = arms.inverse.ncols();
    let independent = arms.inverse.column_iter().enumerate().map(|(row, column)| {
        let deviation = deviations[row * deviations.len() / rows];
        column.norm_squared() * deviation * deviation
    });
    let noise = matrix.norm_squared() * independent.sum::<f64>();
    let carried: f64 =
        changes.iter().map(|change| (&matrix * (&arms.inverse * change).transpose()).norm_squared()).sum();
    ((noise + carried) / fused.nrows() as f64).sqrt()
}

impl OrientedTrial {
    /// Standard deviation of one coefficient, counts per newton: the trial's own, the error of any linear model, and
    /// what a turn by its standard deviation does beyond first order.
    fn coefficient_deviation(&self) -> f64 {
        let coefficients = self.shape.len().max(1) as f64;
        let typical = self.shape.norm() / coefficients.sqrt();
        let second_order = self.covariance.trace() / 2.0;
        typical * self.gain_uncertainty.hypot(MODEL_ERROR).hypot(second_order)
    }
}

/// What one standard deviation of each uncertain quantity does to the stacked shapes (each rN × p).
fn changes(trials: &[OrientedTrial], lengths: &DVector<f64>, fused: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
    let rows: usize = trials.iter().map(|trial| trial.shape.nrows()).sum();
    let mut changes = Vec::new();
    let mut at = 0;
    for trial in trials {
        let rank = trial.shape.nrows();
        let mut add = |change: &DMatrix<f64>| {
            let mut whole = DMatrix::zeros(rows, fused.ncols());
            whole.rows_mut(at, rank).copy_from(change);
            changes.push(whole);
        };
        add(&(&trial.shape * trial.mass_accuracy));
        for turn in turns(&trial.covariance) {
            add(&(cross_product_matrix(&turn) * &trial.shape));
        }
        for axis in 0..trial.arm_m.len() {
            let mut shift = DVector::zeros(trial.arm_m.len());
            shift[axis] = trial.arm_accuracy_m;
            let mut torque = squashing_matrix(rank, &shift);
            torque.columns_mut(0, rank).fill(0.0);
            for (mut column, &length) in torque.column_iter_mut().zip(lengths) {
                column /= length;
            }
            add(&(torque * fused));
        }
        at += rank;
    }
    changes
}

/// The turns of one standard deviation along the principal axes of a covariance of turns.
fn turns(covariance: &DMatrix<f64>) -> Vec<DVector<f64>> {
    let eigen = covariance.clone().symmetric_eigen();
    let deviations = eigen.eigenvalues.iter().map(|variance| variance.max(0.0).sqrt());
    eigen.eigenvectors.column_iter().zip(deviations).map(|(axis, deviation)| axis * deviation).collect()
}

/// [ω]×: the change that a small turn makes, 2 × 2 for a turn in the plane, 3 × 3 for one in space.
fn cross_product_matrix(turn: &DVector<f64>) -> DMatrix<f64> {
    match *turn.as_slice() {
        [x, y, z] => DMatrix::from_row_slice(3, 3, &[0.0, -z, y, z, 0.0, -x, -y, x, 0.0]),
        [angle] => DMatrix::from_row_slice(2, 2, &[0.0, -angle, angle, 0.0]),
        _ => DMatrix::zeros(turn.len(), turn.len()),
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{
        ARM_ACCURACY_M, Consistency, MASS_ACCURACY, OrientedTrial, consistency, cross_product_matrix,
    };
    use crate::calibration::fusion::Stack;
    use crate::calibration::known_load::squashing_matrix;

    const ACCURACY_RAD: f64 = 2e-3;

    fn arms() -> Vec<DVector<f64>> {
        [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]]
            .iter()
            .map(|arm| DVector::from_column_slice(arm))
            .collect()
    }

    /// Trials of one random sensor that fit together exactly.
    fn trials(random: &mut ChaCha8Rng) -> Vec<OrientedTrial> {
        let mut truth = DMatrix::from_fn(6, 8, |_, _| random.random::<f64>() - 0.5);
        truth.rows_mut(3, 3).scale_mut(20.0);
        arms()
            .into_iter()
            .map(|arm_m| OrientedTrial {
                shape: squashing_matrix(3, &arm_m) * &truth,
                arm_m,
                covariance: DMatrix::identity(3, 3) * ACCURACY_RAD.powi(2),
                gain_uncertainty: 1e-4,
                arm_accuracy_m: ARM_ACCURACY_M,
                mass_accuracy: MASS_ACCURACY,
            })
            .collect()
    }

    fn compare(trials: &[OrientedTrial]) -> Consistency {
        let arms = arms();
        let stack =
            Stack::new(Dof::SpatialForceTorque, &arms.iter().collect::<Vec<_>>()).expect("three arms");
        consistency(trials, &stack)
    }

    #[test]
    fn errors_of_the_stated_size_stay_within_the_degrees_of_freedom_and_larger_ones_do_not() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..20 {
            let exact = trials(&mut random);
            let Consistency { misfit, freedom, .. } = compare(&exact);
            assert!(misfit < 1e-9);
            assert_eq!(freedom, (9 - 6) * 8);
            let mut disturbed = |times: f64| {
                let mut normal = || 1.7 * (2.0 * random.random::<f64>() - 1.0) * times;
                let mut trials = exact.clone();
                for trial in &mut trials {
                    let turn = DVector::from_fn(3, |_, _| ACCURACY_RAD * normal());
                    trial.shape += cross_product_matrix(&turn) * &trial.shape
                        + &trial.shape * (MASS_ACCURACY * normal());
                }
                compare(&trials).misfit / freedom as f64
            };
            assert!(disturbed(1.0) < 2.0);
            assert!(disturbed(60.0) > 16.0);
        }
    }

    #[test]
    fn the_misfit_does_not_change_with_the_unit_of_the_counts_nor_with_the_frame() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let mut trials = trials(&mut random);
        for trial in &mut trials {
            trial.shape.apply(|element| *element += 0.01 * (random.random::<f64>() - 0.5));
        }
        let plain = compare(&trials);
        for trial in &mut trials {
            trial.shape *= 1e5;
        }
        let scaled = compare(&trials);
        assert!((scaled.misfit / plain.misfit - 1.0).abs() < 1e-6);
        assert!((scaled.wrench_error / plain.wrench_error - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_shifted_arm_is_forgiven_as_far_as_it_is_uncertain() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let exact = trials(&mut random);
        let shifted = |shift_m: f64| {
            let mut trials = exact.clone();
            // The same sensor, seen from an arm that is not the one stated: torque rows e × shift are missing.
            let arms =
                Stack::new(Dof::SpatialForceTorque, &arms().iter().collect::<Vec<_>>()).expect("three arms");
            let shapes: Vec<DMatrix<f64>> = exact.iter().map(|trial| trial.shape.clone()).collect();
            let truth = arms.fuse(&shapes).shape;
            let arm = &exact[0].arm_m + DVector::from_column_slice(&[shift_m, 0.0, 0.0]);
            trials[0].shape = squashing_matrix(3, &arm) * truth;
            compare(&trials).misfit
        };
        assert!(shifted(ARM_ACCURACY_M) <= 1.0, "one standard deviation costs one at most");
        assert!(shifted(50.0 * ARM_ACCURACY_M) > 16.0 * 24.0);
    }
}
