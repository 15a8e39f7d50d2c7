//! How well one trial knows its shape and bias, from the same moments (design § 4).
//!
//! Let SSᵀ = diag(g), which the trial's canonical orientation makes it, and R the covariance of the channels' noise over the mean
//! σ² of its diagonal. Errors of S and b come from two places:
//!
//! 1. **Along the shape.** The metric constraint says |m|² = 1 + mᵀEm + hᵀm + noise of variance
//!    v(m) = 4 mᵀDm + 2 tr D² + u, where D = σ²(SR⁻¹Sᵀ)⁻¹ is the noise of m (σ² diag(1/g) where R = I) and u whatever else
//!    disturbs the magnitude. With φ(m) the products mₐm_b and the mₐ, Ψ = ⟨φφᵀ⟩:
//!    cov(E, h) = Ψ⁻¹ ⟨φφᵀ v⟩ Ψ⁻¹ / n. Then δS = (E/2) S and δb = Sᵀh/2. The orientation is arbitrary, so the answer is given
//!    for the orientation closest to the truth, where δS Sᵀ is symmetric: element (a, b) of E/2 counts 2gₐ/(gₐ + g_b)
//!    times.
//! 2. **Across it**, in the p − r redundant directions of the codes, S and b are a linear regression on (m, 1):
//!    covariance σ² (n ⟨(m, 1)(m, 1)ᵀ⟩)⁻¹ ⊗ P, where P = R − Sᵀ(SR⁻¹Sᵀ)⁻¹S is what the noise has there (the projection onto
//!    them where R = I).

use nalgebra::{SMatrix, SVector};

use super::coordinates::{MotionMatrix, MotionVector, identity};
use super::directions::{DirectionMoments, for_each_direction};
use super::eigen::symmetric_eigen;
use super::quadric::{
    Coefficients, UNKNOWNS, linear_position, monomials, normal_matrix, positions, product_position,
};
use super::square::invert;
use crate::refusal::Refusal;
use crate::units::{MAX_RANK, Rank};

/// Components of (m, 1).
const REGRESSORS: usize = MAX_RANK + 1;

/// Covariances of one trial.
#[derive(Clone, Debug)]
pub struct TrialUncertainty {
    rank: Rank,
    /// Of the elements of E/2 (a ≤ b), then of h/2: relative to the shape, and to the load.
    along: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Of the regression on (m, 1), counts², in every redundant direction of the codes: the factor before P.
    across: SMatrix<f64, REGRESSORS, REGRESSORS>,
}

/// Where the load has been in all samples, whose magnitude may have been disturbed: what the regression across the shape
/// stands on.
#[derive(Clone, Debug)]
pub struct Regressors {
    /// ⟨m⟩.
    pub mean: MotionVector,
    /// ⟨mmᵀ⟩.
    pub second: MotionMatrix,
    /// Number of samples.
    pub samples: u64,
}

