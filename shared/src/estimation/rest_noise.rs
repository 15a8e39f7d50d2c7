//! The noise of the channels and its correlation, measured while the load hangs still (design § 3.1).
//!
//! A block of four successive samples z₁ … z₄ at rest gives the contrast c = (z₁ − z₂) − (z₃ − z₄), which knows nothing of the
//! load, nor of a drift that is even: ⟨ccᵀ⟩ = 4R, with the covariance R of the noise. All is summed up in integers, so that
//! sensor and host agree to the last bit.
//!
//! **When it is used.** An R that is measured itself costs about p/N of the accuracy, N being the contrasts. It pays only where the
//! channels differ, and whether they do is asked first: the likelihood ratio of "all channels are equally noisy and
//! independent" against R is −N·ln(det R / (tr R/p)ᵖ), with Bartlett's correction distributed as χ² of p(p+1)/2 − 1 degrees of
//! freedom (Mauchly 1940). What would come about by chance once in 10⁶ trials is no difference, nor is one too small to gain
//! anything by.
//!
//! **Rounding.** A load at rest gives the same code again and again where the noise is finer than a step of the converter, and yet
//! the codes are off by up to half a step, each way of it equally likely over the motion: no channel has less than 1/12
//! step².

use nalgebra::{Cholesky, SMatrix};

use crate::units::AdcCode;

/// The largest contrast of noise, counts: beyond it a block is not at rest. Squares have 40 bits, and 2²² of them 62.
const LARGEST_CONTRAST: i32 = 1 << 20;

/// Contrasts after which no more are taken: R is then known to less than 10⁻³.
const MOST_CONTRASTS: u32 = 1 << 22;

/// The fewest contrasts for each channel that say anything of R.
const LEAST_CONTRASTS_PER_CHANNEL: u32 = 16;

/// Variance of the rounding to whole codes, counts².
pub const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// The least −ln det R that is worth while, R being relative to its mean: one channel of eight twice as noisy as the rest has 1.2. A
/// load that swings a little in what passes for rests pretends less, and along the load.
const LEAST_DIFFERENCE: f64 = 1.0;

/// Variance of a contrast over that of a sample.
const CONTRAST_VARIANCE: f64 = 4.0;

/// One case in 10⁶, in standard deviations of a normal distribution, one-sided.
const ONCE_IN_A_MILLION: f64 = 4.75;

/// Sums of contrasts over `GAGES` channels.
#[derive(Clone, Debug)]
pub struct RestNoise<const GAGES: usize> {
    pub(super) contrasts: u32,
    /// Σ cᵢcⱼ for i ≤ j, counts²; the lower triangle stays zero.
    pub(super) products: [[i64; GAGES]; GAGES],
}

/// The noise of the channels, as far as it is known beforehand.
#[derive(Clone, Debug)]
pub struct ChannelNoise<const GAGES: usize> {
    /// The covariance (p × p) of the channels' noise over the mean of their variances; the identity where nothing else is
    /// known.
    pub relative: SMatrix<f64, GAGES, GAGES>,
    /// The mean of the channels' variances, counts²; `None` where the load never rested.
    pub variance: Option<f64>,
    /// Variance of the rounding to codes, counts²: no channel has less.
    pub rounding: f64,
}

impl<const GAGES: usize> ChannelNoise<GAGES> {
    /// Nothing is known but that the converter's steps are `step` counts.
    pub fn unknown(step: i32) -> Self {
        let step = f64::from(step.max(1));
        Self { relative: SMatrix::identity(), variance: None, rounding: step * step * QUANTISATION_VARIANCE }
    }

    /// Whether all channels are taken to be equally noisy and independent.
    pub fn is_equal(&self) -> bool {
        // Element by element: an identity to compare with would stand on the stack.
        let is_diagonal = |place: usize| place.is_multiple_of(GAGES + 1);
        self.relative
            .iter()
            .enumerate()
            .all(|(place, &element)| element == f64::from(u8::from(is_diagonal(place))))
    }
}

impl<const GAGES: usize> Default for RestNoise<GAGES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const GAGES: usize> RestNoise<GAGES> {
    /// No rest yet.
    pub const fn new() -> Self {
        Self { contrasts: 0, products: [[0; GAGES]; GAGES] }
    }

