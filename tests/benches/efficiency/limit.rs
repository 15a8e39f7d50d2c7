//! Error of the shape against the Cramér–Rao bound, and predicted against observed standard deviations.

use ftcal_shared::estimation::shape::solve_trial;
use ftcal_shared::units::AdcCode;
use ftcal_tests::{KnownSensor, moments_of, random, rank};
use nalgebra::SVector;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::bound::Information;
use crate::setting::{Comparison, Setting};

/// Repetitions a row. The ratio of two standard deviations is uncertain by 1/√(2·repetitions), here 1.8 %, so that the most
/// extreme of 32 coefficients lies within 5 %.
pub(crate) const REPETITIONS: u64 = 1500;

/// 95 % of a normal distribution lie within so many standard deviations.
const NINETY_FIVE: f64 = 1.959_964;

/// RMS error of S over the bound: both over random sensors of the setting. Every trial must be solved.
pub(crate) fn error_over_bound<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    setting: Setting,
) -> f64 {
    let (mut squared_error, mut least) = (0.0, 0.0);
    for repetition in 0..REPETITIONS {
        let mut rng = random(repetition);
        let sensor: KnownSensor<GAGES, RANK> = setting.sensor(&mut rng);
        let mut information = Information::new(&sensor);
        let codes = trial(&sensor, setting.samples, &mut rng, |direction| information.add(direction));
        let Ok(answer) = solve_trial::<GAGES, HIGHER>(&moments_of(&codes), rank::<RANK>()) else {
            return f64::INFINITY;
        };
        squared_error += Comparison::new(&sensor, &answer).shape_error.norm_squared();
        least += information.least_shape_error();
    }
    (squared_error / least).sqrt()
}

/// How honest the predictions are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Honesty {
    /// The least ratio of predicted to observed standard deviation of any coefficient.
    pub(crate) least_ratio: f64,
    /// The largest.
    pub(crate) largest_ratio: f64,
    /// The share of errors within the predicted 95 % interval.
    pub(crate) covered: f64,
}

/// Predicted against observed deviations of every coefficient of S and b, of one sensor, in the orientation of the truth.
/// Observed is the RMS error, so that a bias counts, too.
pub(crate) fn honesty<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    setting: Setting,
) -> Honesty {
    let mut rng = random(1);
    let sensor: KnownSensor<GAGES, RANK> = setting.sensor(&mut rng);
    let mut sums = HonestySums::new((RANK + 1) * GAGES);
    for _ in 0..REPETITIONS {
        let codes = trial(&sensor, setting.samples, &mut rng, |_| ());
        let Ok(answer) = solve_trial::<GAGES, HIGHER>(&moments_of(&codes), rank::<RANK>()) else { continue };
        sums.add(Comparison::new(&sensor, &answer).errors());
    }
    sums.honesty()
}

/// Errors and their predicted standard deviations, summed up over trials of one sensor.
#[derive(Clone, Debug)]
pub(crate) struct HonestySums {
    /// Of every coefficient: the sums of squares predicted and observed.
    squares: Vec<(f64, f64)>,
    covered: usize,
    answers: usize,
}

impl HonestySums {
    /// Nothing yet.
    pub(crate) fn new(coefficients: usize) -> Self {
        Self { squares: vec![(0.0, 0.0); coefficients], covered: 0, answers: 0 }
    }

    /// Adds one trial: every error with its predicted standard deviation.
    pub(crate) fn add(&mut self, errors: impl Iterator<Item = (f64, f64)>) {
        self.answers += 1;
        for (sum, (error, deviation)) in self.squares.iter_mut().zip(errors) {
            sum.0 += deviation * deviation;
            sum.1 += error * error;
            self.covered += usize::from(error.abs() <= NINETY_FIVE * deviation);
        }
    }

    /// What they say.
    pub(crate) fn honesty(&self) -> Honesty {
        let ratios = self.squares.iter().map(|(predicted, observed)| (predicted / observed).sqrt());
        Honesty {
            least_ratio: ratios.clone().fold(f64::INFINITY, f64::min),
            largest_ratio: ratios.fold(0.0, f64::max),
            covered: self.covered as f64 / (self.squares.len() * self.answers) as f64,
        }
    }
}

/// The codes of one trial; `seen` gets the direction of every sample.
pub(crate) fn trial<const GAGES: usize, const RANK: usize>(
    sensor: &KnownSensor<GAGES, RANK>,
    samples: usize,
    rng: &mut ChaCha8Rng,
    mut seen: impl FnMut(&SVector<f64, RANK>),
) -> Vec<[AdcCode; GAGES]> {
    (0..samples)
        .map(|_| {
            let direction =
                SVector::<f64, RANK>::from_fn(|_, _| StandardNormal.sample(&mut *rng)).normalize();
            seen(&direction);
            sensor.codes(&direction, rng)
        })
        .collect()
}
