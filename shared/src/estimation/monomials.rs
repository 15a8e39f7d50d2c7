//! The monomials of degree 3 and 4 in p channels: which there are, in which order, and how a batch of samples adds to their
//! sums (design § 2).

use super::moments::BATCH;
use crate::units::MAX_GAGES;

/// The number of channels and of products of two of them.
const fn factor_count(gages: usize) -> usize {
    gages + gages * (gages + 1) / 2
}

/// A sum in single precision that remembers what its last addition rounded away (Kahan).
#[derive(Clone, Copy, Debug)]
pub(super) struct Compensated {
    sum: f32,
    excess: f32,
}

impl Compensated {
    pub(super) const ZERO: Self = Self { sum: 0.0, excess: 0.0 };

    #[inline]
    fn add(&mut self, term: f32) {
        let corrected = term - self.excess;
        let sum = self.sum + corrected;
        self.excess = (sum - self.sum) - corrected;
        self.sum = sum;
    }

    /// A sum of this value.
    pub(super) const fn of(sum: f32) -> Self {
        Self { sum, excess: 0.0 }
    }

    /// The sum, rounded to single precision.
    pub(super) fn rounded(self) -> f32 {
        self.sum - self.excess
    }

    /// Adds another such sum.
    pub(super) fn join(&mut self, other: Self) {
        self.add(other.sum);
        self.add(-other.excess);
    }

    pub(super) fn value(self) -> f64 {
        f64::from(self.sum) - f64::from(self.excess)
    }
}

/// Adds the batch's monomials of degree 3 and 4 to `sums`, in the order of [`for_each_higher_monomial`].
///
/// Every one is a pair of channels times a channel or another pair. These second factors stand in a list, by their first
/// channel, each channel before the pairs that it begins: all that extend one pair are then one run without a gap, to the
/// end of the list. That keeps the innermost loop, which is most of all the work, long.
pub(super) fn add_higher_monomials<const GAGES: usize>(
    lanes: &[[f32; BATCH]; GAGES],
    mut sums: &mut [Compensated],
) {
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
