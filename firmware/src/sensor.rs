//! The sensor as a whole: samples in, frames out; requests in, responses out. Requests about its health are served in a file of
//! their own.

mod health;

use core::ops::DerefMut;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use ftcal_shared::estimation::application::{RealTimeCalibration, UnusableCalibration};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::parity::ParitySpace;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DeviceTime, Gain};
use ftcal_shared::wire::health::StatusBit;
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, ClockSource, CodesFrame, GageList, InvalidCause, Measurement, Rejection,
    Request, Response, Status, StreamKind, ToHost, WrenchFrame,
};

use crate::acquisition::{Acquisition, Sample};
use crate::health::{Health, Observed, SelfTest, is_disturbance};
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
    health: Health<GAGES>,
    self_test: SelfTest<GAGES>,
    stream: StreamKind,
    clock: ClockSource,
}

/// A calibration as it came, and in the form that the sample path applies.
struct LoadedCalibration<const GAGES: usize> {
    upload: CalibrationUpload,
    /// The gain that it came at: its counts are counts at this gain.
    gain: Gain,
    /// Of all gages, or of all but one.
    real_time: RealTimeCalibration<GAGES>,
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
            health: Health::new(),
            self_test: SelfTest::new(),
            stream: StreamKind::Off,
            clock,
        }
    }

    /// Watches over the converter; see [`Acquisition::tick`]. Where a wrench is being streamed and the converter is at
    /// fault, the host is told so at every tick, instead of hearing nothing.
    pub fn tick(&mut self, now: DeviceTime, delay: &mut impl DelayNs) -> Option<StreamFrame> {
        self.acquisition.tick(now, delay);
        self.note_conditions();
        match self.acquisition.state() {
            AdcState::Faulty(fault) => {
                self.health.note_fault(false);
                self.observe(now, &Observed::Fault(fault));
                self.invalid_frame(now, fault)
            }
            AdcState::Starting | AdcState::Running => {
                self.observe(now, &Observed::Nothing);
                None
            }
        }
    }

    /// The sample path: reads the conversion that the converter announces, takes it into the trial, and applies the
    /// calibration. Allocates nothing and waits for nothing but the bus transfer. For the two times see
    /// [`Acquisition::on_data_ready`].
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<StreamFrame> {
        if self.self_test.ignores_data_ready() {
            return None;
        }
        match self.acquisition.on_data_ready(now, announced)? {
            Ok(sample) => {
                self.trial.offer(sample.index, &sample.codes);
                let measurement = self.measure(&sample);
                self.observe(now, &Observed::Sample(&sample.codes, self.health.live()));
                self.stream_frame(&sample, measurement)
            }
            Err(fault) => {
                self.health.note_fault(is_disturbance(fault));
                self.observe(now, &Observed::Fault(fault));
                self.invalid_frame(now, fault)
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
            Request::ConfigureAdc(data_rate, gain) => self.require_peace().map(|()| {
                self.acquisition.configure(data_rate, gain);
                self.health.relearn(data_rate);
                Response::Done
            }),
            Request::Stream(kind) => {
                self.stream = kind;
                Ok(Response::Done)
            }
            Request::StartTrial { rank } => {
                self.require_no_self_test().and_then(|()| self.trial.start(rank)).map(|()| Response::Done)
            }
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
            Request::UploadCalibration(upload) => self
                .require_no_self_test()
                .and_then(|()| self.load(upload))
                .map(|()| self.calibration_response()),
            Request::ReadCalibration => Ok(self.calibration_response()),
            Request::Health(request) => self.answer_about_health(request, now).map(Response::Health),
        };
        self.note_conditions();
        Reaction::Respond(served.unwrap_or_else(Response::Rejected))
    }

    /// Lets the self-test, if one is under way, see what there was to be seen.
    fn observe(&mut self, now: DeviceTime, observed: &Observed<'_, GAGES>) {
        if self.self_test.is_running() {
            let watched = self.health.watched();
            if self.self_test.observe(now, observed, watched, &mut self.acquisition) {
                self.health.set(StatusBit::SelfTest, false);
                self.health.relearn(self.acquisition.settings().data_rate);
            }
        }
    }

    /// Takes a trial back that was solved or asked for its coverage.
    pub fn finish_solving(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.trial.finish(job);
    }

    fn stream_frame(&self, sample: &Sample<GAGES>, measurement: Measurement) -> Option<StreamFrame> {
        match self.stream {
            StreamKind::Off => None,
            // What is played is not to be recorded.
            StreamKind::Codes if self.self_test.is_running() => None,
            StreamKind::Codes => Some(StreamFrame::Codes(CodesFrame {
                index: sample.index,
                time: sample.time,
                codes: GageList::from_slice(&sample.codes).ok()?,
            })),
            StreamKind::Wrench => {
                Some(StreamFrame::Wrench(WrenchFrame { index: sample.index, time: sample.time, measurement }))
            }
        }
    }

    /// Every sample is measured, streamed or not: health is to be known all the time.
    fn measure(&mut self, sample: &Sample<GAGES>) -> Measurement {
        let gain = self.acquisition.settings().gain;
        let (usable, identity) = match &self.calibration {
            None => (Err(InvalidCause::Uncalibrated), 0),
            Some(loaded) if loaded.gain != gain => (Err(InvalidCause::GainChanged), 0),
            Some(loaded) => (Ok(&loaded.real_time), loaded.upload.identity),
        };
        match self.health.measure(usable, saturated_channels(&sample.codes), sample) {
            Ok(wrench) => Measurement::Valid { wrench, calibration: identity },
            Err(cause) => Measurement::Invalid(cause),
        }
    }

    fn invalid_frame(&self, now: DeviceTime, fault: AdcFault) -> Option<StreamFrame> {
        let cause =
            if self.self_test.is_running() { InvalidCause::SelfTest } else { InvalidCause::Adc(fault) };
        (self.stream == StreamKind::Wrench).then(|| {
            StreamFrame::Wrench(WrenchFrame {
                index: self.acquisition.next_index(),
                time: now,
                measurement: Measurement::Invalid(cause),
            })
        })
    }

    /// Takes a calibration into use. The one before stays in use where the new one is refused.
    fn load(&mut self, upload: CalibrationUpload) -> Result<(), Rejection> {
        if upload.identity != upload.identity_of_numbers() {
            return Err(Rejection::WrongIdentity);
        }
        let settings = self.acquisition.settings();
        let same =
            |loaded: &LoadedCalibration<GAGES>| loaded.upload == upload && loaded.gain == settings.gain;
        if self.calibration.as_ref().is_some_and(same) {
            // Once more, because the answer was lost: tare and noise are of this very calibration.
            return Ok(());
        }
        let real_time = prepared(&upload)?;
        self.health.watch(ParitySpace::new(real_time.matrix()), None, settings.data_rate);
        self.health.start_anew();
        self.calibration = Some(LoadedCalibration { upload, gain: settings.gain, real_time });
        Ok(())
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
        }
    }
}

/// A calibration in the form that the sample path applies.
fn prepared<const GAGES: usize>(upload: &CalibrationUpload) -> Result<RealTimeCalibration<GAGES>, Rejection> {
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
fn saturated_channels<const GAGES: usize>(codes: &[AdcCode; GAGES]) -> u16 {
    codes.iter().enumerate().fold(0, |mask, (gage, code)| mask | (u16::from(code.is_saturated()) << gage))
}
