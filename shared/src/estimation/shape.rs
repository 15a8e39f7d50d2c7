//! Shape and bias of one trial: the whole of the paper's figure 2 up to the known loads (eq. 10, 11, design § 3).

use nalgebra::{SMatrix, SVector};

use super::basis::{Basis, basis};
use super::code_sums::CodeMean;
use super::coordinates::{MotionMatrix, MotionVector, carried, cholesky, product, vector};
use super::directions::DirectionMoments;
use super::eigen::symmetric_eigen;
use super::metric::{
    LARGEST_RELATIVE_UNCERTAINTY, LEAST_UNEXPLAINED, Metric, NoiseShift, does_not_span, metric,
    require_indifference_to_noise,
};
use super::moments::Moments;
use super::projection::{MotionSums, project};
use super::rest_noise::ChannelNoise;
use super::uncertainty::{Regressors, TrialUncertainty, predict};
use crate::refusal::Refusal;
use crate::units::{MAX_RANK, Rank};

/// What disturbs the load's magnitude, or seems to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Disturbances {
    /// As many samples share one as there are samples to one of these.
    pub(crate) number: u64,
    /// The variance of |m|² that they have at least, whether it shows or not.
    pub(crate) least: f64,
}

/// Standard deviations of the unexplained variance that are chance.
const LARGEST_CHANCE: f64 = 4.0;

/// Samples that a disturbance lasts at most: as many as a second has at the usual rates.
const LONGEST_DISTURBANCE: f64 = 1000.0;

/// What one trial tells: the sensor's shape for a load at that trial's moment arm, in an arbitrary orientation. What lies beyond
/// the rank is zero.
#[derive(Clone, Debug)]
pub struct TrialSolution<const GAGES: usize> {
    /// r.
    pub rank: Rank,
    /// S (r × p), counts per unit load, so that z = b + Sᵀm with |m| = 1. Known up to a rotation and a mirror image; its
    /// rows are made orthogonal, longest first.
    pub shape_counts_per_load: SMatrix<f64, MAX_RANK, GAGES>,
    /// b (p), counts: the codes with no load.
    pub bias_counts: SVector<f64, GAGES>,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: SVector<f64, GAGES>,
    /// Variance of the noise of one channel, counts²; the mean over the channels; `None` where p = r leaves
    /// no redundant eigenvalue to tell it, and no rest does.
    pub noise_variance: Option<f64>,
    /// Samples that took part.
    pub samples: u64,
    /// Variance of |m|² that the noise does not explain.
    pub unexplained: f64,
    /// C (r × p), per unit load: the load m = C(z − b) of a sample, by least squares weighted by the channels' noise.
    pub to_load: SMatrix<f64, MAX_RANK, GAGES>,
    /// Covariance of the noise of that load (r × r).
    pub load_noise: MotionMatrix,
    /// Covariance of the noise that remains, (I − SᵀC)e, over [`noise_variance`](Self::noise_variance) (p × p): where all
    /// channels are equally noisy, the projection onto the redundant directions of the codes.
    pub redundant_noise: SMatrix<f64, GAGES, GAGES>,
    /// Where the load has been, in the orientation of the shape.
    pub directions: DirectionMoments,
    /// How well shape and bias are known.
    pub uncertainty: TrialUncertainty,
}

/// Shape and bias, and what their uncertainty is predicted from. The rest of a [`TrialSolution`] follows from it and is as large again, and
/// the sensor's stack is small.
#[derive(Clone, Debug)]
pub(crate) struct Fit<const GAGES: usize> {
    shape_counts_per_load: SMatrix<f64, MAX_RANK, GAGES>,
    bias_counts: SVector<f64, GAGES>,
    samples: u64,
    /// Variance of |m|² that the noise does not explain.
    pub(crate) unexplained: f64,
    /// By how much unknown noise may have moved the constraint, in the orientation of the shape.
    noise_shift: Option<NoiseShift>,
    /// Takes the coordinates of the motion, in counts, to the load.
    from_coordinates: MotionMatrix,
    load_noise: MotionMatrix,
    directions: DirectionMoments,
    regressors: Regressors,
}

/// The fewest samples a trial of this rank needs: twice the unknowns of the metric constraint, since fewer fit exactly
/// whatever the motion was.
pub const fn least_samples(rank: Rank) -> u64 {
    let rank = rank.count();
    (rank * (rank + 1) + 2 * rank) as u64
}

