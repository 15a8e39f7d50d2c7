//! Shape and bias of one trial: the whole of the paper's figure 2 up to the known loads (eq. 10, 11, design § 3).

use nalgebra::{Cholesky, SMatrix, SVector};

use super::basis::{Basis, basis, unsupported};
use super::directions::DirectionMoments;
use super::eigen::symmetric_eigen;
use super::metric::{LARGEST_RELATIVE_UNCERTAINTY, metric};
use super::moments::Moments;
use super::projection::project;
use super::uncertainty::{TrialUncertainty, predict};
use crate::refusal::Refusal;

/// What one trial tells: the sensor's shape for a load at that trial's moment arm, in an arbitrary orientation.
#[derive(Clone, Debug)]
pub struct TrialSolution<const GAGES: usize, const RANK: usize> {
    /// S (r × p), counts per unit load, so that z = b + Sᵀm with |m| = 1. Known up to a rotation and a mirror image; its
    /// rows are made orthogonal, longest first.
    pub shape_counts_per_load: SMatrix<f64, RANK, GAGES>,
    /// b (p), counts: the codes with no load.
    pub bias_counts: SVector<f64, GAGES>,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: SVector<f64, GAGES>,
    /// Variance of the noise of one channel, counts²; `None` where p = r leaves no redundant eigenvalue to tell it.
    pub noise_variance: Option<f64>,
    /// Samples that took part.
    pub samples: u64,
    /// Where the load has been, in the orientation of the shape.
    pub directions: DirectionMoments<RANK>,
    /// How well shape and bias are known.
    pub uncertainty: TrialUncertainty<RANK>,
}

/// The fewest samples a trial of this rank needs: twice the unknowns of the metric constraint, since fewer fit exactly
/// whatever the motion was.
pub const fn least_samples(rank: usize) -> u64 {
    (rank * (rank + 1) + 2 * rank) as u64
}

/// Solves one trial from its settled moments.
///
/// # Errors
///
/// [`Refusal::TooFewSamples`], and every refusal of [`basis`] and [`metric`].
pub fn solve_trial<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
) -> Result<TrialSolution<GAGES, RANK>, Refusal> {
    solve_trial_within(moments, LARGEST_RELATIVE_UNCERTAINTY)
}

/// The same, with a bound of the caller's on how uncertain the metric constraint may be: a trial that is still running is
/// asked where it stands long before its answer is good enough to be one.
///
/// # Errors
///
/// As [`solve_trial`].
pub fn solve_trial_within<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    accepted: f64,
) -> Result<TrialSolution<GAGES, RANK>, Refusal> {
    if !(2..=3).contains(&RANK) {
        return Err(unsupported::<GAGES, RANK>());
    }
    let samples = moments.count();
    if samples < least_samples(RANK) {
        return Err(Refusal::TooFewSamples { have: samples, need: least_samples(RANK) });
    }
    let Basis { vectors, eigenvalues, noise_variance } =
        basis::<GAGES, RANK>(&moments.covariance(), samples)?;

    let variances = eigenvalues.fixed_rows::<RANK>(0).into_owned();
    let deviations = variances.map(libm::sqrt);
    let whitening = SMatrix::<f64, RANK, RANK>::from_diagonal(&deviations.map(|deviation| 1.0 / deviation));
    let whitened_noise = variances.map(|variance| noise_variance.unwrap_or(0.0) / variance);
    let whitened = project(moments, &vectors).transformed(&whitening);
    let metric = metric(&whitened, &whitened_noise, samples, accepted)?;

    // M = LLᵀ makes m = Lᵀ(x − c) a unit vector, so z = b + V*Λ^½L⁻ᵀm: A = L⁻¹ in eq. 11, with Ŝ = Λ^½V*ᵀ.
    let factor = Cholesky::new(metric.matrix).ok_or(Refusal::MetricNotPositiveDefinite)?;
    let indeterminate_shape = SMatrix::<f64, RANK, RANK>::from_diagonal(&deviations) * vectors.transpose();
    let shape =
        factor.l().solve_lower_triangular(&indeterminate_shape).ok_or(Refusal::MetricNotPositiveDefinite)?;
    // The orientation is arbitrary, so it is chosen: rows orthogonal, longest first.
    let principal = symmetric_eigen(&(shape * shape.transpose()))?;
    let orientation = principal.vectors.transpose();
    let shape_counts_per_load = orientation * shape;
    let bias_counts = moments.mean_counts() + indeterminate_shape.transpose() * metric.centre;

    let to_direction = orientation * factor.l().transpose();
    let central = whitened.without_noise(&whitened_noise).transformed(&to_direction);
    let directions = DirectionMoments::new(to_direction * -metric.centre, &central);
    let uncertainty =
        predict(&directions, &principal.values, noise_variance.unwrap_or(0.0), metric.unexplained, samples)?;

    if shape_counts_per_load.iter().chain(bias_counts.iter()).any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    Ok(TrialSolution {
        shape_counts_per_load,
        bias_counts,
        eigenvalues,
        noise_variance,
        samples,
        directions,
        uncertainty,
    })
}
