//! How certain the calibration is: the covariance of the joint solution, carried to the matrix and to a wrench.
//!
//! The inverse of the normal matrix is the covariance of all unknowns; of it only that of S̃ matters, in which the errors of
//! orientations, arms and masses are contained. With A = S̃ᵀ and C = A⁺,
//!
//! ```text
//! δC = −C δA C + (AᵀA)⁻¹ δAᵀ (I − A C)
//! ```
//!
//! and the wrench of a load w is wrong by −C δA w − C δb. The errors of shape and bias are of the same motion and belong
//! together: S̃ answers to an error of what a trial saw by the inverse of the normal matrix times the trial's share in the gradient.
//!
//! What all trials have in common does not average out over them, and makes all of C too large or too small in one ratio: the
//! masses, which are weighed on one scale, so that their common share of the variance is added again; and local gravity.

use nalgebra::{DMatrix, DVector};

use super::super::bias::BiasCovariance;
use super::super::drift::ShapeDeviation;
use super::super::known_load::mean_square_load;
use super::super::matrix::matrix_of_shape;
use super::super::wrench_uncertainty::WrenchUncertainty;
use super::refinement::{Fit, Problem};
use crate::gravity::Gravity;

/// Standard deviations of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Of each element of the matrix (m × p), newton and newton metre per count.
    pub matrix: DMatrix<f64>,
    /// Of each component of a wrench (m), newton and newton metre: the root mean square over the loads of the trials in
    /// all directions.
    pub per_axis_full_load: DVector<f64>,
    /// Of each component of any wrench; `None` of a calibration that does not say.
    pub wrench: Option<WrenchUncertainty>,
    /// Of the local gravity that is in both, m/s²; `None` where it is in neither.
    pub gravity_accuracy: Option<f64>,
}

impl Uncertainty {
    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let wrench = self.wrench.iter().flat_map(WrenchUncertainty::numbers);
        let numbers =
            self.matrix.iter().chain(&self.per_axis_full_load).chain(&self.gravity_accuracy).chain(wrench);
        numbers.copied().all(f64::is_finite)
    }
}

/// What a covariance is carried on with.
#[derive(Clone, Copy, Debug)]
pub struct Premises<'a> {
    /// Local gravity.
    pub gravity: Gravity,
    /// The loads of the trials, newton.
    pub newtons: &'a [f64],
    /// How certain the bias is.
    pub bias: &'a BiasCovariance,
    /// How many times larger than expected the misfit is.
    pub strain: f64,
}

/// What the covariance of the joint solution tells.
#[derive(Clone, Debug)]
pub struct Propagated {
    /// Standard deviations.
    pub uncertainty: Uncertainty,
    /// The predicted error of a wrench, relative, torques divided by the characteristic arm length.
    pub wrench_error: f64,
    /// How certain the shape is; without gravity.
    pub shape: ShapeDeviation,
}

