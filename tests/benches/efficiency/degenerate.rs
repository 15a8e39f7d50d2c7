//! Motions that do not determine the answer, or hardly: is it refused, and if not, is it right?
//!
//! A **wrong answer** errs in some coefficient by more than six of the standard deviations that it predicts itself *and* by more
//! than 5 % of a gage's RMS signal. An answer that is far off but says so is none; nor is one that is off by a trifle.

use ftcal_shared::estimation::shape::solve_trial;
use ftcal_tests::{KnownSensor, moments_of, random, rank};
use nalgebra::{Rotation3, SVector, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::setting::{Comparison, SIGNAL_COUNTS, Setting};

const DEVIATIONS: f64 = 6.0;
const SHARE_OF_SIGNAL: f64 = 0.05;

/// How the load moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Motion {
    /// Around a circle through the centre, wobbling out of it by up to 10°.
    Plane,
    /// Within 10 to 60° of one direction.
    Cap,
    /// On the six faces of a cube, wobbling by up to 10°.
    CubeFaces,
    /// Anywhere, but a few dozen samples.
    FewSamples,
    /// Nowhere.
    Rest,
    /// Along a part of a circle, of any radius.
    Arc,
    /// Along two circles.
    TwoCircles,
}

/// Every one of them.
pub(crate) const MOTIONS: [Motion; 7] = [
    Motion::Plane,
    Motion::Cap,
    Motion::CubeFaces,
    Motion::FewSamples,
    Motion::Rest,
    Motion::Arc,
    Motion::TwoCircles,
];

/// What became of one case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// No answer was given.
    Refused,
    /// The answer is as good as it says, or good enough.
    Right,
    /// The answer is wrong.
    Wrong,
}

/// One case: its seed chooses noise, roundness, samples and the motion's parameters.
pub(crate) fn case<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    motion: Motion,
    seed: u64,
) -> Outcome {
    let mut rng = random(seed);
    let pick = |rng: &mut ChaCha8Rng, values: &[f64]| values[rng.random_range(0..values.len())];
    let setting = Setting {
        condition: pick(&mut rng, &[1.0, 2.0, 4.0]),
        relative_noise: pick(&mut rng, &[0.0001, 0.001, 0.01, 0.05]),
        samples: if motion == Motion::FewSamples { rng.random_range(5..60) } else { 1000 },
    };
    let sensor: KnownSensor<GAGES, RANK> = setting.sensor(&mut rng);
    let directions = directions(motion, setting.samples, &mut rng);
    let codes: Vec<_> = directions
        .iter()
        .map(|direction| sensor.codes(&SVector::from_fn(|axis, _| direction[axis]), &mut rng))
        .collect();
    let Ok(answer) = solve_trial::<GAGES, HIGHER>(&moments_of(&codes), rank::<RANK>()) else {
        return Outcome::Refused;
    };
    let wrong = Comparison::new(&sensor, &answer).errors().any(|(error, deviation)| {
        // Written so that an error or a deviation that is no number is wrong.
        !(error.abs() <= DEVIATIONS * deviation || error.abs() <= SHARE_OF_SIGNAL * SIGNAL_COUNTS)
    });
    if wrong { Outcome::Wrong } else { Outcome::Right }
}

/// Directions in space; a planar sensor sees the first two components, made a unit vector again.
fn directions(motion: Motion, samples: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let turn = |rng: &mut ChaCha8Rng| {
        let axis_angle = Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0));
        Rotation3::new(axis_angle)
    };
    // Half of the cases are exactly degenerate, the others nearly.
    let wobble = if rng.random() { 0.0 } else { rng.random_range(0.0..10_f64.to_radians()) };
    let extent = rng.random_range(10_f64.to_radians()..60_f64.to_radians());
    let arc = rng.random_range(0.2..core::f64::consts::TAU);
    let height: f64 = rng.random_range(-0.9..0.9);
    let (frame, second_frame) = (turn(rng), turn(rng));
    let in_plane = |angle: f64, height: f64| {
        let radius = (1.0 - height * height).sqrt();
        Vector3::new(radius * angle.cos(), radius * angle.sin(), height)
    };
    (0..samples)
        .map(|sample| {
            let random_direction = Vector3::from_fn(|_, _| StandardNormal.sample(&mut *rng));
            let angle: f64 = rng.random_range(0.0..core::f64::consts::TAU);
            let lift = rng.random_range(-1.0..1.0) * wobble;
            match motion {
                Motion::Plane => frame * in_plane(angle, lift.sin()),
                Motion::Cap => {
                    let height = rng.random_range(extent.cos()..1.0);
                    frame * in_plane(angle, height)
                }
                Motion::CubeFaces => {
                    let mut face = random_direction * wobble / 3.0;
                    face[(sample / 2) % 3] += if sample % 2 == 0 { 1.0 } else { -1.0 };
                    frame * face
                }
                Motion::FewSamples => random_direction,
                Motion::Rest => frame * (Vector3::z() + random_direction * wobble / 30.0),
                Motion::Arc => frame * in_plane(angle / core::f64::consts::TAU * arc, height + 0.1 * lift),
                Motion::TwoCircles if sample % 2 == 0 => frame * in_plane(angle, lift.sin()),
                Motion::TwoCircles => second_frame * in_plane(angle, lift.sin()),
            }
        })
        .collect()
}
