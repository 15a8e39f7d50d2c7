//! Why a calibrated sensor fails its check in the field, in words.

use super::Explained;

/// Explains why a calibration fails its field check.
pub fn verification_failed(measured_n: f64, expected_n: f64, deviation_n: f64) -> Explained {
    Explained::new(
        "verification-failed",
        format!(
            "the sensor measures {measured_n:.4} N where {expected_n:.4} N hang on it: {:.1} times the predicted standard \
             deviation",
            (measured_n - expected_n).abs() / deviation_n
        ),
        "Check the mass (all that hangs on the sensor) and that it hung at rest; if they are right, calibrate anew.",
    )
}

/// Explains which gage fails the field check.
pub fn gage_suspect(gage: usize, deviations: f64) -> Explained {
    Explained::new(
        "gage-suspect",
        format!(
            "the gages contradict each other; ch{gage} is farthest off, by {deviations:.1} standard deviations"
        ),
        "Check the wiring of that gage; if it is sound, or the temperature has changed, calibrate anew.",
    )
}
