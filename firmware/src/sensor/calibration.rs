//! The calibration in use: taken up, and applied to every sample.

use core::ops::DerefMut;

use ftcal_shared::estimation::application::{RealTimeCalibration, UnusableCalibration};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::parity::ParitySpace;
use ftcal_shared::units::AdcCode;
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, InvalidCause, PackedWrenches, Rejection, Response,
};

use super::Sensor;
use crate::acquisition::Sample;
use crate::storage::items::StoredCalibration;
use crate::stream::Measurement;

/// A calibration as it came, and in the form that the sample path applies.
pub(super) struct LoadedCalibration<const GAGES: usize> {
    pub(super) upload: CalibrationUpload,
    pub(super) origin: CalibrationOrigin,
    /// Of all gages, or of all but one.
    pub(super) real_time: RealTimeCalibration<GAGES>,
}

impl<const GAGES: usize> LoadedCalibration<GAGES> {
    pub(super) fn new(stored: StoredCalibration) -> Result<Self, Rejection> {
        let StoredCalibration { upload, origin } = stored;
        if upload.identity != upload.identity_of_numbers() {
            return Err(Rejection::WrongIdentity);
        }
        let real_time = prepared(&upload)?;
        Ok(Self { upload, origin, real_time })
    }

    pub(super) fn to_be_stored(&self) -> StoredCalibration {
        StoredCalibration { upload: self.upload.clone(), origin: self.origin }
    }
}

impl<Store, const GAGES: usize, const HIGHER: usize> Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Every sample is measured, streamed or not: health is to be known all the time. Of its channels these are `saturated`.
    pub(super) fn measure(&mut self, sample: &Sample<GAGES>, saturated: u16) -> Measurement {
        let gain = self.converter.settings().gain;
        let (usable, axes, identity) = match &self.calibration {
            None => (Err(InvalidCause::Uncalibrated), 0, 0),
            Some(loaded) if loaded.upload.gain != gain => (Err(InvalidCause::GainChanged), 0, 0),
            Some(loaded) => (Ok(&loaded.real_time), loaded.upload.dof.count(), loaded.upload.identity),
        };
        match self.health.measure(usable, saturated, sample) {
            Err(cause) => Measurement::Invalid(cause),
            Ok(()) if !PackedWrenches::can_hold(self.health.wrench()) => {
                Measurement::Invalid(InvalidCause::NonFinite)
            }
            #[expect(clippy::cast_possible_truncation, reason = "at most six axes")]
            Ok(()) => {
                Measurement::Valid { wrench: *self.health.wrench(), axes: axes as u8, calibration: identity }
            }
        }
    }

    /// Takes a calibration into use, of whatever gain: while the converter has another one, there is no wrench. The calibration before
    /// stays in use where the new one is refused.
    #[inline(never)]
    pub(super) fn load(&mut self, upload: CalibrationUpload) -> Result<(), Rejection> {
        if self.calibration.as_ref().is_some_and(|loaded| loaded.upload == upload) {
            // Once more, because the answer was lost: tare and noise are of this very calibration.
            return Ok(());
        }
        let uploaded = StoredCalibration { upload, origin: CalibrationOrigin::Uploaded };
        LoadedCalibration::new(uploaded).map(|loaded| self.use_calibration(loaded))
    }

    pub(super) fn use_calibration(&mut self, loaded: LoadedCalibration<GAGES>) {
        let data_rate = self.converter.settings().data_rate;
        self.health.watch(ParitySpace::new(&loaded.real_time.matrix()), None, data_rate);
        self.health.start_anew(loaded.upload.identity, loaded.upload.dof);
        self.calibration = Some(loaded);
    }

    pub(super) fn calibration_response(&self) -> Response {
        Response::Calibration(self.calibration.as_ref().map(|calibration| calibration.upload.clone()))
    }
}

/// A calibration in the form that the sample path applies.
pub(super) fn prepared<const GAGES: usize>(
    upload: &CalibrationUpload,
) -> Result<RealTimeCalibration<GAGES>, Rejection> {
    RealTimeCalibration::new(upload.dof, &upload.matrix, &upload.bias_counts).map_err(|unusable| {
        match unusable {
            UnusableCalibration::WrongDimensions => Rejection::WrongDimensions,
            UnusableCalibration::NonFinite | UnusableCalibration::BiasOutOfRange => {
                Rejection::UnusableNumbers
            }
        }
    })
}

/// Which channels stand at an end of their range: bit k for gage k.
pub(super) fn saturated_channels<const GAGES: usize>(codes: &[AdcCode; GAGES]) -> u16 {
    // Rarely is any.
    if !AdcCode::any_is_saturated(codes) {
        return 0;
    }
    codes.iter().enumerate().fold(0, |mask, (gage, code)| mask | (u16::from(code.is_saturated()) << gage))
}
