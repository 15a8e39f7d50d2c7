//! What a sensor reports, in words. What to do about errors is in [`super::remedy`].

use std::fmt::Write;

use ftcal_shared::fault::AdcFault;
use ftcal_shared::wire::{
    AdcState, ClockSource, Diagnosis, Failure, KeptCalibration, Rejection, ResetCause, Resumption,
    TrialPhase, TrialStatus,
};

use super::frame::NoWrench;
use super::remedy;

/// A firmware version.
pub fn version([major, minor, patch]: [u8; 3]) -> String {
    format!("{major}.{minor}.{patch}")
}

/// What is wrong with the converter.
pub fn adc_fault(fault: AdcFault) -> String {
    match fault {
        AdcFault::Bus => "the bus to the converter reports an error".into(),
        AdcFault::NotResponding => "no converter answers on the bus".into(),
        AdcFault::WrongIdentity { id } => {
            format!("the device on the bus is no ADS131M08: its identity register reads {id:#06x}")
        }
        AdcFault::ResetNotAcknowledged => "the converter does not acknowledge its reset".into(),
        AdcFault::RegisterMismatch { address } => {
            format!("the converter's register {address:#04x} does not hold what was written to it")
        }
        AdcFault::ReplyCorrupted => "the converter's replies arrive with wrong checksums".into(),
        AdcFault::CommandCorrupted => "commands reach the converter with wrong checksums".into(),
        AdcFault::UnexpectedReply => "the converter replies to something else than what it was sent".into(),
        AdcFault::UnexpectedReset => "the converter was reset without being asked to".into(),
        AdcFault::DataReadyLost => "the converter announces no conversions".into(),
        AdcFault::StaleConversion => "the converter announces conversions but delivers old ones".into(),
    }
}

/// State of the converter.
pub fn adc_state(state: AdcState) -> String {
    match state {
        AdcState::Starting => "starting".into(),
        AdcState::Running => "running".into(),
        AdcState::Faulty(fault) => format!("FAULT: {}. {}", adc_fault(fault), remedy::of_adc_fault(fault)),
    }
}

/// Why a request is not served.
pub const fn rejection(rejection: Rejection) -> &'static str {
    match rejection {
        Rejection::NoTrial => "there is no trial",
        Rejection::TrialBusy => "a trial is running or being solved",
        Rejection::UnsupportedRank => "a trial has rank 2 or 3, and at most as many as the sensor has gages",
        Rejection::WrongDimensions => "the calibration does not fit the number of gages of this sensor",
        Rejection::UnusableNumbers => {
            "a number of the calibration is not finite or beyond the converter's range"
        }
        Rejection::WrongIdentity => "the calibration's checksum does not match its numbers",
        Rejection::UnsupportedRate => "its clock cannot be divided to this baud rate",
        Rejection::Measuring => {
            "it streams samples or runs a trial, which writing to its memory would hold up"
        }
        Rejection::Storing => "it is writing to its memory",
        Rejection::Uncalibrated => "it has no calibration in use",
        Rejection::NoSuchCalibration => "it keeps no such calibration",
        Rejection::NotStored => "its memory did not take what was to be stored, and keeps what it had",
        Rejection::NoSuchGage => "the sensor has no such gage",
        Rejection::GageNeeded => {
            "without that gage there is no wrench, or one with more than ten times the noise"
        }
        Rejection::SelfTestRunning => "a self-test is running",
        Rejection::UnusableLimit => {
            "a limit must be more than zero, a hysteresis no more than its threshold, and a tare of one sample at least"
        }
    }
}

/// What is used after a reset.
pub fn kept_calibration(kept: KeptCalibration) -> String {
    match kept {
        KeptCalibration::Unread => "not read yet".into(),
        KeptCalibration::Nothing => "none".into(),
        KeptCalibration::Corrupt => "CORRUPT: what is in the memory is not what was stored".into(),
        KeptCalibration::OtherFormat(format) => {
            format!("unreadable: stored by other firmware, in format {format}")
        }
        KeptCalibration::Unusable => {
            "unusable: for another number of gages, or with numbers out of range".into()
        }
        KeptCalibration::Unreadable => "UNREADABLE: the memory is defective".into(),
        KeptCalibration::Calibration(identity) => format!("{identity:08x}"),
    }
}

/// Why a sample is no wrench.
pub fn no_wrench(cause: NoWrench) -> String {
    match cause {
        NoWrench::Uncalibrated => "the sensor has no calibration; upload one with `ftcal upload`".into(),
        NoWrench::Saturated(channels) => {
            format!(
                "{} at the end of the converter's range: too much load, or a broken gage",
                channel_list(channels)
            )
        }
        NoWrench::Adc(fault) => format!("{}. {}", adc_fault(fault), remedy::of_adc_fault(fault)),
        NoWrench::GainChanged => {
            format!(
                "the gain is not the one that the calibration was made at, so its counts are of another size. {}",
                remedy::OTHER_GAIN
            )
        }
        NoWrench::OpenInput(gages) => {
            format!("{} repeats itself as no live gage does: dead, open or shorted", channel_list(gages))
        }
        NoWrench::GagesContradict => {
            "the gages contradict each other: no load makes such codes. `ftcal health` names the suspect"
                .into()
        }
        NoWrench::SelfTest => "the sensor is testing itself".into(),
        NoWrench::UnknownCalibration(identity) => {
            format!("the calibration {identity:08x} came into use meanwhile; start the stream again")
        }
        NoWrench::NonFinite => {
            "the calibration's numbers are too large for these codes; calibrate again".into()
        }
        NoWrench::Settling => "the filter before the lower output rate has yet to fill".into(),
        NoWrench::Stale => "it came too late; this machine or the line is too slow for the stream".into(),
    }
}

