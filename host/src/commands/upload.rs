//! `ftcal upload`: gives the sensor its calibration.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::device::DeviceArgs;
use super::{Failure, Streams};
use crate::calibration_file;
use crate::recording::shown;

/// The arguments of `ftcal upload`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Calibration file, as `ftcal calibrate` writes it
    calibration: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Reads the file, checks it, and has the sensor use it.
///
/// # Errors
///
/// [`Failure`]; the sensor then keeps the calibration that it had, unless the failure says otherwise.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let calibration = calibration_file::read(&arguments.calibration).map_err(Failure::input)?;
    let upload = calibration.upload().with_context(|| shown(&arguments.calibration))?;
    arguments.device.connect()?.upload_calibration(&upload)?;
    writeln!(
        streams.words,
        "The sensor uses calibration {:08x} ({} gages, {} components), verified by reading it back.",
        upload.identity,
        upload.bias_counts.len(),
        upload.dof.count()
    )?;
    Ok(())
}
