//! The moments of the motion: the sums over p channels, turned into the r coordinates of the basis (design § 3.2).
//!
//! The coordinates are y = V*ᵀ(z − z̄), in counts, about the mean. A symmetric tensor of degree four in p dimensions is
//! rotated one index at a time: each pass takes one channel index out of every stored monomial and puts a coordinate
//! index in its place. At p = 8, r = 3 that is about 6000 multiply-adds in place of p⁴r⁴.

use nalgebra::{SMatrix, SVector};

use super::moments::{HigherMonomial, Moments, for_each_higher_monomial};

/// Central moments ⟨y⟩, … up to degree four of the motion's r coordinates; every index order is filled in.
#[derive(Clone, Debug)]
pub struct MotionMoments<const RANK: usize> {
    /// ⟨yₐy_b⟩, the unit of y squared.
    pub second: [[f64; RANK]; RANK],
    /// ⟨yₐy_by_c⟩.
    pub third: [[[f64; RANK]; RANK]; RANK],
    /// ⟨yₐy_by_cy_d⟩.
    pub fourth: [[[[f64; RANK]; RANK]; RANK]; RANK],
}

/// Projects settled moments onto `basis` (p × r, orthonormal columns).
pub fn project<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
) -> MotionMoments<RANK> {
    let mean: SVector<f64, RANK> = basis.transpose() * moments.mean_difference();
    let (third, fourth) = rotate(moments, basis);
    let second = rotate_second(moments, basis);
    about_mean(&mean, &second, &third, &fourth)
}

impl<const RANK: usize> MotionMoments<RANK> {
    /// The moments of B y, from those of y.
    #[must_use]
    pub fn transformed(&self, matrix: &SMatrix<f64, RANK, RANK>) -> Self {
        let second = SMatrix::<f64, RANK, RANK>::from_fn(|a, b| self.second[a][b]);
        let second = matrix * second * matrix.transpose();
        let mut transformed = Self { second: rows(&second), third: self.third, fourth: self.fourth };
        // One index at a time; every pass turns the first index and moves it to the back.
        for _ in 0..3 {
            transformed.third = turn_third(&transformed.third, matrix);
        }
        for _ in 0..4 {
            transformed.fourth = turn_fourth(&transformed.fourth, matrix);
        }
        transformed
    }

    /// The moments of y less its noise, where every coordinate carries independent Gaussian noise of this variance
    /// (Kukush, Markovsky, Van Huffel, *Consistent estimation in an implicit quadratic measurement error model*):
    ///
    /// ```text
    /// ⟨yₐy_b⟩       less δ_ab νₐ
    /// ⟨yₐy_by_c⟩    as it is, about the mean
    /// ⟨yₐy_by_cy_d⟩ less Σ₆ δ_ab νₐ ⟨y_cy_d⟩, plus Σ₃ δ_ab νₐ δ_cd ν_c
    /// ```
    ///
    /// (sums over the ways to pair the indices).
    #[must_use]
    pub fn without_noise(&self, variance: &SVector<f64, RANK>) -> Self {
        let nu = |a: usize, b: usize| if a == b { variance[a] } else { 0.0 };
        let second = &self.second;
        let mut free = self.clone();
        for a in 0..RANK {
            for b in 0..RANK {
                free.second[a][b] -= nu(a, b);
                for c in 0..RANK {
                    for d in 0..RANK {
                        let pairs = nu(a, b) * second[c][d]
                            + nu(a, c) * second[b][d]
                            + nu(a, d) * second[b][c]
                            + nu(c, d) * second[a][b]
                            + nu(b, d) * second[a][c]
                            + nu(b, c) * second[a][d];
                        let pairings = nu(a, b) * nu(c, d) + nu(a, c) * nu(b, d) + nu(a, d) * nu(b, c);
                        free.fourth[a][b][c][d] += pairings - pairs;
                    }
                }
            }
        }
        free
    }
}

impl<const RANK: usize> MotionMoments<RANK> {
    /// Moments about zero of coordinates with this mean, from their central moments.
    #[must_use]
    pub fn about_zero(&self, mean: &SVector<f64, RANK>) -> Self {
        let m = mean;
        let mut raw = self.clone();
        for a in 0..RANK {
            for b in 0..RANK {
                raw.second[a][b] += m[a] * m[b];
                for c in 0..RANK {
                    raw.third[a][b][c] += m[a] * self.second[b][c]
                        + m[b] * self.second[a][c]
                        + m[c] * self.second[a][b]
                        + m[a] * m[b] * m[c];
                    for d in 0..RANK {
                        raw.fourth[a][b][c][d] += m[a] * self.third[b][c][d]
                            + m[b] * self.third[a][c][d]
                            + m[c] * self.third[a][b][d]
                            + m[d] * self.third[a][b][c]
                            + pair_products(m, &self.second, [a, b, c, d])
                            + m[a] * m[b] * m[c] * m[d];
                    }
                }
            }
        }
        raw
    }
}

/// Σ₆ mₐm_b E_cd, over the ways to choose two of four indices.
fn pair_products<const RANK: usize>(
    m: &SVector<f64, RANK>,
    second: &[[f64; RANK]; RANK],
    [a, b, c, d]: [usize; 4],
) -> f64 {
    m[a] * m[b] * second[c][d]
        + m[a] * m[c] * second[b][d]
        + m[a] * m[d] * second[b][c]
        + m[b] * m[c] * second[a][d]
        + m[b] * m[d] * second[a][c]
        + m[c] * m[d] * second[a][b]
}

