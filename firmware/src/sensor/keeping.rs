//! What the sensor keeps across resets: what is taken up when it starts, what is asked of the memory, and what came of it.

use core::ops::DerefMut;

use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::{KeptCalibration, MemoryRequest, Rejection, Response, StreamKind};

use super::Sensor;
use super::calibration::LoadedCalibration;
use crate::adc::AdcSettings;
use crate::storage::items::{Settings, StoredCalibration};
use crate::storage::job::{StoreJob, Stored};
use crate::storage::keeper::Found;
use crate::storage::memory::{Kept, StorageError};

/// Between two stores that nobody has asked for.
const HOUSEKEEPING_MICROS: u64 = 10_000_000;

impl<Store, const GAGES: usize, const HIGHER: usize> Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Takes up what was found after the reset: to be called once, as soon as the memory is read. The converter is set for the trial
    /// that goes on; else as was kept; else to the gain that the calibration was made at.
    #[inline(never)]
    pub fn restore(&mut self, found: Found) {
        self.awaits_memory = false;
        let mut settings = found.trial;
        let Ok(kept) = found.kept else {
            self.kept.current = KeptCalibration::Unreadable;
            self.configure(settings);
            return;
        };
        settings = settings.or(kept.settings);
        if let Some(StoredCalibration { upload, .. }) = &kept.calibration {
            let data_rate = self.converter.settings().data_rate;
            settings = settings.or(Some(Settings { data_rate, gain: upload.gain }));
        }
        self.configure(settings);
        let (health, is_incomplete) = (kept.health, kept.is_incomplete);
        self.memory_failed = is_incomplete;
        // Why it cannot be used, the status says.
        let _ = self.take_up(kept, true);
        // A tare is of a calibration, so it comes last.
        if let Some(health) = health {
            self.health.restore(health);
        }
    }

    fn configure(&mut self, settings: Option<Settings>) {
        if let Some(Settings { data_rate, gain }) = settings {
            self.converter.configure(data_rate, gain);
            self.health.relearn(data_rate);
        }
    }

    /// A trial starts when there is room for its checkpoints. While samples are streamed, nothing is erased for them: the trial has none
    /// then.
    pub(super) fn prepare_trial(&mut self, rank: u8) -> Result<StoreJob, Rejection> {
        self.require_nothing_stored(true)?;
        self.require_no_self_test()?;
        self.trial.may_start(rank)?;
        self.storing = true;
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let gages = GAGES as u8;
        Ok(StoreJob::PrepareTrial { rank, gages, may_erase: self.stream == StreamKind::Off })
    }

    /// What a request asks of the memory. Nothing is asked of it while samples are streamed or summed up; see
    /// [`crate::storage::job`].
    #[inline(never)]
    pub(super) fn store_job(&mut self, request: MemoryRequest) -> Result<StoreJob, Rejection> {
        self.require_nothing_stored(true)?;
        self.require_no_self_test()?;
        if self.stream != StreamKind::Off || self.trial.require_idle().is_err() {
            return Err(Rejection::Measuring);
        }
        let job = match request {
            MemoryRequest::StoreCalibration => {
                let loaded = self.calibration.as_ref().ok_or(Rejection::Uncalibrated)?;
                StoreJob::Calibration(loaded.to_be_stored())
            }
            MemoryRequest::RollBack { to } => StoreJob::RollBack(to),
            MemoryRequest::StoreSettings => StoreJob::Settings(self.settings(), *self.health.kept()),
            MemoryRequest::WriteName(name) => StoreJob::Name(name),
        };
        self.storing = true;
        Ok(job)
    }

    /// What is to be stored now without anybody asking for it, if anything: peaks of the load, as soon as nobody measures. Somebody may be
    /// about to, so there is some time between two of these.
    pub fn housekeeping(&mut self, now: DeviceTime) -> Option<StoreJob> {
        if now < self.next_housekeeping {
            return None;
        }
        let peaks = self.health.grown_peaks()?;
        let is_quiet = self.stream == StreamKind::Off
            && !(self.storing || self.awaits_memory || self.memory_failed)
            && self.require_peace().is_ok();
        if !is_quiet {
            return None;
        }
        self.next_housekeeping = DeviceTime::from_micros(now.as_micros() + HOUSEKEEPING_MICROS);
        self.storing = true;
        Some(StoreJob::Peaks(peaks))
    }

    /// Takes up what came of a [`StoreJob`], and says what to answer.
    #[inline(never)]
    pub fn finish_storing(&mut self, stored: Stored) -> Response {
        self.storing = false;
        match &stored {
            Stored::Kept(_) | Stored::Replaced(_) => self.memory_failed = false,
            Stored::Failed(StorageError::NoSuchCalibration) | Stored::Prepared { .. } => {}
            Stored::Failed(StorageError::Flash | StorageError::ReadBackDiffers | StorageError::NoRoom) => {
                self.memory_failed = true;
            }
        }
        let served = match stored {
            Stored::Kept(kept) => self.take_up(kept, false).map(|()| Response::Done),
            Stored::Replaced(kept) => self.take_up(kept, true).map(|()| self.calibration_response()),
            Stored::Prepared { rank } => self.trial.start(rank, self.settings()).map(|()| Response::Done),
            Stored::Failed(error) => Err(error.into()),
        };
        self.note_conditions();
        served.unwrap_or_else(Response::Rejected)
    }

    pub(super) fn settings(&self) -> Settings {
        let &AdcSettings { data_rate, gain, .. } = self.converter.settings();
        Settings { data_rate, gain }
    }

    /// Notes what is kept; and uses it, if so wanted.
    fn take_up(&mut self, kept: Kept, use_it: bool) -> Result<(), Rejection> {
        let Kept { calibration, calibrations, identity, peaks, .. } = kept;
        self.kept = calibrations;
        self.identity = identity;
        self.health.note_kept_peaks(peaks);
        let Some(stored) = calibration else { return Ok(()) };
        match LoadedCalibration::new(stored) {
            Ok(loaded) if use_it => self.use_calibration(loaded),
            Ok(_) => {}
            Err(rejection) => {
                self.kept.current = KeptCalibration::Unusable;
                if use_it {
                    return Err(rejection);
                }
            }
        }
        Ok(())
    }

    /// Nothing that the memory could hold up is started while it is at work.
    pub(super) const fn require_nothing_stored(&self, starts: bool) -> Result<(), Rejection> {
        if starts && self.storing { Err(Rejection::Storing) } else { Ok(()) }
    }
}
