//! The sensor's bias from those of its trials: their mean, weighted by samples, how certain it is, and what errors it shares
//! with the trials' shapes.
//!
//! A load that has been in some directions only leaves a gain and the bias to trade places, so that the two are wrong
//! together: a wrench on the side where the load has been is then better known than either, and one on the other side worse.

use nalgebra::{DMatrix, DVector};

use super::{CalibrationRefusal, SolvedTrial};

/// How far the biases of trials may be apart, as a share of the signal of their loads, beyond their uncertainty.
const LARGEST_DISAGREEMENT: f64 = 0.02;

/// How many standard deviations beyond that count as a disagreement.
const CONTRADICTION: f64 = 5.0;

/// How certain the common bias is.
#[derive(Clone, Debug)]
pub struct BiasCovariance {
    /// Covariance of the bias (p × p), counts².
    pub bias: DMatrix<f64>,
    /// Of each trial, the covariance of its shape, column by column (rp), with the common bias (p): counts per newton times
    /// counts.
    pub with_shapes: Vec<DMatrix<f64>>,
}

/// The mean of the trials' biases (p), counts. All trials are of one sensor: their biases must agree.
///
/// # Errors
///
/// [`CalibrationRefusal::BiasesDisagree`].
pub fn common_bias(trials: &[SolvedTrial]) -> Result<DVector<f64>, CalibrationRefusal> {
    let mean = mean(trials);
    for (index, trial) in trials.iter().enumerate() {
        let signal_counts = trial.shape.shape_counts_per_load.norm() / (trial.shape.rank() as f64).sqrt();
        let counts = (&trial.shape.bias_counts - &mean).norm();
        let allowed = LARGEST_DISAGREEMENT + CONTRADICTION * trial.shape.covariance.bias_deviation();
        let agrees = counts <= allowed * signal_counts;
        if !agrees {
            return Err(CalibrationRefusal::BiasesDisagree { trial: index, counts, signal_counts });
        }
    }
    Ok(mean)
}

/// How certain that mean is, at this local gravity in m/s². Where the biases are further apart than their own
/// covariances explain, because the zero has drifted, these grow by as much.
pub fn bias_covariance(trials: &[SolvedTrial], gravity: f64) -> BiasCovariance {
    let mean = mean(trials);
    let own: Vec<DMatrix<f64>> =
        trials.iter().map(|trial| trial.shape.covariance.bias(&trial.shape.shape_counts_per_load)).collect();
    let misfits = trials.iter().zip(&own).filter_map(|(trial, own)| {
        let apart = &trial.shape.bias_counts - &mean;
        Some(apart.dot(&own.clone().cholesky()?.solve(&apart)))
    });
    let freedom = mean.len() * trials.len().saturating_sub(1);
    let drifted = (misfits.sum::<f64>() / freedom.max(1) as f64).max(1.0);
    let shares = shares(trials);
    let bias = own.iter().zip(&shares).map(|(own, share)| own * (drifted * share * share)).sum();
    let with_shapes = trials
        .iter()
        .zip(&shares)
        .map(|(trial, share)| {
            let newton = trial.case.mass_kg * gravity;
            trial.shape.covariance.shape_with_bias(&trial.shape.shape_counts_per_load) * (share / newton)
        })
        .collect();
    BiasCovariance { bias, with_shapes }
}

fn mean(trials: &[SolvedTrial]) -> DVector<f64> {
    trials.iter().zip(shares(trials)).map(|(trial, share)| &trial.shape.bias_counts * share).sum()
}

fn shares(trials: &[SolvedTrial]) -> Vec<f64> {
    let samples = |trial: &SolvedTrial| trial.shape.samples.used as f64;
    let all: f64 = trials.iter().map(samples).sum();
    trials.iter().map(|trial| samples(trial) / all).collect()
}
