//! The host's side of the conversation with a sensor.
//!
//! A request carries a number, and its response the same number, so that a late response to an earlier request is not
//! taken for this one's. What is not answered in time is asked again where asking twice does no harm: everything but to
//! start or to solve a trial. Samples that come while an answer is awaited are kept for [`Client::next_frame`].
//!
//! A sensor has one host at a time: [`Client::connect`] ends whatever stream an earlier host left running.

mod health;

use std::collections::VecDeque;
use std::time::Duration;

use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::frame::{Decoder, END_OF_FRAME, encode};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, Coverage, Diagnosis, HealthRequest, Hello, PRODUCT, PROTOCOL_VERSION,
    Request, RequestId, Response, Solution, Status, StreamKind, ToDevice, ToHost, TrialStatus,
};

use super::continuity::Continuity;
use super::error::{ClientError, LinkError};
use super::frame::{Frame, KnownCalibration, WrenchSample};
use super::transport::Transport;

/// How long one answer may take. The sensor answers within milliseconds; an emulated one on a busy machine takes longer.
const ANSWER: Duration = Duration::from_secs(1);
/// How often a request is sent before the sensor counts as silent.
const ATTEMPTS: u32 = 3;
/// How long solving a trial may take: 12 gages without hardware for double precision, with a wide margin.
const SOLVING: Duration = Duration::from_mins(1);
/// How long the converter may take to start, retries of its driver included.
const CONVERTER_START: Duration = Duration::from_secs(3);
/// Between two looks at the converter's state.
const CONVERTER_POLL: Duration = Duration::from_millis(20);
/// Samples that are kept while nobody takes them: a minute at 1000 a second.
const KEPT_SAMPLES: usize = 60_000;

/// A conversation with one sensor.
pub struct Client<Line> {
    line: Line,
    decoder: Decoder,
    received: Vec<u8>,
    next_id: RequestId,
    frames: VecDeque<Frame>,
    /// What is streamed.
    streaming: StreamKind,
    /// What will be streamed from the response to this request on.
    next_stream: Option<(RequestId, StreamKind)>,
    continuity: Continuity,
    lost_samples: u64,
    dropped_samples: u64,
    received_bytes: u64,
    broken_frames: u64,
    calibration: Option<KnownCalibration>,
}

/// What the conversation waits for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Awaited {
    Hello,
    Response(RequestId),
    Frame,
}

