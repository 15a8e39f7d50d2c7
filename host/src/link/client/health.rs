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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ftcal_shared::units::Gain;
    use ftcal_shared::wire::health::StatusBit;
    use ftcal_shared::wire::{CalibrationUpload, GageList, LoadLimits, TarePhase};

    use super::Client;
    use crate::calibration::matrix::matrix_of_shape;
    use crate::simulator::board::SimulatedBoard;
    use crate::simulator::flash::SimulatedFlash;
    use crate::simulator::scenario::{Scenario, ScenarioKind};
    use crate::simulator::sensor::SoftwareSensor;

    /// A sensor that was just switched on, with what this flash keeps; something hangs on it.
    fn switched_on(scenario: &Scenario, flash: &SimulatedFlash) -> Client<SimulatedBoard> {
        let board = SimulatedBoard::with_flash(scenario.sensor.clone(), 7, flash.clone()).expect("sizes fit");
        board.bench().with(|bench| bench.hang(scenario.trials[0].load));
        let mut client = Client::connect(board).expect("answers");
        client.wait_for_converter().expect("the converter starts");
        client
    }

    fn true_calibration(sensor: &SoftwareSensor) -> CalibrationUpload {
        let matrix = matrix_of_shape(sensor.shape()).expect("of full rank").transpose();
        #[expect(clippy::cast_possible_truncation, reason = "this is the form in which it travels")]
        let matrix = matrix.iter().map(|&element| element as f32).collect();
        let bias_counts = GageList::from_slice(sensor.bias_counts().as_slice()).expect("room");
        let mut upload =
            CalibrationUpload { dof: sensor.dof(), gain: Gain::default(), bias_counts, matrix, identity: 0 };
        upload.identity = upload.identity_of_numbers();
        upload
    }

    #[test]
    fn limits_peaks_and_a_tare_that_is_to_be_kept_survive_a_reset() {
        let scenario = Scenario::new(ScenarioKind::Fingertip, 7).expect("sizes fit");
        let flash = SimulatedFlash::default();
        let mut client = switched_on(&scenario, &flash);
        client.upload_calibration(&true_calibration(&scenario.sensor)).expect("taken");
        client.store_calibration().expect("kept");
        let limits = LoadLimits { combined: 0.5, ..LoadLimits::NONE };
        assert_eq!(client.set_limits(limits).expect("sound"), limits);
        let kept = client.set_tare(100, true).expect("answers");
        assert!(kept.phase == TarePhase::Settled && kept.wrench.is_some(), "{kept:?}");
        client.store_settings().expect("kept");
        // Peaks need not be stored by hand: every ten seconds they are, where they have grown by more than a twentieth.
        let peaks = client.health().expect("answers").peak_ever;
        client.wait(Duration::from_secs(11)).expect("the line is sound");
        assert!(client.set_tare(50, false).expect("answers") != kept, "another, not to be kept");

        let mut client = switched_on(&scenario, &flash);
        assert_eq!(client.tare().expect("answers"), kept);
        assert_eq!(client.limits().expect("answers"), limits);
        let report = client.health().expect("answers");
        assert!(report.live.contains(StatusBit::TareActive));
        assert!(
            report.peak_ever.iter().zip(&peaks).all(|(now, before)| 1.051 * now >= *before),
            "{report:?}"
        );

        // The tare is of a calibration, and with another one it is not taken up.
        let mut other = true_calibration(&scenario.sensor);
        other.matrix[0] *= 1.5;
        other.identity = other.identity_of_numbers();
        client.upload_calibration(&other).expect("taken");
        client.store_calibration().expect("kept");
        let mut client = switched_on(&scenario, &flash);
        client.wait(Duration::from_millis(50)).expect("the line is sound");
        assert_eq!(client.tare().expect("answers").wrench, None);
        assert_eq!(client.limits().expect("answers"), limits);
    }
}
