//! The field check: does a calibrated sensor still measure a known mass, and are its gages sound (design § 8)?
//!
//! The samples at rest, or all where the load never rests, are taken together while the force stays where it is, at most
//! 64 of them: f is their mean, which has little noise left to make |f| too large. The mean of |f| over all of these
//! stays is compared with m·g, and so is each stay by itself: a sensor may be too strong along one axis and too weak along another.
//! What difference is to be expected is the root of the sum of the squares of
//!
//! * what the calibration promises at its full load F ([`super::accuracy`]), in the ratio of the loads, and of its bias, which does not
//!   fall with the load; for a calibration that states no uncertainty, what its trials' records suggest ([`suggested_deviation`]);
//! * the accuracy of the mass that hangs there now. Where it is one of the calibration's own masses, that is counted twice: nobody
//!   says so, and the check is the milder for it;
//! * local gravity, only where the check is made elsewhere: at the place of the calibration it cancels;
//! * the noise of the samples.
//!
//! The gages are judged by their parity ([`super::parity`]).

use nalgebra::DVector;
use serde::Serialize;

use super::Calibration;
use super::accuracy::{force_deviation, full_load_n, gravity_deviation};
use super::consistency::MASS_ACCURACY;
use super::motion::magnitude;
use super::parity::{Parity, noise_counts, parity, shape_deviation};
use super::rest::{Rested, rested};
use super::samples::SampleCounts;
use crate::gravity::Gravity;
use crate::recording::Recording;

/// How many predicted standard deviations the magnitude may be off: beyond, one good sensor in 370 fails.
pub const LARGEST_DIFFERENCE: f64 = 3.0;

/// The same for the worst of many stays.
pub const LARGEST_DIFFERENCE_OF_MANY: f64 = 5.0;

/// Samples in one stay at most: a load that is turned slowly hardly turns meanwhile.
const LONGEST_STAY: usize = 64;

/// The force stays where it is while it is within this of where it was, relative, or within its noise.
const SAME_PLACE: f64 = 0.02;

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
    /// The part of it that is the calibration's, newton.
    pub calibration_deviation_n: f64,
    /// Whether the calibration states that part itself.
    pub calibration_states_it: bool,
    /// The part of it that is the mass's, newton.
    pub mass_deviation_n: f64,
    /// Whether the magnitude is within three standard deviations.
    pub magnitude_passed: bool,
    /// Magnitude of the force in the stay that is farthest off, newton.
    pub worst_n: f64,
    /// Whether that is within five standard deviations.
    pub worst_passed: bool,
    /// Health of the gages; `null` where there are as many as components.
    pub parity: Option<Parity>,
    /// Samples recorded, used, and left out by cause.
    pub samples: SampleCounts,
}

/// The mass on the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownMass {
    /// The mass, kilogram.
    pub mass_kg: f64,
    /// Its standard deviation, kilogram; [`MASS_ACCURACY`] of it where nobody states one.
    pub accuracy_kg: Option<f64>,
    /// Local gravity where it hangs; `None` at the place where the sensor was calibrated.
    pub elsewhere: Option<Gravity>,
}

