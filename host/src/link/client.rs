//! The host's side of the conversation with a sensor: what it can be asked, each question with its answer.
//!
//! Whatever is lost on the line is asked for again, and nothing is done twice. Samples that come while an answer is awaited are kept
//! for [`Client::next_frame`].
//!
//! A sensor has one host at a time: [`Client::connect`] ends whatever stream an earlier host left running.

mod health;

use std::time::Duration;

use ftcal_shared::units::{DataRate, Decimation, Gain};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, Coverage, Diagnosis, FieldReport, Hello, Output, Request, Response,
    Solution, Status, StreamKind, TrialStatus,
};

use super::conversation::Conversation;
use super::error::{ClientError, LinkError};
use super::frame::{Frame, KnownCalibration};
use super::transport::Transport;

/// How long one answer may take, repetitions included. The sensor answers within milliseconds; an emulated one on a busy machine
/// takes longer.
const ANSWER: Duration = Duration::from_secs(3);
/// How long solving a trial may take: 12 gages without hardware for double precision, with a wide margin.
const SOLVING: Duration = Duration::from_mins(1);
/// How long the converter may take to start, retries of its driver included.
const CONVERTER_START: Duration = Duration::from_secs(3);
/// Between two looks at the converter's state.
const CONVERTER_POLL: Duration = Duration::from_millis(20);

/// A conversation with one sensor.
pub struct Client<Line: Transport> {
    conversation: Conversation<Line>,
}

impl<Line: Transport> Client<Line> {
    /// Greets the sensor at the other end of the line, makes sure that it speaks this protocol, and ends a stream that
    /// an earlier host left running.
    ///
    /// # Errors
    ///
    /// [`LinkError::Silence`], [`LinkError::NoAnswer`], [`LinkError::OtherProduct`], [`LinkError::OtherVersion`].
    pub fn connect(line: Line) -> Result<Self, ClientError> {
        let mut client = Self::over(line);
        client.hello()?;
        client.stream(StreamKind::Off)?;
        Ok(client)
    }

    /// A conversation that has yet to begin; [`Client::connect`] begins it.
    fn over(line: Line) -> Self {
        Self { conversation: Conversation::new(line) }
    }

    /// The line.
    pub const fn line(&self) -> &Line {
        self.conversation.line()
    }

    /// Samples that are missing between those that were taken, since the stream was started last: lost by the converter, by the
    /// sensor or on the line, or dropped because nobody took them in time.
    pub const fn lost_samples(&self) -> u64 {
        self.conversation.tally().lost_samples
    }

    /// Samples that came and were dropped because nobody took them in time.
    pub const fn dropped_samples(&self) -> u64 {
        self.conversation.tally().dropped_samples
    }

    /// Frames that came broken.
    pub const fn broken_frames(&self) -> u64 {
        self.conversation.tally().broken_frames
    }

    /// How often no answer came in time, and the question was asked again or given up: for whoever has to tell a sensor that is slow to
    /// answer, as one that solves a trial is, from a line that loses requests.
    pub const fn repetitions(&self) -> u64 {
        self.conversation.tally().repetitions
    }

    /// Who are you?
    ///
    /// # Errors
    ///
    /// As [`Client::connect`].
    pub fn hello(&mut self) -> Result<Hello, ClientError> {
        self.conversation.hello()
    }

    /// The baud rate of the conversation.
    pub const fn baud(&self) -> u32 {
        self.conversation.baud()
    }

    /// Goes on at another baud rate, or as before where the sensor does not have it or the line does not carry it.
    ///
    /// # Errors
    ///
    /// [`ClientError::Rejected`] where the sensor does not have it; [`LinkError::RateDoesNotWork`] where the line does not carry it;
    /// [`ClientError`].
    pub fn change_rate(&mut self, baud: u32) -> Result<(), ClientError> {
        self.conversation.change_rate(baud)
    }

    /// How are you?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn status(&mut self) -> Result<Status, ClientError> {
        match self.conversation.request(Request::Status, ANSWER)? {
            Response::Status(status) => Ok(status),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// Why did you start, and how much room have you left?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn diagnosis(&mut self) -> Result<Diagnosis, ClientError> {
        match self.conversation.request(Request::Diagnosis, ANSWER)? {
            Response::Diagnosis(diagnosis) => Ok(diagnosis),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// What of calibrations in the field?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn field(&mut self) -> Result<FieldReport, ClientError> {
        match self.conversation.request(Request::ReadField, ANSWER)? {
            Response::Field(report) => Ok(report),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// Sets the converter and waits until it runs so.
    ///
    /// # Errors
    ///
    /// [`ClientError::Converter`] and [`ClientError::ConverterNotStarting`]; [`ClientError`].
    pub fn configure_adc(&mut self, data_rate: DataRate, gain: Gain) -> Result<Status, ClientError> {
        self.request_done(Request::ConfigureAdc(data_rate, gain))?;
        // What the filter delays a wrench is now another time.
        self.output()?;
        self.wait_for_converter()
    }

    /// Waits until the converter runs, which it does when it has delivered a conversion since.
    ///
    /// # Errors
    ///
    /// [`ClientError::Converter`] and [`ClientError::ConverterNotStarting`]; [`ClientError`].
    pub fn wait_for_converter(&mut self) -> Result<Status, ClientError> {
        let begin = self.line().elapsed();
        let before = self.status()?.conversions;
        loop {
            let status = self.status()?;
            match status.adc {
                AdcState::Running if status.conversions != before => return Ok(status),
                AdcState::Faulty(fault) => return Err(ClientError::Converter(fault)),
                AdcState::Starting | AdcState::Running => {
                    let waited = self.line().elapsed().saturating_sub(begin);
                    if waited > CONVERTER_START {
                        return Err(ClientError::ConverterNotStarting { seconds: waited.as_secs_f64() });
                    }
                    self.wait(CONVERTER_POLL)?;
                }
            }
        }
    }

    /// Has samples sent as they come, or not any more; what was sent before and not taken is thrown away.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn stream(&mut self, kind: StreamKind) -> Result<(), ClientError> {
        if kind == StreamKind::Wrench {
            // So that the wrenches can be read, and their age is known.
            self.read_calibration()?;
            self.output()?;
        }
        self.request_done(Request::Stream(kind))
    }

    /// Starts a trial of this proper rank; before that, the sensor may have to erase a part of its memory for it.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn start_trial(&mut self, rank: u8) -> Result<(), ClientError> {
        self.request_done_within(Request::StartTrial { rank }, memory::STORING)
    }

    /// Stops the trial.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn stop_trial(&mut self) -> Result<TrialStatus, ClientError> {
        self.request_trial(Request::StopTrial)
    }

