//! Tests of the whole way from codes to a calibration, on simulated sensors whose truth is known.

use ftcal_shared::units::Dof;
use nalgebra::{DVector, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::synthetic::{Rests, Sensor, flat, spatial};
use super::{Calibration, CalibrationRefusal, HandednessEvidence, SolvedTrial, calibrate};
use crate::session_file::{STANDARD_GRAVITY, Turning};

/// One milliradian, as the paper's fixture gives.
const PRECISE: f64 = 1e-3;

fn rests(accuracy_rad: f64, directions: &[DVector<f64>]) -> Rests {
    Rests { directions: directions.to_vec(), accuracy_rad }
}

/// Three directions that no mirror image shares.
fn three() -> Vec<DVector<f64>> {
    vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)]
}

/// Two directions, in the plane y = 0.
fn two() -> Vec<DVector<f64>> {
    vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.0, 0.0)]
}

fn solve(sensor: &Sensor, trials: &[SolvedTrial]) -> Result<Calibration, CalibrationRefusal> {
    calibrate(sensor.dof, STANDARD_GRAVITY, trials)
}

/// An answer may be off by the errors of the evidence, magnified by the arms: a few times the accuracy.
fn assert_right(sensor: &Sensor, trials: &[SolvedTrial], accuracy_rad: f64) -> Calibration {
    let calibration = solve(sensor, trials).expect("the evidence settles the answer");
    let error = sensor.error_of(&calibration.matrix);
    assert!(error < 10.0 * (accuracy_rad + 1e-3), "off by {error}");
    let bias_error = (&calibration.bias_counts - &sensor.bias_counts).amax();
    assert!(bias_error < 10.0 * sensor.noise_counts, "bias off by {bias_error}");
    calibration
}

#[test]
fn the_fingertip_is_recovered_from_two_known_loads_or_one_and_the_sense_of_turning() {
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, seed);
        let precise_and_rough = Rests { directions: vec![flat(0.3), flat(2.0)], accuracy_rad: PRECISE };
        let trial = sensor.trial(1.0, &[], &precise_and_rough);
        let calibration = assert_right(&sensor, &[trial], PRECISE);
        let evidence = calibration.trials[0].solution.as_ref().map(|solution| solution.handedness);
        assert_eq!(evidence, Some(HandednessEvidence::KnownLoads));

        let one = rests(PRECISE, &[flat(-1.57)]);
        let trial = sensor.turned_trial(1.0, &[], &one, Turning::Counterclockwise);
        assert_right(&sensor, std::slice::from_ref(&trial), PRECISE);
        // Said the other way round, the answer is mirrored: nothing else could tell.
        let mirrored = sensor.turned_trial(1.0, &[], &one, Turning::Clockwise);
        let wrong = solve(&sensor, &[mirrored]).expect("one load cannot contradict it");
        assert!(sensor.error_of(&wrong.matrix) > 1.0);
        // With two known loads it is contradicted.
        let mirrored = sensor.turned_trial(1.0, &[], &precise_and_rough, Turning::Clockwise);
        assert_eq!(solve(&sensor, &[mirrored]), Err(CalibrationRefusal::TurningContradicts { trial: 0 }));
    }
}

#[test]
fn a_second_rough_load_settles_the_plane() {
    let mut sensor = Sensor::new(Dof::PlanarForce, 4, 11);
    let mut trial = sensor.trial(1.0, &[], &rests(PRECISE, &[flat(0.0), flat(1.6)]));
    trial.case.known_loads[1].accuracy_rad = 30_f64.to_radians();
    assert_right(&sensor, &[trial], PRECISE);
}

#[test]
fn one_load_in_the_plane_leaves_a_mirror_image() {
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, seed);
        for directions in
            [vec![flat(0.4)], vec![flat(0.4), flat(0.4)], vec![flat(0.4), flat(0.4 + std::f64::consts::PI)]]
        {
            let trial = sensor.trial(1.0, &[], &rests(PRECISE, &directions));
            let refusal = solve(&sensor, &[trial]).expect_err("a mirror image fits");
            assert!(matches!(refusal, CalibrationRefusal::HandednessNotSettled { .. }), "{refusal:?}");
        }
    }
}

