//! Refinement of one trial where its recording is at hand (design § 3).
//!
//! The sensor has but moments of degree four, in which every sample of the metric constraint counts the same. Where the sensor is not round
//! that is not the best: in units of the load, a weak direction of the shape is noisier than a strong one, and a sample is
//! worth the less the more of its load points there. Maximum likelihood, the orthogonal fit of the ellipsoid, weighs rightly, but noise lifts
//! points off a curved surface (by σ²/2 times the sum of its curvatures on average) and biases it. The refinement takes the
//! weights of maximum likelihood and the adjusted equation of the sensor, which has no bias whatever the noise:
//!
//! ```text
//! recording ─► outliers ─► directions ─► weight ─► constraint ─► refined, or the start
//!              left out    x = C(z − b)  ≈ 1/v     Σ wφ(|m|² − 1 − φᵀθ) = 0, free of noise
//! ```
//!
//! | module | step |
//! |---|---|
//! | `outliers` | samples that noise does not explain |
//! | `fit` | samples and ellipsoid |
//! | `adjusted` | moments of any degree, free of noise |
//! | `weight` | 1/v as a polynomial |
//! | `constraint` | the weighted constraint, its answer and covariance |
//!
//! RMS error of S over the Cramér–Rao bound, condition 4. The first and the last column are of 1500 trials (`cargo bench -p ftcal-tests
//! --bench efficiency`; at 5 % the last is the first times the ratio measured there); the orthogonal fit, with and without its
//! bias, is of a prototype over 120 trials, scaled to the same start:
//!
//! | | equal weights | orthogonal fit | the same less its bias | this |
//! |---|---|---|---|---|
//! | p = 8, σ = 1 % | 1.070 | 1.00 | 1.00 | 1.002 |
//! | p = 8, σ = 5 % | 1.075 | 1.05 | 1.00 | 1.01 |
//! | p = 6, σ = 5 % | 1.113 | 1.11 | 1.02 | 1.05 |
//!
//! Only the ellipsoid within the subspace of the codes is refined. Across it the shape is a regression on the directions, for which the
//! principal components of the codes are as good as the bound allows, to first order: the constraint says nothing about it.
//!
//! # Never worse than its start
//!
//! Both answers are free of bias, so the one with the lower predicted variance is better, and both variances follow from the same
//! samples. The refinement is taken only where it promises at least a hundredth less squared error; on round sensors, and under
//! disturbances that drown the noise, it promises nothing and the start stays. It stays, too, where the refinement
//! moves farther than the start's own uncertainty allows, because then something is not as the model says. What varies beyond the noise
//! lessens both the weights' spread and what they promise.
//!
//! At p = r nothing tells the noise from disturbances of the load, nor one direction's noise from another's, and so neither
//! weights nor outliers: the start stays. It stays where the rests have shown that the channels are not equally noisy, too, since
//! it takes that into account and the refinement does not.

mod adjusted;
mod constraint;
mod fit;
mod outliers;
#[cfg(test)]
mod tests;
mod weight;

use nalgebra::{Cholesky, DMatrix, DVector};

use self::adjusted::AdjustedSums;
use self::constraint::Answer;
use self::fit::{Fit, Samples, constraint_noise, unit};
use self::outliers::{Screened, screen};
use self::weight::Weight;
use super::coverage::TrialCoverage;
use super::matrix::matrix_of_shape;
use super::samples::{Rejection, SampleCounts};
use super::trial::TrialShape;
use crate::recording::Recording;

/// A direction of the load; at rank 2 the third component is zero.
type Direction = [f64; 3];

/// The least share of the squared error that a refinement must promise to take off.
const LEAST_GAIN: f64 = 0.01;

/// Steps. At given weights the equation is linear; the weights follow the fit, and hardly change with it.
const MOST_ITERATIONS: usize = 10;

/// A step of this many standard deviations, all unknowns together, changes nothing any more: it adds a hundredth of one
/// unknown's variance.
const LAST_STEP: f64 = 0.1;

/// x of the bound in `outliers`: one good trial in a million moves farther.
const UNBELIEVABLE: f64 = 13.8;

/// A trial, refined where that serves it.
#[derive(Clone, Debug, PartialEq)]
pub struct Refinement {
    /// The refined trial, or the start.
    pub trial: TrialShape,
    /// Which, and why.
    pub outcome: Outcome,
}