/// Carries the covariance of a solution over to its calibration, or `None` where the observations leave it open.
pub fn propagate(problem: &Problem, fit: &Fit, premises: &Premises) -> Option<Propagated> {
    let &Premises { gravity, newtons, bias, strain } = premises;
    let (components, gages) = (problem.components(), problem.gages());
    let shape = &fit.state.shape;
    let matrix = matrix_of_shape(shape).ok()?;
    let inverse = inverse(&fit.normal)?;
    let covariance = shape_part(problem, &inverse) * strain;
    let common_mass = common_mass_variance(problem);
    let common = common_mass + gravity.relative_accuracy().powi(2);

    let across = DMatrix::identity(gages, gages) - shape.transpose() * &matrix;
    let gram_inverse = &matrix * matrix.transpose();
    let elements = DMatrix::from_fn(components, gages, |row, column| {
        // δC by the change of S̃ in component c and gage k.
        let gradient = DMatrix::from_fn(components, gages, |c, k| {
            gram_inverse[(row, c)] * across[(k, column)] - matrix[(row, k)] * matrix[(c, column)]
        });
        let variance = quadratic_form(&covariance, gradient.as_slice());
        (variance + common * matrix[(row, column)].powi(2)).max(0.0).sqrt() * problem.lengths[row]
    });

    let of_bias = &matrix * &bias.bias * matrix.transpose();
    let mixed = shape_with_bias(problem, fit, &inverse, bias);
    let errors: Vec<DMatrix<f64>> =
        (0..components).map(|row| component_covariance(&covariance, &matrix, row)).collect();
    let of_components = errors.iter().fold(DVector::zeros(components), |sum, error| sum + error.diagonal());
    let wrench = WrenchUncertainty {
        by_load: errors
            .into_iter()
            .enumerate()
            .map(|(row, mut error)| {
                error[(row, row)] += common;
                DMatrix::from_fn(components, components, |c, d| {
                    error[(c, d)] * problem.lengths[row].powi(2) / (problem.lengths[c] * problem.lengths[d])
                })
            })
            .collect(),
        with_bias: (0..components)
            .map(|row| {
                // Twice the covariance of (C δA) and C δb, component by component.
                let of_bias = &mixed * matrix.row(row).transpose();
                DVector::from_fn(components, |c, _| {
                    let of_gages = (0..gages).map(|k| matrix[(row, k)] * of_bias[k * components + c]);
                    2.0 * of_gages.sum::<f64>() * problem.lengths[row].powi(2) / problem.lengths[c]
                })
            })
            .collect(),
        unloaded: DVector::from_fn(components, |row, _| {
            of_bias[(row, row)].max(0.0).sqrt() * problem.lengths[row]
        }),
    }
    .bounded();
    let loads = newtons.iter().enumerate().map(|(trial, newton)| (problem.arm_m(trial, &fit.state), *newton));
    let per_axis = wrench.mean_variance(&mean_square_load(problem.rank, components, loads)).map(f64::sqrt);
    let wrench_error = (of_components.sum() / components as f64).sqrt();
    let of_gages = DVector::from_fn(gages, |gage, _| {
        let block = covariance.view((gage * components, gage * components), (components, components));
        (block.trace() / shape.column(gage).norm_squared() + common_mass).sqrt()
    });
    let uncertainty = Uncertainty {
        matrix: elements,
        per_axis_full_load: per_axis,
        wrench: Some(wrench),
        gravity_accuracy: Some(gravity.accuracy),
    };
    let finite = uncertainty.is_finite() && of_bias.iter().chain(&covariance).all(|x| x.is_finite());
    (finite && wrench_error.is_finite()).then(|| Propagated {
        uncertainty,
        wrench_error,
        shape: ShapeDeviation {
            gages: of_gages,
            components: of_components.map(|variance| (variance + common_mass).sqrt()),
        },
    })
}

/// The covariance of row `row` of −C δA over pairs of components: that of −Σₖ C[row, k] δS̃[c, k].
fn component_covariance(covariance: &DMatrix<f64>, matrix: &DMatrix<f64>, row: usize) -> DMatrix<f64> {
    let (components, gages) = matrix.shape();
    DMatrix::from_fn(components, components, |c, d| {
        let mut sum = 0.0;
        for k in 0..gages {
            for l in 0..gages {
                let element = covariance[(k * components + c, l * components + d)];
                sum += matrix[(row, k)] * matrix[(row, l)] * element;
            }
        }
        sum
    })
}

/// The inverse of the normal matrix: the covariance of all unknowns.
fn inverse(normal: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Brought to a diagonal of ones first: the unknowns differ by many orders of magnitude.
    let scale = normal.diagonal().map(|element| 1.0 / element.sqrt());
    let scaled =
        DMatrix::from_fn(normal.nrows(), normal.ncols(), |a, b| normal[(a, b)] * scale[a] * scale[b]);
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |a, b| inverse[(a, b)] * scale[a] * scale[b]))
}

/// The covariance of S̃, column by column.
fn shape_part(problem: &Problem, inverse: &DMatrix<f64>) -> DMatrix<f64> {
    let own = problem.observations.len() * problem.own_unknowns();
    let wide = inverse.nrows() - own;
    inverse.view((own, own), (wide, wide)).into_owned()
}

/// The covariance of S̃, column by column (mp), with the bias (p).
fn shape_with_bias(
    problem: &Problem,
    fit: &Fit,
    inverse: &DMatrix<f64>,
    bias: &BiasCovariance,
) -> DMatrix<f64> {
    let own = problem.own_unknowns();
    let first = problem.observations.len() * own;
    let wide = inverse.nrows() - first;
    let mut covariance = DMatrix::zeros(wide, problem.gages());
    for (trial, with_shape) in bias.with_shapes.iter().enumerate() {
        let (by_own, by_shape) = problem.response(trial, &fit.state);
        let answer = inverse.view((first, trial * own), (wide, own)) * by_own
            + inverse.view((first, first), (wide, wide)) * by_shape;
        covariance += answer * with_shape;
    }
    covariance
}

/// The variance that all masses have in common, relative, beyond what is left of it in the mean of the trials.
fn common_mass_variance(problem: &Problem) -> f64 {
    let trials = problem.observations.len().max(1) as f64;
    let variance = problem.observations.iter().map(|trial| trial.mass_accuracy.powi(2)).sum::<f64>() / trials;
    variance * (1.0 - 1.0 / trials)
}

fn quadratic_form(covariance: &DMatrix<f64>, gradient: &[f64]) -> f64 {
    let gradient = DVector::from_column_slice(gradient);
    gradient.dot(&(covariance * &gradient))
}
