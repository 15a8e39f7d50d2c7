//! What to do about each error of the link and of the sensor, written once.

use ftcal_shared::fault::AdcFault;
use ftcal_shared::wire::{PROTOCOL_VERSION, Rejection};

use super::error::{ClientError, LinkError};
use super::serial::OpenError;
use super::transport::TransportError;
use crate::remedy::{Explained, estimation};

/// What to do about a calibration of another gain than the converter has.
pub const OTHER_GAIN: &str = "Set the gain that the calibration was made at with `ftcal settings --gain N` (`ftcal info` says which), or \
                              calibrate at this one.";

/// Explains an error of the client.
pub fn of_client(error: &ClientError) -> Explained {
    let (cause, remedy) = match error {
        ClientError::Refused(refusal) => return estimation(refusal),
        ClientError::Link(error) => of_link(error),
        ClientError::Rejected(rejection) => of_rejection(*rejection),
        ClientError::Converter(fault) => ("converter-fault", of_adc_fault(*fault)),
        ClientError::ConverterNotStarting { .. } => (
            "converter-silent",
            "Look at `ftcal info`; if it names no fault, switch the sensor off and on again.",
        ),
        ClientError::Restarted(_) => (
            "sensor-restarted",
            "Start again; where it happens again, check the sensor's supply and its plugs, and report what `ftcal info` says of \
             the last reset.",
        ),
        ClientError::StreamAbandoned => {
            ("stream-abandoned", "Have the output read faster, or written to a file.")
        }
        ClientError::NoSamples { .. } => {
            ("no-samples", "Try again; lower the data rate if it happens again.")
        }
    };
    Explained { cause, detail: error.to_string(), remedy }
}

/// Explains why a port cannot be opened.
pub fn of_open(error: &OpenError) -> Explained {
    let (cause, remedy) = match error {
        OpenError::NoSuchPort { .. } => ("no-such-port", "See `ftcal ports` for the ports there are."),
        OpenError::NotPermitted { .. } => (
            "port-not-permitted",
            "On Linux, join the port's group: `sudo usermod -aG dialout $USER`, then log in again.",
        ),
        OpenError::InUse { .. } => {
            ("port-in-use", "Close the other program (a terminal, another ftcal) and try again.")
        }
        OpenError::CannotOpen { .. } => {
            ("port-unusable", "Name the sensor's own port; see `ftcal ports` for the ports there are.")
        }
    };
    Explained { cause, detail: error.to_string(), remedy }
}

/// What to do about a fault of the converter.
pub const fn of_adc_fault(fault: AdcFault) -> &'static str {
    match fault {
        AdcFault::Bus | AdcFault::NotResponding | AdcFault::ResetNotAcknowledged => {
            "Check the converter's supply and its SPI wiring; the sensor tries again by itself."
        }
        AdcFault::WrongIdentity { .. } => {
            "The board needs an ADS131M08: check which part is fitted, and the SPI wiring."
        }
        AdcFault::RegisterMismatch { .. }
        | AdcFault::ReplyCorrupted
        | AdcFault::CommandCorrupted
        | AdcFault::UnexpectedReply => {
            "Bits are lost on the SPI bus: check its wiring, length and ground; the sensor tries again by itself."
        }
        AdcFault::UnexpectedReset => {
            "Check the converter's supply and its reset line; the sensor starts it again by itself."
        }
        AdcFault::DataReadyLost | AdcFault::StaleConversion => {
            "Check the data-ready line and the converter's clock; the sensor tries again by itself."
        }
    }
}

