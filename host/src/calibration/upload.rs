//! A calibration in the form that the sensor takes.

use ftcal_shared::units::MAX_GAGES;
use ftcal_shared::wire::{CalibrationUpload, GageList};

use super::Calibration;

/// Why a calibration does not fit the sensor's form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UploadError {
    /// Nobody says at which gain the calibration was made.
    #[error(
        "field `gain`: expected the converter's gain that the calibration was made at, found nothing; if you know it, add \
         `--gain N`, else calibrate again from recordings that say theirs, as those of `ftcal record` do"
    )]
    GainUnknown,
    /// An element of the matrix is beyond single precision.
    #[error("an element of the calibration matrix is too large for the sensor's single precision")]
    OutOfRange,
    /// More gages than a sensor has.
    #[error("the calibration is for {gages} gages; a sensor has {MAX_GAGES} at most")]
    TooManyGages {
        /// The calibration's gages.
        gages: usize,
    },
}

impl Calibration {
    /// The calibration as the sensor takes it: the matrix rounded to single precision (2⁻²⁴ of each element, far below
    /// any sensor's accuracy), the bias in full.
    ///
    /// # Errors
    ///
    /// [`UploadError`].
    pub fn upload(&self) -> Result<CalibrationUpload, UploadError> {
        let gain = self.gain.ok_or(UploadError::GainUnknown)?;
        let too_many = UploadError::TooManyGages { gages: self.gages() };
        let mut matrix = heapless::Vec::new();
        for row in self.matrix.row_iter() {
            for element in row.iter() {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "rounding is what is wanted; the range is checked"
                )]
                let rounded = *element as f32;
                if !rounded.is_finite() {
                    return Err(UploadError::OutOfRange);
                }
                matrix.push(rounded).map_err(|_| too_many)?;
            }
        }
        let bias_counts = GageList::from_slice(self.bias_counts.as_slice()).map_err(|_| too_many)?;
        let mut upload = CalibrationUpload { dof: self.dof, gain, bias_counts, matrix, identity: 0 };
        upload.identity = upload.identity_of_numbers();
        Ok(upload)
    }
}
