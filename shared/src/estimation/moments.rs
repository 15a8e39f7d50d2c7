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
//!   shape is. They are added in `f32`, with compensation for what each addition rounds away (Kahan), and in `f64`
//!   across blocks: the error of a compensated sum does not grow with the 1024 batches of a block (Kahan's bound is
//!   2u + O(N u²), u = 2⁻²⁴, so that the second term is 10⁻⁴ of the first). What remains is the rounding of the products themselves, about 5·10⁻⁸ of a batch and independent
//!   from batch to batch: 5·10⁻⁸/√(n/8) of the sum.
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

use nalgebra::{SMatrix, SVector};

use crate::refusal::Refusal;
use crate::units::{AdcCode, MAX_GAGES};

/// Samples absorbed at once.
pub const BATCH: usize = 8;

/// Samples added up in `f32` and `i64` before they are spilled into `f64` and `i128`. The sensor has no `f64` in
/// hardware, so that a spill costs as much as 50 samples; at this length it is a trifle.
pub const BLOCK: usize = 8192;

/// The same in batches.
#[expect(clippy::cast_possible_truncation, reason = "1024")]
const BATCHES_PER_BLOCK: u16 = (BLOCK / BATCH) as u16;

/// The most samples that one accumulator takes: 36 hours at 32 000 samples/s.
///
/// At n samples the exact covariance needs n·ΣΔ² ≤ n²·2⁴⁸; at 2³² samples this is 2¹¹², inside an `i128`.
pub const MAX_SAMPLES: u64 = 1 << 32;

/// The number of monomials of degree 3 and 4 in this many variables: C(p+2, 3) + C(p+3, 4).
pub const fn higher_moment_count(gages: usize) -> usize {
    let cubic = gages * (gages + 1) * (gages + 2) / 6;
    let quartic = gages * (gages + 1) * (gages + 2) * (gages + 3) / 24;
    cubic + quartic
}

/// The number of channels and of products of two of them.
const fn factor_count(gages: usize) -> usize {
    gages + gages * (gages + 1) / 2
}

/// The sums of one trial over `GAGES` channels, about an integer pivot.
///
/// `HIGHER` must be [`higher_moment_count`]`(GAGES)`; anything else does not compile. (The language cannot yet derive
/// one constant from the other.)
#[derive(Clone, Debug)]
pub struct Moments<const GAGES: usize, const HIGHER: usize> {
    pivot: [AdcCode; GAGES],
    count: u64,
    /// Σ Δ, counts.
    sum: [i64; GAGES],
    /// Σ Δᵢ Δⱼ for i ≤ j, counts²; the lower triangle stays zero.
    gram: [[i128; GAGES]; GAGES],
    /// Σ ΔᵢΔⱼΔₖ and Σ ΔᵢΔⱼΔₖΔₗ for i ≤ j ≤ k ≤ l, in the order of [`for_each_higher_monomial`].
    higher: [f64; HIGHER],
    block: Block<GAGES, HIGHER>,
    batch: Batch<GAGES>,
}

/// The sums since the last spill.
#[derive(Clone, Debug)]
struct Block<const GAGES: usize, const HIGHER: usize> {
    batches: u16,
    gram: [[i64; GAGES]; GAGES],
    higher: [Compensated; HIGHER],
}

/// A sum in single precision that remembers what its last addition rounded away (Kahan).
#[derive(Clone, Copy, Debug)]
struct Compensated {
    sum: f32,
    excess: f32,
}

impl Compensated {
    const ZERO: Self = Self { sum: 0.0, excess: 0.0 };

    #[inline]
    fn add(&mut self, term: f32) {
        let corrected = term - self.excess;
        let sum = self.sum + corrected;
        self.excess = (sum - self.sum) - corrected;
        self.sum = sum;
    }

    fn value(self) -> f64 {
        f64::from(self.sum) - f64::from(self.excess)
    }
}

