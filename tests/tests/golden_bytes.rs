//! Golden bytes: what each message looks like on the line.
//!
//! The greeting is frozen for good. The rest is frozen for the version of the protocol it belongs to: a change here needs a
//! new `PROTOCOL_VERSION` and a new set of bytes, never an edit of the old ones. Each set was put together by hand from
//! the specification of postcard (varints, zigzag, little-endian floats), of CRC-32/ISO-HDLC and of COBS.

use ftcal_shared::fault::AdcFault;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, DataRate, Decimation, DeviceTime, Dof, Gain, SampleIndex};
use ftcal_shared::wire::frame::{Decoder, FrameError, encode};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, ClockSource, CodesFrame, Coverage, GageList, GageTarget, Hello, Identity,
    InvalidCause, KeptCalibration, KeptCalibrations, MemoryRequest, Output, PROTOCOL_VERSION, PackedWrenches,
    Rejection, Request, Response, Resumption, Run, SensorName, Solution, Status, StreamKind, ToDevice,
    ToHost, TrialPhase, TrialStatus, WrenchFrame,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The payload must be these bytes, and these bytes must be the payload.
fn assert_golden<Message>(message: &Message, golden: &[u8])
where
    Message: Serialize + DeserializeOwned + PartialEq + core::fmt::Debug,
{
    let mut room = [0_u8; 512];
    let bytes = postcard::to_slice(message, &mut room).unwrap();
    assert_eq!(bytes, golden, "{message:?}");
    let back: Message = postcard::from_bytes(golden).unwrap();
    assert_eq!(&back, message);
}

fn assert_request(request: Request, golden: &[u8]) {
    let mut whole = vec![0x01, 0x05];
    whole.extend_from_slice(golden);
    assert_golden(&ToDevice::Request(5, request), &whole);
}

fn assert_response(response: Response, golden: &[u8]) {
    let mut whole = vec![0x01, 0xAC, 0x02];
    whole.extend_from_slice(golden);
    assert_golden(&ToHost::Response(300, response), &whole);
}

#[test]
fn the_greeting_is_frozen() {
    assert_golden(&ToDevice::Hello, &[0x00]);
    // CRC-32 of a zero byte is D202EF8D.
    assert_eq!(encode(&ToDevice::Hello).unwrap().as_slice(), [0x01, 0x05, 0x8D, 0xEF, 0x02, 0xD2, 0x00]);
    let hello = Hello { product: *b"ftcal", protocol_version: 300, firmware_version: [1, 22, 255] };
    assert_golden(&ToHost::Hello(hello), &[0x00, b'f', b't', b'c', b'a', b'l', 0xAC, 0x02, 1, 22, 255]);
}

#[test]
fn this_set_belongs_to_version_three() {
    assert_eq!(PROTOCOL_VERSION, 3);
}

#[test]
fn requests() {
    assert_request(Request::Status, &[0]);
    assert_request(Request::ConfigureAdc(DataRate::Hz250, Gain::X1), &[1, 0, 0]);
    assert_request(Request::ConfigureAdc(DataRate::Hz32000, Gain::X128), &[1, 7, 7]);
    assert_request(Request::Stream(StreamKind::Off), &[2, 0]);
    assert_request(Request::Stream(StreamKind::Codes), &[2, 1]);
    assert_request(Request::Stream(StreamKind::Wrench), &[2, 2]);
    assert_request(Request::StartTrial { rank: 3 }, &[3, 3]);
    assert_request(Request::StopTrial, &[4]);
    assert_request(Request::TrialStatus, &[5]);
    assert_request(Request::SolveTrial, &[6]);
    let mut upload = vec![7];
    upload.extend_from_slice(&CALIBRATION_BYTES);
    assert_request(Request::UploadCalibration(calibration()), &upload);
    assert_request(Request::ReadCalibration, &[8]);
    assert_request(Request::Coverage, &[9]);
    assert_request(Request::ReadIdentity, &[10]);
    assert_request(Request::Memory(MemoryRequest::StoreCalibration), &[11, 0]);
    assert_request(Request::Memory(MemoryRequest::RollBack { to: 300 }), &[11, 1, 0xAC, 0x02]);
    assert_request(Request::Memory(MemoryRequest::StoreSettings), &[11, 2]);
    let name = SensorName::try_from("ab").unwrap();
    assert_request(Request::Memory(MemoryRequest::WriteName(name)), &[11, 3, 2, b'a', b'b']);
    assert_request(Request::Output(None), &[14, 0]);
    assert_request(Request::Output(Some(Decimation::By128)), &[14, 1, 7]);
    assert_request(Request::ChangeRate(2_000_000), &[15, 0x80, 0x89, 0x7A]);
}

