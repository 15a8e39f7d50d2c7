//! Properties of the joint solution, on simulated sensors whose truth is known.

use ftcal_shared::units::Dof;
use nalgebra::{DVector, Rotation3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::calibration::synthetic::{Rests, Sensor, flat, spatial};
use crate::calibration::{Calibration, CalibrationRefusal, SolvedTrial, calibrate, staged};
use crate::session_file::STANDARD_GRAVITY;

const ROUGH: f64 = std::f64::consts::FRAC_PI_6;

fn solve(sensor: &Sensor, trials: &[SolvedTrial]) -> Result<Calibration, CalibrationRefusal> {
    calibrate(sensor.dof, STANDARD_GRAVITY, trials)
}

fn vector(direction: &DVector<f64>) -> Vector3<f64> {
    Vector3::new(direction[0], direction[1], direction[2])
}

fn unit(random: &mut ChaCha8Rng) -> Vector3<f64> {
    loop {
        let vector = Vector3::from_fn(|_, _| 2.0 * random.random::<f64>() - 1.0);
        if (0.1..1.0).contains(&vector.norm()) {
            return vector.normalize();
        }
    }
}

/// A trial with one known load in this direction, of which only something 30° off is known.
fn rough_trial(
    sensor: &mut Sensor,
    arm: &[f64],
    truth: &DVector<f64>,
    random: &mut ChaCha8Rng,
) -> SolvedTrial {
    let exact = Rests { directions: vec![truth.clone()], accuracy_rad: 0.0 };
    let mut trial = sensor.trial(2.0, arm, &exact);
    let axis = Unit::new_normalize(vector(truth).cross(&unit(random)));
    let off = Rotation3::from_axis_angle(&axis, ROUGH) * vector(truth);
    for load in &mut trial.case.known_loads {
        load.direction = spatial(off.x, off.y, off.z);
        load.accuracy_rad = ROUGH;
    }
    trial
}

/// Three arms about an equilateral triangle of this side, anywhere, and its normal.
fn triangle(side_m: f64, random: &mut ChaCha8Rng) -> ([Vector3<f64>; 3], Vector3<f64>) {
    let turn = Rotation3::from_scaled_axis(unit(random) * (3.0 * random.random::<f64>()));
    let centre = unit(random) * 0.05;
    let corner = |turns: f64| {
        let (sine, cosine) = (std::f64::consts::TAU * turns).sin_cos();
        let jitter = unit(random) * (0.1 * side_m);
        turn * (Vector3::new(cosine, sine, 0.0) * (side_m / 3_f64.sqrt()) + jitter)
    };
    let arms = [0.0, 1.0 / 3.0, 2.0 / 3.0].map(corner).map(|arm| arm + centre);
    let normal = (arms[1] - arms[0]).cross(&(arms[2] - arms[0])).normalize();
    (arms, normal)
}

/// A direction halfway between a plane and its normal.
fn well_off(normal: Vector3<f64>, random: &mut ChaCha8Rng) -> DVector<f64> {
    let inside = normal.cross(&unit(random)).normalize();
    let side = if random.random::<bool>() { 1.0 } else { -1.0 };
    let direction = inside + normal * side;
    spatial(direction.x, direction.y, direction.z)
}

/// Solves random sensors from three arms and one direction each that is 30° off; the median error and the worst.
fn rough_cases(count: u64) -> (f64, f64) {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut errors: Vec<f64> = (0..count)
        .map(|seed| {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
            let (arms, normal) = triangle(0.1, &mut random);
            let trials = arms.map(|arm| {
                let truth = well_off(normal, &mut random);
                rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random)
            });
            let calibration = solve(&sensor, &trials).expect("the rough directions choose");
            sensor.error_of(&calibration.matrix)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() - 1])
}

#[test]
fn rough_directions_choose_the_right_answer() {
    let (median, worst) = rough_cases(25);
    // The noise is 0.2 % of one newton's signal on a load of twenty: 1e-4 of it, and 1500 samples.
    assert!(median < 1e-3 && worst < 0.01, "median {median}, worst {worst}");
}

#[test]
fn without_noise_the_answer_is_exact() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for (seed, gages) in (0..5).zip([6, 7, 8, 9, 12]) {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, gages, seed);
        sensor.noise_counts = 0.0;
        let (arms, normal) = triangle(0.1, &mut random);
        let trials = arms.map(|arm| {
            let truth = well_off(normal, &mut random);
            rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random)
        });
        let calibration = solve(&sensor, &trials).expect("the rough directions choose");
        // Codes are whole counts, of some 4e5: rounding, less by the square root of 1500 samples, more by the arms.
        let error = sensor.error_of(&calibration.matrix);
        assert!(error < 1e-5, "seed {seed}: off by {error}");
    }
}

