//! The samples of a trial, and the ellipsoid that they are fitted by.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::Direction;
use super::constraint::Answer;
use super::weight::ConstraintNoise;
use crate::calibration::singular::Singular;
use crate::recording::Recording;

/// Codes of the samples that take part, in counts.
#[derive(Clone, Debug)]
pub(super) struct Samples {
    /// One column of p counts a sample.
    pub(super) counts: DMatrix<f64>,
    /// Where each stands in the recording.
    pub(super) numbers: Vec<usize>,
}

impl Samples {
    /// Those that are marked.
    pub(super) fn of(recording: &Recording, taken: &[bool]) -> Self {
        let marked = recording.samples().zip(taken).enumerate().filter(|(_, (_, taken))| **taken);
        let (numbers, columns): (Vec<_>, Vec<_>) =
            marked.map(|(number, ((_, codes), _))| (number, recording.counts(codes))).unzip();
        let mut counts = DMatrix::zeros(recording.gages(), columns.len());
        for (mut into, column) in counts.column_iter_mut().zip(&columns) {
            into.copy_from(column);
        }
        Self { counts, numbers }
    }

    /// How many.
    pub(super) const fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Those for which `keep` holds, one truth a sample.
    pub(super) fn only(&self, keep: &[bool]) -> Self {
        let kept: Vec<usize> = (0..self.len()).filter(|&sample| keep[sample]).collect();
        Self {
            counts: self.counts.select_columns(&kept),
            numbers: kept.iter().map(|&sample| self.numbers[sample]).collect(),
        }
    }
}

/// Shape, bias and noise; the rows of the shape are orthogonal, longest first.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    /// S (r × p), counts per unit load.
    pub(super) shape: DMatrix<f64>,
    /// b (p), counts.
    pub(super) bias: DVector<f64>,
    /// Variance of one channel's noise, counts².
    pub(super) noise_variance: f64,
}

impl Fit {
    /// The same ellipsoid whatever the orientation of the shape.
    pub(super) fn new(shape: &DMatrix<f64>, bias: DVector<f64>, noise_variance: f64) -> Self {
        let singular = Singular::of(shape);
        let shape = DMatrix::from_diagonal(&singular.values) * singular.right.transpose();
        Self { shape, bias, noise_variance }
    }

    /// r.
    pub(super) fn rank(&self) -> usize {
        self.shape.nrows()
    }

    /// The diagonal of SSᵀ.
    pub(super) fn gains_squared(&self) -> DVector<f64> {
        DVector::from_iterator(self.rank(), self.shape.row_iter().map(|row| row.norm_squared()))
    }

    /// The variances of the components of a direction; zero beyond the rank.
    pub(super) fn direction_variances(&self) -> Direction {
        let gains = self.gains_squared();
        std::array::from_fn(|a| gains.get(a).map_or(0.0, |gain| self.noise_variance / gain))
    }

    /// x = (SSᵀ)⁻¹S(z − b) of every sample; components beyond the rank are zero.
    pub(super) fn directions(&self, samples: &Samples) -> Vec<Direction> {
        let gains = self.gains_squared();
        let mut matrix = self.shape.clone();
        for (mut row, gain) in matrix.row_iter_mut().zip(&gains) {
            row /= *gain;
        }
        let zero = &matrix * &self.bias;
        let directions = &matrix * &samples.counts;
        let columns = directions.column_iter();
        columns
            .map(|column| std::array::from_fn(|a| column.get(a).map_or(0.0, |component| component - zero[a])))
            .collect()
    }

    /// The fit freed of this share of its errors, found: mᵀ(I − E)m − hᵀm = 1 made an ellipsoid about its centre. `None` where
    /// it is none.
    pub(super) fn corrected(&self, answer: &Answer, share: f64) -> Option<Self> {
        let (error, linear) = answer.errors();
        let quadratic = DMatrix::identity(self.rank(), self.rank()) - error * share;
        let centre = Cholesky::new(quadratic.clone())?.solve(&linear) * (share / 2.0);
        // mᵀQm − hᵀm = 1 about its centre: (m − c)ᵀQ(m − c) = 1 + cᵀQc.
        let level = 1.0 + centre.dot(&(&quadratic * &centre));
        let factor = Cholesky::new(quadratic / level)?;
        let shape = factor.l().solve_lower_triangular(&self.shape)?;
        let bias = &self.bias + self.shape.tr_mul(&centre);
        let corrected = Self::new(&shape, bias, self.noise_variance);
        corrected.shape.iter().chain(&corrected.bias).all(|number| number.is_finite()).then_some(corrected)
    }
}

/// Directions made unit vectors.
pub(super) fn unit(directions: &[Direction]) -> Vec<Direction> {
    let unit = |m: &Direction| {
        let length = squared_length(m).sqrt().max(f64::MIN_POSITIVE);
        m.map(|component| component / length)
    };
    directions.iter().map(unit).collect()
}

/// What is wrong with the length of each direction: |x|² − 1, less what the noise adds to it on average.
pub(super) fn magnitude_errors(directions: &[Direction], variances: &Direction) -> Vec<f64> {
    let expected = 1.0 + variances.iter().sum::<f64>();
    directions.iter().map(|m| squared_length(m) - expected).collect()
}

/// The noise of the constraint, its unexplained part from these samples.
pub(super) fn constraint_noise(
    directions: &[Direction],
    units: &[Direction],
    variances: Direction,
) -> ConstraintNoise {
    let explained = ConstraintNoise { variances, unexplained: 0.0 };
    let count = directions.len().max(1) as f64;
    let errors = magnitude_errors(directions, &variances);
    let observed = errors.iter().map(|error| error * error).sum::<f64>() / count;
    let expected = units.iter().map(|m| explained.at(m)).sum::<f64>() / count;
    ConstraintNoise { unexplained: (observed - expected).max(0.0), ..explained }
}

fn squared_length(m: &Direction) -> f64 {
    m.iter().map(|component| component * component).sum()
}