#[test]
fn the_force_sensor_is_recovered_from_three_known_loads() {
    for (seed, gages) in (0..10).zip([3, 4, 6, 8, 12].into_iter().cycle()) {
        let mut sensor = Sensor::new(Dof::SpatialForce, gages, seed);
        let trial = sensor.trial(1.5, &[], &rests(PRECISE, &three()));
        assert_right(&sensor, &[trial], PRECISE);
    }
}

#[test]
fn two_loads_in_space_or_three_in_one_plane_leave_a_mirror_image() {
    let coplanar = [two(), vec![spatial(-1.0, 0.0, 1.0)]].concat();
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, seed);
        for directions in [two(), coplanar.clone()] {
            // A second trial with the same loads shares the mirror image.
            let trial = sensor.trial(1.5, &[], &rests(PRECISE, &directions));
            let again = sensor.trial(1.0, &[], &rests(PRECISE, &directions));
            for trials in [vec![trial.clone()], vec![trial, again]] {
                let refusal = solve(&sensor, &trials).expect_err("a mirror image fits");
                assert!(matches!(refusal, CalibrationRefusal::HandednessNotSettled { .. }), "{refusal:?}");
            }
        }
    }
}

#[test]
fn known_loads_that_leave_a_turn_free_are_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForce, 6, 3);
    for directions in [vec![spatial(0.0, 0.0, 1.0)], vec![spatial(0.0, 0.0, 1.0), spatial(0.0, 0.0, -1.0)]] {
        let trial = sensor.trial(1.0, &[], &rests(PRECISE, &directions));
        let refusal = solve(&sensor, &[trial]).expect_err("a turn is free");
        assert!(matches!(refusal, CalibrationRefusal::KnownLoadsDoNotOrient { .. }), "{refusal:?}");
    }
    let trial = sensor.trial(1.0, &[], &rests(PRECISE, &[]));
    assert_eq!(solve(&sensor, &[trial]), Err(CalibrationRefusal::NoKnownLoad { trial: 0 }));
}

#[test]
fn the_planar_force_torque_sensor_is_recovered_from_two_arms() {
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::PlanarForceTorque, 4, seed);
        let one = rests(PRECISE, &[flat(-1.57)]);
        let trials = [[0.1, 0.02], [-0.05, 0.0]]
            .map(|arm| sensor.turned_trial(1.0, &arm, &one, Turning::Counterclockwise));
        assert_right(&sensor, &trials, PRECISE);
        // The arms differ neither along the loads nor across them, so the trials fit together in one way only.
        let trials = [[0.1, 0.0], [-0.0, 0.1]].map(|arm| sensor.trial(1.0, &arm, &one));
        let calibration = assert_right(&sensor, &trials, PRECISE);
        let evidence = calibration.trials[0].solution.as_ref().map(|solution| solution.handedness);
        assert_eq!(evidence, Some(HandednessEvidence::Fusion));
        // Arms that differ along the load: the mirror image fits as well.
        let trials = [[0.0, 0.1], [-0.0, -0.05]].map(|arm| sensor.trial(1.0, &arm, &one));
        let refusal = solve(&sensor, &trials).expect_err("a mirror image fits");
        assert!(matches!(refusal, CalibrationRefusal::LoadsInPlaneOfArms { .. }), "{refusal:?}");
    }
}

#[test]
fn the_wrist_is_recovered_from_three_arms() {
    let arms = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let trials = arms.map(|arm| sensor.trial(2.0, &arm, &rests(PRECISE, &three())));
        assert_right(&sensor, &trials, PRECISE);
        // Two loads an arm, as in the paper: the arms lie in general position, so the trials settle it together.
        let trials = arms.map(|arm| sensor.trial(2.0, &arm, &rests(PRECISE, &two())));
        assert_right(&sensor, &trials, PRECISE);
    }
}

#[test]
fn arms_in_the_plane_of_two_loads_leave_a_mirror_image() {
    for seed in 0..10 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let arms = [[0.1, 0.0, 0.05], [-0.1, 0.0, 0.05], [0.0, 0.0, 0.12]];
        let trials = arms.map(|arm| sensor.trial(2.0, &arm, &rests(PRECISE, &two())));
        let refusal = solve(&sensor, &trials).expect_err("the all-mirrored answer fits");
        assert!(matches!(&refusal, CalibrationRefusal::LoadsInPlaneOfArms { trials } if trials.len() == 3));
    }
}

