//! What has come of calibrations in the field, started with the sensor's own button and no host.

use serde::{Deserialize, Serialize};

use super::message::Rejection;
use crate::refusal::Refusal;

/// What has come of calibrations in the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FieldReport {
    /// What is going on.
    pub phase: FieldPhase,
    /// What the last one since the start has ended with.
    pub last: Option<FieldOutcome>,
    /// Where the calibration in use comes from; `None` where there is none.
    pub origin: Option<CalibrationOrigin>,
}

/// What is going on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FieldPhase {
    /// Nothing.
    #[default]
    Idle,
    /// Room for the trial's checkpoints is being made.
    Preparing,
    /// The trial takes samples in.
    Running {
        /// Quarters of its way that it has behind it, 0 to 3.
        quarters: u8,
    },
    /// The trial is being solved and compared.
    Solving,
    /// The new calibration is to be stored: as soon as nothing is streamed and no trial runs.
    Storing,
}

/// What a calibration in the field has ended with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FieldOutcome {
    /// The sensor has moved; a new calibration is in use, and kept.
    Renewed(Renewed, FieldComparison),
    /// The sensor has not moved by more than chance explains; it keeps the calibration that it has.
    Confirmed(FieldComparison),
    /// There is no answer, or none that may be used; the sensor keeps the calibration that it has.
    Refused(FieldRefusal),
}

/// What of a calibration is new. What has not moved is kept as it was: it was determined at least as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Renewed {
    /// The bias.
    Bias,
    /// The bias, and the ratios between the gages' answers.
    ShapeAndBias,
}

/// A trial held against the calibration that it was oriented to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FieldComparison {
    /// Identity of that calibration.
    pub reference: u32,
    /// The largest predicted standard deviation of a gain, cross-talk or offset of the trial, relative to the load.
    pub relative_uncertainty: f32,
    /// The largest change of the answer of a gage, relative to it.
    pub drift: f32,
    /// The gage that has changed so.
    pub gage: u8,
    /// By how much the codes with no load have moved, as a force by that calibration, newton.
    pub bias_shift_newton: f32,
    /// The weight of what hung on the sensor by that calibration, newton. Whoever knows better knows by how much all gages together
    /// have changed, which the trial itself cannot tell.
    pub load_newton: f32,
}

/// Where a calibration comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationOrigin {
    /// A host has uploaded it.
    #[default]
    Uploaded,
    /// It was renewed in the field.
    Field(Renewed, FieldComparison),
}

/// Why a calibration in the field has come to nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FieldRefusal {
    /// There is no calibration that could orient another.
    Uncalibrated,
    /// The calibration in use is not the one that is kept across resets: it could not be brought back.
    CalibrationNotKept,
    /// The sensor measures torque, of which a load at one arm does not tell.
    MeasuresTorque,
    /// The calibration is for another gain than the converter has.
    GainChanged,
    /// The converter is at fault, or being started.
    Converter,
    /// Something else is under way: a trial, a self-test, a store.
    Busy(Rejection),
    /// The host has stopped the trial, or begun another.
    TakenOver,
    /// Another calibration has come into use meanwhile.
    CalibrationChanged,
    /// The trial has no answer.
    Trial(Refusal),
    /// The trial was stopped too early.
    Unfinished {
        /// Quarters of its way that it had behind it.
        quarters: u8,
        /// The fewest with which it says anything.
        need: u8,
    },
    /// The numbers of a calibration make no sense.
    UnusableNumbers,
    /// A mirror image of the trial fits the calibration that there is nearly as well.
    EitherHand,
    /// A gage has moved too far for a drift: it is damaged, or this is another sensor or another way of loading it.
    Drifted {
        /// The gage.
        gage: u8,
        /// The change of its answer, relative to it.
        drift: f32,
        /// The largest that is taken for a drift.
        limit: f32,
    },
    /// The memory did not take the new calibration.
    NotStored,
}
