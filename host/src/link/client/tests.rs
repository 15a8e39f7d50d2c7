use std::time::Duration;

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{DataRate, Dof, Gain, MAX_GAGES};
use ftcal_shared::wire::frame::{Decoder, encode};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, GageList, Hello, PRODUCT, PROTOCOL_VERSION, Rejection, Request, Response,
    Status, StreamKind, ToDevice, ToHost, TrialPhase,
};
use nalgebra::Vector3;

use super::{ATTEMPTS, Client};
use crate::link::error::{ClientError, LinkError};
use crate::link::frame::{Frame, Measured, NoWrench};
use crate::link::transport::{Transport, TransportError};
use crate::simulator::board::SimulatedBoard;
use crate::simulator::fault::{Fault, Rail};
use crate::simulator::scenario::{Scenario, ScenarioKind};

fn board(kind: ScenarioKind) -> SimulatedBoard {
    let scenario = Scenario::new(kind, 1).expect("sizes fit");
    let board = SimulatedBoard::for_scenario(&scenario, 1).expect("sizes fit");
    board.bench().with(|bench| bench.hang(scenario.trials[0].load));
    board
}

fn client(kind: ScenarioKind) -> Client<SimulatedBoard> {
    Client::connect(board(kind)).expect("the simulated board answers")
}

/// A calibration that reads the first two gages as forces in the plane, in counts.
fn first_gages(gages: usize) -> CalibrationUpload {
    let mut matrix = heapless::Vec::new();
    for axis in 0..2 {
        for gage in 0..gages {
            matrix.push(if axis == gage { 1.0 } else { 0.0 }).expect("fits");
        }
    }
    let mut bias_counts = GageList::new();
    bias_counts.resize(gages, 0.0).expect("fits");
    let mut upload = CalibrationUpload { dof: Dof::PlanarForce, bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// A line that does something to what passes over it.
struct Tampered<Tamper> {
    board: SimulatedBoard,
    tamper: Tamper,
    writes: usize,
}

impl<Tamper: FnMut(usize, &mut Vec<u8>)> Tampered<Tamper> {
    fn new(tamper: Tamper) -> Self {
        Self { board: board(ScenarioKind::Fingertip), tamper, writes: 0 }
    }
}

/// `tamper` sees the number of messages sent so far and what has come back.
impl<Tamper: FnMut(usize, &mut Vec<u8>)> Transport for Tampered<Tamper> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.writes += usize::from(bytes.len() > 1);
        self.board.write(bytes)
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<(), TransportError> {
        let mut passing = Vec::new();
        self.board.read(&mut passing, deadline)?;
        (self.tamper)(self.writes, &mut passing);
        received.append(&mut passing);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.board.elapsed()
    }
}

/// A line whose other end answers as told.
struct Scripted<Answer> {
    answer: Answer,
    decoder: Decoder,
    pending: Vec<u8>,
    now: Duration,
}

impl<Answer: FnMut(ToDevice) -> Option<ToHost>> Scripted<Answer> {
    fn new(answer: Answer) -> Self {
        Self { answer, decoder: Decoder::new(), pending: Vec::new(), now: Duration::ZERO }
    }
}

impl<Answer: FnMut(ToDevice) -> Option<ToHost>> Transport for Scripted<Answer> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        for &byte in bytes {
            if let Some(message) = self.decoder.push(byte)
                && let Some(answer) = (self.answer)(message.expect("the client sends whole frames"))
            {
                self.pending.extend(encode(&answer).expect("fits"));
            }
        }
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<(), TransportError> {
        if self.pending.is_empty() {
            self.now = self.now.max(deadline);
        }
        received.append(&mut self.pending);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.now
    }
}

const HELLO: Hello =
    Hello { product: PRODUCT, protocol_version: PROTOCOL_VERSION, firmware_version: [1, 2, 3] };

