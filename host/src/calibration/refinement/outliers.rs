//! Samples that noise does not explain: a glitch in one channel, a bumped load.
//!
//! Of each sample, the codes across the shape should be noise, and the length of the direction one. Standardised, the squares of these
//! p − r + 1 numbers add up to a χ². By Laurent and Massart (*Adaptive estimation of a quadratic functional by model selection*, lemma 1)
//!
//! ```text
//! P(χ²_k ≥ k + 2√(kx) + 2x) ≤ e⁻ˣ
//! ```
//!
//! so that x = ln(n / 0.01) leaves out some good sample of n in at most one trial of a hundred, and then one. What that costs in
//! efficiency is nothing that could be measured. The direction's length is not quite Gaussian: |e|² makes its upper tail heavier. The bound
//! is a third above the true quantile, which is room enough at 5 % noise (a test counts).
//!
//! Standard deviations are from medians, which a few per cent of outliers hardly move; those across the shape for each
//! principal direction of the residuals by itself, because the noise of channels may differ. Outliers have pulled at the fit, too: it is
//! found again without them, and they without it, until nothing changes.

use ftcal_shared::estimation::rest_noise::QUANTISATION_VARIANCE;
use nalgebra::{DMatrix, DVector};

use super::adjusted::AdjustedSums;
use super::constraint::Answer;
use super::fit::{Fit, Samples, constraint_noise, magnitude_errors, unit};
use super::weight::{ConstraintNoise, Weight};
use super::{Direction, Kept};
use crate::calibration::singular::Singular;

/// How many trials of a hundred, at most, lose a good sample.
const LOST_TRIALS: f64 = 0.01;

/// More samples than this share are no outliers: the load, or the sensor, is not what it should be.
const LARGEST_SHARE: f64 = 0.1;

/// Rounds of finding the fit without the outliers, and the outliers without the fit.
const MOST_ROUNDS: usize = 20;

/// The median of χ²₁.
const MEDIAN_SQUARE: f64 = 0.454_936;

/// A trial without its outliers.
#[derive(Clone, Debug)]
pub(super) struct Screened {
    /// What is left.
    pub(super) samples: Samples,
    /// Fitted to that.
    pub(super) fit: Fit,
    /// What was left out.
    pub(super) outliers: usize,
    /// The eigenvalues of the covariance of what is left, counts², where something was left out.
    pub(super) eigenvalues: Option<DVector<f64>>,
}

/// Leaves the outliers out; without any, the fit stays as it is.
pub(super) fn screen(samples: Samples, start: Fit, counts_per_code: f64) -> Result<Screened, Kept> {
    let mut fit = start;
    let mut keep = vec![true; samples.len()];
    let mut left = None;
    for _ in 0..MOST_ROUNDS {
        let now = inliers(&samples, &fit, counts_per_code);
        let outliers = now.iter().filter(|&&keep| !keep).count();
        if outliers as f64 > LARGEST_SHARE * samples.len() as f64 {
            return Err(Kept::TooManyOutliers);
        }
        if now == keep {
            return Ok(match left {
                None => Screened { samples, fit, outliers: 0, eigenvalues: None },
                Some((rest, eigenvalues)) => {
                    Screened { samples: rest, fit, outliers, eigenvalues: Some(eigenvalues) }
                }
            });
        }
        keep = now;
        let rest = samples.only(&keep);
        let (again, eigenvalues) = fitted(&rest, &fit).ok_or(Kept::NotDetermined)?;
        fit = again;
        left = Some((rest, eigenvalues));
    }
    Err(Kept::NotConverged)
}

