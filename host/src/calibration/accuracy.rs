//! What a calibration promises: how well it measures a load, from the uncertainty that its file states.
//!
//! Stated is, for each component k, the standard deviation sₖ of a wrench at full load: the root mean square over the loads of the
//! trials in all directions u. With E the relative error of the force rows (f is measured as (I + E)f + e) and F the full load,
//!
//! ```text
//! Σ sₖ² = F²‖E‖²/r + ‖e‖²        over the r force components, expected values throughout
//! ```
//!
//! The magnitude of a force F u is off by F uᵀEu + uᵀe. In the mean over all directions,
//!
//! ```text
//! ⟨(uᵀEu)²⟩ = (‖E‖² + tr E² + (tr E)²) / r(r + 2)  ≤  ‖E‖²/r,        ⟨(uᵀe)²⟩ = ‖e‖²/r
//! ```
//!
//! since tr E² ≤ ‖E‖² and (tr E)² ≤ r‖E‖². So the root of Σ sₖ² is what |f| may be off by: exactly that for an error of scale
//! (E = εI: mass and gravity, the greatest part as a rule), and more than needed for any other, whose cross-talk turns the force and
//! leaves its length. It holds for the mean over directions; a single direction can be √r times worse, if all of E were in its gain.
//!
//! Local gravity is in sₖ, too. At the place where the sensor was calibrated it cancels: C is too large in the same ratio as m·g. It is
//! taken out here, and who measures elsewhere adds it again ([`gravity_deviation`]).

use nalgebra::DVector;

use super::Calibration;
use super::joint::uncertainty::Uncertainty;
use super::known_load::mean_square_load;

/// The full load: the root mean square of the trials' weights, newton; `None` of no trial.
pub fn full_load_n(calibration: &Calibration) -> Option<f64> {
    let trials = calibration.trials.len();
    let squares: f64 =
        calibration.trials.iter().map(|trial| (trial.mass_kg * calibration.gravity).powi(2)).sum();
    (trials > 0 && squares > 0.0).then(|| (squares / trials as f64).sqrt())
}

/// Standard deviation of the magnitude of a force at full load, relative, gravity left out. `None` where the calibration states no
/// uncertainty.
pub fn force_deviation(calibration: &Calibration) -> Option<f64> {
    let uncertainty = calibration.uncertainty.as_ref()?;
    Some(group_deviation(calibration, uncertainty, 0..calibration.dof.trial_rank()))
}

/// The same for all components: that of the forces or that of the torques, whichever is larger.
pub fn wrench_deviation(calibration: &Calibration) -> Option<f64> {
    let uncertainty = calibration.uncertainty.as_ref()?;
    let (forces, components) = (calibration.dof.trial_rank(), calibration.dof.count());
    let of = |components| group_deviation(calibration, uncertainty, components);
    Some(if components > forces { of(0..forces).max(of(forces..components)) } else { of(0..forces) })
}

/// Standard deviation of local gravity where the sensor was calibrated, relative; zero where the calibration states none.
pub fn gravity_deviation(calibration: &Calibration) -> f64 {
    let accuracy = calibration.uncertainty.as_ref().and_then(|uncertainty| uncertainty.gravity_accuracy);
    accuracy.unwrap_or(0.0) / calibration.gravity
}

/// The share of the stated variance of the forces' rows of C that local gravity makes, 0 to 1.
pub fn share_of_gravity(calibration: &Calibration) -> f64 {
    let forces = calibration.dof.trial_rank();
    let Some(uncertainty) = &calibration.uncertainty else { return 0.0 };
    let whole = uncertainty.matrix.rows(0, forces).norm_squared();
    let of_gravity = (gravity_deviation(calibration) * calibration.matrix.rows(0, forces).norm()).powi(2);
    if whole > 0.0 { of_gravity / whole } else { 0.0 }
}

/// Standard deviation of some components of a wrench over what the trials loaded them with, gravity left out.
fn group_deviation(
    calibration: &Calibration,
    uncertainty: &Uncertainty,
    components: std::ops::Range<usize>,
) -> f64 {
    let loads = mean_square_loads(calibration);
    let sum = |of: &DVector<f64>| of.rows_range(components.clone()).sum();
    let (variance, load) =
        (sum(&uncertainty.per_axis_full_load.map(|deviation| deviation * deviation)), sum(&loads));
    let of_gravity = gravity_deviation(calibration).powi(2);
    if load > 0.0 { (variance / load - of_gravity).max(0.0).sqrt() } else { 0.0 }
}

