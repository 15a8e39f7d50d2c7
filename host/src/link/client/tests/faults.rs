//! What the sensor tells of its converter.

use std::time::Duration;

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::{AdcState, Status};

use super::board;
use crate::link::client::Client;
use crate::link::error::ClientError;
use crate::simulator::fault::Fault;
use crate::simulator::scenario::ScenarioKind;

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
