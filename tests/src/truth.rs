//! What a simulated sensor would be told if everything were known of it.

use ftcal::simulator::sensor::SoftwareSensor;
use ftcal_shared::units::Gain;
use ftcal_shared::wire::{CalibrationUpload, GageList};
use nalgebra::DMatrix;

/// The least squares of the true shape (m × p), newton and newton metre per count. From the definition, and not from the product's own
/// function for it.
///
/// # Panics
///
/// Where a degree of freedom is not felt.
pub fn true_matrix(sensor: &SoftwareSensor) -> DMatrix<f64> {
    let shape = sensor.shape();
    (shape * shape.transpose()).try_inverse().expect("of full rank") * shape
}

/// The sensor's true calibration, as the sensor takes it.
///
/// # Panics
///
/// As [`true_matrix`].
pub fn true_calibration(sensor: &SoftwareSensor) -> CalibrationUpload {
    // Row by row; nalgebra stores column by column.
    let elements = true_matrix(sensor).transpose();
    #[expect(clippy::cast_possible_truncation, reason = "this is the form in which it travels")]
    let matrix = elements.iter().map(|&element| element as f32).collect();
    let bias_counts = GageList::from_slice(sensor.bias_counts().as_slice()).expect("at most twelve");
    let mut upload =
        CalibrationUpload { dof: sensor.dof(), gain: Gain::X128, bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// What a calibration makes of loads of a sensor, beyond a common factor: C Sᵀ over its mean gain, less the identity; of three forces.
pub fn shape_error(calibration: &CalibrationUpload, sensor: &SoftwareSensor) -> f64 {
    let gages = sensor.gages();
    let matrix = DMatrix::from_fn(3, gages, |row, gage| f64::from(calibration.matrix[row * gages + gage]));
    let product = matrix * sensor.shape().transpose();
    let mean = product.trace() / 3.0;
    (product / mean - DMatrix::identity(3, 3)).norm()
}