/// Checks a calibration against a recording of a known mass at rest, or turned slowly. `None` where no sample is a
/// measurement, or a number is not finite.
pub fn verify(calibration: &Calibration, recording: &Recording, mass: KnownMass) -> Option<Verification> {
    let Rested { counts, samples } = rested(recording)?;
    let signals: Vec<DVector<f64>> = counts.iter().map(|counts| counts - &calibration.bias_counts).collect();
    let stays = stays(calibration, &signals);
    let mean_n = magnitude(stays.iter().map(|stay| stay.force_n))?.mean;

    let KnownMass { mass_kg, accuracy_kg, elsewhere } = mass;
    let gravity = elsewhere.map_or(calibration.gravity, |gravity| gravity.magnitude);
    let expected_n = mass_kg * gravity;
    let mass_deviation_n = accuracy_kg.unwrap_or(MASS_ACCURACY * mass_kg) * gravity;
    let of_gravity = elsewhere.map_or(0.0, |gravity| {
        gravity.relative_accuracy().hypot(gravity_deviation(calibration)) * expected_n
    });
    let stated = stated_deviation(calibration, expected_n);
    let calibration_deviation_n =
        stated.unwrap_or_else(|| suggested_deviation(calibration, expected_n)).hypot(of_gravity);
    let predicted_deviation_n =
        calibration_deviation_n.hypot(mass_deviation_n).hypot(sampling_deviation(calibration, signals.len()));
    let difference_n = mean_n - expected_n;
    // One stay: its noise, and what the mean has in common with all of them.
    let systematic_n = calibration_deviation_n.hypot(mass_deviation_n);
    let excess = |stay: &Stay| {
        (stay.force_n - expected_n).abs() / systematic_n.hypot(sampling_deviation(calibration, stay.samples))
    };
    let worst = stays.iter().max_by(|a, b| excess(a).total_cmp(&excess(b)))?;
    let verification = Verification {
        mean_n,
        expected_n,
        difference_n,
        predicted_deviation_n,
        calibration_deviation_n,
        calibration_states_it: stated.is_some(),
        mass_deviation_n,
        magnitude_passed: difference_n.abs() <= LARGEST_DIFFERENCE * predicted_deviation_n,
        worst_n: worst.force_n,
        worst_passed: excess(worst) <= LARGEST_DIFFERENCE_OF_MANY,
        parity: parity(calibration, &signals),
        samples,
    };
    (difference_n.is_finite() && predicted_deviation_n.is_finite()).then_some(verification)
}

/// The force over successive samples during which it stayed where it was.
struct Stay {
    /// |f| of their mean, newton.
    force_n: f64,
    samples: usize,
}

fn stays(calibration: &Calibration, signals: &[DVector<f64>]) -> Vec<Stay> {
    let force_rows = calibration.matrix.rows(0, calibration.dof.trial_rank());
    let forces: Vec<DVector<f64>> = signals.iter().map(|signal| force_rows * signal).collect();
    // Six standard deviations of a difference between two samples, over all components.
    let noise_n = 6.0
        * (2.0 * forces.first().map_or(0, DVector::len) as f64).sqrt()
        * sampling_deviation(calibration, 1);
    let mut stays = Vec::new();
    let mut rest = forces.as_slice();
    while let Some(first) = rest.first() {
        let near = (SAME_PLACE * first.norm()).max(noise_n);
        let together = rest.iter().take(LONGEST_STAY).take_while(|force| (*force - first).norm() <= near);
        let samples = together.count().max(1);
        let (stay, after) = rest.split_at(samples);
        let mean = stay.iter().sum::<DVector<f64>>() / samples as f64;
        stays.push(Stay { force_n: mean.norm(), samples });
        rest = after;
    }
    stays
}

/// Standard deviation, newton, of the magnitude that the calibration measures of a force of `force_n` newton, as it states
/// itself; `None` where it states none.
///
/// What is stated holds at full load and has the bias in it. The bias does not fall with the load; where the trials' noise does not
/// tell how much of it that is, all of it might be.
fn stated_deviation(calibration: &Calibration, force_n: f64) -> Option<f64> {
    let (relative, full_n) = (force_deviation(calibration)?, full_load_n(calibration)?);
    Some(match bias_deviation(calibration) {
        Some(bias_n) => (relative * force_n).hypot(bias_n),
        None => relative * force_n.max(full_n),
    })
}

/// The same for a calibration that states no uncertainty.
///
/// From the trials' own records, each of which is known by (design § 3) √6·σ/(F√n) in its gains and √3·σ/(F√n) in its bias, and
/// from what was stated when it was made: the masses (independent from trial to trial), the fusion residual, and what a linear
/// model is good for.
pub fn suggested_deviation(calibration: &Calibration, force_n: f64) -> f64 {
    let trials = calibration.trials.len().max(1) as f64;
    let bias_n = bias_deviation(calibration).unwrap_or_default();
    let gains = full_load_n(calibration).map_or(0.0, |full_n| 2.0_f64.sqrt() * bias_n / full_n);
    let stated = (MASS_ACCURACY / trials.sqrt()).hypot(shape_deviation(calibration));
    (gains.hypot(stated) * force_n).hypot(bias_n)
}