    /// How far is the trial?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn trial_status(&mut self) -> Result<TrialStatus, ClientError> {
        self.request_trial(Request::TrialStatus)
    }

    /// Has the stopped trial solved on the sensor; takes up to a minute.
    ///
    /// # Errors
    ///
    /// [`ClientError::Refused`] where the trial has no answer; [`ClientError`].
    pub fn solve_trial(&mut self) -> Result<Solution, ClientError> {
        match self.conversation.request(Request::SolveTrial, SOLVING)? {
            Response::Solution(solution) => Ok(solution),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// What has the trial seen by now, and which way is the load to be turned? The trial goes on.
    ///
    /// # Errors
    ///
    /// [`ClientError::Refused`] where it has seen too little to tell; [`ClientError`].
    pub fn coverage(&mut self) -> Result<Coverage, ClientError> {
        match self.conversation.request(Request::Coverage, SOLVING)? {
            Response::Coverage(coverage) => Ok(coverage),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// Has the sensor use this calibration, and makes sure that it does by reading it back.
    ///
    /// # Errors
    ///
    /// [`LinkError::ReadBackDiffers`]; [`ClientError`].
    pub fn upload_calibration(&mut self, upload: &CalibrationUpload) -> Result<(), ClientError> {
        let taken = self.request_calibration(Request::UploadCalibration(upload.clone()))?;
        let read_back = self.request_calibration(Request::ReadCalibration)?;
        if taken.as_ref() == Some(upload) && read_back.as_ref() == Some(upload) {
            Ok(())
        } else {
            Err(LinkError::ReadBackDiffers { uploaded: upload.identity }.into())
        }
    }

    /// Which calibration do you use?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn read_calibration(&mut self) -> Result<Option<CalibrationUpload>, ClientError> {
        self.request_calibration(Request::ReadCalibration)
    }

    /// At which rate do wrenches go out?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn output(&mut self) -> Result<Output, ClientError> {
        self.request_output(None)
    }

    /// Has wrenches go out at the converter's rate by this.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn set_output(&mut self, decimation: Decimation) -> Result<Output, ClientError> {
        self.request_output(Some(decimation))
    }

    /// The next sample of the stream, or `None` where none comes within this time.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub fn next_frame(&mut self, within: Duration) -> Result<Option<Frame>, ClientError> {
        self.conversation.next_frame(within)
    }

    /// Lets time pass; samples that come meanwhile are kept.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub fn wait(&mut self, time: Duration) -> Result<(), ClientError> {
        self.conversation.wait(time)
    }

    fn request_done(&mut self, request: Request) -> Result<(), ClientError> {
        self.request_done_within(request, ANSWER)
    }

    fn request_done_within(&mut self, request: Request, within: Duration) -> Result<(), ClientError> {
        match self.conversation.request(request, within)? {
            Response::Done => Ok(()),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_output(&mut self, decimation: Option<Decimation>) -> Result<Output, ClientError> {
        match self.conversation.request(Request::Output(decimation), ANSWER)? {
            Response::Output(output) => {
                self.conversation.know_filter_delay(filter_delay(output));
                Ok(output)
            }
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_trial(&mut self, request: Request) -> Result<TrialStatus, ClientError> {
        match self.conversation.request(request, ANSWER)? {
            Response::Trial(status) => Ok(status),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_calibration(&mut self, request: Request) -> Result<Option<CalibrationUpload>, ClientError> {
        self.request_calibration_within(request, ANSWER)
    }

    fn request_calibration_within(
        &mut self,
        request: Request,
        within: Duration,
    ) -> Result<Option<CalibrationUpload>, ClientError> {
        match self.conversation.request(request, within)? {
            Response::Calibration(in_use) => {
                let known = |upload: &CalibrationUpload| KnownCalibration {
                    identity: upload.identity,
                    dof: upload.dof,
                };
                self.conversation.know(in_use.as_ref().map(known));
                Ok(in_use)
            }
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }
}

/// What the sensor's filter delays each wrench.
pub fn filter_delay(output: Output) -> Duration {
    Duration::from_secs(output.group_delay_conversions.into()) / output.data_rate.hertz()
}

mod memory;
#[cfg(test)]
mod tests;
