//! What a sensor tells of calibrations in the field, in words, and what to do about those that came to nothing.

use ftcal_shared::wire::{FieldComparison, FieldOutcome, FieldPhase, FieldRefusal, Renewed};

use super::remedy::OTHER_GAIN;
use super::words;
use crate::remedy::estimation;

/// What is going on.
pub fn phase(phase: FieldPhase) -> String {
    match phase {
        FieldPhase::Idle => "idle".to_owned(),
        FieldPhase::Preparing => "getting ready for a trial".to_owned(),
        FieldPhase::Running { quarters } => {
            format!("a trial runs and has {} % of its way behind it", 25 * u32::from(quarters.min(4)))
        }
        FieldPhase::Solving => "a trial is being solved".to_owned(),
        FieldPhase::Storing => "a new calibration waits to be stored until nothing is streamed".to_owned(),
    }
}

/// The same in one word.
pub const fn phase_name(phase: FieldPhase) -> &'static str {
    match phase {
        FieldPhase::Idle => "idle",
        FieldPhase::Preparing => "preparing",
        FieldPhase::Running { .. } => "running",
        FieldPhase::Solving => "solving",
        FieldPhase::Storing => "storing",
    }
}

/// What of a calibration was renewed in the field.
pub fn renewed(renewed: Renewed, found: &FieldComparison) -> String {
    let what = match renewed {
        Renewed::Bias => "bias renewed in the field",
        Renewed::ShapeAndBias => "renewed in the field",
    };
    format!("{what}, from {:08x}; {}", found.reference, comparison(found))
}

/// What the last one has ended with, and what to do about it.
pub fn outcome(outcome: &FieldOutcome) -> String {
    match outcome {
        FieldOutcome::Renewed(what, found) => renewed(*what, found),
        FieldOutcome::Confirmed(found) => {
            format!("{:08x} was confirmed and kept; {}", found.reference, comparison(found))
        }
        FieldOutcome::Refused(refusal) => {
            let (_, cause, remedy) = explained(refusal);
            format!("refused: {cause}. {remedy}")
        }
    }
}

/// The same in one word.
pub fn outcome_name(outcome: &FieldOutcome) -> &'static str {
    match outcome {
        FieldOutcome::Renewed(..) => "renewed",
        FieldOutcome::Confirmed(_) => "confirmed",
        FieldOutcome::Refused(refusal) => explained(refusal).0,
    }
}

fn comparison(found: &FieldComparison) -> String {
    format!(
        "gage {} had moved most, by {:.2} %, and the zero by {:.3} N; known within {:.2} %; the load weighed {:.3} N by the \
         calibration before",
        found.gage,
        100.0 * found.drift,
        found.bias_shift_newton,
        100.0 * found.relative_uncertainty,
        found.load_newton
    )
}

/// An identifier, what was found, and what to do next.
fn explained(refusal: &FieldRefusal) -> (&'static str, String, &'static str) {
    let (name, cause, remedy) = match refusal {
        FieldRefusal::Uncalibrated => (
            "uncalibrated",
            "there is no calibration that could orient another",
            "Calibrate with `ftcal` once.",
        ),
        FieldRefusal::CalibrationNotKept => (
            "calibration-not-kept",
            "the calibration in use is not kept across resets",
            "Store it: `ftcal upload FILE --store`.",
        ),
        FieldRefusal::MeasuresTorque => (
            "measures-torque",
            "a load at one arm tells nothing of the torques",
            "Calibrate this sensor with `ftcal calibrate --reference`.",
        ),
        FieldRefusal::GainChanged => ("gain-changed", "the calibration is for another gain", OTHER_GAIN),
        FieldRefusal::Converter => (
            "converter-fault",
            "the converter was at fault, or being started",
            "See above what is wrong with it.",
        ),
        FieldRefusal::Busy(rejection) => {
            ("busy", words::rejection(*rejection), "Press again when that is over.")
        }
        FieldRefusal::TakenOver => ("taken-over", "a host has stopped the trial", "Press again."),
        FieldRefusal::CalibrationChanged => {
            ("calibration-changed", "another calibration came into use meanwhile", "Press again.")
        }
        FieldRefusal::Trial(refusal) => {
            let explained = estimation(refusal);
            return (explained.cause, explained.detail, explained.remedy);
        }
        FieldRefusal::Unfinished { quarters, need } => {
            let percent = |quarters: u8| 25 * u32::from(quarters);
            let cause = format!(
                "the trial was stopped at {} % of its way, and {} % are needed",
                percent(*quarters),
                percent(*need)
            );
            return (
                "unfinished",
                cause,
                "Turn the load until the light flashes four times, or until it shows a result.",
            );
        }
        FieldRefusal::UnusableNumbers => (
            "unusable-numbers",
            "the numbers of the calibration make no sense",
            "Calibrate anew with `ftcal`.",
        ),
        FieldRefusal::EitherHand => (
            "either-hand",
            "a mirror image fits the calibration nearly as well",
            "Calibrate this sensor with `ftcal` and known loads.",
        ),
        FieldRefusal::Drifted { gage, drift, limit } => {
            let cause = format!(
                "gage {gage} has changed by {:.1} %, and no drift is more than {:.1} %",
                100.0 * drift,
                100.0 * limit
            );
            return (
                "drifted",
                cause,
                "Look at that gage, and at how the load hangs; if all is sound, calibrate anew with `ftcal`.",
            );
        }
        FieldRefusal::NotStored => (
            "not-stored",
            "the memory did not take the new calibration",
            "Press again; if it fails again, the flash is worn or defective.",
        ),
    };
    (name, cause.to_owned(), remedy)
}
