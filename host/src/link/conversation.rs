//! What any conversation with a sensor is made of: requests and their responses, samples between them, and the rate of the line.
//!
//! What is not answered in time is asked again under the same number, until it is answered or too much time has passed. The sensor
//! serves each number once and repeats its answer, so that nothing is done twice; a late response to an earlier request bears
//! another number and is dropped. A sensor that streams stops where its host says nothing for some seconds, so whoever waits for
//! samples here asks how the sensor is now and then.
//!
//! The conversation begins at [`DEFAULT_BAUD`], where a sensor that was left at another rate is again after some seconds, too. Where
//! the line falls silent at another rate, both ends go back.

use std::collections::VecDeque;
use std::time::Duration;

use ftcal_firmware::baud::DEFAULT_BAUD;
use ftcal_shared::wire::frame::{Decoder, END_OF_FRAME, encode};
use ftcal_shared::wire::{
    Hello, PRODUCT, PROTOCOL_VERSION, Rejection, Request, RequestId, Response, StreamKind, ToDevice, ToHost,
};

use super::continuity::Continuity;
use super::error::{ClientError, LinkError};
use super::frame::{Frame, KnownCalibration, WrenchSample};
use super::tally::Tally;
use super::transport::Transport;

/// How long the greeting may take: a sensor that was left at another rate finds back within five seconds, hears the next
/// repetition half a second later, and what it answers may still end what it said at the wrong rate, and be lost with that.
const GREETING: Duration = Duration::from_secs(7);
/// When an unanswered request is sent again.
const REPETITION: Duration = Duration::from_millis(500);
/// How long a host that is being sent samples may be silent: a fraction of what the sensor allows.
const SIGN_OF_LIFE: Duration = Duration::from_secs(1);
/// How long the sensor is given to change its rate after the answer.
const RATE_CHANGE: Duration = Duration::from_millis(50);
/// How long the first answer at a new rate may take: the sensor waits for a second.
const FIRST_ANSWER: Duration = Duration::from_millis(700);
/// When the sensor is back at its usual rate after another did not work.
const FALL_BACK: Duration = Duration::from_millis(1200);
/// How long the memory may be at work: while it is, nothing is begun that it would hold up.
const STORING: Duration = Duration::from_secs(5);
/// Between two questions whether it is done.
const STORING_POLL: Duration = Duration::from_millis(20);
/// Samples that are kept while nobody takes them: a minute at 1000 a second.
const KEPT_SAMPLES: usize = 60_000;

/// One end of a line, with a sensor at the other.
pub(super) struct Conversation<Line: Transport> {
    line: Line,
    baud: u32,
    /// When something was sent last.
    last_sent: Duration,
    decoder: Decoder,
    received: Vec<u8>,
    next_id: RequestId,
    frames: VecDeque<Frame>,
    /// What is streamed.
    streaming: StreamKind,
    /// What will be streamed from the response to this request on.
    next_stream: Option<(RequestId, StreamKind)>,
    continuity: Continuity,
    tally: Tally,
    calibration: Option<KnownCalibration>,
    /// What the sensor's filter delays each wrench.
    filter_delay: Duration,
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

impl<Line: Transport> Conversation<Line> {
    /// A conversation that has yet to begin, with the greeting.
    pub(super) fn new(line: Line) -> Self {
        Self {
            last_sent: line.elapsed(),
            line,
            baud: DEFAULT_BAUD,
            decoder: Decoder::new(),
            received: Vec::new(),
            next_id: 1,
            frames: VecDeque::new(),
            streaming: StreamKind::Off,
            next_stream: None,
            continuity: Continuity::default(),
            tally: Tally::default(),
            calibration: None,
            filter_delay: Duration::ZERO,
        }
    }

    /// The line.
    pub(super) const fn line(&self) -> &Line {
        &self.line
    }

    /// What was counted.
    pub(super) const fn tally(&self) -> &Tally {
        &self.tally
    }

    /// The baud rate.
    pub(super) const fn baud(&self) -> u32 {
        self.baud
    }

    /// Wrenches are made with this calibration.
    pub(super) const fn know(&mut self, calibration: Option<KnownCalibration>) {
        self.calibration = calibration;
    }

