//! Moments of the motion in r coordinates, and what may be done to them: a change of coordinates, of the point that they are
//! about, and the removal of noise (design § 3.2, 3.3).

use super::coordinates::{Fourth, MotionMatrix, MotionVector, Third, carried};
use crate::units::MAX_RANK;

/// Moments ⟨y⟩, … up to degree four of the motion's r coordinates, about some point.
#[derive(Clone, Debug)]
pub struct MotionMoments {
    /// ⟨yₐy_b⟩, the unit of y squared.
    pub second: MotionMatrix,
    /// ⟨yₐy_by_c⟩.
    pub third: Third<f64>,
    /// ⟨yₐy_by_cy_d⟩.
    pub fourth: Fourth<f64>,
}

impl MotionMoments {
    /// Central moments, from moments about another point and the mean as seen from there.
    #[must_use]
    pub(super) fn about_mean(&self, mean: &MotionVector) -> Self {
        self.displaced(&-mean, -1.0)
    }

    /// Moments about zero of coordinates with this mean, from their central moments.
    #[must_use]
    pub fn about_zero(&self, mean: &MotionVector) -> Self {
        self.displaced(mean, 0.0)
    }

    /// The moments of y + d, from those of y, whose mean is so many times d.
    #[inline(never)]
    fn displaced(&self, d: &MotionVector, mean: f64) -> Self {
        let Self { second, third, .. } = self;
        let mut displaced = self.clone();
        // A product of n times d comes from none of the factors being y, and from each of them being its mean.
        displaced.second += d * d.transpose() * (1.0 + 2.0 * mean);
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                for c in b..MAX_RANK {
                    displaced.third[[a, b, c]] += d[a] * second[(b, c)]
                        + d[b] * second[(a, c)]
                        + d[c] * second[(a, b)]
                        + d[a] * d[b] * d[c] * (1.0 + 3.0 * mean);
                    for e in c..MAX_RANK {
                        displaced.fourth[[a, b, c, e]] += d[a] * third[[b, c, e]]
                            + d[b] * third[[a, c, e]]
                            + d[c] * third[[a, b, e]]
                            + d[e] * third[[a, b, c]]
                            + d[a] * d[b] * second[(c, e)]
                            + d[a] * d[c] * second[(b, e)]
                            + d[a] * d[e] * second[(b, c)]
                            + d[b] * d[c] * second[(a, e)]
                            + d[b] * d[e] * second[(a, c)]
                            + d[c] * d[e] * second[(a, b)]
                            + d[a] * d[b] * d[c] * d[e] * (1.0 + 4.0 * mean);
                    }
                }
            }
        }
        displaced
    }

    /// The moments of B y, from those of y.
    #[must_use]
    #[inline(never)]
    pub fn transformed(&self, matrix: &MotionMatrix) -> Self {
        let row = |a: usize| MotionVector::from(matrix.row(a).transpose());
        let mut transformed =
            Self { second: carried(matrix, &self.second), third: Third::ZERO, fourth: Fourth::ZERO };
        // One index at a time; what is left of them stays symmetric.
        for a in 0..MAX_RANK {
            let two_of_third = self.third.along(&row(a));
            let three_of_fourth = self.fourth.along(&row(a));
            for b in a..MAX_RANK {
                let one_of_third = two_of_third.along(&row(b));
                let two_of_fourth = three_of_fourth.along(&row(b));
                for c in b..MAX_RANK {
                    transformed.third[[a, b, c]] = one_of_third.dot(&row(c));
                    let one_of_fourth = two_of_fourth.along(&row(c));
                    for d in c..MAX_RANK {
                        transformed.fourth[[a, b, c, d]] = one_of_fourth.dot(&row(d));
                    }
                }
            }
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
    pub fn without_noise(&self, noise: &MotionMatrix) -> Self {
        let nu = |a: usize, b: usize| noise[(a, b)];
        let second = &self.second;
        let mut free = self.clone();
        free.second -= noise;
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                for c in b..MAX_RANK {
                    for d in c..MAX_RANK {
                        let pairs = nu(a, b) * second[(c, d)]
                            + nu(a, c) * second[(b, d)]
                            + nu(a, d) * second[(b, c)]
                            + nu(c, d) * second[(a, b)]
                            + nu(b, d) * second[(a, c)]
                            + nu(b, c) * second[(a, d)];
                        let pairings = nu(a, b) * nu(c, d) + nu(a, c) * nu(b, d) + nu(a, d) * nu(b, c);
                        free.fourth[[a, b, c, d]] += pairings - pairs;
                    }
                }
            }
        }
        free
    }
}
