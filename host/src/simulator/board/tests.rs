use std::time::Duration;

use ftcal_shared::units::{DataRate, Dof, Gain};
use ftcal_shared::wire::StreamKind;
use nalgebra::{DMatrix, DVector};

use super::{Bench, DEFAULT_BAUD, LINE_BUFFER, MOMENT_QUEUE, SimulatedBoard, TICK_MICROS, UnsupportedGages};
use crate::link::client::Client;
use crate::link::transport::Transport;
use crate::simulator::scenario::{Scenario, ScenarioKind};
use crate::simulator::sensor::SoftwareSensor;

fn board(kind: ScenarioKind) -> SimulatedBoard {
    SimulatedBoard::for_scenario(&Scenario::new(kind, 7).expect("sizes fit"), 7).expect("sizes fit")
}

#[test]
fn the_same_calls_give_the_same_frames() {
    let run = || {
        let board = board(ScenarioKind::Wrist);
        board.bench().with(Bench::turn);
        let mut client = Client::connect(board).expect("answers");
        client.wait_for_converter().expect("the converter starts");
        client.stream(StreamKind::Codes).expect("answers");
        let next = |_| client.next_frame(Duration::from_secs(1)).expect("the line is sound");
        (0..500).map(next).collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn what_does_not_fit_on_the_line_is_dropped_and_counted_and_responses_get_through() {
    let mut client = Client::connect(board(ScenarioKind::Wrist)).expect("answers");
    client.configure_adc(DataRate::Hz32000, Gain::X128).expect("the converter starts");
    client.stream(StreamKind::Codes).expect("answers");
    let before = client.status().expect("answers");
    let lost_before = client.lost_samples();
    let mut streamed = 0_u32;
    let begin = client.line().elapsed();
    while client.line().elapsed() < begin + Duration::from_secs(1) {
        streamed +=
            u32::from(client.next_frame(Duration::from_secs(1)).expect("the line is sound").is_some());
    }
    let status = client.status().expect("answers");
    let dropped = status.dropped_samples - before.dropped_samples;
    let converted = status.conversions - before.conversions;
    // A frame of eight codes has 30 bytes at least, so the line cannot carry more than these.
    let waiting = u32::try_from(LINE_BUFFER / 30 + MOMENT_QUEUE).expect("fits");
    let room = DEFAULT_BAUD / 10 / 30 + waiting;
    assert!(streamed <= room, "{streamed}");
    // What was neither streamed nor dropped was waiting at either end of the second; and conversions are reported as of the last tick.
    let unreported = u32::try_from(TICK_MICROS * 32_000 / 1_000_000).expect("fits");
    assert!(
        converted.abs_diff(streamed + dropped) <= 2 * waiting + unreported,
        "{converted} {streamed} {dropped}"
    );
    // The host has noticed what it did not get, but for what is missing between the samples that are waiting.
    let lost = client.lost_samples() - lost_before;
    let unnoticed = 2 * waiting * converted.div_ceil(streamed);
    assert!(lost.abs_diff(u64::from(dropped)) <= u64::from(unnoticed), "{lost} {dropped}");
}

#[test]
fn a_board_has_two_to_eight_gages() {
    for gages in 1..=8 {
        let shape = DMatrix::from_element(2, gages, 1.0);
        let zeros = DVector::zeros(gages);
        let sensor = SoftwareSensor::new(Dof::PlanarForce, shape, zeros.clone(), zeros).expect("sizes fit");
        match SimulatedBoard::new(sensor, 1) {
            Ok(board) => {
                let mut client = Client::connect(board).expect("answers");
                assert_eq!(usize::from(client.status().expect("answers").gages), gages);
            }
            Err(error) => assert_eq!((error, gages), (UnsupportedGages { gages: 1 }, 1)),
        }
    }
}