#[test]
fn no_near_degenerate_geometry_gives_a_wrong_answer() {
    let (mut answered, mut refused) = (0, 0);
    for seed in 0..60 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 1000 + seed);
        // Arms close to the plane of the two loads, all turned at random together, so that no axis is special.
        let off = 10_f64.powf(-4.5 + 3.5 * seed as f64 / 59.0);
        let axis = sensor.unit();
        let turn = Rotation3::from_scaled_axis(Vector3::new(axis[0], axis[1], axis[2]) * 3.0);
        let turned = |x: f64, y: f64, z: f64| turn * Vector3::new(x, y, z);
        let loads =
            [turned(0.0, 0.0, -1.0), turned(1.0, 0.0, 0.0)].map(|load| spatial(load.x, load.y, load.z));
        let arms = [turned(0.1, off, 0.05), turned(-0.1, -off, 0.05), turned(0.0, 0.0, 0.12)];
        let trials = arms.map(|arm| sensor.trial(2.0, arm.as_slice(), &rests(PRECISE, &loads)));
        match solve(&sensor, &trials) {
            Ok(calibration) => {
                answered += 1;
                let error = sensor.error_of(&calibration.matrix);
                assert!(error < 0.05, "seed {seed}: off by {error}");
            }
            Err(refusal) => {
                refused += 1;
                assert!(
                    matches!(refusal, CalibrationRefusal::LoadsInPlaneOfArms { .. }),
                    "{seed}: {refusal:?}"
                );
            }
        }
    }
    assert!(answered > 10 && refused > 10, "{answered} answered, {refused} refused");
}

#[test]
fn arms_that_leave_a_torque_unseen_are_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 4);
    let mut trial = |arm: [f64; 3]| sensor.trial(2.0, &arm, &rests(PRECISE, &three()));
    let (a, b, c, d) =
        (trial([0.1, 0., 0.]), trial([0., 0.1, 0.]), trial([-0.1, 0.2, 0.]), trial([0.1, 0., 0.]));
    let refused = |trials: &[SolvedTrial]| calibrate(Dof::SpatialForceTorque, STANDARD_GRAVITY, trials);
    assert_eq!(refused(&[a.clone(), b.clone()]), Err(CalibrationRefusal::TooFewArms { have: 2, need: 3 }));
    assert_eq!(refused(&[a.clone(), b, c]), Err(CalibrationRefusal::ArmsCollinear { arms: 3 }));
    let equal = refused(&[a.clone(), d, a]);
    assert!(matches!(equal, Err(CalibrationRefusal::ArmsEqual { arms: 3, .. })), "{equal:?}");
}

#[test]
fn a_wrong_mass_arm_or_direction_is_refused() {
    let arms = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];
    for seed in 0..5 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let trials = arms.map(|arm| sensor.trial(2.0, &arm, &rests(PRECISE, &three())));
        let contradicts = |trials: &[SolvedTrial]| {
            let refusal =
                calibrate(Dof::SpatialForceTorque, STANDARD_GRAVITY, trials).expect_err("it contradicts");
            assert!(matches!(refusal, CalibrationRefusal::TrialsContradict { .. }), "{refusal:?}");
        };
        let mut wrong = trials.clone();
        wrong[1].case.mass_kg *= 1.1;
        let refusal =
            calibrate(Dof::SpatialForceTorque, STANDARD_GRAVITY, &wrong).expect_err("it contradicts");
        assert!(matches!(refusal, CalibrationRefusal::MassesContradict { trial: 1, .. }), "{refusal:?}");
        let mut wrong = trials.clone();
        wrong[2].case.arm_m[0] += 0.02;
        contradicts(&wrong);
        let mut wrong = trials.clone();
        wrong[0].case.known_loads.iter_mut().for_each(|load| load.direction.neg_mut());
        let refusal =
            calibrate(Dof::SpatialForceTorque, STANDARD_GRAVITY, &wrong).expect_err("it contradicts");
        assert!(matches!(refusal, CalibrationRefusal::TrialsContradict { .. }), "{refusal:?}");
        let mut wrong = trials.clone();
        wrong[0].case.known_loads[1].direction = spatial(1.0, 0.8, 0.0);
        let refusal =
            calibrate(Dof::SpatialForceTorque, STANDARD_GRAVITY, &wrong).expect_err("it contradicts");
        assert!(matches!(refusal, CalibrationRefusal::KnownLoadsContradict { trial: 0, .. }), "{refusal:?}");
    }
}