/// Standard deviation of the bias of the calibration, newton: √3·σ/√n of each trial (design § 3), in their mean. `None` where the
/// trials' noise is not known.
fn bias_deviation(calibration: &Calibration) -> Option<f64> {
    let noise_n = noise_counts(calibration)? / mean_sensitivity(calibration);
    let trials = calibration.trials.len().max(1) as f64;
    let solutions = calibration.trials.iter().filter_map(|trial| trial.solution.as_ref());
    let squares: f64 =
        solutions.map(|solution| 3.0 * noise_n * noise_n / solution.samples.used.max(1) as f64).sum();
    Some(squares.sqrt() / trials)
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

    /// The gages of which parity can tell: two redundant directions see of some next to nothing.
    fn gages_seen(calibration: &Calibration) -> Vec<usize> {
        let seen = |gage: usize| 1.0 - calibration.matrix.column(gage).dot(&calibration.shape.column(gage));
        (0..calibration.gages()).filter(|&gage| seen(gage) >= 0.2).collect()
    }

    fn check(sensor: &mut Sensor, calibration: &Calibration, hung_kg: f64, claimed_kg: f64) -> Verification {
        let recording = sensor.record(hung_kg, &[0.02, -0.01, 0.08], &sphere(200));
        verify(calibration, &recording, KnownMass { mass_kg: claimed_kg, accuracy_kg: None, elsewhere: None })
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
            for gage in gages_seen(&calibration) {
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
    fn a_gage_whose_gain_has_changed_is_named_though_the_load_turns() {
        for seed in 0..8 {
            let (mut sensor, calibration) = wrist(seed);
            for gage in gages_seen(&calibration) {
                let healthy = sensor.shape.clone();
                sensor.shape.column_mut(gage).scale_mut(1.3);
                let parity = check(&mut sensor, &calibration, 1.0, 1.0).parity.expect("eight gages for six");
                sensor.shape = healthy;
                assert!(!parity.passed, "{parity:?}");
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
        let found =
            verify(&calibration, &recording, KnownMass { mass_kg: 1.0, accuracy_kg: None, elsewhere: None });
        let found = found.expect("samples");
        assert!(found.magnitude_passed && found.parity.is_none(), "{found:?}");
    }

    #[test]
    fn a_single_rest_is_enough_and_gravity_counts_only_elsewhere() {
        let (mut sensor, mut calibration) = wrist(20);
        let rest = sensor.record(2.0, &[0.02, -0.01, 0.08], &vec![spatial(0.3, -0.5, 0.8); 300]);
        let here = KnownMass { mass_kg: 2.0, accuracy_kg: None, elsewhere: None };
        let exact = verify(&calibration, &rest, here).expect("samples");
        assert!(exact.magnitude_passed && exact.calibration_states_it, "{exact:?}");
        assert!(exact.samples.used > 200, "{:?}", exact.samples);

        // Of gravity so badly known, both C and m·g are wrong in one ratio.
        let relative = 0.05;
        let weight_n = 2.0 * STANDARD_GRAVITY;
        if let Some(uncertainty) = &mut calibration.uncertainty {
            uncertainty.gravity_accuracy = Some(relative * STANDARD_GRAVITY);
            let of_gravity = relative * weight_n / 3.0_f64.sqrt();
            for axis in 0..3 {
                let own = uncertainty.per_axis_full_load[axis];
                uncertainty.per_axis_full_load[axis] = own.hypot(of_gravity);
            }
        }
        let same_place = verify(&calibration, &rest, here).expect("samples");
        assert!((same_place.predicted_deviation_n / exact.predicted_deviation_n - 1.0).abs() < 1e-6);
        let there = KnownMass { elsewhere: Some(STANDARD_GRAVITY.into()), ..here };
        let elsewhere = verify(&calibration, &rest, there).expect("samples");
        let of_gravity = elsewhere.predicted_deviation_n.powi(2) - exact.predicted_deviation_n.powi(2);
        assert!((of_gravity.sqrt() / (relative * weight_n) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_calibration_that_states_nothing_is_judged_by_its_records() {
        let (mut sensor, mut calibration) = wrist(21);
        calibration.uncertainty = None;
        let found = check(&mut sensor, &calibration, 1.0, 1.0);
        assert!(found.magnitude_passed && !found.calibration_states_it, "{found:?}");
        assert!(!check(&mut sensor, &calibration, 1.2, 1.0).magnitude_passed);
    }
}
