//! A linear multi-gage sensor with a known truth (paper, eq. 4 and 6; design § 1).
//!
//! Counts are z = b + S̃ᵀ m̃ + e: `p` gages, a wrench m̃ of the sensor's degrees of freedom in newton and newton metre,
//! the true shape S̃ (m × p, counts per newton and per newton metre, rows in the order of `Dof::axes`), the bias b
//! and independent Gaussian noise e of a standard deviation of its own for each gage. Counts are those of the converter
//! at its highest gain, [`COUNT_GAIN`]; [`volts_of_counts`] turns them into the bridge voltage that the converter sees,
//! so that the model of the converter, not the sensor, decides on gain, rounding and saturation.

use ftcal_shared::units::{Axis, Dof, Gain};
use nalgebra::{DMatrix, DVector, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

use super::ads131m08::{CHANNELS, REFERENCE_VOLTS};

/// The gain at which the sensor's counts are counts of the converter.
pub const COUNT_GAIN: Gain = Gain::X128;

/// Counts from zero to the converter's full scale.
pub const FULL_SCALE_COUNTS: f64 = 8_388_608.0;

/// The bridge voltage of this many counts.
pub fn volts_of_counts(counts: f64) -> f64 {
    counts * (REFERENCE_VOLTS / f64::from(COUNT_GAIN.factor()) / FULL_SCALE_COUNTS)
}

/// Force and torque on the sensor, in the sensor frame, the torque about its origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, newton.
    pub force_newton: Vector3<f64>,
    /// Torque, newton metre.
    pub torque_newton_metre: Vector3<f64>,
}

impl Wrench {
    /// A force that acts at the end of a moment arm: torque = arm × force (paper, eq. 14 and 19).
    pub fn of_force_at(force_newton: Vector3<f64>, arm_m: &Vector3<f64>) -> Self {
        Self { force_newton, torque_newton_metre: arm_m.cross(&force_newton) }
    }

    /// One component.
    pub fn component(&self, axis: Axis) -> f64 {
        match axis {
            Axis::ForceX => self.force_newton.x,
            Axis::ForceY => self.force_newton.y,
            Axis::ForceZ => self.force_newton.z,
            Axis::TorqueX => self.torque_newton_metre.x,
            Axis::TorqueY => self.torque_newton_metre.y,
            Axis::TorqueZ => self.torque_newton_metre.z,
        }
    }

    /// The components that a sensor of these degrees of freedom feels, in the order of `Dof::axes`.
    pub fn components(&self, dof: Dof) -> DVector<f64> {
        DVector::from_iterator(dof.count(), dof.axes().iter().map(|&axis| self.component(axis)))
    }
}

/// Why a software sensor cannot be built.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SensorError {
    /// The shape's rows are not the degrees of freedom.
    #[error("the shape has {found} rows, and the sensor {expected} degrees of freedom")]
    Rows {
        /// Rows that the degrees of freedom ask for.
        expected: usize,
        /// Rows of the shape.
        found: usize,
    },
    /// More gages than the converter has channels, or none.
    #[error("{found} gages do not fit one converter of {CHANNELS} channels")]
    Gages {
        /// Columns of the shape.
        found: usize,
    },
    /// The bias or the noise is not given for exactly one value a gage.
    #[error("bias and noise need one value for each of the {gages} gages")]
    PerGage {
        /// Columns of the shape.
        gages: usize,
    },
}

/// A sensor whose truth is known.
#[derive(Clone, Debug, PartialEq)]
pub struct SoftwareSensor {
    dof: Dof,
    shape: DMatrix<f64>,
    bias_counts: DVector<f64>,
    noise_counts: DVector<f64>,
}

impl SoftwareSensor {
    /// A sensor of this shape (m × p, counts per newton and per newton metre), bias and noise (p each, counts).
    ///
    /// # Errors
    /// When the sizes do not fit each other or the converter.
    pub fn new(
        dof: Dof,
        shape: DMatrix<f64>,
        bias_counts: DVector<f64>,
        noise_counts: DVector<f64>,
    ) -> Result<Self, SensorError> {
        let gages = shape.ncols();
        if shape.nrows() != dof.count() {
            return Err(SensorError::Rows { expected: dof.count(), found: shape.nrows() });
        }
        if gages == 0 || gages > CHANNELS {
            return Err(SensorError::Gages { found: gages });
        }
        if bias_counts.len() != gages || noise_counts.len() != gages {
            return Err(SensorError::PerGage { gages });
        }
        Ok(Self { dof, shape, bias_counts, noise_counts })
    }

