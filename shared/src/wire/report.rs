//! What the sensor tells: its state, its trial, its samples.

use serde::{Deserialize, Serialize};

use super::memory::KeptCalibrations;
use super::message::{GageList, StreamKind};
use crate::fault::AdcFault;
use crate::units::{AdcCode, DataRate, Decimation, DeviceTime, Gain, MAX_GAGES, SampleIndex};

/// State of the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Gage channels p.
    pub gages: u8,
    /// Where the processor's clock comes from.
    pub clock: ClockSource,
    /// State of the converter.
    pub adc: AdcState,
    /// Conversions a second.
    pub data_rate: DataRate,
    /// Gain of the converter.
    pub gain: Gain,
    /// What is being sent unasked.
    pub stream: StreamKind,
    /// Identity of the calibration in use; `None` where the sensor is not calibrated.
    pub calibration: Option<u32>,
    /// State of the trial.
    pub trial: TrialStatus,
    /// Time since the start.
    pub uptime: DeviceTime,
    /// Conversions read well.
    pub conversions: u32,
    /// Conversions lost: announced but not read in time, or never announced.
    pub lost_conversions: u32,
    /// Conversions thrown away because their checksum was wrong.
    pub corrupted_conversions: u32,
    /// Samples of the stream that did not fit on the line.
    pub dropped_samples: u32,
    /// Frames from the host that were broken.
    pub broken_frames: u32,
    /// The calibrations that survive a reset.
    pub kept: KeptCalibrations,
    /// Streams that were ended because the host said nothing any more.
    pub abandoned_streams: u32,
    /// Conversions that were read, and thrown away because those before were not worked off yet.
    pub overrun_conversions: u32,
    /// Samples that were not attended to before the next conversion was due. They are as good as others, but late.
    pub late_samples: u32,
}

/// At which rate wrenches go out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Conversions a second.
    pub data_rate: DataRate,
    /// How many of them make one sample of the stream.
    pub decimation: Decimation,
    /// How long the filter before the decimation delays every frequency: exactly this many conversions. It is in the samples'
    /// times already: each bears the time that it is of.
    pub group_delay_conversions: u16,
}

/// Where the processor's clock comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// The crystal, as designed.
    Crystal,
    /// The internal oscillator, because the crystal did not start: times are off by up to a per cent.
    InternalFallback,
    /// The simulator's own time.
    Simulated,
}

/// State of the converter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AdcState {
    /// Not yet started.
    Starting,
    /// Converting.
    Running,
    /// Not usable; no sample is produced.
    Faulty(AdcFault),
}

/// State of the trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TrialStatus {
    /// What the trial is doing.
    pub phase: TrialPhase,
    /// The proper rank asked for; 0 before the first trial.
    pub rank: u8,
    /// Samples taken in; once the trial is solved, those that its metric was taken from.
    pub used: u32,
    /// Samples rejected because a channel stood at the end of its range.
    pub saturated: u32,
    /// Index of the first sample that was offered to the trial.
    pub first: SampleIndex,
    /// Samples offered to the trial: used and rejected.
    pub offered: u32,
    /// Samples rejected because the converter repeats itself.
    pub repeated: u32,
    /// Samples that the solution leaves out because the load moved too much; zero before the trial is solved.
    pub moving: u32,
    /// Samples rejected because their codes answer to no load at this arm, once a first solution tells.
    pub contradictory: u32,
    /// Samples that the solution leaves out because the load was of another magnitude; zero before the trial is solved.
    pub off_magnitude: u32,
    /// Samples that came while the sums were being worked on, and are lost to the trial.
    pub unattended: u32,
    /// Whether the trial has survived a reset.
    pub resumption: Resumption,
    /// Samples that are kept: a reset now would lose the others.
    pub checkpointed: u32,
}

/// What a reset has done to the trial.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resumption {
    /// There was none since the trial began.
    #[default]
    None,
    /// It goes on from its last checkpoint. What came between that and the reset is lost; how many samples that were, is unknown.
    Resumed,
    /// There was a trial, and it cannot be resumed: it had no checkpoint yet, or other firmware wrote it.
    Lost,
}

/// What a trial is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TrialPhase {
    /// There is none.
    #[default]
    None,
    /// Taking in samples.
    Running,
    /// Stopped, ready to be solved.
    Stopped,
    /// Being solved.
    Solving,
}

/// One trial's shape and bias, as solved on the sensor; the orientation is arbitrary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// The proper rank r.
    pub rank: u8,
    /// S (r × p, row by row), counts per unit load.
    pub shape_counts_per_load: heapless::Vec<f64, { 3 * MAX_GAGES }>,
    /// b (p), counts.
    pub bias_counts: GageList<f64>,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: GageList<f64>,
    /// Standard deviation of the noise of one channel, counts; `None` at p = r.
    pub noise_counts: Option<f64>,
    /// Samples that took part.
    pub samples: u32,
}

/// Where a trial stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Samples that took part.
    pub samples: u32,
    /// The share of all directions that the load has been through, 0 to 1.
    pub fraction: f32,
    /// The largest predicted standard deviation of a gain, cross-talk or offset, relative to the load.
    pub worst_relative_uncertainty: f32,
    /// Which way to turn the load next: what gages read there, the most telling one first.
    pub targets: heapless::Vec<GageTarget, 3>,
    /// Standard deviations of b (p), counts.
    pub bias_deviation_counts: GageList<f32>,
    /// Standard deviations of S (r × p, row by row), counts per unit load, up to its orientation.
    pub shape_deviation_counts_per_load: heapless::Vec<f32, { 3 * MAX_GAGES }>,
}

/// What one gage reads with the load where it is to be turned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GageTarget {
    /// The gage, counted from zero.
    pub gage: u8,
    /// Its code there, counts.
    pub counts: f32,
    /// Where that stands in the range that turning the load gives this gage: from −1, the lowest, to 1, the highest.
    pub position: f32,
}

/// One raw sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CodesFrame {
    /// Number of the conversion.
    pub index: SampleIndex,
    /// When it was read.
    pub time: DeviceTime,
    /// The codes (p).
    pub codes: GageList<AdcCode>,
}

/// Why a sample makes no wrench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidCause {
    /// The sensor has no calibration.
    Uncalibrated,
    /// These channels stood at the end of their range: bit k for gage k.
    Saturated(u16),
    /// The converter is at fault.
    Adc(AdcFault),
    /// The converter has another gain than the calibration was made at: its counts are of another size.
    GainChanged,
    /// A component is infinite or beyond all measure: the calibration's numbers are too large for these codes.
    NonFinite,
    /// These gages repeat their code, as no live input does: bit k for gage k.
    OpenInput(u16),
    /// The gages contradict each other by more than noise can: no load whatever gives these codes.
    GagesContradict,
    /// Faults are being played.
    SelfTest,
    /// The filter before the decimation has not seen enough samples yet: since the start, a gap, or another calibration.
    Settling,
}
