//! The Cramér–Rao bound of one trial: no unbiased estimator has less error than this (design § 3).
//!
//! Parameters are S (r·p) and b (p); the direction of every sample is a nuisance that lives on the sphere. A sample moves
//! with its direction along T = Sᵀ·(tangents at m), so what it says of the parameters is what is left across T:
//!
//! ```text
//! information = Σ [m; 1][m; 1]ᵀ ⊗ P / σ²,   P = I − T(TᵀT)⁻¹Tᵀ
//! ```
//!
//! Turning S and all directions together changes nothing, so r(r − 1)/2 eigenvalues are zero; the bound of the rest is the
//! pseudo-inverse without them.

use ftcal_shared::estimation::rest_noise::QUANTISATION_VARIANCE;
use ftcal_tests::KnownSensor;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Sums up what samples say, one by one.
#[derive(Clone, Debug)]
pub(crate) struct Information<const GAGES: usize, const RANK: usize> {
    shape: SMatrix<f64, RANK, GAGES>,
    noise_variance: f64,
    sum: DMatrix<f64>,
}

impl<const GAGES: usize, const RANK: usize> Information<GAGES, RANK> {
    /// Nothing yet.
    pub(crate) fn new(sensor: &KnownSensor<GAGES, RANK>) -> Self {
        let parameters = (RANK + 1) * GAGES;
        Self {
            shape: sensor.shape,
            noise_variance: sensor.noise * sensor.noise + QUANTISATION_VARIANCE,
            sum: DMatrix::zeros(parameters, parameters),
        }
    }

    /// Adds a sample whose load points in direction `m`, a unit vector.
    pub(crate) fn add(&mut self, m: &SVector<f64, RANK>) {
        self.add_across(m, &self.across(m));
    }

    /// Adds a sample whose load points in direction `m` with a magnitude that nobody knows: it may be anywhere in the span of S,
    /// and tells only what is across that.
    pub(crate) fn add_of_unknown_magnitude(&mut self, m: &SVector<f64, RANK>) {
        let rows = self.shape.row_iter().map(|row| row.transpose());
        self.add_across(m, &without(rows));
    }

    fn add_across(&mut self, m: &SVector<f64, RANK>, across: &SMatrix<f64, GAGES, GAGES>) {
        let regressor = DVector::from_fn(RANK + 1, |row, _| if row < RANK { m[row] } else { 1.0 });
        for a in 0..=RANK {
            for b in 0..=RANK {
                let weight = regressor[a] * regressor[b];
                let mut block = self.sum.view_mut((a * GAGES, b * GAGES), (GAGES, GAGES));
                block.zip_apply(across, |sum, element| *sum += weight * element);
            }
        }
    }

    /// P: the projection across the movement of the sample with its direction, the tangents eₐ − m mₐ, of which r − 1 are
    /// independent.
    fn across(&self, m: &SVector<f64, RANK>) -> SMatrix<f64, GAGES, GAGES> {
        let along_load = self.shape.transpose() * m;
        // Without the axis closest to m, whose tangent is the shortest, the others are independent.
        let skipped = m.iamax();
        let axes = (0..RANK).filter(|&axis| axis != skipped);
        without(axes.map(|axis| self.shape.row(axis).transpose() - along_load * m[axis]))
    }

    /// The least mean square error of S, counts² per load², summed over its elements.
    pub(crate) fn least_shape_error(&self) -> f64 {
        let eigen = (&self.sum / self.noise_variance).symmetric_eigen();
        let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
        order.sort_by(|&left, &right| eigen.eigenvalues[left].total_cmp(&eigen.eigenvalues[right]));
        let gauge = RANK * (RANK - 1) / 2;
        order
            .into_iter()
            .skip(gauge)
            .map(|k| eigen.eigenvectors.column(k).rows(0, RANK * GAGES).norm_squared() / eigen.eigenvalues[k])
            .sum()
    }
}

/// The projection across independent vectors, by Gram and Schmidt.
fn without<const GAGES: usize>(
    vectors: impl Iterator<Item = SVector<f64, GAGES>>,
) -> SMatrix<f64, GAGES, GAGES> {
    vectors.fold(SMatrix::identity(), |across, vector| {
        let rest = across * vector;
        across - rest * rest.transpose() / rest.norm_squared()
    })
}
