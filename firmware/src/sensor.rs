//! The sensor as a whole: samples in, frames out; requests in, responses out.

use core::ops::DerefMut;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use ftcal_shared::estimation::application::{RealTimeCalibration, UnusableCalibration};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DeviceTime, Gain};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, ClockSource, CodesFrame, GageList, Identity, InvalidCause, KeptCalibration,
    KeptCalibrations, Measurement, MemoryRequest, Rejection, Request, Response, Status, StreamKind, ToHost,
    WrenchFrame,
};

use crate::acquisition::{Acquisition, Sample};
use crate::adc::AdcSettings;
use crate::storage::checkpoint::TrialAccess;
use crate::storage::items::{Settings, StoredCalibration};
use crate::storage::job::{StoreJob, Stored};
use crate::storage::keeper::Found;
use crate::storage::memory::Kept;
use crate::trial::{SolveJob, Trial};

/// What the sample path sends to the host.
#[derive(Clone, Debug, PartialEq)]
pub enum StreamFrame {
    /// A raw sample.
    Codes(CodesFrame),
    /// A wrench, or why there is none.
    Wrench(WrenchFrame),
}

impl From<StreamFrame> for ToHost {
    fn from(frame: StreamFrame) -> Self {
        match frame {
            StreamFrame::Codes(frame) => Self::Codes(frame),
            StreamFrame::Wrench(frame) => Self::Wrench(frame),
        }
    }
}

/// What a request leads to.
pub enum Reaction<Store, const GAGES: usize, const HIGHER: usize> {
    /// Send this.
    Respond(Response),
    /// Compute this in the background, send the outcome ([`SolveJob::response`]), and give the job back by
    /// [`Sensor::finish_solving`].
    Solve(SolveJob<Store, GAGES, HIGHER>),
    /// Do this in the background, give the outcome to [`Sensor::finish_storing`], and send what that says.
    Store(StoreJob),
}