#[test]
fn known_loads_of_another_magnitude_or_that_move_are_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForce, 6, 5);
    let good = sensor.trial(1.0, &[], &rests(PRECISE, &three()));
    let mut heavier = good.clone();
    heavier.case.known_loads[2] =
        sensor.trial(1.3, &[], &rests(PRECISE, &three())).case.known_loads[2].clone();
    let refusal = solve(&sensor, &[heavier]).expect_err("another mass");
    assert!(matches!(refusal, CalibrationRefusal::KnownLoadMagnitude { load: 2, .. }), "{refusal:?}");
    let mut moving = good;
    let shape = &moving.shape.shape_counts_per_load;
    moving.case.known_loads[0].rest.drift = shape.row(1).transpose() * 0.1;
    let refusal = solve(&sensor, &[moving]).expect_err("it moved");
    assert!(matches!(refusal, CalibrationRefusal::KnownLoadNotAtRest { load: 0, .. }), "{refusal:?}");
}

#[test]
fn trials_of_different_sensors_are_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForce, 6, 6);
    let first = sensor.trial(1.0, &[], &rests(PRECISE, &three()));
    sensor.bias_counts[3] += 1e6;
    let second = sensor.trial(1.0, &[], &rests(PRECISE, &three()));
    let refusal = solve(&sensor, &[first, second]).expect_err("the biases differ");
    assert!(matches!(refusal, CalibrationRefusal::BiasesDisagree { .. }), "{refusal:?}");
}

#[test]
fn fewer_gages_than_components_are_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForceTorque, 6, 7);
    sensor.shape = sensor.shape.columns(0, 5).into_owned();
    sensor.bias_counts = sensor.bias_counts.rows(0, 5).into_owned();
    let trial = sensor.trial(1.0, &[0.1, 0.0, 0.0], &rests(PRECISE, &three()));
    assert_eq!(solve(&sensor, &[trial]), Err(CalibrationRefusal::TooFewGages { gages: 5, need: 6 }));
}

#[test]
fn a_component_that_the_gages_do_not_see_is_refused() {
    let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 8);
    sensor.shape.row_mut(5).fill(0.0);
    let arms = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];
    let trials = arms.map(|arm| sensor.trial(2.0, &arm, &rests(PRECISE, &three())));
    assert_eq!(solve(&sensor, &trials), Err(CalibrationRefusal::ShapeRankDeficient));
}

#[test]
fn random_sessions_are_answered_rightly_or_refused() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for (dof, known_loads) in [
        (Dof::PlanarForce, 2),
        (Dof::PlanarForceTorque, 1),
        (Dof::SpatialForce, 3),
        (Dof::SpatialForceTorque, 2),
        (Dof::SpatialForceTorque, 3),
    ] {
        let rank = dof.trial_rank();
        let mut answered = 0;
        for seed in 0..30 {
            let mut sensor = Sensor::new(dof, dof.count() + 2, 5000 + seed);
            let loads: Vec<DVector<f64>> = (0..known_loads).map(|_| sensor.unit()).collect();
            let arms = if dof.has_torque() { rank } else { 1 };
            let trials: Vec<SolvedTrial> = (0..arms)
                .map(|_| {
                    let components = if dof.has_torque() { rank } else { 0 };
                    let arm: Vec<f64> =
                        (0..components).map(|_| 0.2 * (random.random::<f64>() - 0.5)).collect();
                    sensor.trial(1.5, &arm, &rests(PRECISE, &loads))
                })
                .collect();
            if let Ok(calibration) = solve(&sensor, &trials) {
                answered += 1;
                // A mirror image is off by one or more; badly placed arms magnify a milliradian a hundredfold.
                let error = sensor.error_of(&calibration.matrix);
                assert!(error < 0.3, "{dof:?}, seed {seed}: off by {error}");
            }
        }
        assert!(answered >= 25, "{dof:?}: {answered} of 30 answered");
    }
}
