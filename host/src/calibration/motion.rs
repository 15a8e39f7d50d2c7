//! The recovered motion of one trial: the load's direction at every sample, m̂ = Ĉ(z − b), in the trial's own frame.
//!
//! Its length should be one throughout (the constraint of eq. 13). How well it is tells how far the trial's shape can be
//! trusted, whatever the cause of the misfit: noise, quantisation, swinging, a sensor that is not linear.

use std::iter;

use ftcal_shared::refusal::Refusal;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::matrix::matrix_of_shape;
use super::trial::TrialShape;
use crate::recording::{Recording, is_saturated};

/// The recovered directions of a trial's load, in the order of the samples.
#[derive(Clone, Debug)]
pub struct Motion {
    /// One direction (r) for each sample that is not saturated, per unit load.
    pub directions: Vec<DVector<f64>>,
    /// Those of the samples that the trial was solved from: what the constraint is judged by.
    pub quiet: Vec<DVector<f64>>,
}

/// How long the recovered load is, per unit load: one, but for noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Magnitude {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

/// Standard deviations of what a trial found, in units of its load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialUncertainty {
    /// Of the least certain gain of the shape, relative.
    pub gain: f64,
    /// Of the least certain component of the bias, as a share of the load.
    pub bias: f64,
}

/// Recovers the motion of a trial from its codes.
///
/// # Errors
///
/// [`Refusal::RankNotReached`] or [`Refusal::NonFinite`] where the shape cannot be inverted.
pub fn recover(recording: &Recording, trial: &TrialShape) -> Result<Motion, Refusal> {
    let matrix = matrix_of_shape(&trial.shape_counts_per_load)?;
    let mut directions = Vec::with_capacity(recording.len());
    let mut quiet = Vec::with_capacity(recording.len());
    let taken = trial.taken.iter().copied().chain(iter::repeat(true));
    for ((_, codes), taken) in recording.samples().zip(taken) {
        if is_saturated(codes) {
            continue;
        }
        let direction = &matrix * (recording.counts(codes) - &trial.bias_counts);
        if taken {
            quiet.push(direction.clone());
        }
        directions.push(direction);
    }
    if directions.iter().flatten().all(|component| component.is_finite()) {
        Ok(Motion { directions, quiet })
    } else {
        Err(Refusal::NonFinite)
    }
}

impl Motion {
    /// Mean and standard deviation of the recovered length over the samples used; `None` of no sample.
    pub fn magnitude(&self) -> Option<Magnitude> {
        magnitude(self.quiet.iter().map(DVector::norm))
    }

    /// How certain the shape and the bias are that this motion was recovered with.
    ///
    /// The metric constraint is regressed once more on the recovered motion, |m|² − 1 = mᵀEm + gᵀm: the covariance of
    /// E and g, scaled by the misfit that was observed, is that of twice the gains and of twice the bias. `None` where
    /// the motion does not determine them.
    pub fn uncertainty(&self) -> Option<TrialUncertainty> {
        let rank = self.quiet.first()?.len();
        let quadratic = rank * (rank + 1) / 2;
        let unknowns = quadratic + rank;
        let freedom = self.quiet.len().checked_sub(unknowns).filter(|&freedom| freedom > 0)?;
        let mut normal = DMatrix::zeros(unknowns, unknowns);
        let mut misfit = 0.0;
        for direction in &self.quiet {
            let products = (0..rank).flat_map(|a| (a..rank).map(move |b| direction[a] * direction[b]));
            let row = DVector::from_iterator(unknowns, products.chain(direction.iter().copied()));
            normal.ger(1.0, &row, &row, 1.0);
            misfit += (direction.norm_squared() - 1.0).powi(2);
        }
        let covariance = normal.cholesky()?.inverse() * (misfit / freedom as f64);
        let deviation = |range: std::ops::Range<usize>| {
            range.map(|unknown| covariance[(unknown, unknown)]).fold(0.0, f64::max).sqrt() / 2.0
        };
        let uncertainty =
            TrialUncertainty { gain: deviation(0..quadratic), bias: deviation(quadratic..unknowns) };
        (uncertainty.gain.is_finite() && uncertainty.bias.is_finite()).then_some(uncertainty)
    }
}

/// Mean and standard deviation (divisor n) of some lengths; `None` of none.
pub fn magnitude(lengths: impl Iterator<Item = f64> + Clone) -> Option<Magnitude> {
    let count = lengths.clone().count();
    if count == 0 {
        return None;
    }
    let mean = lengths.clone().sum::<f64>() / count as f64;
    let variance = lengths.map(|length| (length - mean).powi(2)).sum::<f64>() / count as f64;
    Some(Magnitude { mean, std: variance.sqrt() })
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;

    use super::recover;
    use crate::calibration::synthetic::{Sensor, sphere};
    use crate::calibration::trial::{Gating, solve};

    #[test]
    fn the_predicted_uncertainty_is_that_of_repeated_trials() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, 1);
        sensor.noise_counts *= 10.0;
        let truth = sensor.shape.transpose() * &sensor.shape;
        let (repetitions, mut predicted, mut observed) = (40, 0.0, 0.0);
        for _ in 0..repetitions {
            let recording = sensor.record(1.0, &[], &sphere(400));
            let trial = solve(&recording, 3, Gating::On).expect("the motion spans");
            let motion = recover(&recording, &trial).expect("invertible");
            let length = motion.magnitude().expect("samples");
            assert!((length.mean - 1.0).abs() < 0.01 && length.std < 0.1);
            predicted +=
                motion.uncertainty().expect("the motion spans").gain.powi(2) / f64::from(repetitions);
            // SᵀS is free of the arbitrary orientation; a relative error e of S is one of 2e there.
            let shape = &trial.shape_counts_per_load / crate::session_file::STANDARD_GRAVITY;
            let error = (shape.transpose() * &shape - &truth).norm() / truth.norm() / 2.0;
            observed += error.powi(2) / f64::from(repetitions);
        }
        // The prediction is for the worst single gain, the observation for all together: equal within a small factor.
        let ratio = (predicted / observed).sqrt();
        assert!((0.4..2.5).contains(&ratio), "{ratio}");
    }
}