/// Solves one trial from its settled moments, of a converter whose steps are whole codes and of whose noise nothing is known.
///
/// # Errors
///
/// [`Refusal::TooFewSamples`], and every refusal of [`basis`] and [`metric`].
pub fn solve_trial<const GAGES: usize, const HIGHER: usize>(
    moments: &Moments<GAGES, HIGHER>,
    rank: Rank,
) -> Result<TrialSolution<GAGES>, Refusal> {
    require_samples(moments.count(), rank)?;
    let noise = ChannelNoise::unknown(1);
    let subspace = basis(rank, &moments.codes().covariance(), moments.count(), &noise)?;
    let quiet = project(moments, &subspace.projection, rank);
    let disturbances = Disturbances { number: moments.count(), least: 0.0 };
    let all = moments.codes().mean();
    let found = fit(&subspace, &all, &quiet, LARGEST_RELATIVE_UNCERTAINTY)?;
    let uncertainty = uncertainty(&subspace, &found, disturbances, LARGEST_RELATIVE_UNCERTAINTY)?;
    Ok(solution(&subspace, &found, &uncertainty))
}

/// A trial of too few samples is refused.
pub(crate) const fn require_samples(samples: u64, rank: Rank) -> Result<(), Refusal> {
    if samples < least_samples(rank) {
        return Err(Refusal::TooFewSamples { have: samples, need: least_samples(rank) });
    }
    Ok(())
}

/// Fits shape and bias of one trial within the subspace that `all` of its samples, of which this is the mean, have given; the metric
/// constraint is taken from the `quiet` ones among them, as projected onto that subspace. For `accepted` see [`metric`].
///
/// # Errors
///
/// [`Refusal::TooFewSamples`], every refusal of [`metric`].
#[inline(never)]
pub(crate) fn fit<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    all: &CodeMean<GAGES>,
    quiet: &MotionSums,
    accepted: f64,
) -> Result<Fit<GAGES>, Refusal> {
    require_samples(quiet.samples(), subspace.rank)?;
    let (metric, noise_shift) = constraint(subspace, quiet, accepted)?;
    fit_to(subspace, all, quiet, &metric, noise_shift)
}

/// Shape and bias by the metric (eq. 11).
#[inline(never)]
fn fit_to<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    all: &CodeMean<GAGES>,
    quiet: &MotionSums,
    metric: &Metric,
    noise_shift: Option<NoiseShift>,
) -> Result<Fit<GAGES>, Refusal> {
    let Basis { rank, projection, embedding, variances, .. } = subspace;
    let rank = *rank;
    // M = LLᵀ makes m = Lᵀ(x − c) a unit vector, so z = b + VΛ^½L⁻ᵀm, V being the embedding: A = L⁻¹ in eq. 11, with
    // Ŝ = Λ^½Vᵀ.
    let factor = cholesky(&metric.matrix, rank).ok_or(Refusal::MetricNotPositiveDefinite)?;
    let indeterminate_shape = MotionMatrix::from_diagonal(&variances.map(libm::sqrt)) * embedding.transpose();
    let shape =
        factor.l().solve_lower_triangular(&indeterminate_shape).ok_or(Refusal::MetricNotPositiveDefinite)?;
    // The orientation is arbitrary, so it is chosen: rows orthogonal, longest first.
    let principal = symmetric_eigen(&(shape * shape.transpose()), rank.count())?;
    let orientation = principal.vectors.transpose();
    let shape_counts_per_load = orientation * shape;
    // Across the subspace there is but the bias, and every sample tells it.
    let quiet_from_all = quiet.mean() - projection.transpose() * all.from_pivot;
    let bias_counts =
        all.counts + embedding * quiet_from_all + indeterminate_shape.transpose() * metric.centre;
    if shape_counts_per_load.iter().chain(bias_counts.iter()).any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }

    let to_direction = product(&orientation, &factor.l().transpose());
    let whitening = subspace.whitening();
    let from_coordinates = product(&to_direction, &whitening);
    let whitened_noise = vector(rank, |axis| subspace.noise() / variances[axis]);
    let load_noise = carried(&to_direction, &MotionMatrix::from_diagonal(&whitened_noise));
    let directions =
        directions(rank, quiet, &from_coordinates, &(to_direction * -metric.centre), &load_noise);
    let mean_of_all = to_direction * (-metric.centre - whitening * quiet_from_all);
    // Whitened, the variances are one, noise included.
    let free_of_noise = product(&to_direction, &to_direction.transpose()) - load_noise;
    let regressors = Regressors {
        mean: mean_of_all,
        second: free_of_noise + mean_of_all * mean_of_all.transpose(),
        samples: all.samples,
    };
    Ok(Fit {
        shape_counts_per_load,
        bias_counts,
        samples: quiet.samples(),
        unexplained: metric.unexplained,
        noise_shift: noise_shift.map(|NoiseShift { metric, centre }| NoiseShift {
            metric: carried(&orientation, &metric),
            centre: orientation * centre,
        }),
        from_coordinates,
        load_noise,
        directions,
        regressors,
    })
}