#[test]
fn every_request_has_its_answer() {
    for kind in ScenarioKind::ALL {
        let mut client = client(kind);
        let bench = client.line().bench();
        let sensor = bench.with(|bench| bench.sensor().clone());
        assert_eq!(client.hello().expect("answers").protocol_version, PROTOCOL_VERSION);

        let status = client.configure_adc(DataRate::Hz500, Gain::X128).expect("the converter starts");
        assert_eq!((status.adc, status.data_rate), (AdcState::Running, DataRate::Hz500));
        assert_eq!(usize::from(status.gages), sensor.gages());

        assert!(client.read_calibration().expect("answers").is_none());
        let rank = u8::try_from(sensor.dof().trial_rank()).expect("two or three");
        bench.with(|bench| if rank == 3 { bench.turn() } else { turn_in_plane(bench) });
        client.start_trial(rank).expect("no trial is running");
        client.wait(Duration::from_secs(40)).expect("virtual time passes");
        assert_eq!(client.trial_status().expect("answers").phase, TrialPhase::Running);
        let stopped = client.stop_trial().expect("a trial is running");
        assert_eq!(stopped.phase, TrialPhase::Stopped);
        assert!(stopped.used > 19_000, "40 s at 500 samples a second: {}", stopped.used);
        let solution = client.solve_trial().expect("the motion spans");
        assert_eq!(solution.rank, rank);
        // What the answer left out is counted: no sample is lost between the trial and its solution.
        let solved = client.trial_status().expect("answers");
        assert_eq!(solution.samples + solved.moving, stopped.used);

        let upload = first_gages(sensor.gages());
        client.upload_calibration(&upload).expect("a sound calibration");
        assert_eq!(client.status().expect("answers").calibration, Some(upload.identity));
        assert_eq!(client.read_calibration().expect("answers"), Some(upload));
    }
}

fn turn_in_plane(bench: &mut crate::simulator::bench::Bench) {
    bench.hold(-Vector3::y_axis());
    bench.turn_in_plane(crate::simulator::motion::Turning::Counterclockwise);
}

#[test]
fn samples_come_in_order_and_stop_when_told() {
    let mut client = client(ScenarioKind::Force);
    client.wait_for_converter().expect("the converter starts");
    client.stream(StreamKind::Codes).expect("answers");
    let mut next = None;
    for sample in 0..500 {
        if sample % 100 == 0 {
            client.status().expect("answers in the middle of a stream");
        }
        let frame = client.next_frame(Duration::from_millis(100)).expect("the line is sound");
        let Some(Frame::Codes(frame)) = frame else { panic!("a raw sample was expected") };
        assert_eq!(frame.codes.len(), 6);
        assert!(next.is_none_or(|next| frame.index == next), "no sample is lost");
        next = Some(frame.index.next());
    }
    assert_eq!(client.dropped_samples(), 0);
    client.stream(StreamKind::Off).expect("answers");
    assert_eq!(client.next_frame(Duration::from_secs(1)).expect("the line is sound"), None);
}

#[test]
fn wrenches_are_read_with_the_calibration_in_use() {
    let mut client = client(ScenarioKind::Fingertip);
    client.wait_for_converter().expect("the converter starts");
    client.stream(StreamKind::Wrench).expect("answers");
    let next = |client: &mut Client<SimulatedBoard>| match client
        .next_frame(Duration::from_millis(100))
        .expect("the line is sound")
    {
        Some(Frame::Wrench(sample)) => sample.measured,
        other => panic!("a wrench was expected, not {other:?}"),
    };
    assert_eq!(next(&mut client), Measured::Invalid(NoWrench::Uncalibrated));

    client.upload_calibration(&first_gages(4)).expect("a sound calibration");
    client.stream(StreamKind::Wrench).expect("answers");
    let Measured::Valid(wrench) = next(&mut client) else { panic!("the sensor is calibrated") };
    assert_eq!(wrench.dof(), Dof::PlanarForce);
    let (truth, noise) = client.line().bench().with(|bench| {
        let counts = bench.sensor().noiseless_counts(&bench.true_wrench());
        (counts, bench.sensor().noise_counts().max())
    });
    for (component, counts) in wrench.components().iter().zip(truth.iter()) {
        assert!((f64::from(*component) - counts).abs() < 8.0 * noise + 1.0);
    }

    // Counts at another gain are of another size: the calibration no longer holds, until the gain is set back.
    client.configure_adc(DataRate::Hz1000, Gain::X64).expect("the converter starts");
    client.stream(StreamKind::Wrench).expect("answers");
    assert_eq!(next(&mut client), Measured::Invalid(NoWrench::GainChanged));
    client.configure_adc(DataRate::Hz1000, Gain::X128).expect("the converter starts");
    client.stream(StreamKind::Wrench).expect("answers");
    assert!(matches!(next(&mut client), Measured::Valid(_)));

    let saturated = Fault::SaturatedChannel { channel: 2, rail: Rail::High };
    client.line().bench().with(|bench| bench.inject(saturated));
    client.wait(Duration::from_millis(20)).expect("virtual time passes");
    client.stream(StreamKind::Wrench).expect("answers");
    assert_eq!(next(&mut client), Measured::Invalid(NoWrench::Saturated(0b100)));
}