/// Numbers chosen for their bytes, not for a sensor.
fn calibration() -> CalibrationUpload {
    CalibrationUpload {
        dof: Dof::SpatialForce,
        gain: Gain::X64,
        bias_counts: GageList::from_slice(&[1.5, -2.0]).unwrap(),
        matrix: [0.5].into_iter().collect(),
        identity: 0xDEAD_BEEF,
    }
}

#[rustfmt::skip]
const CALIBRATION_BYTES: [u8; 29] = [
    1,
    6,
    2, 0, 0, 0, 0, 0, 0, 0xF8, 0x3F, 0, 0, 0, 0, 0, 0, 0, 0xC0,
    1, 0, 0, 0, 0x3F,
    0xEF, 0xFD, 0xB6, 0xF5, 0x0D,
];

const TRIAL: TrialStatus = TrialStatus {
    phase: TrialPhase::Running,
    rank: 3,
    used: 128,
    saturated: 1,
    first: SampleIndex::new(5),
    offered: 729,
    repeated: 300,
    moving: 300,
    contradictory: 2,
    off_magnitude: 0,
    unattended: 129,
    resumption: Resumption::Resumed,
    checkpointed: 128,
};

// 729 = 5·128 + 89 and 300 = 2·128 + 44, each low seven bits first.
const TRIAL_BYTES: [u8; 19] =
    [1, 3, 0x80, 0x01, 1, 5, 0xD9, 0x05, 0xAC, 0x02, 0xAC, 0x02, 2, 0, 0x81, 0x01, 1, 0x80, 0x01];

#[test]
fn responses() {
    assert_response(Response::Done, &[0]);
    let status = Status {
        gages: 8,
        clock: ClockSource::InternalFallback,
        adc: AdcState::Faulty(AdcFault::WrongIdentity { id: 0x1234 }),
        data_rate: DataRate::Hz1000,
        gain: Gain::X64,
        stream: StreamKind::Wrench,
        calibration: Some(7),
        trial: TRIAL,
        uptime: DeviceTime::from_micros(1_000_000),
        conversions: 1,
        lost_conversions: 2,
        corrupted_conversions: 3,
        dropped_samples: 4,
        broken_frames: 5,
        kept: KeptCalibrations { current: KeptCalibration::Calibration(300), previous: Some(2) },
        abandoned_streams: 6,
        overrun_conversions: 7,
        late_samples: 8,
    };
    #[rustfmt::skip]
    let mut golden = vec![1, 8, 1, 2, 2, 0xB4, 0x24, 2, 6, 2, 1, 7];
    golden.extend_from_slice(&TRIAL_BYTES);
    golden.extend_from_slice(&[0xC0, 0x84, 0x3D, 1, 2, 3, 4, 5, 6, 0xAC, 0x02, 1, 2, 6, 7, 8]);
    assert_response(Response::Status(status.clone()), &golden);

    let kept = KeptCalibrations { current: KeptCalibration::OtherFormat(9), previous: None };
    let running =
        Status { clock: ClockSource::Crystal, adc: AdcState::Running, calibration: None, kept, ..status };
    let mut golden = vec![1, 8, 0, 1, 2, 6, 2, 0];
    golden.extend_from_slice(&TRIAL_BYTES);
    golden.extend_from_slice(&[0xC0, 0x84, 0x3D, 1, 2, 3, 4, 5, 3, 9, 0, 6, 7, 8]);
    assert_response(Response::Status(running), &golden);

    let mut golden = vec![2];
    golden.extend_from_slice(&TRIAL_BYTES);
    assert_response(Response::Trial(TRIAL), &golden);

    let solution = Solution {
        rank: 2,
        shape_counts_per_load: [1.0].into_iter().collect(),
        bias_counts: GageList::new(),
        eigenvalues: GageList::from_slice(&[2.0]).unwrap(),
        noise_counts: Some(0.5),
        samples: 1000,
    };
    #[rustfmt::skip]
    assert_response(Response::Solution(solution), &[
        3, 2,
        1, 0, 0, 0, 0, 0, 0, 0xF0, 0x3F,
        0,
        1, 0, 0, 0, 0, 0, 0, 0x00, 0x40,
        1, 0, 0, 0, 0, 0, 0, 0xE0, 0x3F,
        0xE8, 0x07,
    ]);

    assert_response(Response::Calibration(None), &[4, 0]);
    let mut golden = vec![4, 1];
    golden.extend_from_slice(&CALIBRATION_BYTES);
    assert_response(Response::Calibration(Some(calibration())), &golden);
}

