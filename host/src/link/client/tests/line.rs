//! Lines that lose, invent and garble, and their rates.

use std::time::Duration;

use ftcal_firmware::baud::DEFAULT_BAUD;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{Rejection, Request, Response, StreamKind, ToDevice, ToHost, TrialPhase};

use super::{HELLO, Scripted, Tampered, board, client, first_gages};
use crate::link::client::Client;
use crate::link::error::{ClientError, LinkError};
use crate::link::transport::{Transport, TransportError};
use crate::simulator::board::SimulatedBoard;
use crate::simulator::scenario::ScenarioKind;

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
fn a_lost_answer_is_asked_for_again_and_nothing_is_done_twice() {
    // Everything that comes back after the third message (hello, stream off, and a request) was sent is lost.
    let losing = |writes: usize, passing: &mut Vec<u8>| {
        if writes == 3 {
            passing.clear();
        }
    };
    let mut client = Client::connect(Tampered::new(losing)).expect("answers");
    client.status().expect("answers the second time");
    assert_eq!(client.line().writes, 4);

    // A trial that was started is not started again, which would be rejected.
    let mut client = Client::connect(Tampered::new(losing)).expect("answers");
    client.start_trial(2).expect("answers the second time");
    assert_eq!(client.line().writes, 4);
    assert_eq!(client.trial_status().expect("answers").phase, TrialPhase::Running);

    // What takes long is awaited, however often it is asked for.
    client.stop_trial().expect("a trial is running");
    assert!(matches!(client.solve_trial(), Err(ClientError::Refused(_))), "nothing has turned");
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
    assert!(sent > 1, "it was asked more than once");
}

#[test]
fn the_rate_is_changed_where_both_ends_and_the_line_have_it() {
    let mut client = client(ScenarioKind::Wrist);
    client.configure_adc(DataRate::Hz8000, Gain::X128).expect("the converter starts");
    let unsupported = client.change_rate(3_000_000);
    assert!(matches!(unsupported, Err(ClientError::Rejected(Rejection::UnsupportedRate))));
    assert_eq!(client.baud(), DEFAULT_BAUD);

    client.upload_calibration(&first_gages(8)).expect("a sound calibration");
    client.change_rate(2_000_000).expect("the simulated line carries everything");
    assert_eq!(client.baud(), 2_000_000);
    client.stream(StreamKind::Wrench).expect("answers");
    for _ in 0..32_000 {
        assert!(client.next_frame(Duration::from_millis(100)).expect("the line is sound").is_some());
    }
    let status = client.status().expect("answers");
    assert_eq!((client.lost_samples(), status.dropped_samples, status.lost_conversions), (0, 0, 0));
}

/// A line that does not carry more than the usual rate.
struct Slow(SimulatedBoard);

impl Transport for Slow {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.0.write(bytes)
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        self.0.read(received, deadline)
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    /// The port does as if.
    fn set_baud(&mut self, _baud: u32) -> Result<(), TransportError> {
        Ok(())
    }
}

#[test]
fn a_line_that_does_not_carry_a_rate_goes_on_at_the_usual_one() {
    let mut client = Client::connect(Slow(board(ScenarioKind::Fingertip))).expect("answers");
    let error = client.change_rate(2_000_000).expect_err("nothing is heard at that rate");
    assert!(matches!(error, ClientError::Link(LinkError::RateDoesNotWork { baud: 2_000_000 })), "{error}");
    assert_eq!(client.baud(), DEFAULT_BAUD);
    client.status().expect("answers as before");
}

#[test]
fn a_sensor_that_was_left_at_another_rate_is_found_again() {
    let mut board = board(ScenarioKind::Fingertip);
    let change = ToDevice::Request(1, Request::ChangeRate(1_000_000));
    board.write(&encode(&change).expect("fits")).expect("a simulated line");
    let mut answer = Vec::new();
    let changed = board.elapsed() + Duration::from_millis(50);
    while board.elapsed() < changed {
        board.read(&mut answer, changed).expect("a simulated line");
    }
    board.set_baud(1_000_000).expect("a simulated line");
    board.write(&encode(&ToDevice::Hello).expect("fits")).expect("a simulated line");
    // Here the program is killed.
    board.set_baud(DEFAULT_BAUD).expect("a simulated line");
    let begin = board.elapsed();
    let client = Client::connect(board).expect("is found in the end");
    assert!(client.line().elapsed() > begin + Duration::from_secs(4), "it had to be waited for");
}
