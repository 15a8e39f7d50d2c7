//! The sensor as a whole: samples in, frames out; requests in, responses out.

use core::ops::DerefMut;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use ftcal_shared::estimation::application::{RealTimeCalibration, UnusableCalibration};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::{AdcCode, DeviceTime, Gain, SampleIndex};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, ClockSource, CodesFrame, GageList, Identity, InvalidCause, KeptCalibration,
    KeptCalibrations, MemoryRequest, PackedWrenches, Rejection, Request, Response, Status, StreamKind,
};

use crate::acquisition::{Acquisition, Sample};
use crate::adc::AdcSettings;
use crate::storage::items::{Settings, StoredCalibration};
use crate::storage::job::{StoreJob, Stored};
use crate::storage::memory::{Kept, StorageError};
use crate::stream::{Measurement, Moment, SilentMoment, WrenchMoment};
use crate::trial::{SolveJob, Trial};

/// What a request leads to.
pub enum Reaction<Store, const GAGES: usize, const HIGHER: usize> {
    /// Send this.
    Respond(Response),
    /// Compute this in the background, send the outcome ([`SolveJob::response`]), and give the job back by
    /// [`Sensor::finish_solving`].
    Solve(SolveJob<Store, GAGES, HIGHER>),
    /// Answer with the board's own [`Diagnosis`](ftcal_shared::wire::Diagnosis), which the sensor knows nothing of.
    Diagnose,
    /// Do this in the background, give the outcome to [`Sensor::finish_storing`], and send what that says.
    Store(StoreJob),
}

/// What the link knows and the sensor reports in its status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Samples of the stream that did not fit on the line.
    pub dropped_samples: u32,
    /// Frames from the host that were broken.
    pub broken_frames: u32,
}

/// Converter, trial and calibration of one sensor with `GAGES` gages.
pub struct Sensor<Spi, Store, const GAGES: usize, const HIGHER: usize> {
    acquisition: Acquisition<Spi, GAGES>,
    trial: Trial<Store, GAGES, HIGHER>,
    calibration: Option<LoadedCalibration<GAGES>>,
    kept: KeptCalibrations,
    identity: Identity,
    /// A [`StoreJob`] is out.
    storing: bool,
    stream: StreamKind,
    clock: ClockSource,
}

/// A calibration as it came, and in the form that the sample path applies.
struct LoadedCalibration<const GAGES: usize> {
    upload: CalibrationUpload,
    /// The gain that it was made at: its counts are counts at this gain.
    gain: Gain,
    real_time: RealTimeCalibration<GAGES>,
}

impl<const GAGES: usize> LoadedCalibration<GAGES> {
    fn new(upload: CalibrationUpload, gain: Gain) -> Result<Self, Rejection> {
        if upload.identity != upload.identity_of_numbers() {
            return Err(Rejection::WrongIdentity);
        }
        let real_time = RealTimeCalibration::new(upload.dof, &upload.matrix, &upload.bias_counts).map_err(
            |unusable| match unusable {
                UnusableCalibration::WrongDimensions => Rejection::WrongDimensions,
                UnusableCalibration::NonFinite | UnusableCalibration::BiasOutOfRange => {
                    Rejection::UnusableNumbers
                }
            },
        )?;
        Ok(Self { upload, gain, real_time })
    }
}