/// What the link knows and the sensor reports in its status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Stream frames that did not fit on the line.
    pub dropped_frames: u32,
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

    /// Takes up what was found after the reset: to be called once, as soon as the memory is read. The converter is set for the trial
    /// that goes on; else as was kept; else to the gain that the calibration was made at.
    pub fn restore(&mut self, found: Found) {
        let mut settings = found.trial;
        let Ok(kept) = found.kept else {
            self.kept.current = KeptCalibration::Unreadable;
            self.configure(settings);
            return;
        };
        settings = settings.or(kept.settings);
        if let Some(StoredCalibration { gain, .. }) = kept.calibration {
            let data_rate = self.acquisition.settings().data_rate;
            settings = settings.or(Some(Settings { data_rate, gain }));
        }
        self.configure(settings);
        // Why it cannot be used, the status says.
        let _ = self.take_up(kept, true);
    }

    fn configure(&mut self, settings: Option<Settings>) {
        if let Some(Settings { data_rate, gain }) = settings {
            self.acquisition.configure(data_rate, gain);
        }
    }

    /// The trial.
    pub const fn trial(&mut self) -> &mut Trial<Store, GAGES, HIGHER> {
        &mut self.trial
    }

    /// Watches over the converter; see [`Acquisition::tick`]. Where a wrench is being streamed and the converter is at
    /// fault, the host is told so at every tick, instead of hearing nothing.
    pub fn tick(&mut self, now: DeviceTime, delay: &mut impl DelayNs) -> Option<StreamFrame> {
        self.acquisition.tick(now, delay);
        match self.acquisition.state() {
            AdcState::Faulty(fault) => self.invalid_frame(now, fault),
            AdcState::Starting | AdcState::Running => None,
        }
    }

    /// The sample path: reads the conversion that the converter announces, takes it into the trial, and applies the
    /// calibration. Allocates nothing and waits for nothing but the bus transfer. For the two times see
    /// [`Acquisition::on_data_ready`].
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<StreamFrame> {
        match self.acquisition.on_data_ready(now, announced)? {
            Ok(sample) => {
                self.trial.offer(sample.index, &sample.codes);
                self.stream_frame(&sample)
            }
            Err(fault) => self.invalid_frame(now, fault),
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
            Request::StartTrial { rank } => match self.prepare_trial(rank) {
                Ok(job) => return Reaction::Store(job),
                Err(rejection) => Err(rejection),
            },
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

    /// A trial starts when there is room for its checkpoints. While samples are streamed, nothing is erased for them: the trial has none
    /// then.
    fn prepare_trial(&mut self, rank: u8) -> Result<StoreJob, Rejection> {
        self.require_nothing_stored(true)?;
        self.trial.may_start(rank)?;
        self.storing = true;
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let gages = GAGES as u8;
        Ok(StoreJob::PrepareTrial { rank, gages, may_erase: self.stream == StreamKind::Off })
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
            MemoryRequest::StoreSettings => StoreJob::Settings(self.settings()),
            MemoryRequest::WriteName(name) => StoreJob::Name(name),
        };
        self.storing = true;
        Ok(job)
    }

    /// Takes up what came of a [`StoreJob`], and says what to answer.
    pub fn finish_storing(&mut self, stored: Stored) -> Response {
        self.storing = false;
        let served = match stored {
            Stored::Kept(kept) => self.take_up(kept, false).map(|()| Response::Done),
            Stored::RolledBack(kept) => self.take_up(kept, true).map(|()| self.calibration_response()),
            Stored::Prepared { rank } => self.trial.start(rank, self.settings()).map(|()| Response::Done),
            Stored::Failed(error) => Err(error.into()),
        };
        served.unwrap_or_else(Response::Rejected)
    }

    fn settings(&self) -> Settings {
        let &AdcSettings { data_rate, gain, .. } = self.acquisition.settings();
        Settings { data_rate, gain }
    }

    /// Notes what is kept; and uses it, if so wanted.
    fn take_up(&mut self, kept: Kept, use_it: bool) -> Result<(), Rejection> {
        let Kept { calibration, calibrations, identity, .. } = kept;
        self.kept = calibrations;
        self.identity = identity;
        let Some(StoredCalibration { upload, gain }) = calibration else { return Ok(()) };
        match LoadedCalibration::new(upload, gain) {
            Ok(loaded) if use_it => self.calibration = Some(loaded),
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
    const fn require_nothing_stored(&self, starts: bool) -> Result<(), Rejection> {
        if starts && self.storing { Err(Rejection::Storing) } else { Ok(()) }
    }

    /// Takes a trial back that was solved or asked for its coverage.
    pub fn finish_solving(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.trial.finish(job);
    }

    fn stream_frame(&self, sample: &Sample<GAGES>) -> Option<StreamFrame> {
        match self.stream {
            StreamKind::Off => None,
            StreamKind::Codes => Some(StreamFrame::Codes(CodesFrame {
                index: sample.index,
                time: sample.time,
                codes: GageList::from_slice(&sample.codes).ok()?,
            })),
            StreamKind::Wrench => Some(StreamFrame::Wrench(WrenchFrame {
                index: sample.index,
                time: sample.time,
                measurement: self.measure(&sample.codes),
            })),
        }
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
        Measurement::Valid {
            wrench: calibration.real_time.apply(codes),
            calibration: calibration.upload.identity,
        }
    }

    fn invalid_frame(&self, now: DeviceTime, fault: AdcFault) -> Option<StreamFrame> {
        (self.stream == StreamKind::Wrench).then(|| {
            StreamFrame::Wrench(WrenchFrame {
                index: self.acquisition.next_index(),
                time: now,
                measurement: Measurement::Invalid(InvalidCause::Adc(fault)),
            })
        })
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
            dropped_frames: link.dropped_frames,
            broken_frames: link.broken_frames,
            kept: self.kept,
        }
    }
}

/// Which channels stand at an end of their range: bit k for gage k.
fn saturated_channels<const GAGES: usize>(codes: &[AdcCode; GAGES]) -> u16 {
    codes.iter().enumerate().fold(0, |mask, (gage, code)| mask | (u16::from(code.is_saturated()) << gage))
}

/// Where nobody else works with the sensor meanwhile.
impl<Spi, Store, const GAGES: usize, const HIGHER: usize> TrialAccess<Store, GAGES, HIGHER>
    for Sensor<Spi, Store, GAGES, HIGHER>
where
    Spi: SpiDevice<u8>,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    fn with<Answer>(&mut self, act: impl FnOnce(&mut Trial<Store, GAGES, HIGHER>) -> Answer) -> Answer {
        act(&mut self.trial)
    }

    fn undisturbed<Answer>(&mut self, act: impl FnOnce(&mut Self) -> Answer) -> Answer {
        act(self)
    }
}
