//! The metric constraint at given weights: its answer, and how certain that is.
//!
//! About a fit at hand, samples have directions x = (SSᵀ)⁻¹S(z − b), and the truth says |m|² = 1 + mᵀEm + hᵀm: E and h are what is wrong
//! with the fit. With φ(m) the terms mₐm_b, mₐ and θ their coefficients, weighted least squares is
//!
//! ```text
//! Σ w(m) φ(m)φ(m)ᵀ θ = Σ w(m) φ(m) (|m|² − 1)
//! ```
//!
//! Everything in it is a polynomial of the true direction, and is estimated without bias by [`super::adjusted`]. With A the matrix to
//! the left, cov θ = A⁻¹ (Σ w² φφᵀ v) A⁻¹. Weights of one make it the estimator of the sensor (design § 3.3); those of [`super::weight`]
//! make it, to first order in the noise, maximum likelihood.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::Direction;
use super::adjusted::{AdjustedSums, Exponents, product};
use super::weight::{ConstraintNoise, Weight};

/// θ at one set of weights.
#[derive(Clone, Debug)]
pub(super) struct Answer {
    /// θ: coefficients of mₐm_b (a ≤ b) row by row, then of mₐ.
    pub(super) theta: DVector<f64>,
    /// Its covariance.
    pub(super) covariance: DMatrix<f64>,
}

impl Answer {
    /// Solves the constraint. `directions` are those of the sums, made unit vectors; `None` where they do not determine θ.
    pub(super) fn of(
        sums: &AdjustedSums,
        directions: &[Direction],
        noise: &ConstraintNoise,
        weight: &Weight,
        rank: usize,
    ) -> Option<Self> {
        let terms = terms(rank);
        let monomials = weight.monomials();
        let weighted = |exponents: Exponents| -> f64 {
            monomials.iter().map(|&(power, factor)| factor * sums.at(product(power, exponents))).sum()
        };
        let normal = DMatrix::from_fn(terms.len(), terms.len(), |row, column| {
            weighted(product(terms[row], terms[column]))
        });
        let right = DVector::from_iterator(
            terms.len(),
            terms.iter().map(|&term| {
                let squares = (0..rank).map(|a| weighted(product(term, product(axis(a), axis(a)))));
                squares.sum::<f64>() - weighted(term)
            }),
        );
        let factor = Cholesky::new(normal)?;
        let mut spread = DMatrix::zeros(terms.len(), terms.len());
        for m in directions {
            let phi = DVector::from_iterator(terms.len(), terms.iter().map(|&term| monomial_at(term, m)));
            spread.ger(weight.at(m).powi(2) * noise.at(m), &phi, &phi, 1.0);
        }
        let answer = Self { theta: factor.solve(&right), covariance: sandwich(&factor, &spread) };
        answer.theta.iter().chain(&answer.covariance).all(|number| number.is_finite()).then_some(answer)
    }

    /// θ in units of its own uncertainty, squared; `None` where the covariance is singular.
    pub(super) fn squared_deviations(&self, theta: &DVector<f64>) -> Option<f64> {
        Some(Cholesky::new(self.covariance.clone())?.solve(theta).dot(theta))
    }

    /// The predicted mean squared error of S, counts², summed over its elements, where SSᵀ = diag(`gains_squared`).
    ///
    /// The error is δS = (E/2)S in the orientation closest to the truth: element (a, b) of E/2 counts 2gₐ/(gₐ + g_b) times.
    pub(super) fn squared_error(&self, gains_squared: &DVector<f64>) -> f64 {
        let along = self.along();
        let rank = gains_squared.len();
        let mut total = 0.0;
        let pairs = (0..rank).flat_map(|a| (a..rank).map(move |b| (a, b)));
        for (position, (a, b)) in pairs.enumerate() {
            let (first, second) = (gains_squared[a], gains_squared[b]);
            let counts = if a == b {
                first
            } else {
                let turned = 2.0 / (first + second);
                (turned * first).powi(2) * second + (turned * second).powi(2) * first
            };
            total += along[(position, position)] * counts;
        }
        total
    }

    /// The covariance of E/2 and h/2, as [`crate::calibration::covariance`] has it.
    pub(super) fn along(&self) -> DMatrix<f64> {
        let halves = halves(rank_of(self.theta.len()));
        self.covariance.component_mul(&(&halves * halves.transpose()))
    }

    /// E and h.
    pub(super) fn errors(&self) -> (DMatrix<f64>, DVector<f64>) {
        let rank = rank_of(self.theta.len());
        let mut error = DMatrix::zeros(rank, rank);
        let pairs = (0..rank).flat_map(|a| (a..rank).map(move |b| (a, b)));
        for ((a, b), &coefficient) in pairs.zip(&self.theta) {
            // An element off the diagonal stands twice in mᵀEm.
            error[(a, b)] += coefficient / 2.0;
            error[(b, a)] += coefficient / 2.0;
        }
        (error, self.theta.rows_range(self.theta.len() - rank..).into_owned())
    }
}

fn sandwich(factor: &Cholesky<f64, Dyn>, spread: &DMatrix<f64>) -> DMatrix<f64> {
    let covariance = factor.solve(&factor.solve(spread).transpose());
    (&covariance + covariance.transpose()) / 2.0
}

/// What turns a coefficient of φ into an element of E/2 or h/2: E stands twice in a product of different components.
fn halves(rank: usize) -> DVector<f64> {
    let of = |term: Exponents| if term.contains(&2) || term.iter().sum::<usize>() == 1 { 0.5 } else { 0.25 };
    let terms = terms(rank);
    DVector::from_iterator(terms.len(), terms.into_iter().map(of))
}

/// Five terms at rank 2, nine at rank 3.
const fn rank_of(terms: usize) -> usize {
    if terms == 5 { 2 } else { 3 }
}

fn axis(a: usize) -> Exponents {
    std::array::from_fn(|at| usize::from(at == a))
}

/// φ: mₐm_b (a ≤ b) row by row, then mₐ.
fn terms(rank: usize) -> Vec<Exponents> {
    let products = (0..rank).flat_map(|a| (a..rank).map(move |b| product(axis(a), axis(b))));
    products.chain((0..rank).map(axis)).collect()
}

/// One monomial of one direction.
pub(super) fn monomial_at(exponents: Exponents, m: &Direction) -> f64 {
    m.iter().zip(exponents).map(|(m, power)| (0..power).map(|_| m).product::<f64>()).product()
}
