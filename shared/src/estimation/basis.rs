//! The basis of the motion: the p×p eigenproblem that stands in for the SVD of Z (eq. 7–9, design § 3.1).
//!
//! The right singular vectors of the centred measurement matrix Z are the eigenvectors of its covariance, and its
//! squared singular values are n times the eigenvalues. The first r of them span the motion; the mean of the other
//! p − r is the noise variance, free of charge.
//!
//! Where the channels' noise is known to differ (design § 3.1), with the covariance R = LLᵀ relative to its mean, all this is
//! done with the codes L⁻¹z, in which it does not. The coordinates of the motion are then y = V*ᵀL⁻¹(z − z̄), and the codes
//! that belong to them z̄ + LV*y.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::coordinates::{MotionMatrix, MotionVector, vector};
use super::eigen::symmetric_eigen;
use super::rest_noise::ChannelNoise;
use crate::refusal::Refusal;
use crate::units::{MAX_RANK, Rank};

/// The least ratio between the r-th and the (r+1)-th eigenvalue that counts as a clear gap.
///
/// Noise alone spreads its own eigenvalues by (1 + √(p/n))² / (1 − √(p/n))², 2.1 at p = 8 and n = 250; a ratio of 10
/// is never reached by noise, and is passed by an ill-shaped sensor (condition 4) at 5 % noise, where it is about 50.
const LEAST_GAP: f64 = 10.0;

/// The most that the first redundant eigenvalue may exceed the second before it is no noise. The noise of channels may
/// differ, but not by ten times in amplitude.
const LARGEST_REDUNDANT_RATIO: f64 = 100.0;

/// The largest share, in amplitude, of a direction beyond the rank that a linear sensor may have: a sensor that is linear
/// to a hundredth. Below it, an error of the answer is that small, too.
const LARGEST_EXCESS_SHARE: f64 = 0.01;

/// How far apart the variance at rest and the redundant eigenvalues may be, as a factor, if both show the channels' noise.
const LARGEST_NOISE_EXCESS: f64 = 2.0;

/// The least r-th eigenvalue, relative to the first, that counts as a direction of its own.
///
/// Where one direction's signal is κ times weaker than another's, its moment of degree four is κ⁴ times smaller and
/// drowns in the rounding of the sums (about 10⁻⁸). This bound is κ = 32, a relative error of 1 %; a sensor's
/// shape is rounder than that, and motion in a plane is not.
const LEAST_RELATIVE_EIGENVALUE: f64 = 1e-3;

/// The rank-r subspace of the codes in which the motion takes place. Columns beyond the rank are zero.
#[derive(Clone, Debug)]
pub struct Basis<const GAGES: usize> {
    /// r.
    pub rank: Rank,
    /// L⁻ᵀV* (p × r): its transpose takes codes to the coordinates of the motion. Where all channels are equally noisy, it is
    /// the first r eigenvectors, V* of eq. 8 (orthonormal columns, each with its largest element positive).
    pub projection: SMatrix<f64, GAGES, MAX_RANK>,
    /// LV* (p × r): takes the coordinates of the motion to codes.
    pub embedding: SMatrix<f64, GAGES, MAX_RANK>,
    /// Variances of the coordinates (r), descending, counts².
    pub variances: MotionVector,
    /// All eigenvalues of the covariance of the codes, descending, counts².
    pub eigenvalues: SVector<f64, GAGES>,
    /// The variance of the noise, counts², the mean over the channels: from the redundant eigenvalues; at p = r, from the rests,
    /// and `None` where there were none.
    pub noise_variance: Option<f64>,
    /// Variance of the rounding to codes, counts².
    pub rounding: f64,
    /// R (p × p), over the mean of its diagonal.
    pub relative_noise: SMatrix<f64, GAGES, GAGES>,
}

impl<const GAGES: usize> Basis<GAGES> {
    /// Λ^-½ (r × r), which makes the coordinates of the motion white.
    pub(super) fn whitening(&self) -> MotionMatrix {
        MotionMatrix::from_diagonal(&vector(self.rank, |axis| 1.0 / libm::sqrt(self.variances[axis])))
    }

