//! Requests of the host, responses of the sensor, and the greeting that never changes.

use serde::{Deserialize, Serialize};

use super::diagnosis::Diagnosis;
use super::field::FieldReport;
use super::health_message::{HealthRequest, HealthResponse};
use super::memory::{Identity, MemoryRequest};
use super::report::{CodesFrame, Coverage, Output, Solution, Status, TrialStatus};
use super::wrench::WrenchFrame;
use crate::refusal::Refusal;
use crate::units::{DataRate, Decimation, Dof, Gain, MAX_DOF, MAX_GAGES};

/// The version of every message but the greeting.
pub const PROTOCOL_VERSION: u16 = 3;

/// What a sensor of this product answers to a greeting.
pub const PRODUCT: [u8; 5] = *b"ftcal";

/// One value a gage.
pub type GageList<T> = heapless::Vec<T, MAX_GAGES>;

/// A number that the host chooses and the sensor repeats in its response.
pub type RequestId = u16;

/// Host to sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToDevice {
    /// Who are you? Frozen.
    Hello,
    /// Everything else.
    Request(RequestId, Request),
}

/// Sensor to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToHost {
    /// The answer to a greeting. Frozen.
    Hello(Hello),
    /// The answer to the request of the same number.
    Response(RequestId, Response),
    /// A raw sample, unasked for while [`StreamKind::Codes`] is on.
    Codes(CodesFrame),
    /// Wrenches, unasked for while [`StreamKind::Wrench`] is on.
    Wrench(WrenchFrame),
}

/// Who the sensor is. Frozen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// [`PRODUCT`].
    pub product: [u8; 5],
    /// The [`PROTOCOL_VERSION`] of every other message.
    pub protocol_version: u16,
    /// Version of the firmware: major, minor, patch.
    pub firmware_version: [u8; 3],
}

/// What the host asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// How are you? Answered by [`Response::Status`].
    Status,
    /// Sample at this rate and gain from now on. Refused while a trial runs.
    ConfigureAdc(DataRate, Gain),
    /// Send samples as they come, or stop sending them. They stop by themselves where the host says nothing for five seconds.
    Stream(StreamKind),
    /// Start a trial of this proper rank (2 or 3); the sums of the trial before are dropped.
    StartTrial {
        /// The proper rank r of the trial.
        rank: u8,
    },
    /// Stop the running trial; its sums are kept. Answered by [`Response::Trial`].
    StopTrial,
    /// How far is the trial? Answered by [`Response::Trial`].
    TrialStatus,
    /// Solve the stopped trial on the sensor. Answered by [`Response::Solution`] when done.
    SolveTrial,
    /// Use this calibration from now on. Answered by [`Response::Calibration`].
    UploadCalibration(CalibrationUpload),
    /// Which calibration do you use? Answered by [`Response::Calibration`].
    ReadCalibration,
    /// What has the trial seen, and what not? Answered by [`Response::Coverage`] when computed. A running trial goes on
    /// afterwards; samples that come meanwhile are not taken in.
    Coverage,
    /// Who are you, and what have you been through? Answered by [`Response::Identity`].
    ReadIdentity,
    /// Something about what is kept across a reset. Rejected while samples are streamed or a trial runs.
    Memory(MemoryRequest),
    /// Why did you start, and how much room have you left? Answered by [`Response::Diagnosis`].
    Diagnosis,
    /// About the sensor's health. Answered by [`Response::Health`].
    Health(HealthRequest),
    /// At which rate do wrenches go out? With `Some`, they do so at the converter's rate by this from now on. Answered by
    /// [`Response::Output`].
    Output(Option<Decimation>),
    /// Change to this baud rate, once the response has left. The sensor goes back to the rate before where it hears nothing at
    /// the new one for a second.
    ChangeRate(u32),
    /// What of calibrations in the field, with no host? Answered by [`Response::Field`].
    ReadField,
}

/// What the sensor sends unasked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StreamKind {
    /// Nothing.
    #[default]
    Off,
    /// The raw codes of every sample.
    Codes,
    /// The wrench of every sample.
    Wrench,
}

