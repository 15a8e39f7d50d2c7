//! The field check: does a calibrated sensor still measure a known mass, and are its gages sound (design § 8)?
//!
//! * **Magnitude.** The mean of |f| over the samples against m·g. What difference is to be expected is predicted from what the
//!   calibration file tells of its own making ([`predicted_deviation`]) and from the accuracy of the mass now on the sensor.
//! * **Parity.** With more gages than components, (I − SᵀC)(z − b) is zero but for noise, whatever the load. It is the projection
//!   of the codes onto the p − m redundant directions. Its square sum over the noise is χ² with p − m degrees of freedom a
//!   sample; the gage whose share, standardised by what the projector leaves of it, is largest is the one that is off. The
//!   shape itself is not known better than [`shape_deviation`], which counts as noise here, since it shows under load only.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::alignment::MODEL_ERROR;
use super::consistency::MASS_ACCURACY;
use super::motion::magnitude;
use super::{Calibration, SolutionRecord};
use crate::recording::Recording;

/// How many predicted standard deviations the magnitude may be off: beyond, one good sensor in 370 fails.
pub const LARGEST_DIFFERENCE: f64 = 3.0;

/// How many standard deviations the parity of a gage may be off. Its noise is known well, what the shape adds to it is not.
pub const LARGEST_PARITY: f64 = 5.0;

/// The least share of a gage in the redundant directions with which its parity says anything of it.
const LEAST_SHARE: f64 = 1e-6;

/// Variance of the rounding to whole counts, counts².
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// What the field check finds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// Mean magnitude of the force, newton.
    pub mean_n: f64,
    /// The weight of the mass, newton.
    pub expected_n: f64,
    /// The one less the other, newton.
    pub difference_n: f64,
    /// Standard deviation of that difference, as predicted, newton.
    pub predicted_deviation_n: f64,
    /// Whether the magnitude is within three of these.
    pub magnitude_passed: bool,
    /// Health of the gages; `null` where there are as many as components.
    pub parity: Option<Parity>,
    /// Samples that took part.
    pub samples: u64,
}

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

/// The mass on the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownMass {
    /// The mass, kilogram.
    pub mass_kg: f64,
    /// Its standard deviation, kilogram; [`MASS_ACCURACY`] of it where nobody states one.
    pub accuracy_kg: Option<f64>,
}

/// Checks a calibration against a recording of a known mass at rest, or turned slowly. `None` where no sample is left but
/// saturated ones, or a number is not finite.
pub fn verify(calibration: &Calibration, recording: &Recording, mass: KnownMass) -> Option<Verification> {
    let forces = calibration.dof.trial_rank();
    let signals: Vec<DVector<f64>> = recording
        .unsaturated()
        .map(|(_, codes)| recording.counts(codes) - &calibration.bias_counts)
        .collect();
    let force_rows = calibration.matrix.rows(0, forces);
    let magnitude =
        magnitude(signals.iter().map(|signal| (force_rows * signal).norm()).collect::<Vec<_>>().into_iter())?;
    let expected_n = mass.mass_kg * calibration.gravity;
    let mass_deviation_n = mass.accuracy_kg.unwrap_or(MASS_ACCURACY * mass.mass_kg) * calibration.gravity;
    let predicted_deviation_n = predicted_deviation(calibration, expected_n)
        .hypot(mass_deviation_n)
        .hypot(sampling_deviation(calibration, signals.len()));
    let difference_n = magnitude.mean - expected_n;
    let verification = Verification {
        mean_n: magnitude.mean,
        expected_n,
        difference_n,
        predicted_deviation_n,
        magnitude_passed: difference_n.abs() <= LARGEST_DIFFERENCE * predicted_deviation_n,
        parity: parity(calibration, &signals),
        samples: signals.len() as u64,
    };
    (difference_n.is_finite() && predicted_deviation_n.is_finite()).then_some(verification)
}

/// Standard deviation, newton, of the magnitude that the calibration measures of a force of `force_n` newton.
///
/// From the trials' own records, each of which is known by (design § 3) √6·σ/(F√n) in its gains and √3·σ/(F√n) in its bias, and
/// from what was stated when it was made: the masses (independent from trial to trial), the fusion residual, and what a linear
/// model is good for. A prediction that the calibration file itself states takes this one's place here.
pub fn predicted_deviation(calibration: &Calibration, force_n: f64) -> f64 {
    let trials = calibration.trials.len().max(1) as f64;
    let noise = noise_counts(calibration).unwrap_or_default();
    let gain = mean_sensitivity(calibration);
    let statistical: f64 = calibration
        .trials
        .iter()
        .filter_map(|trial| {
            let samples = trial.solution.as_ref()?.samples.used.max(1) as f64;
            let relative = noise / (gain * trial.mass_kg * calibration.gravity * samples.sqrt());
            let bias_n = 3.0_f64.sqrt() * relative * trial.mass_kg * calibration.gravity;
            Some((6.0_f64.sqrt() * relative * force_n).powi(2) + bias_n.powi(2))
        })
        .sum::<f64>()
        / (trials * trials);
    let stated = (MASS_ACCURACY / trials.sqrt()).hypot(shape_deviation(calibration)) * force_n;
    statistical.sqrt().hypot(stated)
}

/// Relative standard deviation of the shape beyond the noise of its trials: how far a linear model holds, and how well the
/// trials agree on it.
pub fn shape_deviation(calibration: &Calibration) -> f64 {
    MODEL_ERROR.hypot(calibration.fusion_residual)
}

