//! Whether the sensor is linear: at the load of a trial, and from one load to another.
//!
//! * **At one load.** A linear sensor moves in r directions of the codes, and nothing but noise is in the others. An
//!   (r+1)-th eigenvalue far above the noise of the same sensor at rest is signal: the codes follow the load along a curved
//!   surface (design § 8). Only a rest tells, since more noise is the other explanation.
//! * **From one load to another.** Shape from motion turns one magnitude and cannot tell whether twice the load gives twice the
//!   signal. A trial at another mass can: its shape, turned onto the one that the calibration predicts at its arm (orthogonal
//!   Procrustes, [`super::procrustes`]), must be that shape. It is never fitted. The calibration's uncertainty
//!   ([`super::accuracy`]), the mass's and the trial's own explain part of what is left; only what is beyond is the sensor's.

use ftcal_shared::estimation::rest_noise::QUANTISATION_VARIANCE;
use serde::{Deserialize, Serialize};

use super::accuracy::wrench_deviation;
use super::known_load::{KnownLoad, squashing_matrix};
use super::procrustes::onto;
use super::trial::TrialShape;
use super::{Calibration, CalibrationRefusal, SolvedTrial};

/// How many times the (r+1)-th standard deviation may exceed that at rest.
///
/// Noise alone spreads its own eigenvalues to 1.5 times their mean or less; vibration and drift of a moving sensor add to
/// it. Five times is neither.
const LARGEST_NOISE_RATIO: f64 = 5.0;

/// The share of the signal below which a redundant direction disturbs nobody: a wrench would be off by less than that.
const LEAST_NONLINEARITY: f64 = 3e-3;

/// The fewest samples of a rest that tell its noise: within a fifth at two channels.
const LEAST_REST_SAMPLES: u64 = 20;

/// How many standard deviations of what the uncertainty explains are still explained by it.
const EXPLAINED: f64 = 3.0;

/// Whether a sensor that is not linear is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Linearity {
    /// It is.
    Required,
    /// It is calibrated as if it were linear.
    Assumed,
}

/// How a calibration fits a trial at another load, which it was not made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckRecord {
    /// The recording, as the session names it.
    pub recording: String,
    /// The mass, kilogram.
    pub mass_kg: f64,
    /// The moment arm, metre; empty for force sensors.
    pub arm_m: Vec<f64>,
    /// Response of the gages over what the calibration predicts for this load: one for a linear sensor.
    pub scale: f64,
    /// Standard deviation that the uncertainties of calibration, mass and trial give the scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_uncertainty: Option<f64>,
    /// The part of the response that is not that scale times the prediction, relative.
    pub residual: f64,
    /// The residual that the uncertainties of calibration and trial give, root mean square.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_uncertainty: Option<f64>,
    /// Whether they explain both; absent where the calibration states no uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<CheckVerdict>,
}

/// Whether the sensor is linear from the loads of the calibration to that of a check, as far as that can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CheckVerdict {
    /// What is off is within three standard deviations.
    WithinUncertainty,
    /// It is not.
    BeyondUncertainty,
}

/// Refuses a trial (numbered from zero) whose codes leave the directions of a linear sensor. The noise is that of the known loads'
/// rests or, where there are none, of the quietest samples of the trial. Where nothing tells the noise, nothing tells the
/// one from the other.
///
/// # Errors
///
/// [`CalibrationRefusal::NotLinear`].
pub fn require_linear(
    trial: usize,
    shape: &TrialShape,
    known_loads: &[KnownLoad],
) -> Result<(), CalibrationRefusal> {
    let rank = shape.rank();
    let rest_counts = noise_at_rest(known_loads).or(shape.quietest_noise_counts);
    let (Some(rest_counts), Some(&next)) = (rest_counts, shape.eigenvalues.get(rank)) else { return Ok(()) };
    let redundant_counts = next.max(0.0).sqrt();
    let signal_counts = shape.shape_counts_per_load.norm() / (rank as f64).sqrt();
    if redundant_counts > LARGEST_NOISE_RATIO * rest_counts
        && redundant_counts > LEAST_NONLINEARITY * signal_counts
    {
        return Err(CalibrationRefusal::NotLinear { trial, redundant_counts, rest_counts, signal_counts });
    }
    Ok(())
}

/// Noise of one channel while the load hangs still, counts: that of the noisiest rest; `None` where there is no rest to speak of.
fn noise_at_rest(rests: &[KnownLoad]) -> Option<f64> {
    let long = rests.iter().filter(|known| known.rest.samples >= LEAST_REST_SAMPLES);
    let noisiest = long.map(|known| known.rest.noise_variance).reduce(f64::max)?;
    Some(noisiest.max(QUANTISATION_VARIANCE).sqrt())
}