/// What became of a refinement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The trial is refined.
    Refined {
        /// Steps until nothing changed.
        iterations: usize,
        /// Samples left out.
        outliers: usize,
        /// Predicted RMS error of the shape over that of equal weights.
        error_ratio: f64,
    },
    /// The trial is what it was.
    KeptStart(Kept),
}

/// Why a start stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// The recording is not that of the trial.
    OtherRecording,
    /// p = r, or no noise: nothing tells weights and outliers.
    NoiseUnknown,
    /// The channels are not equally noisy: the start weighs them, the refinement would not.
    ChannelsDiffer,
    /// No other weights promise anything.
    NothingToGain,
    /// So many samples contradict the trial that they are no outliers.
    TooManyOutliers,
    /// The weighted samples do not determine the answer.
    NotDetermined,
    /// The steps did not become small.
    NotConverged,
    /// The refined answer is farther off than the uncertainty of the start allows.
    Contradiction,
}

/// Whether trials are refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refining {
    /// Where that is better.
    On,
    /// The answer is the sensor's own.
    Off,
}

impl Refining {
    /// The trial of this recording as it is to be used.
    pub fn of(self, recording: &Recording, start: TrialShape) -> TrialShape {
        match self {
            Self::On => refine(recording, &start).trial,
            Self::Off => start,
        }
    }
}

/// Refines a trial of this recording.
pub fn refine(recording: &Recording, start: &TrialShape) -> Refinement {
    match refined(recording, start) {
        Ok(refinement) => refinement,
        Err(kept) => Refinement { trial: start.clone(), outcome: Outcome::KeptStart(kept) },
    }
}

fn refined(recording: &Recording, start: &TrialShape) -> Result<Refinement, Kept> {
    if start.gages() != recording.gages() || start.taken.len() != recording.len() {
        return Err(Kept::OtherRecording);
    }
    let noise = start.noise_counts.filter(|&noise| noise > 0.0).ok_or(Kept::NoiseUnknown)?;
    if start.gages() == start.rank() {
        return Err(Kept::NoiseUnknown);
    }
    if !start.covariance.channels_are_equal() {
        return Err(Kept::ChannelsDiffer);
    }
    let fit = Fit::new(&start.shape_counts_per_load, start.bias_counts.clone(), noise * noise);
    let samples = Samples::of(recording, &start.taken);
    let screened = screen(samples, fit, recording.quantisation().counts_per_code())?;
    let Weighted { fit, answer, iterations, error_ratio } = weighted(&screened)?;
    let along = answer.along();
    let across = if screened.outliers == 0 {
        carried_across(start, &fit)?
    } else {
        regression(&screened.samples, &fit)?
    };
    let covariance = start.covariance.with(along, across);
    let trial = TrialShape {
        samples: counts(&start.samples, screened.outliers),
        taken: taken(recording.len(), &screened.samples),
        eigenvalues: screened.eigenvalues.unwrap_or_else(|| start.eigenvalues.clone()),
        noise_counts: Some(fit.noise_variance.sqrt()),
        quietest_noise_counts: start.quietest_noise_counts,
        bias_counts: fit.bias,
        shape_counts_per_load: fit.shape,
        coverage: TrialCoverage {
            worst_relative_uncertainty: covariance.gain_deviation().max(covariance.bias_deviation()),
            ..start.coverage.clone()
        },
        covariance,
    };
    let outcome = Outcome::Refined { iterations, outliers: screened.outliers, error_ratio };
    Ok(Refinement { trial, outcome })
}

/// A fit that weights have moved to where it stays.
struct Weighted {
    fit: Fit,
    answer: Answer,
    iterations: usize,
    error_ratio: f64,
}

