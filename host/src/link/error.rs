//! What can go wrong between the host and a sensor.
//!
//! The link's troubles ([`LinkError`]) stand apart from what the sensor itself says: that it does not serve a request
//! ([`Rejection`]), that a trial has no answer ([`Refusal`]), or that its converter is at fault ([`AdcFault`]). Remedies are in
//! [`super::remedy`].

use ftcal_shared::fault::AdcFault;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::wire::{Diagnosis, PROTOCOL_VERSION, Rejection};
use thiserror::Error;

use super::transport::TransportError;
use super::words;
use crate::remedy::estimation;

/// Why a request has no result.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The link failed, or what is at its other end is not what it should be.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The sensor does not serve the request.
    #[error("the sensor rejects the request: {}", words::rejection(*.0))]
    Rejected(Rejection),
    /// The sensor refuses an answer.
    #[error("the sensor refuses an answer: {}", estimation(.0).detail)]
    Refused(Refusal),
    /// The converter does not run.
    #[error("the sensor's converter does not run: {}", words::adc_fault(*.0))]
    Converter(AdcFault),
    /// The converter is not found at fault, but delivers nothing.
    #[error("the sensor's converter has delivered no conversion within {seconds:.1} s")]
    ConverterNotStarting {
        /// How long was waited, seconds.
        seconds: f64,
    },
    /// The sensor has started anew in the middle of a stream.
    #[error("the sensor has restarted in the middle of the stream: {}", words::restart(.0))]
    Restarted(Diagnosis),
    /// The sensor has ended the stream.
    #[error("the sensor has ended the stream, because it has heard nothing from this program for seconds")]
    StreamAbandoned,
    /// The sensor streams, and no sample comes.
    #[error("the sensor answers, but no sample came for {seconds} s")]
    NoSamples {
        /// How long was waited, seconds.
        seconds: u64,
    },
}

/// What is wrong with the link.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The line itself failed.
    #[error(transparent)]
    Line(#[from] TransportError),
    /// Nothing came at all.
    #[error("the sensor does not answer: not one byte came within {seconds:.1} s")]
    Silence {
        /// How long was waited, seconds.
        seconds: f64,
    },
    /// Something came, but not the answer.
    #[error(
        "no answer within {seconds:.1} s: {bytes} bytes came, with {broken_frames} broken frames and no answer among them"
    )]
    NoAnswer {
        /// How long was waited, seconds.
        seconds: f64,
        /// Bytes that came meanwhile.
        bytes: u64,
        /// Frames among them that were broken.
        broken_frames: u64,
    },
    /// The device speaks the greeting, but is another product.
    #[error("the device is no ftcal sensor: it calls itself \"{}\"", product.escape_ascii())]
    OtherProduct {
        /// What it calls itself.
        product: [u8; 5],
    },
    /// The device speaks another version of the protocol.
    #[error(
        "the sensor speaks protocol version {device} (firmware {}), this ftcal speaks version {PROTOCOL_VERSION}",
        words::version(*firmware)
    )]
    OtherVersion {
        /// The device's protocol version.
        device: u16,
        /// The version of its firmware.
        firmware: [u8; 3],
    },
    /// The response is of a kind that the request does not have.
    #[error("the sensor answered with something else than what was asked for")]
    UnexpectedResponse,
    /// Nothing was heard at a new baud rate.
    #[error("the line does not carry {baud} baud")]
    RateDoesNotWork {
        /// The rate.
        baud: u32,
    },
    /// A message does not fit into a frame.
    #[error("the message is too long for a frame")]
    TooLong,
    /// The calibration read back is not the one uploaded.
    #[error("the calibration read back from the sensor is not the one uploaded ({uploaded:08x})")]
    ReadBackDiffers {
        /// Identity of the one uploaded.
        uploaded: u32,
    },
}
