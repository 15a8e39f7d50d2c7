//! The moments of the motion: the sums over p channels, turned into the r coordinates of the basis (design § 3.2).
//!
//! The coordinates are y = V*ᵀ(z − pivot), in counts. Sums about one pivot add, in r dimensions as in p, and are moved to
//! their mean last. A symmetric tensor of degree four in p dimensions is
//! rotated one index at a time: each pass takes one channel index out of every stored monomial and puts a coordinate
//! index in its place. At p = 8, r = 3 that is about 6000 multiply-adds in place of p⁴r⁴.

use nalgebra::{SMatrix, SVector};

use super::coordinates::{Fourth, MotionVector, Third};
use super::moments::{Moments, UNIT};
use super::monomials::{HigherMonomial, for_each_higher_monomial};
use super::motion_moments::MotionMoments;
use crate::units::{MAX_RANK, Rank};

/// Powers of the unit of the sums of degree 3 and 4.
const CUBED_UNIT: f64 = (UNIT * UNIT * UNIT) as f64;
const FOURTH_POWER_OF_UNIT: f64 = CUBED_UNIT * UNIT as f64;

/// Sums over the samples of the motion's r coordinates y, about the pivot of the codes.
#[derive(Clone, Debug)]
pub struct MotionSums {
    samples: u64,
    /// Σ y.
    first: MotionVector,
    /// Σ yₐy_b, and so on.
    higher: MotionMoments,
}

/// Projects settled moments onto `basis` (p × r, one coordinate a column).
///
/// Never inlined: on the sensor the stack that it takes must be free again before the solution goes on.
#[inline(never)]
pub fn project<const GAGES: usize, const HIGHER: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    rank: Rank,
) -> MotionSums {
    let codes = moments.codes();
    let products = SMatrix::<f64, GAGES, GAGES>::from_fn(|i, j| codes.product_sum(i, j));
    let (third, fourth) = rotate(moments, basis, rank);
    MotionSums {
        samples: codes.count(),
        first: basis.transpose() * SVector::from_fn(|i, _| codes.sum[i] as f64),
        higher: MotionMoments { second: basis.transpose() * products * basis, third, fourth },
    }
}

impl MotionSums {
    /// The number of samples.
    pub const fn samples(&self) -> u64 {
        self.samples
    }

    /// Adds sums about the same pivot, in the same basis.
    pub fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.first += other.first;
        self.higher.second += other.higher.second;
        self.higher.third += &other.higher.third;
        self.higher.fourth += &other.higher.fourth;
    }

    /// The mean of y, from the pivot. Of no samples it is zero.
    pub fn mean(&self) -> MotionVector {
        self.first * self.share()
    }

    /// The central moments.
    pub fn central(&self) -> MotionMoments {
        let share = self.share();
        let MotionMoments { second, third, fourth } = &self.higher;
        let about_pivot = MotionMoments {
            second: second * share,
            third: third.scaled(share),
            fourth: fourth.scaled(share),
        };
        about_pivot.about_mean(&self.mean())
    }

    fn share(&self) -> f64 {
        1.0 / self.samples.max(1) as f64
    }
}

/// Σ yₐy_by_c and Σ yₐy_by_cy_d about the pivot.
///
/// Channel indices are kept ascending, i ≤ j ≤ k ≤ l. A monomial contributes once for every *distinct* channel that can
/// be taken out of it, which is what the guards on repeated indices say.
fn rotate<const GAGES: usize, const HIGHER: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    rank: Rank,
) -> (Third<f64>, Fourth<f64>) {
    let (mut third, mut fourth) = (Third::ZERO, Fourth::ZERO);
    // The largest array of the whole solution: there is one of it.
    let mut triples = [[[0.0; GAGES]; GAGES]; GAGES];
    let axes = rank.count();
    for a in 0..axes {
        let pairs = take_from_sums(moments, basis, a, &mut triples);
        for b in a..axes {
            let two_of_three = take_from_pairs(&pairs, basis, b);
            let two_of_four = take_from_triples(&triples, basis, b);
            for c in b..axes {
                third[[a, b, c]] = along(&two_of_three, basis, c);
                let three_of_four = take_from_pairs(&two_of_four, basis, c);
                for d in c..axes {
                    fourth[[a, b, c, d]] = along(&three_of_four, basis, d);
                }
            }
        }
    }
    (third, fourth)
}

type Pairs<const GAGES: usize> = [[f64; GAGES]; GAGES];
type Triples<const GAGES: usize> = [[[f64; GAGES]; GAGES]; GAGES];

