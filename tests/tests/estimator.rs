//! Properties of the estimator: what must not change the answer, and what must be refused.

#![expect(
    clippy::cast_possible_truncation,
    reason = "codes and matrices are rounded to what the sensor holds"
)]

use ftcal_shared::estimation::application::RealTimeCalibration;
use ftcal_shared::estimation::calibration::calibration_matrix;
use ftcal_shared::estimation::moments::Moments;
use ftcal_shared::estimation::shape::{TrialSolution, solve_trial};
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, Dof, MAX_RANK, Rank};
use ftcal_tests::{KnownSensor, moments_of, random, shape_difference};
use nalgebra::{Rotation3, SMatrix, SVector, Vector3};
use proptest::prelude::{ProptestConfig, any, prop_assert, prop_assert_eq, proptest};
use rand_distr::{Distribution, StandardNormal};

fn solve_wrist(codes: &[[AdcCode; 8]]) -> Result<TrialSolution<8>, Refusal> {
    solve_trial::<8, 450>(&moments_of(codes), Rank::Spatial)
}

/// Relative error of SᵀS to expect: an off-diagonal coefficient of an isotropic sensor has a standard deviation of
/// √3.75·σ/(F√n), a gain √6·σ/(F√n) (design § 3); six standard deviations, for the ill-shaped among random sensors 4 times.
fn allowed(relative_noise: f64, samples: f64) -> f64 {
    4.0 * 6.0 * 2.0 * 6_f64.sqrt() * relative_noise / samples.sqrt()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_spatial_trial_recovers_shape_and_bias(seed in any::<u64>()) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let solution = solve_wrist(&sensor.trial(2000, &mut rng)).unwrap();
        let error = shape_difference(&solution.shape_counts_per_load, &sensor.shape);
        prop_assert!(error < allowed(1e-3, 2000.0), "{error}");
        let bias = (solution.bias_counts - sensor.bias).amax() / 300_000.0;
        prop_assert!(bias < allowed(1e-3, 2000.0), "{bias}");
    }

    #[test]
    fn a_planar_trial_recovers_shape_and_bias(seed in any::<u64>()) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<4, 2>::random(&mut rng, 300_000.0, 300.0);
        let solution = solve_trial::<4, 55>(&moments_of(&sensor.trial(2000, &mut rng)), Rank::Planar).unwrap();
        let error = shape_difference(&solution.shape_counts_per_load, &sensor.shape);
        prop_assert!(error < allowed(1e-3, 2000.0), "{error}");
    }

    /// The noise of one channel is known from the redundant eigenvalues: 5 · 2000 squares average to within 1/√5000.
    #[test]
    fn the_redundant_eigenvalues_tell_the_noise(seed in any::<u64>()) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let solution = solve_wrist(&sensor.trial(2000, &mut rng)).unwrap();
        let noise = solution.noise_variance.unwrap().sqrt();
        prop_assert!((noise / 300.0 - 1.0).abs() < 5.0 / (2.0 * 5000_f64).sqrt(), "{noise}");
    }

    #[test]
    fn merging_is_associative_and_commutative(seed in any::<u64>(), first in 0..300_usize, second in 0..300_usize) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<4, 3>::random(&mut rng, 1e6, 1e3);
        let codes_of_the_trial = sensor.trial(700, &mut rng);
        let part = |codes: &[[AdcCode; 4]]| {
            let mut moments = Moments::<4, 55>::new(codes_of_the_trial[0]);
            for sample in codes {
                moments.push(sample).unwrap();
            }
            moments
        };
        let (a, rest) = codes_of_the_trial.split_at(first);
        let (b, c) = rest.split_at(second);
        let (a, b, c, all) = (part(a), part(b), part(c), part(&codes_of_the_trial));

        let mut left = a.clone();
        left.merge(&b).unwrap();
        left.merge(&c).unwrap();
        let mut tail = c.clone();
        tail.merge(&b).unwrap();
        let mut right = tail;
        right.merge(&a).unwrap();
        let mut one_pass = all;
        one_pass.settle();
        // Exact sums: the same to the last bit.
        prop_assert_eq!(left.codes().covariance(), right.codes().covariance());
        prop_assert_eq!(left.codes().covariance(), one_pass.codes().covariance());
        prop_assert_eq!(left.codes().mean().counts, one_pass.codes().mean().counts);
        // All sums, through the solution: the rounding of the sums of degree 3 and 4, which a flat shape amplifies by the fourth power of how
        // flat it is, stays well below what the trial leaves uncertain.
        let [left, right, one_pass] =
            [left, right, one_pass].map(|moments| solve_trial::<4, 55>(&moments, Rank::Spatial).unwrap());
        let allowed = one_pass.uncertainty.worst_relative() / 4.0;
        for other in [right, one_pass] {
            let difference = shape_difference(&left.shape_counts_per_load, &other.shape_counts_per_load);
            prop_assert!(difference < allowed, "{difference} > {allowed}");
        }
    }

    /// Turning the frame in which the loads are given changes no code but by rounding, and so not the answer.
    #[test]
    fn the_sensor_frame_does_not_matter(seed in any::<u64>(), roll in 0.0..6.2, pitch in -1.5..1.5, yaw in 0.0..6.2) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<6, 3>::random(&mut rng, 300_000.0, 0.0);
        let turn = Rotation3::from_euler_angles(roll, pitch, yaw).into_inner();
        let turned = KnownSensor { shape: turn * sensor.shape, ..sensor.clone() };
        let directions: Vec<Vector3<f64>> =
            (0..500).map(|_| Vector3::from_fn(|_, _| rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut rng))).collect();
        let codes: Vec<_> = directions.iter().map(|m| sensor.codes(m, &mut rng)).collect();
        let codes_turned: Vec<_> = directions.iter().map(|m| turned.codes(&(turn * m), &mut rng)).collect();
        let solution = solve_trial::<6, 182>(&moments_of(&codes), Rank::Spatial).unwrap();
        let solution_turned = solve_trial::<6, 182>(&moments_of(&codes_turned), Rank::Spatial).unwrap();
        let difference = shape_difference(&solution.shape_counts_per_load, &solution_turned.shape_counts_per_load);
        prop_assert!(difference < 1e-5, "{difference}");
    }

    #[test]
    fn the_order_of_the_gages_does_not_matter(seed in any::<u64>(), rotation in 1..8_usize) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let codes = sensor.trial(500, &mut rng);
        let permuted: Vec<[AdcCode; 8]> =
            codes.iter().map(|sample| core::array::from_fn(|gage| sample[(gage + rotation) % 8])).collect();
        let solution = solve_wrist(&codes).unwrap();
        let solution_permuted = solve_wrist(&permuted).unwrap();
        let back = SMatrix::<f64, MAX_RANK, 8>::from_fn(|row, gage| {
            solution_permuted.shape_counts_per_load[(row, (gage + 8 - rotation) % 8)]
        });
        let difference = shape_difference(&solution.shape_counts_per_load, &back);
        prop_assert!(difference < 1e-5, "{difference}");
    }

    #[test]
    fn the_unit_of_the_codes_does_not_matter(seed in any::<u64>(), factor in 2..20_i64) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 30_000.0, 30.0);
        let codes = sensor.trial(500, &mut rng);
        let scaled: Vec<[AdcCode; 8]> = codes
            .iter()
            .map(|sample| sample.map(|code| AdcCode::saturating(i64::from(code.counts()) * factor)))
            .collect();
        let solution = solve_wrist(&codes).unwrap();
        let solution_scaled = solve_wrist(&scaled).unwrap();
        #[expect(clippy::cast_precision_loss)]
        let back = solution_scaled.shape_counts_per_load / factor as f64;
        let difference = shape_difference(&solution.shape_counts_per_load, &back);
        prop_assert!(difference < 1e-5, "{difference}");
    }

    /// A load that stays in a plane cannot calibrate a spatial sensor, redundant gages or not.
    #[test]
    fn planar_motion_is_refused_for_a_spatial_sensor(seed in any::<u64>()) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let planar = KnownSensor { shape: sensor.shape.fixed_rows::<2>(0).into_owned(), bias: sensor.bias, noise: sensor.noise };
        prop_assert!(solve_wrist(&planar.trial(2000, &mut rng)).is_err());

        let three = KnownSensor::<3, 3>::random(&mut rng, 300_000.0, 300.0);
        let planar = KnownSensor { shape: three.shape.fixed_rows::<2>(0).into_owned(), bias: three.bias, noise: three.noise };
        prop_assert!(solve_trial::<3, 25>(&moments_of(&planar.trial(2000, &mut rng)), Rank::Spatial).is_err());
    }

    /// The six faces of a cube leave three of nine coefficients open (design § 4).
    #[test]
    fn the_faces_of_a_cube_are_refused(seed in any::<u64>()) {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let codes: Vec<_> = (0..1200)
            .map(|sample: usize| {
                let sign = if sample.is_multiple_of(2) { 1.0 } else { -1.0 };
                let direction = SVector::<f64, 3>::from_fn(|row, _| if row == (sample / 2) % 3 { sign } else { 0.0 });
                sensor.codes(&direction, &mut rng)
            })
            .collect();
        let refused = matches!(solve_wrist(&codes), Err(Refusal::MotionDoesNotSpan { .. } | Refusal::MetricNotPositiveDefinite));
        prop_assert!(refused);
    }
}

