//! What the sensor is asked and tells about its health: gages, load, tare, self-test. For the status word see [`super::health`].
//!
//! Components of a wrench are in the order of the calibration's axes, newton and newton metre, and zero beyond them.

use serde::{Deserialize, Serialize};

use super::health::StatusWord;
use crate::fault::AdcFault;
use crate::units::MAX_DOF;

/// What is asked about the sensor's health, or changed about how it is watched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum HealthRequest {
    /// How are you? Answered by [`HealthResponse::Report`], as are all below that name no other answer.
    Read,
    /// Forget which bits were live since the last time.
    ClearLatched,
    /// Measure without this gage from now on, or with all of them again.
    CarryOn(Option<u8>),
    /// What are the limits of the load? Answered by [`HealthResponse::Limits`].
    ReadLimits,
    /// Let these be the limits of the load. Answered by [`HealthResponse::Limits`].
    SetLimits(LoadLimits),
    /// What is being subtracted? Answered by [`HealthResponse::Tare`].
    ReadTare,
    /// Subtract from now on the mean of the next so many samples. Answered by [`HealthResponse::Tare`] at once; ask again by
    /// [`HealthRequest::ReadTare`] what came of it.
    SetTare {
        /// Samples to average.
        samples: u16,
        /// Keep it across resets, from when the settings are stored
        /// ([`StoreSettings`](super::MemoryRequest::StoreSettings)).
        store: bool,
    },
    /// Subtract nothing any more. Answered by [`HealthResponse::Tare`].
    ClearTare {
        /// After a reset neither, once the settings are stored.
        store: bool,
    },
    /// Play every fault, and see whether it is found. Takes seconds, during which there are no wrenches. Answered by
    /// [`HealthResponse::SelfTest`] at once; ask again by [`HealthRequest::ReadSelfTest`].
    StartSelfTest,
    /// What came of the self-test? Answered by [`HealthResponse::SelfTest`].
    ReadSelfTest,
}

/// What the sensor tells about its health.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HealthResponse {
    /// How it is.
    Report(HealthReport),
    /// The limits of the load.
    Limits(LoadLimits),
    /// The tare.
    Tare(TareReport),
    /// The self-test.
    SelfTest(SelfTestReport),
}

/// How the sensor is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HealthReport {
    /// What is so now.
    pub live: StatusWord,
    /// What was so at any time since it was cleared.
    pub latched: StatusWord,
    /// Gages that stand at an end of the range now: bit k for gage k.
    pub saturated: u16,
    /// Gages that repeat their code now: bit k for gage k.
    pub repeating: u16,
    /// How well the gages agree; `None` where the sensor has no calibration or no redundant gage.
    pub parity: Option<ParityReport>,
    /// The gage that wrenches are made without.
    pub carrying_on_without: Option<u8>,
    /// Thresholds that are exceeded now: bit k for component k.
    pub thresholds: u8,
    /// The largest magnitude of each component since the start, tare or not.
    pub peak_since_start: [f32; MAX_DOF],
    /// The largest magnitude of each component ever.
    pub peak_ever: [f32; MAX_DOF],
}

/// How well the gages agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParityReport {
    /// Redundant gages, p − m.
    pub redundant: u8,
    /// Gages whose faults show at all: bit k for gage k. The others are needed for the wrench itself.
    pub watched: u16,
    /// Noise of one channel, counts, as the redundant directions show it; `None` before it is known.
    pub noise_counts: Option<f32>,
    /// Root mean square of the disagreement over the last quarter second, counts.
    pub disagreement_counts: f32,
    /// What it may be: noise, rounding and what a calibration may be off by, counts.
    pub allowed_counts: f32,
    /// The gages each of which alone would explain the disagreement: bit k for gage k. None where there is no disagreement, or no
    /// single gage explains it; several where they cannot be told apart.
    pub suspects: u16,
    /// By how much a suspect gage would be off, counts, root mean square; zero where there is none.
    pub suspect_off_counts: f32,
}

/// A level of one component, either sign, and by how much less it must become for the threshold to count as left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadThreshold {
    /// Magnitude, newton or newton metre; infinite for none.
    pub level: f32,
    /// Newton or newton metre.
    pub hysteresis: f32,
}

