//! Golden bytes of the messages about the sensor's health and about calibrations in the field; for what golden bytes are see `golden_bytes.rs`.

use ftcal_shared::fault::AdcFault;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::wire::health::StatusWord;
use ftcal_shared::wire::{
    CalibrationOrigin, Diagnosis, Failure, FieldComparison, FieldOutcome, FieldPhase, FieldRefusal,
    FieldReport, Found, HealthReport, HealthRequest, HealthResponse, InvalidCause, LoadLimits, LoadThreshold,
    MAX_OUTCOMES, ParityReport, PlayedFault, Rejection, Renewed, Request, ResetCause, Response,
    SelfTestOutcome, SelfTestPhase, SelfTestReport, TarePhase, TareRefusal, TareReport,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

const HALF: [u8; 4] = [0, 0, 0, 0x3F];
const ONE: [u8; 4] = [0, 0, 0x80, 0x3F];
const INFINITE: [u8; 4] = [0, 0, 0x80, 0x7F];

/// The payload must be these bytes, and these bytes must be the payload.
fn assert_golden<Message>(message: &Message, golden: &[&[u8]])
where
    Message: Serialize + DeserializeOwned + PartialEq + core::fmt::Debug,
{
    let golden = golden.concat();
    let mut room = [0_u8; 512];
    let bytes = postcard::to_slice(message, &mut room).unwrap();
    assert_eq!(bytes, golden, "{message:?}");
    let back: Message = postcard::from_bytes(&golden).unwrap();
    assert_eq!(&back, message);
}

fn limits() -> LoadLimits {
    LoadLimits {
        largest: [0.5, 1.0, 1.0, 1.0, 1.0, f32::INFINITY],
        combined: 1.0,
        thresholds: [LoadThreshold { level: 1.0, hysteresis: 0.5 }; 6],
    }
}

fn limits_bytes() -> Vec<u8> {
    let largest = [HALF, ONE, ONE, ONE, ONE, INFINITE].concat();
    [largest, ONE.to_vec(), [[ONE, HALF]; 6].as_flattened().concat()].concat()
}

#[test]
fn requests() {
    let golden = |request, bytes: &[u8]| assert_golden(&Request::Health(request), &[&[13], bytes]);
    golden(HealthRequest::Read, &[0]);
    golden(HealthRequest::ClearLatched, &[1]);
    golden(HealthRequest::CarryOn(None), &[2, 0]);
    golden(HealthRequest::CarryOn(Some(7)), &[2, 1, 7]);
    golden(HealthRequest::ReadLimits, &[3]);
    golden(HealthRequest::SetLimits(limits()), &[&[4], limits_bytes().as_slice()].concat());
    golden(HealthRequest::ReadTare, &[5]);
    golden(HealthRequest::SetTare { samples: 300, store: true }, &[6, 0xAC, 0x02, 1]);
    golden(HealthRequest::ClearTare { store: false }, &[7, 0]);
    golden(HealthRequest::StartSelfTest, &[8]);
    golden(HealthRequest::ReadSelfTest, &[9]);
}

#[test]
fn responses() {
    let golden = |response, bytes: &[&[u8]]| {
        assert_golden(&Response::Health(response), &[&[10], bytes.concat().as_slice()]);
    };
    let parity = ParityReport {
        redundant: 2,
        watched: 300,
        noise_counts: Some(0.5),
        disagreement_counts: 1.0,
        allowed_counts: 0.5,
        suspects: 1,
        suspect_off_counts: 1.0,
    };
    let report = HealthReport {
        live: StatusWord::from_bits(300),
        latched: StatusWord::from_bits(0x8000_0000),
        saturated: 1,
        repeating: 2,
        parity: Some(parity),
        carrying_on_without: Some(7),
        thresholds: 4,
        peak_since_start: [0.5; 6],
        peak_ever: [1.0; 6],
    };
    let word = [0xAC, 0x02, 0x80, 0x80, 0x80, 0x80, 0x08];
    let agreement: &[&[u8]] = &[&[1, 2, 0xAC, 0x02, 1], &HALF, &ONE, &HALF, &[1], &ONE];
    let (start, ever) = ([HALF; 6].concat(), [ONE; 6].concat());
    golden(
        HealthResponse::Report(report),
        &[&[0], &word, &[1, 2], &agreement.concat(), &[1, 7, 4], &start, &ever],
    );
    golden(HealthResponse::Limits(limits()), &[&[1], &limits_bytes()]);
    let tare = |phase, wrench| HealthResponse::Tare(TareReport { phase, wrench });
    golden(tare(TarePhase::Settled, Some([0.5; 6])), &[&[2, 0, 1], &start]);
    golden(tare(TarePhase::Averaging { left: 300 }, None), &[&[2, 1, 0xAC, 0x02, 0]]);
    golden(tare(TarePhase::Refused(TareRefusal::NoWrench), None), &[&[2, 2, 0, 0]]);
    golden(tare(TarePhase::Refused(TareRefusal::Moving), None), &[&[2, 2, 1, 0]]);
}

#[test]
fn self_tests() {
    let outcomes = [
        (PlayedFault::PositiveTestSignal, Found::Within { channel: 1, off_counts: -1 }, vec![0, 2, 1, 1]),
        (PlayedFault::NegativeTestSignal, Found::Beyond { channel: 1, off_counts: 1 }, vec![1, 3, 1, 2]),
        (PlayedFault::ShortedInputs, Found::NotWell(None), vec![2, 5, 0]),
        (PlayedFault::CorruptedReply, Found::NotWell(Some(AdcFault::NotResponding)), vec![3, 5, 1, 1]),
        (PlayedFault::CorruptedCommand, Found::Nothing, vec![4, 1]),
        (PlayedFault::DeadLine, Found::After { micros: 300 }, vec![5, 0, 0xAC, 0x02]),
        (PlayedFault::StaleReply, Found::Nothing, vec![6, 1]),
        (PlayedFault::LateReply, Found::Nothing, vec![7, 1]),
        (PlayedFault::Reset, Found::Nothing, vec![8, 1]),
        (PlayedFault::SilentDataReady, Found::Nothing, vec![9, 1]),
        (PlayedFault::SaturatedGage, Found::Nothing, vec![10, 1]),
        (PlayedFault::StuckGage, Found::Nothing, vec![11, 1]),
        (PlayedFault::JumpingGage, Found::NotApplicable, vec![12, 4]),
    ];
    let report = SelfTestReport {
        phase: SelfTestPhase::Done,
        outcomes: outcomes.iter().map(|&(played, found, _)| SelfTestOutcome { played, found }).collect(),
    };
    let bytes = outcomes.iter().flat_map(|(_, _, bytes)| bytes.clone()).collect::<Vec<_>>();
    assert_golden(&Response::Health(HealthResponse::SelfTest(report)), &[&[10, 3, 2, 13], &bytes]);
    assert!(outcomes.len() <= MAX_OUTCOMES);
    let none = Response::Health(HealthResponse::SelfTest(SelfTestReport::default()));
    assert_golden(&none, &[&[10, 3, 0, 0]]);
}

#[test]
fn calibrations_in_the_field() {
    assert_golden(&Request::ReadField, &[&[16]]);
    let golden = |report, bytes: &[&[u8]]| {
        assert_golden(&Response::Field(report), &[&[12], bytes.concat().as_slice()]);
    };
    let found = FieldComparison {
        reference: 300,
        relative_uncertainty: 0.5,
        drift: 1.0,
        gage: 7,
        bias_shift_newton: 1.0,
        load_newton: 0.5,
    };
    let comparison = [&[0xAC, 0x02], HALF.as_slice(), &ONE, &[7], &ONE, &HALF].concat();
    golden(FieldReport::default(), &[&[0, 0, 0]]);
    let report = FieldReport {
        phase: FieldPhase::Running { quarters: 3 },
        last: Some(FieldOutcome::Renewed(Renewed::ShapeAndBias, found)),
        origin: Some(CalibrationOrigin::Field(Renewed::Bias, found)),
    };
    golden(report, &[&[2, 3, 1, 0, 1], &comparison, &[1, 1, 0], &comparison]);
    let confirmed = FieldReport {
        phase: FieldPhase::Storing,
        last: Some(FieldOutcome::Confirmed(found)),
        origin: Some(CalibrationOrigin::Uploaded),
    };
    golden(confirmed, &[&[4, 1, 1], &comparison, &[1, 0]]);
    assert_golden(&FieldPhase::Preparing, &[&[1]]);
    assert_golden(&FieldPhase::Solving, &[&[3]]);
    let refusals: [(FieldRefusal, &[&[u8]]); 14] = [
        (FieldRefusal::Uncalibrated, &[&[0]]),
        (FieldRefusal::CalibrationNotKept, &[&[1]]),
        (FieldRefusal::MeasuresTorque, &[&[2]]),
        (FieldRefusal::GainChanged, &[&[3]]),
        (FieldRefusal::Converter, &[&[4]]),
        (FieldRefusal::Busy(Rejection::TrialBusy), &[&[5, 1]]),
        (FieldRefusal::TakenOver, &[&[6]]),
        (FieldRefusal::CalibrationChanged, &[&[7]]),
        (FieldRefusal::Trial(Refusal::MetricNotPositiveDefinite), &[&[8, 4]]),
        (FieldRefusal::Unfinished { quarters: 2, need: 3 }, &[&[9, 2, 3]]),
        (FieldRefusal::UnusableNumbers, &[&[10]]),
        (FieldRefusal::EitherHand, &[&[11]]),
        (FieldRefusal::Drifted { gage: 2, drift: 1.0, limit: 0.5 }, &[&[12, 2], &ONE, &HALF]),
        (FieldRefusal::NotStored, &[&[13]]),
    ];
    for (refusal, bytes) in refusals {
        assert_golden(&FieldOutcome::Refused(refusal), &[&[2], bytes.concat().as_slice()]);
    }
}

#[test]
fn diagnosis() {
    assert_golden(&Request::Diagnosis, &[&[12]]);
    let golden = |reset, failure, bytes: &[u8]| {
        let diagnosis = Diagnosis { reset, failure, stack_used_bytes: 300, stack_bytes: 1 };
        assert_golden(&Response::Diagnosis(diagnosis), &[&[9], bytes, &[0xAC, 0x02, 1]]);
    };
    golden(ResetCause::Unknown, None, &[0, 0]);
    golden(ResetCause::PowerOn, None, &[1, 0]);
    golden(ResetCause::BrownOut, None, &[2, 0]);
    golden(ResetCause::Pin, None, &[3, 0]);
    golden(ResetCause::Watchdog, Some(Failure::ProcessorFault { at: 300 }), &[4, 1, 1, 0xAC, 0x02]);
    golden(ResetCause::Software, Some(Failure::panic("a.rs", 7)), &[5, 1, 0, 4, b'a', b'.', b'r', b's', 7]);
    golden(ResetCause::Software, Some(Failure::StackOverflow), &[5, 1, 2]);
    golden(ResetCause::Software, Some(Failure::UnservedInterrupt { number: -1 }), &[5, 1, 3, 1]);
}

#[test]
fn causes_and_rejections() {
    assert_golden(&InvalidCause::OpenInput(300), &[&[5, 0xAC, 0x02]]);
    assert_golden(&InvalidCause::GagesContradict, &[&[6]]);
    assert_golden(&InvalidCause::SelfTest, &[&[7]]);
    let order =
        [Rejection::NoSuchGage, Rejection::GageNeeded, Rejection::SelfTestRunning, Rejection::UnusableLimit];
    for (number, rejection) in (11_u8..).zip(order) {
        assert_golden(&Response::Rejected(rejection), &[&[6, number]]);
    }
}
