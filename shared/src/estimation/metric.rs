//! The metric constraint: the load's magnitude never changes (eq. 13, design § 3.3).
//!
//! In whitened coordinates x = Λ^-½ V*ᵀ(z − z̄) the motion lies on an ellipsoid xᵀQx + gᵀx = 1 with free centre. The
//! paper solves its equation 13 for Q by least squares; squares of noisy coordinates then carry the noise variance with
//! them and bias the answer by about −3.3(σ/F)². Here the moments are taken less their noise first
//! ([`MotionMoments::without_noise`]): **adjusted least squares**. With no noise this is the paper's least squares with
//! a free centre.

use nalgebra::SMatrix;

use super::coordinates::{MotionMatrix, MotionVector, carried, cholesky, identity, vector};
use super::eigen::symmetric_eigen;
use super::motion_moments::MotionMoments;
use super::quadric::{Coefficients, UNKNOWNS, linear_position, monomials, normal_matrix, product_position};
use super::square::invert;
use crate::refusal::Refusal;
use crate::units::{MAX_RANK, Rank};

/// The largest relative standard deviation of a principal value of Q that counts as determined by the motion.
///
/// A gain's relative standard deviation is half of this: a motion that cannot fix a gain within 5 % is refused.
pub const LARGEST_RELATIVE_UNCERTAINTY: f64 = 0.1;

/// The largest standard deviation of the load's magnitude, relative and beyond noise, that still is one constant load:
/// twice what a hand that never rests does to it.
const LARGEST_SCATTER: f64 = 0.1;

/// The largest trace of the inverse of the normal matrix that is not rounding: whitened coordinates are of order one, and the
/// moments of degree four carry relative errors up to 10⁻⁶. The trace lies between one and nine times the inverse of the
/// least eigenvalue.
const LARGEST_INVERSE_TRACE: f64 = 1e5;

/// ε: rounding of the moments, relative to the largest of them: some 5·10⁻⁹ as they are summed up, and the same again in taking them
/// about their mean.
const ROUNDING: f64 = 1e-8;

/// Rounding is no part of the uncertainty that is told, so that it must not matter: so many times its deviation counts.
const ROUNDING_WEIGHT: f64 = 10.0;

/// What the rounding of the moments may hide of the unexplained variance: a few parts in 10⁻⁹ of them.
pub(crate) const LEAST_UNEXPLAINED: f64 = 1e-8;

/// The ellipsoid (x − c)ᵀ M (x − c) = 1 of the motion in whitened coordinates.
#[derive(Clone, Debug)]
pub struct Metric {
    /// M (r × r, positive definite); AᵀMA = I gives the paper's A of eq. 11.
    pub matrix: MotionMatrix,
    /// The centre c.
    pub centre: MotionVector,
    /// The variance of (x − c)ᵀM(x − c), which should be one throughout, less what the noise explains of it.
    pub unexplained: f64,
}

/// Solves the metric constraint from central moments of the whitened motion.
///
/// `variances` are those of the motion before it was whitened, `noise_variance` that of a channel in the same unit; zero where it
/// is not known. `accepted` is the largest relative standard deviation of a principal value of Q with which there is an
/// answer: [`LARGEST_RELATIVE_UNCERTAINTY`], or more for one that says no more than where a trial stands.
///
/// # Errors
///
/// [`Refusal::NonFinite`]; [`Refusal::MotionDoesNotSpan`] where the directions of the load do not determine every
/// coefficient; [`Refusal::MetricNotPositiveDefinite`] where the surface is no ellipsoid;
/// [`Refusal::MagnitudeNotConstant`] where the motion does not lie on it.
#[inline(never)]
pub fn metric(
    rank: Rank,
    moments: &MotionMoments,
    variances: &MotionVector,
    noise_variance: f64,
    samples: u64,
    accepted: f64,
) -> Result<Metric, Refusal> {
    let noise = vector(rank, |axis| noise_variance / variances[axis]);
    let mut equations = equations(rank, moments, &noise);
    invert_normal(&mut equations.normal)?;
    // By reference: moved, it would stand on the stack twice.
    let Equations { normal: inverse, right, second } = &equations;
    let solution = inverse * right;

    let quadratic = MotionMatrix::from_fn(|a, b| {
        let element = solution[product_position(a, b)];
        if a == b { element } else { element / 2.0 }
    });
    let linear = MotionVector::from_fn(|a, _| solution[linear_position(a)]);

    // What the constraint leaves unexplained, and the noise, which the moments have been freed of: to first order it
    // moves xᵀQx + gᵀx by its product with the gradient 2Qx + g.
    let unexplained = (1.0 - solution.dot(right)).max(0.0);
    let squared_gradient = carried(&quadratic, second).diagonal() * 4.0 + linear.component_mul(&linear);
    let of_samples = (unexplained + squared_gradient.dot(&noise)) / samples.max(1) as f64;
    let covariance = Covariance { inverse, of_samples, of_rounding: rounding(rank, &solution, variances) };
    require_determined(rank, &quadratic, &covariance, accepted)?;

    let quadratic_factor = cholesky(&quadratic, rank).ok_or(Refusal::MetricNotPositiveDefinite)?;
    let centre = quadratic_factor.solve(&linear) * -0.5;
    // xᵀQx + gᵀx = 1 about its centre: (x − c)ᵀQ(x − c) = 1 + cᵀQc.
    let level = 1.0 + centre.dot(&(quadratic * centre));
    let unexplained = unexplained / (level * level);
    // The magnitude's standard deviation is half of that of its square, which should be one.
    let scatter = libm::sqrt(unexplained) / 2.0;
    if scatter > LARGEST_SCATTER {
        #[expect(clippy::cast_possible_truncation, reason = "a report of three digits")]
        return Err(Refusal::MagnitudeNotConstant { scatter: scatter as f32, limit: LARGEST_SCATTER as f32 });
    }
    Ok(Metric { matrix: quadratic / level, centre, unexplained })
}

