//! Known-load alignment: turns the shape of one trial into the sensor frame (paper, figure 2; design § 6).
//!
//! A trial knows its shape up to an orthogonal matrix R, a rotation or a mirror image. Known loads fix it: R m̂ₖ should be
//! uₖ, with m̂ₖ = Ĉ(zₖ − b) the load as the trial sees it and uₖ its known direction. This is Wahba's problem, solved by the singular value
//! decomposition of Σ wₖ uₖm̂ₖᵀ (Kabsch), once among rotations and once among mirror images. Both candidates are kept,
//! each with its misfit Σ (angleₖ/σₖ)², since in the plane one load, and in space two, fit both: [`super::handedness`]
//! decides.
//!
//! The weights are wₖ = 1/σₖ². σₖ² adds the squares of the load's own accuracy, of the trial's gain error, and of the
//! drift during the rest.

use nalgebra::{DMatrix, DVector};

use super::CalibrationRefusal;
use super::known_load::{KnownLoad, LoadCase};
use super::matrix::matrix_of_shape;
use super::singular::Singular;
use super::trial::TrialShape;

/// Relative error to be expected of any sensor as a linear model: gage amplifiers are linear to about a thousandth.
pub const MODEL_ERROR: f64 = 1e-3;

/// How far the length of a known load may be from one before it is not the load that the trial turned, beyond what the
/// uncertainty of the trial explains.
const LARGEST_MAGNITUDE_ERROR: f64 = 0.05;

/// The largest standard deviation of the orientation that is still an orientation, radian (10°).
const LARGEST_ORIENTATION_ERROR: f64 = 0.175;

/// How many standard deviations count as a contradiction.
const CONTRADICTION: f64 = 5.0;

/// Whether the trial's frame turns into the sensor frame by a rotation or by a mirror image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hand {
    /// det R = 1.
    Rotation,
    /// det R = −1.
    MirrorImage,
}

/// One orthogonal matrix that the known loads allow.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Rotation or mirror image.
    pub hand: Hand,
    /// R (r × r): from the trial's frame to the sensor frame.
    pub orientation: DMatrix<f64>,
    /// Σ (angle/σ)² over the known loads.
    pub misfit: f64,
    /// The angles between R m̂ₖ and uₖ, radian.
    pub angles_rad: Vec<f64>,
}

/// What the known loads of one trial tell about its orientation.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// The best rotation and the best mirror image.
    pub candidates: [Candidate; 2],
    /// Angles measured less angles fitted.
    pub freedom: usize,
    /// Covariance of the orientation's error as a small turn in the sensor frame, radian²: 1 × 1 in the plane, 3 × 3 in
    /// space.
    pub covariance: DMatrix<f64>,
}

impl Alignment {
    /// The best matrix of this hand.
    pub const fn candidate(&self, hand: Hand) -> &Candidate {
        let [rotation, mirror_image] = &self.candidates;
        match hand {
            Hand::Rotation => rotation,
            Hand::MirrorImage => mirror_image,
        }
    }

    /// Root mean square angle between the known directions and those found, degrees.
    pub fn residual_deg(&self, hand: Hand) -> f64 {
        let angles = &self.candidate(hand).angles_rad;
        let squares: f64 = angles.iter().map(|angle| angle * angle).sum();
        (squares / angles.len().max(1) as f64).sqrt().to_degrees()
    }
}

/// Aligns one trial (numbered from zero) with its known loads.
///
/// # Errors
///
/// [`CalibrationRefusal::NoKnownLoad`], [`CalibrationRefusal::KnownLoadsDoNotOrient`], and those of [`sights`].
pub fn align(trial: usize, case: &LoadCase, shape: &TrialShape) -> Result<Alignment, CalibrationRefusal> {
    if case.known_loads.is_empty() {
        return Err(CalibrationRefusal::NoKnownLoad { trial });
    }
    let sights = sights(trial, case, shape)?;
    orient(shape.rank(), &sights).map_err(|NotOriented { deviation_rad }| {
        CalibrationRefusal::KnownLoadsDoNotOrient {
            trial,
            loads: sights.len(),
            uncertainty_deg: deviation_rad.to_degrees(),
        }
    })
}

/// The known loads of a trial (numbered from zero) as the trial sees them.
///
/// # Errors
///
/// [`CalibrationRefusal::KnownLoadMagnitude`], [`CalibrationRefusal::KnownLoadNotAtRest`],
/// [`CalibrationRefusal::Trial`] where the shape cannot be inverted.
pub fn sights(trial: usize, case: &LoadCase, shape: &TrialShape) -> Result<Vec<Sight>, CalibrationRefusal> {
    let matrix = matrix_of_shape(&shape.shape_counts_per_load)
        .map_err(|refusal| CalibrationRefusal::Trial { trial, refusal })?;
    let loads = case.known_loads.iter().enumerate();
    loads.map(|(load, known)| sight(trial, load, known, shape, &matrix)).collect()
}

