//! Moments of the motion in r coordinates, and what may be done to them: a change of coordinates, of the point that they are
//! about, and the removal of noise (design § 3.2, 3.3).

use nalgebra::{SMatrix, SVector};

pub(super) type Third<const RANK: usize> = [[[f64; RANK]; RANK]; RANK];
pub(super) type Fourth<const RANK: usize> = [[[[f64; RANK]; RANK]; RANK]; RANK];

/// Central moments ⟨y⟩, … up to degree four of the motion's r coordinates; every index order is filled in.
#[derive(Clone, Debug)]
pub struct MotionMoments<const RANK: usize> {
    /// ⟨yₐy_b⟩, the unit of y squared.
    pub second: [[f64; RANK]; RANK],
    /// ⟨yₐy_by_c⟩.
    pub third: Third<RANK>,
    /// ⟨yₐy_by_cy_d⟩.
    pub fourth: Fourth<RANK>,
}

impl<const RANK: usize> MotionMoments<RANK> {
    /// Central moments, from moments about another point and the mean as seen from there.
    pub(super) fn about_mean(
        mean: &SVector<f64, RANK>,
        second: &[[f64; RANK]; RANK],
        third: &Third<RANK>,
        fourth: &Fourth<RANK>,
    ) -> Self {
        let m = mean;
        let mut central = Self {
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

    /// The moments of B y, from those of y.
    #[must_use]
    #[inline(never)]
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

    /// The moments of y less its noise, where the coordinates carry Gaussian noise of this covariance ν (r × r)
    /// (Kukush, Markovsky, Van Huffel, *Consistent estimation in an implicit quadratic measurement error model*):
    ///
    /// ```text
    /// ⟨yₐy_b⟩       less ν_ab
    /// ⟨yₐy_by_c⟩    as it is, about the mean
    /// ⟨yₐy_by_cy_d⟩ less Σ₆ ν_ab ⟨y_cy_d⟩, plus Σ₃ ν_ab ν_cd
    /// ```
    ///
    /// (sums over the ways to pair the indices).
    #[must_use]
    #[inline(never)]
    pub fn without_noise(&self, noise: &SMatrix<f64, RANK, RANK>) -> Self {
        let nu = |a: usize, b: usize| noise[(a, b)];
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

pub(super) fn rows<const RANK: usize>(matrix: &SMatrix<f64, RANK, RANK>) -> [[f64; RANK]; RANK] {
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
