//! The recovered motion of one trial: the load's direction at every sample, m̂ = Ĉ(z − b), in the trial's own frame.
//!
//! Its length should be one throughout (the constraint of eq. 13): its spread is what the trial leaves unexplained, by
//! noise, by swinging or by a sensor that is not linear.

use std::iter;

use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::AdcCode;
use nalgebra::DVector;
use serde::Serialize;

use super::matrix::matrix_of_shape;
use super::trial::TrialShape;
use crate::recording::Recording;

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
        if AdcCode::any_is_saturated(codes) {
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