    /// Wrenches have come through a filter that delays them so much.
    pub(super) const fn know_filter_delay(&mut self, delay: Duration) {
        self.filter_delay = delay;
    }

    /// Who are you?
    ///
    /// # Errors
    ///
    /// [`LinkError::Silence`], [`LinkError::NoAnswer`], [`LinkError::OtherProduct`], [`LinkError::OtherVersion`].
    pub(super) fn hello(&mut self) -> Result<Hello, ClientError> {
        self.greet(GREETING)
    }

    fn greet(&mut self, within: Duration) -> Result<Hello, ClientError> {
        match self.converse(&ToDevice::Hello, Awaited::Hello, within)? {
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

    /// Goes on at another baud rate, or as before where the sensor does not have it or the line does not carry it.
    ///
    /// # Errors
    ///
    /// [`ClientError::Rejected`], [`LinkError::RateDoesNotWork`].
    pub(super) fn change_rate(&mut self, baud: u32) -> Result<(), ClientError> {
        if self.request(Request::ChangeRate(baud), FIRST_ANSWER)? != Response::Done {
            return Err(LinkError::UnexpectedResponse.into());
        }
        self.wait(RATE_CHANGE)?;
        // Half a frame of the old rate is no beginning of one of the new.
        self.decoder = Decoder::new();
        let works = self.line.set_baud(baud).is_ok() && self.greet(FIRST_ANSWER).is_ok();
        if works {
            self.baud = baud;
            return Ok(());
        }
        self.fall_back()?;
        self.wait(FALL_BACK)?;
        self.hello()?;
        Err(LinkError::RateDoesNotWork { baud }.into())
    }

    /// Goes back to the usual rate. The sensor does so by itself.
    fn fall_back(&mut self) -> Result<(), LinkError> {
        self.baud = DEFAULT_BAUD;
        self.decoder = Decoder::new();
        Ok(self.line.set_baud(DEFAULT_BAUD)?)
    }

    /// The next sample of the stream, or `None` where none comes within this time.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub(super) fn next_frame(&mut self, within: Duration) -> Result<Option<Frame>, ClientError> {
        if self.frames.is_empty() {
            let deadline = self.line.elapsed() + within;
            self.wait_until(Awaited::Frame, deadline)?;
        }
        let frame = self.frames.pop_front();
        if let Some(frame) = &frame {
            let (index, stride) = frame.place();
            self.tally.lost_samples += u64::from(self.continuity.missing_before(index, stride));
        }
        Ok(frame)
    }

    /// Lets time pass; samples that come meanwhile are kept.
    ///
    /// # Errors
    ///
    /// [`LinkError::Line`].
    pub(super) fn wait(&mut self, time: Duration) -> Result<(), ClientError> {
        let deadline = self.line.elapsed() + time;
        while self.line.elapsed() < deadline {
            self.wait_until(Awaited::Frame, deadline)?;
        }
        Ok(())
    }

    /// One request and its response. Where the sensor is just writing to its memory, the request is made again when it is done.
    pub(super) fn request(&mut self, request: Request, within: Duration) -> Result<Response, ClientError> {
        let begin = self.line.elapsed();
        while self.line.elapsed() < begin + STORING {
            match self.request_once(request.clone(), within) {
                Err(ClientError::Rejected(Rejection::Storing)) => self.wait(STORING_POLL)?,
                other => return other,
            }
        }
        self.request_once(request, within)
    }

    fn request_once(&mut self, request: Request, within: Duration) -> Result<Response, ClientError> {
        let id = self.number();
        if let Request::Stream(kind) = request {
            self.next_stream = Some((id, kind));
        }
        let message = ToDevice::Request(id, request);
        match self.converse(&message, Awaited::Response(id), within)? {
            Arrived::Response(Response::Rejected(rejection)) => Err(ClientError::Rejected(rejection)),
            Arrived::Response(Response::Refused(refusal)) => Err(ClientError::Refused(refusal)),
            Arrived::Response(response) => Ok(response),
            Arrived::Hello(_) | Arrived::Frame => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    /// A number for the next request.
    const fn number(&mut self) -> RequestId {
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        id
    }

    /// Sends a message until what it asks for comes.
    fn converse(
        &mut self,
        message: &ToDevice,
        awaited: Awaited,
        within: Duration,
    ) -> Result<Arrived, LinkError> {
        let begin = self.line.elapsed();
        let (bytes_before, broken_before) = (self.tally.received_bytes, self.tally.broken_frames);
        let mut last = begin + within;
        while self.line.elapsed() < last {
            self.send(message)?;
            let until = (self.line.elapsed() + REPETITION).min(last);
            if let Some(arrived) = self.wait_until(awaited, until)? {
                return Ok(arrived);
            }
            self.tally.repetitions += 1;
            if self.baud != DEFAULT_BAUD && self.line.elapsed() >= last {
                // The sensor has been at its usual rate for a while if it has not heard anything.
                self.fall_back()?;
                last += within.max(FALL_BACK);
            }
        }
        let seconds = self.line.elapsed().saturating_sub(begin).as_secs_f64();
        let bytes = self.tally.received_bytes - bytes_before;
        let broken_frames = self.tally.broken_frames - broken_before;
        Err(if bytes == 0 {
            LinkError::Silence { seconds }
        } else {
            LinkError::NoAnswer { seconds, bytes, broken_frames }
        })
    }

    fn send(&mut self, message: &ToDevice) -> Result<(), LinkError> {
        let frame = encode(message).map_err(|_| LinkError::TooLong)?;
        // Ends whatever half a frame the other end may have: noise from before the port was opened, say.
        self.line.write(&[END_OF_FRAME])?;
        self.line.write(&frame)?;
        self.last_sent = self.line.elapsed();
        Ok(())
    }

    /// Says something, where a sensor that streams has not heard anything for a while. The answer is not waited for.
    fn show_sign_of_life(&mut self) -> Result<(), LinkError> {
        if self.line.elapsed().saturating_sub(self.last_sent) < SIGN_OF_LIFE {
            return Ok(());
        }
        let message = ToDevice::Request(self.number(), Request::Status);
        self.send(&message)
    }

    /// Takes in what comes until it is what is awaited, or until the deadline.
    fn wait_until(&mut self, awaited: Awaited, deadline: Duration) -> Result<Option<Arrived>, LinkError> {
        let streams = awaited == Awaited::Frame && self.streaming != StreamKind::Off;
        loop {
            let mut until = deadline;
            if streams {
                self.show_sign_of_life()?;
                until = until.min(self.last_sent + SIGN_OF_LIFE);
            }
            self.received.clear();
            let came = self.line.read(&mut self.received, until)?;
            self.tally.received_bytes += self.received.len() as u64;
            let mut arrived = None;
            for position in 0..self.received.len() {
                let Some(&byte) = self.received.get(position) else { break };
                match self.decoder.push::<ToHost>(byte) {
                    None => {}
                    Some(Err(_)) => self.tally.broken_frames += 1,
                    Some(Ok(message)) => arrived = self.take_in(message, came, awaited).or(arrived),
                }
            }
            // What has come by the deadline is looked through, however much it is; on a line that is never silent, what comes later is not.
            let is_over = came >= deadline || self.received.is_empty() && self.line.elapsed() >= deadline;
            if arrived.is_some() || is_over {
                return Ok(arrived);
            }
        }
    }

    /// Sorts one message, whose last byte came at this time: samples are kept, what is awaited is returned, and late responses are
    /// dropped.
    fn take_in(&mut self, message: ToHost, came: Duration, awaited: Awaited) -> Option<Arrived> {
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
                let read = WrenchSample::read(&frame, self.calibration, self.filter_delay, came);
                let Some(samples) = read else {
                    self.tally.broken_frames += 1;
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
        self.tally.lost_samples = 0;
        self.frames.clear();
    }

    fn keep(&mut self, frame: Frame) {
        if self.frames.len() == KEPT_SAMPLES {
            self.frames.pop_front();
            self.tally.dropped_samples += 1;
        }
        self.frames.push_back(frame);
    }
}

impl<Line: Transport> Drop for Conversation<Line> {
    /// Leaves the sensor at its usual rate, where the next host looks for it. Where this is lost, the sensor goes back by itself.
    fn drop(&mut self) {
        if self.baud != DEFAULT_BAUD {
            let message = ToDevice::Request(self.number(), Request::ChangeRate(DEFAULT_BAUD));
            let _ = self.send(&message);
        }
    }
}