/// The calibration matrix of a recovered shape gives every load back, applied as the sensor applies it (eq. 1, 5): within
/// single precision of what the exact matrix gives.
#[test]
fn the_applied_calibration_gives_the_loads_back() {
    let mut rng = random(3);
    let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 0.0);
    let matrix = calibration_matrix(&sensor.shape).unwrap();
    let rows: Vec<f32> =
        matrix.row_iter().flat_map(|row| row.iter().map(|&c| c as f32).collect::<Vec<_>>()).collect();
    let applied = RealTimeCalibration::<8>::new(Dof::SpatialForce, &rows, sensor.bias.as_slice()).unwrap();
    for codes in sensor.trial(200, &mut rng) {
        let exact = matrix * (SVector::from_fn(|gage, _| f64::from(codes[gage].counts())) - sensor.bias);
        let wrench = applied.apply(&codes);
        for axis in 0..3 {
            assert!((f64::from(wrench[axis]) - exact[axis]).abs() < 8.0 * f64::from(f32::EPSILON) * 4.0);
        }
        assert_eq!(wrench[3..], [0.0; 3]);
    }
}

/// A load that is not constant is no shape-from-motion load, however many samples there are.
#[test]
fn a_load_that_changes_is_refused() {
    for seed in 0..20 {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let codes: Vec<_> = (0..20_000)
            .map(|_| {
                let mut gaussian = || -> f64 { StandardNormal.sample(&mut rng) };
                let load = Vector3::from_fn(|_, _| 0.6 * gaussian());
                let exact = sensor.bias + sensor.shape.transpose() * load;
                core::array::from_fn(|gage| {
                    AdcCode::saturating((exact[gage] + 300.0 * gaussian()).round() as i64)
                })
            })
            .collect();
        let refusal = solve_wrist(&codes).expect_err("the load is Gaussian");
        assert!(matches!(refusal, Refusal::MagnitudeNotConstant { .. }), "{refusal:?}");
    }
}