/// Which samples the noise explains.
fn inliers(samples: &Samples, fit: &Fit, counts_per_code: f64) -> Vec<bool> {
    let directions = fit.directions(samples);
    let redundant = redundant_coordinates(samples, fit, &directions);
    let least = QUANTISATION_VARIANCE * counts_per_code * counts_per_code;
    let variances: Vec<f64> = redundant
        .row_iter()
        .map(|row| (median(row.iter().map(|value| value * value)) / MEDIAN_SQUARE).max(least))
        .collect();
    // Along the shape the noise may be that of the noisiest channel.
    let noise_variance = variances.iter().copied().fold(least, f64::max);
    let robust = Fit { noise_variance, ..fit.clone() };
    let variances_along = robust.direction_variances();
    let units = unit(&directions);
    let errors = magnitude_errors(&directions, &variances_along);
    let constraint = robust_constraint_noise(&errors, &units, variances_along);

    let freedom = (variances.len() + 1) as f64;
    let x = (samples.len().max(1) as f64 / LOST_TRIALS).ln();
    let largest = freedom + 2.0 * (freedom * x).sqrt() + 2.0 * x;
    let along = errors.iter().zip(&units).map(|(error, m)| error * error / constraint.at(m));
    redundant
        .column_iter()
        .zip(along)
        .map(|(column, along)| {
            let across: f64 =
                column.iter().zip(&variances).map(|(value, variance)| value * value / variance).sum();
            across + along <= largest
        })
        .collect()
}

/// The residuals of the codes across the shape, in their p − r principal directions: one column a sample.
fn redundant_coordinates(samples: &Samples, fit: &Fit, directions: &[Direction]) -> DMatrix<f64> {
    let mut residuals = samples.counts.clone();
    for (mut column, direction) in residuals.column_iter_mut().zip(directions) {
        column -= &fit.bias;
        for (row, component) in fit.shape.row_iter().zip(direction) {
            column.axpy(-component, &row.transpose(), 1.0);
        }
    }
    let principal = Singular::of(&(&residuals * residuals.transpose()));
    let redundant = fit.shape.ncols() - fit.rank();
    principal.left.columns(0, redundant).tr_mul(&residuals)
}

/// As [`constraint_noise`], from the median.
fn robust_constraint_noise(errors: &[f64], units: &[Direction], variances: Direction) -> ConstraintNoise {
    let explained = ConstraintNoise { variances, unexplained: 0.0 };
    let observed = median(errors.iter().map(|error| error * error)) / MEDIAN_SQUARE;
    let expected = units.iter().map(|m| explained.at(m)).sum::<f64>() / units.len().max(1) as f64;
    ConstraintNoise { unexplained: (observed - expected).max(0.0), ..explained }
}

/// The fit of these samples by the estimator of the sensor, from a fit nearby; and the eigenvalues of their covariance.
fn fitted(samples: &Samples, near: &Fit) -> Option<(Fit, DVector<f64>)> {
    let (rank, gages, count) = (near.rank(), near.shape.ncols(), samples.len() as f64);
    let mean = samples.counts.column_mean();
    let mut central = samples.counts.clone();
    for mut column in central.column_iter_mut() {
        column -= &mean;
    }
    let principal = Singular::of(&(&central * central.transpose() / count.max(1.0)));
    let redundant: f64 = principal.values.iter().skip(rank).sum();
    // The mean and r directions are fitted to every channel.
    let free = (count - (rank + 1) as f64).max(1.0);
    let noise_variance = redundant / (gages - rank) as f64 * (count / free);
    let basis = principal.left.columns(0, rank);
    let onto = basis * basis.transpose();
    let bias = &mean + &onto * (&near.bias - &mean);
    let mut fit = Fit::new(&(&near.shape * &onto), bias, noise_variance);
    // The constraint is linear about a fit; the second time, the fit is its own.
    for _ in 0..2 {
        let directions = fit.directions(samples);
        let units = unit(&directions);
        let variances = fit.direction_variances();
        let noise = constraint_noise(&directions, &units, variances);
        let sums = AdjustedSums::of(&directions, variances, rank);
        fit = fit.corrected(&Answer::of(&sums, &units, &noise, &Weight::equal(), rank)?, 1.0)?;
    }
    Some((fit, principal.values))
}

/// The middle one; zero of none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
