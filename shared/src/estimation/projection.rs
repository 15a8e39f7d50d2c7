//! The moments of the motion: the sums over p channels, turned into the r coordinates of the basis (design § 3.2).
//!
//! The coordinates are y = V*ᵀ(z − pivot), in counts. Sums about one pivot add, in r dimensions as in p, and are moved to
//! their mean last. A symmetric tensor of degree four in p dimensions is
//! rotated one index at a time: each pass takes one channel index out of every stored monomial and puts a coordinate
//! index in its place. At p = 8, r = 3 that is about 6000 multiply-adds in place of p⁴r⁴.

use nalgebra::{SMatrix, SVector};

use super::moments::Moments;
use super::monomials::{HigherMonomial, for_each_higher_monomial};
use super::motion_moments::{Fourth, MotionMoments, Third, rows};

/// Sums over the samples of the motion's r coordinates y, about the pivot of the codes; every index order is filled in.
#[derive(Clone, Debug)]
pub struct MotionSums<const RANK: usize> {
    samples: u64,
    /// Σ y.
    first: SVector<f64, RANK>,
    /// Σ yₐy_b.
    second: SMatrix<f64, RANK, RANK>,
    third: Third<RANK>,
    fourth: Fourth<RANK>,
}

/// Projects settled moments onto `basis` (p × r, one coordinate a column).
///
/// Never inlined: on the sensor the stack that it takes must be free again before the solution goes on.
#[inline(never)]
pub fn project<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
) -> MotionSums<RANK> {
    let codes = moments.codes();
    let products = SMatrix::<f64, GAGES, GAGES>::from_fn(|i, j| codes.product_sum(i, j));
    let (third, fourth) = rotate(moments, basis);
    MotionSums {
        samples: codes.count(),
        first: basis.transpose() * SVector::from_fn(|i, _| codes.sum[i] as f64),
        second: basis.transpose() * products * basis,
        third,
        fourth,
    }
}

impl<const RANK: usize> MotionSums<RANK> {
    /// The number of samples.
    pub const fn samples(&self) -> u64 {
        self.samples
    }

    /// Adds sums about the same pivot, in the same basis.
    pub fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.first += other.first;
        self.second += other.second;
        for a in 0..RANK {
            for b in 0..RANK {
                for c in 0..RANK {
                    self.third[a][b][c] += other.third[a][b][c];
                    for d in 0..RANK {
                        self.fourth[a][b][c][d] += other.fourth[a][b][c][d];
                    }
                }
            }
        }
    }

    /// The mean of y, from the pivot. Of no samples it is zero.
    pub fn mean(&self) -> SVector<f64, RANK> {
        self.first * self.share()
    }

    /// The central moments.
    pub fn central(&self) -> MotionMoments<RANK> {
        let share = self.share();
        let third = self.third.map(|rows| rows.map(|row| row.map(|sum| sum * share)));
        let fourth = self.fourth.map(|blocks| blocks.map(|rows| rows.map(|row| row.map(|sum| sum * share))));
        MotionMoments::about_mean(&self.mean(), &rows(&(self.second * share)), &third, &fourth)
    }

    fn share(&self) -> f64 {
        1.0 / self.samples.max(1) as f64
    }
}