/// Takes one channel out of every sum and rotates it onto coordinate `axis`: of cubics ascending pairs remain, of quartics
/// ascending `triples`.
fn take_from_sums<const GAGES: usize, const HIGHER: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    axis: usize,
    triples: &mut Triples<GAGES>,
) -> Pairs<GAGES> {
    let mut pairs = [[0.0; GAGES]; GAGES];
    triples.as_flattened_mut().as_flattened_mut().fill(0.0);
    let mut sums = moments.higher_sums().iter();
    for_each_higher_monomial(GAGES, |monomial| {
        let Some(sum) = sums.next().map(|sum| sum.value()) else { return };
        match monomial {
            HigherMonomial::Cubic([i, j, k]) => {
                let sum = sum * CUBED_UNIT;
                pairs[j][k] += basis[(i, axis)] * sum;
                if j != i {
                    pairs[i][k] += basis[(j, axis)] * sum;
                }
                if k != j {
                    pairs[i][j] += basis[(k, axis)] * sum;
                }
            }
            HigherMonomial::Quartic([i, j, k, l]) => {
                let sum = sum * FOURTH_POWER_OF_UNIT;
                triples[j][k][l] += basis[(i, axis)] * sum;
                if j != i {
                    triples[i][k][l] += basis[(j, axis)] * sum;
                }
                if k != j {
                    triples[i][j][l] += basis[(k, axis)] * sum;
                }
                if l != k {
                    triples[i][j][k] += basis[(l, axis)] * sum;
                }
            }
        }
    });
    pairs
}

/// Takes one channel out of ascending triples and rotates it onto coordinate `axis`: ascending pairs remain.
fn take_from_triples<const GAGES: usize>(
    triples: &[[[f64; GAGES]; GAGES]; GAGES],
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    axis: usize,
) -> [[f64; GAGES]; GAGES] {
    let mut pairs = [[0.0; GAGES]; GAGES];
    for i in 0..GAGES {
        for j in i..GAGES {
            for k in j..GAGES {
                let value = triples[i][j][k];
                pairs[j][k] += basis[(i, axis)] * value;
                if j != i {
                    pairs[i][k] += basis[(j, axis)] * value;
                }
                if k != j {
                    pairs[i][j] += basis[(k, axis)] * value;
                }
            }
        }
    }
    pairs
}

/// Takes one channel out of ascending pairs and rotates it onto coordinate `axis`: single channels remain.
fn take_from_pairs<const GAGES: usize>(
    pairs: &[[f64; GAGES]; GAGES],
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    axis: usize,
) -> [f64; GAGES] {
    let mut singles = [0.0; GAGES];
    for i in 0..GAGES {
        for j in i..GAGES {
            singles[j] += basis[(i, axis)] * pairs[i][j];
            if j != i {
                singles[i] += basis[(j, axis)] * pairs[i][j];
            }
        }
    }
    singles
}

/// Rotates the last channel index onto coordinate `axis`.
fn along<const GAGES: usize>(
    singles: &[f64; GAGES],
    basis: &SMatrix<f64, GAGES, MAX_RANK>,
    axis: usize,
) -> f64 {
    singles.iter().zip(basis.column(axis).iter()).map(|(value, weight)| value * weight).sum()
}

#[cfg(test)]
mod tests {
    use super::project;
    use crate::estimation::moments::Moments;
    use crate::units::{AdcCode, Rank};
    use nalgebra::{SMatrix, SVector};

    /// Turning the sums of all channels gives the same moments as turning every sample first.
    #[test]
    fn projection_equals_the_moments_of_projected_samples() {
        let samples: [[i32; 4]; 7] = [
            [30, -12, 71, 5],
            [2, 25, -50, -8],
            [110, 4, 12, 33],
            [-61, -28, 90, -70],
            [80, 83, -81, 12],
            [-9, 41, 7, 64],
            [17, -77, -20, -3],
        ];
        let mut moments = Moments::<4, 55>::new([AdcCode::new(19).unwrap(); 4]);
        for sample in samples {
            moments.push(&sample.map(|counts| AdcCode::new(counts).unwrap())).unwrap();
        }
        moments.settle();
        let basis = SMatrix::<f64, 4, 3>::new(
            0.5, 0.5, 0.5, //
            0.5, -0.5, 0.5, //
            0.5, 0.5, -0.5, //
            0.5, -0.5, -0.5,
        );
        let projected = project(&moments, &basis, Rank::Spatial).central();

        let mean = moments.codes().mean().counts;
        let motion: [SVector<f64, 3>; 7] =
            samples.map(|sample| basis.transpose() * (SVector::from_fn(|i, _| f64::from(sample[i])) - mean));
        let expectation = |indices: &[usize]| {
            motion.iter().map(|y| indices.iter().map(|&i| y[i]).product::<f64>()).sum::<f64>() / 7.0
        };
        // The sums of degree 3 and 4 carry a relative error of 2e-7 at most.
        let close = |got: f64, expected: f64, scale: f64| (got - expected).abs() <= 1e-6 * scale;
        for a in 0..3 {
            for b in 0..3 {
                assert!(close(projected.second[(a, b)], expectation(&[a, b]), 1e4));
                for c in 0..3 {
                    assert!(close(projected.third[[a, b, c]], expectation(&[a, b, c]), 1e6));
                    for d in 0..3 {
                        assert!(close(projected.fourth[[a, b, c, d]], expectation(&[a, b, c, d]), 1e8));
                    }
                }
            }
        }
    }
}