#[test]
fn a_fourth_arm_out_of_the_plane_needs_one_rough_direction_alone() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    for seed in 0..5 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let (arms, normal) = triangle(0.1, &mut random);
        let fourth = arms[0] + normal * 0.08;
        let truth = well_off(normal, &mut random);
        let mut trials = [arms[0], arms[1], arms[2], fourth]
            .map(|arm| rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random));
        for trial in &mut trials[1..] {
            trial.case.known_loads.clear();
        }
        let calibration = solve(&sensor, &trials).expect("one direction leaves one sign");
        assert!(sensor.error_of(&calibration.matrix) < 0.01);
        // The same direction with three arms in one plane leaves mirror images of the others.
        let refusal = solve(&sensor, &trials[..3]).expect_err("mirror images fit");
        assert!(matches!(refusal, CalibrationRefusal::HandednessNotSettled { .. }), "{refusal:?}");
        for trial in &mut trials {
            trial.case.known_loads.clear();
        }
        assert_eq!(solve(&sensor, &trials), Err(CalibrationRefusal::NoKnownLoad { trial: 0 }));
    }
}

#[test]
fn a_rough_direction_in_the_plane_of_the_arms_or_along_its_normal_is_refused() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for seed in 0..6 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let (arms, normal) = triangle(0.1, &mut random);
        let inside = normal.cross(&unit(&mut random)).normalize();
        let truth = if seed % 2 == 0 { normal } else { inside };
        let truth = spatial(truth.x, truth.y, truth.z);
        let trials = arms.map(|arm| rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random));
        let refusal = solve(&sensor, &trials).expect_err("another answer fits");
        assert!(matches!(refusal, CalibrationRefusal::HandednessNotSettled { .. }), "{refusal:?}");
    }
}

#[test]
fn the_plane_needs_one_rough_direction_a_trial() {
    for seed in 0..20 {
        let mut sensor = Sensor::new(Dof::PlanarForceTorque, 4, seed);
        // Halfway between the line of the arms and its normal: 30° either way is still closer than any other answer.
        let trials = [[0.1, 0.02], [-0.05, 0.02]].map(|arm| {
            let exact = Rests { directions: vec![flat(-0.785)], accuracy_rad: 0.0 };
            let mut trial = sensor.trial(1.0, &arm, &exact);
            trial.case.known_loads[0].direction = flat(-0.785 + if seed % 2 == 0 { ROUGH } else { -ROUGH });
            trial.case.known_loads[0].accuracy_rad = ROUGH;
            trial
        });
        let calibration = solve(&sensor, &trials).expect("the rough directions choose");
        let error = sensor.error_of(&calibration.matrix);
        assert!(error < 0.01, "seed {seed}: off by {error}");
    }
}

#[test]
fn the_joint_answer_is_four_times_better_than_the_staged_one() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    for side_m in [0.05, 0.15] {
        let (mut joint, mut stages) = (0.0_f64, 0.0_f64);
        let repetitions = 12;
        for seed in 0..repetitions {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 300 + seed);
            // 0.2 % of the signal of a load of two kilogram, whose gains are 2e4 counts a newton about.
            sensor.noise_counts = 0.002 * 2e4 * 2.0 * STANDARD_GRAVITY;
            let (arms, _) = triangle(side_m, &mut random);
            let loads = [unit(&mut random), unit(&mut random)].map(|load| spatial(load.x, load.y, load.z));
            let rests = Rests { directions: loads.to_vec(), accuracy_rad: 1e-3 };
            let trials = arms.map(|arm| {
                let mut trial = sensor.trial(2.0, arm.as_slice(), &rests);
                // As exact as they are here.
                (trial.case.arm_accuracy_m, trial.case.mass_accuracy_kg) = (1e-6, 2e-6);
                trial
            });
            let (Ok(ours), Ok(theirs)) =
                (solve(&sensor, &trials), staged::calibrate(sensor.dof, STANDARD_GRAVITY, &trials))
            else {
                continue;
            };
            joint += sensor.error_of(&ours.matrix).powi(2);
            stages += sensor.error_of(&theirs.matrix).powi(2);
        }
        let ratio = (stages / joint).sqrt();
        assert!(ratio > 4.0, "arms {side_m} m apart: {ratio}");
    }
}

#[test]
fn a_wrong_mass_is_named() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for seed in 0..3 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let (arms, normal) = triangle(0.1, &mut random);
        let truth = well_off(normal, &mut random);
        let mut trials = arms.map(|arm| rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random));
        trials[1].case.mass_kg *= 1.1;
        let refusal = solve(&sensor, &trials).expect_err("the masses contradict each other");
        let CalibrationRefusal::MassesContradict { trial: 1, ratio } = refusal else {
            panic!("{refusal:?}");
        };
        assert!((ratio - 1.0 / 1.1).abs() < 0.01, "{ratio}");
    }
}