    /// Takes in four successive samples of a load at rest.
    pub fn take(&mut self, block: &[[AdcCode; GAGES]; 4]) {
        let [first, second, third, fourth] = block;
        let mut contrast = [0; GAGES];
        for gage in 0..GAGES {
            let early = first[gage].counts() - second[gage].counts();
            let late = third[gage].counts() - fourth[gage].counts();
            contrast[gage] = early - late;
        }
        let at_rest = contrast.iter().all(|contrast| contrast.abs() <= LARGEST_CONTRAST);
        if !at_rest || self.contrasts >= MOST_CONTRASTS {
            return;
        }
        self.contrasts += 1;
        for i in 0..GAGES {
            for j in i..GAGES {
                self.products[i][j] += i64::from(contrast[i]) * i64::from(contrast[j]);
            }
        }
    }

    /// What the rests tell of the noise of a converter whose steps are `step` counts.
    #[inline(never)]
    pub fn channels(&self, step: i32) -> ChannelNoise<GAGES> {
        let unknown = ChannelNoise::unknown(step);
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let needed = LEAST_CONTRASTS_PER_CHANNEL * GAGES as u32;
        if self.contrasts < needed {
            return unknown;
        }
        let divisor = CONTRAST_VARIANCE * f64::from(self.contrasts);
        let covariance = SMatrix::<f64, GAGES, GAGES>::from_fn(|row, column| {
            let (low, high) = if row <= column { (row, column) } else { (column, row) };
            let measured = self.products[low][high] as f64 / divisor;
            if row == column { measured.max(unknown.rounding) } else { measured }
        });
        let mean = covariance.trace() / GAGES as f64;
        let relative = covariance / mean;
        let relative = if self.differ(&relative) { relative } else { SMatrix::identity() };
        ChannelNoise { relative, variance: Some(mean), ..unknown }
    }

    /// Whether these relative covariances are more than chance.
    fn differ(&self, relative: &SMatrix<f64, GAGES, GAGES>) -> bool {
        let Some(factor) = Cholesky::new(*relative) else { return false };
        let log_determinant: f64 =
            factor.l_dirty().diagonal().iter().map(|element| 2.0 * libm::log(*element)).sum();
        let channels = GAGES as f64;
        let correction = (2.0 * channels * channels + channels + 2.0) / (6.0 * channels);
        let ratio = -(f64::from(self.contrasts) - correction) * log_determinant;
        -log_determinant > LEAST_DIFFERENCE
            && ratio > chi_square_limit(channels * (channels + 1.0) / 2.0 - 1.0)
    }
}

/// What a χ² of so many degrees of freedom exceeds once in 10⁶ cases (Wilson and Hilferty 1931): from 4 % too much at five
/// degrees to 15 % at one.
pub(super) fn chi_square_limit(freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    let root = 1.0 - spread + ONCE_IN_A_MILLION * libm::sqrt(spread);
    freedom * root * root * root
}

#[cfg(test)]
mod tests {
    use super::{RestNoise, chi_square_limit};
    use crate::units::AdcCode;

    #[test]
    fn codes_that_stand_still_tell_the_rounding_and_a_drift_is_no_noise() {
        let (mut still, mut drifting) = (RestNoise::<3>::new(), RestNoise::<3>::new());
        for block in 0..100 {
            still.take(&[[AdcCode::ZERO; 3]; 4]);
            drifting.take(&[0, 1, 2, 3].map(|sample| [AdcCode::saturating(70 * (4 * block + sample)); 3]));
        }
        for sums in [still, drifting] {
            let noise = sums.channels(16);
            assert_eq!(noise.variance, Some(256.0 / 12.0));
            assert!(noise.is_equal());
        }
    }

    #[test]
    fn a_few_rests_tell_nothing() {
        let mut sums = RestNoise::<3>::new();
        for _ in 0..47 {
            sums.take(&[[AdcCode::ZERO; 3]; 4]);
        }
        assert_eq!(sums.channels(1).variance, None);
    }

    #[test]
    fn the_limit_is_that_of_the_tables_or_a_little_above() {
        for (freedom, table) in [(1.0, 23.93), (3.0, 30.66), (5.0, 35.89)] {
            let ratio = chi_square_limit(freedom) / table;
            assert!((1.0..1.16).contains(&ratio), "{freedom}: {ratio}");
        }
    }
}
