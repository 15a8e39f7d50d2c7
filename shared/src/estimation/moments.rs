//! Streaming moments: all that the estimator needs of a trial, in one pass and fixed memory (design § 2).
//!
//! The p×p Gram matrix gives the subspace of the motion, but the metric constraint (eq. 13) is itself quadratic in the
//! codes, so that its least-squares solution needs moments up to degree four. All are taken about an integer **pivot**
//! (the first sample, or the tare), which keeps an offset from eating the precision.
//!
//! # Precision
//!
//! * Count, sum and Gram matrix are **exact integers**: the noise stands 10⁻⁶ … 10⁻⁸ below the signal's variance, and
//!   the redundant eigenvalues that measure it must survive. A difference of two 24-bit codes has 25 bits, a product
//!   at most 2⁴⁸; a block of 8192 products stays within 2⁶¹ in an `i64`, and blocks add up in an `i128`.
//! * Sums of degree 3 and 4 need a relative accuracy of 10⁻⁶ only, times the fourth power of how far from round the
//!   shape is. They are added in `f32`, the only floating point that the sensor has in hardware, with compensation for
//!   what each addition rounds away (Kahan): the error of such a sum is 2u + O(N u²) of the sum of the magnitudes,
//!   u = 2⁻²⁴, so that the second term stays below 10⁻⁶ for N = 2²⁸ batches. What remains is the rounding of the products
//!   themselves, about 5·10⁻⁸ of a batch and independent from batch to batch: 5·10⁻⁸/√(n/8) of the sum. The differences
//!   are taken in units of 2¹² counts, so that the largest sum that can come about, 2³² fourth powers of 25 bits, has 84.
//!
//! # Speed
//!
//! Samples are absorbed in batches of [`BATCH`], so that each accumulator is loaded and stored once a batch. A batch
//! that is settled before it is full is filled up with zeros, which add nothing to any sum. `tests/speed` counts the
//! instructions on the target.
//!
//! # Algebra
//!
//! Accumulators about one pivot add ([`Moments::merge`]): associative and commutative, exactly so for sum and Gram
//! matrix and to rounding for the rest. A trial can thus be cut and resumed.

mod saved;

pub use saved::saved_words;

use super::code_sums::{CodeSums, MAX_SAMPLES};
use super::monomials::{Compensated, add_higher_monomials};
use crate::refusal::Refusal;
use crate::units::{AdcCode, MAX_GAGES};

/// Samples absorbed at once.
pub const BATCH: usize = 8;

/// The unit of the differences in single precision, counts: a power of two, which rounds nothing.
pub(super) const UNIT: f32 = 4096.0;

/// Samples whose products are added up in `i64` before they are spilled into `i128`.
pub const BLOCK: usize = 8192;

/// The same in batches.
#[expect(clippy::cast_possible_truncation, reason = "1024")]
const BATCHES_PER_BLOCK: u16 = (BLOCK / BATCH) as u16;

/// The number of monomials of degree 3 and 4 in this many variables: C(p+2, 3) + C(p+3, 4).
pub const fn higher_moment_count(gages: usize) -> usize {
    let cubic = gages * (gages + 1) * (gages + 2) / 6;
    let quartic = gages * (gages + 1) * (gages + 2) * (gages + 3) / 24;
    cubic + quartic
}

/// The sums of one trial over `GAGES` channels, about an integer pivot.
///
/// `HIGHER` must be [`higher_moment_count`]`(GAGES)`; anything else does not compile. (The language cannot yet derive
/// one constant from the other.)
#[derive(Clone, Debug)]
pub struct Moments<const GAGES: usize, const HIGHER: usize> {
    codes: CodeSums<GAGES>,
    /// Σ ΔᵢΔⱼΔₖ and Σ ΔᵢΔⱼΔₖΔₗ for i ≤ j ≤ k ≤ l, in the order of `for_each_higher_monomial`, with Δ in [`UNIT`]s.
    higher: [Compensated; HIGHER],
    block: Block<GAGES>,
    batch: Batch<GAGES>,
}

/// The products since the last spill.
#[derive(Clone, Debug)]
struct Block<const GAGES: usize> {
    batches: u16,
    gram: [[i64; GAGES]; GAGES],
}

