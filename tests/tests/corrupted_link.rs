//! A line that corrupts one byte in a thousand, in both directions, between the host's client and the sensor's own code.
//!
//! Bytes are flipped, dropped, doubled and inserted, ten million of them passing. Whatever happens: no wrong value is accepted, no
//! request is served twice, nothing takes for ever, and every sample that does not arrive is counted.

use std::time::Duration;

use ftcal::link::client::Client;
use ftcal::link::error::{ClientError, LinkError};
use ftcal::link::frame::{Frame, Measured, WrenchSample};
use ftcal::link::transport::{Transport, TransportError};
use ftcal_firmware::polled::{EmptyBus, NoDelay, PolledSensor};
use ftcal_firmware::sensor::{LinkCounters, Reaction};
use ftcal_firmware::session::{Order, Session, Ticket};
use ftcal_firmware::storage::job::{StoreJob, Stored};
use ftcal_firmware::stream::{Batcher, Measurement, Moment, WrenchMoment};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::{DeviceTime, Dof, Gain, MAX_DOF, SampleIndex};
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{
    CalibrationUpload, ClockSource, Rejection, Request, Response, StreamKind, ToHost, TrialPhase,
};
use ftcal_tests::random;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// Bytes that pass, in both directions together.
const BYTES: u64 = 10_000_000;

/// How many of them are corrupted.
const CORRUPTED: f64 = 1e-3;

const GAGES: usize = 8;
const HIGHER: usize = higher_moment_count(GAGES);

/// Time between two samples of the stream.
const PERIOD_MICROS: u32 = 125;

/// The force and torque of a sample: whole numbers, which the frames carry exactly.
fn wrench(index: u32) -> [f32; MAX_DOF] {
    let mixed = index.wrapping_mul(2_654_435_761);
    std::array::from_fn(|axis| ((mixed >> (3 * axis)) & 0x7ff) as f32 - 1000.0)
}

/// The sensor at the end of the line, in virtual time. It has no converter; the samples that it streams are made up.
struct Device {
    polled: PolledSensor<EmptyBus, Box<Bins<GAGES, HIGHER>>, GAGES, HIGHER>,
    session: Session,
    batcher: Batcher,
    now: DeviceTime,
    streaming: bool,
    next: u32,
    calibration: u32,
    last_served: Option<Ticket>,
    served: u64,
}

impl Device {
    fn new() -> Self {
        Self {
            polled: PolledSensor::new(EmptyBus, Box::new(Bins::new()), ClockSource::Simulated),
            session: Session::new(),
            batcher: Batcher::new(),
            now: DeviceTime::default(),
            streaming: false,
            // The numbers are about to wrap around.
            next: u32::MAX - 10_000,
            calibration: 0,
            last_served: None,
            served: 0,
        }
    }

    fn receive(&mut self, byte: u8) -> Option<ToHost> {
        let (ticket, response) = match self.session.on_byte(byte, self.now)? {
            Order::Send(message) => return Some(message),
            Order::ChangeRate(ticket, _) => (ticket, Response::Rejected(Rejection::UnsupportedRate)),
            Order::Serve(ticket, request) => (ticket, self.serve(ticket, request)),
        };
        self.session.answer(ticket, response)
    }

    fn serve(&mut self, ticket: Ticket, request: Request) -> Response {
        assert_ne!(self.last_served, Some(ticket), "a request is served once");
        self.last_served = Some(ticket);
        self.served += 1;
        if let Request::Stream(kind) = request {
            self.streaming = kind == StreamKind::Wrench;
            self.batcher.clear();
        }
        let response = match self.polled.sensor.answer(request, self.now, LinkCounters::default()) {
            Reaction::Respond(response) => response,
            Reaction::Store(StoreJob::PrepareTrial { rank, .. }) => {
                self.polled.sensor.finish_storing(Stored::Prepared { rank })
            }
            Reaction::Diagnose | Reaction::Store(_) => panic!("nobody asks for that"),
            Reaction::Solve(mut job) => {
                let response = job.response();
                self.polled.sensor.finish_solving(job);
                response
            }
        };
        if let Response::Calibration(Some(upload)) = &response {
            self.calibration = upload.identity;
        }
        response
    }