    /// The variance of the noise of a channel, counts²: where nothing tells it, there is at least the rounding.
    pub(super) fn noise(&self) -> f64 {
        self.noise_variance.unwrap_or(self.rounding)
    }

    /// What the noise has across the subspace (p × p), over that of a channel.
    #[inline(never)]
    pub(super) fn redundant_noise(&self) -> SMatrix<f64, GAGES, GAGES> {
        self.relative_noise - self.embedding * self.embedding.transpose()
    }
}

/// Finds the basis of the motion from the covariance of the codes (p × p, counts²) of `samples` samples, whose channels have
/// this noise as far as it is known.
///
/// # Errors
///
/// [`Refusal::UnsupportedDimensions`] for a rank above the number of gages;
/// [`Refusal::NonFinite`]; [`Refusal::RankNotReached`] where the codes span fewer than r directions;
/// [`Refusal::NoEigenvalueGap`] where the r-th direction cannot be told from noise; [`Refusal::RankExceeded`] where a
/// further direction is no noise: a rank that is too low, a channel that clips, a sensor that is not linear.
pub fn basis<const GAGES: usize>(
    rank: Rank,
    covariance: &SMatrix<f64, GAGES, GAGES>,
    samples: u64,
    noise: &ChannelNoise<GAGES>,
) -> Result<Basis<GAGES>, Refusal> {
    match basis_of_white_codes(rank, covariance, samples, noise) {
        Some(Ok(basis)) => Ok(basis),
        None | Some(Err(_)) => basis_of_equal_channels(rank, covariance, samples, noise),
    }
}

/// The basis found in the codes L⁻¹z; `None` where the channels are not known to differ, or what the redundant directions show is
/// not their noise.
#[inline(never)]
fn basis_of_white_codes<const GAGES: usize>(
    rank: Rank,
    covariance: &SMatrix<f64, GAGES, GAGES>,
    samples: u64,
    noise: &ChannelNoise<GAGES>,
) -> Option<Result<Basis<GAGES>, Refusal>> {
    let at_rest = noise.variance.filter(|_| !noise.is_equal())?;
    let factor = lower_factor(&noise.relative)?;
    let white = whitened(covariance, &factor);
    let mut outcome = basis_of_equal_channels(rank, white.as_ref()?, samples, noise);
    // Changed where it stands: taken out, it would stand on the stack twice.
    let Ok(found) = outcome.as_mut() else { return Some(outcome) };
    let ratio = found.noise_variance? / at_rest;
    if !(1.0 / LARGEST_NOISE_EXCESS..=LARGEST_NOISE_EXCESS).contains(&ratio) {
        return None;
    }
    colour(found, &factor)?;
    found.relative_noise = noise.relative;
    match eigenvalues_of(covariance) {
        Ok(of_codes) => found.eigenvalues = of_codes,
        Err(refusal) => return Some(Err(refusal)),
    }
    Some(outcome)
}

/// L of LLᵀ = R. A function of its own, as are the other steps here: the sensor's stack is small.
#[inline(never)]
fn lower_factor<const GAGES: usize>(
    relative: &SMatrix<f64, GAGES, GAGES>,
) -> Option<SMatrix<f64, GAGES, GAGES>> {
    Cholesky::new(*relative).map(|factor| factor.l())
}

/// Takes a basis of whitened codes back to the codes themselves.
#[inline(never)]
fn colour<const GAGES: usize>(found: &mut Basis<GAGES>, factor: &SMatrix<f64, GAGES, GAGES>) -> Option<()> {
    found.projection = factor.tr_solve_lower_triangular(&found.projection)?;
    found.embedding = factor * found.embedding;
    Some(())
}

/// All eigenvalues of the covariance, descending.
#[inline(never)]
fn eigenvalues_of<const GAGES: usize>(
    covariance: &SMatrix<f64, GAGES, GAGES>,
) -> Result<SVector<f64, GAGES>, Refusal> {
    symmetric_eigen(covariance, GAGES).map(|eigen| not_negative(&eigen.values))
}

/// The covariance has no negative eigenvalue; rounding may give it one.
fn not_negative<const GAGES: usize>(eigenvalues: &SVector<f64, GAGES>) -> SVector<f64, GAGES> {
    eigenvalues.map(|eigenvalue| eigenvalue.max(0.0))
}