/// The samples since the last absorption, as differences from the pivot, channel by channel.
#[derive(Clone, Debug)]
struct Batch<const GAGES: usize> {
    samples: usize,
    difference: [[i32; BATCH]; GAGES],
    /// The same in single precision, in [`UNIT`]s. At most 25 bits: rounded by 2⁻²⁵ of its value, far below what degree 3
    /// and 4 need.
    rounded: [[f32; BATCH]; GAGES],
}

impl<const GAGES: usize> Batch<GAGES> {
    const EMPTY: Self = Self { samples: 0, difference: [[0; BATCH]; GAGES], rounded: [[0.0; BATCH]; GAGES] };

    /// Puts zeros where no sample is yet: what the batch before has left there.
    fn clear_rest(&mut self) {
        for (channel, rounded) in self.difference.iter_mut().zip(&mut self.rounded) {
            channel[self.samples..].fill(0);
            rounded[self.samples..].fill(0.0);
        }
    }
}

impl<const GAGES: usize, const HIGHER: usize> Moments<GAGES, HIGHER> {
    const DIMENSIONS_AGREE: () =
        assert!(HIGHER == higher_moment_count(GAGES) && 2 <= GAGES && GAGES <= MAX_GAGES);

    /// An empty accumulator about `pivot`.
    pub const fn new(pivot: [AdcCode; GAGES]) -> Self {
        let () = Self::DIMENSIONS_AGREE;
        Self {
            codes: CodeSums::new(pivot),
            higher: [Compensated::ZERO; HIGHER],
            block: Block { batches: 0, gram: [[0; GAGES]; GAGES] },
            batch: Batch::EMPTY,
        }
    }

    /// Empties the accumulator in place and moves it to a new pivot.
    pub fn restart(&mut self, pivot: [AdcCode; GAGES]) {
        self.codes = CodeSums::new(pivot);
        self.higher = [Compensated::ZERO; HIGHER];
        self.block.batches = 0;
        self.block.gram = [[0; GAGES]; GAGES];
        self.batch = Batch::EMPTY;
    }

    /// The codes about which the sums are taken.
    pub const fn pivot(&self) -> &[AdcCode; GAGES] {
        &self.codes.pivot
    }

    /// The number of samples taken in.
    pub const fn count(&self) -> u64 {
        self.codes.count
    }