    /// Lives through one sample period.
    fn live(&mut self) -> Option<ToHost> {
        self.now = DeviceTime::from_micros(self.now.as_micros() + u64::from(PERIOD_MICROS));
        if self.session.watch(self.now).end_stream {
            self.polled.sensor.abandon_stream();
            self.streaming = false;
        }
        let index = self.next;
        self.next = index.wrapping_add(1);
        let mut moment = self.streaming.then(|| {
            Moment::Wrench(WrenchMoment {
                index: SampleIndex::new(index),
                stride: 1,
                time: self.now,
                announced: self.now,
                period_nanos: 1000 * PERIOD_MICROS,
                status: 0,
                parity: None,
                basis: 0,
                measurement: Measurement::Valid {
                    wrench: wrench(index),
                    axes: 6,
                    calibration: self.calibration,
                },
            })
        });
        self.batcher.next(self.now, true, || moment.take())
    }
}

/// What lies between the two, in both directions.
struct Line {
    device: Device,
    noise: ChaCha8Rng,
    to_host: Vec<u8>,
    bytes: u64,
    corrupted: u64,
}

impl Line {
    /// What arrives of these bytes.
    fn pass(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut arriving = Vec::with_capacity(bytes.len() + 8);
        for &byte in bytes {
            self.bytes += 1;
            if !self.noise.random_bool(CORRUPTED) {
                arriving.push(byte);
                continue;
            }
            self.corrupted += 1;
            match self.noise.random_range(0..4) {
                0 => arriving.push(byte ^ 1 << self.noise.random_range(0..8)),
                1 => {}
                2 => arriving.extend([byte, byte]),
                _ => arriving.extend([self.noise.next_u32().to_le_bytes()[0], byte]),
            }
        }
        arriving
    }

    fn send(&mut self, message: &ToHost) {
        let frame = encode(message).expect("every message fits");
        let arriving = self.pass(&frame);
        self.to_host.extend(arriving);
    }
}

impl Transport for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        for byte in self.pass(bytes) {
            if let Some(message) = self.device.receive(byte) {
                self.send(&message);
            }
        }
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        while self.to_host.is_empty() && self.elapsed() < deadline {
            // The tick, of which a converter that is missing makes nothing, only now and then.
            if self.device.now.as_micros().is_multiple_of(10_000) {
                self.device.polled.tick(self.device.now, &mut NoDelay);
            }
            if let Some(message) = self.device.live() {
                self.send(&message);
            }
        }
        received.append(&mut self.to_host);
        Ok(self.elapsed())
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.device.now.as_micros())
    }

    fn set_baud(&mut self, _baud: u32) -> Result<(), TransportError> {
        Ok(())
    }
}

/// What came of a request: its answer, or that there is none, within bounded time. Nothing else may come of it.
fn outcome<T>(
    client: &mut Client<Line>,
    ask: impl FnOnce(&mut Client<Line>) -> Result<T, ClientError>,
) -> Option<T> {
    let begin = client.line().elapsed();
    let asked = ask(client);
    // Several requests may be behind one question.
    assert!(client.line().elapsed() < begin + Duration::from_secs(20), "it takes bounded time");
    match asked {
        Ok(answer) => Some(answer),
        Err(ClientError::Link(LinkError::NoAnswer { .. } | LinkError::Silence { .. })) => None,
        Err(error) => panic!("{error}"),
    }
}