#[test]
fn what_is_kept() {
    let identity = Identity { name: SensorName::try_from("ab").unwrap(), boots: 300, stores: 1 };
    assert_response(Response::Identity(identity), &[8, 2, b'a', b'b', 0xAC, 0x02, 1]);
    let order = [
        KeptCalibration::Unread,
        KeptCalibration::Nothing,
        KeptCalibration::Corrupt,
        KeptCalibration::OtherFormat(0),
        KeptCalibration::Unusable,
        KeptCalibration::Unreadable,
        KeptCalibration::Calibration(0),
    ];
    for (number, kept) in (0_u8..).zip(order) {
        let mut room = [0_u8; 8];
        assert_eq!(postcard::to_slice(&kept, &mut room).unwrap()[0], number);
    }
}

#[test]
fn output() {
    let output =
        Output { data_rate: DataRate::Hz32000, decimation: Decimation::By4, group_delay_conversions: 300 };
    assert_response(Response::Output(output), &[11, 7, 2, 0xAC, 0x02]);
}

#[test]
fn coverage() {
    let coverage = Coverage {
        samples: 300,
        fraction: 0.5,
        worst_relative_uncertainty: f32::INFINITY,
        targets: [GageTarget { gage: 7, counts: -1.0, position: -0.5 }].into_iter().collect(),
        bias_deviation_counts: [2.0].into_iter().collect(),
        shape_deviation_counts_per_load: [0.5, -0.5].into_iter().collect(),
    };
    #[rustfmt::skip]
    assert_response(Response::Coverage(coverage), &[
        7,
        0xAC, 0x02,
        0, 0, 0, 0x3F,
        0, 0, 0x80, 0x7F,
        1, 7, 0, 0, 0x80, 0xBF, 0, 0, 0, 0xBF,
        1, 0, 0, 0, 0x40,
        2, 0, 0, 0, 0x3F, 0, 0, 0, 0xBF,
    ]);
}

#[test]
fn refusals() {
    let refused = |refusal, golden: &[u8]| {
        let mut whole = vec![5];
        whole.extend_from_slice(golden);
        assert_response(Response::Refused(refusal), &whole);
    };
    refused(Refusal::TooFewSamples { have: 1, need: 18 }, &[0, 1, 18]);
    refused(Refusal::RankNotReached { have: 2, need: 3 }, &[1, 2, 3]);
    refused(Refusal::NoEigenvalueGap { ratio: 0.5, need: 2.0 }, &[2, 0, 0, 0, 0x3F, 0, 0, 0, 0x40]);
    refused(
        Refusal::MotionDoesNotSpan { relative_uncertainty: 0.5, need: 2.0 },
        &[3, 0, 0, 0, 0x3F, 0, 0, 0, 0x40],
    );
    refused(Refusal::MetricNotPositiveDefinite, &[4]);
    refused(Refusal::NonFinite, &[5]);
    refused(Refusal::Saturated { samples: 300 }, &[6, 0xAC, 0x02]);
    refused(Refusal::OverflowAhead { samples: 300 }, &[7, 0xAC, 0x02]);
    refused(Refusal::PivotsDiffer, &[8]);
    refused(Refusal::UnsupportedDimensions { gages: 13, rank: 4 }, &[9, 13, 4]);
    refused(Refusal::MagnitudeNotConstant { scatter: 0.5, limit: 2.0 }, &[10, 0, 0, 0, 0x3F, 0, 0, 0, 0x40]);
    refused(Refusal::RankExceeded { share: 0.5, limit: 2.0 }, &[11, 0, 0, 0, 0x3F, 0, 0, 0, 0x40]);
}

#[test]
fn rejections() {
    let order = [
        Rejection::NoTrial,
        Rejection::TrialBusy,
        Rejection::UnsupportedRank,
        Rejection::WrongDimensions,
        Rejection::UnusableNumbers,
        Rejection::WrongIdentity,
        Rejection::Measuring,
        Rejection::Storing,
        Rejection::Uncalibrated,
        Rejection::NoSuchCalibration,
        Rejection::NotStored,
        Rejection::NoSuchGage,
        Rejection::GageNeeded,
        Rejection::SelfTestRunning,
        Rejection::UnusableLimit,
        Rejection::UnsupportedRate,
    ];
    for (number, rejection) in (0_u8..).zip(order) {
        assert_response(Response::Rejected(rejection), &[6, number]);
    }
}

#[test]
fn faults() {
    let order = [
        AdcFault::Bus,
        AdcFault::NotResponding,
        AdcFault::WrongIdentity { id: 0 },
        AdcFault::ResetNotAcknowledged,
        AdcFault::RegisterMismatch { address: 0 },
        AdcFault::ReplyCorrupted,
        AdcFault::CommandCorrupted,
        AdcFault::UnexpectedReply,
        AdcFault::UnexpectedReset,
        AdcFault::StaleConversion,
        AdcFault::DataReadyLost,
    ];
    for (number, fault) in (0_u8..).zip(order) {
        let mut room = [0_u8; 8];
        assert_eq!(postcard::to_slice(&fault, &mut room).unwrap()[0], number);
    }
}

