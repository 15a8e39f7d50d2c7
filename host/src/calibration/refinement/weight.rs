//! How much each direction of the load counts.
//!
//! The constraint |m|² = 1 is known at a sample with the variance v(m) = 4 mᵀDm + 2 tr D² + u (see
//! [`ftcal_shared::estimation::uncertainty`]), D the noise of m and u the disturbance of the load. Maximum likelihood counts it 1/v
//! times. A weight that follows the sample's own noise brings a bias in; one that is a polynomial of the direction does not
//! ([`super::adjusted`]). So 1/v is replaced by the cubic polynomial of the quadratic form q(m) = mᵀDm that comes closest.

use nalgebra::{SMatrix, SVector, SymmetricEigen};

use super::Direction;
use super::adjusted::Exponents;

/// Powers of q beside the constant.
const POWERS: usize = 3;

/// Degree of the weight in the components of the direction.
pub(super) const DEGREE: usize = 2 * POWERS;

/// The variance v of |m|² as a function of the direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConstraintNoise {
    /// The diagonal of D.
    pub(super) variances: Direction,
    /// The variance of |m|² that the noise does not explain.
    pub(super) unexplained: f64,
}

impl ConstraintNoise {
    /// v(m).
    pub(super) fn at(&self, m: &Direction) -> f64 {
        let constant: f64 = self.variances.iter().map(|variance| variance * variance).sum();
        4.0 * self.form(m) + 2.0 * constant + self.unexplained
    }

    fn form(&self, m: &Direction) -> f64 {
        m.iter().zip(&self.variances).map(|(m, variance)| m * m * variance).sum()
    }
}

/// w = Σ cₖ (q/q_max)ᵏ.
#[derive(Clone, Debug)]
pub(super) struct Weight {
    coefficients: SVector<f64, { POWERS + 1 }>,
    /// The diagonal of D over its largest element.
    relative: Direction,
}

impl Weight {
    /// Every direction counts the same.
    pub(super) fn equal() -> Self {
        let mut coefficients = SVector::zeros();
        coefficients[0] = 1.0;
        Self { coefficients, relative: [0.0; 3] }
    }

    /// The weight closest to 1/v over these unit directions: least Σ v (w − 1/v)², which is what a weight other than 1/v adds to the
    /// variance of the answer. `None` where there is no noise.
    pub(super) fn of_likelihood(noise: &ConstraintNoise, directions: &[Direction]) -> Option<Self> {
        let largest = noise.variances.iter().copied().fold(0.0, f64::max);
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        let mut weight = Self::equal();
        weight.relative = noise.variances.map(|variance| variance / largest);
        let (mut normal, mut right) = (SMatrix::zeros(), SVector::zeros());
        for m in directions {
            let powers = weight.powers(m);
            normal += powers * powers.transpose() * (noise.at(m) / largest);
            right += powers;
        }
        // Where all variances are the same, q takes but one value: the least squares solution of least norm is a constant there.
        let eigen = SymmetricEigen::new(normal);
        let floor = eigen.eigenvalues.max() * RELATIVE_ROUNDING;
        weight.coefficients = eigen
            .eigenvalues
            .iter()
            .zip(eigen.eigenvectors.column_iter())
            .filter(|(value, _)| **value > floor)
            .map(|(value, vector)| vector * (vector.dot(&right) / value))
            .sum();
        weight.coefficients.iter().all(|c| c.is_finite()).then_some(weight)
    }

    /// w(m).
    pub(super) fn at(&self, m: &Direction) -> f64 {
        self.coefficients.dot(&self.powers(m))
    }

    fn powers(&self, m: &Direction) -> SVector<f64, { POWERS + 1 }> {
        let form: f64 = m.iter().zip(&self.relative).map(|(m, variance)| m * m * variance).sum();
        SVector::from_fn(|power, _| (0..power).map(|_| form).product())
    }

    /// The same as a sum of monomials of the direction.
    pub(super) fn monomials(&self) -> Vec<(Exponents, f64)> {
        let mut monomials = Vec::new();
        for i in 0..=POWERS {
            for j in 0..=POWERS - i {
                for k in 0..=POWERS - i - j {
                    let exponents = [i, j, k];
                    let mut factor = self.coefficients[i + j + k] * ways(exponents);
                    for (variance, power) in self.relative.iter().zip(exponents) {
                        factor *= (0..power).map(|_| variance).product::<f64>();
                    }
                    if factor != 0.0 {
                        monomials.push((exponents.map(|power| 2 * power), factor));
                    }
                }
            }
        }
        monomials
    }
}

/// An eigenvalue below this share of the largest is rounding.
const RELATIVE_ROUNDING: f64 = 1e-12;

/// (i + j + k)! / (i! j! k!).
fn ways([i, j, k]: Exponents) -> f64 {
    let factorial = |n: usize| (1..=n).product::<usize>() as f64;
    factorial(i + j + k) / (factorial(i) * factorial(j) * factorial(k))
}

#[cfg(test)]
mod tests {
    use super::super::constraint::monomial_at;
    use super::{ConstraintNoise, Weight};

    const ROUND_THE_SPHERE: [[f64; 3]; 5] =
        [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, 0.0, 1.0], [0.36, 0.48, 0.8], [0.6, -0.8, 0.0]];

    #[test]
    fn the_monomials_add_up_to_the_weight() {
        let noise = ConstraintNoise { variances: [1e-4, 4e-4, 1.6e-3], unexplained: 1e-4 };
        let weight = Weight::of_likelihood(&noise, &ROUND_THE_SPHERE).expect("there is noise");
        for m in &ROUND_THE_SPHERE {
            let sum: f64 = weight
                .monomials()
                .iter()
                .map(|&(exponents, factor)| factor * monomial_at(exponents, m))
                .sum();
            assert!((sum - weight.at(m)).abs() < 1e-12 * weight.at(m).abs().max(1.0));
        }
    }

    /// A cubic meets 1/v at four values of q.
    #[test]
    fn the_weight_is_one_over_the_variance_where_it_can_be() {
        let noise = ConstraintNoise { variances: [1.0, 2.0, 4.0], unexplained: 0.5 };
        let four = [0, 1, 2, 4].map(|direction| ROUND_THE_SPHERE[direction]);
        let weight = Weight::of_likelihood(&noise, &four).expect("there is noise");
        let scale = weight.at(&four[0]) * noise.at(&four[0]);
        for m in &four {
            assert!((weight.at(m) * noise.at(m) / scale - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn equal_noise_makes_equal_weights() {
        let noise = ConstraintNoise { variances: [0.01; 3], unexplained: 0.0 };
        let weight = Weight::of_likelihood(&noise, &ROUND_THE_SPHERE).expect("there is noise");
        let first = weight.at(&ROUND_THE_SPHERE[0]);
        assert!(ROUND_THE_SPHERE.iter().all(|m| (weight.at(m) / first - 1.0).abs() < 1e-9));
        assert!(Weight::of_likelihood(&ConstraintNoise { variances: [0.0; 3], ..noise }, &[]).is_none());
    }
}