/// The samples since the last absorption, as differences from the pivot, channel by channel.
#[derive(Clone, Debug)]
struct Batch<const GAGES: usize> {
    samples: usize,
    difference: [[i32; BATCH]; GAGES],
    /// The same in single precision. At most 25 bits: rounded by 2⁻²⁵ of its value, far below what degree 3 and 4 need.
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
            pivot,
            count: 0,
            sum: [0; GAGES],
            gram: [[0; GAGES]; GAGES],
            higher: [0.0; HIGHER],
            block: Block { batches: 0, gram: [[0; GAGES]; GAGES], higher: [Compensated::ZERO; HIGHER] },
            batch: Batch::EMPTY,
        }
    }

    /// Empties the accumulator in place and moves it to a new pivot.
    pub fn restart(&mut self, pivot: [AdcCode; GAGES]) {
        self.pivot = pivot;
        self.count = 0;
        self.sum = [0; GAGES];
        self.gram = [[0; GAGES]; GAGES];
        self.higher = [0.0; HIGHER];
        self.block.batches = 0;
        self.block.gram = [[0; GAGES]; GAGES];
        self.block.higher = [Compensated::ZERO; HIGHER];
        self.batch = Batch::EMPTY;
    }

    /// The codes about which the sums are taken.
    pub const fn pivot(&self) -> &[AdcCode; GAGES] {
        &self.pivot
    }

    /// The number of samples taken in.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Takes in one sample of all channels.
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] at [`MAX_SAMPLES`]; the accumulator is left as it was.
    pub fn push(&mut self, codes: &[AdcCode; GAGES]) -> Result<(), Refusal> {
        if self.count >= MAX_SAMPLES {
            return Err(Refusal::OverflowAhead { samples: self.count });
        }
        let slot = self.batch.samples;
        for gage in 0..GAGES {
            let difference = codes[gage].counts() - self.pivot[gage].counts();
            self.batch.difference[gage][slot] = difference;
            self.batch.rounded[gage][slot] = difference as f32;
        }
        self.count += 1;
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
        self.absorb(&mut other.clone())
    }

    /// The same with no copy made: `other` is settled, and keeps its sums.
    ///
    /// # Errors
    ///
    /// Those of [`Moments::merge`].
    pub fn absorb(&mut self, other: &mut Self) -> Result<(), Refusal> {
        if self.pivot != other.pivot {
            return Err(Refusal::PivotsDiffer);
        }
        if self.count + other.count > MAX_SAMPLES {
            return Err(Refusal::OverflowAhead { samples: self.count + other.count });
        }
        other.settle();
        self.settle();
        self.count += other.count;
        for i in 0..GAGES {
            self.sum[i] += other.sum[i];
            for j in i..GAGES {
                self.gram[i][j] += other.gram[i][j];
            }
        }
        for (mine, theirs) in self.higher.iter_mut().zip(&other.higher) {
            *mine += theirs;
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

    /// The mean of the codes, counts. Settle first.
    pub fn mean_counts(&self) -> SVector<f64, GAGES> {
        SVector::from_fn(|i, _| f64::from(self.pivot[i].counts())) + self.mean_difference()
    }

    /// The mean difference from the pivot, counts. Settle first.
    pub fn mean_difference(&self) -> SVector<f64, GAGES> {
        SVector::from_fn(|i, _| self.sum[i] as f64 / self.samples())
    }

    /// The covariance of the codes (divisor n), counts². Settle first.
    ///
    /// Computed as (n·ΣΔᵢΔⱼ − ΣΔᵢ·ΣΔⱼ)/n² with an exact numerator, so that it is rounded once.
    pub fn covariance(&self) -> SMatrix<f64, GAGES, GAGES> {
        let samples = self.samples();
        SMatrix::from_fn(|row, column| {
            let (i, j) = if row <= column { (row, column) } else { (column, row) };
            let numerator =
                i128::from(self.count) * self.gram[i][j] - i128::from(self.sum[i]) * i128::from(self.sum[j]);
            numerator as f64 / (samples * samples)
        })
    }

    /// The mean products of two differences from the pivot, counts². Settle first.
    pub fn second_moment(&self, i: usize, j: usize) -> f64 {
        let (low, high) = if i <= j { (i, j) } else { (j, i) };
        self.gram[low][high] as f64 / self.samples()
    }

    /// The sums of degree 3 and 4, in the order of [`for_each_higher_monomial`]. Settle first.
    pub(crate) const fn higher_sums(&self) -> &[f64; HIGHER] {
        &self.higher
    }

    /// The number of samples as a divisor; 1 where there are none, so that the readings of an empty accumulator are
    /// zero rather than undefined.
    pub(crate) fn samples(&self) -> f64 {
        self.count.max(1) as f64
    }

    fn absorb_batch(&mut self) {
        for i in 0..GAGES {
            let left = &self.batch.difference[i];
            // Eight differences of 25 bits have 28.
            self.sum[i] += i64::from(left.iter().sum::<i32>());
            for j in i..GAGES {
                let right = &self.batch.difference[j];
                let mut products = 0_i64;
                for lane in 0..BATCH {
                    products += i64::from(left[lane]) * i64::from(right[lane]);
                }
                self.block.gram[i][j] += products;
            }
        }
        add_higher_monomials(&self.batch.rounded, &mut self.block.higher);

        self.batch.samples = 0;
        self.block.batches += 1;
        if self.block.batches == BATCHES_PER_BLOCK {
            self.spill_block();
        }
    }

    fn spill_block(&mut self) {
        for i in 0..GAGES {
            for j in i..GAGES {
                self.gram[i][j] += i128::from(self.block.gram[i][j]);
                self.block.gram[i][j] = 0;
            }
        }
        for (sum, partial) in self.higher.iter_mut().zip(&mut self.block.higher) {
            *sum += partial.value();
            *partial = Compensated::ZERO;
        }
        self.block.batches = 0;
    }
}

/// Adds the batch's monomials of degree 3 and 4 to `sums`, in the order of [`for_each_higher_monomial`].
///
/// Every one is a pair of channels times a channel or another pair. These second factors stand in a list, by their first
/// channel, each channel before the pairs that it begins: all that extend one pair are then one run without a gap, to the
/// end of the list. That keeps the innermost loop, which is most of all the work, long.
fn add_higher_monomials<const GAGES: usize>(lanes: &[[f32; BATCH]; GAGES], mut sums: &mut [Compensated]) {
    let mut factors = heapless::Vec::<[f32; BATCH], { factor_count(MAX_GAGES) }>::new();
    for k in 0..GAGES {
        // There is room for all, see `DIMENSIONS_AGREE`.
        factors.extend([lanes[k]]);
        factors.extend(lanes[k..].iter().map(|right| product(&lanes[k], right)));
    }
    for i in 0..GAGES {
        for j in i..GAGES {
            let pair = product(&lanes[i], &lanes[j]);
            let run = &factors[factors.len() - factor_count(GAGES - j)..];
            let Some((extended, rest)) = sums.split_at_mut_checked(run.len()) else { return };
            for (sum, factor) in extended.iter_mut().zip(run) {
                sum.add(total(&product(&pair, factor)));
            }
            sums = rest;
        }
    }
}

#[inline]
fn product(left: &[f32; BATCH], right: &[f32; BATCH]) -> [f32; BATCH] {
    core::array::from_fn(|lane| left[lane] * right[lane])
}

#[inline]
fn total(lanes: &[f32; BATCH]) -> f32 {
    // A tree, so that the sensor and the host add in the same order whatever their vector width.
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// One monomial of degree 3 or 4: its channels in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HigherMonomial {
    /// Δᵢ Δⱼ Δₖ with i ≤ j ≤ k.
    Cubic([usize; 3]),
    /// Δᵢ Δⱼ Δₖ Δₗ with i ≤ j ≤ k ≤ l.
    Quartic([usize; 4]),
}

/// Visits every monomial of degree 3 and 4 in the order in which [`Moments`] stores their sums: each cubic is followed
/// by the quartics that extend it.
pub(crate) fn for_each_higher_monomial(gages: usize, mut visit: impl FnMut(HigherMonomial)) {
    for i in 0..gages {
        for j in i..gages {
            for k in j..gages {
                visit(HigherMonomial::Cubic([i, j, k]));
                for l in k..gages {
                    visit(HigherMonomial::Quartic([i, j, k, l]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{HigherMonomial, Moments, for_each_higher_monomial, higher_moment_count};
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
        assert_eq!(moments.gram[0][1], 1000 * product);
        assert_eq!(moments.covariance()[(0, 1)], 0.0);
    }

    #[test]
    fn an_offset_of_half_the_range_costs_nothing() {
        // One count of ripple on a large offset, pivot at the far end of the range.
        let mut moments = Moments::<2, 9>::new([AdcCode::MIN; 2]);
        for sample in 0..100_000 {
            moments.push(&[code(4_000_000 + sample % 2), code(4_000_000)]).unwrap();
        }
        moments.settle();
        assert_eq!(moments.covariance()[(0, 0)], 0.25);
        assert_eq!(moments.mean_counts()[0], 4_000_000.5);
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
            assert_eq!(sums.next().copied(), Some(f64::from(expected)));
        });
        assert_eq!(sums.next(), None);
    }

    #[test]
    fn accumulators_about_different_pivots_do_not_merge() {
        let mut left = Moments::<2, 9>::new([AdcCode::ZERO; 2]);
        let right = Moments::<2, 9>::new([code(1); 2]);
        assert_eq!(left.merge(&right), Err(Refusal::PivotsDiffer));
    }
}
