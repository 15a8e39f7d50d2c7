//! What contradicts a trial's first solution: glitches of a channel, and a load of another magnitude.

use std::collections::BTreeMap;

use ftcal::calibration::samples::Rejection;
use ftcal::calibration::trial::{Gating, TrialShape, solve};
use ftcal::recording::Recording;
use ftcal_shared::units::AdcCode;
use ftcal_tests::{KnownSensor, random};
use nalgebra::{DMatrix, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};

const GAGES: usize = 8;
type Codes = [AdcCode; GAGES];

/// Signal of the sensor, counts per unit load, and its noise.
const SIGNAL: f64 = 1e5;
const NOISE: f64 = 100.0;

/// Samples in each direction, and how many directions.
const DWELL: usize = 80;
const DIRECTIONS: usize = 100;

/// The codes of a load that rests in random directions and goes from one to the next between two samples; it has this
/// magnitude while it rests in each.
fn codes(
    sensor: &KnownSensor<GAGES, 3>,
    magnitude: impl Fn(usize) -> f64,
    rng: &mut ChaCha8Rng,
) -> Vec<Codes> {
    let mut codes = Vec::with_capacity(DWELL * DIRECTIONS);
    for rest in 0..DIRECTIONS {
        let load: Vector3<f64> = Vector3::from(UnitSphere.sample(rng)) * magnitude(rest);
        codes.extend((0..DWELL).map(|_| sensor.codes_at(&load, rng)));
    }
    codes
}

fn solved(codes: &[Codes]) -> TrialShape {
    let times = (0..codes.len()).map(|sample| sample as f64 * 1e-3).collect();
    let recording = Recording::from_codes(GAGES, times, codes.iter().flatten().copied().collect());
    solve(&recording, 3, Gating::On).expect("the motion spans")
}

/// Error of SᵀS, which has no orientation, relative.
fn error(sensor: &KnownSensor<GAGES, 3>, solved: &TrialShape) -> f64 {
    let truth = DMatrix::from_fn(GAGES, GAGES, |i, j| sensor.shape.column(i).dot(&sensor.shape.column(j)));
    let shape = &solved.shape_counts_per_load;
    (shape.transpose() * shape - &truth).norm() / truth.norm()
}

#[test]
fn nothing_is_rejected_where_nothing_is_wrong() {
    for seed in 0..20 {
        let mut rng = random(seed);
        let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
        let trial = solved(&codes(&sensor, |_| 1.0, &mut rng));
        assert_eq!(trial.samples.rejected, BTreeMap::new());
    }
}

#[test]
fn glitches_are_rejected_by_the_parity_of_the_gages() {
    for seed in 0..10 {
        let mut rng = random(100 + seed);
        let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
        let clean = codes(&sensor, |_| 1.0, &mut rng);
        let mut glitched = clean.clone();
        // Twenty of 8000 samples, a channel each, off by a third of the load: 300 times the noise. Each takes its block with it.
        for glitch in 0..20 {
            let (sample, gage) = (400 * glitch + rng.random_range(0..400), rng.random_range(0..GAGES));
            glitched[sample][gage] = AdcCode::saturating(i64::from(clean[sample][gage].counts()) + 33_000);
        }
        let changed =
            clean.chunks(4).zip(glitched.chunks(4)).filter(|(before, after)| before != after).count();
        let changed = 4 * changed as u64;
        let (before, after) = (solved(&clean), solved(&glitched));
        assert_eq!(after.samples.rejected.get(&Rejection::Parity), Some(&changed), "{:?}", after.samples);
        // One sample of a hundred less: the answer is as good as it was, but for chance.
        let (before, after) = (error(&sensor, &before), error(&sensor, &after));
        assert!(after < 1.5 * before, "{after} for {before}");
    }
}

#[test]
fn a_load_of_another_magnitude_is_left_out_and_counted() {
    for seed in 0..10 {
        let mut rng = random(200 + seed);
        let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
        // Somebody lifts the load a little during one rest of a hundred.
        let lifted = codes(&sensor, |rest| if rest == 50 { 0.95 } else { 1.0 }, &mut rng);
        let trial = solved(&lifted);
        let magnitude = trial.samples.rejected.get(&Rejection::Magnitude).copied().unwrap_or(0);
        // Up to three blocks of four at either end of a rest count as moving.
        assert!((DWELL as u64 - 24..=DWELL as u64).contains(&magnitude), "{:?}", trial.samples);
        // √6 · σ/(F√n) for the worst gain: three times that for all of SᵀS.
        assert!(error(&sensor, &trial) < 3.0 * 6.0_f64.sqrt() * NOISE / SIGNAL / 8000.0_f64.sqrt());
    }
}
