//! Moments of the load's directions, free of noise, to any degree (Kukush, Markovsky, Van Huffel; design § 3.3).
//!
//! A component x of a sample is its true value plus Gaussian noise of variance ν. The mean of xᵏ is then not that of the true
//! value's power, but the mean of the Hermite polynomial Heₖ(x; ν) is:
//!
//! ```text
//! He₀ = 1    He₁ = x    Heₖ₊₁ = x Heₖ − k ν Heₖ₋₁
//! ```
//!
//! (x² − ν, x³ − 3νx, x⁴ − 6νx² + 3ν², …: those of the metric constraint.) In the frame in which the rows of the shape are
//! orthogonal the noise of different components is independent, so that their polynomials multiply. Whatever is a polynomial of
//! the true direction thereby has an estimate without bias, however large the noise.

use super::Direction;

/// Exponents of the components of one monomial; those beyond the rank are zero.
pub(super) type Exponents = [usize; 3];

/// The highest total degree: the weight's and, four, that of a product of two terms of the constraint.
pub(super) const DEGREE: usize = super::weight::DEGREE + 4;

const SIZE: usize = DEGREE + 1;

/// Sums over samples of every monomial of their true directions, estimated.
#[derive(Clone, Debug)]
pub(super) struct AdjustedSums {
    sums: Vec<f64>,
}

impl AdjustedSums {
    /// Of directions whose components carry noise of these variances. At rank 2 the third component is zero.
    pub(super) fn of(directions: &[Direction], variances: Direction, rank: usize) -> Self {
        let mut sums = vec![0.0; SIZE * SIZE * SIZE];
        let highest_third = if rank == 3 { DEGREE } else { 0 };
        for direction in directions {
            let [first, second, third]: [[f64; SIZE]; 3] =
                std::array::from_fn(|axis| hermite(direction[axis], variances[axis]));
            for k in 0..=highest_third {
                for j in 0..=DEGREE - k {
                    let product = third[k] * second[j];
                    let row = &mut sums[position([0, j, k])..];
                    for (sum, value) in row.iter_mut().zip(&first[..=DEGREE - k - j]) {
                        *sum += product * value;
                    }
                }
            }
        }
        Self { sums }
    }

    /// The sum of one monomial of degree [`DEGREE`] at most.
    pub(super) fn at(&self, exponents: Exponents) -> f64 {
        self.sums[position(exponents)]
    }
}

/// He₀ … of one component.
fn hermite(x: f64, variance: f64) -> [f64; SIZE] {
    let mut values = [1.0; SIZE];
    values[1] = x;
    for k in 1..DEGREE {
        values[k + 1] = x * values[k] - k as f64 * variance * values[k - 1];
    }
    values
}

const fn position([first, second, third]: Exponents) -> usize {
    (third * SIZE + second) * SIZE + first
}

/// The monomial that is the product of two.
pub(super) fn product(left: Exponents, right: Exponents) -> Exponents {
    std::array::from_fn(|axis| left[axis] + right[axis])
}

#[cfg(test)]
mod tests {
    use super::{AdjustedSums, hermite};

    /// E Heₖ(x + e; ν) = xᵏ for e of variance ν: exact by the Gauss-Hermite rule of three points (0 and ±√3ν) up to degree five,
    /// and by two points' symmetry for odd degrees.
    #[test]
    fn the_mean_over_the_noise_is_the_power_of_the_true_value() {
        let variance: f64 = 0.04;
        let node = (3.0 * variance).sqrt();
        for x in [-1.0, -0.3, 0.0, 0.7] {
            let mean = |k: usize| {
                (4.0 * hermite(x, variance)[k]
                    + hermite(x + node, variance)[k]
                    + hermite(x - node, variance)[k])
                    / 6.0
            };
            for k in 0..=5 {
                let power = x.powi(i32::try_from(k).expect("small"));
                assert!((mean(k) - power).abs() < 1e-14, "degree {k} at {x}");
            }
        }
    }

    #[test]
    fn without_noise_the_sums_are_plain() {
        let directions = [[0.5, -0.5, 0.7], [0.1, 0.9, -0.2]];
        let sums = AdjustedSums::of(&directions, [0.0; 3], 3);
        for exponents in [[0, 0, 0], [1, 0, 0], [2, 3, 1], [0, 4, 6], [10, 0, 0]] {
            let plain: f64 = directions
                .iter()
                .map(|direction| {
                    direction
                        .iter()
                        .zip(exponents)
                        .map(|(x, k)| x.powi(i32::try_from(k).expect("small")))
                        .product::<f64>()
                })
                .sum();
            assert!((sums.at(exponents) - plain).abs() < 1e-15);
        }
    }
}
