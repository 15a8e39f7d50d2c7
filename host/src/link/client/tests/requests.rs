//! Every request has its answer, and what is no answer is an error.

use std::time::Duration;

use ftcal_shared::units::{DataRate, Gain, MAX_GAGES};
use ftcal_shared::wire::{
    AdcState, Hello, PROTOCOL_VERSION, Rejection, Request, Response, ToDevice, ToHost, TrialPhase,
};
use nalgebra::Vector3;

use super::{HELLO, Scripted, client, first_gages};
use crate::link::client::Client;
use crate::link::error::{ClientError, LinkError};
use crate::simulator::scenario::ScenarioKind;

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
