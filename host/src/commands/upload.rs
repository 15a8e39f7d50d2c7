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
    /// Have the sensor keep it across resets, too; the one that it kept so far can be brought back with `ftcal rollback`
    #[arg(long)]
    store: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Reads the file, checks it, and has the sensor use it, and keep it if so wanted.
///
/// # Errors
///
/// [`Failure`]; the sensor then keeps the calibration that it had, unless the failure says otherwise.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let calibration = calibration_file::read(&arguments.calibration).map_err(Failure::input)?;
    let mut client = arguments.device.connect()?;
    let gain = client.status()?.gain;
    let upload = calibration.upload(gain).with_context(|| shown(&arguments.calibration))?;
    client.upload_calibration(&upload)?;
    writeln!(
        streams.words,
        "The sensor uses calibration {:08x} ({} gages, {} components), verified by reading it back.",
        upload.identity,
        upload.bias_counts.len(),
        upload.dof.count()
    )?;
    if !arguments.store {
        writeln!(streams.words, "It is lost with the next reset; to have it kept, upload it with --store.")?;
        return Ok(());
    }
    let kept = client.store_calibration()?;
    write!(streams.words, "It is kept across resets")?;
    match kept.previous {
        None => writeln!(streams.words, ".")?,
        Some(previous) => {
            writeln!(streams.words, "; `ftcal rollback` brings {previous:08x} back.")?;
        }
    }
    Ok(())
}
