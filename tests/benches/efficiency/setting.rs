//! What is measured: a sensor of given roundness and noise, and a truth to compare with.

use ftcal_shared::estimation::shape::TrialSolution;
use ftcal_shared::units::MAX_RANK;
use ftcal_tests::KnownSensor;
use nalgebra::{DMatrix, SMatrix, SVector};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// RMS signal of a gage over all directions of the load, counts: an ADS131M08 at a third of its range leaves rounding to
/// whole codes far below the least noise measured here.
pub(crate) const SIGNAL_COUNTS: f64 = 300_000.0;

/// Shape condition and noise of one row of the table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Setting {
    /// The largest singular value of S over the smallest; those between are spaced geometrically.
    pub(crate) condition: f64,
    /// Standard deviation of one channel's noise, relative to the RMS signal of a gage.
    pub(crate) relative_noise: f64,
    /// Samples of the trial, directions uniform over the circle or sphere.
    pub(crate) samples: usize,
}

impl Setting {
    /// A random sensor of this setting. The rows of its shape are orthogonal, longest first.
    pub(crate) fn sensor<const GAGES: usize, const RANK: usize>(
        &self,
        rng: &mut ChaCha8Rng,
    ) -> KnownSensor<GAGES, RANK> {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let gaussian = DMatrix::from_fn(GAGES, RANK, |_, _| normal());
        let orthonormal = gaussian.qr().q();
        let shape = SMatrix::<f64, RANK, GAGES>::from_fn(|row, gage| {
            let fraction = row as f64 / (RANK - 1) as f64;
            self.condition.powf(-fraction) * orthonormal[(gage, row)]
        });
        // ⟨mmᵀ⟩ = I/r makes the mean square signal of a gage |S|²/(r·p).
        let rms = shape.norm() / ((RANK * GAGES) as f64).sqrt();
        KnownSensor {
            shape: shape * (SIGNAL_COUNTS / rms),
            bias: SVector::from_fn(|_, _| SIGNAL_COUNTS / 3.0 * normal()),
            noise: self.relative_noise * SIGNAL_COUNTS,
        }
    }
}

/// An answer beside the truth, in the orientation of the truth.
#[derive(Clone, Debug)]
pub(crate) struct Comparison<const GAGES: usize, const RANK: usize> {
    /// R Ŝ − S, R by orthogonal Procrustes, counts per load.
    pub(crate) shape_error: SMatrix<f64, RANK, GAGES>,
    /// The standard deviations that the answer predicts for it.
    pub(crate) shape_deviation: SMatrix<f64, RANK, GAGES>,
    /// b̂ − b, counts.
    pub(crate) bias_error: SVector<f64, GAGES>,
    /// The standard deviations that the answer predicts for it.
    pub(crate) bias_deviation: SVector<f64, GAGES>,
}

impl<const GAGES: usize, const RANK: usize> Comparison<GAGES, RANK> {
    /// Turns the answer to where it fits the truth best.
    pub(crate) fn new(truth: &KnownSensor<GAGES, RANK>, answer: &TrialSolution<GAGES>) -> Self {
        let padded_shape = &answer.shape_counts_per_load;
        let shape = padded_shape.fixed_rows::<RANK>(0).into_owned();
        let turn = procrustes(&truth.shape, &shape);
        let mut padded_turn = SMatrix::<f64, MAX_RANK, MAX_RANK>::zeros();
        padded_turn.fixed_view_mut::<RANK, RANK>(0, 0).copy_from(&turn);
        let (uncertainty, redundant_noise) = (&answer.uncertainty, &answer.redundant_noise);
        let deviation = uncertainty.turned_shape_deviation(padded_shape, redundant_noise, &padded_turn);
        Self {
            shape_error: turn * shape - truth.shape,
            shape_deviation: deviation.fixed_rows::<RANK>(0).into_owned(),
            bias_error: answer.bias_counts - truth.bias,
            bias_deviation: uncertainty.bias_deviation(padded_shape, redundant_noise),
        }
    }

    /// Every error with its predicted standard deviation: S column by column, then b.
    pub(crate) fn errors(&self) -> impl Iterator<Item = (f64, f64)> {
        let errors = self.shape_error.iter().chain(&self.bias_error).copied();
        errors.zip(self.shape_deviation.iter().chain(&self.bias_deviation).copied())
    }
}

/// The orthogonal matrix R, mirror images included, that makes |R·from − to| least.
pub(crate) fn procrustes<const GAGES: usize, const RANK: usize>(
    to: &SMatrix<f64, RANK, GAGES>,
    from: &SMatrix<f64, RANK, GAGES>,
) -> SMatrix<f64, RANK, RANK> {
    let product = DMatrix::from_fn(RANK, RANK, |a, b| to.row(a).dot(&from.row(b)));
    let decomposition = product.svd(true, true);
    let (Some(left), Some(right)) = (decomposition.u, decomposition.v_t) else {
        return SMatrix::identity();
    };
    let turn = left * right;
    SMatrix::from_fn(|a, b| turn[(a, b)])
}
