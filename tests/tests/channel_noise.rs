//! Noise that differs from channel to channel: measured while the load hangs still, and put to use.

use ftcal_shared::estimation::bins::{Bins, QuietSolution};
use ftcal_shared::estimation::gate::Verdict;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::{AdcCode, Rank};
use ftcal_tests::{KnownSensor, random};
use nalgebra::{SMatrix, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};

/// Signal of the sensor, counts per unit load.
const SIGNAL: f64 = 1e5;

/// Samples in each direction, and how many directions.
const DWELL: usize = 100;
const DIRECTIONS: usize = 60;

/// A load that rests in random directions and goes from one to the next between two samples, seen through channels with noise of
/// these standard deviations, counts.
fn rests<const GAGES: usize>(
    sensor: &KnownSensor<GAGES, 3>,
    noise: &[f64; GAGES],
    rng: &mut ChaCha8Rng,
) -> Vec<[AdcCode; GAGES]> {
    let mut codes = Vec::with_capacity(DWELL * DIRECTIONS);
    for _ in 0..DIRECTIONS {
        let direction: Vector3<f64> = Vector3::from(UnitSphere.sample(rng));
        let exact = sensor.bias + sensor.shape.transpose() * direction;
        for _ in 0..DWELL {
            codes.push(core::array::from_fn(|gage| {
                let standard: f64 = StandardNormal.sample(rng);
                #[expect(clippy::cast_possible_truncation, reason = "rounded to whole counts")]
                AdcCode::saturating((exact[gage] + noise[gage] * standard).round() as i64)
            }));
        }
    }
    codes
}

fn solve<const GAGES: usize, const HIGHER: usize>(
    codes: &[[AdcCode; GAGES]],
    gated: bool,
) -> QuietSolution<GAGES> {
    let mut bins = Box::new(Bins::<GAGES, HIGHER>::new());
    for codes in codes {
        let verdict = if gated { bins.offer(codes) } else { bins.offer_ungated(codes) };
        assert_eq!(verdict, Ok(Verdict::Accepted));
    }
    bins.finish();
    bins.solve(Rank::Spatial).expect("the motion spans")
}

/// SᵀS, which has no orientation, of the six quiet gages among eight.
fn quiet_gages(shape: &SMatrix<f64, 3, 8>) -> SMatrix<f64, 6, 6> {
    let quiet = shape.select_columns(&[0, 2, 3, 5, 6, 7]);
    SMatrix::from_fn(|i, j| quiet.column(i).dot(&quiet.column(j)))
}

/// Root mean square over the cases.
fn root_mean_square(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn channels_that_differ_are_weighted_by_what_they_are_worth() {
    // Two of eight channels are thirty times noisier than the rest. The gate's classes are the same for both ways of
    // solving, as the rests are all there is.
    let noise = [30.0, 900.0, 30.0, 30.0, 900.0, 30.0, 30.0, 30.0];
    let (mut weighted, mut equal) = (Vec::new(), Vec::new());
    for seed in 0..40 {
        let mut rng = random(seed);
        let sensor = KnownSensor::<8, 3>::random(&mut rng, SIGNAL, 0.0);
        let codes = rests(&sensor, &noise, &mut rng);
        let truth = quiet_gages(&sensor.shape);
        let error = |solved: &QuietSolution<8>| {
            (quiet_gages(&solved.solution.shape_counts_per_load) - truth).norm() / truth.norm()
        };
        weighted.push(error(&solve::<8, { higher_moment_count(8) }>(&codes, true)));
        equal.push(error(&solve::<8, { higher_moment_count(8) }>(&codes, false)));
    }
    // Six gages of 30 counts tell the load to about 30 counts. All eight weighted alike, two of 900 among them, tell it to
    // √(2/8) · 900 = 450; a quarter of the ratio of the two is left to chance.
    let (weighted, equal) = (root_mean_square(&weighted), root_mean_square(&equal));
    assert!(weighted < 0.25 * equal, "{weighted} for {equal}");
}

#[test]
fn the_noise_is_taken_out_where_nothing_redundant_tells_it() {
    // As many gages as directions, 5 % noise. Taken for signal, it makes the shape too large by about 3.3 (σ/F)² (design
    // § 3.3): that must be gone, and no more than chance be left of it.
    const CASES: u32 = 60;
    let [mut gated, mut ungated] = [(0.0, 0.0); 2];
    for seed in 0..CASES {
        let mut rng = random(100 + u64::from(seed));
        let shape = SMatrix::<f64, 3, 3>::identity() * SIGNAL;
        let sensor = KnownSensor::<3, 3> { shape, bias: Vector3::new(1e4, -2e4, 3e4), noise: 0.0 };
        let codes = rests(&sensor, &[0.05 * SIGNAL; 3], &mut rng);
        for (sums, gate) in [(&mut gated, true), (&mut ungated, false)] {
            let solved = solve::<3, { higher_moment_count(3) }>(&codes, gate);
            assert_eq!(solved.solution.noise_variance.is_some(), gate);
            let scale = (solved.solution.shape_counts_per_load.norm_squared() / 3.0).sqrt() / SIGNAL - 1.0;
            sums.0 += scale / f64::from(CASES);
            sums.1 += scale * scale / f64::from(CASES);
        }
    }
    let deviation = |(mean, square): (f64, f64)| ((square - mean * mean) / f64::from(CASES)).sqrt();
    assert!(gated.0.abs() < 4.0 * deviation(gated), "{} ± {}", gated.0, deviation(gated));
    assert!(ungated.0.abs() > 10.0 * deviation(ungated), "{} ± {}", ungated.0, deviation(ungated));
}

#[test]
fn the_noise_at_rest_is_that_of_the_channels_and_their_common_part() {
    let mut rng = random(1);
    let sensor = KnownSensor::<3, 3>::random(&mut rng, SIGNAL, 0.0);
    let noise = [100.0, 400.0, 200.0];
    let solved = solve::<3, { higher_moment_count(3) }>(&rests(&sensor, &noise, &mut rng), true);
    let mean: f64 = noise.iter().map(|noise| noise * noise).sum::<f64>() / 3.0;
    let found = solved.solution.noise_variance.expect("the load rested");
    // 1500 blocks, of which some are at the ends of a rest: a variance is known to √(2/1400) = 4 %, dominated by one channel.
    assert!((found / mean - 1.0).abs() < 0.12, "{found} for {mean}");
}