#[test]
fn stream_frames() {
    let codes =
        [AdcCode::MIN, AdcCode::new(-1).unwrap(), AdcCode::ZERO, AdcCode::new(300).unwrap(), AdcCode::MAX];
    let frame = CodesFrame {
        index: SampleIndex::new(128),
        time: DeviceTime::from_micros(300),
        codes: GageList::from_slice(&codes).unwrap(),
    };
    #[rustfmt::skip]
    assert_golden(&ToHost::Codes(frame), &[
        2, 0x80, 0x01, 0xAC, 0x02,
        5, 0xFF, 0xFF, 0xFF, 0x07, 0x01, 0x00, 0xD8, 0x04, 0xFE, 0xFF, 0xFF, 0x07,
    ]);

    let frame = |run| {
        ToHost::Wrench(WrenchFrame {
            first: SampleIndex::new(1),
            stride: 4,
            time: DeviceTime::from_micros(2),
            span_micros: 300,
            age_micros: 3,
            status: 0x8001,
            temperature_centi_celsius: Some(-1),
            run,
        })
    };
    // Two axes, two samples: (0.5, -2.0) and (0.25, 1.0). The exponents are 0 and 2, the units 2⁻²³ and 2⁻²¹.
    let wrenches = [[0.5, -2.0, 0.0, 0.0, 0.0, 0.0], [0.25, 1.0, 0.0, 0.0, 0.0, 0.0]];
    let wrenches = PackedWrenches::pack(2, &wrenches).unwrap();
    let valid = Run::Valid { calibration: 300, parity: Some(0.5), wrenches };
    #[rustfmt::skip]
    assert_golden(&frame(valid), &[
        3, 1, 4, 2, 0xAC, 0x02, 3, 0x81, 0x80, 0x02, 1, 0x01,
        0, 0xAC, 0x02, 1, 0, 0, 0, 0x3F,
        2, 0, 2,
        12, 0, 0, 0x40, 0, 0, 0xC0, 0, 0, 0x20, 0, 0, 0x20,
    ]);
    let invalid = |cause, golden: &[u8]| {
        let mut whole = vec![3, 1, 4, 2, 0xAC, 0x02, 3, 0x81, 0x80, 0x02, 1, 0x01, 1];
        whole.extend_from_slice(golden);
        whole.push(20);
        assert_golden(&frame(Run::Invalid { cause, samples: 20 }), &whole);
    };
    invalid(InvalidCause::Uncalibrated, &[0]);
    invalid(InvalidCause::Saturated(0x81), &[1, 0x81, 0x01]);
    invalid(InvalidCause::Adc(AdcFault::Bus), &[2, 0]);
    invalid(InvalidCause::GainChanged, &[3]);
    invalid(InvalidCause::NonFinite, &[4]);
    invalid(InvalidCause::OpenInput(0x81), &[5, 0x81, 0x01]);
    invalid(InvalidCause::GagesContradict, &[6]);
    invalid(InvalidCause::SelfTest, &[7]);
    invalid(InvalidCause::Settling, &[8]);
}

#[test]
fn a_frame_survives_garbage_before_it_and_none_survives_a_flipped_bit() {
    let message = ToDevice::Request(5, Request::UploadCalibration(calibration()));
    let frame = encode(&message).unwrap();
    let decode = |bytes: &[u8]| {
        let mut decoder = Decoder::new();
        bytes.iter().filter_map(|&byte| decoder.push::<ToDevice>(byte)).collect::<Vec<_>>()
    };
    let mut garbage = vec![0x55, 0xAA, 0x01, 0xFF, 0x00];
    garbage.extend_from_slice(&frame);
    let received = decode(&garbage);
    assert!(received[0].is_err());
    assert_eq!(received[1..], [Ok(message.clone())]);

    for position in 0..frame.len() {
        for bit in 0..8 {
            let mut broken = frame.to_vec();
            broken[position] ^= 1 << bit;
            broken.push(0);
            assert!(decode(&broken).iter().all(Result::is_err), "byte {position}, bit {bit}");
        }
    }
}

#[test]
fn a_frame_without_end_is_dropped_and_the_next_one_read() {
    let mut decoder = Decoder::new();
    for _ in 0..10_000 {
        assert_eq!(decoder.push::<ToDevice>(0x11), None);
    }
    assert_eq!(decoder.push::<ToDevice>(0), Some(Err(FrameError::TooLong)));
    let received: Vec<_> =
        encode(&ToDevice::Hello).unwrap().iter().filter_map(|&byte| decoder.push::<ToDevice>(byte)).collect();
    assert_eq!(received, [Ok(ToDevice::Hello)]);
}