/// The directions leave a turn free, or all but free.
#[derive(Clone, Copy, Debug)]
pub struct NotOriented {
    /// Standard deviation of the worst turn, radian.
    pub deviation_rad: f64,
}

/// The orientations that known loads allow.
///
/// # Errors
///
/// [`NotOriented`].
pub fn orient(rank: usize, sights: &[Sight]) -> Result<Alignment, NotOriented> {
    let covariance = orientation_covariance(rank, sights);
    let deviation_rad = covariance.as_ref().map_or(f64::INFINITY, largest_deviation);
    let covariance = covariance
        .filter(|_| deviation_rad <= LARGEST_ORIENTATION_ERROR)
        .ok_or(NotOriented { deviation_rad })?;
    let turns = rank * (rank - 1) / 2;
    Ok(Alignment {
        candidates: [Hand::Rotation, Hand::MirrorImage].map(|hand| best(rank, sights, hand)),
        freedom: (sights.len() * (rank - 1)).saturating_sub(turns),
        covariance,
    })
}

/// A direction that is known in the sensor frame, as the trial sees it.
#[derive(Clone, Debug)]
pub struct Sight {
    /// m̂ₖ, of length one.
    pub seen: DVector<f64>,
    /// uₖ.
    pub known: DVector<f64>,
    /// σₖ, radian.
    pub deviation_rad: f64,
}

fn sight(
    trial: usize,
    load: usize,
    known: &KnownLoad,
    shape: &TrialShape,
    matrix: &DMatrix<f64>,
) -> Result<Sight, CalibrationRefusal> {
    let seen = matrix * (&known.rest.mean - &shape.bias_counts);
    let magnitude = seen.norm();
    let trial_error =
        shape.covariance.gain_deviation().hypot(shape.covariance.bias_deviation()).hypot(MODEL_ERROR);
    let same_load = (magnitude - 1.0).abs() <= LARGEST_MAGNITUDE_ERROR + CONTRADICTION * trial_error;
    if !same_load {
        return Err(CalibrationRefusal::KnownLoadMagnitude { trial, load, magnitude });
    }
    // Noise makes the two halves of a rest differ, too: by 2σ/√n on average.
    let drift_rad = (matrix * &known.rest.drift).norm();
    let noise_rad =
        shape.noise_counts.unwrap_or(0.0) * matrix.norm() * 2.0 / (known.rest.samples.max(1) as f64).sqrt();
    if drift_rad > CONTRADICTION * (known.accuracy_rad.hypot(noise_rad).hypot(MODEL_ERROR)) {
        return Err(CalibrationRefusal::KnownLoadNotAtRest {
            trial,
            load,
            drift_deg: drift_rad.to_degrees(),
        });
    }
    Ok(Sight {
        seen: seen / magnitude,
        known: known.direction.clone(),
        deviation_rad: known.accuracy_rad.hypot(trial_error).hypot(drift_rad / 2.0),
    })
}

/// Covariance of the small turn that is left: the inverse of Σ (I − uuᵀ)/σ², in the plane of Σ 1/σ². `None` where the
/// directions leave a turn free.
fn orientation_covariance(rank: usize, sights: &[Sight]) -> Option<DMatrix<f64>> {
    let turns = rank * (rank - 1) / 2;
    let mut information = DMatrix::zeros(turns, turns);
    for Sight { known, deviation_rad, .. } in sights {
        let seen_turns = DMatrix::identity(turns, turns);
        let turns_seen = if rank == 3 { seen_turns - known * known.transpose() } else { seen_turns };
        information += turns_seen / (deviation_rad * deviation_rad);
    }
    information.cholesky().map(|factor| factor.inverse())
}

