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

use nalgebra::{Cholesky, SMatrix, SVector};

use super::directions::{DirectionMoments, for_each_direction};
use super::eigen::symmetric_eigen;
use super::quadric::{Coefficients, UNKNOWNS, linear_position, monomials, normal_matrix, product_position};
use crate::refusal::Refusal;

/// Components of (m, 1) at rank 3.
const REGRESSORS: usize = 4;

/// Covariances of one trial.
#[derive(Clone, Debug)]
pub struct TrialUncertainty<const RANK: usize> {
    /// Of the elements of E/2 (a ≤ b), then of h/2: relative to the shape, and to the load.
    along: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Of the regression on (m, 1), counts², in every redundant direction of the codes: the factor before P.
    across: SMatrix<f64, REGRESSORS, REGRESSORS>,
}

/// Where the load has been in all samples, whose magnitude may have been disturbed: what the regression across the shape
/// stands on.
#[derive(Clone, Debug)]
pub struct Regressors<const RANK: usize> {
    /// ⟨m⟩.
    pub mean: SVector<f64, RANK>,
    /// ⟨mmᵀ⟩.
    pub second: SMatrix<f64, RANK, RANK>,
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
pub fn predict<const RANK: usize>(
    directions: &DirectionMoments<RANK>,
    regressors: &Regressors<RANK>,
    load_noise: &SMatrix<f64, RANK, RANK>,
    noise_variance: f64,
    unexplained: f64,
    samples: u64,
) -> Result<TrialUncertainty<RANK>, Refusal> {
    let undetermined = Refusal::MotionDoesNotSpan { relative_uncertainty: f32::INFINITY, need: 1.0 };
    let eigenvalues = symmetric_eigen(load_noise, RANK)?.values;
    let least_noise = eigenvalues.min();
    let constant = 4.0 * least_noise + 2.0 * load_noise.norm_squared() + unexplained;

    // Ψ, and ⟨φφᵀ v⟩ with the constant part of v exactly and the rest over the directions.
    let normal = normal_matrix(&directions.higher);
    let excess = *load_noise - SMatrix::identity() * least_noise;
    let inverse = Cholesky::new(normal).ok_or(undetermined)?.inverse();
    let mut along = spread_over_directions(directions, &(excess * 4.0));
    along += normal * constant;
    along = inverse * along * inverse;
    // Where the load has been in a small part of all directions, degree four is too coarse for the density, and the constraint
    // all but blind where it then puts some of it. v is nowhere more than with the noise of the noisiest direction.
    let most = constant + 4.0 * (eigenvalues.max() - least_noise);
    let bounded = (0..UNKNOWNS).map(|k| along[(k, k)] / inverse[(k, k)]).fold(0.0, f64::max) <= most;
    if !bounded {
        along = inverse * most;
    }
    for row in 0..UNKNOWNS {
        for column in 0..UNKNOWNS {
            along[(row, column)] *= half::<RANK>(row) * half::<RANK>(column) / samples.max(1) as f64;
        }
    }

    let mut regression = SMatrix::<f64, REGRESSORS, REGRESSORS>::identity();
    for a in 0..RANK {
        for b in 0..RANK {
            regression[(a, b)] = regressors.second[(a, b)];
        }
        regression[(a, REGRESSORS - 1)] = regressors.mean[a];
        regression[(REGRESSORS - 1, a)] = regressors.mean[a];
    }
    let across = Cholesky::new(regression).ok_or(undetermined)?.inverse()
        * (noise_variance / regressors.samples.max(1) as f64);
    if along.iter().chain(across.iter()).all(|element| element.is_finite()) {
        Ok(TrialUncertainty { along, across })
    } else {
        Err(Refusal::NonFinite)
    }
}

/// ⟨φφᵀ mᵀDm⟩ over the directions m of the load. In single precision: it is a sum over many directions, of a density that is no
/// better.
#[inline(never)]
fn spread_over_directions<const RANK: usize>(
    directions: &DirectionMoments<RANK>,
    noise: &SMatrix<f64, RANK, RANK>,
) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
    let density = directions.density();
    // Brought to order one, far from what single precision underflows at.
    let scale = noise.amax().max(f64::MIN_POSITIVE);
    #[expect(clippy::cast_possible_truncation, reason = "of order one")]
    let noise = noise.map(|element| (element / scale) as f32);
    let mut spread = SMatrix::<f32, UNKNOWNS, UNKNOWNS>::zeros();
    for_each_direction(|m: SVector<f64, RANK>, weight| {
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
    spread.map(|element| f64::from(element) * scale)
}

impl<const RANK: usize> TrialUncertainty<RANK> {
    /// Adds an error along the shape that is not of chance: the constraint may be (m − δ)ᵀ(I + E)(m − δ) = 1 for all that is
    /// known, with E the `metric` and δ the `centre`. To first order, mᵀEm − 2δᵀm is added to |m|².
    pub fn add_shift(&mut self, metric: &SMatrix<f64, RANK, RANK>, centre: &SVector<f64, RANK>) {
        let mut shift = Coefficients::zeros();
        for a in 0..RANK {
            for b in a..RANK {
                shift[product_position::<RANK>(a, b)] = metric[(a, b)] / 2.0;
            }
            shift[linear_position::<RANK>(a)] = -centre[a];
        }
        self.along += shift * shift.transpose();
    }

    /// Covariance along the shape: the elements (a ≤ b) of E/2 row by row, then h/2; only the first
    /// RANK·(RANK + 1)/2 + RANK rows and columns mean anything. Relative to the shape, and to the load.
    pub const fn along(&self) -> &SMatrix<f64, UNKNOWNS, UNKNOWNS> {
        &self.along
    }

    /// Covariance across the shape: of the regression on m and, last, on 1, counts², in every redundant direction of
    /// the codes: to be multiplied by P. At rank 2 the third row and column mean nothing.
    pub const fn across(&self) -> &SMatrix<f64, REGRESSORS, REGRESSORS> {
        &self.across
    }

    /// Standard deviations of the elements of `turn · shape`, where `turn` (r × r, orthogonal) brings the shape into an
    /// orientation given from outside: element (a, gage) of turn·δS gathers the errors of every row of δS. The shape is r × p,
    /// counts per unit load, its rows orthogonal, and `redundant_noise` (p × p) is P.
    pub fn turned_shape_deviation<const GAGES: usize>(
        &self,
        shape: &SMatrix<f64, RANK, GAGES>,
        redundant_noise: &SMatrix<f64, GAGES, GAGES>,
        turn: &SMatrix<f64, RANK, RANK>,
    ) -> SMatrix<f64, RANK, GAGES> {
        let gains = SVector::<f64, RANK>::from_fn(|a, _| shape.row(a).norm_squared());
        SMatrix::from_fn(|row, gage| {
            let mut gradient = Coefficients::zeros();
            let mut across = 0.0;
            for a in 0..RANK {
                for b in 0..RANK {
                    let turned = 2.0 * gains[a] / (gains[a] + gains[b]);
                    gradient[product_position::<RANK>(a, b)] += turn[(row, a)] * turned * shape[(b, gage)];
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
        shape: &SMatrix<f64, RANK, GAGES>,
        redundant_noise: &SMatrix<f64, GAGES, GAGES>,
    ) -> SVector<f64, GAGES> {
        let last = REGRESSORS - 1;
        SVector::from_fn(|gage, _| {
            let mut gradient = Coefficients::zeros();
            for a in 0..RANK {
                gradient[linear_position::<RANK>(a)] = shape[(a, gage)];
            }
            let along = gradient.dot(&(self.along * gradient));
            libm::sqrt((along + self.across[(last, last)] * redundant_noise[(gage, gage)]).max(0.0))
        })
    }

    /// The largest standard deviation of any gain, cross-talk or offset, relative to the load.
    pub fn worst_relative(&self) -> f64 {
        libm::sqrt(
            (0..linear_position::<RANK>(RANK))
                .map(|position| self.along[(position, position)])
                .fold(0.0, f64::max),
        )
    }
}

/// What turns a coefficient of φ into an element of E/2 or h/2: E stands twice in a product of different components.
const fn half<const RANK: usize>(position: usize) -> f64 {
    let mut a = 0;
    while a < RANK {
        if position == product_position::<RANK>(a, a) || position == linear_position::<RANK>(a) {
            return 0.5;
        }
        a += 1;
    }
    0.25
}