#[test]
fn frames_that_nobody_takes_are_dropped_oldest_first_and_counted() {
    let mut client = client(ScenarioKind::Fingertip);
    client.configure_adc(DataRate::Hz1000, Gain::X128).expect("the converter starts");
    client.stream(StreamKind::Codes).expect("answers");
    client.wait(Duration::from_secs(70)).expect("virtual time passes");
    let kept = u64::try_from(client.frames.len()).expect("fits");
    assert_eq!(kept, 60_000);
    let dropped = client.dropped_samples();
    assert!((9_900..=10_100).contains(&dropped), "{dropped} of 70 000");
}

#[test]
fn what_is_rejected_says_why() {
    let mut client = client(ScenarioKind::Fingertip);
    let rejected = |result: Result<(), ClientError>| match result {
        Err(ClientError::Rejected(rejection)) => rejection,
        other => panic!("a rejection was expected, not {other:?}"),
    };
    assert_eq!(rejected(client.stop_trial().map(drop)), Rejection::NoTrial);
    assert_eq!(rejected(client.start_trial(4)), Rejection::UnsupportedRank);
    assert_eq!(rejected(client.upload_calibration(&first_gages(6))), Rejection::WrongDimensions);
    client.start_trial(2).expect("no trial is running");
    assert_eq!(rejected(client.configure_adc(DataRate::Hz250, Gain::X1).map(drop)), Rejection::TrialBusy);
    client.stop_trial().expect("a trial is running");
    assert!(matches!(client.solve_trial(), Err(ClientError::Refused(_))), "nothing has turned");
}

#[test]
fn garbage_on_the_line_is_skipped_and_counted() {
    let mut noise = 1_u32;
    let line = Tampered::new(|_, passing: &mut Vec<u8>| {
        // Before each piece that comes, some bytes of a linear congruential sequence, and an end of frame.
        let garbage = (0..40).map(|_| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            noise.to_be_bytes()[0]
        });
        let mut with_garbage: Vec<u8> = garbage.chain([0]).collect();
        with_garbage.append(passing);
        *passing = with_garbage;
    });
    let mut client = Client::connect(line).expect("answers in spite of the noise");
    client.wait_for_converter().expect("answers in spite of the noise");
    assert!(client.broken_frames() > 0);
}

#[test]
fn a_lost_answer_is_asked_for_again_where_that_is_safe() {
    // Everything that comes back after the third message (hello, stream off, status) was sent is lost.
    let losing = |writes: usize, passing: &mut Vec<u8>| {
        if writes == 3 {
            passing.clear();
        }
    };
    let mut client = Client::connect(Tampered::new(losing)).expect("answers");
    client.status().expect("answers the second time");
    assert_eq!(client.line.writes, 4);

    let mut client = Client::connect(Tampered::new(losing)).expect("answers");
    assert!(matches!(client.start_trial(2), Err(ClientError::Link(LinkError::Silence { .. }))));
    assert_eq!(client.line.writes, 3, "a start is not repeated");
}

#[test]
fn a_late_answer_is_not_taken_for_another() {
    let mut held = None;
    let mut client = Client::over(Scripted::new(move |message| {
        let ToDevice::Request(id, request) = message else { return Some(ToHost::Hello(HELLO)) };
        match request {
            Request::StartTrial { .. } => {
                held = Some(ToHost::Response(id, Response::Done));
                None
            }
            // The start's answer comes now, and the stop's never.
            _ => held.take(),
        }
    }));
    assert!(client.start_trial(3).is_err());
    assert!(matches!(
        client.stop_trial(),
        Err(ClientError::Link(LinkError::NoAnswer { broken_frames: 0, .. }))
    ));
}

#[test]
fn silence_is_told_from_noise_and_takes_bounded_time() {
    let mut sent = 0;
    let mut silent = Client::over(Scripted::new(|_| {
        sent += 1;
        None
    }));
    let error = silent.hello().expect_err("nobody is there");
    assert!(
        matches!(error, ClientError::Link(LinkError::Silence { seconds }) if (1.0..10.0).contains(&seconds))
    );
    drop(silent);
    assert_eq!(sent, ATTEMPTS);
}

