//! What the sensor keeps across resets: what is taken up when it starts, what is asked of the memory, and what came of it.

use core::ops::DerefMut;

use embedded_hal::spi::SpiDevice;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::wire::{KeptCalibration, MemoryRequest, Rejection, Response, StreamKind};

use super::{LoadedCalibration, Sensor};
use crate::adc::AdcSettings;
use crate::storage::items::{Settings, StoredCalibration};
use crate::storage::job::{StoreJob, Stored};
use crate::storage::memory::{Kept, StorageError};

impl<Spi, Store, const GAGES: usize, const HIGHER: usize> Sensor<Spi, Store, GAGES, HIGHER>
where
    Spi: SpiDevice<u8>,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Takes up what was kept across the reset: to be called once, as soon as the memory is read. A calibration is used at the gain
    /// that it was made at, unless settings were kept that say otherwise.
    pub fn restore(&mut self, kept: Result<Kept, StorageError>) {
        let Ok(kept) = kept else {
            self.kept.current = KeptCalibration::Unreadable;
            return;
        };
        let mut settings = kept.settings;
        if let Some(StoredCalibration { gain, .. }) = kept.calibration {
            let data_rate = self.acquisition.settings().data_rate;
            settings = settings.or(Some(Settings { data_rate, gain }));
        }
        // Why it cannot be used, the status says.
        let _ = self.take_up(kept, true);
        if let Some(Settings { data_rate, gain }) = settings {
            self.acquisition.configure(data_rate, gain);
            self.health.relearn(data_rate);
        }
    }

    /// What a request asks of the memory. Nothing is asked of it while samples are streamed or summed up; see
    /// [`crate::storage::job`].
    pub(super) fn store_job(&mut self, request: MemoryRequest) -> Result<StoreJob, Rejection> {
        self.require_nothing_stored(true)?;
        if self.stream != StreamKind::Off || self.trial.require_idle().is_err() {
            return Err(Rejection::Measuring);
        }
        let job = match request {
            MemoryRequest::StoreCalibration => {
                let LoadedCalibration { upload, gain, .. } =
                    self.calibration.as_ref().ok_or(Rejection::Uncalibrated)?;
                StoreJob::Calibration(StoredCalibration { upload: upload.clone(), gain: *gain })
            }
            MemoryRequest::RollBack { to } => StoreJob::RollBack(to),
            MemoryRequest::StoreSettings => {
                let &AdcSettings { data_rate, gain, .. } = self.acquisition.settings();
                StoreJob::Settings(Settings { data_rate, gain })
            }
            MemoryRequest::WriteName(name) => StoreJob::Name(name),
        };
        self.storing = true;
        Ok(job)
    }

    /// Takes up what came of a [`StoreJob`], and says what to answer.
    pub fn finish_storing(&mut self, stored: Stored) -> Response {
        self.storing = false;
        match stored.kept.map(|kept| self.take_up(kept, stored.is_rollback)) {
            Err(error) => Response::Rejected(error.into()),
            Ok(Err(rejection)) => Response::Rejected(rejection),
            Ok(Ok(())) if stored.is_rollback => self.calibration_response(),
            Ok(Ok(())) => Response::Done,
        }
    }

    /// Notes what is kept; and uses it, if so wanted.
    fn take_up(&mut self, kept: Kept, use_it: bool) -> Result<(), Rejection> {
        let Kept { calibration, calibrations, identity, .. } = kept;
        self.kept = calibrations;
        self.identity = identity;
        let Some(StoredCalibration { upload, gain }) = calibration else { return Ok(()) };
        let loaded = LoadedCalibration::new(upload, gain);
        if loaded.is_err() {
            self.kept.current = KeptCalibration::Unusable;
        }
        if use_it {
            self.use_calibration(loaded?);
        }
        Ok(())
    }

    /// Nothing that the memory could hold up is started while it is at work.
    pub(super) const fn require_nothing_stored(&self, starts: bool) -> Result<(), Rejection> {
        if starts && self.storing { Err(Rejection::Storing) } else { Ok(()) }
    }
}
