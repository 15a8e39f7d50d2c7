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
//!   themselves, about 5·10⁻⁸ of a batch and independent from batch to batch: 4·10⁻⁸/√(n/16) of the sum. The differences
//!   are taken in units of 2¹² counts, so that the largest sum that can come about, 2³² fourth powers of 25 bits, has 84.
//!
//! # Speed
//!
//! Samples are absorbed in batches of [`BATCH`], so that each accumulator is loaded and stored once a batch. No sample may take
//! much longer than another, so that a full batch is absorbed while the next one fills: with each sample a share of the pairs
//! of channels, products of two and all monomials that begin with them. The shares are as equal as pairs allow. A batch that
//! is settled before it is full is filled up with zeros, which add nothing to any sum. `tests/speed` counts the instructions on the
//! target.
//!
//! # Algebra
//!
//! Accumulators about one pivot add ([`Moments::merge`]): associative and commutative, exactly so for sum and Gram
//! matrix and to rounding for the rest. A trial can thus be cut and resumed.

mod saved;

pub use saved::saved_words;

use super::code_sums::{CodeSums, MAX_SAMPLES};
use super::monomials::{Compensated, HALF, Lanes, add_monomials_of_pair, monomials_of_pair};
use crate::refusal::Refusal;
use crate::units::{AdcCode, MAX_GAGES};

/// Samples absorbed at once.
pub const BATCH: usize = 2 * HALF;

/// The unit of the differences in single precision, counts: a power of two, which rounds nothing.
pub(super) const UNIT: f32 = 4096.0;

/// Samples whose products are added up in `i64` before they are spilled into `i128`.
pub const BLOCK: usize = 8192;

/// The same in batches.
#[expect(clippy::cast_possible_truncation, reason = "512")]
const BATCHES_PER_BLOCK: u16 = (BLOCK / BATCH) as u16;

/// The number of monomials of degree 3 and 4 in this many variables: C(p+2, 3) + C(p+3, 4).
pub const fn higher_moment_count(gages: usize) -> usize {
    let cubic = gages * (gages + 1) * (gages + 2) / 6;
    let quartic = gages * (gages + 1) * (gages + 2) * (gages + 3) / 24;
    cubic + quartic
}

/// What absorbing a pair of channels takes, in monomials: those that begin with it, and as much as three for its product of
/// two and for turning to it.
const fn weight(gages: usize, second: usize) -> usize {
    monomials_of_pair(gages - second) + 3
}

/// How many shares of at most `most` all pairs make, taken in order.
const fn shares(gages: usize, most: usize) -> usize {
    let (mut shares, mut taken) = (1, 0);
    let mut first = 0;
    while first < gages {
        let mut second = first;
        while second < gages {
            let weight = weight(gages, second);
            if taken + weight > most {
                (shares, taken) = (shares + 1, 0);
            }
            taken += weight;
            second += 1;
        }
        first += 1;
    }
    shares
}

/// The least that each of [`BATCH`] shares must be allowed, so that they hold all pairs.
const fn least_share(gages: usize) -> usize {
    let mut most = weight(gages, 0);
    while shares(gages, most) > BATCH {
        most += 1;
    }
    most
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
    /// The one that fills, and the one that is being absorbed.
    batches: [Batch<GAGES>; 2],
    /// Which of them fills.
    filling: usize,
    absorption: Absorption,
}

/// How far the full batch is absorbed.
#[derive(Clone, Copy, Debug)]
struct Absorption {
    /// The next pair of channels, first ≤ second; beyond the last channel when all is done.
    pair: (usize, usize),
    /// Where its monomials begin among the higher sums.
    place: usize,
    /// Whether the block ends with this batch.
    spills: bool,
}

impl Absorption {
    const fn done(gages: usize) -> Self {
        Self { pair: (gages, gages), place: 0, spills: false }
    }
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
    difference: [[[i32; HALF]; 2]; GAGES],
    /// The same in single precision, in [`UNIT`]s. At most 25 bits: rounded by 2⁻²⁵ of its value, far below what degree 3
    /// and 4 need.
    rounded: [Lanes; GAGES],
}

impl<const GAGES: usize> Batch<GAGES> {
    const EMPTY: Self =
        Self { samples: 0, difference: [[[0; HALF]; 2]; GAGES], rounded: [[[0.0; HALF]; 2]; GAGES] };

    /// Puts a sample into its place.
    #[inline]
    fn put(&mut self, place: usize, codes: &[AdcCode; GAGES], pivot: &[AdcCode; GAGES]) {
        let keep = |code: &AdcCode, pivot: &AdcCode, exact: &mut [[i32; HALF]; 2], rounded: &mut Lanes| {
            let difference = code.counts() - pivot.counts();
            exact.as_flattened_mut()[place] = difference;
            rounded.as_flattened_mut()[place] = difference as f32 * (1.0 / UNIT);
        };
        let ((code_fours, code_rest), (pivot_fours, pivot_rest)) =
            (codes.as_chunks::<4>(), pivot.as_chunks::<4>());
        let (exact_fours, exact_rest) = self.difference.as_chunks_mut::<4>();
        let (rounded_fours, rounded_rest) = self.rounded.as_chunks_mut::<4>();
        // Four at a time: see `monomials`.
        let four_to_keep = exact_fours.iter_mut().zip(rounded_fours);
        for (([a, b, c, d], [e, f, g, h]), (exact, rounded)) in
            code_fours.iter().zip(pivot_fours).zip(four_to_keep)
        {
            let ([i, j, k, l], [m, n, o, p]) = (exact, rounded);
            keep(a, e, i, m);
            keep(b, f, j, n);
            keep(c, g, k, o);
            keep(d, h, l, p);
        }
        let to_keep = exact_rest.iter_mut().zip(rounded_rest);
        for ((code, pivot), (exact, rounded)) in code_rest.iter().zip(pivot_rest).zip(to_keep) {
            keep(code, pivot, exact, rounded);
        }
    }

