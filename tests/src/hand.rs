//! A hand that turns a load: from one random direction to the next, with a rest at each, and how it disturbs the load meanwhile.

use ftcal_shared::units::AdcCode;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};

use crate::KnownSensor;

/// Samples of a turn, and of the rest that follows it: at 250 samples a second, 1.2 s and 0.3 s, a fifth of the time.
const TURN: u32 = 300;
const REST: u32 = 75;
const TURNS: u32 = 27;

/// How much of the disturbance is left after one sample: it lasts for about a tenth of a second.
const MEMORY: f64 = 0.96;

/// One sample of the motion.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Where the load pulls, a unit vector.
    pub direction: Vector3<f64>,
    /// Whether it moves.
    pub moving: bool,
}

/// A hand that turns from one random direction to the next with the minimum-jerk profile, and rests at each.
pub fn hand(rng: &mut ChaCha8Rng) -> Vec<Pose> {
    let mut poses = Vec::new();
    let mut random_direction = || Vector3::from(UnitSphere.sample(rng));
    let mut from = random_direction();
    for _ in 0..TURNS {
        let to: Vector3<f64> = random_direction();
        for sample in 0..TURN {
            let t = f64::from(sample) / f64::from(TURN);
            let way = t * t * t * (10.0 - 15.0 * t + 6.0 * t * t);
            poses.push(Pose { direction: from.slerp(&to, way), moving: true });
        }
        poses.extend((0..REST).map(|_| Pose { direction: to, moving: false }));
        from = to;
    }
    poses
}

/// The codes of a motion; while it moves, the magnitude wanders by `disturbance` (a standard deviation, relative).
pub fn codes<const GAGES: usize>(
    sensor: &KnownSensor<GAGES, 3>,
    poses: &[Pose],
    disturbance: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<[AdcCode; GAGES]> {
    let mut wander = 0.0;
    poses
        .iter()
        .map(|pose| {
            let step: f64 = StandardNormal.sample(rng);
            wander = MEMORY * wander + (1.0 - MEMORY * MEMORY).sqrt() * step;
            let magnitude = if pose.moving { 1.0 + disturbance * wander } else { 1.0 };
            sensor.codes_at(&(pose.direction * magnitude), rng)
        })
        .collect()
}