/// Predicts the uncertainty of a trial whose metric was taken from `samples` samples.
///
/// `directions` are the moments of m in the orientation in which SSᵀ is diagonal; `load_noise` is D, `noise_variance` σ²,
/// counts² (what rounding alone gives where it is not known: the rest is then part of `unexplained`), and `unexplained` the
/// variance of |m|² that is not noise.
///
/// # Errors
///
/// [`Refusal::MotionDoesNotSpan`] where the directions do not determine the answer.
#[inline(never)]
pub fn predict(
    directions: &DirectionMoments,
    regressors: &Regressors,
    load_noise: &MotionMatrix,
    noise_variance: f64,
    unexplained: f64,
    samples: u64,
) -> Result<TrialUncertainty, Refusal> {
    let rank = directions.rank;
    let undetermined = Refusal::MotionDoesNotSpan { relative_uncertainty: f32::INFINITY, need: 1.0 };
    let eigenvalues = symmetric_eigen(load_noise, rank.count())?.values;
    let (most_noise, least_noise) = (eigenvalues[0], eigenvalues[rank.count() - 1]);
    let constant = 4.0 * least_noise + 2.0 * load_noise.norm_squared() + unexplained;

    // Ψ, and ⟨φφᵀ v⟩ with the constant part of v exactly and the rest over the directions.
    let mut inverse = normal_matrix(&directions.higher, rank);
    invert(&mut inverse).map_err(|_| undetermined)?;
    let mut along = SMatrix::zeros();
    spread_over_directions(directions, &((load_noise - identity(rank) * least_noise) * 4.0), &mut along);
    between(&inverse, &mut along);
    for (spread, inverse) in along.iter_mut().zip(&inverse) {
        *spread += constant * inverse;
    }
    // Where the load has been in a small part of all directions, degree four is too coarse for the density, and the constraint
    // all but blind where it then puts some of it. v is nowhere more than with the noise of the noisiest direction.
    let most = constant + 4.0 * (most_noise - least_noise);
    let bounded = (0..UNKNOWNS).map(|k| along[(k, k)] / inverse[(k, k)]).fold(0.0, f64::max) <= most;
    let share = 1.0 / samples.max(1) as f64;
    let halves = halves(rank);
    for row in 0..UNKNOWNS {
        for column in 0..UNKNOWNS {
            let place = (row, column);
            let whole = if bounded { along[place] } else { inverse[place] * most };
            along[place] = whole * share * halves[row] * halves[column];
        }
    }

    let mut regression = SMatrix::<f64, REGRESSORS, REGRESSORS>::identity();
    for a in rank.axes() {
        for b in rank.axes() {
            regression[(a, b)] = regressors.second[(a, b)];
        }
        regression[(a, REGRESSORS - 1)] = regressors.mean[a];
        regression[(REGRESSORS - 1, a)] = regressors.mean[a];
    }
    invert(&mut regression).map_err(|_| undetermined)?;
    let mut across = regression * (noise_variance / regressors.samples.max(1) as f64);
    for beyond in rank.count()..MAX_RANK {
        across[(beyond, beyond)] = 0.0;
    }
    if along.iter().chain(across.iter()).all(|element| element.is_finite()) {
        Ok(TrialUncertainty { rank, along, across })
    } else {
        Err(Refusal::NonFinite)
    }
}

/// Replaces B by ABA.
#[inline(never)]
fn between(outer: &SMatrix<f64, UNKNOWNS, UNKNOWNS>, inner: &mut SMatrix<f64, UNKNOWNS, UNKNOWNS>) {
    let half = outer * *inner;
    half.mul_to(outer, inner);
}

/// ⟨φφᵀ mᵀDm⟩ over the directions m of the load. In single precision: it is a sum over many directions, of a density that is no
/// better.
#[inline(never)]
fn spread_over_directions(
    directions: &DirectionMoments,
    noise: &MotionMatrix,
    sum: &mut SMatrix<f64, UNKNOWNS, UNKNOWNS>,
) {
    let density = directions.density();
    // Brought to order one, far from what single precision underflows at.
    let scale = noise.amax().max(f64::MIN_POSITIVE);
    #[expect(clippy::cast_possible_truncation, reason = "of order one")]
    let noise = noise.map(|element| (element / scale) as f32);
    let mut spread = SMatrix::<f32, UNKNOWNS, UNKNOWNS>::zeros();
    for_each_direction(directions.rank, |m, weight| {
        #[expect(clippy::cast_possible_truncation, reason = "of order one")]
        let (m, weight) = (m.map(|component| component as f32), weight as f32);
        let phi = monomials(&m);
        let scaled = phi * (m.dot(&(noise * m)) * weight * density.at(&m));
        for row in 0..UNKNOWNS {
            for column in row..UNKNOWNS {
                spread[(row, column)] += scaled[row] * phi[column];
            }
        }
    });
    spread.fill_lower_triangle_with_upper_triangle();
    for (sum, element) in sum.iter_mut().zip(&spread) {
        *sum = f64::from(*element) * scale;
    }
}