    /// Puts zeros where no sample is yet: what the batch before has left there.
    fn clear_rest(&mut self) {
        for (channel, rounded) in self.difference.iter_mut().zip(&mut self.rounded) {
            channel.as_flattened_mut()[self.samples..].fill(0);
            rounded.as_flattened_mut()[self.samples..].fill(0.0);
        }
    }
}

impl<const GAGES: usize, const HIGHER: usize> Moments<GAGES, HIGHER> {
    /// What one sample absorbs of the batch before, at most.
    const SHARE: usize = least_share(GAGES);

    const DIMENSIONS_AGREE: () =
        assert!(HIGHER == higher_moment_count(GAGES) && 2 <= GAGES && GAGES <= MAX_GAGES);

    /// An empty accumulator about `pivot`.
    pub const fn new(pivot: [AdcCode; GAGES]) -> Self {
        let () = Self::DIMENSIONS_AGREE;
        Self {
            codes: CodeSums::new(pivot),
            higher: [Compensated::ZERO; HIGHER],
            block: Block { batches: 0, gram: [[0; GAGES]; GAGES] },
            batches: [Batch::EMPTY; 2],
            filling: 0,
            absorption: Absorption::done(GAGES),
        }
    }

    /// Moves an accumulator that is empty to another pivot: a fraction of the work of [`Moments::restart`].
    pub const fn set_pivot(&mut self, pivot: [AdcCode; GAGES]) {
        self.codes.pivot = pivot;
    }

    /// Empties the accumulator in place and moves it to a new pivot.
    pub fn restart(&mut self, pivot: [AdcCode; GAGES]) {
        self.codes = CodeSums::new(pivot);
        self.higher = [Compensated::ZERO; HIGHER];
        self.block.batches = 0;
        self.block.gram = [[0; GAGES]; GAGES];
        self.batches = [Batch::EMPTY; 2];
        self.absorption = Absorption::done(GAGES);
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
        let batch = &mut self.batches[self.filling];
        debug_assert!(batch.samples < BATCH);
        // So that the compiler, too, knows that there is room.
        let place = batch.samples % BATCH;
        batch.put(place, codes, &self.codes.pivot);
        batch.samples += 1;
        let full = batch.samples == BATCH;
        self.codes.count += 1;
        self.absorb_share(Self::SHARE);
        if full {
            self.begin_absorption();
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
        self.absorb_share(usize::MAX);
        let batch = &mut self.batches[self.filling];
        if batch.samples > 0 {
            batch.clear_rest();
            self.begin_absorption();
            self.absorb_share(usize::MAX);
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

    /// Turns to the other batch, and to absorbing this one. The one before has been absorbed by then: there were as many samples
    /// as there are shares.
    fn begin_absorption(&mut self) {
        self.filling = 1 - self.filling;
        self.batches[self.filling].samples = 0;
        self.block.batches += 1;
        let spills = self.block.batches == BATCHES_PER_BLOCK;
        if spills {
            self.block.batches = 0;
        }
        self.absorption = Absorption { pair: (0, 0), place: 0, spills };
    }

    /// Brings what is being absorbed to its end, which changes no sum that there will be. Samples that wait for more.
    fn finish_absorption(&mut self) -> u64 {
        self.absorb_share(usize::MAX);
        self.batches[self.filling].samples as u64
    }

    /// Absorbs as many pairs of channels as do not exceed this share.
    fn absorb_share(&mut self, most: usize) {
        let batch = &self.batches[1 - self.filling];
        let Absorption { pair: (mut i, mut j), mut place, spills } = self.absorption;
        let mut taken = 0;
        while i < GAGES {
            taken += weight(GAGES, j);
            if taken > most {
                break;
            }
            let (left, right) = (&batch.difference[i], &batch.difference[j]);
            let gram = &mut self.block.gram[i][j];
            *gram += products(&left[0], &right[0]) + products(&left[1], &right[1]);
            if spills {
                self.codes.gram[i][j] += i128::from(*gram);
                *gram = 0;
            }
            if i == j {
                // Sixteen differences of 25 bits have 29.
                self.codes.sum[i] += i64::from(sum(&left[0]) + sum(&left[1]));
            }
            if let Some(sums) = self.higher.get_mut(place..) {
                add_monomials_of_pair(&batch.rounded, (i, j), sums);
            }
            place += monomials_of_pair(GAGES - j);
            j += 1;
            if j == GAGES {
                i += 1;
                j = i;
            }
        }
        self.absorption = Absorption { pair: (i, j), place, spills };
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

/// Σ of the products of two channels, counts². Lane by lane, see [`add_monomials_of_pair`].
#[inline]
fn products(left: &[i32; HALF], right: &[i32; HALF]) -> i64 {
    let ([a, b, c, d, e, f, g, h], [i, j, k, l, m, n, o, p]) = (*left, *right);
    let product = |left: i32, right: i32| i64::from(left) * i64::from(right);
    let first = product(a, i) + product(b, j) + product(c, k) + product(d, l);
    first + product(e, m) + product(f, n) + product(g, o) + product(h, p)
}

#[inline]
fn sum(of: &[i32; HALF]) -> i32 {
    let [a, b, c, d, e, f, g, h] = *of;
    (a + b) + (c + d) + (e + f) + (g + h)
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
