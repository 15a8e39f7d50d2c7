//! What is streamed, and when it ends.

use std::time::Duration;

use ftcal_shared::units::{DataRate, Decimation, Dof, Gain};
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{Request, StreamKind, ToDevice};

use super::{board, client, first_gages, true_calibration};
use crate::link::client::Client;
use crate::link::frame::{Frame, Measured, NoWrench};
use crate::link::transport::{Transport, TransportError};
use crate::simulator::board::SimulatedBoard;
use crate::simulator::fault::{Fault, Rail};
use crate::simulator::scenario::ScenarioKind;

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
        Some(Frame::Wrench(sample)) => sample.at_any_age(),
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
    // To give it to the sensor once more does not make it one of this gain.
    client.stream(StreamKind::Off).expect("answers");
    client.upload_calibration(&first_gages(4)).expect("a sound calibration");
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

/// A line over which everything is looked at only some time after it came.
struct Late(SimulatedBoard);

const LATE: Duration = Duration::from_secs(2);

impl Transport for Late {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.0.write(bytes)
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        Ok(self.0.read(received, deadline)?.saturating_sub(LATE))
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        self.0.set_baud(baud)
    }
}

#[test]
fn a_wrench_ages_from_when_it_came_and_not_from_when_it_was_looked_at() {
    let mut client = Client::connect(Late(board(ScenarioKind::Fingertip))).expect("answers");
    client.wait_for_converter().expect("the converter starts");
    client.wait(2 * LATE).expect("virtual time passes");
    client.upload_calibration(&first_gages(4)).expect("a sound calibration");
    client.stream(StreamKind::Wrench).expect("answers");
    let frame = client.next_frame(Duration::from_millis(100)).expect("the line is sound");
    let Some(Frame::Wrench(sample)) = frame else { panic!("a wrench was expected") };
    let now = client.line().elapsed();
    assert_eq!(sample.within(LATE / 2, now), Measured::Invalid(NoWrench::Stale));
    assert!(matches!(sample.within(LATE + Duration::from_millis(20), now), Measured::Valid(_)));
}

#[test]
fn frames_that_nobody_takes_are_dropped_oldest_first_and_counted() {
    let mut client = client(ScenarioKind::Fingertip);
    client.configure_adc(DataRate::Hz1000, Gain::X128).expect("the converter starts");
    client.stream(StreamKind::Codes).expect("answers");
    client.wait(Duration::from_secs(70)).expect("virtual time passes");
    let dropped = client.dropped_samples();
    assert!((9_900..=10_100).contains(&dropped), "{dropped} of 70 000");
    for _ in 0..60_000 {
        assert!(client.next_frame(Duration::ZERO).expect("the line is sound").is_some());
    }
    assert_eq!(
        (client.next_frame(Duration::ZERO).expect("the line is sound"), client.lost_samples()),
        (None, 0)
    );
}

#[test]
fn a_stream_goes_on_while_somebody_listens_and_ends_when_nobody_does() {
    let mut client = client(ScenarioKind::Fingertip);
    client.wait_for_converter().expect("the converter starts");
    client.stream(StreamKind::Codes).expect("answers");
    client.wait(Duration::from_secs(20)).expect("virtual time passes");
    let status = client.status().expect("answers");
    assert_eq!((status.stream, status.abandoned_streams), (StreamKind::Codes, 0));

    // Whoever reads the line alone says nothing.
    let mut board = board(ScenarioKind::Fingertip);
    let mut garbage = Vec::new();
    let start = ToDevice::Request(1, Request::Stream(StreamKind::Codes));
    board.write(&encode(&start).expect("fits")).expect("a simulated line");
    let end = board.elapsed() + Duration::from_secs(8);
    while board.elapsed() < end {
        board.read(&mut garbage, end).expect("a simulated line");
    }
    let mut client = Client::connect(board).expect("answers");
    let status = client.status().expect("answers");
    assert_eq!((status.stream, status.abandoned_streams), (StreamKind::Off, 1));
}

#[test]
fn the_stream_has_the_rate_that_was_asked_for() {
    let mut client = client(ScenarioKind::Fingertip);
    client.configure_adc(DataRate::Hz2000, Gain::X128).expect("the converter starts");
    let calibration = true_calibration(&client);
    client.upload_calibration(&calibration).expect("a sound calibration");
    let output = client.set_output(Decimation::By8).expect("answers");
    assert_eq!(client.output().expect("answers"), output);
    assert_eq!((output.data_rate, output.decimation), (DataRate::Hz2000, Decimation::By8));
    client.stream(StreamKind::Wrench).expect("answers");
    let mut next = || match client.next_frame(Duration::from_millis(100)).expect("the line is sound") {
        Some(Frame::Wrench(sample)) => sample,
        other => panic!("a wrench was expected, not {other:?}"),
    };
    let mut previous = next();
    while previous.at_any_age() == Measured::Invalid(NoWrench::Settling) {
        previous = next();
    }
    for _ in 0..100 {
        let sample = next();
        assert!(matches!(sample.at_any_age(), Measured::Valid(_)));
        assert_eq!((sample.stride, sample.index.since(previous.index)), (8, 8));
        assert_eq!(sample.time.as_micros() - previous.time.as_micros(), 4000);
        // It bears the time that it is of by either clock, which are one here but for what the line delays.
        let line = sample.taken.as_secs_f64() - sample.time.as_seconds();
        assert!((-1e-6..3e-3).contains(&line), "{line} s");
        previous = sample;
    }
}