#[test]
fn nearly_degenerate_arms_are_answered_rightly_or_refused() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut answered = 0;
    for seed in 0..40 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 700 + seed);
        let (mut arms, normal) = triangle(0.1, &mut random);
        // The third arm towards the line of the others, or all towards one point.
        let shrink = 10_f64.powf(-3.0 * random.random::<f64>());
        let middle = (arms[0] + arms[1]) / 2.0;
        if seed % 2 == 0 {
            arms[2] = middle + (arms[2] - middle) * shrink;
        } else {
            arms = arms.map(|arm| middle + (arm - middle) * shrink);
        }
        let trials = arms.map(|arm| {
            let truth = well_off(normal, &mut random);
            rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random)
        });
        if let Ok(calibration) = solve(&sensor, &trials) {
            answered += 1;
            let error = sensor.error_of(&calibration.matrix);
            assert!(error < 0.5, "seed {seed}, shrunk {shrink}: off by {error}");
        }
    }
    assert!(answered > 10, "{answered} answered");
}

#[test]
fn the_predicted_uncertainty_covers_the_error() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let (mut squares, mut elements) = (0.0, 0.0);
    let mut wrench_squares = DVector::zeros(6);
    let mut wrenches = 0.0;
    for seed in 0..80 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 900 + seed);
        sensor.noise_counts *= 10.0;
        let truth = crate::calibration::matrix_of_shape(&sensor.shape).expect("of full rank");
        let (arms, normal) = triangle(0.1, &mut random);
        let trials = arms.map(|arm| {
            let truth = well_off(normal, &mut random);
            let mut trial = rough_trial(&mut sensor, arm.as_slice(), &truth, &mut random);
            // As exact as they are.
            (trial.case.arm_accuracy_m, trial.case.mass_accuracy_kg) = (1e-8, 2e-8);
            trial
        });
        let calibration = solve(&sensor, &trials).expect("the rough directions choose");
        let uncertainty = calibration.uncertainty.clone().expect("the joint solution tells it");
        let deviations = (&calibration.matrix - truth).component_div(&uncertainty.matrix);
        squares += deviations.norm_squared();
        elements += deviations.len() as f64;
        let wrench = uncertainty.wrench.expect("the joint solution tells it of each wrench");
        for _ in 0..10 {
            // Up to the forces and torques of the trials.
            let share: f64 = random.random();
            let load = DVector::from_fn(6, |axis, _| {
                let full = if axis < 3 { 20.0 } else { 2.0 };
                share * full * (2.0 * random.random::<f64>() - 1.0)
            });
            let codes = &sensor.bias_counts + sensor.shape.transpose() * &load;
            let error = calibration.wrench(&codes) - &load;
            wrench_squares += error.component_div(&wrench.of(&load)).map(|error| error * error);
            wrenches += 1.0;
        }
    }
    // Eighty sensors of some dozen independent errors each: their root mean square is known to 2.5 %, three times that, and as much
    // again for a strain that is never less than one.
    let ratio = (squares / elements).sqrt();
    assert!((0.85..1.15).contains(&ratio), "{ratio}");
    // Of each component, eighty sensors of two independent errors at least, gain and offset: 5.6 %, three times that.
    for (component, squares) in wrench_squares.iter().enumerate() {
        let ratio = f64::sqrt(squares / wrenches);
        assert!((0.83..1.17).contains(&ratio), "component {component}: {ratio}");
    }
}

#[test]
fn an_unsettled_hand_is_that_of_the_trials_that_may_be_mirrored() {
    for seed in 0..5 {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (arms, normal) = triangle(0.1, &mut random);
        let all_round = Rests {
            directions: vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)],
            accuracy_rad: 1e-3,
        };
        // A load in the plane of the arms looks the same in the mirror.
        let inside = normal.cross(&unit(&mut random));
        let flat = spatial(inside.x, inside.y, inside.z);
        let trials = [
            sensor.trial(2.0, arms[0].as_slice(), &all_round),
            rough_trial_at(&mut sensor, arms[1].as_slice(), &flat),
            sensor.trial(2.0, arms[2].as_slice(), &all_round),
        ];
        let refused = solve(&sensor, &trials).map_err(|refusal| match refusal {
            CalibrationRefusal::LoadsInPlaneOfArms { trials } => trials,
            other => panic!("{other:?}"),
        });
        assert_eq!(refused.err(), Some(vec![1]));
    }
}

/// A trial with one known load in this direction, of which it is said that it may be 30° off.
fn rough_trial_at(sensor: &mut Sensor, arm: &[f64], direction: &DVector<f64>) -> SolvedTrial {
    let mut trial = sensor.trial(2.0, arm, &Rests { directions: vec![direction.clone()], accuracy_rad: 0.0 });
    for load in &mut trial.case.known_loads {
        load.accuracy_rad = ROUGH;
    }
    trial
}