/// Noise of one channel as the trials found it, counts; `None` where none of them could tell.
fn noise_counts(calibration: &Calibration) -> Option<f64> {
    let told = |solution: &SolutionRecord| solution.noise_counts.map(|noise| noise * noise);
    let squares: Vec<f64> =
        calibration.trials.iter().filter_map(|trial| told(trial.solution.as_ref()?)).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Counts a newton, all gages together, the mean over the directions of the force.
fn mean_sensitivity(calibration: &Calibration) -> f64 {
    let forces = calibration.dof.trial_rank();
    calibration.shape.rows(0, forces).norm() / (forces as f64).sqrt()
}

/// Standard deviation of the mean magnitude from the noise of the samples alone, newton.
fn sampling_deviation(calibration: &Calibration, samples: usize) -> f64 {
    let forces = calibration.dof.trial_rank();
    let widest = calibration.matrix.rows(0, forces).row_iter().map(|row| row.norm()).fold(0.0, f64::max);
    noise_counts(calibration).unwrap_or_default() * widest / (samples.max(1) as f64).sqrt()
}

/// Parity of codes less the bias; `None` at p = m, and where no noise is known.
fn parity(calibration: &Calibration, signals: &[DVector<f64>]) -> Option<Parity> {
    let gages = calibration.gages();
    let redundant = gages.checked_sub(calibration.dof.count()).filter(|&redundant| redundant > 0)?;
    let noise = noise_counts(calibration)?;
    let noise_variance = (noise * noise).max(QUANTISATION_VARIANCE);
    let projector = DMatrix::identity(gages, gages) - calibration.shape.transpose() * &calibration.matrix;
    let (mut chi_square, mut variance) = (0.0, 0.0);
    let mut mean = DVector::zeros(gages);
    for signal in signals {
        let parity = &projector * signal;
        // An error of the shape turns a share of the signal into parity, spread over all gages.
        let from_shape = (shape_deviation(calibration) * signal.norm()).powi(2) / gages as f64;
        chi_square += parity.norm_squared() / (noise_variance + from_shape);
        variance += from_shape;
        mean += parity;
    }
    let samples = signals.len().max(1) as f64;
    mean /= samples;
    // The mean of the noise falls with the samples, what the shape does not know stays.
    let mean_variance = noise_variance / samples + variance / samples;
    let standardised = |gage: usize| {
        let share = projector[(gage, gage)];
        if share > LEAST_SHARE { mean[gage].abs() / (share * mean_variance).sqrt() } else { 0.0 }
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

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;

    use super::{KnownMass, Verification, verify};
    use crate::calibration::synthetic::{Rests, Sensor, spatial, sphere};
    use crate::calibration::{Calibration, calibrate};
    use crate::session_file::STANDARD_GRAVITY;

    const ARMS: [[f64; 3]; 3] = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];

    fn wrist(seed: u64) -> (Sensor, Calibration) {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let directions = vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)];
        let rests = Rests { directions, accuracy_rad: 1e-3 };
        let trials: Vec<_> = ARMS.iter().map(|arm| sensor.trial(2.0, arm, &rests)).collect();
        let calibration = calibrate(sensor.dof, STANDARD_GRAVITY, &trials).expect("the evidence is good");
        (sensor, calibration)
    }

    fn check(sensor: &mut Sensor, calibration: &Calibration, hung_kg: f64, claimed_kg: f64) -> Verification {
        let recording = sensor.record(hung_kg, &[0.02, -0.01, 0.08], &sphere(200));
        verify(calibration, &recording, KnownMass { mass_kg: claimed_kg, accuracy_kg: None })
            .expect("samples")
    }

    #[test]
    fn a_sound_sensor_passes_at_any_mass_and_arm_and_a_wrong_mass_fails() {
        for seed in 0..8 {
            let (mut sensor, calibration) = wrist(seed);
            for mass_kg in [0.5, 1.0, 2.0] {
                let found = check(&mut sensor, &calibration, mass_kg, mass_kg);
                assert!(found.magnitude_passed, "{found:?}");
                assert!(found.parity.as_ref().is_some_and(|parity| parity.passed), "{found:?}");
                // Thirty predicted deviations off.
                let wrong = mass_kg * (1.0 + 30.0 * found.predicted_deviation_n / found.expected_n);
                assert!(!check(&mut sensor, &calibration, wrong, mass_kg).magnitude_passed, "{found:?}");
            }
        }
    }

    #[test]
    fn a_gage_that_has_moved_is_named() {
        for seed in 0..8 {
            let (mut sensor, calibration) = wrist(seed);
            for gage in 0..8 {
                // Two redundant directions see of some gages next to nothing; of those nobody can tell.
                let seen = 1.0 - calibration.matrix.column(gage).dot(&calibration.shape.column(gage));
                if seen < 0.2 {
                    continue;
                }
                let healthy = sensor.bias_counts[gage];
                sensor.bias_counts[gage] += 2e5;
                let parity = check(&mut sensor, &calibration, 1.0, 1.0).parity.expect("eight gages for six");
                sensor.bias_counts[gage] = healthy;
                assert!(!parity.passed && parity.chi_square_per_freedom > 10.0, "{parity:?}");
                assert_eq!(parity.worst_gage, gage, "{parity:?}");
            }
        }
    }

    #[test]
    fn as_many_gages_as_components_have_no_parity() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 3, 1);
        let directions = vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)];
        let trial = sensor.trial(2.0, &[], &Rests { directions, accuracy_rad: 1e-3 });
        let calibration = calibrate(sensor.dof, STANDARD_GRAVITY, &[trial]).expect("the evidence is good");
        let recording = sensor.record(1.0, &[], &sphere(100));
        let found = verify(&calibration, &recording, KnownMass { mass_kg: 1.0, accuracy_kg: None });
        let found = found.expect("samples");
        assert!(found.magnitude_passed && found.parity.is_none(), "{found:?}");
    }
}