fn rows<const RANK: usize>(matrix: &SMatrix<f64, RANK, RANK>) -> [[f64; RANK]; RANK] {
    core::array::from_fn(|a| core::array::from_fn(|b| matrix[(a, b)]))
}

fn turn_third<const RANK: usize>(tensor: &Third<RANK>, matrix: &SMatrix<f64, RANK, RANK>) -> Third<RANK> {
    let mut turned = [[[0.0; RANK]; RANK]; RANK];
    for a in 0..RANK {
        for b in 0..RANK {
            for c in 0..RANK {
                turned[b][c][a] = (0..RANK).map(|i| matrix[(a, i)] * tensor[i][b][c]).sum();
            }
        }
    }
    turned
}

fn turn_fourth<const RANK: usize>(tensor: &Fourth<RANK>, matrix: &SMatrix<f64, RANK, RANK>) -> Fourth<RANK> {
    let mut turned = [[[[0.0; RANK]; RANK]; RANK]; RANK];
    for a in 0..RANK {
        for b in 0..RANK {
            for c in 0..RANK {
                for d in 0..RANK {
                    turned[b][c][d][a] = (0..RANK).map(|i| matrix[(a, i)] * tensor[i][b][c][d]).sum();
                }
            }
        }
    }
    turned
}

type Third<const RANK: usize> = [[[f64; RANK]; RANK]; RANK];
type Fourth<const RANK: usize> = [[[[f64; RANK]; RANK]; RANK]; RANK];

/// ⟨yₐy_b⟩ about the pivot.
fn rotate_second<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
) -> [[f64; RANK]; RANK] {
    let gram = SMatrix::<f64, GAGES, GAGES>::from_fn(|i, j| moments.second_moment(i, j));
    rows(&(basis.transpose() * gram * basis))
}

/// ⟨yₐy_by_c⟩ and ⟨yₐy_by_cy_d⟩ about the pivot.
///
/// Channel indices are kept ascending, i ≤ j ≤ k ≤ l. A monomial contributes once for every *distinct* channel that can
/// be taken out of it, which is what the guards on repeated indices say.
fn rotate<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    moments: &Moments<GAGES, HIGHER>,
    basis: &SMatrix<f64, GAGES, RANK>,
) -> (Third<RANK>, Fourth<RANK>) {
    let samples = moments.samples();
    // First index: quartics become one coordinate and three channels, cubics one coordinate and two channels.
    let mut one_of_four = [[[[0.0; GAGES]; GAGES]; GAGES]; RANK];
    let mut one_of_three = [[[0.0; GAGES]; GAGES]; RANK];
    let mut sums = moments.higher_sums().iter();
    for_each_higher_monomial(GAGES, |monomial| {
        let Some(mean) = sums.next().map(|sum| sum / samples) else { return };
        for a in 0..RANK {
            match monomial {
                HigherMonomial::Cubic([i, j, k]) => {
                    let into = &mut one_of_three[a];
                    into[j][k] += basis[(i, a)] * mean;
                    if j != i {
                        into[i][k] += basis[(j, a)] * mean;
                    }
                    if k != j {
                        into[i][j] += basis[(k, a)] * mean;
                    }
                }
                HigherMonomial::Quartic([i, j, k, l]) => {
                    let into = &mut one_of_four[a];
                    into[j][k][l] += basis[(i, a)] * mean;
                    if j != i {
                        into[i][k][l] += basis[(j, a)] * mean;
                    }
                    if k != j {
                        into[i][j][l] += basis[(k, a)] * mean;
                    }
                    if l != k {
                        into[i][j][k] += basis[(l, a)] * mean;
                    }
                }
            }
        }
    });

    let mut third = [[[0.0; RANK]; RANK]; RANK];
    let mut fourth = [[[[0.0; RANK]; RANK]; RANK]; RANK];
    for a in 0..RANK {
        for b in a..RANK {
            let two_of_three = take_from_pairs(&one_of_three[a], basis, b);
            let two_of_four = take_from_triples(&one_of_four[a], basis, b);
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

/// Moves raw moments (about the pivot) to the mean.
fn about_mean<const RANK: usize>(
    mean: &SVector<f64, RANK>,
    second: &[[f64; RANK]; RANK],
    third: &Third<RANK>,
    fourth: &Fourth<RANK>,
) -> MotionMoments<RANK> {
    let m = mean;
    let mut central = MotionMoments {
        second: [[0.0; RANK]; RANK],
        third: [[[0.0; RANK]; RANK]; RANK],
        fourth: [[[[0.0; RANK]; RANK]; RANK]; RANK],
    };
    for a in 0..RANK {
        for b in 0..RANK {
            central.second[a][b] = second[a][b] - m[a] * m[b];
            for c in 0..RANK {
                central.third[a][b][c] = third[a][b][c]
                    - (m[a] * second[b][c] + m[b] * second[a][c] + m[c] * second[a][b])
                    + 2.0 * m[a] * m[b] * m[c];
                for d in 0..RANK {
                    let one_mean = m[a] * third[b][c][d]
                        + m[b] * third[a][c][d]
                        + m[c] * third[a][b][d]
                        + m[d] * third[a][b][c];
                    central.fourth[a][b][c][d] = fourth[a][b][c][d] - one_mean
                        + pair_products(m, second, [a, b, c, d])
                        - 3.0 * m[a] * m[b] * m[c] * m[d];
                }
            }
        }
    }
    central
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
        let projected = project(&moments, &basis);

        let mean = moments.mean_counts();
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