/// The normal equations of the constraint.
struct Equations {
    /// ⟨φφᵀ⟩, of moments free of noise.
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// ⟨φ⟩.
    right: Coefficients,
    /// ⟨xxᵀ⟩.
    second: MotionMatrix,
}

/// Sets the equations up. Never inlined: the moments that it takes are large, and the sensor's stack is not.
#[inline(never)]
fn equations(rank: Rank, moments: &MotionMoments, noise: &MotionVector) -> Equations {
    let free = moments.without_noise(&MotionMatrix::from_diagonal(noise));
    Equations { normal: normal_matrix(&free, rank), right: means(&free), second: free.second }
}

/// Replaces a normal matrix by its inverse.
#[inline(never)]
fn invert_normal(normal: &mut SMatrix<f64, UNKNOWNS, UNKNOWNS>) -> Result<(), Refusal> {
    if normal.iter().any(|element| !element.is_finite()) {
        return Err(Refusal::NonFinite);
    }
    invert(normal).map_err(|_| does_not_span(f64::INFINITY))?;
    if normal.trace() > LARGEST_INVERSE_TRACE { Err(does_not_span(f64::INFINITY)) } else { Ok(()) }
}

/// By how much unknown noise may have moved the ellipsoid, in coordinates in which the one found is |m| = 1.
#[derive(Clone, Debug)]
pub struct NoiseShift {
    /// E (r × r): what is added to the identity.
    pub metric: MotionMatrix,
    /// δ (r): how far the centre moves.
    pub centre: MotionVector,
}

/// Where nothing redundant tells the noise (p = r), the answer must not hinge on it.
///
/// The moments then carry noise of unknown variance σ² in every channel, ν_k = σ²/λ_k in whitened coordinate k, and pull the
/// ellipsoid with them: the more, the less of it the motion covers, until noise alone, of a load that never moved, looks
/// like a motion. But noise cannot hide: to first order it leaves a variance of Σ ν_k ⟨(∂/∂x_k)²⟩ of (x − c)ᵀM(x − c)
/// unexplained, with the gradient 2M(x − c). All that is unexplained, taken for noise, gives the most that σ² can be; solved
/// with that much noise taken out, the ellipsoid must stay where it was, by the measure that its own statistical
/// uncertainty must meet: no more than `accepted`. By as much as it does move, the answer may be off for all that is known.
///
/// # Errors
///
/// [`Refusal::MotionDoesNotSpan`] with the largest relative change of a principal value, or of the centre.
pub fn require_indifference_to_noise(
    rank: Rank,
    moments: &MotionMoments,
    variances: &MotionVector,
    found: &Metric,
    samples: u64,
    accepted: f64,
) -> Result<NoiseShift, Refusal> {
    let about_centre = moments.second + found.centre * found.centre.transpose();
    let squared_gradient = carried(&found.matrix, &about_centre).diagonal() * 4.0;
    let shares = vector(rank, |axis| 1.0 / variances[axis]);
    let most = found.unexplained.max(LEAST_UNEXPLAINED) / squared_gradient.dot(&shares);
    let other = metric(rank, moments, variances, most, samples, accepted)?;

    // In coordinates in which the ellipsoid found is the unit sphere.
    let factor = cholesky(&found.matrix, rank).ok_or(Refusal::MetricNotPositiveDefinite)?;
    let half = factor.l().solve_lower_triangular(&other.matrix).ok_or(Refusal::NonFinite)?;
    let relative = factor.l().solve_lower_triangular(&half.transpose()).ok_or(Refusal::NonFinite)?;
    let metric = relative - identity(rank);
    let centre = factor.l().transpose() * (other.centre - found.centre);
    // A gain changes by half of what its square does.
    let change = symmetric_eigen(&metric, rank.count())?.values.amax().max(2.0 * centre.norm());
    if change > accepted { Err(does_not_span(change)) } else { Ok(NoiseShift { metric, centre }) }
}

