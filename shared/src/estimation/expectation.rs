//! What a trial that has been solved once expects of its samples: that their codes lie in the subspace of the shape, and that the
//! load's magnitude is what it was (design § 5, § 8).
//!
//! The samples are judged by the means of blocks of four, as the gate takes them. The load of a block is m = C(z̄ − b), and what
//! remains, e = z̄ − b − Sᵀm, is noise whatever the load.
//!
//! * **Parity.** ‖e‖² has the mean σ² tr P / 4 and the variance 2σ⁴ tr P² / 16 with the covariance σ²P of what a sample leaves,
//!   and is taken for the χ² that has both (Satterthwaite). Where it is more than chance would bring about once in 10⁶
//!   blocks, the codes are no answer to a load at this arm: a glitch in a channel, or a hand on the sensor. What the subspace
//!   itself is uncertain by in directions in which the load has not been yet is added.
//! * **Magnitude.** |m|² − 1 has the variance v(m) of [`super::uncertainty`], with the noise of a mean of four, and the solution's
//!   own uncertainty besides.
//!
//! What the sensor is off by because it is not quite linear is contained in both variances as a mean over all directions; in some
//! it is more. The limit of the magnitude has room for that; that of the parity, which has several degrees of freedom, is doubled in
//! amplitude: it is gross errors that are to be found here, not directions. All is in single precision.

use super::eigen::symmetric_eigen;
use super::rest_noise::chi_square_limit;
use super::shape::TrialSolution;
use crate::refusal::Refusal;
use crate::units::MAX_RANK;

/// Samples in a block.
const SAMPLES: f64 = super::gate::BLOCK as f64;

/// The fewest samples of a solution that anything is expected from: the subspace is then known to a tenth of the noise.
const LEAST_SAMPLES: u64 = 400;

/// The largest parity over what chance alone would bring about, in amplitude.
const PARITY_MARGIN: f64 = 2.0;

/// Once in 10⁶ samples, two-sided, in standard deviations.
const LARGEST_DEVIATION: f64 = 4.9;

/// |m|² is off by mᵀEm + hᵀm, six terms of twice the worst standard deviation at most.
const SHARE_OF_WORST: f64 = 12.0;

/// What is expected of a block of samples of `GAGES` channels.
#[derive(Clone, Debug)]
pub struct Expectation<const GAGES: usize> {
    /// The sum of a block with no load, rounded: an eighth of a count of its mean at most.
    pivot: [i32; GAGES],
    /// C (r × p) over the samples of a block, per unit load; rows beyond the rank are zero.
    to_load: [[f32; MAX_RANK]; GAGES],
    /// S (r × p) times the samples of a block, counts per unit load; rows beyond the rank are zero.
    shape: [[f32; MAX_RANK]; GAGES],
    /// The largest ‖e‖² for the sum of a block, counts²; infinite where nothing is redundant.
    largest_parity: f32,
    /// The largest change of |m|².
    largest_change: f32,
}

/// How a block meets the expectation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meets {
    /// It does.
    Both,
    /// The load's magnitude is another.
    ParityAlone,
    /// The codes answer to no load at this arm.
    Neither,
}

impl<const GAGES: usize> Expectation<GAGES> {
    /// What this solution expects; `None` where it stands on too few samples to expect anything.
    ///
    /// # Errors
    ///
    /// [`Refusal::NonFinite`].
    pub fn new(solution: &TrialSolution<GAGES>) -> Result<Option<Self>, Refusal> {
        if solution.samples < LEAST_SAMPLES {
            return Ok(None);
        }
        let load_noise = symmetric_eigen(&solution.load_noise, solution.rank.count())?.values / SAMPLES;
        let variance = 4.0 * load_noise.max() + 2.0 * load_noise.norm_squared() + solution.unexplained;
        let change =
            LARGEST_DEVIATION * libm::sqrt(variance) + SHARE_OF_WORST * solution.uncertainty.worst_relative();
        let mut expected = Self {
            pivot: [0; GAGES],
            to_load: [[0.0; MAX_RANK]; GAGES],
            shape: [[0.0; MAX_RANK]; GAGES],
            largest_parity: largest_parity(solution),
            #[expect(clippy::cast_possible_truncation, reason = "a limit needs three digits")]
            largest_change: change as f32,
        };
        #[expect(clippy::cast_possible_truncation, reason = "single precision is what the sample path has")]
        for gage in 0..GAGES {
            expected.pivot[gage] = libm::round(SAMPLES * solution.bias_counts[gage]) as i32;
            for row in 0..MAX_RANK {
                expected.to_load[gage][row] = (solution.to_load[(row, gage)] / SAMPLES) as f32;
                expected.shape[gage][row] = (solution.shape_counts_per_load[(row, gage)] * SAMPLES) as f32;
            }
        }
        Ok(Some(expected))
    }

    /// Compares a block, given as the sum of its samples, with it.
    pub fn judge(&self, sum: &[i32; GAGES]) -> Meets {
        // A bias is about inside of the converter's range: the difference has 27 bits, or wraps around into nonsense that is
        // no load.
        let signal: [f32; GAGES] =
            core::array::from_fn(|gage| sum[gage].wrapping_sub(self.pivot[gage]) as f32);
        let [mut x, mut y, mut z] = [0.0; MAX_RANK];
        for (signal, [to_x, to_y, to_z]) in signal.iter().zip(&self.to_load) {
            x += to_x * signal;
            y += to_y * signal;
            z += to_z * signal;
        }
        let mut parity = 0.0;
        for (signal, [of_x, of_y, of_z]) in signal.iter().zip(&self.shape) {
            let rest = signal - of_x * x - of_y * y - of_z * z;
            parity += rest * rest;
        }
        let squared = x * x + y * y + z * z;
        if parity > self.largest_parity {
            Meets::Neither
        } else if (squared - 1.0).abs() > self.largest_change {
            Meets::ParityAlone
        } else {
            Meets::Both
        }
    }
}

/// What ‖e‖² of a block's sum exceeds by chance once in 10⁶ blocks, and the margin; counts².
fn largest_parity<const GAGES: usize>(solution: &TrialSolution<GAGES>) -> f32 {
    let noise = &solution.redundant_noise;
    let (mean, mean_square) = (noise.trace(), noise.norm_squared());
    match solution.noise_variance {
        Some(variance) if GAGES > solution.rank.count() => {
            let freedom = mean * mean / mean_square;
            // The subspace is a regression, and off by ⟨(m, 1) across (m, 1)⟩ in direction m: by twice the trace at most.
            let of_subspace = 2.0 * SAMPLES * solution.uncertainty.across().trace() / variance;
            let limit =
                SAMPLES * variance * (1.0 + of_subspace) * mean_square / mean * chi_square_limit(freedom);
            #[expect(clippy::cast_possible_truncation, reason = "a limit needs three digits")]
            let limit = (PARITY_MARGIN * PARITY_MARGIN * limit) as f32;
            limit
        }
        _ => f32::INFINITY,
    }
}