const fn of_rejection(rejection: Rejection) -> (&'static str, &'static str) {
    match rejection {
        Rejection::NoTrial => ("no-trial", "Start one with `ftcal trial start`."),
        Rejection::TrialBusy => {
            ("trial-busy", "Stop it with `ftcal trial stop`, or wait until it is solved.")
        }
        Rejection::UnsupportedRank => {
            ("unsupported-rank", "Use rank 2 for a planar sensor, 3 for a spatial one.")
        }
        Rejection::WrongDimensions => {
            ("wrong-dimensions", "Use a calibration of this very sensor; it keeps the one that it had.")
        }
        Rejection::UnusableNumbers => {
            ("unusable-numbers", "Calibrate again; the sensor keeps the calibration that it had.")
        }
        Rejection::WrongIdentity => {
            ("wrong-identity", "Upload again; the sensor keeps the calibration that it had.")
        }
        Rejection::Measuring => (
            "measuring",
            "Stop the stream, and the trial with `ftcal trial stop`; then try again. To erase a part of the memory \
             stalls the sensor for a second or two.",
        ),
        Rejection::Storing => ("storing", "Try again in a few seconds."),
        Rejection::Uncalibrated => ("uncalibrated", "Upload a calibration: `ftcal upload FILE --store`."),
        Rejection::NoSuchCalibration => {
            ("no-such-calibration", "See `ftcal info` for the calibrations that it keeps.")
        }
        Rejection::NotStored => (
            "not-stored",
            "Try again; if it fails again, the flash is worn or defective, and the sensor works with uploaded \
             calibrations only.",
        ),
        Rejection::NoSuchGage => {
            ("no-such-gage", "Gages are counted from zero; `ftcal info` says how many there are.")
        }
        Rejection::GageNeeded => {
            ("gage-needed", "Have the gage repaired; `ftcal health --with-all` measures with all of them.")
        }
        Rejection::SelfTestRunning => ("self-test-running", "Wait until it is over: a few seconds."),
        Rejection::UnusableLimit => {
            ("unusable-limit", "Check the numbers; the sensor keeps those that it had.")
        }
        Rejection::UnsupportedRate => {
            ("unsupported-rate", "Leave --baud away, or name another rate: 2000000 and 1000000 are exact.")
        }
    }
}

const fn of_link(error: &LinkError) -> (&'static str, &'static str) {
    match error {
        LinkError::Line(TransportError::Vanished) => {
            ("port-vanished", "Plug the sensor in again, or start `ftcal sim` again.")
        }
        LinkError::Line(TransportError::NoSuchRate { .. }) => {
            ("no-such-rate", "Leave --baud away, or name a rate that this machine's serial port has.")
        }
        LinkError::RateDoesNotWork { .. } => {
            ("rate-does-not-work", "Leave --baud away, or use a shorter cable or another serial adapter.")
        }
        LinkError::Line(_) => ("port-failed", "Unplug the sensor, plug it in again, and try again."),
        LinkError::Silence { .. } => (
            "no-answer",
            "Check that the port is the sensor's, that the sensor is powered, and that its firmware is flashed \
             (`ftcal flash`).",
        ),
        LinkError::NoAnswer { broken_frames: 0, .. } => ("no-answer", "The sensor is alive: try again."),
        LinkError::NoAnswer { .. } => (
            "no-answer",
            "Something else than a sensor, or noise on the line: check that the port is the sensor's, and the cable.",
        ),
        LinkError::OtherProduct { .. } => (
            "other-product",
            "Name the sensor's own port with --port; see `ftcal ports` for the ports there are.",
        ),
        LinkError::OtherVersion { device, .. } if *device > PROTOCOL_VERSION => (
            "other-version",
            "Use the ftcal of the firmware's version, or flash this version's firmware with `ftcal flash`.",
        ),
        LinkError::OtherVersion { .. } => {
            ("other-version", "Flash this version's firmware with `ftcal flash`.")
        }
        LinkError::UnexpectedResponse | LinkError::TooLong => (
            "protocol-defect",
            "This is a defect of ftcal or of the firmware; flash the firmware of this very version with `ftcal flash`.",
        ),
        LinkError::ReadBackDiffers { .. } => {
            ("read-back-differs", "Upload again; do not measure with this sensor until that succeeds.")
        }
    }
}
