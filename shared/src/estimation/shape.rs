//! Shape and bias of one trial: the whole of the paper's figure 2 up to the known loads (eq. 10, 11, design § 3).

use nalgebra::{Cholesky, SMatrix, SVector};

use super::basis::{Basis, basis};
use super::code_sums::CodeSums;
use super::directions::DirectionMoments;
use super::eigen::symmetric_eigen;
use super::metric::{
    LARGEST_RELATIVE_UNCERTAINTY, LEAST_UNEXPLAINED, NoiseShift, does_not_span, metric,
    require_indifference_to_noise,
};
use super::moments::Moments;
use super::projection::{MotionSums, project};
use super::uncertainty::{Regressors, TrialUncertainty, predict};
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
    /// Variance of |m|² that the noise does not explain.
    pub unexplained: f64,
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
    require_samples::<RANK>(moments.count())?;
    let subspace = basis::<GAGES, RANK>(&moments.codes().covariance(), moments.count())?;
    let quiet = project(moments, &subspace.vectors);
    solve_within(&subspace, moments.codes(), &quiet, LARGEST_RELATIVE_UNCERTAINTY)
}

/// A trial of an unknown rank, or of too few samples, is refused.
pub(crate) const fn require_samples<const RANK: usize>(samples: u64) -> Result<(), Refusal> {
    if samples < least_samples(RANK) {
        return Err(Refusal::TooFewSamples { have: samples, need: least_samples(RANK) });
    }
    Ok(())
}

/// Solves one trial within the subspace that `all` of its samples have given; the metric constraint is taken from the
/// `quiet` ones among them, as projected onto that subspace. For `accepted` see [`metric`].
///
/// # Errors
///
/// [`Refusal::TooFewSamples`], and every refusal of [`metric`].
pub(crate) fn solve_within<const GAGES: usize, const RANK: usize>(
    subspace: &Basis<GAGES, RANK>,
    all: &CodeSums<GAGES>,
    quiet: &MotionSums<RANK>,
    accepted: f64,
) -> Result<TrialSolution<GAGES, RANK>, Refusal> {
    let samples = quiet.samples();
    require_samples::<RANK>(samples)?;
    let &Basis { vectors, eigenvalues, noise_variance } = subspace;

    let variances = eigenvalues.fixed_rows::<RANK>(0).into_owned();
    let deviations = variances.map(libm::sqrt);
    let whitening = SMatrix::<f64, RANK, RANK>::from_diagonal(&deviations.map(|deviation| 1.0 / deviation));
    let whitened = quiet.central().transformed(&whitening);
    let noise = noise_variance.unwrap_or(0.0);
    let whitened_noise = variances.map(|variance| noise / variance);
    let metric = metric(&whitened, &variances, noise, samples, accepted)?;
    let noise_shift = match noise_variance {
        Some(_) => None,
        None => Some(require_indifference_to_noise(&whitened, &variances, &metric, samples, accepted)?),
    };

    // M = LLᵀ makes m = Lᵀ(x − c) a unit vector, so z = b + V*Λ^½L⁻ᵀm: A = L⁻¹ in eq. 11, with Ŝ = Λ^½V*ᵀ.
    let factor = Cholesky::new(metric.matrix).ok_or(Refusal::MetricNotPositiveDefinite)?;
    let indeterminate_shape = SMatrix::<f64, RANK, RANK>::from_diagonal(&deviations) * vectors.transpose();
    let shape =
        factor.l().solve_lower_triangular(&indeterminate_shape).ok_or(Refusal::MetricNotPositiveDefinite)?;
    // The orientation is arbitrary, so it is chosen: rows orthogonal, longest first.
    let principal = symmetric_eigen(&(shape * shape.transpose()))?;
    let orientation = principal.vectors.transpose();
    let shape_counts_per_load = orientation * shape;
    // Across the subspace there is but the bias, and every sample tells it.
    let quiet_from_all = quiet.mean() - vectors.transpose() * all.mean_difference();
    let bias_counts =
        all.mean_counts() + vectors * quiet_from_all + indeterminate_shape.transpose() * metric.centre;

    let to_direction = orientation * factor.l().transpose();
    let central = whitened.without_noise(&whitened_noise).transformed(&to_direction);
    let directions = DirectionMoments::new(to_direction * -metric.centre, &central);
    let mean_of_all = to_direction * (-metric.centre - whitening * quiet_from_all);
    let free_of_noise = SMatrix::<f64, RANK, RANK>::identity() - SMatrix::from_diagonal(&whitened_noise);
    let regressors = Regressors {
        mean: mean_of_all,
        second: to_direction * free_of_noise * to_direction.transpose()
            + mean_of_all * mean_of_all.transpose(),
        samples: all.count(),
    };
    let unexplained =
        if noise_shift.is_some() { metric.unexplained.max(LEAST_UNEXPLAINED) } else { metric.unexplained };
    let mut uncertainty = predict(&directions, &regressors, &principal.values, noise, unexplained, samples)?;
    if let Some(NoiseShift { metric, centre }) = noise_shift {
        uncertainty.add_shift(&(orientation * metric * orientation.transpose()), &(orientation * centre));
    }
    let worst = uncertainty.worst_relative();
    if worst > accepted {
        return Err(does_not_span(worst));
    }

    if shape_counts_per_load.iter().chain(bias_counts.iter()).any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    Ok(TrialSolution {
        shape_counts_per_load,
        bias_counts,
        eigenvalues,
        noise_variance,
        samples,
        unexplained: metric.unexplained,
        directions,
        uncertainty,
    })
}