impl<Spi, Store, const GAGES: usize, const HIGHER: usize> Sensor<Spi, Store, GAGES, HIGHER>
where
    Spi: SpiDevice<u8>,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// An uncalibrated sensor whose converter the first [`Sensor::tick`] starts.
    pub fn new(spi: Spi, store: Store, clock: ClockSource) -> Self {
        Self {
            acquisition: Acquisition::new(spi),
            trial: Trial::new(store),
            calibration: None,
            kept: KeptCalibrations::default(),
            identity: Identity::default(),
            storing: false,
            stream: StreamKind::Off,
            clock,
        }
    }

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
        }
    }

    /// Watches over the converter; see [`Acquisition::tick`]. Where a wrench is being streamed and the converter is at
    /// fault, the host is told so at every tick, instead of hearing nothing.
    pub fn tick(&mut self, now: DeviceTime, delay: &mut impl DelayNs) -> Option<Moment> {
        self.acquisition.tick(now, delay);
        match self.acquisition.state() {
            AdcState::Faulty(fault) if self.stream == StreamKind::Wrench => {
                Some(Moment::Silence(SilentMoment {
                    next: self.acquisition.next_index(),
                    time: now,
                    status: 0,
                    cause: InvalidCause::Adc(fault),
                }))
            }
            AdcState::Faulty(_) | AdcState::Starting | AdcState::Running => None,
        }
    }

    /// The sample path: reads the conversion that the converter announces, takes it into the trial, and applies the
    /// calibration. Allocates nothing and waits for nothing but the bus transfer. For the two times see
    /// [`Acquisition::on_data_ready`].
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<Moment> {
        match self.acquisition.on_data_ready(now, announced)? {
            Ok(sample) => {
                self.trial.offer(sample.index, &sample.codes);
                self.moment(&sample, now)
            }
            Err(fault) => {
                let measurement = Measurement::Invalid(InvalidCause::Adc(fault));
                let index = self.acquisition.last_index();
                (self.stream == StreamKind::Wrench)
                    .then(|| self.wrench_moment(index, announced, now, measurement))
            }
        }
    }

    /// Serves one request.
    pub fn answer(
        &mut self,
        request: Request,
        now: DeviceTime,
        link: LinkCounters,
    ) -> Reaction<Store, GAGES, HIGHER> {
        let served = match request {
            Request::Status => Ok(Response::Status(self.status(now, link))),
            Request::ConfigureAdc(data_rate, gain) => self.trial.require_idle().map(|()| {
                self.acquisition.configure(data_rate, gain);
                Response::Done
            }),
            Request::Stream(kind) => self.require_nothing_stored(kind != StreamKind::Off).map(|()| {
                self.stream = kind;
                Response::Done
            }),
            Request::StartTrial { rank } => self
                .require_nothing_stored(true)
                .and_then(|()| self.trial.start(rank))
                .map(|()| Response::Done),
            Request::StopTrial => self.trial.stop().map(Response::Trial),
            Request::TrialStatus => Ok(Response::Trial(self.trial.status())),
            Request::SolveTrial => match self.trial.take_for_solving() {
                Ok(job) => return Reaction::Solve(job),
                Err(rejection) => Err(rejection),
            },
            Request::Coverage => match self.trial.take_for_coverage() {
                Ok(job) => return Reaction::Solve(job),
                Err(rejection) => Err(rejection),
            },
            Request::Diagnosis => return Reaction::Diagnose,
            Request::UploadCalibration(upload) => {
                // The one before stays in use where the new one is refused.
                LoadedCalibration::new(upload, self.acquisition.settings().gain).map(|loaded| {
                    self.calibration = Some(loaded);
                    self.calibration_response()
                })
            }
            Request::ReadCalibration => Ok(self.calibration_response()),
            Request::ReadIdentity => Ok(Response::Identity(self.identity.clone())),
            Request::Memory(request) => match self.store_job(request) {
                Ok(job) => return Reaction::Store(job),
                Err(rejection) => Err(rejection),
            },
        };
        Reaction::Respond(served.unwrap_or_else(Response::Rejected))
    }

    /// What a request asks of the memory. Nothing is asked of it while samples are streamed or summed up; see
    /// [`crate::storage::job`].
    fn store_job(&mut self, request: MemoryRequest) -> Result<StoreJob, Rejection> {
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
            self.calibration = Some(loaded?);
        }
        Ok(())
    }

    /// Nothing that the memory could hold up is started while it is at work.
    const fn require_nothing_stored(&self, starts: bool) -> Result<(), Rejection> {
        if starts && self.storing { Err(Rejection::Storing) } else { Ok(()) }
    }

    /// Takes a trial back that was solved or asked for its coverage.
    pub fn finish_solving(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.trial.finish(job);
    }

    fn moment(&self, sample: &Sample<GAGES>, now: DeviceTime) -> Option<Moment> {
        match self.stream {
            StreamKind::Off => None,
            StreamKind::Codes => Some(Moment::Codes(CodesFrame {
                index: sample.index,
                time: sample.time,
                codes: GageList::from_slice(&sample.codes).ok()?,
            })),
            StreamKind::Wrench => {
                Some(self.wrench_moment(sample.index, sample.time, now, self.measure(&sample.codes)))
            }
        }
    }

    fn wrench_moment(
        &self,
        index: SampleIndex,
        time: DeviceTime,
        announced: DeviceTime,
        measurement: Measurement,
    ) -> Moment {
        Moment::Wrench(WrenchMoment {
            index,
            stride: 1,
            time,
            announced,
            period_micros: 1_000_000 / self.acquisition.settings().data_rate.hertz(),
            status: 0,
            parity: None,
            measurement,
        })
    }

    fn measure(&self, codes: &[AdcCode; GAGES]) -> Measurement {
        let Some(calibration) = &self.calibration else {
            return Measurement::Invalid(InvalidCause::Uncalibrated);
        };
        if calibration.gain != self.acquisition.settings().gain {
            return Measurement::Invalid(InvalidCause::GainChanged);
        }
        let saturated = saturated_channels(codes);
        if saturated != 0 {
            return Measurement::Invalid(InvalidCause::Saturated(saturated));
        }
        let wrench = calibration.real_time.apply(codes);
        if !PackedWrenches::can_hold(&wrench) {
            return Measurement::Invalid(InvalidCause::NonFinite);
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most six axes")]
        let axes = calibration.upload.dof.count() as u8;
        Measurement::Valid { wrench, axes, calibration: calibration.upload.identity }
    }

    fn calibration_response(&self) -> Response {
        Response::Calibration(self.calibration.as_ref().map(|calibration| calibration.upload.clone()))
    }

    fn status(&self, now: DeviceTime, link: LinkCounters) -> Status {
        let counters = self.acquisition.counters();
        let settings = self.acquisition.settings();
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let gages = GAGES as u8;
        Status {
            gages,
            clock: self.clock,
            adc: self.acquisition.state(),
            data_rate: settings.data_rate,
            gain: settings.gain,
            stream: self.stream,
            calibration: self.calibration.as_ref().map(|calibration| calibration.upload.identity),
            trial: self.trial.status(),
            uptime: now,
            conversions: counters.read,
            lost_conversions: counters.lost,
            corrupted_conversions: counters.corrupted,
            dropped_samples: link.dropped_samples,
            broken_frames: link.broken_frames,
            kept: self.kept,
        }
    }
}

/// Which channels stand at an end of their range: bit k for gage k.
fn saturated_channels<const GAGES: usize>(codes: &[AdcCode; GAGES]) -> u16 {
    codes.iter().enumerate().fold(0, |mask, (gage, code)| mask | (u16::from(code.is_saturated()) << gage))
}