/// Compares a trial at another load with what the calibration predicts of it.
pub fn check(calibration: &Calibration, trial: &SolvedTrial) -> CheckRecord {
    let force_n = trial.case.mass_kg * calibration.gravity;
    let squashing = squashing_matrix(trial.shape.rank(), &trial.case.arm_m);
    let predicted = squashing * &calibration.shape * force_n;
    let found = onto(&trial.shape.shape_counts_per_load, &predicted).turned;
    let scale = found.dot(&predicted) / predicted.norm_squared();
    let residual = (&found - &predicted * scale).norm() / predicted.norm();
    let deviations = wrench_deviation(calibration).map(|of_calibration| {
        let own = &trial.shape.covariance;
        let mass = trial.case.mass_accuracy_kg / trial.case.mass_kg;
        let shape =
            trial.shape.shape_deviation_counts_per_load().norm() / trial.shape.shape_counts_per_load.norm();
        (of_calibration.hypot(mass).hypot(own.gain_deviation()), of_calibration.hypot(shape))
    });
    let verdict = deviations.map(|(of_scale, of_residual)| {
        if (scale - 1.0).abs() <= EXPLAINED * of_scale && residual <= EXPLAINED * of_residual {
            CheckVerdict::WithinUncertainty
        } else {
            CheckVerdict::BeyondUncertainty
        }
    });
    CheckRecord {
        recording: trial.case.name.clone(),
        mass_kg: trial.case.mass_kg,
        arm_m: trial.case.arm_m.iter().copied().collect(),
        scale,
        scale_uncertainty: deviations.map(|(of_scale, _)| of_scale),
        residual,
        residual_uncertainty: deviations.map(|(_, of_residual)| of_residual),
        verdict,
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::DVector;

    use super::{CheckVerdict, check, require_linear};
    use crate::calibration::known_load::{KnownLoad, LoadCase, average};
    use crate::calibration::synthetic::{Rests, Sensor, spatial, sphere};
    use crate::calibration::{Calibration, CalibrationRefusal, SolvedTrial, calibrate, trial};
    use crate::recording::Recording;
    use crate::session_file::STANDARD_GRAVITY;

    /// The recording of a sensor whose gages answer with this share of the square of their signal, full scale being the load's.
    fn bent(sensor: &mut Sensor, directions: &[DVector<f64>], share: f64) -> Recording {
        let straight = sensor.record(1.0, &[], directions);
        let bias = sensor.bias_counts.clone();
        let full = sensor.shape.norm() * STANDARD_GRAVITY / 3.0_f64.sqrt();
        let counts: Vec<f64> = straight
            .samples()
            .flat_map(|(_, codes)| {
                let signal = straight.counts(codes) - &bias;
                // Each gage bends its own way.
                let bent = signal.map_with_location(|gage, _, count| {
                    let way = if gage % 2 == 0 { share } else { -share };
                    (count + way * count * count / full * (1.0 + 0.3 * gage as f64)).round()
                });
                (bent + &bias).iter().copied().collect::<Vec<_>>()
            })
            .collect();
        Recording::from_counts(straight.gages(), vec![0.0; straight.len()], &counts)
    }

    fn solved(sensor: &mut Sensor, share: f64) -> SolvedTrial {
        let direction = spatial(0.0, 0.0, -1.0);
        let rest = bent(sensor, &vec![direction.clone(); 100], share);
        let recording = bent(sensor, &sphere(1500), share);
        let shape = trial::solve(&recording, 3, trial::Gating::On).expect("the motion spans");
        let known =
            KnownLoad { direction, accuracy_rad: 1e-3, rest: average(&rest).expect("nothing is saturated") };
        SolvedTrial {
            case: LoadCase {
                name: "trial.csv".to_owned(),
                mass_kg: 1.0,
                arm_m: DVector::zeros(0),
                arm_accuracy_m: 0.0,
                mass_accuracy_kg: 1e-3,
                known_loads: vec![known],
            },
            shape,
            turned: None,
        }
    }

    #[test]
    fn a_bent_sensor_is_refused_and_a_straight_one_is_not() {
        for seed in 0..10 {
            let mut sensor = Sensor::new(Dof::SpatialForce, 8, seed);
            let straight = solved(&mut sensor, 0.0);
            assert_eq!(require_linear(0, &straight.shape, &straight.case.known_loads), Ok(()));
            let bent = solved(&mut sensor, 0.1);
            let refused = require_linear(0, &bent.shape, &bent.case.known_loads);
            assert!(matches!(refused, Err(CalibrationRefusal::NotLinear { trial: 0, .. })), "{refused:?}");
        }
    }

    #[test]
    fn a_check_tells_scale_and_residual_whatever_its_orientation() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, 1);
        let directions = vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)];
        let rests = Rests { directions, accuracy_rad: 1e-3 };
        let fitted = sensor.trial(2.0, &[], &rests);
        let calibration = calibrate(sensor.dof, STANDARD_GRAVITY, &[fitted]).expect("the evidence is good");
        let none = Rests { directions: Vec::new(), accuracy_rad: 1e-3 };

        let linear = check(&calibration, &sensor.trial(4.0, &[], &none));
        // Noise is 0.01 % of the load in 1500 samples.
        assert!((linear.scale - 1.0).abs() < 1e-4 && linear.residual < 1e-3, "{linear:?}");
        assert_eq!(linear.verdict, Some(CheckVerdict::WithinUncertainty), "{linear:?}");
        sensor.shape *= 0.97;
        let soft = check(&calibration, &sensor.trial(4.0, &[], &none));
        assert!((soft.scale - 0.97).abs() < 1e-4 && soft.residual < 1e-3, "{soft:?}");
        // Masses are known to 0.1 %, so that 3 % is far beyond.
        assert_eq!(soft.verdict, Some(CheckVerdict::BeyondUncertainty), "{soft:?}");

        let silent = Calibration { uncertainty: None, ..calibration };
        assert_eq!(check(&silent, &sensor.trial(4.0, &[], &none)).verdict, None);
    }
}
