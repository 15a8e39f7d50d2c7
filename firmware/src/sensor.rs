//! The sensor as a whole: samples in, frames out; requests in, responses out. Requests about its health, and about what it
//! keeps, are served in files of their own; so is whoever calibrates it in the field, with no host.

mod calibration;
mod field;
mod health;
mod keeping;

use core::ops::DerefMut;

use embedded_hal::spi::SpiDevice;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{Decimation, DeviceTime, SampleIndex};
use ftcal_shared::wire::health::StatusBit;
use ftcal_shared::wire::{
    AdcState, ClockSource, CodesFrame, GageList, HealthRequest, Identity, InvalidCause, KeptCalibrations,
    Output, Rejection, Request, Response, Status, StreamKind,
};

use crate::acquisition::{Acquisition, Sample};
use crate::adc::ChannelMask;
use crate::decimator::{Decimator, group_delay};
use crate::field::Field;
use crate::handover::{Reading, RemoteConverter};
use crate::health::{Health, Observed, SelfTest, is_disturbance};
use crate::storage::checkpoint::TrialAccess;
use crate::storage::job::StoreJob;
use crate::stream::{Measurement, Moment, SilentMoment, WrenchMoment};
use crate::trial::{SolveJob, Trial};

use calibration::{LoadedCalibration, saturated_channels};

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

/// Trial, calibration and health of one sensor with `GAGES` gages, and the other end of its converter.
pub struct Sensor<Store, const GAGES: usize, const HIGHER: usize> {
    converter: RemoteConverter,
    trial: Trial<Store, GAGES, HIGHER>,
    calibration: Option<LoadedCalibration<GAGES>>,
    kept: KeptCalibrations,
    identity: Identity,
    /// A [`StoreJob`] is out.
    storing: bool,
    /// What was kept before the reset is still to come.
    awaits_memory: bool,
    /// Something that was stored besides the calibrations cannot be read, or something could not be stored.
    memory_failed: bool,
    next_housekeeping: DeviceTime,
    health: Health<GAGES>,
    self_test: SelfTest<GAGES>,
    field: Field,
    stream: StreamKind,
    abandoned_streams: u32,
    decimator: Decimator,
    clock: ClockSource,
    /// Readings that were not attended to before the next conversion was due.
    late_samples: u32,
}

