//! What can be asked of a sensor about its health.

use std::time::Duration;

use ftcal_shared::wire::{
    HealthReport, HealthRequest, HealthResponse, LoadLimits, Request, Response, SelfTestPhase,
    SelfTestReport, TarePhase, TareReport,
};

use super::{ANSWER, Client};
use crate::link::error::{ClientError, LinkError};
use crate::link::transport::Transport;

/// Between two looks at something that takes its time.
const POLL: Duration = Duration::from_millis(50);

/// How long a self-test may take: two seconds for each fault at worst, with a wide margin.
const SELF_TEST: Duration = Duration::from_mins(1);

/// How long a tare may take: 65 535 samples at 250 a second.
const TARE: Duration = Duration::from_mins(5);

impl<Line: Transport> Client<Line> {
    /// How are the gages, the load, the sensor?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn health(&mut self) -> Result<HealthReport, ClientError> {
        self.request_report(HealthRequest::Read)
    }

    /// Has the sensor forget what was in its status word and is no more.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn clear_latched(&mut self) -> Result<HealthReport, ClientError> {
        self.request_report(HealthRequest::ClearLatched)
    }

    /// Has the sensor measure without this gage, or with all of them again.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn carry_on_without(&mut self, gage: Option<u8>) -> Result<HealthReport, ClientError> {
        self.request_report(HealthRequest::CarryOn(gage))
    }

    /// The limits of the load.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn limits(&mut self) -> Result<LoadLimits, ClientError> {
        self.request_limits(HealthRequest::ReadLimits)
    }

    /// Sets the limits of the load.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn set_limits(&mut self, limits: LoadLimits) -> Result<LoadLimits, ClientError> {
        self.request_limits(HealthRequest::SetLimits(limits))
    }

    /// The tare.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn tare(&mut self) -> Result<TareReport, ClientError> {
        self.request_tare(HealthRequest::ReadTare)
    }

    /// Has the sensor take a tare from so many samples, and waits for what comes of it.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn set_tare(&mut self, samples: u16, store: bool) -> Result<TareReport, ClientError> {
        let begin = self.line().elapsed();
        let mut report = self.request_tare(HealthRequest::SetTare { samples, store })?;
        while matches!(report.phase, TarePhase::Averaging { .. }) {
            if self.line().elapsed().saturating_sub(begin) > TARE {
                return Err(LinkError::UnexpectedResponse.into());
            }
            self.wait(POLL)?;
            report = self.tare()?;
        }
        Ok(report)
    }

    /// Has the sensor subtract nothing any more.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn clear_tare(&mut self, store: bool) -> Result<TareReport, ClientError> {
        self.request_tare(HealthRequest::ClearTare { store })
    }

    /// Has the sensor test itself, and waits until it is done. Not begun twice: a second start is rejected while the first
    /// runs.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn self_test(&mut self) -> Result<SelfTestReport, ClientError> {
        let begin = self.line().elapsed();
        let mut report = self.request_self_test(HealthRequest::StartSelfTest)?;
        while report.phase == SelfTestPhase::Running {
            if self.line().elapsed().saturating_sub(begin) > SELF_TEST {
                return Err(LinkError::UnexpectedResponse.into());
            }
            self.wait(POLL)?;
            report = self.request_self_test(HealthRequest::ReadSelfTest)?;
        }
        Ok(report)
    }

    fn request_report(&mut self, request: HealthRequest) -> Result<HealthReport, ClientError> {
        match self.request_health(request)? {
            HealthResponse::Report(report) => Ok(report),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_limits(&mut self, request: HealthRequest) -> Result<LoadLimits, ClientError> {
        match self.request_health(request)? {
            HealthResponse::Limits(limits) => Ok(limits),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_tare(&mut self, request: HealthRequest) -> Result<TareReport, ClientError> {
        match self.request_health(request)? {
            HealthResponse::Tare(tare) => Ok(tare),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_self_test(&mut self, request: HealthRequest) -> Result<SelfTestReport, ClientError> {
        match self.request_health(request)? {
            HealthResponse::SelfTest(report) => Ok(report),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_health(&mut self, request: HealthRequest) -> Result<HealthResponse, ClientError> {
        match self.conversation.request(Request::Health(request), ANSWER)? {
            Response::Health(response) => Ok(response),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }
}