/// The mean square of each component of the trials' loads, over all directions: newton² and (newton metre)².
fn mean_square_loads(calibration: &Calibration) -> DVector<f64> {
    let loads = calibration
        .trials
        .iter()
        .map(|trial| (DVector::from_column_slice(&trial.arm_m), trial.mass_kg * calibration.gravity));
    mean_square_load(calibration.dof.trial_rank(), calibration.dof.count(), loads).diagonal()
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::{DMatrix, DVector};

    use super::{force_deviation, full_load_n, share_of_gravity, wrench_deviation};
    use crate::calibration::calibrate;
    use crate::calibration::synthetic::{Rests, Sensor, spatial, sphere};
    use crate::gravity::Gravity;
    use crate::session_file::STANDARD_GRAVITY;

    const ARMS: [[f64; 3]; 3] = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];

    #[test]
    fn gravity_makes_forces_and_torques_less_certain_by_its_own_share_and_cancels_where_they_were_calibrated()
    {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 3);
        let directions = vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)];
        let rests = Rests { directions, accuracy_rad: 1e-3 };
        let trials: Vec<_> = ARMS.iter().map(|arm| sensor.trial(2.0, arm, &rests)).collect();
        let with = |accuracy: f64| {
            let gravity = Gravity { magnitude: STANDARD_GRAVITY, accuracy };
            calibrate(sensor.dof, gravity, &trials).expect("the evidence is good")
        };
        let (exact, guessed) = (with(0.0), with(0.015));
        assert_eq!(exact.matrix, guessed.matrix);
        let relative = 0.015 / STANDARD_GRAVITY;
        let deviations =
            |calibration: &crate::calibration::Calibration| calibration.uncertainty.clone().expect("stated");
        let (without, with) = (deviations(&exact), deviations(&guessed));
        // Variances add: (relative · C)² in each element, (relative · load)² in each component.
        let of_gravity =
            (with.matrix.map(|x| x * x) - without.matrix.map(|x| x * x)).map(|x| x.max(0.0).sqrt());
        assert!((of_gravity - exact.matrix.abs() * relative).norm() < 1e-6 * relative * exact.matrix.norm());
        let force = full_load_n(&exact).expect("trials") / 3.0_f64.sqrt();
        for axis in 0..3 {
            let squares = with.per_axis_full_load[axis].powi(2) - without.per_axis_full_load[axis].powi(2);
            assert!((squares.sqrt() / (relative * force) - 1.0).abs() < 1e-6);
        }
        for deviation in [force_deviation, wrench_deviation] {
            let (without, with) = (deviation(&exact).expect("stated"), deviation(&guessed).expect("stated"));
            assert!((with / without - 1.0).abs() < 1e-6, "{with} {without}");
        }
        assert_eq!(share_of_gravity(&exact), 0.0);
        let forces = |deviations: &DMatrix<f64>| deviations.rows(0, 3).norm_squared();
        let share = 1.0 - forces(&without.matrix) / forces(&with.matrix);
        assert!((share_of_gravity(&guessed) - share).abs() < 1e-6);
        // The masses, 0.1 %, are as certain as in any session, and gravity at a guess is 0.153 %: most of it.
        assert!((0.5..0.7).contains(&share), "{share}");
    }

    #[test]
    fn an_error_of_scale_is_promised_as_it_is_and_any_other_is_at_most_what_is_promised() {
        let directions = sphere(4000);
        let mean_square = |error: &DMatrix<f64>| {
            let squares = directions.iter().map(|u| (u.transpose() * error * u)[0].powi(2));
            squares.sum::<f64>() / directions.len() as f64
        };
        let promised = |error: &DMatrix<f64>| error.norm_squared() / 3.0;
        let scale = DMatrix::identity(3, 3) * 1e-3;
        assert!((mean_square(&scale) / promised(&scale) - 1.0).abs() < 1e-9);
        let mut sensor = Sensor::new(Dof::SpatialForce, 3, 1);
        for _ in 0..50 {
            let error = DMatrix::from_columns(&[sensor.unit(), sensor.unit(), sensor.unit()]);
            assert!(mean_square(&error) <= promised(&error) * (1.0 + 1e-3), "{error}");
        }
        // √r times that in the worst direction: all of E in the gain along it.
        let one_gain = DMatrix::from_diagonal(&DVector::from_vec(vec![1e-3, 0.0, 0.0]));
        assert!((3.0 * promised(&one_gain) / 1e-6 - 1.0).abs() < 1e-9);
    }
}