impl<Store, const GAGES: usize, const HIGHER: usize> Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// An uncalibrated sensor whose converter is not started yet.
    pub fn new(store: Store, clock: ClockSource) -> Self {
        Self {
            converter: RemoteConverter::new(const { ChannelMask::first(GAGES) }),
            trial: Trial::new(store),
            calibration: None,
            kept: KeptCalibrations::default(),
            identity: Identity::default(),
            storing: false,
            awaits_memory: false,
            memory_failed: false,
            next_housekeeping: DeviceTime::default(),
            health: Health::new(),
            self_test: SelfTest::new(),
            field: Field::new(),
            stream: StreamKind::Off,
            abandoned_streams: 0,
            decimator: Decimator::new(Decimation::default()),
            clock,
            late_samples: 0,
        }
    }

    /// Holds back whatever would be overwritten by what was kept, until that is there ([`Sensor::restore`]): to be called at the start by
    /// a board that has a memory. A trial that goes on takes no samples before the converter is set for it.
    pub const fn await_memory(&mut self) {
        self.awaits_memory = true;
    }

    /// The trial.
    pub const fn trial(&mut self) -> &mut Trial<Store, GAGES, HIGHER> {
        &mut self.trial
    }

    /// Tells the converter what the sensor wants of it, and hears how it is. To be called at every tick, before [`Sensor::tick`].
    /// The interrupt that reads the converter waits for this, so it is all that the two share.
    pub fn exchange<Spi: SpiDevice<u8>>(&mut self, acquisition: &mut Acquisition<Spi, GAGES>) {
        self.converter.exchange(acquisition);
    }

    /// Notes how the converter is. Where a wrench is being streamed and the converter is at fault, the host is told so at every tick,
    /// instead of hearing nothing.
    pub fn tick(&mut self, now: DeviceTime) -> Option<Moment> {
        self.note_conditions();
        match self.converter.state() {
            AdcState::Faulty(fault) => {
                self.health.note_fault(false);
                self.observe(now, &Observed::Fault(fault));
                (self.stream == StreamKind::Wrench).then(|| {
                    Moment::Silence(SilentMoment {
                        next: self.converter.next_index(),
                        time: now,
                        status: self.status_word().frame_bits(),
                        cause: self.cause_of(fault),
                    })
                })
            }
            AdcState::Starting | AdcState::Running => {
                self.observe(now, &Observed::Nothing);
                None
            }
        }
    }

    /// The sample path, once a conversion is read: takes it into the trial, and applies the calibration. Allocates nothing and waits for
    /// nothing. What was read before the converter was last told to start is passed over.
    pub fn take_in(&mut self, reading: &Reading<GAGES>, now: DeviceTime) -> Option<Moment> {
        if !self.converter.is_current(reading) {
            return None;
        }
        let waited = now.as_micros().saturating_sub(reading.read_at.as_micros());
        if waited > u64::from(self.period_nanos() / 1000) {
            self.late_samples = self.late_samples.wrapping_add(1);
        }
        // The sample that ends a self-test is part of it.
        let is_testing = self.self_test.is_running();
        match reading.outcome() {
            Ok(sample) => {
                let saturated = saturated_channels(&sample.codes);
                if !self.awaits_memory {
                    self.trial.offer(reading.index, &sample.codes, saturated != 0);
                }
                let measurement = self.measure(sample, saturated);
                self.observe(now, &Observed::Sample(&sample.codes, self.health.live()));
                self.moment(reading, sample, measurement, is_testing)
            }
            Err(fault) => {
                let measurement = Measurement::Invalid(self.cause_of(fault));
                self.health.note_fault(is_disturbance(fault));
                self.observe(now, &Observed::Fault(fault));
                match self.stream {
                    StreamKind::Wrench => {
                        self.wrench_moment(reading.index, reading.announced, reading.read_at, measurement)
                    }
                    StreamKind::Codes | StreamKind::Off => None,
                }
            }
        }
    }

    /// Serves one request.
    #[inline(never)]
    pub fn answer(
        &mut self,
        request: Request,
        now: DeviceTime,
        link: LinkCounters,
    ) -> Reaction<Store, GAGES, HIGHER> {
        let served = match request {
            ref request if self.awaits_memory && changes_something(request) => Err(Rejection::Storing),
            Request::Status => Ok(Response::Status(self.status(now, link))),
            Request::ConfigureAdc(data_rate, gain) => self.require_peace().map(|()| {
                self.converter.configure(data_rate, gain);
                self.health.relearn(data_rate);
                self.decimator = Decimator::new(self.decimator.decimation());
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
            Request::StopTrial => self.trial.stop().map(|stopped| {
                self.field.give_up();
                Response::Trial(stopped)
            }),
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
            Request::UploadCalibration(upload) => self
                .require_no_self_test()
                .and_then(|()| self.require_nothing_stored(true))
                .and_then(|()| self.load(upload))
                .map(|()| self.calibration_response()),
            Request::ReadCalibration => Ok(self.calibration_response()),
            Request::ReadIdentity => Ok(Response::Identity(self.identity.clone())),
            Request::Memory(request) => match self.store_job(request) {
                Ok(job) => return Reaction::Store(job),
                Err(rejection) => Err(rejection),
            },
            Request::Health(request) => self.answer_about_health(request, now).map(Response::Health),
            // The line is the board's.
            Request::ChangeRate(_) => Err(Rejection::UnsupportedRate),
            Request::Output(decimation) => {
                if let Some(decimation) = decimation {
                    self.decimator = Decimator::new(decimation);
                }
                Ok(Response::Output(self.output()))
            }
            Request::ReadField => Ok(Response::Field(self.field_report())),
        };
        self.note_conditions();
        Reaction::Respond(served.unwrap_or_else(Response::Rejected))
    }

    /// The state of the converter as it was last reported.
    pub const fn converter_state(&self) -> AdcState {
        self.converter.state()
    }

    /// Nobody listens any more: what was being streamed is not, and the status says so.
    pub fn abandon_stream(&mut self) {
        if self.stream != StreamKind::Off {
            self.stream = StreamKind::Off;
            self.abandoned_streams = self.abandoned_streams.wrapping_add(1);
        }
    }

    /// Takes a trial back that was solved or asked for its coverage.
    pub fn finish_solving(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.trial.finish(job);
    }

    fn moment(
        &mut self,
        reading: &Reading<GAGES>,
        sample: &Sample<GAGES>,
        measurement: Measurement,
        is_testing: bool,
    ) -> Option<Moment> {
        match self.stream {
            StreamKind::Off => None,
            // What is played is not to be recorded.
            StreamKind::Codes if is_testing => None,
            StreamKind::Codes => Some(Moment::Codes(CodesFrame {
                index: reading.index,
                time: reading.announced,
                codes: GageList::from_slice(&sample.codes).ok()?,
            })),
            StreamKind::Wrench => {
                self.wrench_moment(reading.index, reading.announced, reading.read_at, measurement)
            }
        }
    }

    /// Puts a measurement at the converter's rate into the stream; what comes of it has the stream's rate.
    fn wrench_moment(
        &mut self,
        index: SampleIndex,
        time: DeviceTime,
        announced: DeviceTime,
        measurement: Measurement,
    ) -> Option<Moment> {
        let moment = WrenchMoment {
            index,
            stride: 1,
            time,
            announced,
            period_nanos: self.period_nanos(),
            status: self.status_word().frame_bits(),
            parity: self.health.chi_square(),
            basis: self.health.basis(),
            measurement,
        };
        if self.decimator.decimation() == Decimation::By1 {
            return Some(Moment::Wrench(moment));
        }
        self.decimator.push(&moment).map(Moment::Wrench)
    }

    /// Nominal time from one conversion to the next.
    fn period_nanos(&self) -> u32 {
        1_000_000_000 / self.converter.settings().data_rate.hertz()
    }

    /// Why there is no wrench while the converter has this fault.
    fn cause_of(&self, fault: AdcFault) -> InvalidCause {
        if self.self_test.is_running() { InvalidCause::SelfTest } else { InvalidCause::Adc(fault) }
    }

    /// Lets the self-test, if one is under way, see what there was to be seen.
    fn observe(&mut self, now: DeviceTime, observed: &Observed<'_, GAGES>) {
        if self.self_test.is_running() {
            let watched = self.health.watched();
            if self.self_test.observe(now, observed, watched, &mut self.converter) {
                self.health.set(StatusBit::SelfTest, false);
                self.health.relearn(self.converter.settings().data_rate);
            }
        }
    }

    fn output(&self) -> Output {
        let decimation = self.decimator.decimation();
        Output {
            data_rate: self.converter.settings().data_rate,
            decimation,
            group_delay_conversions: group_delay(decimation),
        }
    }

    #[inline(never)]
    fn status(&self, now: DeviceTime, link: LinkCounters) -> Status {
        let counters = self.converter.counters();
        let settings = self.converter.settings();
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let gages = GAGES as u8;
        Status {
            gages,
            clock: self.clock,
            adc: self.converter.state(),
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
            abandoned_streams: self.abandoned_streams,
            overrun_conversions: counters.overrun,
            late_samples: self.late_samples,
        }
    }
}

/// Whether the sensor is another one after this request.
const fn changes_something(request: &Request) -> bool {
    match request {
        Request::Status
        | Request::TrialStatus
        | Request::Diagnosis
        | Request::ReadCalibration
        | Request::ReadIdentity
        | Request::ReadField
        | Request::Stream(_)
        | Request::Output(_)
        | Request::ChangeRate(_)
        | Request::Health(
            HealthRequest::Read
            | HealthRequest::ReadLimits
            | HealthRequest::ReadTare
            | HealthRequest::ReadSelfTest,
        ) => false,
        Request::ConfigureAdc(..)
        | Request::StartTrial { .. }
        | Request::StopTrial
        | Request::SolveTrial
        | Request::Coverage
        | Request::UploadCalibration(_)
        | Request::Memory(_)
        | Request::Health(
            HealthRequest::ClearLatched
            | HealthRequest::CarryOn(_)
            | HealthRequest::SetLimits(_)
            | HealthRequest::SetTare { .. }
            | HealthRequest::ClearTare { .. }
            | HealthRequest::StartSelfTest,
        ) => true,
    }
}

/// Where nobody else works with the sensor meanwhile.
impl<Store, const GAGES: usize, const HIGHER: usize> TrialAccess<Store, GAGES, HIGHER>
    for Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    fn with<Answer>(&mut self, act: impl FnOnce(&mut Trial<Store, GAGES, HIGHER>) -> Answer) -> Answer {
        act(&mut self.trial)
    }

    fn undisturbed<Answer>(&mut self, act: impl FnOnce(&mut Self) -> Answer) -> Answer {
        act(self)
    }
}
