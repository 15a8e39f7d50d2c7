//! Properties of the field re-calibration, on simulated sensors whose truth is known.

use ftcal_shared::units::Dof;
use nalgebra::{DMatrix, DVector};

use super::recalibrate;
use crate::calibration::drift::Moved;
use crate::calibration::joint::uncertainty::Uncertainty;
use crate::calibration::known_load::squashing_matrix;
use crate::calibration::matrix::matrix_of_shape;
use crate::calibration::synthetic::{Rests, Sensor, flat, spatial, sphere};
use crate::calibration::wrench_uncertainty::WrenchUncertainty;
use crate::calibration::{BiasOrigin, Calibration, CalibrationRefusal, Handedness, Method, SolvedTrial};
use crate::session_file::STANDARD_GRAVITY;

const ARMS: [[f64; 3]; 3] = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];

/// A calibration that is the truth.
fn truth(sensor: &Sensor) -> Calibration {
    Calibration {
        dof: sensor.dof,
        method: Method::Sfm,
        gain: None,
        gravity: STANDARD_GRAVITY,
        matrix: matrix_of_shape(&sensor.shape).expect("of full rank"),
        bias_counts: sensor.bias_counts.clone(),
        bias: BiasOrigin::Estimated,
        shape: sensor.shape.clone(),
        handedness: Handedness::Proven,
        fusion_residual: 0.0,
        uncertainty: None,
        trials: Vec::new(),
        checks: Vec::new(),
        drift: None,
    }
}

fn trials(sensor: &mut Sensor, arms: &[[f64; 3]]) -> Vec<SolvedTrial> {
    let none = Rests { directions: Vec::new(), accuracy_rad: 1e-3 };
    arms.iter().map(|arm| sensor.trial(2.0, arm, &none)).collect()
}

#[test]
fn a_gage_that_changed_its_gain_is_found_with_no_known_load() {
    for seed in 0..5 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let stored = truth(&sensor);
        sensor.shape.column_mut(3).scale_mut(1.04);
        let trials = trials(&mut sensor, &ARMS);
        let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("a small drift");
        let drift = found.drift.expect("what the reference is for");
        assert_eq!(drift.components_seen, 6);
        let worst = (0..8).max_by(|&a, &b| drift.gage_percent[a].total_cmp(&drift.gage_percent[b]));
        assert_eq!(worst, Some(3), "{:?}", drift.gage_percent);
        // The turn that hides in the change takes some of it.
        assert!((drift.gage_percent[3] - 4.0).abs() < 2.0, "{:?}", drift.gage_percent);
        let moved: Vec<Moved> = drift.gages().collect();
        assert!(moved[3].is_real(), "{moved:?}");
    }
}

#[test]
fn an_unchanged_sensor_has_not_moved_and_one_arm_leaves_the_rest_as_it_was() {
    for (arms, seen) in [(&ARMS[..], 6), (&ARMS[..1], 3)] {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 7);
        let stored = truth(&sensor);
        let trials = trials(&mut sensor, arms);
        let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("no drift");
        let drift = found.drift.expect("what the reference is for");
        assert_eq!(drift.components_seen, seen);
        // Noise of 0.01 % of the load and 1500 samples: far below a tenth of a per cent.
        assert!(
            drift.gage_percent.iter().chain(&drift.axis_percent).all(|&percent| percent < 0.1),
            "{drift:?}"
        );
        assert!(!drift.gages().chain(drift.axes()).any(Moved::is_real), "{drift:?}");
    }
}

#[test]
fn another_sensor_is_refused() {
    let stored = truth(&Sensor::new(Dof::SpatialForceTorque, 8, 1));
    let mut other = Sensor::new(Dof::SpatialForceTorque, 8, 2);
    let refused = recalibrate(&stored, STANDARD_GRAVITY, &trials(&mut other, &ARMS));
    assert!(matches!(refused, Err(CalibrationRefusal::ReferenceDiffers { trial: 0, .. })), "{refused:?}");

    let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 3);
    let stored = truth(&sensor);
    let change = DMatrix::from_fn(6, 8, |row, gage| if (row + gage) % 2 == 0 { 1.5 } else { 0.5 });
    sensor.shape.component_mul_assign(&change);
    let trials = trials(&mut sensor, &ARMS);
    assert!(recalibrate(&stored, STANDARD_GRAVITY, &trials).is_err());
}

/// What a calibration states that knows every element within this share of it, at the full load of `newton`.
fn stated(calibration: &Calibration, share: f64, newton: f64) -> Uncertainty {
    let forces = calibration.dof.trial_rank();
    Uncertainty {
        matrix: calibration.matrix.abs() * share,
        per_axis_full_load: DVector::from_fn(calibration.dof.count(), |axis, _| {
            share * newton * if axis < forces { 1.0 } else { 0.1 }
        }),
        wrench: Some(WrenchUncertainty {
            by_load: (0..calibration.dof.count())
                .map(|axis| {
                    let own = if axis < forces { 1.0 } else { 0.1 };
                    let diagonal = DVector::from_fn(calibration.dof.count(), |other, _| {
                        if other < forces { (share * own).powi(2) } else { 0.0 }
                    });
                    DMatrix::from_diagonal(&diagonal)
                })
                .collect(),
            with_bias: vec![DVector::zeros(calibration.dof.count()); calibration.dof.count()],
            unloaded: DVector::zeros(calibration.dof.count()),
        }),
        gravity_accuracy: Some(0.0),
    }
}