    /// Takes in one sample of all channels.
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] at [`MAX_SAMPLES`]; the accumulator is left as it was.
    pub fn push(&mut self, codes: &[AdcCode; GAGES]) -> Result<(), Refusal> {
        if self.codes.count >= MAX_SAMPLES {
            return Err(Refusal::OverflowAhead { samples: self.codes.count });
        }
        let slot = self.batch.samples;
        for gage in 0..GAGES {
            let difference = codes[gage].counts() - self.codes.pivot[gage].counts();
            self.batch.difference[gage][slot] = difference;
            self.batch.rounded[gage][slot] = difference as f32 * (1.0 / UNIT);
        }
        self.codes.count += 1;
        self.batch.samples += 1;
        if self.batch.samples == BATCH {
            self.absorb_batch();
        }
        Ok(())
    }

    /// Adds the sums of another accumulator about the same pivot.
    ///
    /// # Errors
    ///
    /// [`Refusal::PivotsDiffer`], or [`Refusal::OverflowAhead`] where both together exceed [`MAX_SAMPLES`]; `self` is
    /// then left as it was.
    pub fn merge(&mut self, other: &Self) -> Result<(), Refusal> {
        let mut other = other.clone();
        other.settle();
        self.settle();
        self.codes.add(&other.codes)?;
        for (mine, theirs) in self.higher.iter_mut().zip(&other.higher) {
            mine.join(*theirs);
        }
        Ok(())
    }

    /// Brings every sample taken in so far into the long sums. To be called before any of the readings below; taking
    /// in more samples afterwards is fine.
    pub fn settle(&mut self) {
        if self.batch.samples > 0 {
            self.batch.clear_rest();
            self.absorb_batch();
        }
        self.spill_block();
    }

    /// Count, sum and Gram matrix. Settle first.
    pub const fn codes(&self) -> &CodeSums<GAGES> {
        &self.codes
    }

    /// The sums of degree 3 and 4, in the order of `for_each_higher_monomial` and in powers of [`UNIT`]. Settle first.
    pub(super) const fn higher_sums(&self) -> &[Compensated; HIGHER] {
        &self.higher
    }

    /// Brings what is being absorbed to its end, which changes no sum that there will be. Samples that wait for more.
    fn finish_absorption(&mut self) -> u64 {
        self.batch.samples as u64
    }

    fn absorb_batch(&mut self) {
        for i in 0..GAGES {
            let left = &self.batch.difference[i];
            // Eight differences of 25 bits have 28.
            self.codes.sum[i] += i64::from(left.iter().sum::<i32>());
            for j in i..GAGES {
                let right = &self.batch.difference[j];
                let mut products = 0_i64;
                for lane in 0..BATCH {
                    products += i64::from(left[lane]) * i64::from(right[lane]);
                }
                self.block.gram[i][j] += products;
            }
        }
        add_higher_monomials(&self.batch.rounded, &mut self.higher);

        self.batch.samples = 0;
        self.block.batches += 1;
        if self.block.batches == BATCHES_PER_BLOCK {
            self.spill_block();
        }
    }

    fn spill_block(&mut self) {
        for i in 0..GAGES {
            for j in i..GAGES {
                self.codes.gram[i][j] += i128::from(self.block.gram[i][j]);
                self.block.gram[i][j] = 0;
            }
        }
        self.block.batches = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::{Moments, UNIT, higher_moment_count};
    use crate::estimation::monomials::{HigherMonomial, for_each_higher_monomial};
    use crate::refusal::Refusal;
    use crate::units::AdcCode;

    fn code(counts: i32) -> AdcCode {
        AdcCode::new(counts).unwrap()
    }

    #[test]
    fn the_counts_of_the_design_notes() {
        for (gages, count) in [(4, 55), (6, 182), (8, 450), (12, 1729)] {
            assert_eq!(higher_moment_count(gages), count);
        }
    }

    #[test]
    fn the_gram_matrix_is_exact_at_full_scale() {
        // The largest difference that 24-bit codes allow, 1000 times: every product is (2²⁴ − 1)².
        let mut moments = Moments::<2, 9>::new([AdcCode::MIN; 2]);
        for _ in 0..1000 {
            moments.push(&[AdcCode::MAX; 2]).unwrap();
        }
        moments.settle();
        let product = i128::from((1_i64 << 24) - 1).pow(2);
        assert_eq!(moments.codes.gram[0][1], 1000 * product);
        assert_eq!(moments.codes().covariance()[(0, 1)], 0.0);
    }

    #[test]
    fn an_offset_of_half_the_range_costs_nothing() {
        // One count of ripple on a large offset, pivot at the far end of the range.
        let mut moments = Moments::<2, 9>::new([AdcCode::MIN; 2]);
        for sample in 0..100_000 {
            moments.push(&[code(4_000_000 + sample % 2), code(4_000_000)]).unwrap();
        }
        moments.settle();
        assert_eq!(moments.codes().covariance()[(0, 0)], 0.25);
        assert_eq!(moments.codes().mean().counts[0], 4_000_000.5);
    }

    #[test]
    fn higher_sums_match_their_definition() {
        let samples: [[i32; 3]; 5] = [[3, -1, 7], [0, 2, -5], [11, 4, 1], [-6, -2, 9], [8, 8, -8]];
        let mut moments = Moments::<3, 25>::new([AdcCode::ZERO; 3]);
        for sample in samples {
            moments.push(&sample.map(code)).unwrap();
        }
        moments.settle();
        let mut sums = moments.higher_sums().iter();
        for_each_higher_monomial(3, |monomial| {
            let expected: i32 = samples
                .iter()
                .map(|sample| match monomial {
                    HigherMonomial::Cubic(index) => index.map(|i| sample[i]).iter().product::<i32>(),
                    HigherMonomial::Quartic(index) => index.map(|i| sample[i]).iter().product::<i32>(),
                })
                .sum();
            let unit = f64::from(UNIT).powi(match monomial {
                HigherMonomial::Cubic(_) => 3,
                HigherMonomial::Quartic(_) => 4,
            });
            assert_eq!(sums.next().map(|sum| sum.value() * unit), Some(f64::from(expected)));
        });
        assert!(sums.next().is_none());
    }

    #[test]
    fn accumulators_about_different_pivots_do_not_merge() {
        let mut left = Moments::<2, 9>::new([AdcCode::ZERO; 2]);
        let right = Moments::<2, 9>::new([code(1); 2]);
        assert_eq!(left.merge(&right), Err(Refusal::PivotsDiffer));
    }
}