/// How well a fit is known.
///
/// # Errors
///
/// [`Refusal::MotionDoesNotSpan`] where any coefficient is more uncertain than `accepted`, and every refusal of [`predict`].
#[inline(never)]
pub(crate) fn uncertainty<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    found: &Fit<GAGES>,
    disturbances: Disturbances,
    accepted: f64,
) -> Result<TrialUncertainty, Refusal> {
    let Fit { samples, noise_shift, load_noise, directions, regressors, .. } = found;
    let least = if noise_shift.is_some() { LEAST_UNEXPLAINED } else { 0.0 };
    let unexplained = found.unexplained.max(least);
    let unexplained = unexplained + lasting(subspace.rank, unexplained, load_noise, *samples, disturbances);
    let mut predicted = predict(directions, regressors, load_noise, subspace.noise(), unexplained, *samples);
    if let Ok(uncertainty) = &mut predicted {
        if let Some(NoiseShift { metric, centre }) = noise_shift {
            uncertainty.add_shift(metric, centre);
        }
        // A cap of directions may determine the principal values of the constraint, and leave the bias and a gain to trade places.
        let worst = uncertainty.worst_relative();
        if worst > accepted {
            return Err(does_not_span(worst));
        }
    }
    predicted
}

/// The whole solution. Never inlined, so that it is made where it is to be.
#[inline(never)]
pub(crate) fn solution<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    found: &Fit<GAGES>,
    uncertainty: &TrialUncertainty,
) -> TrialSolution<GAGES> {
    TrialSolution {
        rank: subspace.rank,
        shape_counts_per_load: found.shape_counts_per_load,
        bias_counts: found.bias_counts,
        eigenvalues: subspace.eigenvalues,
        noise_variance: subspace.noise_variance,
        samples: found.samples,
        unexplained: found.unexplained,
        to_load: found.from_coordinates * subspace.projection.transpose(),
        load_noise: found.load_noise,
        redundant_noise: subspace.redundant_noise(),
        directions: found.directions.clone(),
        uncertainty: uncertainty.clone(),
    }
}

/// What is to be added to the variance of |m|² per sample for disturbances of the magnitude that last, so that it may be divided by
/// the number of samples like noise: a hand leans on the load, or the load swings, for much longer than a sample. There are
/// no more of them than there are rests and movements.
///
/// Only what is more than chance counts: of n samples with the variance v̄ from noise and u beyond it, u itself is known to
/// √(2/n)·(v̄ + u). But there is the least that is told.
///
/// Few disturbances are fitted rather than seen: of d of them, k unknowns of the constraint leave the share (d − k)/d in what remains,
/// were it fitted to them alone. It is fitted to samples, in which each comes with many places, and what is fitted that way shows
/// even less: 2k in place of k is what agrees with simulated hands, of whose trials of 20 s and more the worst error of six lies
/// within three of the standard deviations that come of it in nine cases of ten.
fn lasting(
    rank: Rank,
    unexplained: f64,
    load_noise: &MotionMatrix,
    samples: u64,
    Disturbances { number, least }: Disturbances,
) -> f64 {
    let samples = samples.max(1) as f64;
    let of_noise = 4.0 * load_noise.trace() / rank.count() as f64 + 2.0 * load_noise.norm_squared();
    let chance = libm::sqrt(2.0 / samples) * (of_noise + unexplained);
    let beyond_chance = (unexplained - LARGEST_CHANCE * chance).max(least);
    let longest = (samples / number.max(1) as f64).clamp(1.0, LONGEST_DISTURBANCE);
    let number = samples / longest;
    let unknowns = (rank.count() * (rank.count() + 1) / 2 + rank.count()) as f64;
    let seen = (number - 2.0 * unknowns).max(1.0) / number;
    beyond_chance * (longest / seen - 1.0).max(0.0)
}

/// The metric constraint in whitened coordinates. Never inlined, nor is [`directions`]: moments up to degree four are large, and the
/// sensor's stack is not.
#[inline(never)]
fn constraint<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    quiet: &MotionSums,
    accepted: f64,
) -> Result<(Metric, Option<NoiseShift>), Refusal> {
    let whitened = quiet.central().transformed(&subspace.whitening());
    let (rank, variances, samples) = (subspace.rank, &subspace.variances, quiet.samples());
    let metric = metric(rank, &whitened, variances, subspace.noise(), samples, accepted)?;
    let noise_shift = match subspace.noise_variance {
        Some(_) => None,
        None => Some(require_indifference_to_noise(rank, &whitened, variances, &metric, samples, accepted)?),
    };
    Ok((metric, noise_shift))
}

/// Where the load has been: `to_direction` (r × r) takes the coordinates of the motion to directions, `mean` is their mean
/// and `noise` the covariance of their noise.
#[inline(never)]
fn directions(
    rank: Rank,
    quiet: &MotionSums,
    to_direction: &MotionMatrix,
    mean: &MotionVector,
    noise: &MotionMatrix,
) -> DirectionMoments {
    let central = quiet.central().transformed(to_direction).without_noise(noise);
    DirectionMoments::new(rank, *mean, &central)
}