fn largest_deviation(covariance: &DMatrix<f64>) -> f64 {
    covariance.clone().symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// The orthogonal matrix of one hand that brings the directions seen closest to those known.
pub fn best(rank: usize, sights: &[Sight], hand: Hand) -> Candidate {
    let mut profile = DMatrix::zeros(rank, rank);
    for Sight { seen, known, deviation_rad } in sights {
        profile += known * seen.transpose() / (deviation_rad * deviation_rad);
    }
    let Singular { left, right, .. } = Singular::of(&profile);
    let wanted = match hand {
        Hand::Rotation => 1.0,
        Hand::MirrorImage => -1.0,
    };
    // Where the hand asks for it, the weakest direction is turned over: it costs the least.
    let mut signs = DVector::from_element(rank, 1.0);
    signs[rank - 1] = wanted * (left.determinant() * right.determinant()).signum();
    let orientation = left * DMatrix::from_diagonal(&signs) * right.transpose();
    let angles_rad: Vec<f64> =
        sights.iter().map(|sight| angle(&(&orientation * &sight.seen), &sight.known)).collect();
    let misfit =
        angles_rad.iter().zip(sights).map(|(angle, sight)| (angle / sight.deviation_rad).powi(2)).sum();
    Candidate { hand, orientation, misfit, angles_rad }
}

/// The angle between two unit vectors, accurate for small ones and for those near a half turn.
pub fn angle(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    2.0 * (a - b).norm().atan2((a + b).norm())
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{Hand, Sight, angle, best};

    fn random_unit(random: &mut ChaCha8Rng, rank: usize) -> DVector<f64> {
        DVector::from_fn(rank, |_, _| random.random::<f64>() - 0.5).normalize()
    }

    fn random_orthogonal(random: &mut ChaCha8Rng, rank: usize, hand: Hand) -> DMatrix<f64> {
        let mut orthogonal = DMatrix::from_fn(rank, rank, |_, _| random.random::<f64>() - 0.5).qr().q();
        let wanted = if hand == Hand::Rotation { 1.0 } else { -1.0 };
        if orthogonal.determinant() * wanted < 0.0 {
            orthogonal.row_mut(0).neg_mut();
        }
        orthogonal
    }

    #[test]
    fn the_truth_is_found_among_its_own_hand_and_fits_exactly() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (rank, loads) in [(2, 1), (2, 2), (2, 5), (3, 2), (3, 3), (3, 6)] {
            for hand in [Hand::Rotation, Hand::MirrorImage] {
                let truth = random_orthogonal(&mut random, rank, hand);
                let sights: Vec<Sight> = (0..loads)
                    .map(|_| {
                        let seen = random_unit(&mut random, rank);
                        Sight { known: &truth * &seen, seen, deviation_rad: 1e-3 }
                    })
                    .collect();
                let found = best(rank, &sights, hand);
                assert!((&found.orientation - &truth).norm() < 1e-6, "rank {rank}, {loads} loads");
                let other = if hand == Hand::Rotation { Hand::MirrorImage } else { Hand::Rotation };
                let mirrored = best(rank, &sights, other);
                assert!((mirrored.orientation.determinant() + found.orientation.determinant()).abs() < 1e-9);
                // One load in the plane, two in space, fit the other hand as well; one more does not.
                assert_eq!(mirrored.misfit < 1.0, loads < rank, "rank {rank}, {loads} loads");
            }
        }
    }

    #[test]
    fn no_small_turn_fits_better() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for rank in [2, 3] {
            for hand in [Hand::Rotation, Hand::MirrorImage] {
                let sights: Vec<Sight> = (0..5)
                    .map(|_| Sight {
                        seen: random_unit(&mut random, rank),
                        known: random_unit(&mut random, rank),
                        deviation_rad: 0.5 + random.random::<f64>(),
                    })
                    .collect();
                // The cost of Wahba's problem: weighted squares of chords.
                let cost = |orientation: &DMatrix<f64>| -> f64 {
                    let chord = |sight: &Sight| {
                        (orientation * &sight.seen - &sight.known).norm() / sight.deviation_rad
                    };
                    sights.iter().map(|sight| chord(sight).powi(2)).sum()
                };
                let found = best(rank, &sights, hand).orientation;
                for _ in 0..50 {
                    let rough = DMatrix::identity(rank, rank)
                        + DMatrix::from_fn(rank, rank, |_, _| 0.02 * (random.random::<f64>() - 0.5));
                    let mut turn = rough.qr().q();
                    for axis in 0..rank {
                        let sign = turn[(axis, axis)].signum();
                        turn.column_mut(axis).scale_mut(sign);
                    }
                    assert!(cost(&found) <= cost(&(turn * &found)) + 1e-12);
                }
            }
        }
    }

    #[test]
    fn angles_are_exact_from_nothing_to_a_half_turn() {
        for degrees in [0.0, 1e-6, 1.0, 90.0, 179.0, 179.999_999, 180.0] {
            let radians = f64::to_radians(degrees);
            let (a, b) =
                (DVector::from_vec(vec![1.0, 0.0]), DVector::from_vec(vec![radians.cos(), radians.sin()]));
            assert!((angle(&a, &b) - radians).abs() < 1e-12, "{degrees}");
        }
    }
}
