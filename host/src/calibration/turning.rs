//! The sense in which a planar load turned, from its recovered motion.
//!
//! The trial sees the load turn in its own frame. If that frame is a mirror image of the sensor frame, the sense comes
//! out reversed, so one word from the user, "counterclockwise", settles the mirror image that a single known load
//! leaves (design § 6). The sense must be plain: at least half a turn that way, and little of the other.

use std::f64::consts::{FRAC_PI_4, PI};

use nalgebra::DVector;

use super::CalibrationRefusal;
use super::alignment::Hand;
use super::motion::Motion;
use crate::session_file::Turning;

/// A reversal smaller than this is noise or a trembling hand, radian (15°).
const LEAST_REVERSAL: f64 = 0.26;

/// The least turn that shows a sense.
const LEAST_TURN: f64 = PI;

/// How many times more the load must have turned one way than the other.
const LEAST_DOMINANCE: f64 = 4.0;

/// The largest share of steps of more than an eighth of a turn from one sample to the next, whose sense is a guess. (A load
/// that turns by nearly a whole turn between samples looks like one that creeps back; nothing in the codes tells.)
const LARGEST_SHARE_OF_JUMPS: f64 = 0.01;

/// How far a planar load turned each way in the trial's own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Swept {
    /// Counterclockwise, radian.
    pub counterclockwise_rad: f64,
    /// Clockwise, radian.
    pub clockwise_rad: f64,
    /// The share of steps too large to tell their sense.
    pub jumps: f64,
}

/// What is known about the sense of turning of one trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// The sense in the sensor frame, as the session says.
    pub claimed: Turning,
    /// The motion in the trial's frame.
    pub swept: Swept,
}

/// Adds up how far the load turned each way.
///
/// The angle is followed from sample to sample; a stretch one way ends where the angle comes back by more than
/// 15°.
pub fn swept(motion: &Motion) -> Swept {
    let mut swept = Swept::default();
    let (mut angle, mut turning_point, mut extreme) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut steps, mut jumps) = (0_u64, 0_u64);
    for pair in motion.directions.windows(2) {
        let [before, after] = pair else { continue };
        let step = signed_angle(before, after);
        steps += 1;
        if step.abs() > FRAC_PI_4 {
            jumps += 1;
            continue;
        }
        angle += step;
        let onwards = extreme - turning_point;
        if onwards == 0.0 || (angle - extreme) * onwards > 0.0 {
            extreme = angle;
        } else if (angle - extreme).abs() > LEAST_REVERSAL {
            swept.add(onwards);
            turning_point = extreme;
            extreme = angle;
        }
    }
    swept.add(extreme - turning_point);
    swept.jumps = if steps == 0 { 0.0 } else { jumps as f64 / steps as f64 };
    swept
}

impl Swept {
    fn add(&mut self, stretch_rad: f64) {
        if stretch_rad > 0.0 {
            self.counterclockwise_rad += stretch_rad;
        } else {
            self.clockwise_rad -= stretch_rad;
        }
    }
}

/// The hand of the trial's frame (numbered from zero) that the sense of turning demands.
///
/// # Errors
///
/// [`CalibrationRefusal::TurningUnclear`] where the load turned both ways, too little, or in jumps.
pub fn hand(trial: usize, turned: &Turned) -> Result<Hand, CalibrationRefusal> {
    let Swept { counterclockwise_rad: left, clockwise_rad: right, jumps } = turned.swept;
    let (more, less) = (left.max(right), left.min(right));
    if more < LEAST_TURN || more < LEAST_DOMINANCE * less || jumps > LARGEST_SHARE_OF_JUMPS {
        return Err(CalibrationRefusal::TurningUnclear { trial, swept: turned.swept });
    }
    let seen = if left > right { Turning::Counterclockwise } else { Turning::Clockwise };
    Ok(if seen == turned.claimed { Hand::Rotation } else { Hand::MirrorImage })
}

/// The angle from one direction of the plane to another, −π to π, counterclockwise positive.
fn signed_angle(from: &DVector<f64>, to: &DVector<f64>) -> f64 {
    match (from.as_slice(), to.as_slice()) {
        (&[a, b], &[c, d]) => (a * d - b * c).atan2(a * c + b * d),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{Turned, hand, swept};
    use crate::calibration::alignment::Hand;
    use crate::calibration::motion::Motion;
    use crate::session_file::Turning;

    fn motion(angles: impl Iterator<Item = f64>) -> Motion {
        let directions: Vec<_> =
            angles.map(|angle| DVector::from_column_slice(&[angle.cos(), angle.sin()])).collect();
        Motion { quiet: directions.clone(), directions }
    }

    fn hand_of(angles: impl Iterator<Item = f64>) -> Option<Hand> {
        let swept = swept(&motion(angles));
        hand(0, &Turned { claimed: Turning::Counterclockwise, swept }).ok()
    }

    #[test]
    fn a_plain_turn_has_a_sense_whatever_the_noise_and_the_start() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        for (sense, expected) in [(1.0, Hand::Rotation), (-1.0, Hand::MirrorImage)] {
            for turns in [0.7, 1.0, 3.0] {
                let start = TAU * random.random::<f64>();
                let noisy: Vec<f64> = (0..2000)
                    .map(|i| {
                        start
                            + sense * TAU * turns * f64::from(i) / 2000.0
                            + 0.1 * (random.random::<f64>() - 0.5)
                    })
                    .collect();
                assert_eq!(hand_of(noisy.into_iter()), Some(expected));
            }
        }
    }

    #[test]
    fn noise_adds_nothing_to_a_slow_turn() {
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let angles: Vec<f64> =
            (0..20_000).map(|i| f64::from(i) * 3e-4 + 0.2 * (random.random::<f64>() - 0.5)).collect();
        let swept = swept(&motion(angles.into_iter()));
        assert!((swept.counterclockwise_rad - 6.0).abs() < 0.3 && swept.clockwise_rad < 0.3, "{swept:?}");
    }

    #[test]
    fn turning_both_ways_too_little_or_in_jumps_is_unclear() {
        assert_eq!(hand_of((0..1000).map(|i| (f64::from(i) * 0.02).sin() * 4.0)), None, "to and fro");
        assert_eq!(hand_of((0..1000).map(|i| f64::from(i) * 0.002)), None, "a third of a turn");
        assert_eq!(hand_of(std::iter::empty()), None, "no motion");
        let mut random = ChaCha8Rng::seed_from_u64(10);
        assert_eq!(hand_of((0..1000).map(|_| TAU * random.random::<f64>())), None, "jumps");
    }
}
