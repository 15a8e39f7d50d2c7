//! What the sensor is asked about its health, what is changed about how it is watched, and what others tell it.

use core::ops::DerefMut;

use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::parity::{GageNeeded, ParitySpace};
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{
    AdcState, ClockSource, Diagnosis, HealthRequest, HealthResponse, KeptCalibration, Rejection, ResetCause,
    TrialPhase,
};

use super::Sensor;
use super::calibration::prepared;

impl<Store, const GAGES: usize, const HIGHER: usize> Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// The status word as it is now; see [`ftcal_shared::wire::health`].
    pub const fn status_word(&self) -> StatusWord {
        self.health.live()
    }

    /// Notes in the status word why the sensor started.
    pub const fn note_start(&mut self, diagnosis: &Diagnosis) {
        let by_watchdog = matches!(diagnosis.reset, ResetCause::Watchdog);
        self.health.set(StatusBit::WatchdogReset, by_watchdog);
        self.health.set(StatusBit::PanicReset, diagnosis.failure.is_some());
    }

    #[inline(never)]
    pub(super) fn answer_about_health(
        &mut self,
        request: HealthRequest,
        now: DeviceTime,
    ) -> Result<HealthResponse, Rejection> {
        match request {
            HealthRequest::Read
            | HealthRequest::ReadLimits
            | HealthRequest::ReadTare
            | HealthRequest::ReadSelfTest => {}
            HealthRequest::ClearLatched => self.health.clear_latched(),
            HealthRequest::CarryOn(gage) => self.require_peace().and_then(|()| self.carry_on(gage))?,
            HealthRequest::SetLimits(limits) => self.health.set_limits(limits)?,
            HealthRequest::SetTare { samples, store } => {
                self.calibration.as_ref().ok_or(Rejection::Uncalibrated)?;
                self.health.start_tare(samples, store)?;
            }
            HealthRequest::ClearTare { store } => self.health.clear_tare(store),
            HealthRequest::StartSelfTest => {
                self.require_peace()?;
                self.require_nothing_stored(true)?;
                self.health.set(StatusBit::SelfTest, true);
                self.self_test.start(now, self.health.in_use(), self.health.watched());
            }
        }
        Ok(match request {
            HealthRequest::Read | HealthRequest::ClearLatched | HealthRequest::CarryOn(_) => {
                HealthResponse::Report(self.health.report())
            }
            HealthRequest::ReadLimits | HealthRequest::SetLimits(_) => {
                HealthResponse::Limits(*self.health.limits())
            }
            HealthRequest::ReadTare | HealthRequest::SetTare { .. } | HealthRequest::ClearTare { .. } => {
                HealthResponse::Tare(self.health.tare())
            }
            HealthRequest::StartSelfTest | HealthRequest::ReadSelfTest => {
                HealthResponse::SelfTest(self.self_test.report().clone())
            }
        })
    }

    /// Neither a trial nor a self-test may be under way.
    pub(super) fn require_peace(&self) -> Result<(), Rejection> {
        self.require_no_self_test()?;
        self.trial.require_idle()
    }

    pub(super) fn require_no_self_test(&self) -> Result<(), Rejection> {
        if self.self_test.is_running() { Err(Rejection::SelfTestRunning) } else { Ok(()) }
    }

    /// Makes wrenches without a gage, or with all again.
    #[inline(never)]
    fn carry_on(&mut self, gage: Option<u8>) -> Result<(), Rejection> {
        let data_rate = self.converter.settings().data_rate;
        let loaded = self.calibration.as_mut().ok_or(Rejection::Uncalibrated)?;
        let mut real_time = prepared(&loaded.upload)?;
        let mut space = ParitySpace::new(&real_time.matrix());
        if let Some(gage) = gage {
            if usize::from(gage) >= GAGES {
                return Err(Rejection::NoSuchGage);
            }
            (real_time, space) = real_time
                .without(usize::from(gage), &space, &loaded.upload.bias_counts)
                .map_err(|GageNeeded| Rejection::GageNeeded)?;
        }
        loaded.real_time = real_time;
        self.health.watch(space, gage, data_rate);
        Ok(())
    }

    /// Brings into the status word what lasts.
    pub(super) fn note_conditions(&mut self) {
        let gain = self.converter.settings().gain;
        let other_gain = self.calibration.as_ref().is_some_and(|loaded| loaded.upload.gain != gain);
        let calibration_failed = match self.kept.current {
            KeptCalibration::Unread | KeptCalibration::Nothing | KeptCalibration::Calibration(_) => false,
            KeptCalibration::Unreadable
            | KeptCalibration::Unusable
            | KeptCalibration::Corrupt
            | KeptCalibration::OtherFormat(_) => true,
        };
        let conditions = [
            (StatusBit::AdcFault, self.converter.state() != AdcState::Running),
            (StatusBit::Uncalibrated, self.calibration.is_none()),
            (StatusBit::GainChanged, other_gain),
            (StatusBit::TrialRunning, self.trial.status().phase == TrialPhase::Running),
            (StatusBit::ClockFallback, self.clock == ClockSource::InternalFallback),
            (StatusBit::StorageProblem, calibration_failed || self.memory_failed),
        ];
        for (bit, set) in conditions {
            self.health.set(bit, set);
        }
    }
}