#[test]
fn only_a_sensor_of_this_protocol_is_talked_to() {
    let connect = |hello: Hello| Client::connect(Scripted::new(move |_| Some(ToHost::Hello(hello)))).err();
    assert!(matches!(
        connect(Hello { protocol_version: PROTOCOL_VERSION + 1, ..HELLO }),
        Some(ClientError::Link(LinkError::OtherVersion { device, firmware: [1, 2, 3] })) if device == PROTOCOL_VERSION + 1
    ));
    assert!(matches!(
        connect(Hello { product: *b"toast", ..HELLO }),
        Some(ClientError::Link(LinkError::OtherProduct { product })) if &product == b"toast"
    ));
}

#[test]
fn a_calibration_counts_as_uploaded_when_it_reads_back() {
    let mut client = Client::over(Scripted::new(|message| match message {
        ToDevice::Hello => Some(ToHost::Hello(HELLO)),
        ToDevice::Request(id, Request::UploadCalibration(upload)) => {
            Some(ToHost::Response(id, Response::Calibration(Some(upload))))
        }
        ToDevice::Request(id, _) => Some(ToHost::Response(id, Response::Calibration(None))),
    }));
    let upload = first_gages(MAX_GAGES);
    assert!(matches!(
        client.upload_calibration(&upload),
        Err(ClientError::Link(LinkError::ReadBackDiffers { uploaded })) if uploaded == upload.identity
    ));
}

#[test]
fn an_answer_of_another_kind_is_an_error() {
    let mut client = Client::over(Scripted::new(|message| match message {
        ToDevice::Hello => Some(ToHost::Hello(HELLO)),
        ToDevice::Request(id, _) => Some(ToHost::Response(id, Response::Done)),
    }));
    assert!(matches!(client.status(), Err(ClientError::Link(LinkError::UnexpectedResponse))));
}

/// What the status told of a board on which this fault acted for 1.2 s, since it was switched on or while it was
/// running, every 4 ms.
fn statuses_under(fault: Fault, from_the_start: bool) -> Vec<Status> {
    let board = board(ScenarioKind::Wrist);
    let bench = board.bench();
    if from_the_start {
        bench.with(|bench| bench.inject(fault));
    }
    let mut client = Client::connect(board).expect("the link answers whatever the converter does");
    if !from_the_start {
        client.wait_for_converter().expect("the converter starts");
        bench.with(|bench| bench.inject(fault));
    }
    let look = |_| {
        client.wait(Duration::from_millis(4)).expect("virtual time passes");
        client.status().expect("the link answers whatever the converter does")
    };
    (0..300).map(look).collect()
}

#[test]
fn every_fault_of_the_converter_is_reported() {
    let is_faulty = |status: &Status| matches!(status.adc, AdcState::Faulty(_));
    for fault in [
        Fault::ConverterMissing,
        Fault::LateReply,
        Fault::WrongIdentity { id: 0x2400 },
        Fault::BusBitErrors { probability: 0.05 },
        Fault::DataReadyLost { probability: 1.0 },
    ] {
        assert!(statuses_under(fault, true).iter().any(is_faulty), "{fault:?}");
        // An identity is asked for at the start only. Replies that begin to be late while the converter runs look each
        // like one in time; at the next start they do not.
        let shows_at_start_only = matches!(fault, Fault::WrongIdentity { .. } | Fault::LateReply);
        let while_running = statuses_under(fault, false);
        assert!(shows_at_start_only || while_running.iter().any(is_faulty), "{fault:?}");
    }
    let wrong_identity = statuses_under(Fault::WrongIdentity { id: 0x2400 }, true);
    assert!(
        wrong_identity
            .iter()
            .skip(10)
            .all(|status| status.adc == AdcState::Faulty(AdcFault::WrongIdentity { id: 0x2400 }))
    );
}

#[test]
fn a_converter_that_delivers_nothing_does_not_count_as_running() {
    let board = board(ScenarioKind::Fingertip);
    board.bench().with(|bench| bench.inject(Fault::DataReadyLost { probability: 1.0 }));
    let mut client = Client::connect(board).expect("the link answers whatever the converter does");
    let error = client.configure_adc(DataRate::Hz1000, Gain::X128).expect_err("there are no conversions");
    assert!(matches!(
        error,
        ClientError::Converter(AdcFault::DataReadyLost) | ClientError::ConverterNotStarting { .. }
    ));
}