impl TrialUncertainty {
    /// Adds an error along the shape that is not of chance: the constraint may be (m − δ)ᵀ(I + E)(m − δ) = 1 for all that is
    /// known, with E the `metric` and δ the `centre`. To first order, mᵀEm − 2δᵀm is added to |m|².
    pub fn add_shift(&mut self, metric: &MotionMatrix, centre: &MotionVector) {
        let mut shift = Coefficients::zeros();
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                shift[product_position(a, b)] = metric[(a, b)] / 2.0;
            }
            shift[linear_position(a)] = -centre[a];
        }
        self.along += shift * shift.transpose();
    }

    /// The rows and columns of [`along`](Self::along) that belong to the trial's rank; the others are zero.
    pub fn unknowns(&self) -> impl Iterator<Item = usize> {
        positions(self.rank)
    }

    /// The rows and columns of [`across`](Self::across) that belong to the trial's rank; the others are zero.
    pub fn regressors(&self) -> impl Iterator<Item = usize> {
        self.rank.axes().chain([REGRESSORS - 1])
    }

    /// Covariance along the shape: the elements (a ≤ b) of E/2 row by row, then h/2. Relative to the shape, and to the load.
    pub const fn along(&self) -> &SMatrix<f64, UNKNOWNS, UNKNOWNS> {
        &self.along
    }

    /// Covariance across the shape: of the regression on m and, last, on 1, counts², in every redundant direction of
    /// the codes: to be multiplied by P.
    pub const fn across(&self) -> &SMatrix<f64, REGRESSORS, REGRESSORS> {
        &self.across
    }

    /// Standard deviations of the elements of `turn · shape`, where `turn` (r × r, orthogonal) brings the shape into an
    /// orientation given from outside: element (a, gage) of turn·δS gathers the errors of every row of δS. The shape is r × p,
    /// counts per unit load, its rows orthogonal, and `redundant_noise` (p × p) is P.
    pub fn turned_shape_deviation<const GAGES: usize>(
        &self,
        shape: &SMatrix<f64, MAX_RANK, GAGES>,
        redundant_noise: &SMatrix<f64, GAGES, GAGES>,
        turn: &MotionMatrix,
    ) -> SMatrix<f64, MAX_RANK, GAGES> {
        let gains = MotionVector::from_fn(|a, _| shape.row(a).norm_squared());
        SMatrix::from_fn(|row, gage| {
            let mut gradient = Coefficients::zeros();
            let mut across = 0.0;
            for a in self.rank.axes() {
                for b in self.rank.axes() {
                    let turned = 2.0 * gains[a] / (gains[a] + gains[b]);
                    gradient[product_position(a, b)] += turn[(row, a)] * turned * shape[(b, gage)];
                    across += turn[(row, a)] * self.across[(a, b)] * turn[(row, b)];
                }
            }
            let along = gradient.dot(&(self.along * gradient));
            libm::sqrt((along + across * redundant_noise[(gage, gage)]).max(0.0))
        })
    }

    /// Standard deviations of the bias (p), counts. For the arguments see [`Self::turned_shape_deviation`].
    pub fn bias_deviation<const GAGES: usize>(
        &self,
        shape: &SMatrix<f64, MAX_RANK, GAGES>,
        redundant_noise: &SMatrix<f64, GAGES, GAGES>,
    ) -> SVector<f64, GAGES> {
        let last = REGRESSORS - 1;
        SVector::from_fn(|gage, _| {
            let mut gradient = Coefficients::zeros();
            for a in 0..MAX_RANK {
                gradient[linear_position(a)] = shape[(a, gage)];
            }
            let along = gradient.dot(&(self.along * gradient));
            libm::sqrt((along + self.across[(last, last)] * redundant_noise[(gage, gage)]).max(0.0))
        })
    }

    /// The largest standard deviation of any gain, cross-talk or offset, relative to the load.
    pub fn worst_relative(&self) -> f64 {
        libm::sqrt(self.along.diagonal().iter().copied().fold(0.0, f64::max))
    }
}

/// What turns the coefficients of φ into elements of E/2 and h/2: E stands twice in a product of different components.
fn halves(rank: Rank) -> Coefficients {
    let mut halves = Coefficients::zeros();
    for a in rank.axes() {
        for b in a..rank.count() {
            halves[product_position(a, b)] = if a == b { 0.5 } else { 0.25 };
        }
        halves[linear_position(a)] = 0.5;
    }
    halves
}
