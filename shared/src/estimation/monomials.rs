//! The monomials of degree 3 and 4 in p channels: which there are, in which order, and how a batch of samples adds to their
//! sums (design § 2).

/// Samples of half a batch: as many lanes as are written out.
pub(super) const HALF: usize = 8;

/// One channel of a batch in single precision, in two halves.
pub(super) type Lanes = [[f32; HALF]; 2];
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

/// The number of monomials that begin with one pair of channels, of which the second is the first of `channels`: each of
/// them, and each product of two.
pub(super) const fn monomials_of_pair(channels: usize) -> usize {
    channels + channels * (channels + 1) / 2
}

/// Adds the batch's monomials of degree 3 and 4 that begin with the channels i ≤ j to their `sums`, in the order of
/// [`for_each_higher_monomial`].
#[inline]
pub(super) fn add_monomials_of_pair<const GAGES: usize>(
    lanes: &[Lanes; GAGES],
    (i, j): (usize, usize),
    mut sums: &mut [Compensated],
) {
    let pair = product(&lanes[i], &lanes[j]);
    let mut channels = &lanes[j..];
    while let [third, later @ ..] = channels {
        let triple = product(&pair, third);
        let Some((run, rest)) = sums.split_at_mut_checked(1 + channels.len()) else { return };
        let [cubic, quartics @ ..] = run else { return };
        cubic.add(total(&triple));
        for (quartic, lane) in quartics.iter_mut().zip(channels) {
            quartic.add(total(&product(&triple, lane)));
        }
        (channels, sums) = (later, rest);
    }
}

#[inline]
fn product(left: &Lanes, right: &Lanes) -> Lanes {
    [product_of_half(&left[0], &right[0]), product_of_half(&left[1], &right[1])]
}

// Lane by lane, and not as a loop: this is most of what a sample costs, and stays so in an image that is built for its size.
#[inline]
fn product_of_half(left: &[f32; HALF], right: &[f32; HALF]) -> [f32; HALF] {
    let ([a, b, c, d, e, f, g, h], [i, j, k, l, m, n, o, p]) = (*left, *right);
    [a * i, b * j, c * k, d * l, e * m, f * n, g * o, h * p]
}

#[inline]
fn total([first, second]: &Lanes) -> f32 {
    total_of_half(first) + total_of_half(second)
}

#[inline]
fn total_of_half(lanes: &[f32; HALF]) -> f32 {
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
