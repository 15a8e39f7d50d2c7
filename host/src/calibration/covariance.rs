//! How certain the shape and the bias of one trial are, in the counts of its recording (design § 4).
//!
//! The estimator's prediction, with dimensions known at run time. In the trial's own frame an error of the shape is
//! δS = (E/2)S along the shape, and an independent regression error in each of the p − r directions of the codes across
//! it; that of the bias is Sᵀh/2 along and a regression error across. A turn of the frame is no error: the orientation is
//! arbitrary.

use ftcal_shared::estimation::uncertainty::TrialUncertainty;
use nalgebra::{DMatrix, DVector, SMatrix};

/// A projection is its own square, but for rounding.
const SAME: f64 = 1e-9;

/// Covariances of one trial's shape and bias.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialCovariance {
    /// Of the elements (a ≤ b) of E/2, row by row, then of h/2 (r): relative.
    along: DMatrix<f64>,
    /// Of the regression on m (r) and on 1, counts², in each direction of the codes across the shape.
    across: DMatrix<f64>,
    /// What the noise has across the shape (p × p), over that of a channel: the projection onto those directions where all
    /// channels are equally noisy.
    redundant_noise: DMatrix<f64>,
}

impl TrialCovariance {
    /// The estimator's prediction, whose codes are `counts_per_code` counts each.
    pub fn new<const GAGES: usize>(
        uncertainty: &TrialUncertainty,
        redundant_noise: &SMatrix<f64, GAGES, GAGES>,
        counts_per_code: f64,
    ) -> Self {
        let unknowns: Vec<usize> = uncertainty.unknowns().collect();
        let regressors: Vec<usize> = uncertainty.regressors().collect();
        let of = |all: &dyn Fn(usize, usize) -> f64, positions: &[usize]| {
            DMatrix::from_fn(positions.len(), positions.len(), |a, b| all(positions[a], positions[b]))
        };
        Self {
            along: of(&|a, b| uncertainty.along()[(a, b)], &unknowns),
            redundant_noise: DMatrix::from_column_slice(GAGES, GAGES, redundant_noise.as_slice()),
            across: of(&|a, b| uncertainty.across()[(a, b)], &regressors)
                * (counts_per_code * counts_per_code),
        }
    }

    /// Of covariances along and across the shape, as the fields say.
    pub(super) fn with(&self, along: DMatrix<f64>, across: DMatrix<f64>) -> Self {
        Self { along, across, redundant_noise: self.redundant_noise.clone() }
    }

    /// Whether the trial took all channels for equally noisy: what is left of the noise is then a projection.
    pub fn channels_are_equal(&self) -> bool {
        let noise = &self.redundant_noise;
        (noise * noise - noise).amax() < SAME
    }

    /// Of the regression on m (r) and on 1, counts², in each direction of the codes across the shape.
    pub(super) const fn across(&self) -> &DMatrix<f64> {
        &self.across
    }

    /// Covariance of the elements (a ≤ b) of E/2, row by row.
    pub fn gains(&self) -> DMatrix<f64> {
        let gains = self.gain_count();
        self.along.view((0, 0), (gains, gains)).into_owned()
    }

    /// Covariance (r × r) of the shape's rows in each direction of the codes across it, (counts per unit load)².
    pub fn redundant(&self) -> DMatrix<f64> {
        let rank = self.rank();
        self.across.view((0, 0), (rank, rank)).into_owned()
    }

    /// Standard deviation of the least certain gain, relative.
    pub fn gain_deviation(&self) -> f64 {
        largest_deviation(&self.along, 0..self.gain_count())
    }

    /// Standard deviation of the least certain component of the bias, as a share of the load.
    pub fn bias_deviation(&self) -> f64 {
        largest_deviation(&self.along, self.gain_count()..self.along.nrows())
    }

    /// Covariance of the bias (p × p), counts², of a trial of this shape (r × p, counts per unit load).
    pub fn bias(&self, shape: &DMatrix<f64>) -> DMatrix<f64> {
        let (rank, gains) = (self.rank(), self.gain_count());
        let along = shape.transpose() * self.along.view((gains, gains), (rank, rank)) * shape;
        along + &self.redundant_noise * self.across[(rank, rank)]
    }

