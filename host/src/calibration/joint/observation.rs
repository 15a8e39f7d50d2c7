//! What the joint solution takes from one trial: its shape, how certain each part of it is, and what is known about its
//! orientation.
//!
//! The trial saw S (r × p) in a frame of its own, so that R S = [I Xᵀ] S̃ in the sensor frame. A misfit E of S splits in
//! three (design § 7), each whitened by its own covariance:
//!
//! ```text
//! D = E S⁺ (r × r)    symmetric part       the gains, known as the trial's motion tells
//!                     antisymmetric part   a turn of the frame: R carries it, so it is no error and gets full weight
//! E N (r × (p−r))     across the shape     a regression, known far better than the gains
//! ```
//!
//! with N the directions of the codes that no load of the trial moves. The whitening is one rp × rp matrix on E, column
//! by column.

use nalgebra::{DMatrix, DVector};

use super::super::alignment::{Hand, Sight, sights};
use super::super::matrix::matrix_of_shape;
use super::super::{CalibrationRefusal, SolvedTrial, turning};

/// Relative errors below this are rounding, whatever the trial says.
const ROUNDING: f64 = 1e-7;

/// How many times the best-known gain the frame is known: R has no error but its own.
const FRAME_WEIGHT: f64 = 10.0;

/// One trial as the joint solution takes it.
#[derive(Clone, Debug)]
pub struct Observation {
    /// S (r × p) in the trial's own frame, counts per newton.
    pub shape: DMatrix<f64>,
    /// Misfit of S, column by column, to independent numbers of variance one (rp × rp).
    pub whitening: DMatrix<f64>,
    /// The arm as the session states it, metre; empty for force sensors.
    pub arm_m: DVector<f64>,
    /// Standard deviation of each component of the arm, metre.
    pub arm_accuracy_m: f64,
    /// Relative standard deviation of the mass.
    pub mass_accuracy: f64,
    /// The known loads, rough ones too.
    pub sights: Vec<Sight>,
    /// The hand that the sense of turning demands.
    pub hand: Option<Hand>,
}

impl Observation {
    /// The observation of one trial (numbered from zero). `model_error` is the relative error of a coefficient that the
    /// trial's own covariance does not know of.
    ///
    /// # Errors
    ///
    /// Those of [`sights`] and [`turning::hand`]; [`CalibrationRefusal::Trial`] of a shape that cannot be inverted.
    pub fn new(
        trial: usize,
        solved: &SolvedTrial,
        gravity: f64,
        model_error: f64,
    ) -> Result<Self, CalibrationRefusal> {
        let SolvedTrial { case, shape, turned } = solved;
        let newton = case.mass_kg * gravity;
        let own = &shape.shape_counts_per_load / newton;
        let redundant = shape.covariance.redundant() / (newton * newton);
        let whitening = whitening(&own, &shape.covariance.gains(), &redundant, model_error.max(ROUNDING))
            .map_err(|refusal| CalibrationRefusal::Trial { trial, refusal })?;
        Ok(Self {
            whitening,
            shape: own,
            arm_m: case.arm_m.clone(),
            arm_accuracy_m: case.arm_accuracy_m,
            mass_accuracy: case.mass_accuracy_kg / case.mass_kg,
            sights: sights(trial, case, shape)?,
            hand: turned.as_ref().map(|turned| turning::hand(trial, turned)).transpose()?,
        })
    }
}