impl LoadThreshold {
    /// No threshold.
    pub const NONE: Self = Self { level: f32::INFINITY, hysteresis: 0.0 };
}

/// What load is too much, and which loads the user wants to hear of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadLimits {
    /// Largest magnitude of each component that does no harm, newton and newton metre; infinite for none. Judged without tare,
    /// for it is the whole load that does harm.
    pub largest: [f32; MAX_DOF],
    /// Largest root of the summed squares of all components, each over its own limit; infinite for none. At one, the loads
    /// allowed are those of the ellipsoid through the limits of each alone.
    pub combined: f32,
    /// The user's thresholds, of wrenches as they are sent: with the tare subtracted.
    pub thresholds: [LoadThreshold; MAX_DOF],
}

impl LoadLimits {
    /// None at all.
    pub const NONE: Self = Self {
        largest: [f32::INFINITY; MAX_DOF],
        combined: f32::INFINITY,
        thresholds: [LoadThreshold::NONE; MAX_DOF],
    };
}

impl Default for LoadLimits {
    fn default() -> Self {
        Self::NONE
    }
}

/// The tare.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TareReport {
    /// What is being done about it.
    pub phase: TarePhase,
    /// What is subtracted from every wrench, newton and newton metre; `None` where nothing is.
    pub wrench: Option<[f32; MAX_DOF]>,
}

/// What is being done about the tare.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TarePhase {
    /// Nothing.
    #[default]
    Settled,
    /// Samples are being averaged; until that is done, the tare is what it was.
    Averaging {
        /// Samples still to come.
        left: u16,
    },
    /// The last one asked for was refused, and the tare is what it was.
    Refused(TareRefusal),
}

/// Why a tare was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TareRefusal {
    /// A sample was no wrench: uncalibrated, saturated, at fault.
    NoWrench,
    /// The load changed meanwhile by more than noise does.
    Moving,
}

/// The self-test.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SelfTestReport {
    /// How far it is.
    pub phase: SelfTestPhase,
    /// What came of each fault that was played so far.
    pub outcomes: heapless::Vec<SelfTestOutcome, MAX_OUTCOMES>,
}

/// The most faults that a self-test plays.
pub const MAX_OUTCOMES: usize = 16;

/// How far a self-test is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SelfTestPhase {
    /// There was none since the start.
    #[default]
    None,
    /// It is under way.
    Running,
    /// It is over.
    Done,
}

/// What came of one fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelfTestOutcome {
    /// What was played.
    pub played: PlayedFault,
    /// What the sensor made of it.
    pub found: Found,
}

/// A fault that the self-test plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PlayedFault {
    /// The converter measures its own positive test signal.
    PositiveTestSignal,
    /// The converter measures its own negative test signal.
    NegativeTestSignal,
    /// The converter measures a short circuit of its own.
    ShortedInputs,
    /// A bit of a reply flips.
    CorruptedReply,
    /// A bit of a command flips on its way to the converter.
    CorruptedCommand,
    /// The line is dead: all ones.
    DeadLine,
    /// A reply is marked as read before.
    StaleReply,
    /// Replies come one frame late.
    LateReply,
    /// The converter says that it was reset.
    Reset,
    /// Conversions are not announced.
    SilentDataReady,
    /// A gage stands at the end of the range.
    SaturatedGage,
    /// A gage repeats its code.
    StuckGage,
    /// A gage jumps to another value.
    JumpingGage,
}

/// What the sensor made of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Found {
    /// It found it.
    After {
        /// From the first sample that carried the fault, microseconds.
        micros: u32,
    },
    /// It did not find it in the time that it has for it.
    Nothing,
    /// The converter's codes are what the test signal demands: within the tolerance in every channel.
    Within {
        /// The channel that is farthest off.
        channel: u8,
        /// By how much, counts.
        off_counts: i32,
    },
    /// They are not.
    Beyond {
        /// The channel that is farthest off.
        channel: u8,
        /// By how much, counts.
        off_counts: i32,
    },
    /// It could not be played: without a calibration or a redundant gage nobody can tell that a gage jumps.
    NotApplicable,
    /// The sensor did not become well after the fault before, or was not to begin with.
    NotWell(Option<AdcFault>),
}