    /// Covariance of the elements of the shape (r × p, counts per unit load, column by column) with those of the bias (p), of
    /// a trial of this shape, whose errors do not turn it: both are displaced along the shape by one estimate of E and h, and
    /// across it by one regression.
    pub fn shape_with_bias(&self, shape: &DMatrix<f64>) -> DMatrix<f64> {
        let (rank, gains) = (self.rank(), self.gain_count());
        let mixed = self.along.view((0, gains), (gains, rank)) * shape;
        DMatrix::from_fn(rank * shape.ncols(), shape.ncols(), |element, biased| {
            let (gage, row) = (element / rank, element % rank);
            let along: f64 = (0..rank)
                .map(|other| shape[(other, gage)] * mixed[(gain_position(rank, row, other), biased)])
                .sum();
            along + self.across[(row, rank)] * self.redundant_noise[(gage, biased)]
        })
    }

    /// Standard deviations of the elements of the trial's shape (r × p, counts per unit load, rows orthogonal), up to its
    /// orientation.
    ///
    /// The orientation closest to the truth makes δS Sᵀ symmetric, so that element (a, b) of E/2 counts 2gₐ/(gₐ + g_b) times,
    /// with the squared lengths g of the rows.
    pub fn shape(&self, shape: &DMatrix<f64>) -> DMatrix<f64> {
        let rank = self.rank();
        let squares: Vec<f64> = shape.row_iter().map(|row| row.norm_squared()).collect();
        DMatrix::from_fn(rank, shape.ncols(), |row, gage| {
            let mut gradient = DVector::zeros(self.gain_count());
            for other in 0..rank {
                let turned = 2.0 * squares[row] / (squares[row] + squares[other]);
                gradient[gain_position(rank, row, other)] = turned * shape[(other, gage)];
            }
            let along = gradient.dot(&(self.gains() * &gradient));
            (along + self.across[(row, row)] * self.redundant_noise[(gage, gage)]).max(0.0).sqrt()
        })
    }

    fn rank(&self) -> usize {
        self.across.nrows() - 1
    }

    fn gain_count(&self) -> usize {
        self.along.nrows() - self.rank()
    }
}

/// Where the element (row, column) of E/2 stands among those with row ≤ column, row by row.
const fn gain_position(rank: usize, row: usize, column: usize) -> usize {
    let (low, high) = if row <= column { (row, column) } else { (column, row) };
    low * rank - low * (low + 1) / 2 + high
}

fn largest_deviation(covariance: &DMatrix<f64>, range: std::ops::Range<usize>) -> f64 {
    range.map(|unknown| covariance[(unknown, unknown)]).fold(0.0, f64::max).sqrt()
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::DMatrix;

    use crate::calibration::procrustes::onto;
    use crate::calibration::synthetic::{Sensor, sphere};
    use crate::calibration::trial::{Gating, solve};
    use crate::session_file::STANDARD_GRAVITY;

    #[test]
    fn the_predicted_uncertainty_is_that_of_repeated_trials() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, 1);
        sensor.noise_counts *= 10.0;
        let truth = sensor.shape.transpose() * &sensor.shape;
        let (repetitions, mut predicted, mut observed) = (40, 0.0, 0.0);
        let mut bias = DMatrix::zeros(6, 6);
        let mut bias_observed = 0.0;
        let (mut shape_predicted, mut shape_observed) = (0.0, 0.0);
        for _ in 0..repetitions {
            let recording = sensor.record(1.0, &[], &sphere(400));
            let trial = solve(&recording, 3, Gating::On).expect("the motion spans");
            predicted += trial.covariance.gain_deviation().powi(2) / f64::from(repetitions);
            // SᵀS is free of the arbitrary orientation; a relative error e of S is one of 2e there.
            let shape = &trial.shape_counts_per_load / STANDARD_GRAVITY;
            let error = (shape.transpose() * &shape - &truth).norm() / truth.norm() / 2.0;
            observed += error.powi(2) / f64::from(repetitions);
            let turned = onto(&shape, &sensor.shape).turned;
            shape_observed += (turned - &sensor.shape).norm_squared() / f64::from(repetitions);
            let deviation = trial.covariance.shape(&trial.shape_counts_per_load) / STANDARD_GRAVITY;
            shape_predicted += deviation.norm_squared() / f64::from(repetitions);
            bias += trial.covariance.bias(&trial.shape_counts_per_load) / f64::from(repetitions);
            bias_observed +=
                (&trial.bias_counts - &sensor.bias_counts).norm_squared() / f64::from(repetitions);
        }
        // The prediction is for the worst single gain, the observation for all together: equal within a small factor.
        let ratio = (predicted / observed).sqrt();
        assert!((0.4..2.5).contains(&ratio), "{ratio}");
        // Six components, forty repetitions: the root mean square is known to about 1/√(2·6·40) = 5 %, three times that.
        let ratio = (bias.trace() / bias_observed).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
        let ratio = (shape_predicted / shape_observed).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
    }
}