/// A spatial load is no planar one, even where one direction is weak.
#[test]
fn a_rank_too_low_is_refused() {
    for seed in 0..20 {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
        let moments = moments_of::<8, 450>(&sensor.trial(2000, &mut rng));
        let refusal = solve_trial::<8, 450>(&moments, Rank::Planar).expect_err("the load turns in space");
        assert!(
            matches!(refusal, Refusal::RankExceeded { .. } | Refusal::NoEigenvalueGap { .. }),
            "{refusal:?}"
        );
    }
}

#[test]
fn nothing_and_too_little_are_refused() {
    let empty = moments_of::<8, 450>(&[]);
    assert!(matches!(
        solve_trial::<8, 450>(&empty, Rank::Spatial),
        Err(Refusal::TooFewSamples { have: 0, .. })
    ));
    let mut rng = random(1);
    let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
    assert!(matches!(solve_wrist(&sensor.trial(10, &mut rng)), Err(Refusal::TooFewSamples { have: 10, .. })));
}

#[test]
fn a_sensor_at_rest_is_refused() {
    let mut rng = random(2);
    let sensor = KnownSensor::<8, 3>::random(&mut rng, 300_000.0, 300.0);
    let rest: Vec<_> = (0..1000).map(|_| sensor.codes(&Vector3::z(), &mut rng)).collect();
    assert!(matches!(solve_wrist(&rest), Err(Refusal::NoEigenvalueGap { .. })));
    let constant = vec![[AdcCode::new(1000).unwrap(); 8]; 1000];
    assert!(matches!(solve_wrist(&constant), Err(Refusal::RankNotReached { have: 0, need: 3 })));
}

/// With as many gages as directions nothing redundant tells the noise, and noise alone fills a ball that is no worse a fit
/// for an ellipsoid than any.
#[test]
fn noise_is_not_taken_for_a_motion_where_nothing_redundant_tells_it() {
    for seed in 0..20 {
        let mut rng = random(seed);
        let sensor = KnownSensor::<3, 3>::random(&mut rng, 300_000.0, 300.0);
        let rest: Vec<_> = (0..1000).map(|_| sensor.codes(&Vector3::z(), &mut rng)).collect();
        assert!(solve_trial::<3, 25>(&moments_of(&rest), Rank::Spatial).is_err());
        let turning = sensor.trial(1000, &mut rng);
        assert!(solve_trial::<3, 25>(&moments_of(&turning), Rank::Spatial).is_ok());
    }
}