/// Σ yₐy_by_c and Σ yₐy_by_cy_d about the pivot.
///
/// Channel indices are kept ascending, i ≤ j ≤ k ≤ l. A monomial contributes once for every *distinct* channel that can
/// be taken out of it, which is what the guards on repeated indices say.
fn rotate<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
) -> (Third<RANK>, Fourth<RANK>) {
    let mut third = [[[0.0; RANK]; RANK]; RANK];
    let mut fourth = [[[[0.0; RANK]; RANK]; RANK]; RANK];
    // The largest array of the whole solution: there is one of it.
    let mut triples = [[[0.0; GAGES]; GAGES]; GAGES];
    for a in 0..RANK {
        let pairs = take_from_sums(moments, basis, a, &mut triples);
        for b in a..RANK {
            let two_of_three = take_from_pairs(&pairs, basis, b);
            let two_of_four = take_from_triples(&triples, basis, b);
            for c in b..RANK {
                fill_third(&mut third, [a, b, c], along(&two_of_three, basis, c));
                let three_of_four = take_from_pairs(&two_of_four, basis, c);
                for d in c..RANK {
                    fill_fourth(&mut fourth, [a, b, c, d], along(&three_of_four, basis, d));
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
fn take_from_sums<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
    axis: usize,
    triples: &mut Triples<GAGES>,
) -> Pairs<GAGES> {
    let mut pairs = [[0.0; GAGES]; GAGES];
    triples.as_flattened_mut().as_flattened_mut().fill(0.0);
    let mut sums = moments.higher_sums().iter();
    for_each_higher_monomial(GAGES, |monomial| {
        let Some(&sum) = sums.next() else { return };
        match monomial {
            HigherMonomial::Cubic([i, j, k]) => {
                pairs[j][k] += basis[(i, axis)] * sum;
                if j != i {
                    pairs[i][k] += basis[(j, axis)] * sum;
                }
                if k != j {
                    pairs[i][j] += basis[(k, axis)] * sum;
                }
            }
            HigherMonomial::Quartic([i, j, k, l]) => {
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
fn take_from_triples<const GAGES: usize, const RANK: usize>(
    triples: &[[[f64; GAGES]; GAGES]; GAGES],
    basis: &SMatrix<f64, GAGES, RANK>,
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
fn take_from_pairs<const GAGES: usize, const RANK: usize>(
    pairs: &[[f64; GAGES]; GAGES],
    basis: &SMatrix<f64, GAGES, RANK>,
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
fn along<const GAGES: usize, const RANK: usize>(
    singles: &[f64; GAGES],
    basis: &SMatrix<f64, GAGES, RANK>,
    axis: usize,
) -> f64 {
    singles.iter().zip(basis.column(axis).iter()).map(|(value, weight)| value * weight).sum()
}

fn fill_third<const RANK: usize>(tensor: &mut Third<RANK>, [a, b, c]: [usize; 3], value: f64) {
    for [x, y, z] in [[a, b, c], [a, c, b], [b, a, c], [b, c, a], [c, a, b], [c, b, a]] {
        tensor[x][y][z] = value;
    }
}

fn fill_fourth<const RANK: usize>(tensor: &mut Fourth<RANK>, [a, b, c, d]: [usize; 4], value: f64) {
    for (first, rest) in [(a, [b, c, d]), (b, [a, c, d]), (c, [a, b, d]), (d, [a, b, c])] {
        fill_third(&mut tensor[first], rest, value);
    }
}

#[cfg(test)]
mod tests {
    use super::project;
    use crate::estimation::moments::Moments;
    use crate::units::AdcCode;
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
        let projected = project(&moments, &basis).central();

        let mean = moments.codes().mean_counts();
        let motion: [SVector<f64, 3>; 7] =
            samples.map(|sample| basis.transpose() * (SVector::from_fn(|i, _| f64::from(sample[i])) - mean));
        let expectation = |indices: &[usize]| {
            motion.iter().map(|y| indices.iter().map(|&i| y[i]).product::<f64>()).sum::<f64>() / 7.0
        };
        // The sums of degree 3 and 4 carry a relative error of 2e-7 at most.
        let close = |got: f64, expected: f64, scale: f64| (got - expected).abs() <= 1e-6 * scale;
        for a in 0..3 {
            for b in 0..3 {
                assert!(close(projected.second[a][b], expectation(&[a, b]), 1e4));
                for c in 0..3 {
                    assert!(close(projected.third[a][b][c], expectation(&[a, b, c]), 1e6));
                    for d in 0..3 {
                        assert!(close(projected.fourth[a][b][c][d], expectation(&[a, b, c, d]), 1e8));
                    }
                }
            }
        }
    }
}