/// The whitening of a trial's misfit from the covariances of its gains (a ≤ b) and across the shape.
fn whitening(
    shape: &DMatrix<f64>,
    gains: &DMatrix<f64>,
    redundant: &DMatrix<f64>,
    model_error: f64,
) -> Result<DMatrix<f64>, ftcal_shared::refusal::Refusal> {
    let (rank, gages) = shape.shape();
    let inverse = matrix_of_shape(shape)?.transpose();
    let across = unmoved_directions(&(&inverse * shape), rank);
    // A coefficient off by ε of the typical one is a gain off by ε/√p.
    let gain_floor = model_error * model_error / gages as f64;
    let coefficient_floor = model_error * model_error * shape.norm_squared() / shape.len() as f64;
    let gains = with_floor(gains, gain_floor);
    let redundant = with_floor(redundant, coefficient_floor);
    let frame_weight = FRAME_WEIGHT / gains.symmetric_eigenvalues().min().max(gain_floor).sqrt();

    let pairs: Vec<(usize, usize)> = (0..rank).flat_map(|a| (a..rank).map(move |b| (a, b))).collect();
    let (gain_factor, across_factor) = (inverse_factor(gains)?, inverse_factor(redundant)?);
    let columns = (0..gages).flat_map(|gage| (0..rank).map(move |row| (row, gage)));
    let mut whitening = DMatrix::zeros(rank * gages, rank * gages);
    for (column, (row, gage)) in columns.enumerate() {
        // D of a misfit of one in this coefficient.
        let share = |a: usize, b: usize| if a == row { inverse[(gage, b)] } else { 0.0 };
        let symmetric = DVector::from_iterator(
            pairs.len(),
            pairs.iter().map(|&(a, b)| f64::midpoint(share(a, b), share(b, a))),
        );
        let turns = pairs
            .iter()
            .filter(|(a, b)| a != b)
            .map(|&(a, b)| frame_weight * f64::midpoint(share(a, b), -share(b, a)));
        let unit = DVector::from_fn(rank, |a, _| if a == row { 1.0 } else { 0.0 });
        let regression = &across_factor * unit;
        let whitened = (&gain_factor * symmetric).iter().copied().chain(turns).collect::<Vec<_>>();
        let rest = across.column_iter().flat_map(|direction| {
            let by = direction[gage];
            regression.iter().map(move |component| component * by)
        });
        let all: Vec<f64> = whitened.into_iter().chain(rest).collect();
        whitening.set_column(column, &DVector::from_vec(all));
    }
    Ok(whitening)
}

/// Orthonormal directions N (p × (p−r)) that the projector onto the shape's rows takes to zero.
fn unmoved_directions(projector: &DMatrix<f64>, rank: usize) -> DMatrix<f64> {
    let eigen = projector.clone().symmetric_eigen();
    let mut order: Vec<usize> = (0..projector.nrows()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    order.truncate(projector.nrows() - rank);
    eigen.eigenvectors.select_columns(&order)
}

fn with_floor(covariance: &DMatrix<f64>, floor: f64) -> DMatrix<f64> {
    covariance + DMatrix::identity(covariance.nrows(), covariance.ncols()) * floor
}

/// L⁻¹ of a covariance LLᵀ.
fn inverse_factor(covariance: DMatrix<f64>) -> Result<DMatrix<f64>, ftcal_shared::refusal::Refusal> {
    let identity = DMatrix::identity(covariance.nrows(), covariance.ncols());
    covariance
        .cholesky()
        .and_then(|factor| factor.l().solve_lower_triangular(&identity))
        .ok_or(ftcal_shared::refusal::Refusal::NonFinite)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{FRAME_WEIGHT, whitening};

    #[test]
    fn every_part_of_a_misfit_counts_by_its_own_deviation() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for (rank, gages) in [(2, 2), (2, 4), (3, 3), (3, 8)] {
            let shape = DMatrix::from_fn(rank, gages, |_, _| random.random::<f64>() - 0.5);
            let (gain, across) = (1e-3, 1e-2);
            let gains = rank * (rank + 1) / 2;
            let whitening = whitening(
                &shape,
                &(DMatrix::identity(gains, gains) * gain * gain),
                &(DMatrix::identity(rank, rank) * across * across),
                1e-9,
            )
            .expect("of full rank");
            let length =
                |misfit: &DMatrix<f64>| (&whitening * DVector::from_column_slice(misfit.as_slice())).norm();
            // All gains too large by one standard deviation: r independent gains, each off by one.
            let larger = length(&(&shape * gain));
            assert!((larger - (rank as f64).sqrt()).abs() < 1e-4, "{larger}");
            // A turn counts as so many deviations of the gains.
            let mut turn = DMatrix::zeros(rank, rank);
            (turn[(0, 1)], turn[(1, 0)]) = (-gain, gain);
            assert!((length(&(turn * &shape)) - FRAME_WEIGHT).abs() < 1e-3);
            // What is orthogonal to every row of the shape lies across it.
            let random_row = DMatrix::from_fn(rank, gages, |_, _| random.random::<f64>() - 0.5);
            let projector = shape.clone().pseudo_inverse(1e-12).expect("finite") * &shape;
            let beyond = &random_row - &random_row * projector;
            assert!((length(&beyond) - beyond.norm() / across).abs() < 1e-4 * (1.0 + beyond.norm() / across));
        }
    }
}