/// The covariance of L⁻¹z (p × p).
#[inline(never)]
fn whitened<const GAGES: usize>(
    covariance: &SMatrix<f64, GAGES, GAGES>,
    factor: &SMatrix<f64, GAGES, GAGES>,
) -> Option<SMatrix<f64, GAGES, GAGES>> {
    let halfway = factor.solve_lower_triangular(covariance)?;
    factor.solve_lower_triangular(&halfway.transpose())
}

/// The basis where R is the identity.
#[inline(never)]
fn basis_of_equal_channels<const GAGES: usize>(
    rank: Rank,
    covariance: &SMatrix<f64, GAGES, GAGES>,
    samples: u64,
    noise: &ChannelNoise<GAGES>,
) -> Result<Basis<GAGES>, Refusal> {
    let directions = rank.count();
    if directions > GAGES {
        return Err(Refusal::UnsupportedDimensions { gages: small(GAGES), rank: small(directions) });
    }
    let eigen = symmetric_eigen(covariance, GAGES)?;
    let eigenvalues = not_negative(&eigen.values);

    let floor = (eigenvalues[0] * LEAST_RELATIVE_EIGENVALUE).max(noise.rounding);
    let spanned = eigenvalues.iter().take_while(|&&eigenvalue| eigenvalue > floor).count();
    if spanned < directions {
        return Err(Refusal::RankNotReached { have: small(spanned), need: small(directions) });
    }
    let weakest = eigenvalues[directions - 1];
    if GAGES > directions {
        let ratio = weakest / eigenvalues[directions].max(noise.rounding);
        if ratio < LEAST_GAP {
            #[expect(clippy::cast_possible_truncation, reason = "a report of three digits")]
            return Err(Refusal::NoEigenvalueGap { ratio: ratio as f32, need: LEAST_GAP as f32 });
        }
    }
    if GAGES > directions + 1 {
        let (excess, next) = (eigenvalues[directions], eigenvalues[directions + 1].max(noise.rounding));
        let share = libm::sqrt(excess / weakest);
        if excess > LARGEST_REDUNDANT_RATIO * next && share > LARGEST_EXCESS_SHARE {
            #[expect(clippy::cast_possible_truncation, reason = "a report of three digits")]
            return Err(Refusal::RankExceeded { share: share as f32, limit: LARGEST_EXCESS_SHARE as f32 });
        }
    }
    // A load that jumps about from sample to sample has no rests, whatever they look like: noise stands below the signal.
    let at_rest = noise.variance.filter(|variance| LEAST_GAP * variance <= weakest);
    let mut spanning = SMatrix::<f64, GAGES, MAX_RANK>::zeros();
    for axis in rank.axes() {
        spanning.set_column(axis, &eigen.vectors.column(axis));
    }
    Ok(Basis {
        rank,
        projection: spanning,
        embedding: spanning,
        variances: vector(rank, |axis| eigenvalues[axis]),
        noise_variance: redundant_variance(rank, &eigenvalues, samples).or(at_rest),
        eigenvalues,
        rounding: noise.rounding,
        relative_noise: SMatrix::identity(),
    })
}

/// The mean of the redundant eigenvalues. The covariance has divisor n and a mean estimated from the same samples, and
/// r directions are fitted besides, which take (r + 1) of n degrees of freedom from every residual.
fn redundant_variance<const GAGES: usize>(
    rank: Rank,
    eigenvalues: &SVector<f64, GAGES>,
    samples: u64,
) -> Option<f64> {
    let redundant = GAGES.checked_sub(rank.count()).filter(|&count| count > 0)?;
    let sum: f64 = eigenvalues.iter().skip(rank.count()).sum();
    let samples = samples as f64;
    let fitted = (rank.count() + 1) as f64;
    let unbiased = if samples > 2.0 * fitted { samples / (samples - fitted) } else { 1.0 };
    Some(unbiased * sum / redundant as f64)
}

/// Dimensions are at most 12.
#[expect(clippy::cast_possible_truncation, reason = "dimensions are at most 12")]
const fn small(dimension: usize) -> u8 {
    dimension as u8
}