/// The channels of a mask: bit k for gage k.
pub fn channel_list(mask: u16) -> String {
    let mut words = String::new();
    for channel in (0..u16::BITS).filter(|channel| mask & (1 << channel) != 0) {
        let before = if words.is_empty() { "" } else { ", " };
        // Writing to a string cannot fail.
        let _ = write!(words, "{before}ch{channel}");
    }
    words
}

/// Where the processor's clock comes from.
pub const fn clock_source(clock: ClockSource) -> &'static str {
    match clock {
        ClockSource::Crystal => "crystal",
        ClockSource::InternalFallback => {
            "internal oscillator, because the crystal did not start: times are off by up to a per cent"
        }
        ClockSource::Simulated => "simulated",
    }
}

/// What a reset came from.
pub const fn reset_cause(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::Unknown => "not known",
        ResetCause::PowerOn => "power came",
        ResetCause::BrownOut => "the supply fell too low: check it under load",
        ResetCause::Pin => "the reset pin",
        ResetCause::Watchdog => "the watchdog: a task hung; report it, with the log (`ftcal logs`)",
        ResetCause::Software => "the firmware itself",
    }
}

/// What the sensor says of its last start.
pub fn restart(diagnosis: &Diagnosis) -> String {
    let cause = format!("the cause is {}", reset_cause(diagnosis.reset));
    match &diagnosis.failure {
        None => cause,
        Some(failed) => format!("{cause}, after {}", failure(failed)),
    }
}

/// What made the firmware give up.
pub fn failure(failure: &Failure) -> String {
    match failure {
        Failure::Panic { file, line } => format!("a panic at {file}:{line}; report it"),
        Failure::ProcessorFault { at } => format!("a fault of the processor at {at:#010x}; report it"),
        Failure::StackOverflow => "the stack had no more room; report it".to_owned(),
        Failure::UnservedInterrupt { number } => {
            format!("interrupt {number} came, which nobody serves; report it")
        }
    }
}

/// What a trial is doing.
pub const fn trial_phase(phase: TrialPhase) -> &'static str {
    match phase {
        TrialPhase::None => "none",
        TrialPhase::Running => "running",
        TrialPhase::Stopped => "stopped",
        TrialPhase::Solving => "being solved",
    }
}

/// What a reset has done to the trial.
pub const fn resumption(resumption: Resumption) -> &'static str {
    match resumption {
        Resumption::None => "none",
        Resumption::Resumed => "resumed",
        Resumption::Lost => "lost",
    }
}

/// State of the trial.
pub fn trial_status(trial: &TrialStatus) -> String {
    let phase = trial_phase(trial.phase);
    if trial.phase == TrialPhase::None {
        return match trial.resumption {
            Resumption::Lost => {
                format!(
                    "{phase}; the one before the reset is lost: it had no checkpoint yet, or none that can be read"
                )
            }
            Resumption::None | Resumption::Resumed => phase.into(),
        };
    }
    let mut words = format!("{phase}, rank {}, {} samples used", trial.rank, trial.used);
    if trial.resumption == Resumption::Resumed {
        words.push_str(match trial.phase {
            TrialPhase::Running => {
                " (resumed after a reset; what came between its last checkpoint and that is lost)"
            }
            // The sensor does not say which.
            _ => {
                " (kept across a reset: whole if it was stopped before that, and else without what came after its last checkpoint)"
            }
        });
    }
    if trial.checkpointed > 0 {
        let _ = write!(words, ", {} of them safe from a reset", trial.checkpointed);
    }
    if trial.saturated > 0 {
        let _ = write!(words, ", {} rejected for saturation", trial.saturated);
    }
    if trial.repeated > 0 {
        let _ = write!(words, ", {} rejected because the converter repeated itself", trial.repeated);
    }
    if trial.moving > 0 {
        let _ = write!(words, ", {} left out because the load moved too much", trial.moving);
    }
    if trial.off_magnitude > 0 {
        let _ = write!(words, ", {} left out because the load was of another magnitude", trial.off_magnitude);
    }
    if trial.contradictory > 0 {
        let _ = write!(words, ", {} rejected because the gages contradicted each other", trial.contradictory);
    }
    if trial.unattended > 0 {
        let _ = write!(words, ", {} missed while the sums were worked on", trial.unattended);
    }
    words
}