/// What the sensor answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// Done, nothing to tell.
    Done,
    /// State of the sensor.
    Status(Status),
    /// State of the trial.
    Trial(TrialStatus),
    /// The trial's shape and bias.
    Solution(Solution),
    /// The calibration in use, if any.
    Calibration(Option<CalibrationUpload>),
    /// The trial has no answer.
    Refused(Refusal),
    /// The request cannot be served.
    Rejected(Rejection),
    /// What the trial has seen, and what not.
    Coverage(Coverage),
    /// Name and counters.
    Identity(Identity),
    /// What the board knows of itself.
    Diagnosis(Diagnosis),
    /// About the sensor's health.
    Health(HealthResponse),
    /// At which rate wrenches go out.
    Output(Output),
    /// What has come of calibrations in the field.
    Field(FieldReport),
}

/// Why a request is not served.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rejection {
    /// There is no trial to stop or to solve.
    NoTrial,
    /// A trial is running, or being solved.
    TrialBusy,
    /// A trial has rank 2 or 3.
    UnsupportedRank,
    /// The calibration is for another number of gages than this sensor has, or its matrix does not fit its axes.
    WrongDimensions,
    /// A number of the calibration is not finite, or out of the converter's range.
    UnusableNumbers,
    /// The calibration's checksum does not match its numbers.
    WrongIdentity,
    /// Samples are streamed or a trial runs: writing to the memory would hold them up.
    Measuring,
    /// The memory is being written to.
    Storing,
    /// There is no calibration in use: none to be stored, and no wrench to take a tare of or to leave a gage out of.
    Uncalibrated,
    /// No calibration of this identity is kept.
    NoSuchCalibration,
    /// The memory did not take it: what was kept before is still kept.
    NotStored,
    /// The sensor has no such gage.
    NoSuchGage,
    /// The wrench cannot be had without this gage, or with so much more noise that it is none.
    GageNeeded,
    /// A self-test is under way.
    SelfTestRunning,
    /// A limit is negative or no number, a threshold's hysteresis is larger than its level, or a tare is of no sample.
    UnusableLimit,
    /// The board's clock cannot be divided to this baud rate.
    UnsupportedRate,
}

/// A calibration in the sensor's own form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationUpload {
    /// The axes, in the order of the matrix's rows.
    pub dof: Dof,
    /// The converter's gain that it was made at: its counts are counts at this gain, and at no other.
    pub gain: Gain,
    /// b (p), counts.
    pub bias_counts: GageList<f64>,
    /// C (m × p, row by row), newton and newton metre per count.
    pub matrix: heapless::Vec<f32, { MAX_DOF * MAX_GAGES }>,
    /// [`CalibrationUpload::identity_of_numbers`] of the above, by which every wrench names its calibration.
    pub identity: u32,
}

impl CalibrationUpload {
    /// The identity of these numbers: CRC-32 over the axes, the gain's factor, the bias and the matrix as they travel.
    pub fn identity_of_numbers(&self) -> u32 {
        let mut digest = super::frame::CHECK.digest();
        digest.update(&[self.dof as u8, self.gain.factor()]);
        for bias in &self.bias_counts {
            digest.update(&bias.to_le_bytes());
        }
        for element in &self.matrix {
            digest.update(&element.to_le_bytes());
        }
        digest.finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::{CalibrationUpload, GageList};
    use crate::units::{Dof, Gain};

    #[test]
    fn whatever_a_calibration_says_is_in_its_identity() {
        let calibration = CalibrationUpload {
            dof: Dof::PlanarForce,
            gain: Gain::X128,
            bias_counts: GageList::from_slice(&[1.0, 2.0]).unwrap(),
            matrix: heapless::Vec::from_slice(&[1.0, 0.0, 0.0, 1.0]).unwrap(),
            identity: 0,
        };
        let identity = calibration.identity_of_numbers();
        let mut bias = calibration.clone();
        bias.bias_counts[1] = -2.0;
        let mut matrix = calibration.clone();
        matrix.matrix[3] = 2.0;
        let dof = CalibrationUpload { dof: Dof::SpatialForce, ..calibration.clone() };
        for other in [dof, bias, matrix] {
            assert_ne!(other.identity_of_numbers(), identity, "{other:?}");
        }
        let gains =
            Gain::ALL.map(|gain| CalibrationUpload { gain, ..calibration.clone() }.identity_of_numbers());
        assert_eq!(gains.iter().filter(|&&of_gain| of_gain == identity).count(), 1, "{gains:08x?}");
    }
}