fn random_calibration(rng: &mut ChaCha8Rng) -> CalibrationUpload {
    let mut upload = CalibrationUpload {
        dof: Dof::SpatialForceTorque,
        gain: Gain::ALL[rng.random_range(0..Gain::ALL.len())],
        bias_counts: (0..GAGES).map(|_| rng.random_range(-1e5..1e5)).collect(),
        matrix: (0..6 * GAGES).map(|_| rng.random_range(-1.0_f32..1.0)).collect(),
        identity: 0,
    };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// Streams for a while: how many samples came, and how many are missing between them.
fn stream(client: &mut Client<Line>, samples: u32) -> Option<(u64, u64)> {
    outcome(client, |client| client.stream(StreamKind::Wrench))?;
    let mut ends: Option<(WrenchSample, WrenchSample)> = None;
    for taken in 1..=samples {
        let frame = client.next_frame(Duration::from_millis(500)).expect("the line stays open");
        let Some(Frame::Wrench(sample)) = frame else { panic!("{frame:?} is no wrench") };
        let Measured::Valid(measured) = sample.at_any_age() else { panic!("{:?}", sample.at_any_age()) };
        assert_eq!(measured.components(), wrench(sample.index.get()), "as it was sent");
        assert_eq!(measured.calibration(), client.line().device.calibration);
        let first = ends.map_or(sample, |(first, _)| first);
        ends = Some((first, sample));
        let place = u64::from(sample.index.since(first.index));
        let micros = sample.time.as_micros() - first.time.as_micros();
        assert_eq!(micros, place * u64::from(PERIOD_MICROS), "taken when it says");
        if taken == samples {
            assert_eq!(client.lost_samples() + u64::from(samples), place + 1, "every loss is counted");
        }
    }
    let mut came = u64::from(samples);
    let (first, mut last) = ends?;
    // Take what is waiting: then the account is complete.
    while let Some(Frame::Wrench(sample)) = client.next_frame(Duration::ZERO).expect("the line stays open") {
        came += 1;
        last = sample;
    }
    let span = u64::from(last.index.since(first.index)) + 1;
    assert_eq!(came + client.lost_samples(), span, "every loss is counted");
    Some((came, client.lost_samples()))
}

#[test]
fn nothing_wrong_is_accepted_and_every_loss_is_counted() {
    let mut rng = random(1);
    let noise = random(2);
    let line = Line { device: Device::new(), noise, to_host: Vec::new(), bytes: 0, corrupted: 0 };
    let mut client = Client::connect(line).expect("one of many greetings arrives");
    let (mut unanswered, mut came, mut lost) = (0_u64, 0_u64, 0_u64);
    while client.line().bytes < BYTES {
        let upload = random_calibration(&mut rng);
        let before = client.line().device.calibration;
        if outcome(&mut client, |client| client.upload_calibration(&upload)).is_some() {
            assert_eq!(client.line().device.calibration, upload.identity);
        } else {
            unanswered += 1;
            assert!([before, upload.identity].contains(&client.line().device.calibration));
        }
        if outcome(&mut client, |client| client.start_trial(3)).is_some() {
            if let Some(status) = outcome(&mut client, Client::trial_status) {
                assert_eq!((status.phase, status.rank), (TrialPhase::Running, 3));
            }
        } else {
            unanswered += 1;
        }
        // A trial that was started unheard is stopped, too; one that was not is no trial of this round.
        match client.stop_trial() {
            Ok(status) => assert_eq!(status.phase, TrialPhase::Stopped),
            Err(ClientError::Rejected(Rejection::NoTrial) | ClientError::Link(_)) => unanswered += 1,
            Err(error) => panic!("{error}"),
        }
        if let Some((arrived, missing)) = stream(&mut client, 500) {
            came += arrived;
            lost += missing;
        }
        if outcome(&mut client, |client| client.stream(StreamKind::Off)).is_none() {
            unanswered += 1;
        }
    }
    let line = client.line();
    println!(
        "{} bytes, {} corrupted; {} requests served, {unanswered} unanswered; {came} samples came, {lost} were lost; \
         {} frames came broken",
        line.bytes,
        line.corrupted,
        line.device.served,
        client.broken_frames()
    );
    // One byte costs two frames at most: where the end of one is lost, the next one goes with it.
    assert!(lost <= 2 * 20 * line.corrupted, "{lost}");
    // It was a test: much was lost, and most came through.
    assert!(lost > 10_000 && came > lost && client.broken_frames() > 1000);
    assert!(unanswered * 20 < line.device.served, "{unanswered}");
}