/// What came of what was waited for.
enum Arrived {
    Hello(Hello),
    Response(Response),
    Frame,
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
        Self {
            line,
            decoder: Decoder::new(),
            received: Vec::new(),
            next_id: 1,
            frames: VecDeque::new(),
            streaming: StreamKind::Off,
            next_stream: None,
            continuity: Continuity::default(),
            lost_samples: 0,
            dropped_samples: 0,
            received_bytes: 0,
            broken_frames: 0,
            calibration: None,
        }
    }

    /// The line.
    pub const fn line(&self) -> &Line {
        &self.line
    }

    /// Samples that are missing between those that came, since the stream was started last: lost by the converter, by the
    /// sensor or on the line.
    pub const fn lost_samples(&self) -> u64 {
        self.lost_samples
    }

    /// Samples that came and were dropped because nobody took them in time.
    pub const fn dropped_samples(&self) -> u64 {
        self.dropped_samples
    }

    /// Frames that came broken.
    pub const fn broken_frames(&self) -> u64 {
        self.broken_frames
    }

    /// Who are you?
    ///
    /// # Errors
    ///
    /// As [`Client::connect`].
    pub fn hello(&mut self) -> Result<Hello, ClientError> {
        match self.converse(&ToDevice::Hello, Awaited::Hello, ANSWER, ATTEMPTS)? {
            Arrived::Hello(hello) if hello.product != PRODUCT => {
                Err(LinkError::OtherProduct { product: hello.product }.into())
            }
            Arrived::Hello(hello) if hello.protocol_version != PROTOCOL_VERSION => {
                Err(LinkError::OtherVersion {
                    device: hello.protocol_version,
                    firmware: hello.firmware_version,
                }
                .into())
            }
            Arrived::Hello(hello) => Ok(hello),
            Arrived::Response(_) | Arrived::Frame => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// How are you?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn status(&mut self) -> Result<Status, ClientError> {
        match self.request(Request::Status, ANSWER)? {
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
        match self.request(Request::Diagnosis, ANSWER)? {
            Response::Diagnosis(diagnosis) => Ok(diagnosis),
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
        self.wait_for_converter()
    }

    /// Waits until the converter runs, which it does when it has delivered a conversion since.
    ///
    /// # Errors
    ///
    /// [`ClientError::Converter`] and [`ClientError::ConverterNotStarting`]; [`ClientError`].
    pub fn wait_for_converter(&mut self) -> Result<Status, ClientError> {
        let begin = self.line.elapsed();
        let before = self.status()?.conversions;
        loop {
            let status = self.status()?;
            match status.adc {
                AdcState::Running if status.conversions != before => return Ok(status),
                AdcState::Faulty(fault) => return Err(ClientError::Converter(fault)),
                AdcState::Starting | AdcState::Running => {
                    let waited = self.line.elapsed().saturating_sub(begin);
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
            // So that the wrenches can be read.
            self.read_calibration()?;
        }
        self.next_stream = Some((self.next_id, kind));
        self.request_done(Request::Stream(kind))
    }

    /// Starts a trial of this proper rank; before that, the sensor may have to erase a part of its memory for it. Not repeated: a second start would be rejected, or drop samples.
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
        match self.request(Request::SolveTrial, SOLVING)? {
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
        match self.request(Request::Coverage, SOLVING)? {
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

    /// The next sample of the stream, or `None` where none comes within this time.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub fn next_frame(&mut self, within: Duration) -> Result<Option<Frame>, ClientError> {
        if self.frames.is_empty() {
            let deadline = self.line.elapsed() + within;
            self.wait_until(Awaited::Frame, deadline)?;
        }
        Ok(self.frames.pop_front())
    }

    /// Lets time pass; samples that come meanwhile are kept.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub fn wait(&mut self, time: Duration) -> Result<(), ClientError> {
        let deadline = self.line.elapsed() + time;
        while self.line.elapsed() < deadline {
            self.wait_until(Awaited::Frame, deadline)?;
        }
        Ok(())
    }

    fn request_done(&mut self, request: Request) -> Result<(), ClientError> {
        self.request_done_within(request, ANSWER)
    }

    fn request_done_within(&mut self, request: Request, within: Duration) -> Result<(), ClientError> {
        match self.request(request, within)? {
            Response::Done => Ok(()),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_trial(&mut self, request: Request) -> Result<TrialStatus, ClientError> {
        match self.request(request, ANSWER)? {
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
        match self.request(request, within)? {
            Response::Calibration(in_use) => {
                self.calibration = in_use
                    .as_ref()
                    .map(|upload| KnownCalibration { identity: upload.identity, dof: upload.dof });
                Ok(in_use)
            }
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// One request and its response.
    fn request(&mut self, request: Request, within: Duration) -> Result<Response, ClientError> {
        let attempts = if is_safe_to_repeat(&request) { ATTEMPTS } else { 1 };
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        let message = ToDevice::Request(id, request);
        match self.converse(&message, Awaited::Response(id), within, attempts)? {
            Arrived::Response(Response::Rejected(rejection)) => Err(ClientError::Rejected(rejection)),
            Arrived::Response(Response::Refused(refusal)) => Err(ClientError::Refused(refusal)),
            Arrived::Response(response) => Ok(response),
            Arrived::Hello(_) | Arrived::Frame => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// Sends a message until what it asks for comes.
    fn converse(
        &mut self,
        message: &ToDevice,
        awaited: Awaited,
        within: Duration,
        attempts: u32,
    ) -> Result<Arrived, LinkError> {
        let frame = encode(message).map_err(|_| LinkError::TooLong)?;
        let begin = self.line.elapsed();
        let (bytes_before, broken_before) = (self.received_bytes, self.broken_frames);
        for _ in 0..attempts {
            // Ends whatever half a frame the other end may have: noise from before the port was opened, say.
            self.line.write(&[END_OF_FRAME])?;
            self.line.write(&frame)?;
            let deadline = self.line.elapsed() + within;
            if let Some(arrived) = self.wait_until(awaited, deadline)? {
                return Ok(arrived);
            }
        }
        let seconds = self.line.elapsed().saturating_sub(begin).as_secs_f64();
        let bytes = self.received_bytes - bytes_before;
        let broken_frames = self.broken_frames - broken_before;
        Err(if bytes == 0 {
            LinkError::Silence { seconds }
        } else {
            LinkError::NoAnswer { seconds, bytes, broken_frames }
        })
    }

    /// Takes in what comes until it is what is awaited, or until the deadline.
    fn wait_until(&mut self, awaited: Awaited, deadline: Duration) -> Result<Option<Arrived>, LinkError> {
        loop {
            self.received.clear();
            self.line.read(&mut self.received, deadline)?;
            self.received_bytes += self.received.len() as u64;
            let mut arrived = None;
            for position in 0..self.received.len() {
                let Some(&byte) = self.received.get(position) else { break };
                match self.decoder.push::<ToHost>(byte) {
                    None => {}
                    Some(Err(_)) => self.broken_frames += 1,
                    Some(Ok(message)) => arrived = self.take_in(message, awaited).or(arrived),
                }
            }
            if arrived.is_some() || self.line.elapsed() >= deadline {
                return Ok(arrived);
            }
        }
    }

    /// Sorts one message: samples are kept, what is awaited is returned, and late responses are dropped.
    fn take_in(&mut self, message: ToHost, awaited: Awaited) -> Option<Arrived> {
        match message {
            ToHost::Hello(hello) => return (awaited == Awaited::Hello).then_some(Arrived::Hello(hello)),
            ToHost::Response(id, response) => {
                if let Some((of, kind)) = self.next_stream
                    && of == id
                    && response == Response::Done
                {
                    self.begin_stream(kind);
                }
                return (awaited == Awaited::Response(id)).then_some(Arrived::Response(response));
            }
            ToHost::Codes(frame) if self.streaming == StreamKind::Codes => self.keep(Frame::Codes(frame)),
            ToHost::Wrench(frame) if self.streaming == StreamKind::Wrench => {
                let Some(samples) = WrenchSample::read(&frame, self.calibration, self.line.elapsed()) else {
                    self.broken_frames += 1;
                    return None;
                };
                for sample in samples {
                    self.keep(Frame::Wrench(sample));
                }
            }
            // Of a stream that was ended.
            ToHost::Codes(_) | ToHost::Wrench(_) => return None,
        }
        (awaited == Awaited::Frame).then_some(Arrived::Frame)
    }

    /// The sensor streams this from now on.
    fn begin_stream(&mut self, kind: StreamKind) {
        self.next_stream = None;
        self.streaming = kind;
        self.continuity = Continuity::default();
        self.lost_samples = 0;
        self.frames.clear();
    }

    fn keep(&mut self, frame: Frame) {
        let (index, stride) = frame.place();
        self.lost_samples += u64::from(self.continuity.missing_before(index, stride));
        if self.frames.len() == KEPT_SAMPLES {
            self.frames.pop_front();
            self.dropped_samples += 1;
        }
        self.frames.push_back(frame);
    }
}

/// Whether a request may be sent again when its response was lost: whether the sensor ends up in the same state, and
/// answers the same. Starting a trial twice is rejected; so is solving one that is being solved, or asking for the coverage
/// of one that is out for it.
const fn is_safe_to_repeat(request: &Request) -> bool {
    match request {
        Request::Status
        | Request::ConfigureAdc(..)
        | Request::Stream(_)
        | Request::StopTrial
        | Request::TrialStatus
        | Request::Diagnosis
        | Request::UploadCalibration(_)
        | Request::ReadCalibration
        | Request::ReadIdentity
        | Request::Memory(_) => true,
        Request::Health(request) => !matches!(request, HealthRequest::StartSelfTest),
        Request::StartTrial { .. } | Request::SolveTrial | Request::Coverage => false,
    }
}

mod memory;
#[cfg(test)]
mod tests;
