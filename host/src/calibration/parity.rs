//! Parity: whether the gages of a calibrated sensor agree with each other (design § 8).
//!
//! With more gages than components, (I − SᵀC)(z − b) is zero but for noise, whatever the load. It is the projection of the codes
//! onto the p − m redundant directions. Its square sum over the noise is χ² with p − m degrees of freedom a sample; the gage whose
//! share, standardised by what the projector leaves of it, is largest is the one that is off: by its mean, which an offset shows best,
//! or by its root mean square, since a wrong gain averages out over a load that turns. The shape itself is not known better
//! than [`shape_deviation`], which counts as noise here, since it shows under load only.

use ftcal_shared::estimation::rest_noise::QUANTISATION_VARIANCE;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::alignment::MODEL_ERROR;
use super::{Calibration, SolutionRecord};

/// How many standard deviations the parity of a gage may be off. Its noise is known well, what the shape adds to it is not.
pub const LARGEST_PARITY: f64 = 5.0;

/// The least share of a gage in the redundant directions with which its parity says anything of it.
const LEAST_SHARE: f64 = 1e-6;

/// Health of the gages.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parity {
    /// χ² over its degrees of freedom: one for a sound sensor.
    pub chi_square_per_freedom: f64,
    /// The gage that is farthest off, counted from zero.
    pub worst_gage: usize,
    /// How far it is off, in standard deviations.
    pub worst_standardised: f64,
    /// Whether that is within five of these.
    pub passed: bool,
}

/// Relative standard deviation of the shape beyond the noise of its trials: how far a linear model holds, and how well the
/// trials agree on it.
pub fn shape_deviation(calibration: &Calibration) -> f64 {
    MODEL_ERROR.hypot(calibration.fusion_residual)
}

/// Noise of one channel as the trials found it, counts; `None` where none of them could tell.
pub fn noise_counts(calibration: &Calibration) -> Option<f64> {
    let told = |solution: &SolutionRecord| solution.noise_counts.map(|noise| noise * noise);
    let squares: Vec<f64> =
        calibration.trials.iter().filter_map(|trial| told(trial.solution.as_ref()?)).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Parity of codes less the bias; `None` at p = m, and where no noise is known.
pub fn parity(calibration: &Calibration, signals: &[DVector<f64>]) -> Option<Parity> {
    let gages = calibration.gages();
    let redundant = gages.checked_sub(calibration.dof.count()).filter(|&redundant| redundant > 0)?;
    let noise = noise_counts(calibration)?;
    let noise_variance = (noise * noise).max(QUANTISATION_VARIANCE);
    let projector = DMatrix::identity(gages, gages) - calibration.shape.transpose() * &calibration.matrix;
    let (mut chi_square, mut variance) = (0.0, 0.0);
    let (mut mean, mut mean_square) = (DVector::zeros(gages), DVector::zeros(gages));
    let samples = signals.len().max(1) as f64;
    for signal in signals {
        let parity = &projector * signal;
        // An error of the shape turns a share of the signal into parity, spread over all gages.
        let from_shape = (shape_deviation(calibration) * signal.norm()).powi(2) / gages as f64;
        chi_square += parity.norm_squared() / (noise_variance + from_shape);
        variance += from_shape / samples;
        mean_square += parity.component_mul(&parity) / samples;
        mean += parity / samples;
    }
    // The mean of the noise falls with the samples, what the shape does not know stays.
    let mean_variance = noise_variance / samples + variance;
    let standardised = |gage: usize| {
        let share = projector[(gage, gage)];
        if share > LEAST_SHARE {
            let of_mean = mean[gage].abs() / (share * mean_variance).sqrt();
            of_mean.max((mean_square[gage] / (share * (noise_variance + variance))).sqrt())
        } else {
            0.0
        }
    };
    let worst_gage = (0..gages).max_by(|&a, &b| standardised(a).total_cmp(&standardised(b)))?;
    let worst_standardised = standardised(worst_gage);
    Some(Parity {
        chi_square_per_freedom: chi_square / (samples * redundant as f64),
        worst_gage,
        worst_standardised,
        passed: worst_standardised <= LARGEST_PARITY,
    })
}