    /// The degrees of freedom.
    pub const fn dof(&self) -> Dof {
        self.dof
    }

    /// The number of gages, p: the converter's channels 0 to p − 1.
    pub fn gages(&self) -> usize {
        self.shape.ncols()
    }

    /// The true shape, m × p, counts per newton and per newton metre.
    pub const fn shape(&self) -> &DMatrix<f64> {
        &self.shape
    }

    /// The true bias, counts.
    pub const fn bias_counts(&self) -> &DVector<f64> {
        &self.bias_counts
    }

    /// The standard deviation of each gage's noise, counts.
    pub const fn noise_counts(&self) -> &DVector<f64> {
        &self.noise_counts
    }

    /// What the gages would read under this wrench if they had no noise, counts.
    pub fn noiseless_counts(&self, wrench: &Wrench) -> DVector<f64> {
        self.shape.tr_mul(&wrench.components(self.dof)) + &self.bias_counts
    }

    /// What the gages read, counts: the noise comes from the given sequence.
    pub(super) fn read(&self, wrench: &Wrench, noise: &mut ChaCha8Rng) -> DVector<f64> {
        let mut counts = self.noiseless_counts(wrench);
        for (count, deviation) in counts.iter_mut().zip(self.noise_counts.iter()) {
            let draw: f64 = StandardNormal.sample(noise);
            *count += deviation * draw;
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::{DMatrix, DVector, Vector3};

    use super::{SensorError, SoftwareSensor, Wrench};
    use crate::simulator::{Purpose, random_sequence};

    fn sensor() -> SoftwareSensor {
        let shape = DMatrix::from_row_slice(2, 3, &[100.0, 0.0, 50.0, 0.0, 100.0, -50.0]);
        let bias = DVector::from_vec(vec![10.0, 20.0, 30.0]);
        let noise = DVector::from_vec(vec![1.0, 2.0, 3.0]);
        SoftwareSensor::new(Dof::PlanarForce, shape, bias, noise).expect("sizes fit")
    }

    #[test]
    fn the_response_is_linear_about_the_bias() {
        let sensor = sensor();
        let wrench = |x, y| Wrench { force_newton: Vector3::new(x, y, 9.0), ..Wrench::default() };
        let of = |x, y| sensor.noiseless_counts(&wrench(x, y)) - sensor.bias_counts();
        assert_eq!(of(0.0, 0.0), DVector::zeros(3));
        assert!((of(2.0, -3.0) - (of(1.0, 0.0) * 2.0 - of(0.0, 1.0) * 3.0)).norm() < 1e-9);
    }

    #[test]
    fn noise_has_the_stated_deviation_on_each_gage_and_no_mean() {
        let sensor = sensor();
        let mut noise = random_sequence(3, Purpose::Noise);
        let n = 20_000;
        let mut sum = DVector::zeros(3);
        let mut squares = DVector::zeros(3);
        for _ in 0..n {
            let error = sensor.read(&Wrench::default(), &mut noise) - sensor.bias_counts();
            squares += error.component_mul(&error);
            sum += error;
        }
        for gage in 0..3 {
            let deviation = sensor.noise_counts()[gage];
            // Five standard errors: σ/√n for the mean, √2·σ² / √n for the mean square.
            let n = f64::from(n);
            assert!((sum[gage] / n).abs() < 5.0 * deviation / n.sqrt());
            let variance = deviation * deviation;
            assert!((squares[gage] / n - variance).abs() < 5.0 * 2.0_f64.sqrt() * variance / n.sqrt());
        }
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        let build = |rows, gages, bias| {
            let shape = DMatrix::zeros(rows, gages);
            SoftwareSensor::new(Dof::PlanarForce, shape, DVector::zeros(bias), DVector::zeros(gages))
        };
        assert_eq!(build(3, 4, 4), Err(SensorError::Rows { expected: 2, found: 3 }));
        assert_eq!(build(2, 9, 9), Err(SensorError::Gages { found: 9 }));
        assert_eq!(build(2, 0, 0), Err(SensorError::Gages { found: 0 }));
        assert_eq!(build(2, 4, 5), Err(SensorError::PerGage { gages: 4 }));
    }
}