fn weighted(screened: &Screened) -> Result<Weighted, Kept> {
    let Screened { samples, outliers, .. } = screened;
    let mut fit = screened.fit.clone();
    let (equal, likelihood) = answers(samples, &fit)?;
    let gains = fit.gains_squared();
    let ratio = likelihood.squared_error(&gains) / equal.squared_error(&gains);
    let gains_enough = ratio <= 1.0 - LEAST_GAIN;
    if *outliers == 0 {
        if !gains_enough {
            return Err(Kept::NothingToGain);
        }
        require_believable(&likelihood.theta, &equal)?;
    }
    let (mut share, mut last) = (1.0, f64::INFINITY);
    for iterations in 1..=MOST_ITERATIONS {
        let (equal, likelihood) = answers(samples, &fit)?;
        let (answer, error_ratio) = if gains_enough { (likelihood, ratio.sqrt()) } else { (equal, 1.0) };
        let step = answer.squared_deviations(&answer.theta).ok_or(Kept::NotDetermined)?;
        if step <= LAST_STEP * LAST_STEP {
            return Ok(Weighted { fit, answer, iterations, error_ratio });
        }
        // Steps that hardly shrink go to and fro across the answer.
        if step > last / 4.0 {
            share /= 2.0;
        }
        last = step;
        fit = fit.corrected(&answer, share).ok_or(Kept::NotDetermined)?;
    }
    Err(Kept::NotConverged)
}

/// The answers with equal weights and with those of the likelihood, about this fit.
fn answers(samples: &Samples, fit: &Fit) -> Result<(Answer, Answer), Kept> {
    let directions = fit.directions(samples);
    let units = unit(&directions);
    let variances = fit.direction_variances();
    let noise = constraint_noise(&directions, &units, variances);
    let sums = AdjustedSums::of(&directions, variances, fit.rank());
    let answer =
        |weight: &Weight| Answer::of(&sums, &units, &noise, weight, fit.rank()).ok_or(Kept::NotDetermined);
    let likelihood = Weight::of_likelihood(&noise, &units).ok_or(Kept::NoiseUnknown)?;
    Ok((answer(&Weight::equal())?, answer(&likelihood)?))
}

/// The step from the start is of the order of the start's own uncertainty.
fn require_believable(step: &DVector<f64>, start: &Answer) -> Result<(), Kept> {
    let freedom = step.len() as f64;
    let farthest = freedom + 2.0 * (freedom * UNBELIEVABLE).sqrt() + 2.0 * UNBELIEVABLE;
    let moved = start.squared_deviations(step).ok_or(Kept::NotDetermined)?;
    if moved <= farthest { Ok(()) } else { Err(Kept::Contradiction) }
}

/// The start's covariance across the shape, of the regression on (m, 1), for the directions of the refined fit: all samples
/// that gave the subspace still do. With S' = MS and b' = b + Sᵀk, the regression is [S'; b'] = [M 0; kᵀ 1] [S; b].
fn carried_across(start: &TrialShape, fit: &Fit) -> Result<DMatrix<f64>, Kept> {
    let rank = fit.rank();
    let matrix = matrix_of_shape(&start.shape_counts_per_load).map_err(|_| Kept::NotDetermined)?;
    let shift = &matrix * (&fit.bias - &start.bias_counts);
    let mut carry = DMatrix::identity(rank + 1, rank + 1);
    carry.view_mut((0, 0), (rank, rank)).copy_from(&(&fit.shape * matrix.transpose()));
    carry.view_mut((rank, 0), (1, rank)).copy_from(&shift.transpose());
    Ok(&carry * start.covariance.across() * carry.transpose())
}

/// The covariance across the shape from these samples: σ² (Σ (m, 1)(m, 1)ᵀ)⁻¹, free of noise.
fn regression(samples: &Samples, fit: &Fit) -> Result<DMatrix<f64>, Kept> {
    let rank = fit.rank();
    let variances = fit.direction_variances();
    let mut normal = DMatrix::zeros(rank + 1, rank + 1);
    for m in fit.directions(samples) {
        let regressor = DVector::from_fn(rank + 1, |a, _| if a < rank { m[a] } else { 1.0 });
        normal.ger(1.0, &regressor, &regressor, 1.0);
    }
    for a in 0..rank {
        normal[(a, a)] -= samples.len() as f64 * variances[a];
    }
    Ok(Cholesky::new(normal).ok_or(Kept::NotDetermined)?.inverse() * fit.noise_variance)
}

fn counts(start: &SampleCounts, outliers: usize) -> SampleCounts {
    let mut counts = start.clone();
    if outliers > 0 {
        counts.used = counts.used.saturating_sub(outliers as u64);
        counts.rejected.insert(Rejection::Outlier, outliers as u64);
    }
    counts
}

/// Which samples of a recording these are.
fn taken(recorded: usize, samples: &Samples) -> Vec<bool> {
    let mut taken = vec![false; recorded];
    for &number in &samples.numbers {
        taken[number] = true;
    }
    taken
}