#[test]
fn the_stated_uncertainty_covers_the_error_whether_the_arms_see_all_or_not() {
    for (arms, seen) in [(&ARMS[..], 6), (&ARMS[..1], 3)] {
        for seed in 0..6 {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
            let mut stored = truth(&sensor);
            stored.uncertainty = Some(stated(&stored, 1e-3, 2.0 * STANDARD_GRAVITY));
            // One arm sees no more than its own combinations; what it does not see must not have moved.
            if seen == 6 {
                sensor.shape.column_mut(2).scale_mut(1.02);
            }
            let found =
                recalibrate(&stored, STANDARD_GRAVITY, &trials(&mut sensor, arms)).expect("it is small");
            assert_eq!(found.drift.as_ref().map(|drift| drift.components_seen), Some(seen));
            let uncertainty = found.uncertainty.expect("the stored one states its own");
            assert!(uncertainty.matrix.iter().all(|&deviation| deviation > 0.0));
            let error = &found.matrix * sensor.shape.transpose() - DMatrix::identity(6, 6);
            let directions = sphere_loads(arms);
            let wrench = uncertainty.wrench.as_ref().expect("the stored one states it of each wrench");
            for (axis, &deviation) in uncertainty.per_axis_full_load.iter().enumerate() {
                let mean = |squares: &dyn Fn(&DVector<f64>) -> f64| {
                    (directions.iter().map(squares).sum::<f64>() / directions.len() as f64).sqrt()
                };
                let actual = mean(&|load| (error.row(axis) * load)[0].powi(2));
                assert!(actual <= 3.0 * deviation, "axis {axis}: {actual} for {deviation}");
                let predicted = mean(&|load| wrench.of(load)[axis].powi(2));
                assert!(actual <= 3.0 * predicted, "axis {axis}: {actual} for {predicted}");
            }
        }
    }
}

/// The wrenches of 2 kg in many directions at these arms.
fn sphere_loads(arms: &[[f64; 3]]) -> Vec<DVector<f64>> {
    let at = |arm: &[f64; 3]| {
        let squashing = squashing_matrix(3, &DVector::from_column_slice(arm)).transpose();
        sphere(100).into_iter().map(move |direction| &squashing * direction * (2.0 * STANDARD_GRAVITY))
    };
    arms.iter().flat_map(at).collect()
}

#[test]
fn planar_sensors_are_oriented_by_what_they_were() {
    for (dof, arms) in
        [(Dof::PlanarForce, &[&[][..]][..]), (Dof::PlanarForceTorque, &[&[0.06, 0.01][..], &[-0.03, 0.05]])]
    {
        for seed in 0..5 {
            let mut sensor = Sensor::new(dof, 4, seed);
            let stored = truth(&sensor);
            sensor.shape.column_mut(1).scale_mut(0.97);
            let none = Rests { directions: Vec::new(), accuracy_rad: 1e-3 };
            let trials: Vec<SolvedTrial> = arms.iter().map(|arm| sensor.trial(1.0, arm, &none)).collect();
            let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("a small drift");
            // A turn of half the change of one gage in four at most is taken for none.
            assert!(sensor.error_of(&found.matrix) < 0.02, "{dof:?} {seed}");
            assert!(sensor.error_of(&found.matrix) < sensor.error_of(&stored.matrix), "{dof:?} {seed}");
        }
    }
}

#[test]
fn known_loads_are_compared_and_not_used() {
    let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 11);
    let stored = truth(&sensor);
    let rests =
        Rests { directions: vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.3, 0.0)], accuracy_rad: 1e-3 };
    let mut trials: Vec<SolvedTrial> = ARMS.iter().map(|arm| sensor.trial(2.0, arm, &rests)).collect();
    let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("all agrees");
    for trial in &found.trials {
        let solution = trial.solution.as_ref().expect("a motion");
        assert!((1e-6..0.3).contains(&solution.alignment_residual_deg), "{solution:?}");
    }
    for trial in &mut trials {
        trial.case.known_loads.clear();
    }
    let without = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("none is needed");
    assert_eq!(found.matrix, without.matrix);

    let mut trial = sensor.trial(2.0, &ARMS[0], &rests);
    trial.case.known_loads[1].direction = spatial(0.3, 1.0, 0.0);
    let refused = recalibrate(&stored, STANDARD_GRAVITY, &[trial]);
    let contradicts = CalibrationRefusal::KnownLoadsContradict { trial: 0, load: 1, angle_deg: 0.0 };
    let cause = refused.map_err(|refusal| std::mem::discriminant(&refusal));
    assert_eq!(cause.err(), Some(std::mem::discriminant(&contradicts)));
}

#[test]
fn another_gain_and_other_gages_are_told_from_a_drift() {
    let mut sensor = Sensor::new(Dof::PlanarForce, 4, 12);
    let stored = truth(&sensor);
    let rest = Rests { directions: vec![flat(0.0)], accuracy_rad: 1e-3 };
    sensor.shape *= 2.0;
    let refused = recalibrate(&stored, STANDARD_GRAVITY, &[sensor.trial(1.0, &[], &rest)]);
    let Err(CalibrationRefusal::ReferenceDiffers { scale, .. }) = refused else { panic!("{refused:?}") };
    assert!((scale - 2.0).abs() < 1e-2, "{scale}");

    let mut other = Sensor::new(Dof::PlanarForce, 3, 12);
    let refused = recalibrate(&stored, STANDARD_GRAVITY, &[other.trial(1.0, &[], &rest)]);
    assert_eq!(refused, Err(CalibrationRefusal::GagesDiffer { trial: 0, gages: 3, stored: 4 }));
}