/// The covariance of the coefficients s = N⁻¹⟨φ⟩.
struct Covariance<'a> {
    /// N⁻¹.
    inverse: &'a SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// The variance of the constraint over the number of samples: from chance, the covariance is N⁻¹ times that.
    of_samples: f64,
    /// D⁻¹ times a number, see [`rounding`].
    of_rounding: Coefficients,
}

impl Covariance<'_> {
    /// The variance along a gradient: that of chance, and that of rounding.
    fn along(&self, gradient: &Coefficients) -> f64 {
        let turned = self.inverse * gradient;
        gradient.dot(&turned) * self.of_samples + self.of_rounding.component_mul(&turned).norm_squared()
    }
}

/// What rounding does to the coefficients s = N⁻¹⟨φ⟩, [`ROUNDING_WEIGHT`] times as large as it is: N⁻¹ times the diagonal matrix of
/// these numbers is the square root of its covariance.
///
/// The moments of the codes are rounded by ε of their size, which is that of the strongest axis of the motion. In
/// coordinates of that size, y = T x with T = diag √(λₐ/λ₁), all elements of N_y = D N D are off by ε, where D has the products
/// of T that belong to φ. So s_y = D⁻¹s is off by ε|s_y| N_y⁻¹, and s by N⁻¹D⁻¹ times that: little in a round motion, and most in
/// a motion that is flat and hardly determines what is across it.
fn rounding(rank: Rank, solution: &Coefficients, variances: &MotionVector) -> Coefficients {
    let flatness = vector(rank, |axis| libm::sqrt(variances.max() / variances[axis]));
    let sizes = monomials(&flatness);
    let coefficients = solution.component_mul(&sizes).norm();
    sizes * (ROUNDING * ROUNDING_WEIGHT * coefficients)
}

/// Every principal value of Q must stand clear of its own uncertainty; a negative one that does is no ellipsoid.
fn require_determined(
    rank: Rank,
    quadratic: &MotionMatrix,
    covariance: &Covariance<'_>,
    accepted: f64,
) -> Result<(), Refusal> {
    let principal = symmetric_eigen(quadratic, rank.count())?;
    for k in rank.axes() {
        let direction = principal.vectors.column(k);
        let mut gradient = Coefficients::zeros();
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                gradient[product_position(a, b)] = direction[a] * direction[b];
            }
        }
        let deviation = libm::sqrt(covariance.along(&gradient).max(0.0));
        let value = principal.values[k];
        let relative = deviation / value.abs().max(f64::MIN_POSITIVE);
        let determined = relative <= LARGEST_RELATIVE_UNCERTAINTY;
        if relative > accepted || (value <= 0.0 && !determined) {
            return Err(does_not_span(relative));
        }
        if value <= 0.0 {
            return Err(Refusal::MetricNotPositiveDefinite);
        }
    }
    Ok(())
}

/// ⟨φ⟩ of central moments.
fn means(central: &MotionMoments) -> Coefficients {
    let mut means = Coefficients::zeros();
    for a in 0..MAX_RANK {
        for b in a..MAX_RANK {
            means[product_position(a, b)] = central.second[(a, b)];
        }
    }
    means
}

#[expect(clippy::cast_possible_truncation, reason = "a report of three digits")]
pub(crate) const fn does_not_span(relative_uncertainty: f64) -> Refusal {
    Refusal::MotionDoesNotSpan {
        relative_uncertainty: relative_uncertainty as f32,
        need: LARGEST_RELATIVE_UNCERTAINTY as f32,
    }
}
