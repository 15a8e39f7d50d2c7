//! The quasi-static gate: what it makes of a hand that rests a fifth of the time, of one that disturbs the load while it
//! moves, and of converters that repeat themselves.

use ftcal_shared::estimation::bins::{Bins, QuietSolution};
use ftcal_shared::estimation::gate::{Quietness, Verdict};
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::{AdcCode, Rank};
use ftcal_tests::hand::{Pose, codes, hand};
use ftcal_tests::{KnownSensor, random};
use nalgebra::{SMatrix, Vector3};
use rand::RngExt;

const GAGES: usize = 8;
const HIGHER: usize = higher_moment_count(GAGES);
type Codes = [AdcCode; GAGES];

/// Signal of the sensor, counts per unit load, and its noise.
const SIGNAL: f64 = 1e5;
const NOISE: f64 = 100.0;

const SEEDS: u64 = 60;

fn bins_of(codes: &[Codes], gated: bool) -> Box<Bins<GAGES, HIGHER>> {
    let mut bins = Box::new(Bins::new());
    for codes in codes {
        if gated { bins.offer(codes) } else { bins.offer_ungated(codes) }.unwrap();
    }
    bins.finish();
    bins
}

fn solve(codes: &[Codes], gated: bool) -> QuietSolution<GAGES> {
    bins_of(codes, gated).solve(Rank::Spatial).unwrap()
}

/// Error of SᵀS, which has no orientation, relative.
fn error(sensor: &KnownSensor<GAGES, 3>, solved: &QuietSolution<GAGES>) -> f64 {
    let gram = |shape: &SMatrix<f64, 3, GAGES>| shape.transpose() * shape;
    let truth = gram(&sensor.shape);
    (gram(&solved.solution.shape_counts_per_load) - truth).norm() / truth.norm()
}

/// Root mean square: one bad answer counts.
fn usual(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Where nothing is disturbed, every sample counts. Where the magnitude wanders by 2 % while the hand moves (57 times the noise),
/// a moving sample tells nothing of it, and no gate can do better than one who knows the truth and takes the rests alone.
#[test]
fn a_disturbed_motion_is_worth_its_rests_and_an_undisturbed_one_all_of_itself() {
    let [mut clean, mut clean_gated, mut shaken, mut shaken_gated, mut rests] = [const { Vec::new() }; 5];
    for seed in 0..SEEDS {
        let mut rng = random(seed);
        let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
        let poses = hand(&mut rng);
        let undisturbed = codes(&sensor, &poses, 0.0, &mut rng.clone());
        let disturbed = codes(&sensor, &poses, 0.02, &mut rng);
        let pairs = poses.iter().zip(&disturbed);
        let resting: Vec<Codes> = pairs.filter(|(pose, _)| !pose.moving).map(|(_, codes)| *codes).collect();
        clean.push(error(&sensor, &solve(&undisturbed, false)));
        clean_gated.push(error(&sensor, &solve(&undisturbed, true)));
        shaken.push(error(&sensor, &solve(&disturbed, false)));
        shaken_gated.push(error(&sensor, &solve(&disturbed, true)));
        rests.push(error(&sensor, &solve(&resting, false)));
    }
    let [clean, clean_gated, shaken, shaken_gated, rests] =
        [clean, clean_gated, shaken, shaken_gated, rests].map(|errors| usual(&errors));
    assert!(clean_gated <= 1.2 * clean, "{clean_gated} for {clean}");
    assert!(shaken_gated <= 1.25 * rests, "{shaken_gated} for {rests}");
    assert!(shaken_gated <= 0.05 * shaken, "{shaken_gated} for {shaken}");
    eprintln!(
        "undisturbed {clean:.2e}, gated {clean_gated:.2e}; disturbed {shaken:.2e}, gated {shaken_gated:.2e}, true rests {rests:.2e}"
    );
}

#[test]
fn rests_are_told_from_turns() {
    let mut rng = random(7);
    let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
    let poses = hand(&mut rng);
    let shaken = codes(&sensor, &poses, 0.02, &mut rng);
    let solved = solve(&shaken, true);
    let resting = poses.iter().filter(|pose| !pose.moving).count() as f64;
    assert_eq!(solved.up_to, Quietness::Still);
    let share = solved.solution.samples as f64 / resting;
    // A rest is blurred by 14 samples at either end, and the slow ends of each turn count as rest.
    assert!((0.5..1.5).contains(&share), "{share}");
}

#[test]
fn a_slow_dense_motion_passes() {
    let mut rng = random(11);
    let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
    let spiral: Vec<Pose> = (0..8000)
        .map(|sample| {
            let height = f64::from(sample) / 4000.0 - 1.0;
            let (sine, cosine) = (f64::from(sample) * 0.01).sin_cos();
            let radius = (1.0 - height * height).sqrt();
            Pose { direction: Vector3::new(radius * cosine, radius * sine, height), moving: true }
        })
        .collect();
    let solved = solve(&codes(&sensor, &spiral, 0.0, &mut rng), true);
    assert_eq!(solved.solution.samples, 8000);
}

/// What became of the samples: accepted, saturated, repeated.
fn verdicts(codes: impl IntoIterator<Item = Codes>) -> [usize; 3] {
    let mut bins = Box::new(Bins::<GAGES, HIGHER>::new());
    let mut counts = [0; 3];
    for codes in codes {
        match bins.offer(&codes).unwrap() {
            Verdict::Accepted => counts[0] += 1,
            Verdict::Saturated => counts[1] += 1,
            Verdict::Repeated => counts[2] += 1,
            Verdict::Contradictory => panic!("nothing is expected of the samples"),
        }
    }
    counts
}

#[test]
fn a_converter_that_hangs_is_noticed_and_a_coarse_one_is_left_alone() {
    for seed in 0..10 {
        let mut rng = random(100 + seed);
        let fine = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
        let poses = hand(&mut rng);
        let mut hanging = codes(&fine, &poses, 0.0, &mut rng);
        let from = rng.random_range(1000..5000);
        let stuck = hanging[from];
        hanging[from..from + 500].fill(stuck);
        // Four repetitions of 499 pass.
        assert_eq!(verdicts(hanging), [poses.len() - 495, 0, 495]);

        // The same sensor behind a converter whose steps are ten times the noise: at rest it repeats itself for good.
        let steps =
            |codes: Codes| codes.map(|code| AdcCode::saturating(i64::from(code.counts() / 1000 * 1000)));
        let coarse = codes(&fine, &poses, 0.0, &mut rng).into_iter().map(steps);
        assert_eq!(verdicts(coarse), [poses.len(), 0, 0]);
    }
}

#[test]
fn the_zero_of_the_codes_is_of_no_account() {
    let mut rng = random(3);
    let sensor = KnownSensor::<GAGES, 3>::random(&mut rng, SIGNAL, NOISE);
    let shaken = codes(&sensor, &hand(&mut rng), 0.02, &mut rng);
    let shifted: Vec<Codes> = shaken
        .iter()
        .map(|codes| codes.map(|code| AdcCode::saturating(i64::from(code.counts()) + 1_000_000)))
        .collect();
    let (here, there) = (solve(&shaken, true), solve(&shifted, true));
    assert_eq!(here.up_to, there.up_to);
    assert_eq!(here.solution.shape_counts_per_load, there.solution.shape_counts_per_load);
}
