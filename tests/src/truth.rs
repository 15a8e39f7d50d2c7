//! What a simulated sensor would be told if everything were known of it.

use ftcal::simulator::sensor::SoftwareSensor;
use ftcal_shared::units::Gain;
use ftcal_shared::wire::{CalibrationUpload, GageList};
use nalgebra::DMatrix;

/// The least squares of the true shape (m × p), newton and newton metre per count.
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
