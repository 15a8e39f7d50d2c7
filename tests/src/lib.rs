//! What the tests that cross crate borders have in common: simulated trials with a known truth, and patience with
//! emulated boards.

pub mod hand;
pub mod image;
#[cfg(unix)]
pub mod patience;
pub mod truth;

use ftcal_shared::estimation::moments::Moments;
use ftcal_shared::units::{AdcCode, Rank};
use nalgebra::{DMatrix, SMatrix, SVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, StandardNormal};

/// A sensor whose truth is known: z = b + Sᵀm + e.
#[derive(Clone, Debug)]
pub struct KnownSensor<const GAGES: usize, const RANK: usize> {
    /// S (r × p), counts per unit load.
    pub shape: SMatrix<f64, RANK, GAGES>,
    /// b (p), counts.
    pub bias: SVector<f64, GAGES>,
    /// Standard deviation of the noise of each channel, counts.
    pub noise: f64,
}

/// The random numbers of this seed.
pub fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

impl<const GAGES: usize, const RANK: usize> KnownSensor<GAGES, RANK> {
    /// A sensor with a random shape of order `signal` counts per unit load, and a random bias. The shape's singular
    /// values differ by a factor of four at most: about as far from round as real sensors are.
    pub fn random(rng: &mut ChaCha8Rng, signal: f64, noise: f64) -> Self {
        let standard = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
        let bias = SVector::from_fn(|_, _| signal * standard(rng));
        loop {
            let shape = SMatrix::<f64, RANK, GAGES>::from_fn(|_, _| signal * standard(rng));
            let gram = DMatrix::from_fn(RANK, RANK, |a, b| shape.row(a).dot(&shape.row(b)));
            let eigenvalues = gram.symmetric_eigenvalues();
            if eigenvalues.max() <= 16.0 * eigenvalues.min() {
                return Self { shape, bias, noise };
            }
        }
    }

    /// The codes of one load direction (any length; it is made a unit vector), with noise, in whole counts.
    pub fn codes(&self, direction: &SVector<f64, RANK>, rng: &mut ChaCha8Rng) -> [AdcCode; GAGES] {
        self.codes_at(&direction.normalize(), rng)
    }

    /// The codes of one load, with noise, in whole counts.
    pub fn codes_at(&self, load: &SVector<f64, RANK>, rng: &mut ChaCha8Rng) -> [AdcCode; GAGES] {
        let noise = Normal::new(0.0, self.noise).expect("a standard deviation is not negative");
        let exact = self.bias + self.shape.transpose() * load;
        core::array::from_fn(|gage| {
            #[expect(clippy::cast_possible_truncation, reason = "rounded to whole counts")]
            AdcCode::saturating((exact[gage] + noise.sample(rng)).round() as i64)
        })
    }

    /// `samples` codes of loads in random directions, uniform over the circle or sphere.
    pub fn trial(&self, samples: usize, rng: &mut ChaCha8Rng) -> Vec<[AdcCode; GAGES]> {
        (0..samples)
            .map(|_| {
                let direction = SVector::<f64, RANK>::from_fn(|_, _| StandardNormal.sample(rng));
                self.codes(&direction, rng)
            })
            .collect()
    }
}

/// The rank of this number of directions.
pub fn rank<const RANK: usize>() -> Rank {
    Rank::new(RANK).expect("a trial's rank is 2 or 3")
}

/// The settled moments of these codes about the first of them.
pub fn moments_of<const GAGES: usize, const HIGHER: usize>(
    codes: &[[AdcCode; GAGES]],
) -> Moments<GAGES, HIGHER> {
    let mut moments = Moments::new(codes.first().copied().unwrap_or([AdcCode::ZERO; GAGES]));
    for sample in codes {
        moments.push(sample).expect("a test has fewer samples than the accumulator takes");
    }
    moments.settle();
    moments
}

/// The largest relative difference between two shapes, whatever their orientation: of SᵀS, which a rotation or a mirror
/// image leaves alone.
pub fn shape_difference<const GAGES: usize, const ROWS: usize, const OTHER_ROWS: usize>(
    left: &SMatrix<f64, ROWS, GAGES>,
    right: &SMatrix<f64, OTHER_ROWS, GAGES>,
) -> f64 {
    let (left, right) = (left.transpose() * left, right.transpose() * right);
    (left - right).amax() / right.amax()
}
