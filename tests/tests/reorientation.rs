//! A trial is turned onto the calibration that there is: never onto its mirror image, and with one gage's drift left to that gage.

use ftcal_shared::estimation::reorientation::{
    MAX_RANK, MODEL_ERROR, NoOrientation, Oriented, Rows, Unoriented, dual, orient,
};
use ftcal_tests::random;
use nalgebra::{DMatrix, Matrix3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// What a gage answers, counts per newton, and what hangs on the sensor.
const ANSWER: f32 = 1e5;
const NEWTON: f32 = 7.0;

/// A hundred roundings.
const ROUNDING: f32 = 100.0 * f32::EPSILON;

fn normal(rng: &mut ChaCha8Rng) -> f32 {
    StandardNormal.sample(rng)
}

/// Gages that answer to random directions, the last component `flatness` times as much as the others.
fn shape<const GAGES: usize>(rng: &mut ChaCha8Rng, rank: usize, flatness: f32) -> Rows<GAGES> {
    let mut rows = [[0.0; GAGES]; MAX_RANK];
    for (row, elements) in rows.iter_mut().enumerate().take(rank) {
        let size = if row + 1 == rank { flatness * ANSWER } else { ANSWER };
        elements.fill_with(|| size * normal(rng));
    }
    rows
}

/// The shape as a trial sees it: in an orientation of its own, of either hand, per unit load, and with noise of this deviation in
/// every element.
fn seen<const GAGES: usize>(
    rng: &mut ChaCha8Rng,
    rank: usize,
    shape: &Rows<GAGES>,
    noise: f32,
) -> Rows<GAGES> {
    let turn = DMatrix::from_fn(rank, rank, |_, _| normal(rng)).qr().q();
    let hand = if rng.random() { 1.0 } else { -1.0 };
    let mut seen = [[0.0; GAGES]; MAX_RANK];
    for row in 0..rank {
        for gage in 0..GAGES {
            let turned: f32 = (0..rank).map(|k| turn[(row, k)] * shape[k][gage]).sum();
            let side = if row == 0 { hand } else { 1.0 };
            seen[row][gage] = NEWTON * (side * turned + noise * normal(rng));
        }
    }
    seen
}

fn oriented<const GAGES: usize>(
    rank: usize,
    seen: &Rows<GAGES>,
    noise: f32,
    known: &Rows<GAGES>,
) -> Result<Oriented<GAGES>, NoOrientation> {
    let deviation = [NEWTON * noise * (rank as f32).sqrt(); GAGES];
    orient(&Unoriented { rank, shape: seen, deviation: &deviation }, known)
}

fn distance<const GAGES: usize>(one: &Rows<GAGES>, other: &Rows<GAGES>) -> f32 {
    let squares = one.iter().flatten().zip(other.iter().flatten()).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f32>().sqrt() / other.iter().flatten().map(|b| b * b).sum::<f32>().sqrt()
}

/// Whether a shape has the hand of the other: the determinant of their product, beyond the rank the identity.
fn same_hand<const GAGES: usize>(rank: usize, one: &Rows<GAGES>, other: &Rows<GAGES>) -> bool {
    let product = Matrix3::from_fn(|a, b| {
        let term = |gage: usize| f64::from(one[a][gage]) * f64::from(other[b][gage]);
        if a >= rank && a == b { 1.0 } else { (0..GAGES).map(term).sum::<f64>() }
    });
    product.determinant() > 0.0
}

fn with_gain<const GAGES: usize>(shape: &Rows<GAGES>, gage: usize, gain: f32) -> Rows<GAGES> {
    shape.map(|mut row| {
        row[gage] *= gain;
        row
    })
}

fn exact<const GAGES: usize>(rank: usize) {
    for seed in 0..300 {
        let mut rng = random(seed);
        let known = shape::<GAGES>(&mut rng, rank, 1.0);
        let seen = seen(&mut rng, rank, &known, 0.0);
        let Ok(found) = oriented(rank, &seen, 0.0, &known) else { continue };
        assert!(distance(&found.shape, &known) < ROUNDING, "{rank} {GAGES} {seed}");
        assert!((found.load_newton / NEWTON - 1.0).abs() < ROUNDING);
        assert!(found.drift < 10.0 * ROUNDING);
    }
}

#[test]
fn a_turned_mirrored_and_scaled_shape_is_brought_back() {
    exact::<2>(2);
    exact::<4>(2);
    exact::<3>(3);
    exact::<6>(3);
    exact::<8>(3);
}

/// Of all shapes, flat ones included, with noise and a gage that has drifted: the answer has the right hand, or there is none.
fn never_mirrored<const GAGES: usize>(rank: usize) {
    let (mut answered, mut refused) = (0, 0);
    for seed in 0..2000 {
        let mut rng = random(seed);
        // From round to flat.
        let flatness = 10_f32.powf(rng.random_range(-4.0..0.0));
        let noise = ANSWER * 10_f32.powf(rng.random_range(-6.0..-2.5));
        let known = shape::<GAGES>(&mut rng, rank, flatness);
        let moved = with_gain(&known, rng.random_range(0..GAGES), rng.random_range(0.97..1.03));
        let seen = seen(&mut rng, rank, &moved, noise);
        match oriented(rank, &seen, noise, &known) {
            Ok(found) => {
                assert!(same_hand(rank, &found.shape, &known), "{rank} {GAGES} {seed}");
                answered += 1;
            }
            Err(_) => refused += 1,
        }
    }
    assert!(answered > 300 && refused > 300, "{rank} {GAGES}: {answered} {refused}");
}

#[test]
fn a_mirror_image_never_slips_in() {
    never_mirrored::<2>(2);
    never_mirrored::<4>(2);
    never_mirrored::<3>(3);
    never_mirrored::<6>(3);
    never_mirrored::<8>(3);
}

/// Eight gages around a sphere's directions: each is one of eight, and has half of the weight of four parameters (three turns and
/// a scale) at most. What a gage that is off by any amount pulls with is two standard deviations; so the others, and the turn and the
/// scale with them, are off by no more than that.
#[test]
fn a_gage_that_drifts_takes_nothing_else_along() {
    let corners: Rows<8> = core::array::from_fn(|row| {
        core::array::from_fn(|gage| if gage >> row & 1 == 0 { ANSWER } else { -ANSWER })
    });
    let mut rng = random(1);
    for gage in 0..8 {
        for gain in [0.5, 0.9, 0.99, 0.995, 1.005, 1.02, 1.5] {
            let moved = with_gain(&corners, gage, gain);
            let seen = seen(&mut rng, 3, &moved, 0.0);
            let found = oriented(3, &seen, 0.0, &corners).expect("round");
            let off = distance(&found.shape, &moved);
            assert!(off < 2.0 * MODEL_ERROR, "{gain} {off}");
            let change = f32::abs(gain - 1.0);
            assert_eq!(usize::from(found.gage), gage);
            assert!((found.drift - change).abs() < 3.0 * MODEL_ERROR, "{gain} {}", found.drift);
        }
    }
}

#[test]
fn a_calibration_matrix_and_its_shape_are_each_other_s_dual() {
    let mut rng = random(2);
    for rank in [2, 3] {
        for _ in 0..200 {
            let shape = shape::<6>(&mut rng, rank, 1.0);
            let Some(matrix) = dual(rank, &shape) else { panic!("independent") };
            for a in 0..rank {
                for b in 0..rank {
                    let product: f32 = (0..6).map(|gage| matrix[a][gage] * shape[b][gage]).sum();
                    assert!((product - f32::from(u8::from(a == b))).abs() < 10.0 * ROUNDING);
                }
            }
            assert!(dual(rank, &matrix).is_some_and(|again| distance(&again, &shape) < 10.0 * ROUNDING));
            let mut dependent = shape;
            dependent[rank - 1] = dependent[0].map(|element| -2.0 * element);
            assert_eq!(dual(rank, &dependent), None);
            let mut broken = shape;
            broken[0][1] = f32::NAN;
            assert_eq!(dual(rank, &broken), None);
        }
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let known = shape::<4>(&mut random(3), 2, 1.0);
    for wrong in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
        let mut broken = known;
        broken[1][2] = wrong;
        assert!(oriented(2, &broken, 0.0, &known).is_err());
        assert!(oriented(2, &known, 0.0, &broken).is_err());
        let deviation = [1.0, wrong, 1.0, 1.0];
        let trial = Unoriented { rank: 2, shape: &known, deviation: &deviation };
        // Nothing known of a gage is as good as nothing of it.
        if let Ok(found) = orient(&trial, &known) {
            assert!(distance(&found.shape, &known) < ROUNDING);
        }
    }
    let nothing = [[0.0; 4]; MAX_RANK];
    assert!(oriented(2, &nothing, 0.0, &known).is_err() && oriented(2, &known, 0.0, &nothing).is_err());
    for scale in [1e-15, 1e12] {
        let scaled = known.map(|row| row.map(|element| scale * element));
        assert!(
            oriented(2, &scaled, 0.0, &known).is_ok_and(|found| distance(&found.shape, &known) < ROUNDING)
        );
        assert!(
            oriented(2, &known, 0.0, &scaled).is_ok_and(|found| distance(&found.shape, &scaled) < ROUNDING)
        );
    }
}
